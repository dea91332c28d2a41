"""Tasks shared out to processes: all results come back, whatever happens to a worker."""

from __future__ import annotations

import math
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
import worker_tasks

from kr210_sim.workers import share_out

pytestmark = pytest.mark.slow  # each worker is an interpreter to start


def results_of(task, items, *, jobs=2, limit=math.inf):
    losses = []
    results = share_out(task, items, jobs=jobs, limit=lambda _item: limit, on_loss=losses.append)
    return sorted(results), losses


@pytest.mark.parametrize("jobs", [1, 2, 5])
def test_every_task_is_done_once(jobs):
    results, losses = results_of(worker_tasks.double, range(7), jobs=jobs)
    assert results == [0, 2, 4, 6, 8, 10, 12]
    assert losses == []


def test_no_tasks_need_no_workers():
    assert results_of(worker_tasks.double, []) == ([], [])


def test_what_a_task_raises_is_raised_here():
    with pytest.raises(ZeroDivisionError, match="task 0"):
        results_of(worker_tasks.fail, [0])


def test_a_worker_that_is_killed_costs_its_own_task_one_retry(tmp_path):
    results, losses = results_of(worker_tasks.die, [(tmp_path, n, n == 2) for n in range(6)])
    assert results == [0, 1, 2, 3, 4, 5]
    assert [(loss.item[1], loss.attempt, loss.hung, loss.final) for loss in losses] == [
        (2, 1, False, False)
    ]
    assert losses[0].cause == "killed by signal 9"


def test_a_worker_that_is_killed_while_it_has_nothing_to_do_is_replaced():
    seen, losses = [], []
    for process in share_out(
        worker_tasks.name, range(3), jobs=1, limit=lambda _item: 60.0, on_loss=losses.append
    ):
        seen.append(process)
        os.kill(process, signal.SIGKILL)
        time.sleep(0.5)  # until that is known; else it costs a task its retry
    assert len(set(seen)) == 3


def test_a_task_that_no_worker_survives_is_lost_and_no_other(tmp_path):
    results, losses = results_of(worker_tasks.die, [(tmp_path, n, 9 * (n == 2)) for n in range(6)])
    assert results == [0, 1, 3, 4, 5]
    assert [(loss.item[1], loss.attempt, loss.final) for loss in losses] == [
        (2, 1, False), (2, 2, True)
    ]  # fmt: skip
    assert len(list(tmp_path.iterdir())) == 2


def test_a_worker_that_hangs_is_ended_and_its_task_tried_again(tmp_path):
    tasks = [(tmp_path, n, n == 1) for n in range(3)]
    results, losses = results_of(worker_tasks.sleep, tasks, limit=5.0)
    assert results == [0, 1, 2]
    assert [(loss.item[1], loss.hung) for loss in losses] == [(1, True)]
    assert "no result within 5 s" in losses[0].cause


def is_running(process: int) -> bool:
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    return "State:\tZ" not in Path(f"/proc/{process}/status").read_text()


@pytest.mark.skipif(not Path("/proc/self").exists(), reason="looks processes up in /proc")
@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGTERM])
def test_workers_die_with_their_parent(tmp_path, number):
    program = (
        "import sys, worker_tasks\n"
        "from pathlib import Path\n"
        "from kr210_sim.workers import share_out\n"
        "if __name__ == '__main__':\n"
        "    list(share_out(worker_tasks.name_and_wait, [Path(sys.argv[1])], jobs=1,\n"
        "                   limit=lambda item: 600.0, on_loss=print))\n"
    )
    (tmp_path / "main.py").write_text(program)
    path = tmp_path / "worker"
    parent = subprocess.Popen(
        [sys.executable, str(tmp_path / "main.py"), str(path)],
        env=os.environ | {"PYTHONPATH": str(Path(__file__).parent)},
    )
    deadline = time.monotonic() + 60
    while not (path.exists() and path.read_text()):
        assert time.monotonic() < deadline
        time.sleep(0.05)
    worker = int(path.read_text())
    assert is_running(worker)
    parent.send_signal(number)
    parent.wait()
    while is_running(worker):
        assert time.monotonic() < deadline, "the worker outlives its parent"
        time.sleep(0.05)
