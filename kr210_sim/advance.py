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
"""Configurations of a path looked at to begin with, if it is one to choose from or asked for alone:
coarse, for it is often blocked."""

_SPACING, _MOST_SPACED = 0.15, 9
"""Travel of all joints between such configurations [rad], and how many there are at most, where
several paths must all be free: then each mostly is."""

_MOST_PARTS, _MOST_PARTS_ALONE = 6, 2
"""Configurations looked at next in a stretch that is not yet proved, at most: more calls are saved
than looks are lost, but for a path that is asked for alone, as sampling does, mostly in vain."""

_EXPECT = 0.5
"""Configurations looked at next per length that a look has proved beside what it has not."""

_CAUTION = 0.9
"""What is taken of a reach that must be found by trial, where a path bends."""


@dataclass(frozen=True, kw_only=True)
class Stretches:
    """Stretches of polylines that begin where B looks were, E from each of them.

    Joints come first, here and wherever numpy reduces over them: over a short last axis it is slow.

    Attributes:
        change: (6, E, B) of the joint positions, from its beginning to its end [rad].
        travel: (6, E, B) of the joints on the way [rad].
        bend: (6, E, B) how far the joints leave the straight line on the way, at most [rad].
    """

    change: Array
    travel: Array
    bend: Array


Room: TypeAlias = Callable[[Stretches], Array]
"""What looks found free around them. Returns (E, B) at least 1 if nothing can come too near on a
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
        return room or (lambda stretches: np.ones(stretches.change.shape[1:])), near

    return bool(advance_each([q], look_each)[0])


def advance_each(
    paths: Sequence[Array], look: LookEach, choice: NDArray[np.int64] | None = None
) -> NDArray[np.bool_]:
    """Tell of each of some polylines (N, 6) whether it is free, as `advance` does of one.

    They are looked at together. One that turns out to be blocked is not looked at any more.

    Args:
        paths: the polylines.
        look: at configurations.
        choice: (P,) number of the choice each is offered to, ascending, where one will do; by
            default each stands alone. The first of each that is not blocked is looked at, the
            others only as far along as one was blocked; what comes after one that is free does not
            count as free.
    """
    if not paths:
        return np.ones(0, dtype=bool)
    choice = np.arange(len(paths)) if choice is None else choice
    q = np.concatenate(paths)  # positions count through all of them, stretches never span two
    count = np.array([len(path) for path in paths])
    last = count.cumsum() - 1
    begin = last + 1 - count
    lines = _Lines(q)
    free = np.ones(len(paths), dtype=bool)
    first = _first(free, choice)
    most = _MOST_PARTS if len(paths) > 1 else _MOST_PARTS_ALONE
    parts = np.where((count > 1) & first, _PARTS, 1)
    if len(paths) > 1:
        spaced = np.ceil(lines.travel(begin, last) / _SPACING).clip(1, _MOST_SPACED)
        parts = np.where(np.bincount(choice)[choice] == 1, spaced, parts).astype(np.int64)
    waiting, owner = _divided(begin, last, parts, np.arange(len(paths)))
    urgent = np.zeros(len(owner), dtype=bool)
    while True:
        turn = (urgent | first[owner]).nonzero()[0][:_AT_ONCE]
        if not len(turn):
            return first
        which, now = owner[turn], waiting[:, turn]
        ends, middle = now[:2], now[2]
        room, near = look(lines.at(middle), which)
        stays = np.ones(len(owner), dtype=bool)
        stays[turn] = False
        if near.any():
            free[which[near]] = False
            first = _first(free, choice)
            stays &= free[owner]
        waiting, owner, urgent = waiting[:, stays], owner[stays], urgent[stays]
        for path, position in zip(which[near].tolist(), middle[near].tolist(), strict=True):
            # There the others of its choice are mostly blocked as well.
            share = (position - begin[path]) / max(count[path] - 1, 1)
            there = begin[owner] + share * (count[owner] - 1)
            hit = (choice[owner] == choice[path]) & ~urgent
            hit &= (waiting[0] <= there) & (there <= waiting[1])
            waiting[2, hit] = there[hit]
            urgent |= hit
        goes_on = free[which]
        reached = lines.reached(middle, ends, room, goes_on)
        more, whose = _left(middle, ends, reached, np.where(goes_on, which, -1), most)
        waiting = np.concatenate([waiting, more], axis=1)
        owner = np.concatenate([owner, whose])
        urgent = np.concatenate([urgent, np.zeros(len(whose), dtype=bool)])


def _left(
    middle: Array, ends: Array, reached: Array, owner: NDArray[np.int64], most: int
) -> tuple[Array, NDArray[np.int64]]:
    """Return what looks did not reach, divided as by `_divided`.

    Args:
        middle: (B,) positions of the looks.
        ends: (2, B) how far they should reach.
        reached: (2, B) how far they do.
        owner: (B,) of the stretches; -1 if it does not matter any more.
        most: parts that a stretch is divided into.
    """
    side, index = ((reached != ends) & (owner >= 0)).nonzero()
    middle, end, reached = middle[index], ends[side, index], reached[side, index]
    # What a look reached there it will reach about again.
    further = np.abs(end - reached) / np.maximum(np.abs(reached - middle), 1e-12)
    parts = np.ceil(_EXPECT * further).clip(1, most).astype(np.int64)
    return _divided(np.minimum(reached, end), np.maximum(reached, end), parts, owner[index])


def _first(free: NDArray[np.bool_], choice: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Return which of some paths is the first free one of its choice, choices ascending."""
    first = np.zeros(len(free), dtype=bool)
    index = free.nonzero()[0]
    of_index = choice[index]
    begins = np.ones(len(index), dtype=bool)
    np.not_equal(of_index[1:], of_index[:-1], out=begins[1:])
    first[index[begins]] = True
    return first


def _divided(
    begin: Array, end: Array, parts: NDArray[np.int64], owner: NDArray[np.int64]
) -> tuple[Array, NDArray[np.int64]]:
    """Return stretches that divide each of some (K,) into parts, and their owners.

    A stretch has its ends, and where in it to look (3, W).
    """
    index = np.arange(len(parts)).repeat(parts)
    number = np.arange(len(index)) - (parts.cumsum() - parts)[index]
    begin, end, parts = begin[index], end[index], parts[index]
    step = (end - begin) / parts
    lower = begin + step * number
    upper = np.where(number + 1 == parts, end, lower + step)
    return np.array([lower, upper, (lower + upper) / 2]), owner[index]


class _Lines:
    """Polylines through configurations (N, 6), one after another."""

    def __init__(self, q: Array) -> None:
        # Positions and what the joints have travelled (12, N); (6, N) what they have turned.
        steps = np.diff(q.T)
        self._both, self._turns = np.zeros((12, len(q))), np.zeros((6, len(q)))
        self._both[:6] = q.T
        np.cumsum(np.abs(steps), axis=1, out=self._both[6:, 1:])
        np.cumsum(np.abs(np.diff(steps)), axis=1, out=self._turns[:, 1:-1])

    def at(self, position: Array) -> Array:
        """Return the configurations (B, 6) at positions (B,) in [0, N - 1]."""
        return np.ascontiguousarray(self._at(position)[:6].T)

    def travel(self, begin: NDArray[np.int64], end: NDArray[np.int64]) -> Array:
        """Return how far all joints together travel between points [rad]."""
        return np.asarray((self._both[6:, end] - self._both[6:, begin]).sum(axis=0))

    def reached(self, middle: Array, ends: Array, room: Room, counts: NDArray[np.bool_]) -> Array:
        """Return how far the room around looks proves the lines towards both ends (2, B).

        Args:
            middle: (B,) positions of the looks.
            ends: (2, B) how far to go.
            room: around them.
            counts: (B,) whether it does.
        """
        at_begin, aside = self._at(middle)[:, None], ends - middle
        share, reached = np.ones(ends.shape), ends
        while True:
            change = self._at(reached) - at_begin
            low, high = np.minimum(middle, reached), np.maximum(middle, reached)
            travel, bend = np.abs(change[6:]), self._bend(low, high)
            found = room(Stretches(change=change[:6], travel=travel, bend=bend))
            proved = (found >= 1.0) | ~counts
            # Known at once on a straight piece; where the path bends it takes a few trials.
            less = np.where(share == 1.0, 1.0 - 1e-9, _CAUTION) * found
            share = np.where(proved, share, share * less)
            reached = np.where(share == 1.0, ends, middle + share * aside)
            if (proved | ~bend.any(axis=0)).all():
                return reached

    def _bend(self, low: Array, high: Array) -> Array:
        """Return how far the lines leave the straight one between positions at most (6, ...).

        That is a quarter of what the turns on the way, all in the middle, would make of the length.
        """
        first, last = low.astype(np.int64), np.ceil(high).astype(np.int64) - 1
        turns = self._turns.take(np.maximum(last, first), axis=1) - self._turns.take(first, axis=1)
        return np.asarray((high - low) / 4.0 * turns)

    def _at(self, position: Array) -> Array:
        """Return the points (12, ...) at positions (...) in [0, N - 1]."""
        index = np.minimum(position.astype(np.int64), max(self._both.shape[1] - 2, 0))
        share = position - index
        here = self._both.take(index, axis=1)
        after = self._both.take(np.minimum(index + 1, self._both.shape[1] - 1), axis=1)
        return np.asarray((1.0 - share) * here + share * after)
