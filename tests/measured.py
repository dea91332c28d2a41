"""Lets the processes that are killed when they are no longer needed hand in their coverage first.

Solvers may write to their scratch folder only, and it goes with them; idle workers are killed.
Without coverage nothing here is used.
"""

from __future__ import annotations

import base64
import json
import os
import shutil
import subprocess
from contextlib import suppress
from pathlib import Path

import pytest

from kr210_sim.grading.process import SolverProcess
from kr210_sim.workers import _Worker

SETTINGS = "COVERAGE_PROCESS_CONFIG"
"""Variable by which coverage tells its settings to the processes that it measures."""

GRACE = 3.0
"""Time to end by itself [s]; what hangs is killed after it."""


def hand_in(patch: pytest.MonkeyPatch) -> None:
    """Give children time to end by themselves, and solvers a place for their data."""
    settings = json.loads(base64.b64decode(os.environ[SETTINGS]))
    data = Path(settings["data_file"])
    environment, close, end = SolverProcess._environment, SolverProcess.close, _Worker.end

    def measured_environment(solver: SolverProcess) -> dict[str, str]:
        of_solver = settings | {"data_file": str(solver._scratch / data.name)}
        told = base64.b64encode(json.dumps(of_solver).encode()).decode()
        return environment(solver) | {SETTINGS: told}

    def patient_close(solver: SolverProcess) -> None:
        if solver._process.returncode is None:
            nowhere = os.open(os.devnull, os.O_WRONLY)
            os.dup2(nowhere, solver._requests)  # the solver reads the end of its requests
            os.close(nowhere)
            with suppress(subprocess.TimeoutExpired):
                solver._process.wait(GRACE)
        for part in solver._scratch.glob(f"{data.name}.*"):
            shutil.move(part, data.parent)
        close(solver)

    def patient_end(worker: _Worker) -> str:
        worker._pool.shutdown(wait=False, cancel_futures=True)
        worker._process.join(GRACE)
        return end(worker)

    patch.setattr(SolverProcess, "_environment", measured_environment)
    patch.setattr(SolverProcess, "close", patient_close)
    patch.setattr(_Worker, "end", patient_end)
