"""A solver in a process of its own: asked on its channel, held to its limits, gone at the end."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from kr210_sim.config import RunConfig
from kr210_sim.exceptions import BadInput
from kr210_sim.grading.findings import Refused
from kr210_sim.grading.process import SolverProcess, _rows
from kr210_sim.grading.source import SolverLimits, SolverSource

T = np.tile(np.eye(4), (4, 1, 1))
HOME = np.zeros(6)
QUICK = SolverLimits(pose_timeout=0.5, time_limit=8.0)

SOLVERS = """
import os, sys, time
import numpy as np

def echo(T, q_start):
    print("hello")
    return np.tile(q_start, (len(T), 1)) + T[:, :1, 0]

def waits(position, quaternion):
    time.sleep(0.1 if waits.asked < 2 else 60.0)
    waits.asked += 1
    return [0.0] * 6
waits.asked = 0

def hangs(T, q_start):
    while True:
        pass

def leaves(T, q_start):
    os._exit(7)

def crashes(T, q_start):
    import ctypes
    ctypes.string_at(0)

def forks(T, q_start):
    while True:
        os.fork()

def grows(T, q_start):
    return [0] * (10**10 // 8)

def floods(T, q_start):
    while True:
        print("x" * 10000)

def kills(T, q_start):
    os.kill(os.getppid(), 9)

def writes(T, q_start):
    open("inside.txt", "w").write("x")
    open(OUTSIDE, "w").write("x")

def lies(T, q_start):
    os.write(int(CHANNEL), b'{"event": "rows", "q": [[1, 2]], "seconds": 0}\\n')
    while True:
        pass

def closes(T, q_start):
    os.closerange(0, 100)
    while True:
        pass

def limits(T, q_start):
    import resource
    resource.setrlimit(resource.RLIMIT_NOFILE, (64, 64))  # its own may be lowered
    resource.prlimit(os.getppid(), resource.RLIMIT_CORE, (0, 0))

def rings(T, q_start):
    import ctypes
    libc = ctypes.CDLL(None, use_errno=True)
    libc.syscall(425, 1, None)  # io_uring_setup
    raise OSError(ctypes.get_errno(), "refused")

def secret(T, q_start):
    raise ValueError(os.environ.get("A_TOKEN", "nothing"))
"""


@pytest.fixture
def started(tmp_path):
    """Start a function of SOLVERS; what was started ends with the test."""
    running = []

    def start(function: str, text: str = SOLVERS, limits: SolverLimits = QUICK) -> SolverProcess:
        path = tmp_path / "solvers.py"
        path.write_text(text)
        running.append(SolverProcess(SolverSource(file=path, function=function), limits))
        return running[-1]

    yield start
    for process in running:
        process.close()


def test_a_solver_answers_and_its_prints_are_kept_apart(started):
    process = started("echo")
    for start in (HOME, np.full(6, 0.25)):
        answer = process.ask(T, start)
        assert answer.finding is None
        np.testing.assert_array_equal(answer.q, np.tile(start + 1.0, (4, 1)))
        assert answer.seconds.shape == (4,)
    assert process.output == b"hello\nhello\n"
    assert (process.form, process.language) == ("poses", "Python 3")


def test_a_hanging_solver_is_stopped_at_its_line(started):
    process = started("hangs")
    answer = process.ask(T[:1], HOME)
    assert answer.finding.kind == "timeout"
    assert answer.finding.source.strip() in ("while True:", "pass")
    assert not process.alive


def test_answers_that_came_in_time_count(started):
    answer = started("waits").ask(T, HOME)
    assert (len(answer.q), answer.finding.kind) == (2, "timeout")


def test_no_file_is_bad_input(tmp_path):
    for text in ("nothing.py:f", f"{tmp_path}/absent.py:f", "solver", ":f", "a b:f", "m:1f"):
        with pytest.raises(BadInput, match="--ik: "):
            RunConfig(ik=text)


def test_a_file_without_the_function_says_which_it_has(started):
    with pytest.raises(Refused) as caught:
        started("solve", "def mine(T, q_start):\n    pass\n")
    assert caught.value.finding.kind == "not_found"
    assert "mine" in caught.value.finding.detail


@pytest.mark.slow
@pytest.mark.parametrize(
    ("function", "kind"),
    [
        ("leaves", "died"),
        ("crashes", "died"),
        ("forks", "raised"),
        ("grows", "memory"),
        ("floods", "timeout"),
        ("kills", "raised"),
        ("closes", "died"),
    ],
)
def test_a_hostile_solver_is_a_finding(started, function, kind):
    began = time.monotonic()
    answer = started(function).ask(T[:1], HOME)
    assert answer.finding.kind == kind
    assert time.monotonic() - began < 20.0


@pytest.mark.slow
def test_nothing_is_written_outside_the_scratch_folder(started, tmp_path):
    outside = tmp_path / "outside.txt"
    process = started("writes", SOLVERS + f"\nOUTSIDE = {str(outside)!r}\n")
    if "not enforced" in process.kept["files"]:
        pytest.skip(process.kept["files"])
    answer = process.ask(T, HOME)
    assert answer.finding.source.strip() == 'open(OUTSIDE, "w").write("x")'
    assert not outside.exists()


@pytest.mark.slow
@pytest.mark.parametrize("function", ["limits", "rings"])
def test_what_amounts_to_a_signal_or_a_socket_is_refused_as_well(started, function):
    process = started(function)
    if "not enforced" in process.kept["processes"]:
        pytest.skip(process.kept["processes"])
    assert "PermissionError" in process.ask(T[:1], HOME).finding.detail


@pytest.mark.parametrize(
    "message",
    [
        {"q": [[10**400, 0, 0, 0, 0, 0]], "seconds": 0.0},
        {"q": [[0.0] * 6], "seconds": 10**400},
        {"q": [[0.0] * 6] * 2, "seconds": 0.0},
        {"q": [["1"] * 6], "seconds": 0.0},
        {"q": [[0.0] * 5], "seconds": 0.0},
        {"q": None, "seconds": 0.0},
        {},
    ],
)
def test_rows_that_are_none_are_told_from_rows(message):
    assert _rows({"q": [[1, 2, 3, 4, 5, 6]], "seconds": 1}, 1) == ([[1, 2, 3, 4, 5, 6]], 1.0)
    assert _rows(message, 1) is None


@pytest.mark.slow
@pytest.mark.parametrize("channel", range(3, 12))
def test_forged_answers_are_refused(started, channel):
    process = started("lies", SOLVERS + f"\nCHANNEL = {channel}\n")
    answer = process.ask(T[:1], HOME)
    assert answer.finding is not None
    assert process.alive == (answer.finding.kind != "died")  # what follows a forged line is, too
    assert len(answer.q) == 0


@pytest.mark.slow
def test_a_solver_does_not_see_our_environment(started, monkeypatch):
    monkeypatch.setenv("A_TOKEN", "a secret")
    assert "nothing" in started("secret").ask(T, HOME).finding.detail


@pytest.mark.slow
def test_a_module_is_imported_from_the_working_folder(tmp_path, monkeypatch):
    (tmp_path / "my_package").mkdir()
    (tmp_path / "my_package" / "__init__.py").write_text("")
    (tmp_path / "my_package" / "inverse.py").write_text(SOLVERS)
    monkeypatch.chdir(tmp_path)
    process = SolverProcess(SolverSource.parse("my_package.inverse:echo"), QUICK)
    assert process.ask(T, HOME).finding is None
    process.close()
    with pytest.raises(Refused) as caught:
        SolverProcess(SolverSource.parse("no_such_module:echo"), QUICK)
    assert caught.value.finding.kind == "import"


@pytest.mark.slow
def test_a_solver_ends_with_its_host(tmp_path):
    path = tmp_path / "solvers.py"
    path.write_text(SOLVERS)
    program = (
        "import sys; from pathlib import Path; import os\n"
        "from kr210_sim.grading.process import SolverProcess\n"
        "from kr210_sim.grading.source import SolverLimits, SolverSource\n"
        "process = SolverProcess(SolverSource(file=Path(sys.argv[1]), function='echo'), "
        "SolverLimits())\n"
        "print(process._process.pid, flush=True); os.kill(os.getpid(), 9)\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", program, str(path)], capture_output=True, text=True, check=False
    )
    solver = int(done.stdout)
    deadline = time.monotonic() + 10.0
    while time.monotonic() < deadline and _runs(solver):
        time.sleep(0.05)
    assert not _runs(solver)


def _runs(process: int) -> bool:
    status = Path(f"/proc/{process}/stat")
    if status.parent.parent.exists():
        return status.exists() and status.read_text().rpartition(")")[2].split()[0] != "Z"
    try:
        os.kill(process, 0)
    except OSError:
        return False
    return True
