"""The two kinds of error: bad input, which stops a run, and a cycle that fails, which is data."""

from __future__ import annotations


class Kr210SimError(Exception):
    """Base class of every error this package raises on purpose."""


class BadInput(Kr210SimError):
    """What the user gave cannot be used.

    The message is one line that names the file or option, the field and the remedy.
    """


class MissingFile(BadInput):
    """A file that a description names does not exist."""


class NotWritten(Kr210SimError):
    """A file of a run cannot be written, e.g. on a full disk; what is finished is kept."""


class Interrupted(KeyboardInterrupt):
    """A run was interrupted; the message says what is kept."""


class CycleFailure(Kr210SimError):
    """A cycle cannot go on; the sequencer turns it into a scored failure.

    Attributes:
        reason: one of `kr210_sim.score.REASONS`.
        detail: one clause for the reader: which pose, which bodies, which joint.
        stage: the stage it concerns, if another than the one running.
    """

    def __init__(self, reason: str, detail: str, *, stage: str | None = None) -> None:
        super().__init__(f"{reason}: {detail}")
        self.reason = reason
        self.detail = detail
        self.stage = stage
