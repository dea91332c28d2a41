"""The verb `grade`: judge inverse kinematics written by somebody else."""

from __future__ import annotations

import argparse
import json
import shlex
import sys
import time
from pathlib import Path
from typing import Any

from kr210_sim.exceptions import BadInput, Interrupted
from kr210_sim.grading.source import FRAMES, SCOPES, SolverLimits, SolverSource
from kr210_sim.interrupts import one_interrupt
from kr210_sim.verbs.common import EXIT_GATE, EXIT_PASSED, whole


def add(verbs: Any) -> None:
    """Add `grade` to the verbs."""
    parser = verbs.add_parser(
        "grade",
        help="grade an IK of your own, or a class of them",
        description="Let solvers drive the arm through pick-and-place cycles, and judge every "
        "answer. A file of the course (IK_server.py) runs as it is. Exit status: 0 passed (all of "
        "a class, all steps, all debug cases within 1 mm), 1 not passed, 2 bad input.",
        allow_abbrev=False,
    )
    parser.add_argument(
        "solver", nargs="+", help="FILE.py, FILE.py:FUNC, MODULE:FUNC, or several files and folders"
    )
    parser.add_argument(
        "--cycles", type=whole, default=10, metavar="N", help="cycles to drive (default: 10)"
    )
    parser.add_argument(
        "--seed", type=whole, default=0, metavar="S", help="of the cycles (default: 0)"
    )
    parser.add_argument(
        "--frame", default=FRAMES[0], metavar="LINK", help="gripper_link (default) or link_6"
    )
    parser.add_argument(
        "--ik-scope", default=SCOPES[0], metavar="WHICH", help="course (default) or all"
    )
    defaults = SolverLimits()
    parser.add_argument(
        "--pose-timeout", type=float, default=defaults.pose_timeout, metavar="S",
        help="longest time for one pose [s] (default: 30)",
    )  # fmt: skip
    parser.add_argument(
        "--time-limit", type=float, default=defaults.time_limit, metavar="S",
        help="longest time for all answers of a solver [s] (default: 900)",
    )  # fmt: skip
    parser.add_argument(
        "--debug-cases", nargs="?", const=0, type=whole, metavar="N",
        help="only print the errors at the course's three golden poses, and N random ones",
    )  # fmt: skip
    parser.add_argument(
        "--step", metavar="NAME",
        help="grade one step of the course (docs/course), by the function of that name; or all",
    )  # fmt: skip
    parser.add_argument("--jobs", type=whole, default=1, metavar="N", help="(default: 1)")
    parser.add_argument("--out", type=Path, metavar="DIR", help="folder of the reports")
    parser.add_argument("--resume", action="store_true", help="go on with the class in --out")
    parser.add_argument("--json", action="store_true", help="print JSON, all else on stderr")
    parser.set_defaults(verb=_grade)


def _grade(options: argparse.Namespace) -> int:
    from kr210_sim.grading.grade import GradeConfig

    config = GradeConfig(
        cycles=options.cycles,
        seed=options.seed,
        frame=options.frame,
        scope=options.ik_scope,
        limits=SolverLimits(pose_timeout=options.pose_timeout, time_limit=options.time_limit),
    )
    if options.resume and options.out is None:
        raise BadInput("--resume: which class? name its folder by --out DIR")
    if not 1 <= options.jobs <= 1024:
        raise BadInput(f"--jobs: {options.jobs} is out of range; give 1 to 1024")
    paths = [Path(text) for text in options.solver]
    with one_interrupt():
        if len(paths) > 1 or paths[0].is_dir():
            return _class(paths, config, options)
        if options.resume:
            raise BadInput("--resume: is for a class; a single solver is graded anew, leave it out")
        source = _source(options.solver[0])
        if options.step is not None:
            return _steps(source, config, options)
        if options.debug_cases is not None:
            return _debug(source, config, options)
        return _single(source, config, options)


def _source(text: str) -> SolverSource:
    if text.endswith(".py"):
        return SolverSource.from_file(Path(text))
    return SolverSource.parse(text, "FILE.py")


def _debug(source: SolverSource, config: Any, options: argparse.Namespace) -> int:
    from contextlib import closing

    from kr210_sim.grading.debug_cases import GOLDEN, debug_report, random_cases
    from kr210_sim.grading.findings import Refused
    from kr210_sim.grading.foreign import ForeignSolver, refuse_mistyped
    from kr210_sim.loading import read_robot
    from kr210_sim.source import RobotSource

    if options.json:
        raise BadInput("--json: --debug-cases prints text alone; leave one of them out")
    if not 0 <= options.debug_cases <= 10_000:
        raise BadInput(f"--debug-cases: {options.debug_cases} is out of range; give 0 to 10000")
    _, robot = read_robot(RobotSource())
    solver = ForeignSolver(source, robot, frame=config.frame, limits=config.limits)
    with closing(solver):
        cases = [*GOLDEN, *random_cases(robot, options.debug_cases, config.seed)]
        try:
            text, passed = debug_report(solver, robot, cases)
        except Refused as refused:  # it cannot be loaded
            refuse_mistyped(source, refused)
            print(refused.finding.text(solver.source.name))
            return EXIT_GATE
    print(text)
    return EXIT_PASSED if passed else EXIT_GATE


def _steps(source: SolverSource, config: Any, options: argparse.Namespace) -> int:
    from kr210_sim.grading.exercises import check_step, find_exercises, step_text
    from kr210_sim.loading import read_robot
    from kr210_sim.source import RobotSource

    if options.debug_cases is not None:
        raise BadInput("--step: give it or --debug-cases, not both")
    if source.function is not None:
        raise BadInput(f"--step: asks the step's own function; leave ':{source.function}' out")
    exercises = find_exercises(options.step)
    _, robot = read_robot(RobotSource())
    found = []
    text = sys.stderr if options.json else sys.stdout
    for exercise in exercises:
        found.append(check_step(exercise, source, robot, seed=config.seed, limits=config.limits))
        print(step_text(exercise, found[-1]), file=text, flush=True)
    passed = sum(step["passed"] for step in found)
    if len(found) > 1:
        print(f"\n{passed} of {len(found)} steps are right", file=text)
    if options.json:
        print(json.dumps(found, indent=2, allow_nan=False))
    return EXIT_PASSED if passed == len(found) else EXIT_GATE


def _single(source: SolverSource, config: Any, options: argparse.Namespace) -> int:
    from kr210_sim.grading.class_list import PAGES, open_folder, write_grade
    from kr210_sim.grading.grade import grade
    from kr210_sim.grading.report import grade_text
    from kr210_sim.summary import HEADER, cycle_line

    out = _out(options)
    is_new = not out.exists()
    open_folder(out, resume=False, of_class=False)
    text = sys.stderr if options.json else sys.stdout
    header = [HEADER]

    def show(line: dict[str, Any]) -> None:
        while header:
            print(header.pop(), file=text)
        print(cycle_line(line), file=text, flush=True)

    try:
        content = grade(source, config, on_cycle=show).content
    except BadInput:
        if is_new:
            out.rmdir()
        raise
    write_grade(out, content)
    print(f"\n{grade_text(content)}\nresults        {out / PAGES[0]}", file=text)
    if options.json:
        print(json.dumps(content, indent=2, allow_nan=False))
    return EXIT_PASSED if content["passed"] else EXIT_GATE


def _class(paths: list[Path], config: Any, options: argparse.Namespace) -> int:
    from kr210_sim.grading.class_list import (
        PAGES,
        find_items,
        grade_class,
        open_folder,
        write_class,
    )
    from kr210_sim.grading.page import grade_command
    from kr210_sim.grading.report import CLASS_HEADER, class_line, class_row

    for option, given in (("--debug-cases", options.debug_cases), ("--step", options.step)):
        if given is not None:
            raise BadInput(f"{option}: is for one solver at a time")
    out = _out(options)
    items = find_items(paths, out)
    command = f"{grade_command(options.solver, config.as_json())} {_going_on(out, options.jobs)}"
    open_folder(out, resume=options.resume)
    text = sys.stderr if options.json else sys.stdout
    done: list[dict[str, Any]] = []
    print(f"       {CLASS_HEADER}", file=text, flush=True)

    def show(content: dict[str, Any]) -> None:
        done.append(content)
        count = f"{len(done)}/{len(items)}"
        print(f"{count:>6} {class_line(content)}", file=text, flush=True)
        write_class(
            out, sorted(done, key=lambda item: item["name"]), total=len(items), command=command
        )

    try:
        contents = grade_class(items, config, jobs=options.jobs, on_grade=show)
    except KeyboardInterrupt as error:
        raise Interrupted(
            f"interrupted; {len(done)} of {len(items)} solvers are graded in {out}; "
            f"--out {shlex.quote(str(out))} --resume goes on"
        ) from error
    passed = sum(bool(content["passed"]) for content in contents)
    print(
        f"\n{passed} of {len(contents)} solvers passed\nresults        {out / PAGES[1]}", file=text
    )
    if options.json:
        rows = [class_row(content) for content in contents]
        print(json.dumps(rows, indent=2, allow_nan=False))
    return EXIT_PASSED if passed == len(contents) else EXIT_GATE


def _going_on(out: Path, jobs: int) -> str:
    """Return the options of the command that goes on with a class."""
    return shlex.join([*(["--jobs", str(jobs)] if jobs > 1 else []), "--out", str(out), "--resume"])


def _out(options: argparse.Namespace) -> Path:
    if options.out is not None:
        return Path(options.out)
    stamp, number = time.strftime("%Y%m%d-%H%M%S"), 2
    out = Path("runs") / f"{stamp}-grade"
    while out.exists():
        out, number = Path("runs") / f"{stamp}-grade-{number}", number + 1
    return out
