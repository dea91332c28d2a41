"""Joint limits: which configurations are inside, and all 2 pi turns that are."""

from __future__ import annotations

import math
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .exceptions import IKError
from .tolerances import LIMIT_SLACK

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]
IntArray = NDArray[np.intp]

TWO_PI = 2.0 * np.pi


class Bounds(NamedTuple):
    """The joints whose limits leave out some angle of [-pi, pi], in the form `inverse` wants.

    For each: joint, lower and upper limit with the slack added [rad], and whether turns can help.
    """

    arm: tuple[tuple[int, float, float, bool], ...]
    """Those among joints 1 to 3."""
    wrist: tuple[tuple[int, float, float, bool], ...]
    """Those among joints 4 to 6."""


class Turns(NamedTuple):
    """Configurations inside of the limits, and where they come from."""

    q: FloatArray
    """Joint angles [rad]. Shape (m, 6)."""
    row: IntArray
    """Row of the given angles, flattened to (n, 6), that each is a turn of. Shape (m,)."""


def check_limits(
    lower: ArrayLike, upper: ArrayLike, velocity: ArrayLike = (1.0,) * 6
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return limits as arrays of six, or say what is wrong with them.

    Args:
        lower: Lower limits [rad]. Shape (6,).
        upper: Upper limits [rad]. Shape (6,).
        velocity: Velocity limits [rad/s]. Shape (6,).

    Returns:
        The three arrays. Shapes (6,).

    Raises:
        IKError: A shape is not (6,), a value is NaN, a lower limit is above its upper limit, or a
            velocity is not positive.
    """
    arrays = [np.asarray(a, dtype=np.float64) for a in (lower, upper, velocity)]
    if any(a.shape != (6,) for a in arrays):
        raise IKError(f"limits must have shape (6,), got {[a.shape for a in arrays]}")
    low, high, v = arrays
    if not (low <= high).all():
        raise IKError(f"lower limits must not be above upper ones: {low} and {high}")
    if not (v > 0.0).all():
        raise IKError(f"velocity limits must be positive, got {v}")
    return low, high, v


def find_bounds(lower: ArrayLike, upper: ArrayLike) -> Bounds | None:
    """List the joints whose limits leave out some angle.

    Args:
        lower: Lower limits [rad]. Shape (6,).
        upper: Upper limits [rad]. Shape (6,).

    Returns:
        None when no joint's limits do.

    Raises:
        IKError: A shape is not (6,), a value is NaN, or a lower limit is above its upper limit.
    """
    low, high = np.asarray(lower, dtype=np.float64), np.asarray(upper, dtype=np.float64)
    return _bounds_of(low.tobytes(), high.tobytes(), low.shape, high.shape)


@lru_cache(maxsize=64)
def _bounds_of(
    lower: bytes, upper: bytes, shape: tuple[int, ...], other_shape: tuple[int, ...]
) -> Bounds | None:
    """Do the work of `find_bounds`; cached, as it would take as long as half a pose."""
    if shape != (6,) or other_shape != (6,):
        raise IKError(f"limits must have shape (6,), got {shape} and {other_shape}")
    low, high, _ = check_limits(np.frombuffer(lower), np.frombuffer(upper))
    bounds = [
        (j, a, b, a <= -math.pi or b >= math.pi)
        for j, (a, b) in enumerate(
            zip((low - LIMIT_SLACK).tolist(), (high + LIMIT_SLACK).tolist(), strict=True)
        )
        if a > -math.pi or b < math.pi
    ]
    if not bounds:
        return None
    return Bounds(tuple(b for b in bounds if b[0] < 3), tuple(b for b in bounds if b[0] >= 3))


def within_limits(
    q: ArrayLike, lower: ArrayLike, upper: ArrayLike, slack: float = LIMIT_SLACK
) -> BoolArray:
    """Tell which configurations are inside of the joint limits as they are, without turns.

    Args:
        q: Joint angles [rad]; NaN is outside. Shape (..., 6).
        lower: Lower limits [rad], -inf for none. Shape (6,).
        upper: Upper limits [rad], +inf for none. Shape (6,).
        slack: How far outside still counts as inside [rad].

    Returns:
        Shape (...).

    Raises:
        IKError: Limits have a wrong shape or value.
    """
    low, high, _ = check_limits(lower, upper)
    angles = np.asarray(q, dtype=np.float64)
    inside = (angles >= low - slack) & (angles <= high + slack)
    return np.asarray(inside.all(axis=-1))


def turns(q: ArrayLike, lower: ArrayLike, upper: ArrayLike, slack: float = LIMIT_SLACK) -> Turns:
    """List every copy q + 2 pi k, k one whole number per joint, that is inside of the limits.

    Args:
        q: Joint angles [rad]; rows with NaN have no copies. Shape (..., 6).
        lower: Lower limits [rad], finite. Shape (6,).
        upper: Upper limits [rad], finite. Shape (6,).
        slack: How far outside still counts as inside [rad].

    Returns:
        The copies, ordered by row, and within a row by k with joint 1 slowest.

    Raises:
        IKError: A limit is not finite (the copies would be without number) or otherwise wrong.
    """
    rows = np.asarray(q, dtype=np.float64).reshape(-1, 6)
    low, high, _ = check_limits(lower, upper)
    if not (np.isfinite(low).all() and np.isfinite(high).all()):
        raise IKError("turns need finite limits; give a continuous joint a range such as +-2 pi")
    row = np.flatnonzero(~np.isnan(rows).any(axis=1))
    rows = rows[row]
    for j in range(6):
        first = np.ceil((low[j] - slack - rows[:, j]) / TWO_PI).astype(np.intp)
        last = np.floor((high[j] + slack - rows[:, j]) / TWO_PI).astype(np.intp)
        count = np.maximum(last - first + 1, 0)
        start = np.repeat(np.cumsum(count) - count, count)
        k = np.repeat(first, count) + np.arange(len(start)) - start
        rows, row = np.repeat(rows, count, axis=0), np.repeat(row, count)
        rows[:, j] += TWO_PI * k
    return Turns(rows, row)
