"""The verb `view`: look at a robot or a scene."""

from __future__ import annotations

import argparse
from typing import Any

from kr210_sim.verbs.common import EXIT_PASSED, ROBOT_OPTIONS, add_option, source_of, warn, whole
from kr210_sim.verbs.showing import opened_page, until_interrupted
from kr210_sim.viewers.address import HOST, PORT, check_address


def add(verbs: Any) -> None:
    """Add `view` to the verbs."""
    parser = verbs.add_parser(
        "view",
        help="look at a robot or a scene in a browser",
        description="Show a robot or a scene on a page in the browser: joint sliders, the frames "
        "of links and DH table, forward kinematics, and all eight branches of the inverse "
        "kinematics as ghosts. Ctrl-C ends it.",
        allow_abbrev=False,
    )
    parser.add_argument(
        "what",
        nargs="?",
        metavar="ROBOT|SCENE",
        help="a .xacro or .urdf, or a scene by name or path; default: the bundled KR210",
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
