"""The verb `ik`: solve one pose."""

from __future__ import annotations

import argparse
import json
from typing import Any

from kr210_sim.verbs.common import EXIT_PASSED, ROBOT_OPTIONS, add_option, robot_of

BRANCHES = (
    "A branch is named by shoulder, elbow and wrist. front: axis 1 turns the arm towards the wrist "
    "center; back: away from it, and the arm reaches over its back. up, down: theta 3 is above or "
    "below that of the stretched arm; in front, so is the elbow above or below the straight line "
    "from axis 2 to the wrist center. + and -: the sign of theta 5. inside, BEYOND: the limits of "
    "the joints, whole turns tried."
)


def add(verbs: Any) -> None:
    """Add `ik` to the verbs."""
    parser = verbs.add_parser(
        "ik",
        help="solve one pose: every branch with limits, residual and singularities",
        description="Solve one pose of the palm (the bundled robot's gripper_link) in the base "
        "frame, and list all eight branches.",
        epilog=BRANCHES,
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
        add_option(parser, name)
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
    report = solve_report(robot_of(options), T_base_palm)
    print(json.dumps(report, indent=2, allow_nan=False) if options.json else solve_text(report))
    return EXIT_PASSED
