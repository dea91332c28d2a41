"""What the library raises: one base class, one subclass for each kind of bad input."""

from __future__ import annotations


class IKError(ValueError):
    """Base class of the errors of `ik`; bad input, with the remedy in its message."""


class InvalidPose(IKError):
    """A matrix that was given as a pose is no rigid transform."""


class UnsupportedArm(IKError):
    """The arm is outside of the class that `ik` solves.

    Attributes:
        reasons: One sentence per condition that the arm fails, in geometric words.
    """

    def __init__(self, reasons: tuple[str, ...], hint: str = "") -> None:
        """Join the reasons into one message.

        Args:
            reasons: One sentence per failed condition.
            hint: What the caller can do about it.
        """
        self.reasons = reasons
        text = "no ortho-parallel arm with a spherical wrist: " + "; ".join(reasons)
        super().__init__(text + (f" ({hint})" if hint else ""))
