"""Grades without a simulation: a solver is asked for two drawn legs, its cycles are made up."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import ik
from kr210_sim.grading import grade as grading
from kr210_sim.grading.grade import GradeConfig, grade
from kr210_sim.grading.source import SolverLimits, SolverSource
from kr210_sim.scene import Scene

BRIEF = GradeConfig(cycles=1, limits=SolverLimits(pose_timeout=3.0, time_limit=9.0))
ONE = GradeConfig(cycles=1)
_THERE = np.array([0.6, 0.3, -0.5, 0.9, 0.8, -0.6])
_BACK = np.array([-0.9, 0.5, -0.2, -0.5, 0.6, 0.9])


def graded(path: Path, config: GradeConfig = BRIEF, function: str | None = None) -> dict[str, Any]:
    return grade(SolverSource(file=path, function=function), config).content


def drawn_grade(
    scene: Scene, path: Path, function: str | None = None, config: GradeConfig = ONE
) -> dict[str, Any]:
    """Grade a solver by two legs a cycle.

    Cycles with wrong answers fail, and so does every second one.
    """

    def drawn(_scene, episode, setup, **_):
        for number in range(episode.first_cycle, episode.first_cycle + len(episode.cells)):
            start, right = np.zeros(6), number % 2 == 0
            for goal in (_THERE, _BACK):
                T = ik.forward(ik.KR210, start + np.linspace(0, 1, 13)[1:, None] * (goal - start))
                right &= np.allclose(ik.forward(ik.KR210, setup.solver(T, start)), T, atol=1e-3)
                start = goal
            yield SimpleNamespace(as_json=partial(line, number, right))

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(grading, "_scene", lambda config: scene)
        patch.setattr(grading, "run_episode", drawn)
        return graded(path, config, function)


def failed_grade(scene: Scene, folder: Path) -> dict[str, Any]:
    """Grade a file that cannot be imported."""
    path = folder / "<b>evil.py"
    path.write_text("import numpy\nimport no_such_package\n")
    return drawn_grade(scene, path)


def line(number: int, success: bool) -> dict[str, Any]:
    """What a grade says of a cycle."""
    return {
        "cycle": number,
        "cell": 1 + number % 9,
        "success": success,
        "reason": None if success else "dropped",
        "failed_stage": None if success else "LIFT",
        "failed_time_s": None if success else 3.25,
        "detail": None if success else "a finger lost <b>it</b>",
        "cycle_time_s": 8.5 if success else None,
    }
