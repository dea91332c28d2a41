"""Paths + limits -> Trajectory: jerk-limited time laws by ruckig, overlapped at corners."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from kr210_sim.arrays import Array
from kr210_sim.path import Path
from kr210_sim.robot import ACCELERATION_TIME
from kr210_sim.time_law import TimeLaw

JERK_TIME = 0.05
"""Time from zero to the acceleration limit at the jerk limit [s]."""

_MARGIN = 1.0 - 1e-4  # share of the limits that is used, for what lies between the samples
_GRID = 81  # points of a path at which its limits are estimated
_INSTANTS = 5  # of each phase of constant jerk at which shapes are compared
_SAMPLES = 2000  # instants of a motion at which its limits are evaluated
_SPEEDS = np.geomspace(0.1, 1.0, 12)  # shares of the speed limit tried on a curved path
_JERK_SHARES = (1.0, 0.7, 0.4)  # of the acceleration limit, to leave jerk to the curvature
_LEAST = 0.05  # of the acceleration and jerk limits that a shape keeps on a tight curve
_CHECK_RATE = 1000.0  # [Hz]
_INSTANT = 1e-9  # [s]
_OVERLAP_STEP = 1 / 250  # of overlaps, as a share of the time to accelerate to full speed
_GLANCES = 24  # instants at which all overlaps are compared with the limits at once
_SHARE = 0.75  # of a motion, at most, that overlaps the one before it
_SHRINK = 0.8  # of an overlap that is not clear


@dataclass(frozen=True, kw_only=True)
class MotionLimits:
    """Joint limits of a motion; arrays of shape (6,).

    Attributes:
        velocity: [rad/s].
        acceleration: [rad/s^2].
        jerk: [rad/s^3].
    """

    velocity: Array
    acceleration: Array
    jerk: Array

    @classmethod
    def from_velocity(cls, velocity: Array, speed: float = 1.0) -> MotionLimits:
        """Derive acceleration and jerk limits from the velocity limits (6,) [rad/s].

        Args:
            velocity: the description's velocity limits.
            speed: time scaling in (0, 1]: velocity x F, acceleration x F^2, jerk x F^3.
        """
        acceleration = velocity / ACCELERATION_TIME
        return cls(
            velocity=velocity * speed,
            acceleration=acceleration * speed**2,
            jerk=acceleration / JERK_TIME * speed**3,
        )

    def scaled(self, share: float) -> MotionLimits:
        """Return the limits under which the same motion takes 1 / share of the time."""
        return MotionLimits(
            velocity=self.velocity * share,
            acceleration=self.acceleration * share**2,
            jerk=self.jerk * share**3,
        )


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
        q = np.tile(self.paths[0].start, (len(t), 1))
        for path, law, start in zip(self.paths, self._laws, self.starts, strict=True):
            begun = t > start
            if np.any(begun):
                q[begun] += path(law.position(t[begun] - start)) - path.start
        return q

    def derivatives(self, t: Array) -> tuple[Array, Array, Array, Array]:
        """Return q and its first three derivatives, each (N, 6), at times t (N,) [s]."""
        t = np.asarray(t, dtype=float)
        total = np.zeros((4, len(t), 6))
        total[0] = self.paths[0].start
        for path, law, start in zip(self.paths, self._laws, self.starts, strict=True):
            begun = t > start
            if np.any(begun):
                total[:, begun] += _along(path, law, t[begun] - start)
        return total[0], total[1], total[2], total[3]

    def usage(self, limits: MotionLimits) -> tuple[float, float, float]:
        """Return the largest |qd|/v, |qdd|/a and |qddd|/j; 1 is at the limit.

        On a 1 kHz grid, and on both sides of every instant at which a jerk jumps.
        """
        t = np.linspace(0.0, self.duration, int(np.ceil(self.duration * _CHECK_RATE)) + 1)
        t = np.concatenate([t, self.jumps()])
        return _usage(self.derivatives(t)[1:], limits)

    def jumps(self) -> Array:
        """Return times (N,) on both sides of every instant at which a jerk jumps [s]."""
        changes = zip(self._laws, self.starts, strict=True)
        return _around(np.concatenate([start + law.changes for law, start in changes]))


def _along(path: Path, law: TimeLaw, t: Array) -> Array:
    """Return q - q(0) and three derivatives (4, N, 6) of one motion at times t (N,) [s]."""
    s = law.position(t)
    return np.concatenate([(path(s) - path.start)[None], _rates(path, law, t)])


def _rates(path: Path, law: TimeLaw, t: Array) -> Array:
    """Return three derivatives of q (3, N, 6) of one motion at times t (N,) [s].

    The chain rule for q(s(t)), with q1, q2, q3 the derivatives along the path and ds, dds, ddds
    those of the time law; after its end a motion stays where it is.
    """
    s, ds, dds, ddds = (x[:, None] for x in law(t))
    q1, q2, q3 = path.derivatives(s[:, 0])
    ddds = np.where(t[:, None] < law.duration, ddds, 0.0)
    return np.array([q1 * ds, q1 * dds + q2 * ds**2, q1 * ddds + 3 * q2 * ds * dds + q3 * ds**3])


def _around(times: Array) -> Array:
    """Return instants just before and just after each, for what jumps there."""
    return np.concatenate([times - _INSTANT, times + _INSTANT])


def _usage(
    derivatives: Sequence[Array] | Array, limits: MotionLimits
) -> tuple[float, float, float]:
    bounds = np.stack([limits.velocity, limits.acceleration, limits.jerk])[:, None]
    v, a, j = np.max(np.abs(derivatives) / bounds, axis=(1, 2)).tolist()
    return v, a, j


def time_path(path: Path, limits: MotionLimits) -> Trajectory:
    """Return the trajectory of one path, from rest to rest."""
    return Trajectory([path], [_law(path, limits)], [0.0])


def time_paths(
    paths: Sequence[Path],
    limits: MotionLimits,
    free: Callable[[int, Array], bool] = lambda corner, q: True,
) -> Trajectory:
    """Return the trajectory of a chain of paths without a stop in between.

    Neighbours overlap in time as far as the joint limits hold and the rounded corner is free.

    Args:
        paths: each begins where the one before ends.
        limits: of the joints.
        free: tells whether configurations (N, 6) around corner k, between paths k and k + 1, keep
            their clearance; they follow each other in small steps.
    """
    laws = [_law(path, limits) for path in paths]
    # In proportion to the time scale of the limits, so that the geometry is the same at any speed.
    step = _OVERLAP_STEP * float(np.min(limits.velocity / limits.acceleration))
    starts, taken = [0.0], 0.0
    for corner in range(len(paths) - 1):
        pair = slice(corner, corner + 2)
        before, after = laws[pair]
        # Three motions never overlap at once; the next corner shall have its share as well.
        last = corner == len(paths) - 2
        most = min(before.duration - taken, after.duration * (1.0 if last else _SHARE))
        around = partial(free, corner)
        taken = step * _widest(paths[pair], laws[pair], int(most / step), step, limits, around)
        starts.append(starts[-1] + before.duration - taken)
    return Trajectory(paths, laws, starts)


def _widest(
    paths: Sequence[Path],
    laws: Sequence[TimeLaw],
    most: int,
    step: float,
    limits: MotionLimits,
    free: Callable[[Array], bool],
) -> int:
    """Return for how many steps, at most, two motions may overlap."""
    grid = step * np.arange(most + 1)
    first = _along(paths[0], laws[0], laws[0].duration - grid[::-1])
    second = _along(paths[1], laws[1], grid)
    bound = most
    for count in _hopeful(first[1:], second[1:], limits):
        if count > bound:
            continue
        # The second begins `count` steps before the first ends; compare them step by step.
        total = first[:, most - count :] + second[:, : count + 1]
        if max(_usage(total[1:], limits)) > 1.0 or not _smooth(paths, laws, count * step, limits):
            continue
        if free(paths[0].start + total[0]):
            return count
        bound = int(count * _SHRINK)
    return 0


def _hopeful(first: Array, second: Array, limits: MotionLimits) -> list[int]:
    """Return the overlaps, longest first, that hold the limits at some instants at least.

    Args:
        first: (3, N, 6) derivatives of a motion in its last steps.
        second: (3, N, 6) of the one after it, in its first steps.
        limits: of the joints.
    """
    bounds = np.stack([limits.velocity, limits.acceleration, limits.jerk])[:, None]
    most = first.shape[1] - 1
    # All derivatives of all joints one below the other (18, N).
    first, second = (
        np.ascontiguousarray(np.moveaxis(x / bounds, 1, 2)).reshape(-1, most + 1)
        for x in (first, second)
    )
    used = np.zeros(most + 1)  # at overlaps of most, most - 1, ... steps
    for index in range(0, most + 1, most // _GLANCES + 1):
        # Step `index` of the second meets step `most - count + index` of the first.
        meeting = np.abs(first[:, index:] + second[:, index : index + 1])
        np.maximum(used[: most - index + 1], np.max(meeting, axis=0), out=used[: most - index + 1])
    return [count for count in range(most, 0, -1) if used[most - count] <= 1.0]


def _smooth(
    paths: Sequence[Path], laws: Sequence[TimeLaw], overlap: float, limits: MotionLimits
) -> bool:
    """Tell whether two motions hold the limits where a jerk jumps in their overlap [s]."""
    both = Trajectory(paths, laws, [0.0, laws[0].duration - overlap])
    t = both.jumps()
    t = t[(t > both.starts[1]) & (t < laws[0].duration)]
    return max(_usage(both.derivatives(t)[1:], limits)) <= 1.0


def _law(path: Path, limits: MotionLimits) -> TimeLaw:
    """Return the quickest of the laws that just hold the joint limits along a path.

    Their shapes come from path limits (V, A, J) with |q1| V <= v, |q2| V^2 + |q1| A <= a and
    |q3| V^3 + 3 |q2| V A + |q1| J <= j, where q1, q2, q3 are the derivatives of the path. Each
    choice of V and A shares out differently what the curvature leaves.
    """
    if path.length == 0.0:
        return TimeLaw(0.0, 1.0, 1.0, 1.0)
    grid = np.linspace(0.0, path.length, _GRID)
    derivatives = path.derivatives(grid)
    first, second, third = np.abs(derivatives)
    first = np.maximum(first, 1e-12)
    fastest, quickest, sharpest = (
        float(np.min(limit / first))
        for limit in (limits.velocity, limits.acceleration, limits.jerk)
    )
    if np.max(second) * fastest**2 < 1e-9 * np.min(limits.acceleration):  # a straight line
        v, a, j = fastest * _MARGIN, quickest * _MARGIN**2, sharpest * _MARGIN**3
        return TimeLaw(path.length, v, a, j)
    v_all = np.repeat(fastest * _SPEEDS, len(_JERK_SHARES))
    speed = v_all[:, None, None]
    most = np.min((limits.acceleration - second * speed**2) / first, axis=(1, 2))
    a_all = np.tile(_JERK_SHARES, len(_SPEEDS)) * np.maximum(most, _LEAST * quickest)
    rest = limits.jerk - third * speed**3 - 3 * second * speed * a_all[:, None, None]
    j_all = np.maximum(np.min(rest / first, axis=(1, 2)), _LEAST * sharpest)
    shapes = np.stack([v_all, a_all, j_all])
    best = int(np.argmin(_durations(path.length, shapes, derivatives, limits)))
    v, a, j = shapes[:, best].tolist()
    return _fitted(path, (v, a, j), limits)


def _durations(length: float, shapes: Array, derivatives: Array, limits: MotionLimits) -> Array:
    """Return how long laws within path limits take once they are scaled to the joint limits.

    Args:
        length: of the path [s].
        shapes: (3, n) path limits V, A and J.
        derivatives: (3, N, 6) of the path, evenly along it.
        limits: of the joints.
    """
    phases = _phases(length, *shapes)
    duration = np.sum(phases, axis=1)
    s, ds, dds, ddds = _states(phases, shapes[2])
    at = np.clip(s / length, 0.0, 1.0) * (derivatives.shape[1] - 1)
    index = np.minimum(at.astype(np.int64), derivatives.shape[1] - 2)
    share = (at - index)[..., None]
    q1, q2, q3 = (1 - share) * derivatives[:, index] + share * derivatives[:, index + 1]
    ds, dds, ddds = ds[..., None], dds[..., None], ddds[..., None]
    stretch = np.zeros(len(duration))
    for order, (x, bound) in enumerate(
        (
            (q1 * ds, limits.velocity),
            (q1 * dds + q2 * ds**2, limits.acceleration),
            (q1 * ddds + 3 * q2 * ds * dds + q3 * ds**3, limits.jerk),
        ),
        start=1,
    ):
        used = np.max(np.abs(x) / bound, axis=(1, 2))
        stretch = np.maximum(stretch, used ** (1 / order))
    return np.asarray(duration * stretch)


def _phases(length: float, v: Array, a: Array, j: Array) -> Array:
    """Return the durations (n, 7) of the phases of constant jerk, from rest to rest.

    The closed form of what ruckig computes one by one, to compare many shapes [s].
    """
    # The peak speed, if the acceleration limit is reached and if not.
    ramp = a / j
    peak = a * (np.sqrt(ramp**2 + 4 * length / a) - ramp) / 2
    peak = np.where(peak >= a * ramp, peak, j * (length / (2 * j)) ** (2 / 3))
    peak = np.minimum(peak, v)
    ramp = np.minimum(ramp, np.sqrt(peak / j))
    hold = np.maximum(peak / (j * ramp) - ramp, 0.0)
    cruise = np.maximum(length / peak - 2 * ramp - hold, 0.0)
    return np.stack([ramp, hold, ramp, cruise, ramp, hold, ramp], axis=1)


def _states(phases: Array, jerk: Array) -> tuple[Array, Array, Array, Array]:
    """Return s and its derivatives (n, 7 m) at m instants in each phase, its ends included."""
    t = phases[:, None] * np.linspace(0.0, 1.0, _INSTANTS)[:, None]
    s, ds, dds = (np.zeros((len(jerk), 1)) for _ in range(3))
    rows = []
    for phase, sign in enumerate((1, 0, -1, 0, -1, 0, 1)):
        x, ddds = t[:, :, phase], sign * jerk[:, None]
        rows.append(
            (
                s + x * (ds + x * (dds / 2 + x * ddds / 6)),
                ds + x * (dds + x * ddds / 2),
                dds + x * ddds,
                np.broadcast_to(ddds, x.shape),
            )
        )
        s, ds, dds = (values[:, -1:] for values in rows[-1][:3])
    s, ds, dds, ddds = (np.concatenate(values, axis=1) for values in zip(*rows, strict=True))
    return s, ds, dds, ddds


def _fitted(path: Path, shape: tuple[float, float, float], limits: MotionLimits) -> TimeLaw:
    """Return the law within (V, A, J), scaled in time until it touches its tightest limit."""
    v, a, j = shape
    law = TimeLaw(path.length, v, a, j)
    t = np.concatenate([np.linspace(0.0, law.duration, _SAMPLES), _around(law.changes)])
    used = _usage(_rates(path, law, t), limits)
    stretch = max(share ** (1 / order) for order, share in enumerate(used, start=1)) / _MARGIN
    return TimeLaw(path.length, v / stretch, a / stretch**2, j / stretch**3)
