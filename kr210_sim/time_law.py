"""Jerk-limited time law of one degree of freedom from rest to rest, by ruckig."""

from __future__ import annotations

import copy

import numpy as np
from numpy.typing import NDArray
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
        self._starts = self.changes[:-1]
        self._p, self._v, self._a = (np.array(x[:7]) for x in (profile.p, profile.v, profile.a))
        self._j = np.array(profile.j)

    def slowed(self, share: float) -> TimeLaw:
        """Return the same law in 1 / share of the time."""
        law = copy.copy(self)
        law.duration, law.changes = self.duration / share, self.changes / share
        law._starts, law._v = law.changes[:-1], self._v * share
        law._a, law._j = self._a * share**2, self._j * share**3
        return law

    def __call__(self, t: Array) -> tuple[Array, Array, Array, Array]:
        """Return position, velocity, acceleration and jerk, each (N,), at times t (N,) [s]."""
        phase, dt = self._phase(t)
        p, v, a, j = (x[phase] for x in (self._p, self._v, self._a, self._j))
        return (
            p + dt * (v + dt * (a / 2 + dt * j / 6)),
            v + dt * (a + dt * j / 2),
            a + dt * j,
            j,
        )

    def position(self, t: Array) -> Array:
        """Return the position (N,) alone."""
        phase, dt = self._phase(t)
        p, v, a, j = (x[phase] for x in (self._p, self._v, self._a, self._j))
        return np.asarray(p + dt * (v + dt * (a / 2 + dt * j / 6)))

    def _phase(self, t: Array) -> tuple[NDArray[np.int64], Array]:
        """Return the phase (N,) of each time, and how long it has lasted (N,) [s]."""
        t = np.clip(t, 0.0, self.duration)
        phase = np.searchsorted(self._starts, t, side="right") - 1
        return phase, t - self._starts[phase]
