"""The verb `convert`: write a robot as a folder of MJCF."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from kr210_sim.verbs.common import EXIT_GATE, EXIT_PASSED, ROBOT_OPTIONS, add_option, source_of


def add(verbs: Any) -> None:
    """Add `convert` to the verbs."""
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
        add_option(parser, name)
    parser.set_defaults(verb=_convert)


def _convert(options: argparse.Namespace) -> int:
    from kr210_sim.convert import conversion_text, convert

    done = convert(source_of(options), options.out, scene=options.scene, check=options.check)
    print(conversion_text(done))
    return EXIT_PASSED if done.passed else EXIT_GATE
