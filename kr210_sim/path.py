"""A joint path: the geometry of a motion, without time."""

from __future__ import annotations

from functools import cached_property
from typing import Protocol

import numpy as np
from scipy.interpolate import make_interp_spline

from kr210_sim.arrays import Array

_DEGREE = 5
"""Quintic splines: the third derivative, from which jerk follows, is smooth."""

_NORM = 8.0
"""Exponent of the smooth maximum over joints that defines the arc length."""

_KNOTS = 60  # pieces between the samples that the reparametrised spline passes through, at least
_FINE = 6  # steps of the arc-length integral in each of them
_NOWHERE = 1e-12  # length up to which a path goes nowhere [s]


class _Curve(Protocol):
    """q(s) and its derivatives, as scipy's splines."""

    def __call__(self, s: Array, order: int = 0) -> Array:
        """Return q or its derivative of that order (N, 6) at s (N,)."""
        ...


class _Line:
    """A straight line through joint space."""

    def __init__(self, start: Array, direction: Array) -> None:
        self._start, self._direction = start, direction

    def __call__(self, s: Array, order: int = 0) -> Array:
        if order == 0:
            return np.asarray(self._start + np.asarray(s)[:, None] * self._direction)
        slope = self._direction if order == 1 else np.zeros_like(self._direction)
        return np.tile(slope, (len(s), 1))


class _Backwards:
    """A curve, from its end to its beginning."""

    def __init__(self, curve: _Curve, length: float) -> None:
        self._curve, self._length = curve, length

    def __call__(self, s: Array, order: int = 0) -> Array:
        return (-1.0) ** order * self._curve(self._length - np.asarray(s), order)


class Path:
    """A curve q(s) through joint space, s in [0, length].

    s is arc length in the velocity-weighted norm (sum_j |dq_j / v_j|^8)^(1/8), unit seconds: at
    ds/dt = 1 about the fastest joint moves at its velocity limit.

    Attributes:
        length: [s]; 0 for a path that goes nowhere.
        there: the path of which this is the way back, else itself.
        direction: (6,) dq/ds of a straight line in joint space [rad/s], None if it bends.
    """

    def __init__(self, curve: _Curve, length: float, direction: Array | None = None) -> None:
        self.there = self
        self.direction = direction
        self._curve = curve
        self.length = length

    @classmethod
    def straight(cls, q_start: Array, q_end: Array, velocity: Array) -> Path:
        """Return the straight joint line between two configurations (6,) [rad]."""
        length = float(np.sum(np.abs((q_end - q_start) / velocity) ** _NORM) ** (1 / _NORM))
        length = length if length > _NOWHERE else 0.0
        direction = (q_end - q_start) / (length or 1.0)
        return cls(_Line(q_start, direction), length, direction)

    @classmethod
    def through(cls, q: Array, velocity: Array) -> Path:
        """Return a smooth path through samples of a smooth curve.

        Args:
            q: (N, 6) samples [rad], N >= 6, spaced about evenly along the curve.
            velocity: (6,) velocity limits [rad/s], the weights of the arc length.
        """
        curve = make_interp_spline(np.linspace(0.0, 1.0, len(q)), q, k=_DEGREE)
        knots = max(_KNOTS, len(q))
        u = np.linspace(0.0, 1.0, knots * _FINE + 1)
        rate = np.sum(np.abs(curve(u, 1) / velocity) ** _NORM, axis=1) ** (1 / _NORM)
        s = np.concatenate([[0.0], np.cumsum((rate[1:] + rate[:-1]) / (2 * (len(u) - 1)))])
        length = float(s[-1])
        if length <= _NOWHERE:
            return cls(curve, 0.0)
        # Both q(u) and s(u) are smooth, and s increases: so is q(s), through its values there.
        return cls(make_interp_spline(s[::_FINE], curve(u[::_FINE]), k=_DEGREE), length)

    def reversed(self) -> Path:
        """Return the way back."""
        direction = None if self.direction is None else -self.direction
        path = Path(_Backwards(self._curve, self.length), self.length, direction)
        path.there = self.there
        return path

    def __call__(self, s: Array, order: int = 0) -> Array:
        """Return the derivative of that order (0 to 3) of q with respect to s: (N,) -> (N, 6)."""
        return np.asarray(self._curve(s, order))

    def derivatives(self, s: Array) -> Array:
        """Return the first three derivatives of q with respect to s: (N,) -> (3, N, 6)."""
        return np.array([self._curve(s, order) for order in (1, 2, 3)])

    @cached_property
    def start(self) -> Array:
        """First configuration (6,) [rad]."""
        return np.asarray(self(np.zeros(1))[0])

    @cached_property
    def end(self) -> Array:
        """Last configuration (6,) [rad]."""
        return np.asarray(self(np.array([self.length]))[0])

    def samples(self, step: float) -> Array:
        """Return configurations (N, 6) no further apart than `step` [rad] in any joint."""
        coarse = self(np.linspace(0.0, self.length, 33))
        travel = float(np.max(np.sum(np.abs(np.diff(coarse, axis=0)), axis=0)))
        count = max(2, int(np.ceil(travel / step)) + 1)
        while True:
            q = self(np.linspace(0.0, self.length, count))
            widest = float(np.max(np.abs(np.diff(q, axis=0))))
            if widest <= step:
                return q
            count = int(np.ceil(count * widest / step)) + 1
