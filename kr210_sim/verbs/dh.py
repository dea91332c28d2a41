"""The verb `dh`: derive the joint and DH tables of a robot."""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import Any

from kr210_sim.exceptions import BadInput
from kr210_sim.verbs.common import EXIT_PASSED, ROBOT_OPTIONS, add_option, robot_of


def add(verbs: Any) -> None:
    """Add `dh` to the verbs."""
    parser = verbs.add_parser(
        "dh",
        help="derive joint table and modified DH table of a robot",
        description="Print the joint table of a robot, the modified DH table derived from it, and "
        "each transform.",
        allow_abbrev=False,
    )
    parser.add_argument("robot", nargs="?", type=Path, help="default: the bundled KR210")
    for name in ROBOT_OPTIONS[1:]:
        add_option(parser, name)
    parser.add_argument("--symbolic", action="store_true", help="transforms as formulas (sympy)")
    parser.add_argument("--json", action="store_true", help="print JSON")
    parser.set_defaults(verb=_dh)


def _dh(options: argparse.Namespace) -> int:
    if options.symbolic and options.json:
        raise BadInput("--json: --symbolic prints formulas alone; leave one of them out")
    from kr210_sim.kinematics import dh_report, dh_symbols, dh_text

    robot = robot_of(options)
    if options.symbolic:
        print(dh_symbols(robot))
        return EXIT_PASSED
    report = dh_report(robot)
    print(json.dumps(report, indent=2, allow_nan=False) if options.json else dh_text(report))
    return EXIT_PASSED
