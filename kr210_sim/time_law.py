"""Jerk-limited time law of one degree of freedom from rest to rest, by ruckig."""

from __future__ import annotations

import copy
from collections.abc import Sequence
from itertools import accumulate

import numpy as np
from ruckig import InputParameter, Result, Ruckig, RuckigError
from ruckig import Trajectory as RuckigTrajectory

from kr210_sim.arrays import Array

_PHASES = 9  # rest, seven phases of constant jerk, rest


class TimeLaw:
    """s(t) of one degree of freedom from rest to rest, s in [0, distance], by ruckig.

    Attributes:
        duration: [s].
        changes: times at which the jerk jumps (8,), the last at the end [s].
        table: (5, 9) position, velocity, acceleration and jerk when a phase of constant jerk
            begins, and when [s]; the first phase is rest before the start, the last that after
            the end.
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
        self._tabulate(
            np.array(
                [
                    [0.0, *profile.p[:7], distance],
                    [0.0, *profile.v[:7], 0.0],
                    [0.0, *profile.a[:7], 0.0],
                    [0.0, *profile.j, 0.0],
                    [0.0, *accumulate(profile.t, initial=0.0)],
                ]
            )
        )

    def _tabulate(self, table: Array) -> None:
        """Become the law of such a table."""
        self.table, self.changes = table, table[4, 1:]
        self.duration = float(table[4, -1])

    def slowed(self, share: float) -> TimeLaw:
        """Return the same law in 1 / share of the time."""
        law = copy.copy(self)
        law._tabulate(self.table * np.array([1.0, share, share**2, share**3, 1 / share])[:, None])
        return law

    def __call__(self, t: Array) -> Array:
        """Return position, velocity, acceleration and jerk (4, N) at times t (N,) [s]."""
        return laws_at([self], [t])

    def position(self, t: Array) -> Array:
        """Return the position (N,) alone."""
        (p, v, a, j), dt = _since([self], [t])
        return np.asarray(p + dt * (v + dt * (a / 2 + dt * j / 6)))


def laws_at(laws: Sequence[TimeLaw], times: Sequence[Array]) -> Array:
    """Return position, velocity, acceleration and jerk (4, N) of laws, evaluated in one pass.

    Args:
        laws: one beside the other.
        times: (N_k,) of each [s]; N is their sum.
    """
    state, dt = _since(laws, times)
    p, v, a, j = state
    p += dt * (v + dt * (a / 2 + dt * j / 6))
    v += dt * (a + dt * j / 2)
    a += dt * j
    return state


def _since(laws: Sequence[TimeLaw], times: Sequence[Array]) -> tuple[Array, Array]:
    """Return the last states (4, N) at which jerks jumped, and how long ago (N,) [s]."""
    phases = [
        law.changes.searchsorted(t, side="right") + k * _PHASES
        for k, (law, t) in enumerate(zip(laws, times, strict=True))
    ]
    tables = np.concatenate([law.table for law in laws], axis=1)
    found = tables.take(np.concatenate(phases), axis=1)
    return found[:4], np.concatenate(times) - found[4]
