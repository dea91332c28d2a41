"""Conservative advancement: a whole path of configurations proved free from looks at a few."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from kr210_sim.arrays import Array

_AT_ONCE = 16
"""Configurations looked at together, at most: fewer calls, but more of them than needed."""

_PARTS = 3
"""Configurations looked at to begin with."""

_CAUTION = 0.9
"""What is taken of a reach that must be found by trial, where a path bends."""

Look = Callable[[Array], Array | None]
"""Looks at configurations (B, 6). Returns weights w (B, P, 6) [1/rad]: from there, nothing can come
too near while each joint travels |dq| with w |dq| <= 1 in all rows; None if one is too near."""


def advance(q: Array, look: Look) -> bool:
    """Tell whether the polyline through configurations (N, 6) is free, all between them included.

    Every look proves a stretch to both sides of itself, and the middle of what is not yet proved
    is looked at next: coarse first, so that a blocked path is refused early.
    """
    travel = np.zeros_like(q)
    np.cumsum(np.abs(np.diff(q, axis=0)), axis=0, out=travel[1:])
    parts = np.linspace(0.0, len(q) - 1.0, _PARTS + 1 if len(q) > 1 else 2)
    waiting = np.stack([parts[:-1], parts[1:]], axis=1)
    while len(waiting):
        ends, waiting = waiting[:_AT_ONCE], waiting[_AT_ONCE:]
        middle = np.mean(ends, axis=1)
        weights = look(_at(q, middle))
        if weights is None:
            return False
        reached = _reached(travel, weights, middle, ends)
        left = np.stack([np.minimum(reached, ends), np.maximum(reached, ends)], axis=2)
        waiting = np.concatenate([waiting, left[reached != ends]])
    return True


def _reached(travel: Array, weights: Array, middle: Array, ends: Array) -> Array:
    """Return how far looks from the middle (B,) prove the polyline towards both ends (B, 2)."""
    origin = _at(travel, middle)[:, None]
    share = np.ones(ends.shape)
    while True:
        reached = middle[:, None] + share * (ends - middle[:, None])
        spent = np.abs(_at(travel, reached) - origin)
        used = np.max(spent @ np.swapaxes(weights, 1, 2), axis=2)
        if np.all(used <= 1.0):
            return np.where(share == 1.0, ends, reached)
        # At once on a straight piece; where the path bends it takes a few trials.
        less = np.where(share == 1.0, 1.0 - 1e-9, _CAUTION) / np.maximum(used, 1.0)
        share = np.where(used <= 1.0, share, share * less)


def _at(rows: Array, position: Array) -> Array:
    """Return the points (..., 6) of the polyline at positions (...) in [0, N - 1]."""
    index = np.minimum(position.astype(np.int64), max(len(rows) - 2, 0))
    share = (position - index)[..., None]
    return np.asarray(
        (1.0 - share) * rows[index] + share * rows[np.minimum(index + 1, len(rows) - 1)]
    )
