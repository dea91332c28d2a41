"""Jerk-limited time law of one degree of freedom from rest to rest, by ruckig."""

from __future__ import annotations

import copy

import numpy as np
from ruckig import InputParameter, Result, Ruckig, RuckigError
from ruckig import Trajectory as RuckigTrajectory

from kr210_sim.arrays import Array


class TimeLaw:
    """s(t) of one degree of freedom from rest to rest, s in [0, distance], by ruckig.

    Attributes:
        duration: [s].
        changes: times at which the jerk jumps (8,), the last at the end [s].
    """

    def __init__(self, distance: float, velocity: float, acceleration: float, jerk: float) -> None:
        request = InputParameter(1)
        request.current_position, request.target_position = [0.0], [distance]
        request.max_velocity = [velocity]
        request.max_acceleration = [acceleration]
        request.max_jerk = [jerk]
        law = RuckigTrajectory(1)
        try:
            result = Ruckig(1).calculate(request, law)
        except RuckigError as error:
            raise ValueError(f"ruckig finds no time law: {error}") from error
        if result not in (Result.Working, Result.Finished):
            raise ValueError(f"ruckig finds no time law: {result}")
        profile = law.profiles[0][0]
        self.duration = float(law.duration)
        self.changes = np.concatenate([[0.0], np.cumsum(profile.t)])
        self._states = np.array([profile.p[:7], profile.v[:7], profile.a[:7], profile.j])

    def slowed(self, share: float) -> TimeLaw:
        """Return the same law in 1 / share of the time."""
        law = copy.copy(self)
        law.duration, law.changes = self.duration / share, self.changes / share
        law._states = self._states * np.array([[1.0], [share], [share**2], [share**3]])
        return law

    def __call__(self, t: Array) -> Array:
        """Return position, velocity, acceleration and jerk (4, N) at times t (N,) [s]."""
        state, dt = self._since(t)
        p, v, a, j = state
        p += dt * (v + dt * (a / 2 + dt * j / 6))
        v += dt * (a + dt * j / 2)
        a += dt * j
        return state

    def position(self, t: Array) -> Array:
        """Return the position (N,) alone."""
        (p, v, a, j), dt = self._since(t)
        return np.asarray(p + dt * (v + dt * (a / 2 + dt * j / 6)))

    def _since(self, t: Array) -> tuple[Array, Array]:
        """Return the last state (4, N) at which the jerk jumped, and how long ago (N,) [s]."""
        t = np.minimum(np.maximum(t, 0.0), self.duration)
        phase = self.changes[1:-1].searchsorted(t, side="right")
        return self._states.take(phase, axis=1), t - self.changes[phase]
