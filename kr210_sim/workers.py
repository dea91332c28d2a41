"""Tasks shared out to worker processes: one that crashes or hangs costs its own task a retry."""

from __future__ import annotations

import math
import multiprocessing
import os
import threading
import time
from collections.abc import Callable, Generator, Iterable
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass
from typing import Any, Generic, TypeVar

from kr210_sim.exceptions import BadInput, Kr210SimError
from kr210_sim.interrupts import ignore_interrupts

TASK_ATTEMPTS = 2
"""A task whose worker is lost is tried again once."""

Item = TypeVar("Item")
Result = TypeVar("Result")


@dataclass(frozen=True, kw_only=True)
class Loss(Generic[Item]):
    """A worker that was lost with the task it had.

    Attributes:
        item: what the task was given.
        attempt: counts from 1.
        hung: whether it gave no result in time, and was ended.
        cause: one clause for the reader.
    """

    item: Item
    attempt: int
    hung: bool
    cause: str

    @property
    def final(self) -> bool:
        """Whether the task is not tried again."""
        return self.attempt == TASK_ATTEMPTS


class _Worker:
    """One process in an executor of its own, so that no crash is charged to another's task."""

    def __init__(self) -> None:
        before = multiprocessing.active_children()
        # spawn: MuJoCo and the executors have threads, and those do not survive a fork
        context = multiprocessing.get_context("spawn")
        self._pool = ProcessPoolExecutor(1, mp_context=context, initializer=_begin)
        self._began = self._pool.submit(os.getpid)
        self._process = next(
            child for child in multiprocessing.active_children() if child not in before
        )

    def submit(self, task: Callable[[Item], Result], item: Item) -> Future[Result]:
        return self._pool.submit(task, item)

    def end(self) -> str:
        """End the process, if it still runs; return how it ended."""
        self._process.kill()
        self._pool.shutdown(wait=True, cancel_futures=True)
        code = self._process.exitcode
        if code is not None and code < 0:
            return f"killed by signal {-code}"
        return f"exit status {code}"

    @property
    def began(self) -> bool:
        return self._began.done() and self._began.exception() is None


def _begin() -> None:
    """Prepare a worker: the parent decides about interrupts, and its death is the worker's."""
    ignore_interrupts()
    parent = multiprocessing.parent_process()

    def follow() -> None:
        if parent is not None:
            parent.join()
            os._exit(1)

    threading.Thread(target=follow, daemon=True).start()


@dataclass(kw_only=True)
class _Attempt(Generic[Item]):
    item: Item
    number: int
    worker: _Worker
    limit: float
    deadline: float
    hung: bool = False


def share_out(
    task: Callable[[Item], Result],
    items: Iterable[Item],
    *,
    jobs: int,
    limit: Callable[[Item], float],
    on_loss: Callable[[Loss[Item]], None],
) -> Generator[Result, None, None]:
    """Yield the results in the order in which they are finished.

    Args:
        task: a function of a module, since it is pickled.
        items: one per task, also pickled; read as workers become free.
        jobs: number of processes.
        limit: longest time that a task may take [s] before its worker counts as hanging.
        on_loss: told of every lost worker; a task whose loss is `final` has no result.

    Raises:
        Kr210SimError: if a worker does not even start.
        Exception: what a task raises.
    """
    waiting, again = iter(items), list[tuple[Item, int]]()
    idle: list[_Worker] = []
    running: dict[Future[Result], _Attempt[Item]] = {}

    def begin() -> bool:
        """Give the next task to a worker, if there is one left."""
        item, number = again.pop() if again else (next(waiting, None), 1)
        if item is None:
            return False
        seconds = limit(item)
        worker, future = _given(idle, task, item)
        deadline = time.monotonic() + seconds
        running[future] = _Attempt(
            item=item, number=number, worker=worker, limit=seconds, deadline=deadline
        )
        return True

    try:
        while True:
            while len(running) < jobs and begin():
                pass
            if not running:
                return
            for future in _finished(running):
                attempt = running.pop(future)
                try:
                    result = future.result()
                except BrokenProcessPool:
                    loss = _loss(attempt)
                    on_loss(loss)
                    if not loss.final:
                        again.append((attempt.item, attempt.number + 1))
                    continue
                idle.append(attempt.worker)
                yield result
    finally:
        for worker in (*idle, *(attempt.worker for attempt in running.values())):
            worker.end()


def _given(
    idle: list[_Worker], task: Callable[[Item], Result], item: Item
) -> tuple[_Worker, Future[Result]]:
    """Give a task to an idle worker, or to a new one if there is none."""
    while idle:
        worker = idle.pop()
        try:
            return worker, worker.submit(task, item)
        except BrokenProcessPool:  # killed while it had nothing to do, which costs no task
            worker.end()
    worker = _Worker()
    return worker, worker.submit(task, item)


def _finished(running: dict[Future[Any], _Attempt[Any]]) -> set[Future[Any]]:
    """Wait until a task is finished or overdue; end the workers of those that are overdue."""
    first = min(attempt.deadline for attempt in running.values())
    timeout = None if math.isinf(first) else max(0.0, first - time.monotonic())
    done = wait(running, timeout=timeout, return_when=FIRST_COMPLETED).done
    if not done:
        for attempt in running.values():
            if attempt.deadline <= time.monotonic():
                attempt.hung, attempt.deadline = True, math.inf
                attempt.worker.end()
    return done


def _loss(attempt: _Attempt[Item]) -> Loss[Item]:
    ending = attempt.worker.end()
    if not attempt.worker.began:
        raise Kr210SimError(f"a worker process cannot be started ({ending})")
    cause = f"no result within {attempt.limit:.0f} s" if attempt.hung else ending
    return Loss(item=attempt.item, attempt=attempt.number, hung=attempt.hung, cause=cause)


def share_out_by_dask(
    task: Callable[[Item], Result], items: Iterable[Item], *, jobs: int
) -> Generator[Result, None, None]:
    """Yield the results in the order in which Dask's workers finish them.

    The scheduler is the one of Dask's own configuration (`DASK_SCHEDULER_ADDRESS`), else a cluster
    on this machine. Dask itself runs the task of a lost worker again.

    Raises:
        BadInput: if joblib or distributed is not installed, or the scheduler does not answer.
        Exception: what a task raises.
    """
    try:
        import dask
        import distributed
        import joblib
    except ModuleNotFoundError as error:
        raise BadInput(
            f"--backend: dask needs {error.name}; python -m pip install 'kr210-sim[cluster]'"
        ) from error
    address = dask.config.get("scheduler-address", None)
    local = {"n_workers": jobs, "threads_per_worker": 1, "dashboard_address": None}
    try:
        client = distributed.Client(**({} if address else local))
    except (OSError, ValueError) as error:
        raise BadInput(f"--backend: no Dask scheduler at {address}: {error}") from error
    with client, joblib.parallel_config("dask"):
        # a batch of one, since an episode is long, and no more of them in flight than needed
        parallel = joblib.Parallel(
            return_as="generator_unordered", batch_size=1, pre_dispatch="2*n_jobs"
        )
        yield from parallel(joblib.delayed(task)(item) for item in items)
