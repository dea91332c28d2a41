"""The verb `run`: simulate and score cycles."""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

from kr210_sim.config import RunConfig
from kr210_sim.exceptions import BadInput
from kr210_sim.failures import show_again
from kr210_sim.film.format import FILM, check_cameras
from kr210_sim.interrupts import one_interrupt
from kr210_sim.options import read_options
from kr210_sim.progress import ProgressBar
from kr210_sim.verbs.common import (
    EXIT_GATE,
    EXIT_PASSED,
    add_option,
    add_version,
    film_with_bar,
)
from kr210_sim.verbs.report import report_on
from kr210_sim.verbs.showing import watching


def add(verbs: Any) -> None:
    """Add `run` to the verbs."""
    parser = verbs.add_parser(
        "run",
        help="run and score pick-and-place cycles",
        description="Run and score pick-and-place cycles. Exit status: 0 all gates met, 1 one not "
        "met, 2 bad input, 3 internal error or full disk, 130 interrupted.",
        allow_abbrev=False,
    )
    add_version(parser)
    for name in RunConfig.metadata():
        add_option(parser, name, only_given=True)
    parser.add_argument(
        "--config", type=Path, metavar="FILE", help="options in JSON or TOML; those given here win"
    )
    parser.add_argument(
        "--list-scenes", action="store_true", help="list the bundled scenes and exit"
    )
    parser.set_defaults(verb=_run)


def _run(options: argparse.Namespace) -> int:
    if options.list_scenes:
        from kr210_sim.scene import list_scenes

        print("\n".join(list_scenes()))
        return EXIT_PASSED
    given = {name: getattr(options, name) for name in RunConfig.metadata() if name in options}
    config = RunConfig(**((read_options(options.config) if options.config else {}) | given))
    film = _film(config)
    _check_junit(config)
    from kr210_sim.junit import write_junit
    from kr210_sim.results import read_lines
    from kr210_sim.runner import absolute, run
    from kr210_sim.summary import HEADER, cycle_line, exit_text, summary_text

    text = sys.stderr if config.json else sys.stdout
    only = config.only_cycle
    bar = ProgressBar(config.cycles if only is None else only + 1, sys.stderr)
    header = [HEADER]

    def report(line: dict[str, Any]) -> None:
        bar.clear()
        if watcher is not None:
            watcher.tell(line)
        while header:
            print(header.pop(), file=text)
        print(cycle_line(line), file=text, flush=True)
        bar.show(line["cycle"])

    with one_interrupt():
        with watching(config) as watcher:
            try:
                out, summary = run(config, on_cycle=report, onlooker=watcher)
            finally:
                bar.clear()
        if config.junit is not None:
            command = partial(show_again, absolute(config))
            name = f"seed {config.seed}"
            write_junit(config.junit, read_lines(out), summary, name=name, command=command)
        print(f"\n{summary_text(summary)}", file=text)
        print(f"results        {out}", file=text, flush=True)
        if config.json:
            print(json.dumps(summary, indent=2, allow_nan=False), flush=True)
        if film is not None:
            print(f"film           {film(out) or 'none: no cycle has a record'}", file=text)
        if config.report:
            print(f"report         {report_on(out)}", file=text)
        print(exit_text(summary), file=text, flush=True)
    return EXIT_PASSED if summary["passed"] else EXIT_GATE


def _check_junit(config: RunConfig) -> None:
    """Refuse a place where no file can be written, before anybody waits for cycles."""
    path = config.junit
    if path is None:
        return
    known = path.parent == config.out or path.parent.is_dir()
    if path == config.out or path.is_dir() or not known:
        raise BadInput(f"--junit: {path} must be a file in a folder that exists")


def _film(config: RunConfig) -> Callable[[Path], Path | None] | None:
    """Return the function that films a run and names the film, or None if none is asked for.

    Checked before the run, so that nobody waits for cycles that cannot be filmed.
    """
    if config.video is None:
        return None
    from kr210_sim.results import RECORDS
    from kr210_sim.scene import find_scene
    from kr210_sim.video import check_target, find_gl, scene_cameras

    form = config.film()
    if config.video:
        check_target(Path(config.video), "--video")
    elif config.out is not None:
        check_target(config.out / FILM, "--video", in_run=True)
    check_cameras(form.cameras, scene_cameras(find_scene(config.scene)), "--camera")
    backend = find_gl("--video")

    def film(out: Path) -> Path | None:
        if not any((out / RECORDS).iterdir()):  # of --record failed, if none did
            return None
        target = Path(config.video or out / FILM)
        film_with_bar(out, target, form, backend=backend)
        return target

    return film
