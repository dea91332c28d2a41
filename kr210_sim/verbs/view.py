"""The verb `view`: look at a robot, a scene or a recorded cycle, or prove a record."""

from __future__ import annotations

import argparse
import os
import sys
from pathlib import Path
from typing import Any

from kr210_sim.exceptions import BadInput
from kr210_sim.verbs.common import (
    EXIT_GATE,
    EXIT_PASSED,
    ROBOT_OPTIONS,
    add_option,
    source_of,
    warn,
    whole,
)
from kr210_sim.verbs.showing import opened_page, until_interrupted
from kr210_sim.viewers.address import HOST, PORT, VIEWERS, check_address
from kr210_sim.viewers.pace import check_speed


def add(verbs: Any) -> None:
    """Add `view` to the verbs."""
    parser = verbs.add_parser(
        "view",
        help="look at a robot, a scene or a recorded cycle; --verify simulates it again",
        description="Show a robot or a scene on a page in the browser: joint sliders, the frames "
        "of links and DH table, forward kinematics, and all eight branches of the inverse "
        "kinematics as ghosts. Of a run, show a recorded cycle; with --verify, simulate its "
        "episode again and compare the bits: exit status 0 if they are the same, 1 if not. Ctrl-C "
        "ends it.",
        allow_abbrev=False,
    )
    parser.add_argument(
        "what",
        nargs="?",
        metavar="ROBOT|SCENE|RUN",
        help="a .xacro or .urdf, a scene by name or path, or the folder of a run; default: the "
        "bundled KR210",
    )
    parser.add_argument("--cycle", type=whole, metavar="N", help="of a run; default: the first")
    parser.add_argument("--verify", action="store_true", help="simulate the episode again")
    parser.add_argument(
        "--viewer", choices=VIEWERS, default=VIEWERS[0], help=f"default: {VIEWERS[0]}"
    )
    parser.add_argument(
        "--speed", type=float, default=1.0, metavar="F", help="recorded over real time (default: 1)"
    )
    parser.add_argument(
        "--host", default=HOST, help=f"address to listen on (default: {HOST}, this machine only)"
    )
    parser.add_argument(
        "--port", type=whole, default=PORT, metavar="N", help=f"to listen on (default: {PORT})"
    )
    for name in ROBOT_OPTIONS:
        add_option(parser, name)
    parser.set_defaults(verb=_view)


def _view(options: argparse.Namespace) -> int:
    out = None if options.what is None or not os.path.isdir(options.what) else Path(options.what)
    if out is None:
        _check_of_a_run(options)
        return _view_arm(options)
    if options.verify:
        return _verify(out, options.cycle)
    check_speed("--speed", options.speed)
    if options.viewer == "native":
        return _replay_native(out, options)
    return _replay_on_a_page(out, options)


def _check_of_a_run(options: argparse.Namespace) -> None:
    """Refuse what only the folder of a run can be asked for."""
    asked = {"--cycle": options.cycle is not None, "--verify": options.verify}
    for option in (name for name, given in asked.items() if given):
        raise BadInput(f"{option}: of which run? give its folder: view RUN {option}")
    if options.viewer == "native":
        raise BadInput("--viewer native: shows cycles of a run only; robots and scenes are web")


def _view_arm(options: argparse.Namespace) -> int:
    check_address(options.host, options.port)
    from kr210_sim.viewers.page import load_viser

    load_viser()
    from kr210_sim.viewers.arm_page import ArmPage
    from kr210_sim.viewers.subject import load_subject

    subject = load_subject(options.what, source_of(options))
    warn(subject.notes)
    with opened_page(options.host, options.port, subject.title) as page:
        ArmPage(page, subject)
        until_interrupted(page.wait)
    return EXIT_PASSED


def _replay_on_a_page(out: Path, options: argparse.Namespace) -> int:
    check_address(options.host, options.port)
    from kr210_sim.viewers.cycle_page import ReplayPage
    from kr210_sim.viewers.pace import Pace
    from kr210_sim.viewers.replay import Player, load_replay

    replay = load_replay(out, options.cycle)
    pace = Pace(options.speed)
    title = f"{out.name}, cycle {replay.take.cycle}"
    with opened_page(options.host, options.port, title) as page:
        screen = ReplayPage(page, pace, replay.take.duration, lambda at: player.seek(at))
        player = Player(replay, screen, pace)
        until_interrupted(player.play)
    return EXIT_PASSED


def _replay_native(out: Path, options: argparse.Namespace) -> int:
    from kr210_sim.viewers.native import KEYS, SEEK_KEYS, NativeScreen, check_display
    from kr210_sim.viewers.pace import Pace
    from kr210_sim.viewers.replay import Player, load_replay

    replay = load_replay(out, options.cycle)
    check_display()
    print(f"kr210-sim: {KEYS}, {SEEK_KEYS}", file=sys.stderr, flush=True)
    pace = Pace(options.speed)
    screen = NativeScreen(pace, lambda at: player.seek(at))
    player = Player(replay, screen, pace)
    try:
        until_interrupted(player.play)
    finally:
        screen.close()
    return EXIT_PASSED


def _verify(out: Path, cycle: int | None) -> int:
    from kr210_sim.verify import verify

    verdict = verify(out, cycle)
    print(verdict.text())
    return EXIT_PASSED if verdict.same else EXIT_GATE
