"""How far a run is: a bar with rate and time left, on a terminal."""

from __future__ import annotations

import time
from typing import TextIO

_WIDTH = 24


def progress_bar(done: int, total: int, *, begun: int, seconds: float, unit: str = "cycles") -> str:
    """Return the line of a run that is not finished.

    Args:
        done: cycles that are finished.
        total: cycles of the run.
        begun: cycles that were finished before this session.
        seconds: since this session began.
        unit: what is counted, if not cycles.
    """
    filled = _WIDTH * done // total
    text = f"[{'#' * filled}{'-' * (_WIDTH - filled)}] {done}/{total} {unit}"
    fresh = done - begun
    if fresh <= 0 or seconds <= 0:
        return text
    rate = fresh / seconds
    return f"{text}, {60 * rate:.1f} a minute, {_duration((total - done) / rate)} left"


def _duration(seconds: float) -> str:
    minutes, rest = divmod(round(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours}:{minutes:02d}:{rest:02d}" if hours else f"{minutes}:{rest:02d}"


class ProgressBar:
    """A bar on a terminal; nothing elsewhere, where the lines of the cycles tell.

    Args:
        total: cycles of the run.
        stream: where it is drawn.
        unit: what is counted, if not cycles.
    """

    def __init__(self, total: int, stream: TextIO, *, unit: str = "cycles") -> None:
        self._unit = unit
        self._total, self._stream, self._shown = total, stream, stream.isatty()
        self._started = time.perf_counter()
        self._begun: int | None = None
        self._draw(progress_bar(0, total, begun=0, seconds=0, unit=unit))

    def show(self, cycle: int) -> None:
        """Show the bar after a cycle, by its index."""
        if self._begun is None:  # a run that was resumed begins later
            self._begun = cycle
        if cycle + 1 < self._total:
            seconds = time.perf_counter() - self._started
            bar = progress_bar(
                cycle + 1, self._total, begun=self._begun, seconds=seconds, unit=self._unit
            )
            self._draw(f"\r{bar}")

    def clear(self) -> None:
        """Take the bar away."""
        self._draw("\r\x1b[K")

    def _draw(self, text: str) -> None:
        if self._shown:
            self._stream.write(text)
            self._stream.flush()
