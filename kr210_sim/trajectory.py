"""Paths + limits -> Trajectory: jerk-limited time laws by ruckig, overlapped at corners."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import TypeAlias

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from kr210_sim.arrays import Array
from kr210_sim.limits import MotionLimits, about_peaks, around, shift, states, usages
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
    corners = [list(_corners(*chain, limits)) for chain in zip(chains, laws, strict=True)]
    asked = [
        (chain, index, corner)
        for chain, of_chain in enumerate(corners)
        for index, corner in enumerate(of_chain)
    ]
    while asked := [one for one in asked if one[2].overlap > 0]:
        answers = free([(chain, index, corner.rounded) for chain, index, corner in asked])
        asked = [one for one, is_free in zip(asked, answers, strict=True) if not is_free]
        for _, _, corner in asked:
            corner.narrow(int(corner.overlap * _SHRINK))
    found = []
    for paths, of_chain, own in zip(chains, laws, corners, strict=True):
        changes = [
            law.duration - limits.step * corner.overlap
            for law, corner in zip(of_chain[:-1], own, strict=True)
        ]
        found.append(Trajectory(paths, of_chain, np.cumsum([0.0, *changes]).tolist()))
    return found


def _corners(
    paths: Sequence[Path], laws: Sequence[TimeLaw], limits: MotionLimits
) -> Iterator[_Corner]:
    """Yield the corners between paths, each rounded as far as the limits hold."""
    taken = 0.0
    for index in range(len(paths) - 1):
        before, after = laws[index : index + 2]
        # Three motions never overlap at once; the next corner shall have its share as well.
        last = index == len(paths) - 2
        most = min(before.duration - taken, after.duration * (1.0 if last else _SHARE))
        corner = _Corner(paths[index : index + 2], (before, after), int(most / limits.step), limits)
        taken = limits.step * corner.overlap
        yield corner


class _Corner:
    """Two motions, the second of which begins before the first has ended.

    Attributes:
        overlap: for how many steps at most they overlap while the joint limits hold.
    """

    def __init__(
        self,
        paths: Sequence[Path],
        laws: Sequence[TimeLaw],
        most: int,
        limits: MotionLimits,
    ) -> None:
        self._paths, self._laws, self._limits = paths, laws, limits
        steps = limits.step * np.arange(most + 1)
        first = states(paths[0], laws[0], laws[0].duration - steps[::-1])
        second = states(paths[1], laws[1], steps)
        self._shifts = first[0], second[0]
        self._used = first[1:] / limits.orders, second[1:] / limits.orders
        self._hopeful = _hopeful(*self._used)
        self.overlap = 0
        self.narrow(most)

    @property
    def rounded(self) -> Array:
        """The configurations (N, 6) while they overlap, step by step [rad]."""
        there = _meeting(*self._shifts, self.overlap)
        return np.asarray(self._paths[0].start + there.T)

    def narrow(self, most: int) -> None:
        """Go on to the next overlap that holds the limits and is not wider than `most` steps."""
        for overlap in self._hopeful:
            self.overlap = overlap
            if overlap <= most and self._holds():
                return
        self.overlap = 0

    def _holds(self) -> bool:
        """Tell whether the limits hold step by step, between the steps, and where a jerk jumps."""
        used = np.max(np.abs(_meeting(*self._used, self.overlap)), axis=1)
        if np.max(used) > 1.0:
            return False
        before, after = self._laws
        start = before.duration - self._limits.step * self.overlap
        jumps = around(np.concatenate([before.changes, start + after.changes]))
        steps = start + self._limits.step * np.arange(used.shape[1])
        t = np.concatenate([jumps, about_peaks(steps, used)])
        t = t[(t > start) & (t < before.duration)]
        total = states(self._paths[0], before, t) + states(self._paths[1], after, t - start)
        return bool(np.max(usages(total[1:], self._limits), initial=0.0) <= 1.0)


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
