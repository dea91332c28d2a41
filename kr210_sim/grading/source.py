"""Where a solver of somebody else is, and how long and large it may be."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

from kr210_sim.exceptions import BadInput

FRAMES = ("gripper_link", "link_6")
"""Frames whose poses a solver may be sent."""

SCOPES = ("course", "all")
"""Where it is asked: the two planned legs, or the straight lines as well."""

_MEBIBYTE = 1 << 20
_LARGEST_FILE = 4 * _MEBIBYTE


@dataclass(frozen=True, kw_only=True)
class SolverSource:
    """A function in a file or a module.

    Attributes:
        file: path of a Python file, or None.
        module: name of a module, or None.
        function: in it; None for what the file offers as a service, or `handle_calculate_IK`.
    """

    file: Path | None = None
    module: str | None = None
    function: str | None = None

    @property
    def name(self) -> str:
        """What a reader calls it."""
        return self.file.name if self.file is not None else str(self.module)

    @property
    def text(self) -> str:
        """What names it on a command line, from the folder where we are."""
        if self.file is None:
            where = str(self.module)
        elif self.file.is_relative_to(Path.cwd()):
            where = str(self.file.relative_to(Path.cwd()))
        else:
            where = str(self.file)
        return f"{where}:{self.function}" if self.function else where

    @classmethod
    def from_file(cls, path: Path, function: str | None = None) -> SolverSource:
        """Return the source for a file that exists.

        Raises:
            BadInput: naming the file.
        """
        try:
            size = path.stat().st_size
            with path.open("rb") as file:
                file.read(1)
        except OSError as error:
            raise BadInput(f"{path} cannot be read ({error.strerror}); name a .py file") from error
        if size > _LARGEST_FILE:
            raise BadInput(f"{path} has {size / _MEBIBYTE:.0f} MB; a solver has 4 MB at most")
        return cls(file=path.absolute(), function=function)

    @classmethod
    def parse(cls, text: str, *others: str) -> SolverSource:
        """Read FILE.py:FUNC or MODULE:FUNC.

        Args:
            text: what was given.
            others: what may be given as well, for the error.

        Raises:
            BadInput: naming the remedy.
        """
        where, colon, function = text.rpartition(":")
        names = function.split(".")
        if not colon or not where or not all(name.isidentifier() for name in names):
            if text.endswith(".py"):
                raise BadInput(f"'{text:.80}' needs its function: give it as FILE.py:FUNC")
            known = ", ".join((*others, "FILE.py:FUNC"))
            raise BadInput(f"no solver '{text:.80}'; give {known} or MODULE:FUNC")
        if where.endswith(".py") or "/" in where:
            return cls.from_file(Path(where), function)
        if not all(name.isidentifier() for name in where.split(".")):
            raise BadInput(f"'{where:.80}' is neither a .py file nor the name of a module")
        return cls(module=where, function=function)


@dataclass(frozen=True, kw_only=True)
class SolverLimits:
    """What a solver may use.

    Attributes:
        pose_timeout: longest time for one pose [s]; a list of n poses may take n times as long.
        time_limit: longest time for loading and all answers together [s].
        memory: [bytes].
        file_size: of the largest file it may write [bytes].
        scratch_size: of all its files together [bytes].
    """

    pose_timeout: float = 30.0
    time_limit: float = 900.0
    memory: int = 2048 * _MEBIBYTE
    file_size: int = 16 * _MEBIBYTE
    scratch_size: int = 128 * _MEBIBYTE

    def __post_init__(self) -> None:
        """Check the times.

        Raises:
            BadInput: naming the option and the remedy.
        """
        for option, value in (
            ("--pose-timeout", self.pose_timeout),
            ("--time-limit", self.time_limit),
        ):
            if not (math.isfinite(value) and 0 < value <= 1e6):
                raise BadInput(f"{option}: {value} is no time; give a number of s above 0")
