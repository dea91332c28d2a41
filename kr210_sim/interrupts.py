"""Ctrl-C and SIGTERM: one interrupt stops a run, and none tears what is being written."""

from __future__ import annotations

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

_SIGNALS = (signal.SIGINT, signal.SIGTERM)


def _handled() -> bool:
    """Tell whether this thread is the one that Python lets set handlers."""
    return threading.current_thread() is threading.main_thread()


@contextmanager
def one_interrupt() -> Iterator[None]:
    """Let the first SIGINT or SIGTERM raise KeyboardInterrupt, and further ones do nothing.

    That holds until the process ends, which it is then about to.
    """
    seen: list[int] = []

    def stop(number: int, _frame: Any) -> None:
        seen.append(number)
        if len(seen) == 1:
            raise KeyboardInterrupt

    if not _handled():
        yield
        return
    previous = {number: signal.signal(number, stop) for number in _SIGNALS}
    try:
        yield
    finally:
        for number, handler in previous.items():
            signal.signal(number, signal.SIG_IGN if seen else handler)


@contextmanager
def no_interrupt() -> Iterator[None]:
    """Let SIGINT and SIGTERM wait until the body is done."""
    if not _handled():
        yield
        return
    waiting: list[int] = []
    previous = {
        number: signal.signal(number, lambda caught, _frame: waiting.append(caught))
        for number in _SIGNALS
    }
    try:
        yield
    finally:
        for number, handler in previous.items():
            signal.signal(number, handler)
    if waiting:
        signal.raise_signal(waiting[0])


def ignore_interrupts() -> None:
    """Leave interrupts to another process, for good."""
    for number in _SIGNALS:
        signal.signal(number, signal.SIG_IGN)
