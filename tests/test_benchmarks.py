"""The benchmarks start as their first lines say, from any folder."""

from __future__ import annotations

import runpy
import subprocess
import sys
from pathlib import Path

import pytest

FOLDER = Path(__file__).resolve().parents[1] / "benchmarks"
SCRIPTS = sorted(path.name for path in FOLDER.glob("*.py") if "__main__" in path.read_text())
SPAWNING = [name for name in SCRIPTS if '"spawn"' in (FOLDER / name).read_text()]


@pytest.mark.slow
@pytest.mark.parametrize("script", SCRIPTS)
def test_a_benchmark_starts(script, tmp_path):
    command = [sys.executable, str(FOLDER / script), "--help"]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert "usage" in done.stdout


@pytest.mark.parametrize("script", SPAWNING)
def test_a_process_of_a_benchmark_imports_what_its_parent_does(script, monkeypatch):
    path = ["first", *sys.path]
    monkeypatch.setattr(sys, "path", list(path))
    runpy.run_path(str(FOLDER / script), run_name="__mp_main__")  # as multiprocessing does
    assert sys.path == path


@pytest.mark.slow
def test_the_motion_benchmark_compares_a_pair(tmp_path):
    pytest.importorskip("toppra")
    command = [sys.executable, str(FOLDER / "motion.py"), "--cycles", "0", "--pairs", "1"]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    rows = [line.strip("| ").split(" | ") for line in done.stdout.splitlines()]
    means = {row[0]: float(row[1]) for row in rows[2:6]}
    assert means["(a) velocity bound, no acceleration limit"] < means["planned"]
    assert means["(b) TOPP-RA, same path, v and a, no jerk limit"] < means["planned"]
    assert means["(c) a stop at every pose, 0.2 of the limits"] > 5 * means["planned"]
    assert "Axes 4 and 6 turn further than the shortest-path choice in 0 of 1." in done.stdout
    assert "Not planned: 0" in done.stdout


@pytest.mark.slow
def test_the_throughput_benchmark_replays_cycles_and_compares_workers(tmp_path):
    small = ["--replayed", "1", "--passes", "1", "--cycles", "2", "--episode-cycles", "1"]
    command = [sys.executable, str(FOLDER / "throughput.py"), *small]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    rows = [line.strip("| ").split(" | ") for line in done.stdout.splitlines()]
    cost = {row[0]: float(row[2]) for row in rows if len(row) == 5 and row[1][0].isdigit()}
    assert cost["bare mj_step loop"] == 1
    assert 0.5 < cost["**stepping, control, recording, scoring**"] < cost["the whole episode"]
    measured = {row[0]: row[1:] for row in rows if len(row) == 4}
    assert {"cycles per minute", "steps per second, bare loops"} <= set(measured)
    assert "Least success rate: 1.000" in done.stdout
