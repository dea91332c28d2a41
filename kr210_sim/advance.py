"""Conservative advancement: whole paths of configurations proved free from looks at a few."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from kr210_sim.arrays import Array

_AT_ONCE = 64
"""Configurations looked at together, at most: fewer calls, but more of them than needed."""

_PARTS = 5
"""Configurations of each path looked at to begin with."""

_MOST_PARTS, _MOST_PARTS_ALONE = 4, 2
"""Configurations looked at next in a stretch that is not yet proved, at most: more calls are saved
than looks are lost, but for a path that is asked for alone, as sampling does, mostly in vain."""

_EXPECT = 0.5
"""Configurations looked at next per length that a look has proved beside what it has not."""

_CAUTION = 0.9
"""What is taken of a reach that must be found by trial, where a path bends."""

Weights: TypeAlias = tuple[Array, Array]
"""Rows (B, P, 6) and sets of rows (B, S, R, 6) of weights w [1/rad]: nothing can come too near
while each joint travels |dq| with w |dq| <= 1 in all rows and in all those of one of the sets."""

Look: TypeAlias = Callable[[Array], Weights | None]
"""Looks at configurations (B, 6). Returns weights from there, None if one is too near."""

LookEach: TypeAlias = Callable[[Array, NDArray[np.int64]], tuple[Weights, NDArray[np.bool_]]]
"""Looks at configurations (B, 6), each of the path with an index (B,). Returns weights as `Look`
does, and (B,) whether each is too near; the weights of those that are do not count."""


def advance(q: Array, look: Look) -> bool:
    """Tell whether the polyline through configurations (N, 6) is free, all between them included.

    Every look proves a stretch to both sides of itself, and what is not yet proved is looked at
    next: coarse first, so that a blocked path is refused early.
    """

    def look_each(q: Array, _: NDArray[np.int64]) -> tuple[Weights, NDArray[np.bool_]]:
        weights = look(q)
        if weights is None:
            none = np.zeros((len(q), 1, 1, 6))
            return (none[:, 0], none), np.ones(len(q), dtype=bool)
        return weights, np.zeros(len(q), dtype=bool)

    return bool(advance_each([q], look_each)[0])


def advance_each(
    paths: Sequence[Array], look: LookEach, choice: NDArray[np.int64] | None = None
) -> NDArray[np.bool_]:
    """Tell of each of some polylines (N, 6) whether it is free, as `advance` does of one.

    They are looked at together. One that turns out to be blocked is not looked at any more.

    Args:
        paths: the polylines.
        look: at configurations.
        choice: (P,) number of the choice each is offered to, where one will do; by default each
            stands alone. The first of each that is not blocked is looked at, the others only as far
            along as one was blocked; what comes after one that is free does not count as free.
    """
    if not paths:
        return np.ones(0, dtype=bool)
    choice = np.arange(len(paths)) if choice is None else choice
    q = np.concatenate(paths)  # positions count through all of them, stretches never span two
    count = np.array([len(path) for path in paths])
    last = np.cumsum(count) - 1
    begin = last + 1 - count
    travel = np.zeros_like(q)
    np.cumsum(np.abs(np.diff(q, axis=0)), axis=0, out=travel[1:])
    free = np.ones(len(paths), dtype=bool)
    most = _MOST_PARTS if len(paths) > 1 else _MOST_PARTS_ALONE
    parts = np.where((count > 1) & _first(free, choice), _PARTS, 1)
    waiting, owner = _divided(np.stack([begin, last], axis=1), parts, np.arange(len(paths)))
    urgent = np.zeros(len(waiting), dtype=bool)
    while True:
        first = _first(free, choice)
        turn = np.flatnonzero(urgent | first[owner])[:_AT_ONCE]
        if not len(turn):
            return first
        which, ends, middle = owner[turn], waiting[turn, :2], waiting[turn, 2]
        (rows, sets), near = look(_at(q, middle), which)
        free[which[near]] = False
        stays = free[owner]
        stays[turn] = False
        waiting, owner, urgent = waiting[stays], owner[stays], urgent[stays]
        for path, position in zip(which[near].tolist(), middle[near].tolist(), strict=True):
            # There the others of its choice are mostly blocked as well.
            share = (position - begin[path]) / max(count[path] - 1, 1)
            there = begin[owner] + share * (count[owner] - 1)
            hit = (choice[owner] == choice[path]) & ~urgent
            hit &= (waiting[:, 0] <= there) & (there <= waiting[:, 1])
            waiting[hit, 2] = there[hit]
            urgent |= hit
        goes_on = free[which]
        middle, ends, which = middle[goes_on], ends[goes_on], which[goes_on]
        reached = _reached(travel, (rows[goes_on], sets[goes_on]), middle, ends)
        left = np.stack([np.minimum(reached, ends), np.maximum(reached, ends)], axis=2)
        # What a look reached there it will reach about again.
        further = np.abs(ends - reached) / np.maximum(np.abs(reached - middle[:, None]), 1e-12)
        is_left = reached != ends
        parts = np.clip(np.ceil(_EXPECT * further[is_left]), 1, most).astype(np.int64)
        more, whose = _divided(left[is_left], parts, np.repeat(which[:, None], 2, axis=1)[is_left])
        waiting, owner = np.concatenate([waiting, more]), np.concatenate([owner, whose])
        urgent = np.concatenate([urgent, np.zeros(len(more), dtype=bool)])


def _first(free: NDArray[np.bool_], choice: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Return which of some paths is the first free one of its choice."""
    first = np.zeros(len(free), dtype=bool)
    index = np.flatnonzero(free)
    first[index[np.unique(choice[index], return_index=True)[1]]] = True
    return first


def _divided(
    ends: Array, parts: NDArray[np.int64], owner: NDArray[np.int64]
) -> tuple[Array, NDArray[np.int64]]:
    """Return stretches that divide each of some (K, 2) into parts, and their owners.

    A stretch (W, 3) has its ends, and where in it to look.
    """
    index = np.repeat(np.arange(len(ends)), parts)
    number = np.arange(len(index)) - np.repeat(np.cumsum(parts) - parts, parts)
    begin, end = ends[index].T
    lower = begin + (end - begin) * (number / parts[index])
    upper = begin + (end - begin) * ((number + 1) / parts[index])
    upper = np.where(number + 1 == parts[index], end, upper)
    return np.stack([lower, upper, (lower + upper) / 2], axis=1), owner[index]


def _reached(travel: Array, weights: Weights, middle: Array, ends: Array) -> Array:
    """Return how far looks from the middle (B,) prove the polylines towards both ends (B, 2)."""
    origin = _at(travel, middle)[:, None]
    aside = ends - middle[:, None]
    rows, sets = weights
    transposed = np.swapaxes(rows, 1, 2)
    beside = np.swapaxes(sets.reshape(len(sets), sets.shape[1] * sets.shape[2], 6), 1, 2)
    share = np.ones(ends.shape)
    while True:
        reached = middle[:, None] + share * aside
        spent = np.abs(_at(travel, reached) - origin)
        used = np.max(spent @ transposed, axis=2, initial=0.0)
        in_sets = np.max((spent @ beside).reshape(*used.shape, *sets.shape[1:3]), axis=3)
        np.maximum(used, np.min(in_sets, axis=2), out=used)
        if np.all(used <= 1.0):
            return np.where(share == 1.0, ends, reached)
        # At once on a straight piece; where the path bends it takes a few trials.
        less = np.where(share == 1.0, 1.0 - 1e-9, _CAUTION) / np.maximum(used, 1.0)
        share = np.where(used <= 1.0, share, share * less)


def _at(rows: Array, position: Array) -> Array:
    """Return the points (..., 6) of the polylines at positions (...) in [0, N - 1]."""
    index = np.minimum(position.astype(np.int64), max(len(rows) - 2, 0))
    share = (position - index)[..., None]
    return np.asarray(
        (1.0 - share) * rows[index] + share * rows[np.minimum(index + 1, len(rows) - 1)]
    )
