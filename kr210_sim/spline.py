"""Even samples -> the pieces of the quintic spline through them."""

from __future__ import annotations

from functools import cache
from math import factorial

import numpy as np

from kr210_sim.arrays import Array

DEGREE = 5
"""Quintic splines: the third derivative, from which jerk follows, is smooth."""


@cache
def pieces(samples: int) -> tuple[Array, Array]:
    """Return what makes the pieces of the spline through samples at x = 0, 1, 2, ...

    The spline is linear in the samples. It has no knot at the first three and the last three of
    them ("not a knot": de Boor, A Practical Guide to Splines, 2001, chapter IV), so its first and
    last pieces are three long.

    Args:
        samples: how many they are, N >= 6.

    Returns:
        (DEGREE + 1, N - DEGREE, N): times the samples, what multiplies the powers of x - begin in
        each piece; and (N - DEGREE,) the begins.
    """
    x = np.arange(float(samples))
    knots = np.concatenate([np.zeros(DEGREE + 1), x[3:-3], np.full(DEGREE + 1, x[-1])])
    begins = knots[DEGREE : -DEGREE - 1]
    coefficients = np.linalg.inv(_basis(knots, x, DEGREE))
    found = []
    for power in range(DEGREE + 1):
        degree = DEGREE - power
        found.append(_basis(knots, begins, degree) @ coefficients / factorial(power))
        if degree:  # de Boor, chapter X (15)
            width = knots[degree + 1 : -1] - knots[1 : -degree - 1]
            coefficients = degree * np.diff(coefficients, axis=0) / width[:, None]
            knots = knots[1:-1]
    return np.array(found), begins


def _basis(knots: Array, x: Array, degree: int) -> Array:
    """Return the B-splines of that degree at x (M,), each of the last knots included: (M, n).

    By the recurrence of Cox and de Boor (de Boor, chapter IX (14)).
    """
    last = len(knots) - degree - 2  # the last piece that is not empty
    piece = np.minimum(np.searchsorted(knots, x, side="right") - 1, last)
    basis = np.zeros((len(x), len(knots) - 1))
    basis[np.arange(len(x)), piece] = 1.0
    for order in range(1, degree + 1):
        width = knots[order:] - knots[:-order]
        shares = basis / np.where(width > 0.0, width, 1.0)
        rising = (x[:, None] - knots[: -order - 1]) * shares[:, :-1]
        falling = (knots[order + 1 :] - x[:, None]) * shares[:, 1:]
        basis = rising + falling
    return basis
