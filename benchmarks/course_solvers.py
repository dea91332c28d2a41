"""Three ways to choose among the answers to a pose, as solvers that `kr210-sim grade` takes."""

from __future__ import annotations

from typing import Any

import numpy as np

import ik

LOWER = np.radians([-185, -45, -210, -350, -125, -350])
UPPER = np.radians([185, 85, 65, 350, 125, 350])
VELOCITY = np.radians([123, 115, 112, 179, 172, 219])


def naive(T: Any, q_start: Any) -> Any:
    """Take the same branch always, each angle between -pi and pi."""
    return ik.inverse(ik.KR210, T).q[:, 0]


def greedy(T: Any, q_start: Any) -> Any:
    """Take what is next to the answer before."""
    return ik.greedy_sequence(ik.KR210, T, LOWER, UPPER, VELOCITY, q_start).q


def exact(T: Any, q_start: Any) -> Any:
    """Take the shortest of all paths through the poses."""
    return ik.best_sequence(ik.KR210, T, LOWER, UPPER, VELOCITY, q_start).q
