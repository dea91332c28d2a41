"""Instants and spans of time, as rospy and the headers of messages have them."""

from __future__ import annotations

import time as _time
from typing import Any


class Duration:
    """A span of time [s]; nanoseconds come as a second number."""

    def __init__(self, secs: float = 0.0, nsecs: int = 0) -> None:
        self._seconds = float(secs) + 1e-9 * nsecs

    @classmethod
    def from_sec(cls, seconds: float) -> Any:
        """Return it from seconds."""
        return cls(seconds)

    @property
    def secs(self) -> int:
        """Return the whole seconds."""
        return int(self._seconds // 1)

    @property
    def nsecs(self) -> int:
        """Return the nanoseconds beyond the whole seconds."""
        return int(1e9 * (self._seconds % 1))

    def to_sec(self) -> float:
        """Return it in seconds."""
        return self._seconds

    def to_nsec(self) -> int:
        """Return it in nanoseconds."""
        return int(1e9 * self._seconds)

    def __sub__(self, other: Duration) -> Duration:
        return Duration(self._seconds - other.to_sec())

    def __add__(self, other: Duration) -> Any:
        return type(self)(self._seconds + other.to_sec())

    def __lt__(self, other: Duration) -> bool:
        return self._seconds < other.to_sec()

    def __gt__(self, other: Duration) -> bool:
        return self._seconds > other.to_sec()

    def __repr__(self) -> str:
        return str(self.to_nsec())


class Time(Duration):
    """An instant."""

    @staticmethod
    def now() -> Time:
        """Return the present instant."""
        return Time(_time.time())
