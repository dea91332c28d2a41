"""Pictures of a run, drawn in processes of their own and handed over in order."""

from __future__ import annotations

import os
import subprocess
import sys
import threading
from collections.abc import Generator, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from queue import Queue
from tempfile import TemporaryFile
from typing import IO

import numpy as np
from numpy.typing import NDArray

from kr210_sim.film.worker import Job

Picture = NDArray[np.uint8]

LEAST_PICTURES = 20
"""A process that draws fewer costs more to start than it saves."""

MAX_PROCESSES = 8  # a GPU, or memory at 0.4 GB each, is the limit then
_AHEAD = 4  # pictures that a process may be ahead


def draw(job: Job, *, backend: str, processes: int | None = None) -> Generator[Picture]:
    """Yield the pictures of a job in order.

    MuJoCo chooses its OpenGL when it is first imported, so the drawing happens in new processes,
    which take turns: the first draws pictures 0, n, 2 n, ...

    Args:
        job: what to draw.
        backend: from `find_gl`.
        processes: how many; by default one a core.

    Raises:
        OSError: if a process fails.
    """
    count = processes or min(cores(), MAX_PROCESSES, max(1, len(job.moments) // LEAST_PICTURES))
    threads = max(1, cores() // count)
    with ExitStack() as stack:
        jobs = [replace(job, moments=job.moments[first::count]) for first in range(count)]
        turns = [stack.enter_context(_drawn(one, backend, threads)) for one in jobs]
        for index in range(len(job.moments)):
            yield next(turns[index % count])


def cores() -> int:
    """Return the number of cores that this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


@contextmanager
def _drawn(job: Job, backend: str, threads: int) -> Iterator[Iterator[Picture]]:
    """Start a process; it ends with the context."""
    environment = os.environ | {"MUJOCO_GL": backend, "LP_NUM_THREADS": str(threads)}
    with TemporaryFile() as errors:
        process = subprocess.Popen(
            [sys.executable, "-m", "kr210_sim.film.worker"],
            env=environment,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=errors,
            start_new_session=True,  # an interrupt is for us alone
        )
        assert process.stdin is not None
        assert process.stdout is not None
        pictures: Queue[Picture | None] = Queue(_AHEAD)
        reader = threading.Thread(target=_read, args=(process.stdout, job, pictures), daemon=True)
        try:
            try:
                process.stdin.write(job.to_json().encode())
                process.stdin.close()
            except BrokenPipeError:
                pass  # its own words tell more
            reader.start()
            yield _in_order(pictures, process, errors)
        finally:
            process.kill()
            process.wait()
            while reader.is_alive():  # it may wait for room
                while not pictures.empty():
                    pictures.get()
                reader.join(0.05)
            process.stdout.close()


def _read(stream: IO[bytes], job: Job, pictures: Queue[Picture | None]) -> None:
    """Queue the pictures of a process; None when there are no more."""
    width, height = job.size
    for _ in job.moments:
        picture = np.empty((height, width, 3), dtype=np.uint8)
        rest = picture.data.cast("B")
        while rest:
            count = stream.readinto(rest)  # type: ignore[attr-defined]
            if not count:
                pictures.put(None)
                return
            rest = rest[count:]
        pictures.put(picture)
    pictures.put(None)


def _in_order(
    pictures: Queue[Picture | None], process: subprocess.Popen[bytes], errors: IO[bytes]
) -> Iterator[Picture]:
    while True:
        picture = pictures.get()
        if picture is None:
            process.wait()
            errors.seek(0)
            lines: Sequence[str] = errors.read().decode(errors="replace").strip().splitlines()
            last = lines[-1] if lines else f"the process ended with status {process.returncode}"
            raise OSError(f"the picture could not be drawn: {last}")
        yield picture
