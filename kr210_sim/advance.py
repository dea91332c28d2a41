"""Conservative advancement: whole paths of configurations proved free from looks at a few."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from kr210_sim.arrays import Array

_AT_ONCE = 64
"""Configurations looked at together, at most: fewer calls, but more of them than needed."""

_PARTS = 3
"""Configurations of each path looked at to begin with."""

_MOST_PARTS, _MOST_PARTS_ALONE = 4, 2
"""Configurations looked at next in a stretch that is not yet proved, at most: more calls are saved
than looks are lost, but for a path that is asked for alone, as sampling does, mostly in vain."""

_EXPECT = 0.5
"""Configurations looked at next per length that a look has proved beside what it has not."""

_CAUTION = 0.9
"""What is taken of a reach that must be found by trial, where a path bends."""


@dataclass(frozen=True, kw_only=True)
class Stretches:
    """Stretches of polylines that begin where B looks were, E from each of them.

    Attributes:
        change: (B, E, 6) of the joint positions, from its beginning to its end [rad].
        travel: (B, E, 6) of the joints on the way [rad].
        bend: (B, E, 6) how far the joints leave the straight line on the way, at most [rad].
    """

    change: Array
    travel: Array
    bend: Array


Room: TypeAlias = Callable[[Stretches], Array]
"""What looks found free around them. Returns (B, E) at least 1 if nothing can come too near on a
stretch, else the share of it that would be free if it were straight."""

Look: TypeAlias = Callable[[Array], Room | None]
"""Looks at configurations (B, 6). Returns the room around them, None if one is too near."""

LookEach: TypeAlias = Callable[[Array, NDArray[np.int64]], tuple[Room, NDArray[np.bool_]]]
"""Looks at configurations (B, 6), each of the path with an index (B,). Returns the room as `Look`
does, and (B,) whether each is too near; the room around those that are does not count."""


def advance(q: Array, look: Look) -> bool:
    """Tell whether the polyline through configurations (N, 6) is free, all between them included.

    Every look proves a stretch to both sides of itself, and what is not yet proved is looked at
    next: coarse first, so that a blocked path is refused early.
    """

    def look_each(q: Array, _: NDArray[np.int64]) -> tuple[Room, NDArray[np.bool_]]:
        room = look(q)
        near = np.full(len(q), room is None)
        return room or (lambda stretches: np.ones(stretches.change.shape[:2])), near

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
    lines = _Lines(q)
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
        room, near = look(_at(q, middle), which)
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
        reached = lines.reached(middle, ends, room, goes_on)[goes_on]
        middle, ends, which = middle[goes_on], ends[goes_on], which[goes_on]
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


class _Lines:
    """Polylines through configurations (N, 6), one after another."""

    def __init__(self, q: Array) -> None:
        steps = np.diff(q, axis=0)
        travel, self._turns = np.zeros_like(q), np.zeros_like(q)
        np.cumsum(np.abs(steps), axis=0, out=travel[1:])
        np.cumsum(np.abs(np.diff(steps, axis=0)), axis=0, out=self._turns[1:-1])
        self._both = np.concatenate([q, travel], axis=1)

    def reached(self, middle: Array, ends: Array, room: Room, counts: NDArray[np.bool_]) -> Array:
        """Return how far the room around looks proves the lines towards both ends (B, 2).

        Args:
            middle: (B,) positions of the looks.
            ends: (B, 2) how far to go.
            room: around them.
            counts: (B,) whether it does.
        """
        begin = middle[:, None]
        at_begin, aside = _at(self._both, begin), ends - begin
        share = np.ones(ends.shape)
        while True:
            reached = begin + share * aside
            change = _at(self._both, reached) - at_begin
            found = room(
                Stretches(
                    change=change[..., :6],
                    travel=np.abs(change[..., 6:]),
                    bend=self._bend(np.minimum(begin, reached), np.maximum(begin, reached)),
                )
            )
            proved = (found >= 1.0) | ~counts[:, None]
            if np.all(proved):
                return np.where(share == 1.0, ends, reached)
            # At once on a straight piece; where the path bends it takes a few trials.
            less = np.where(share == 1.0, 1.0 - 1e-9, _CAUTION) * found
            share = np.where(proved, share, share * less)

    def _bend(self, low: Array, high: Array) -> Array:
        """Return how far the lines leave the straight one between positions at most (..., 6).

        That is a quarter of what the turns on the way, all in the middle, would make of the length.
        """
        first, last = low.astype(np.int64), np.ceil(high).astype(np.int64) - 1
        turns = self._turns[np.maximum(last, first)] - self._turns[first]
        return np.asarray((high - low)[..., None] / 4.0 * turns)


def _at(rows: Array, position: Array) -> Array:
    """Return the points (..., 6) of the polylines at positions (...) in [0, N - 1]."""
    index = np.minimum(position.astype(np.int64), max(len(rows) - 2, 0))
    share = (position - index)[..., None]
    return np.asarray(
        (1.0 - share) * rows[index] + share * rows[np.minimum(index + 1, len(rows) - 1)]
    )
