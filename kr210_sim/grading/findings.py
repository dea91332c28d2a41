"""Findings: what is wrong with a solver, one clause each, with the line of its source."""

from __future__ import annotations

import traceback
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

KINDS = (
    "not_found", "syntax", "import", "raised", "exit", "form", "shape", "none", "complex", "nan",
    "not_a_number", "infinite", "timeout", "died", "memory", "changed", "not_tried",
)  # fmt: skip
"""All kinds of findings."""

_OF_GRADE = ("sympy", "mpmath")
"""Packages of solvers that come with our extra `grade`."""


@dataclass(frozen=True, kw_only=True)
class Finding:
    """Something that is wrong with a solver.

    Attributes:
        kind: one of KINDS.
        detail: one clause for the reader.
        line: of the solver's source; None where none can be told.
        source: that line of text.
        pose: index of the pose in the request that it concerns, or None.
    """

    kind: str
    detail: str
    line: int | None = None
    source: str | None = None
    pose: int | None = None

    def text(self, name: str) -> str:
        """Return one sentence, with the place in the file of that name."""
        where = f"{name}, line {self.line}: " if self.line else ""
        shown = f" | {self.source.strip()}" if self.source else ""
        return f"{where}{self.detail}{shown}"

    def as_json(self) -> dict[str, Any]:
        """Return it as plain JSON values."""
        return asdict(self)

    @classmethod
    def from_json(cls, content: Any) -> Finding:
        """Return a finding from what a process that is not trusted says it is."""
        content = content if isinstance(content, dict) else {}
        kind, line, pose = content.get("kind"), content.get("line"), content.get("pose")
        return cls(
            kind=kind if kind in KINDS else "died",
            detail=_short(content.get("detail", "it says nothing more")),
            line=line if isinstance(line, int) else None,
            source=_short(source) if isinstance(source := content.get("source"), str) else None,
            pose=pose if isinstance(pose, int) else None,
        )


class Refused(Exception):
    """A solver cannot go on for a reason that is a finding."""

    def __init__(self, finding: Finding) -> None:
        super().__init__(finding.detail)
        self.finding = finding


class Source:
    """The text of a solver, to find lines in.

    Args:
        path: under which its code is compiled.
        text: as the user has it.
    """

    def __init__(self, path: Path, text: str) -> None:
        self.path, self._lines = str(path), text.split("\n")  # as Python counts lines, no more

    def line(self, number: int | None) -> str | None:
        """Return a line by its number, counting from 1."""
        if number is None or not 1 <= number <= len(self._lines):
            return None
        return self._lines[number - 1]

    def raised(self, error: BaseException, *, pose: int | None = None) -> Finding:
        """Return the finding for what the solver's code raised."""
        lines = [
            frame.lineno
            for frame in traceback.extract_tb(error.__traceback__, limit=-1000)
            if frame.filename == self.path
        ]
        number = lines[-1] if lines else None
        kind, what = "raised", f"raised {type(error).__name__}: {_text(error)}"
        remedy = ""
        if isinstance(error, SyntaxError):
            kind, what = "syntax", f"{type(error).__name__}: {_text(error.msg)}"
            number = error.lineno if error.filename == self.path else number
        elif isinstance(error, SystemExit):
            kind, what = "exit", f"ended the program by sys.exit({_short(error.code)})"
        elif isinstance(error, MemoryError):
            kind, what = "memory", "asked for more memory than it may have"
        elif isinstance(error, ImportError) and pose is None:
            kind = "import"
            if error.name in _OF_GRADE:
                remedy = "; python -m pip install 'kr210-sim[grade]'"
        return Finding(
            kind=kind,
            detail=_short(what) + remedy,
            line=number,
            source=self.line(number),
            pose=pose,
        )


def _text(value: object) -> str:
    try:
        return str(value)[:2000]
    except BaseException:  # foreign objects may fail at anything
        return f"a {type(value).__name__}"


def _short(value: object) -> str:
    """Return a value as one line of at most 300 printable characters."""
    text = " ".join(_text(value).split())
    text = "".join(sign if sign.isprintable() else "?" for sign in text)
    return text if len(text) <= 300 else f"{text[:200]} ... {text[-80:]}"
