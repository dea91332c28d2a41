"""Paths + limits -> Trajectory: jerk-limited time laws by ruckig, overlapped at corners."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from ruckig import InputParameter, Result, Ruckig
from ruckig import Trajectory as RuckigTrajectory

from kr210_sim.arrays import Array
from kr210_sim.path import Path

ACCELERATION_TIME = 0.25
"""Time from rest to the velocity limit at the acceleration limit [s]."""

JERK_TIME = 0.05
"""Time from zero to the acceleration limit at the jerk limit [s]."""

_MARGIN = 1.0 - 1e-6  # share of the limits that is used, so that rounding never ends above one
_GRID = 41  # points of a path at which its limits are evaluated
_SPEEDS = np.linspace(0.3, 1.0, 15)  # shares of the speed limit tried on a curved path
_JERK_SHARES = (1.0, 0.7, 0.4)  # of the acceleration limit, to leave jerk to the curvature
_CHECK_RATE = 1000.0  # [Hz]
_CLEARANCE_SAMPLES = 20  # configurations of an overlap that are checked for clearance
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


class TimeLaw:
    """s(t) of one degree of freedom from rest to rest, s in [0, distance], by ruckig."""

    def __init__(self, distance: float, velocity: float, acceleration: float, jerk: float) -> None:
        request = InputParameter(1)
        request.current_position, request.target_position = [0.0], [distance]
        request.max_velocity = [velocity]
        request.max_acceleration = [acceleration]
        request.max_jerk = [jerk]
        law = RuckigTrajectory(1)
        result = Ruckig(1).calculate(request, law)
        if result not in (Result.Working, Result.Finished):
            raise ValueError(f"ruckig finds no time law: {result}")
        profile = law.profiles[0][0]
        self.duration = float(law.duration)
        self._starts = np.concatenate([[0.0], np.cumsum(profile.t)])[:-1]
        self._p, self._v, self._a = (np.array(x[:7]) for x in (profile.p, profile.v, profile.a))
        self._j = np.array(profile.j)

    def __call__(self, t: Array) -> tuple[Array, Array, Array, Array]:
        """Return position, velocity, acceleration and jerk, each (N,), at times t (N,) [s]."""
        t = np.clip(t, 0.0, self.duration)
        phase = np.searchsorted(self._starts, t, side="right") - 1
        dt = t - self._starts[phase]
        p, v, a, j = (x[phase] for x in (self._p, self._v, self._a, self._j))
        return (
            p + dt * (v + dt * (a / 2 + dt * j / 6)),
            v + dt * (a + dt * j / 2),
            a + dt * j,
            j,
        )


class Trajectory:
    """Motions from rest to rest, each begun before the one before has ended.

    q(t) = q_1(t) + sum_k (q_k(t - start_k) - q_k(0)): while two overlap, one brakes and the next
    speeds up, and their sum rounds the corner between their paths. Scaling all limits by a time
    factor scales starts and durations alike, so the curve in space does not depend on the speed.

    Attributes:
        paths: of the motions, in order; each begins where the one before ends.
        starts: when each begins [s].
        duration: of the whole [s].
    """

    def __init__(self, paths: Sequence[Path], laws: Sequence[TimeLaw], starts: Sequence[float]):
        self.paths, self._laws = tuple(paths), tuple(laws)
        self.starts = np.array(starts, dtype=float)
        self._ends = self.starts + [law.duration for law in laws]
        self.duration = float(self._ends[-1])

    @property
    def end(self) -> Array:
        """Last configuration (6,) [rad]."""
        return self.paths[-1].end

    def part_at(self, t: float) -> int:
        """Return which motion is under way at a time [s]; in an overlap, from its middle on."""
        changes = (self._ends[:-1] + self.starts[1:]) / 2
        return int(np.searchsorted(changes, t, side="right"))

    def __call__(self, t: Array) -> tuple[Array, Array, Array]:
        """Return q, qd, qdd, each (N, 6) [rad, rad/s, rad/s^2], at times t (N,) [s]."""
        q, qd, qdd, _ = self.derivatives(t)
        return q, qd, qdd

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
        """Return the largest |qd|/v, |qdd|/a and |qddd|/j on a 1 kHz grid; 1 is at the limit."""
        t = np.linspace(0.0, self.duration, int(np.ceil(self.duration * _CHECK_RATE)) + 1)
        return _usage(self.derivatives(t)[1:], limits)


def _along(path: Path, law: TimeLaw, t: Array) -> Array:
    """Return q - q(0) and three derivatives (4, N, 6) of one motion at times t (N,) [s].

    The chain rule for q(s(t)), with q1, q2, q3 the derivatives along the path and ds, dds, ddds
    those of the time law; after its end a motion stays where it is.
    """
    s, ds, dds, ddds = (x[:, None] for x in law(t))
    q1, q2, q3 = (path(s[:, 0], order) for order in (1, 2, 3))
    ddds = np.where(t[:, None] < law.duration, ddds, 0.0)
    return np.stack(
        [
            path(s[:, 0]) - path.start,
            q1 * ds,
            q1 * dds + q2 * ds**2,
            q1 * ddds + 3 * q2 * ds * dds + q3 * ds**3,
        ]
    )


def _usage(derivatives: Iterable[Array], limits: MotionLimits) -> tuple[float, float, float]:
    bounds = (limits.velocity, limits.acceleration, limits.jerk)
    v, a, j = (
        float(np.max(np.abs(x) / bound)) for x, bound in zip(derivatives, bounds, strict=True)
    )
    return v, a, j


def time_path(path: Path, limits: MotionLimits) -> Trajectory:
    """Return the trajectory of one path, from rest to rest.

    Raises:
        ValueError: if no time law holds the limits.
    """
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
            their clearance.

    Raises:
        ValueError: if no time law holds the limits.
    """
    laws = [_law(path, limits) for path in paths]
    tables = [_along(path, law, _grid(law)) for path, law in zip(paths, laws, strict=True)]
    starts, taken = [0.0], 0.0
    for corner in range(len(paths) - 1):
        before, after = laws[corner], laws[corner + 1]
        # Three motions never overlap at once.
        most = min(before.duration - taken, after.duration)
        taken = _widest(
            tables[corner], tables[corner + 1], paths[corner].start, most, limits, free, corner
        )
        starts.append(starts[-1] + before.duration - taken)
    return Trajectory(paths, laws, starts)


def _grid(law: TimeLaw) -> Array:
    """Return times (N,) [s] at the check rate, ending with the motion."""
    count = int(np.ceil(law.duration * _CHECK_RATE))
    return law.duration - np.arange(count, -1, -1) / _CHECK_RATE


def _widest(
    first: Array,
    second: Array,
    q_start: Array,
    most: float,
    limits: MotionLimits,
    free: Callable[[int, Array], bool],
    corner: int,
) -> float:
    """Return the longest overlap of two motions, tabulated (4, N, 6), that is allowed [s]."""
    count = int(most * _CHECK_RATE)
    while count > 0:
        # The second begins `count` steps before the first ends; compare them step by step.
        total = first[:, -count - 1 :] + second[:, : count + 1]
        if max(_usage(total[1:], limits)) > 1.0:
            count -= 1
        elif not free(corner, q_start + total[0, :: max(1, count // _CLEARANCE_SAMPLES)]):
            count = int(count * _SHRINK)
        else:
            break
    return count / _CHECK_RATE


def _law(path: Path, limits: MotionLimits) -> TimeLaw:
    """Return the quickest law within path limits (V, A, J) that imply the joint limits.

    |q1| V <= v, |q2| V^2 + |q1| A <= a, |q3| V^3 + 3 |q2| V A + |q1| J <= j all along the path,
    with q1, q2, q3 its derivatives. What the curvature leaves is shared out differently by each
    choice of V and A.
    """
    grid = np.linspace(0.0, path.length, _GRID)
    first, second, third = (np.abs(path(grid, order)) for order in (1, 2, 3))
    first = np.maximum(first, 1e-12)
    fastest = float(np.min(limits.velocity / first))
    straight = np.max(second) * fastest**2 < 1e-9 * np.min(limits.acceleration)
    best: TimeLaw | None = None
    for share in (1.0,) if straight else _SPEEDS:
        v = _MARGIN * share * fastest
        most = float(np.min((limits.acceleration - second * v**2) / first))
        for part in (1.0,) if straight else _JERK_SHARES:
            a = _MARGIN * part * most
            j = _MARGIN * float(np.min((limits.jerk - third * v**3 - 3 * second * v * a) / first))
            if a <= 0 or j <= 0:
                continue
            law = TimeLaw(path.length, v, a, j)
            if best is None or law.duration < best.duration:
                best = law
    if best is None:
        raise ValueError("no time law holds the joint limits on this path")
    return best
