"""The command line: the one place that parses options, prints, and turns errors into exit codes."""

from __future__ import annotations

import argparse
import io
import json
import os
import re
import sys
import traceback
from collections.abc import Sequence
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Any, NoReturn

from kr210_sim import __version__
from kr210_sim.config import RunConfig
from kr210_sim.exceptions import BadInput, NotWritten
from kr210_sim.interrupts import one_interrupt
from kr210_sim.junit import write_junit
from kr210_sim.options import read_options
from kr210_sim.progress import ProgressBar
from kr210_sim.source import RobotSource

if TYPE_CHECKING:
    from kr210_sim.robot import Robot

ROBOT_OPTIONS = (
    "robot",
    "package",
    "xacro_arg",
    "gripper",
    "base",
    "tip",
    "joints",
    "fingers",
)
"""The options that say what the robot is, common to all verbs that read one."""

EXIT_PASSED, EXIT_GATE, EXIT_BAD_INPUT, EXIT_INTERNAL, EXIT_INTERRUPTED = 0, 1, 2, 3, 130


class _Parser(argparse.ArgumentParser):
    """Argument errors in one line, with exit status 2."""

    def __init__(self, **options: Any) -> None:
        super().__init__(**options)
        # argparse of Python below 3.14 takes -1e-3 for an option
        self._negative_number_matcher = re.compile(r"-(\d+\.?\d*|\.\d+)(e[-+]?\d+)?$", re.I)

    def error(self, message: str) -> NoReturn:
        raise BadInput(message.replace("argument ", "", 1))


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command line; returns the exit status."""
    _mend_streams()
    try:
        options = _parser().parse_args(argv)
        return int(options.verb(options))
    except BadInput as error:
        print(f"kr210-sim: {_one_line(str(error))}", file=sys.stderr)
        return EXIT_BAD_INPUT
    except KeyboardInterrupt as error:
        print(f"kr210-sim: {error or 'interrupted'}", file=sys.stderr)
        return EXIT_INTERRUPTED
    except BrokenPipeError:  # the reader of our output has gone, e.g. `| head`
        sys.stdout = open(os.devnull, "w")
        return EXIT_INTERNAL
    except NotWritten as error:
        print(f"kr210-sim: {error}", file=sys.stderr)
        return EXIT_INTERNAL
    except OSError as error:
        print(f"kr210-sim: {error}; what is finished is kept", file=sys.stderr)
        return EXIT_INTERNAL
    except Exception:
        traceback.print_exc()
        print("kr210-sim: internal error, please report the lines above", file=sys.stderr)
        return EXIT_INTERNAL


def _one_line(message: str) -> str:
    """Return a message as one line; what quotes an endless name is cut in the middle."""
    line = " ".join(message.split())
    return line if len(line) <= 600 else f"{line[:250]} ... {line[-250:]}"


def _mend_streams() -> None:
    """Let output go nowhere if a stream is closed, and escape what its encoding does not have."""
    for name in ("stdout", "stderr"):
        if getattr(sys, name) is None:
            setattr(sys, name, open(os.devnull, "w", encoding="utf-8"))
        elif isinstance(stream := getattr(sys, name), io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")


def _parser() -> argparse.ArgumentParser:
    parser = _Parser(prog="kr210-sim", description="KUKA KR210 pick and place in MuJoCo, scored.")
    _add_version(parser)
    verbs = parser.add_subparsers(metavar="VERB", required=True)
    _add_run(verbs)
    _add_ik(verbs)
    _add_dh(verbs)
    _add_convert(verbs)
    _add_compare(verbs)
    return parser


def _add_version(parser: argparse.ArgumentParser) -> None:
    versions = f"kr210-sim {__version__}, MuJoCo {version('mujoco')}, ruckig {version('ruckig')}"
    parser.add_argument("--version", action="version", version=versions)


def _add_run(verbs: Any) -> None:
    parser = verbs.add_parser(
        "run",
        help="run and score pick-and-place cycles",
        description="Run and score pick-and-place cycles. Exit status: 0 all gates met, 1 one not "
        "met, 2 bad input, 3 internal error or full disk, 130 interrupted.",
        allow_abbrev=False,
    )
    _add_version(parser)
    for name in RunConfig.metadata():
        _add_option(parser, name, only_given=True)
    parser.add_argument(
        "--config", type=Path, metavar="FILE", help="options in JSON or TOML; those given here win"
    )
    parser.add_argument(
        "--list-scenes", action="store_true", help="list the bundled scenes and exit"
    )
    parser.set_defaults(verb=_run)


def _add_option(parser: argparse.ArgumentParser, name: str, *, only_given: bool = False) -> None:
    """Add an option as RunConfig describes it.

    Args:
        parser: of the verb.
        name: of the field.
        only_given: leave no attribute where the option is not given.
    """
    default, metadata = RunConfig.metadata()[name]
    option, text, kind = "--" + name.replace("_", "-"), metadata["help"], metadata["kind"]
    absent = argparse.SUPPRESS if only_given else default
    shown = f" (default: {default})" if default not in (None, False, ()) else ""
    if kind is bool:
        parser.add_argument(option, action="store_true", default=absent, help=text)
        return
    more: dict[str, Any] = {"metavar": metadata["metavar"], "default": absent, "help": text + shown}
    if kind is tuple:
        more["default"] = argparse.SUPPRESS if only_given else []
        parser.add_argument(option, action="append", **more)
    elif name == "video":
        parser.add_argument(option, nargs="?", const="", **more)
    else:
        parser.add_argument(option, type=_whole if kind is int else kind, **more)


def _whole(text: str) -> int:
    try:
        return int(text)
    except ValueError as error:
        raise argparse.ArgumentTypeError(
            f"'{text:.24}' is no whole number, or far too large"
        ) from error


def _source(options: argparse.Namespace) -> RobotSource:
    return RobotSource.from_options(**{name: getattr(options, name) for name in ROBOT_OPTIONS})


def _run(options: argparse.Namespace) -> int:
    if options.list_scenes:
        from kr210_sim.scene import list_scenes

        print("\n".join(list_scenes()))
        return EXIT_PASSED
    given = {name: getattr(options, name) for name in RunConfig.metadata() if name in options}
    config = RunConfig(**((read_options(options.config) if options.config else {}) | given))
    film = _film(config)
    _check_junit(config)
    from kr210_sim.results import read_lines
    from kr210_sim.runner import run
    from kr210_sim.summary import HEADER, cycle_line, summary_text

    text = sys.stderr if config.json else sys.stdout
    bar = ProgressBar(config.cycles, sys.stderr)
    header = [HEADER]

    def report(line: dict[str, Any]) -> None:
        bar.clear()
        while header:
            print(header.pop(), file=text)
        print(cycle_line(line), file=text, flush=True)
        bar.show(line["cycle"])

    with one_interrupt():
        try:
            out, summary = run(config, on_cycle=report)
        finally:
            bar.clear()
        if config.junit is not None:
            write_junit(config.junit, read_lines(out), summary, name=f"seed {config.seed}")
        print(f"\n{summary_text(summary)}", file=text)
        print(f"results        {out}", file=text, flush=True)
        if config.json:
            print(json.dumps(summary, indent=2, allow_nan=False), flush=True)
        if film is not None:
            target = Path(config.video or out / "film.mp4")
            film(out, target)
            print(f"film           {target}", file=text)
    return EXIT_PASSED if summary["passed"] else EXIT_GATE


def _check_junit(config: RunConfig) -> None:
    """Refuse a place where no file can be written, before anybody waits for cycles."""
    path = config.junit
    if path is None or path.parent == config.out:
        return
    if path.is_dir() or not path.parent.is_dir():
        raise BadInput(f"--junit: {path} must be a file in a folder that exists")


def _film(config: RunConfig) -> Any:
    """Return the function that films a run, or None if no film is asked for.

    Checked before the run, so that nobody waits for cycles that cannot be filmed.
    """
    if config.video is None:
        return None
    from kr210_sim.video import film_run, find_gl

    target = Path(config.video) if config.video else None
    if target is not None and (
        target.suffix != ".mp4" or not os.path.isdir(target.parent) or len(target.name) > 200
    ):
        raise BadInput(f"--video: {target} must be a .mp4 in a folder that exists")
    backend = find_gl()
    return lambda out, path: film_run(out, path, backend=backend)


def _add_ik(verbs: Any) -> None:
    parser = verbs.add_parser(
        "ik",
        help="solve one pose: every branch with limits, residual and singularities",
        description="Solve one pose of the palm (the bundled robot's gripper_link) in the base "
        "frame, and list all eight branches.",
        allow_abbrev=False,
    )
    parser.add_argument("--position", nargs=3, type=float, metavar=("X", "Y", "Z"), help="[m]")
    parser.add_argument(
        "--quaternion", nargs=4, type=float, metavar=("X", "Y", "Z", "W"), help="normalised here"
    )
    parser.add_argument(
        "--rpy", nargs=3, type=float, metavar=("R", "P", "Y"), help="about fixed x, y, z [rad]"
    )
    parser.add_argument("--pose", metavar="JSON", help="T_base_palm as a 4 x 4 list, or a file")
    for name in ROBOT_OPTIONS:
        _add_option(parser, name)
    parser.add_argument("--json", action="store_true", help="print JSON")
    parser.set_defaults(verb=_ik)


def _ik(options: argparse.Namespace) -> int:
    from kr210_sim.kinematics import read_pose, solve_report, solve_text

    T_base_palm = read_pose(
        position=options.position,
        quaternion=options.quaternion,
        rpy=options.rpy,
        pose=options.pose,
    )
    report = solve_report(_robot(options), T_base_palm)
    print(json.dumps(report, indent=2, allow_nan=False) if options.json else solve_text(report))
    return EXIT_PASSED


def _add_dh(verbs: Any) -> None:
    parser = verbs.add_parser(
        "dh",
        help="derive joint table and modified DH table of a robot",
        description="Print the joint table of a robot, the modified DH table derived from it, and "
        "each transform.",
        allow_abbrev=False,
    )
    parser.add_argument("robot", nargs="?", type=Path, help="default: the bundled KR210")
    for name in ROBOT_OPTIONS[1:]:
        _add_option(parser, name)
    parser.add_argument("--symbolic", action="store_true", help="transforms as formulas (sympy)")
    parser.add_argument("--json", action="store_true", help="print JSON")
    parser.set_defaults(verb=_dh)


def _dh(options: argparse.Namespace) -> int:
    from kr210_sim.kinematics import dh_report, dh_symbols, dh_text

    robot = _robot(options)
    if options.symbolic:
        print(dh_symbols(robot))
        return EXIT_PASSED
    report = dh_report(robot)
    print(json.dumps(report, indent=2, allow_nan=False) if options.json else dh_text(report))
    return EXIT_PASSED


def _add_convert(verbs: Any) -> None:
    parser = verbs.add_parser(
        "convert",
        help="write a robot as a folder of MJCF",
        description="Write a robot, or a scene with it, as a self-contained folder of MJCF, and "
        "report everything that was changed or guessed. Exit status: 0 written (and parity holds, "
        "with --check), 1 parity fails, 2 bad input.",
        allow_abbrev=False,
    )
    parser.add_argument("robot", type=Path, metavar="ROBOT", help="a .xacro or .urdf")
    parser.add_argument("-o", "--out", type=Path, required=True, metavar="DIR", help="new folder")
    parser.add_argument("--scene", metavar="NAME|PATH", help="write the scene with the robot, too")
    parser.add_argument(
        "--check", action="store_true", help="compare every link with the description"
    )
    for name in ROBOT_OPTIONS[1:]:
        _add_option(parser, name)
    parser.set_defaults(verb=_convert)


def _convert(options: argparse.Namespace) -> int:
    from kr210_sim.convert import conversion_text, convert

    done = convert(_source(options), options.out, scene=options.scene, check=options.check)
    print(conversion_text(done))
    return EXIT_PASSED if done.passed else EXIT_GATE


def _add_compare(verbs: Any) -> None:
    parser = verbs.add_parser(
        "compare",
        help="compare two runs and tell whether the second is a regression",
        description="Compare run B with run A. Cycles of the same seed are paired: exact McNemar "
        "test for success, Wilcoxon signed-rank test for the rest; without common seeds Fisher's "
        "and Mann-Whitney's. A regression is worse with p < 0.05 and, success apart, by more than "
        "1 % of a simulated figure or 100 % of a wall-clock one. Exit status: 0 no regression, 1 "
        "regression, 2 bad input.",
        allow_abbrev=False,
    )
    for name in ("A", "B"):
        parser.add_argument(
            f"run_{name.lower()}",
            type=Path,
            metavar=f"RUN_{name}",
            help="a run's folder, or its summary.json or cycles.jsonl",
        )
    parser.add_argument("--json", action="store_true", help="print JSON")
    parser.set_defaults(verb=_compare)


def _compare(options: argparse.Namespace) -> int:
    from kr210_sim.compare import compare_runs, comparison_text

    report = compare_runs(options.run_a, options.run_b)
    print(
        json.dumps(report, indent=2, allow_nan=False) if options.json else comparison_text(report)
    )
    return EXIT_GATE if report["regressions"] else EXIT_PASSED


def _robot(options: argparse.Namespace) -> Robot:
    """Read the robot of an option; what was changed or guessed on the way goes to stderr."""
    from kr210_sim.loading import read_robot

    description, robot = read_robot(_source(options))
    _warn((*description.notes, *robot.notes))
    return robot


def _warn(notes: Sequence[str]) -> None:
    for note in notes:
        print(f"kr210-sim: note: {note}", file=sys.stderr)
