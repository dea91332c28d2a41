"""Paths + limits -> Trajectory: jerk-limited time laws by ruckig, overlapped at corners."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import TypeAlias

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from kr210_sim.arrays import Array
from kr210_sim.limits import (
    MotionLimits,
    about_peaks,
    around,
    shift,
    slices,
    states,
    states_of,
    usages,
)
from kr210_sim.path import Path
from kr210_sim.path_law import quickest_laws
from kr210_sim.time_law import TimeLaw

_CHECK_RATE = 1000.0  # [Hz]
_GLANCES = 16  # instants at which overlaps are compared with the limits at first
_BLOCK = 64  # overlaps that are compared together
_SHARE = 0.75  # of a motion, at most, that overlaps the one before it
_SHRINK = 0.8  # of an overlap that is not clear

Free: TypeAlias = Callable[[Sequence[tuple[int, int, Array]]], Sequence[bool]]
"""Tells of rounded corners whether they keep their clearance: each is the number of a chain, the
number k of a corner, between its paths k and k + 1, and configurations (N, 6) in small steps."""


class Trajectory:
    """Motions from rest to rest, each begun before the one before has ended.

    q(t) = q_1(t) + sum_k (q_k(t - start_k) - q_k(0)): while two overlap, one brakes and the next
    speeds up, and their sum rounds the corner between their paths. Scaling all limits by a time
    factor scales starts and durations alike, so the curve in space does not depend on the speed.

    Attributes:
        paths: of the motions, in order; each begins where the one before ends.
        starts, ends: when each begins and ends [s].
        duration: of the whole [s].
    """

    def __init__(self, paths: Sequence[Path], laws: Sequence[TimeLaw], starts: Sequence[float]):
        self.paths, self._laws = tuple(paths), tuple(laws)
        self.starts = np.array(starts, dtype=float)
        self.ends = self.starts + [law.duration for law in laws]
        self.duration = float(self.ends[-1])

    def slowed(self, share: float) -> Trajectory:
        """Return the same curve in 1 / share of the time."""
        return Trajectory(
            self.paths, [law.slowed(share) for law in self._laws], (self.starts / share).tolist()
        )

    @property
    def end(self) -> Array:
        """Last configuration (6,) [rad]."""
        return self.paths[-1].end

    def part_at(self, t: float) -> int:
        """Return which motion is under way at a time [s]; in an overlap, from its middle on."""
        changes = (self.ends[:-1] + self.starts[1:]) / 2
        return int(np.searchsorted(changes, t, side="right"))

    def __call__(self, t: Array) -> tuple[Array, Array, Array]:
        """Return q, qd, qdd, each (N, 6) [rad, rad/s, rad/s^2], at times t (N,) [s]."""
        q, qd, qdd, _ = self.derivatives(t)
        return q, qd, qdd

    def positions(self, t: Array) -> Array:
        """Return q (N, 6) [rad] at times t (N,) [s]."""
        q = np.repeat(self.paths[0].start[:, None], len(t), axis=1)
        for path, law, start in zip(self.paths, self._laws, self.starts, strict=True):
            q += shift(path, law, t - start)
        return np.ascontiguousarray(q.T)

    def motion(self, t: Array) -> tuple[Array, Array]:
        """Return q and qd, each (N, 6) [rad, rad/s], at times t (N,) [s]: all that servos need."""
        q, qd = np.tile(self.paths[0].start, (len(t), 1)), np.zeros((len(t), 6))
        for path, law, start in zip(self.paths, self._laws, self.starts, strict=True):
            begun = t > start
            if np.any(begun):
                s, ds, _, _ = law(t[begun] - start)
                q[begun] += path(s) - path.start
                qd[begun] += path(s, 1) * ds[:, None]
        return q, qd

    def derivatives(self, t: Array) -> tuple[Array, Array, Array, Array]:
        """Return q and its first three derivatives, each (N, 6), at times t (N,) [s]."""
        q, qd, qdd, qddd = np.ascontiguousarray(self._states(t).transpose(0, 2, 1))
        return q, qd, qdd, qddd

    def _states(self, t: Array) -> Array:
        """Return q and its first three derivatives (4, 6, N) at times t (N,) [s]."""
        t = np.asarray(t, dtype=float)
        total = np.zeros((4, 6, len(t)))
        total[0] = self.paths[0].start[:, None]
        for path, law, start in zip(self.paths, self._laws, self.starts, strict=True):
            begun = t > start
            if np.any(begun):
                total[:, :, begun] += states(path, law, t[begun] - start)
        return total

    def usage(self, limits: MotionLimits) -> tuple[float, float, float]:
        """Return the largest |qd|/v, |qdd|/a and |qddd|/j; 1 is at the limit.

        On a 1 kHz grid, and on both sides of every instant at which a jerk jumps.
        """
        t = np.linspace(0.0, self.duration, int(np.ceil(self.duration * _CHECK_RATE)) + 1)
        t = np.concatenate([t, self.jumps()])
        v, a, j = np.max(usages(self._states(t)[1:], limits), axis=1, initial=0.0).tolist()
        return v, a, j

    def jumps(self) -> Array:
        """Return times (N,) on both sides of every instant at which a jerk jumps [s]."""
        changes = zip(self._laws, self.starts, strict=True)
        return around(np.concatenate([start + law.changes for law, start in changes]))


def time_path(path: Path, limits: MotionLimits) -> Trajectory:
    """Return the trajectory of one path, from rest to rest."""
    return Trajectory([path], quickest_laws([path], limits), [0.0])


def time_paths(
    paths: Sequence[Path],
    limits: MotionLimits,
    free: Callable[[int, Array], bool] = lambda corner, q: True,
) -> Trajectory:
    """Return the trajectory of one chain of paths, as `time_chains` does of some.

    Args:
        paths: of the chain.
        limits: of the joints.
        free: tells whether configurations (N, 6) around corner k keep their clearance.
    """
    return time_chains([paths], limits, lambda asked: [free(k, q) for _, k, q in asked])[0]


def time_chains(
    chains: Sequence[Sequence[Path]], limits: MotionLimits, free: Free
) -> list[Trajectory]:
    """Return the trajectories of chains of paths, each without a stop in between.

    Neighbours overlap in time as far as the joint limits hold and the rounded corner is free.

    Args:
        chains: in each, a path begins where the one before ends.
        limits: of the joints.
        free: tells of some rounded corners whether they keep their clearance.
    """
    # From rest to rest, the quickest law is the same there and back.
    alike = {id(path.there): path.there for paths in chains for path in paths}
    laws_of = quickest_laws(list(alike.values()), limits)
    quickest = dict(zip(alike, laws_of, strict=True))
    laws = [[quickest[id(path.there)] for path in paths] for paths in chains]
    corners = [
        [
            _Corner(paths[k : k + 2], of_chain[k : k + 2], limits, last=k == len(paths) - 2)
            for k in range(len(paths) - 1)
        ]
        for paths, of_chain in zip(chains, laws, strict=True)
    ]
    _round(corners, limits)
    asked = [
        (chain, index, corner)
        for chain, of_chain in enumerate(corners)
        for index, corner in enumerate(of_chain)
    ]
    while asked := [one for one in asked if one[2].overlap > 0]:
        answers = free([(chain, index, corner.rounded) for chain, index, corner in asked])
        asked = [one for one, is_free in zip(asked, answers, strict=True) if not is_free]
        _narrow([(corner, int(corner.overlap * _SHRINK)) for _, _, corner in asked], limits)
    found = []
    for paths, of_chain, own in zip(chains, laws, corners, strict=True):
        changes = [
            law.duration - limits.step * corner.overlap
            for law, corner in zip(of_chain[:-1], own, strict=True)
        ]
        found.append(Trajectory(paths, of_chain, np.cumsum([0.0, *changes]).tolist()))
    return found


class _Corner:
    """Two motions, the second of which begins before the first has ended.

    Attributes:
        paths, laws: of the two.
        reach: for how many steps they may overlap if no motion before them does.
        overlap: for how many they do, 0 until it is narrowed.
    """

    def __init__(
        self, paths: Sequence[Path], laws: Sequence[TimeLaw], limits: MotionLimits, *, last: bool
    ) -> None:
        self.paths, self.laws, self._step = paths, laws, limits.step
        # Three motions never overlap at once; the next corner shall have its share as well.
        self._share = 1.0 if last else _SHARE
        self.reach = self.most(0.0)
        self.overlap = 0

    def most(self, taken: float) -> int:
        """Return for how many steps they may overlap if `taken` [s] of the first has done so."""
        before, after = self.laws
        return int(min(before.duration - taken, after.duration * self._share) / self._step)

    def steps(self) -> tuple[Array, Array]:
        """Return the last times (reach + 1,) of the first and the first of the second [s]."""
        steps = self._step * np.arange(self.reach + 1)
        return self.laws[0].duration - steps[::-1], steps

    def meet(self, first: Array, second: Array) -> None:
        """Take the states (4, 6, reach + 1) of both at the `steps`."""
        self._first, self._second = first, second

    def begin(self, most: int, limits: MotionLimits) -> None:
        """Start over with all overlaps of up to `most` steps."""
        first, second = self._first[1:, :, -1 - most :], self._second[1:, :, : most + 1]
        self._used = first / limits.orders, second / limits.orders
        self._hopeful = _hopeful(*self._used)

    @property
    def rounded(self) -> Array:
        """The configurations (N, 6) while they overlap, step by step [rad]."""
        there = _meeting(self._first[0], self._second[0], self.overlap)
        return np.asarray(self.paths[0].start + there.T)

    def narrow(self, most: int) -> bool:
        """Go on to the next overlap, of `most` steps at most, whose steps hold the limits."""
        for overlap in self._hopeful:
            if overlap <= most:
                used = np.max(np.abs(_meeting(*self._used, overlap)), axis=1)
                if np.max(used) <= 1.0:
                    self.overlap, self._at_steps = overlap, used
                    return True
        self.overlap = 0
        return False

    def instants(self) -> tuple[Array, Array]:
        """Return when to look between the steps and where a jerk jumps, in the time of each [s]."""
        before, after = self.laws
        start = before.duration - self._step * self.overlap
        jumps = around(np.concatenate([before.changes, start + after.changes]))
        steps = start + self._step * np.arange(self._at_steps.shape[1])
        t = np.concatenate([jumps, about_peaks(steps, self._at_steps)])
        t = t[(t > start) & (t < before.duration)]
        return t, t - start


def _round(chains: Sequence[Sequence[_Corner]], limits: MotionLimits) -> None:
    """Round the corners of chains as far as the limits hold, one after the other in each."""
    every = [corner for corners in chains for corner in corners]
    if every:
        both = _moving(every, [corner.steps() for corner in every])
        for corner, (first, second) in zip(every, both, strict=True):
            corner.meet(first, second)
    for k in range(max(map(len, chains), default=0)):
        asked = []
        for corners in chains:
            if k < len(corners):
                most = corners[k].most(limits.step * corners[k - 1].overlap if k else 0.0)
                corners[k].begin(most, limits)
                asked.append((corners[k], most))
        _narrow(asked, limits)


def _narrow(asked: Sequence[tuple[_Corner, int]], limits: MotionLimits) -> None:
    """Narrow corners to the next overlap that holds the limits and is not above what is asked."""
    while asked := [(corner, most) for corner, most in asked if corner.narrow(most)]:
        corners = [corner for corner, _ in asked]
        both = _moving(corners, [corner.instants() for corner in corners])
        asked = [
            one
            for one, (first, second) in zip(asked, both, strict=True)
            if np.max(usages(first[1:] + second[1:], limits), initial=0.0) > 1.0
        ]


def _moving(
    corners: Sequence[_Corner], times: Sequence[tuple[Array, Array]]
) -> list[tuple[Array, Array]]:
    """Return the states (4, 6, N) of both motions of corners, each at its own times (N,) [s]."""
    paths = [path for corner in corners for path in corner.paths]
    laws = [law for corner in corners for law in corner.laws]
    found = states_of(paths, laws, [t for both in times for t in both])
    parts = slices([len(t) for both in times for t in both])
    return [
        (found[:, :, first], found[:, :, second])
        for first, second in zip(parts[::2], parts[1::2], strict=True)
    ]


def _meeting(first: Array, second: Array, overlap: int) -> Array:
    """Return the sum of the last steps of one motion and the first of the next, (..., steps)."""
    return np.asarray(first[..., -1 - overlap :] + second[..., : overlap + 1])


def _hopeful(first: Array, second: Array) -> Iterator[int]:
    """Yield the overlaps, longest first, that hold the limits at some instants at least.

    Args:
        first: (3, 6, N) derivatives of a motion in its last steps, as shares of their limits.
        second: (3, 6, N) of the one after it, in its first steps.
    """
    most = first.shape[2] - 1
    first, second = first.reshape(18, -1), second.reshape(18, -1)
    counts = np.max(np.abs(first), axis=1) + np.max(np.abs(second), axis=1) > 1.0
    apart = most // _GLANCES + 1
    second = second[counts, ::apart, None]
    # Step i of the second meets step i + k of the first if they overlap in all but k steps; after
    # its end a motion is at rest.
    ended = np.zeros((len(second), (second.shape[1] - 1) * apart))
    first = np.concatenate([first[counts], ended], axis=1)
    meeting = sliding_window_view(first, most + 1, axis=1)[:, ::apart]
    for less in range(0, most, _BLOCK):
        total = meeting[:, :, less : less + _BLOCK] + second
        used = np.max(np.abs(total, out=total), axis=(0, 1), initial=0.0)
        for more in np.flatnonzero(used[: most - less] <= 1.0).tolist():
            yield most - less - more
