"""Path + limits -> Trajectory: the jerk-limited time law of a motion, by ruckig."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from ruckig import InputParameter, Result, Ruckig
from ruckig import Trajectory as RuckigTrajectory

from kr210_sim.arrays import Array
from kr210_sim.path import Path
from kr210_sim.robot import ACCELERATION_TIME

JERK_TIME = 0.05
"""Time from zero to the acceleration limit at the jerk limit [s]."""

_CHECK_RATE = 1000.0  # [Hz], the grid on which the limits are verified
_LIMIT_MARGIN = 1.0 - 1e-6  # aimed at, so that rounding never ends above a limit
_ROUNDS = 12


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
    """s(t) of one degree of freedom from rest to rest, s in [0, distance], within limits."""

    def __init__(self, distance: float, velocity: float, acceleration: float, jerk: float) -> None:
        request = InputParameter(1)
        request.current_position = [0.0]
        request.target_position = [distance]
        request.max_velocity = [velocity]
        request.max_acceleration = [acceleration]
        request.max_jerk = [jerk]
        self._law = RuckigTrajectory(1)
        result = Ruckig(1).calculate(request, self._law)
        if result not in (Result.Working, Result.Finished):
            raise ValueError(f"ruckig finds no time law: {result}")
        self.duration = float(self._law.duration)

    def __call__(self, t: Array) -> tuple[Array, Array, Array]:
        """Return position, velocity and acceleration, each (N,), at times t (N,) [s]."""
        clipped = np.clip(t, 0.0, self.duration)
        rows = np.array([self._law.at_time(float(time)) for time in clipped])[:, :, 0]
        return rows[:, 0], rows[:, 1], rows[:, 2]

    def jerk(self, t: Array) -> Array:
        """Return the jerk (N,) at times t (N,) [s], from ruckig's constant-jerk sections."""
        profile = self._law.profiles[0][0]
        section = np.searchsorted(np.cumsum(profile.t), t, side="right")
        return np.append(profile.j, 0.0)[np.minimum(section, len(profile.t))]


class Trajectory:
    """A path with its time law: traj(t) -> q, qd, qdd; rest at both ends.

    Attributes:
        path: the geometry.
        duration: [s].
    """

    def __init__(self, path: Path, law: TimeLaw) -> None:
        self.path = path
        self._law = law
        self.duration = law.duration

    def __call__(self, t: Array) -> tuple[Array, Array, Array]:
        """Return q, qd, qdd, each (N, 6) [rad, rad/s, rad/s^2], at times t (N,) [s]."""
        s, ds, dds = (column[:, None] for column in self._law(t))
        q1, q2 = self.path(s[:, 0], 1), self.path(s[:, 0], 2)
        return self.path(s[:, 0]), q1 * ds, q1 * dds + q2 * ds**2

    def usage(self, limits: MotionLimits) -> tuple[float, float, float]:
        """Return the largest |qd|/v, |qdd|/a and |qddd|/j on a 1 kHz grid; 1 is at the limit."""
        count = int(np.ceil(self.duration * _CHECK_RATE)) + 1
        t = np.linspace(0.0, self.duration, count)
        s, ds, dds = self._law(t)
        q1, q2, q3 = (self.path(s, order) for order in (1, 2, 3))
        ds, dds, ddds = ds[:, None], dds[:, None], self._law.jerk(t)[:, None]
        velocity = q1 * ds
        acceleration = q1 * dds + q2 * ds**2
        jerk = q1 * ddds + 3 * q2 * ds * dds + q3 * ds**3
        return (
            float(np.max(np.abs(velocity) / limits.velocity)),
            float(np.max(np.abs(acceleration) / limits.acceleration)),
            float(np.max(np.abs(jerk) / limits.jerk)),
        )


def time_path(path: Path, limits: MotionLimits) -> Trajectory:
    """Give a path the fastest rest-to-rest law of constant path limits that the joints allow.

    The joint limits bound ds/dt and its derivatives along the path,
    qd = q' s', qdd = q' s'' + q'' s'^2, qddd = q' s''' + 3 q'' s' s'' + q''' s'^3,
    so the law's three limits start from q' alone and are rescaled in time (v/k, a/k^2, j/k^3) until
    the verified trajectory touches its tightest limit and exceeds none.
    """
    grid = np.linspace(0.0, 1.0, 101)
    rate = np.abs(path(grid, 1))
    if np.max(rate) < 1e-9:
        return Trajectory(path, TimeLaw(0.0, 1.0, 1.0, 1.0))
    steepest = np.maximum(np.max(rate, axis=0), 1e-300)
    velocity, acceleration, jerk = (
        float(np.min(limit / steepest))
        for limit in (limits.velocity, limits.acceleration, limits.jerk)
    )
    best: Trajectory | None = None
    for _ in range(_ROUNDS):
        trajectory = Trajectory(path, TimeLaw(1.0, velocity, acceleration, jerk))
        v, a, j = trajectory.usage(limits)
        stretch = max(v, a**0.5, j ** (1 / 3)) / _LIMIT_MARGIN
        if max(v, a, j) <= 1.0 and (best is None or trajectory.duration < best.duration):
            best = trajectory
        if best is not None and abs(stretch - 1.0) < 1e-4:
            break
        # Slow down at once, speed up with care: the law's shape changes with its limits.
        stretch = stretch if stretch > 1.0 else stretch**0.7
        velocity, acceleration, jerk = (
            velocity / stretch,
            acceleration / stretch**2,
            jerk / stretch**3,
        )
    if best is None:
        raise ValueError("no time law holds the joint limits on this path")
    return best
