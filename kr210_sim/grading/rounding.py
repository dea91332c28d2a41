"""Numbers of the arm that a solver rounded: fitted to answers that miss by very little."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

import ik
from kr210_sim.arrays import Array
from kr210_sim.grading.diagnosis import Diagnosis

NEAR = 0.01
"""Answers that miss the wrist center by more are no matter of rounding [m]."""

_SAME = 2e-7
"""Numbers that agree within this are the right ones [m, rad]."""

_LEAST = 6
"""Fewer answers could be explained by chance [1]."""

_ROUNDS = 3
"""Of Newton's method: the lengths are linear, and the quarter turn is nearly so [1]."""

_LENGTHS = ("a1", "d1", "L2", "a3", "d4")
_TURNED = np.array([0, 1, 1, 0, 0, 0])  # joints whose formula has pi/2 in it


def rounding(
    answers: Sequence[tuple[Array, Array]], arm: ik.Arm, tolerance: float
) -> Diagnosis | None:
    """Name the lengths and angles with which all answers would be right, if nearly so they are.

    Fitted are the lengths of the DH table, and the pi/2 of theta 2 and 3. A solver may have the
    forearm as a3 and d4 or as side and sag of the triangle: the form with fewer changes is told.

    Args:
        answers: T_base_palm (n, 4, 4) and the angles answered to it (n, 6) [rad] of each request.
        arm: the right geometry.
        tolerance: up to which a wrist center is right [m].

    Returns:
        None if no answer misses, one misses by far, other numbers do not explain all of them, or
        there are too few.
    """
    if sum(len(q) for _, q in answers) < _LEAST:
        return None
    angles = np.concatenate([q for _, q in answers])
    centers = ik.wrist_center(arm, np.concatenate([T for T, _ in answers]))

    def missed(numbers: Array) -> Array:
        taken = replace(arm, **dict(zip(_LENGTHS, numbers[:-1].tolist(), strict=True)))
        poses = ik.forward(taken, angles - (numbers[-1] - 0.5 * np.pi) * _TURNED)
        return np.asarray(ik.wrist_center(taken, poses) - centers).ravel()

    right = np.array([*(getattr(arm, name) for name in _LENGTHS), 0.5 * np.pi])
    before = _distances(missed(right))
    if not tolerance < before.max() < NEAR:
        return None
    numbers, step = right, 1e-4 * np.eye(len(right))
    for _ in range(_ROUNDS):
        slopes = [(missed(numbers + row) - missed(numbers - row)) / 2e-4 for row in step]
        numbers = numbers - np.linalg.lstsq(np.stack(slopes, axis=1), missed(numbers))[0]
    after = _distances(missed(numbers))
    if not after.max() < tolerance:
        return None
    clauses = min((_clauses(form(right), form(numbers)) for form in (_triangle, _table)), key=len)
    text = (
        f"{' and '.join(clauses)}: with that the wrist center is right to {after.max():.0e} m in "
        f"all of {len(before)} answers, without it is off by up to {before.max():.2g} m, and "
        f"{tolerance:g} m is asked for."
    )
    return Diagnosis(key="rounding", text=text[:1].upper() + text[1:])


def _distances(missed: Array) -> Array:
    return np.asarray(np.linalg.norm(missed.reshape(-1, 3), axis=1))


def _table(numbers: Array) -> dict[str, float]:
    a1, d1, a2, a3, d4, quarter = numbers.tolist()
    lengths = {"a1": a1, "d1": d1, "a2": a2, "a3": a3, "d4": d4}
    return {f"the length {name}": value for name, value in lengths.items()} | {"pi/2": quarter}


def _triangle(numbers: Array) -> dict[str, float]:
    """Return the same with the forearm as a formula of theta 3 has it."""
    found = _table(numbers)
    a3, d4 = found.pop("the length a3"), found.pop("the length d4")
    side, sag = "the side from axis 3 to the wrist center", "the sag angle"
    return found | {side: float(np.hypot(a3, d4)), sag: float(np.arctan2(-a3, d4))}


def _clauses(right: dict[str, float], taken: dict[str, float]) -> list[str]:
    """Return a clause for every number that is not the right one."""
    return [
        f"{name} is {taken[name]:.7g} instead of {wanted:.7g}"
        for name, wanted in right.items()
        if abs(taken[name] - wanted) > _SAME
    ]
