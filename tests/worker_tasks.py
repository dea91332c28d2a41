"""What the workers of test_workers.py do; they import this module and nothing heavy."""

from __future__ import annotations

import os
import signal
import time
from pathlib import Path


def double(number: int) -> int:
    return 2 * number


def fail(number: int) -> int:
    raise ZeroDivisionError(f"task {number}")


def die(task: tuple[Path, int, int]) -> int:
    """Die by SIGKILL as often as the task says, leaving a mark each time, then answer."""
    folder, number, deaths = task
    marks = len(list(folder.glob(f"{number}-*")))
    if marks < deaths:
        (folder / f"{number}-{marks}").touch()
        os.kill(os.getpid(), signal.SIGKILL)
    return number


def sleep(task: tuple[Path, int, int]) -> int:
    """Hang as often as the task says, then answer."""
    folder, number, times = task
    marks = len(list(folder.glob(f"{number}-*")))
    if marks < times:
        (folder / f"{number}-{marks}").touch()
        time.sleep(600)
    return number


def name(_number: int) -> int:
    return os.getpid()


def name_and_wait(path: Path) -> int:
    path.write_text(str(os.getpid()))
    time.sleep(600)
    return 0
