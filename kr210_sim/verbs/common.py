"""What several verbs share: exit statuses, options described by RunConfig, the robot."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from kr210_sim import __version__
from kr210_sim.config import RunConfig
from kr210_sim.film.format import Format
from kr210_sim.progress import ProgressBar
from kr210_sim.source import RobotSource

if TYPE_CHECKING:
    from kr210_sim.robot import Robot

EXIT_PASSED, EXIT_GATE, EXIT_BAD_INPUT, EXIT_INTERNAL, EXIT_INTERRUPTED = 0, 1, 2, 3, 130

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


class _Versions(argparse.Action):
    """Print ours, MuJoCo's and ruckig's, looked up when they are asked for."""

    def __call__(self, parser: argparse.ArgumentParser, *_given: Any) -> None:
        from importlib.metadata import version

        print(f"kr210-sim {__version__}, MuJoCo {version('mujoco')}, ruckig {version('ruckig')}")
        parser.exit()


def add_version(parser: argparse.ArgumentParser) -> None:
    """Add `--version`: ours, MuJoCo's and ruckig's."""
    parser.add_argument(
        "--version", action=_Versions, nargs=0, help="show program's version number and exit"
    )


def add_option(parser: argparse.ArgumentParser, name: str, *, only_given: bool = False) -> None:
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
        parser.add_argument(option, type=whole if kind is int else kind, **more)


def whole(text: str) -> int:
    """Read a whole number; argparse turns the error into one line."""
    try:
        return int(text)
    except ValueError as error:
        raise argparse.ArgumentTypeError(
            f"'{text:.24}' is no whole number, or far too large"
        ) from error


def source_of(options: argparse.Namespace) -> RobotSource:
    """Return where the robot of some options comes from."""
    return RobotSource.from_options(**{name: getattr(options, name) for name in ROBOT_OPTIONS})


def robot_of(options: argparse.Namespace) -> Robot:
    """Read the robot of an option; what was changed or guessed on the way goes to stderr."""
    from kr210_sim.loading import read_robot

    description, robot = read_robot(source_of(options))
    warn((*description.notes, *robot.notes))
    return robot


def film_with_bar(
    out: Path, film: Path, form: Format, *, backend: str, cycle: int | None = None
) -> None:
    """Film a run, or one cycle of it, showing on a terminal how far it is."""
    from kr210_sim.video import film_run, moments_of

    moments = moments_of(out, form, cycle)
    bar = ProgressBar(len(moments), sys.stderr, unit="frames")
    try:
        film_run(
            out, film, form, backend=backend, moments=moments,
            on_frame=lambda index, _total: bar.show(index),
        )  # fmt: skip
    finally:
        bar.clear()


def warn(notes: Sequence[str]) -> None:
    """Print notes to stderr, a line each."""
    for note in notes:
        print(f"kr210-sim: note: {note}", file=sys.stderr)
