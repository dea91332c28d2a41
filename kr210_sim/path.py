"""A joint path: the geometry of a motion, without time."""

from __future__ import annotations

from functools import cache, cached_property
from math import factorial, perm
from typing import Protocol

import numpy as np
from scipy.interpolate import make_interp_spline

from kr210_sim.arrays import Array

_DEGREE = 5
"""Quintic splines: the third derivative, from which jerk follows, is smooth."""

_ORDERS = 4
"""A path is known with its first three derivatives."""

_KNOTS = 60  # pieces between the samples that the reparametrised spline passes through, at least
_FINE = 6  # steps of the arc-length integral in each of them
_NOWHERE = 1e-12  # length up to which a path goes nowhere [s]
_TURNED = np.array([1.0, -1.0, 1.0, -1.0])[:, None, None]  # of q and its derivatives, on a way back


class _Curve(Protocol):
    """q(s) and its derivatives."""

    def __call__(self, s: Array, orders: slice) -> Array:
        """Return some of q and its first three derivatives (K, 6, N) at s (N,)."""
        ...


class _Line:
    """A straight line through joint space."""

    def __init__(self, start: Array, direction: Array) -> None:
        self._rows = np.zeros((_ORDERS, 6))
        self._rows[0], self._rows[1] = start, direction

    def __call__(self, s: Array, orders: slice) -> Array:
        q = np.repeat(self._rows[orders, :, None], len(s), axis=2)
        if not orders.start:
            q[0] += self._rows[1, :, None] * s
        return q


class _Spline:
    """A quintic spline through values q (M, 6) at increasing s (M,), as a table of its pieces.

    The table (power, order, 6, piece) holds what multiplies the powers of the distance from where
    a piece begins, for q and its derivatives side by side: one look-up and one Horner scheme serve
    all of them.
    """

    def __init__(self, s: Array, q: Array) -> None:
        spline = make_interp_spline(s, q, k=_DEGREE)
        knots = spline.t[_DEGREE:-_DEGREE]
        self._begins, self._inner = knots[:-1], knots[1:-1]
        terms = [spline(self._begins, power).T / factorial(power) for power in range(_DEGREE + 1)]
        self._table = np.zeros((_DEGREE + 1, _ORDERS, 6, len(self._begins)))
        for order in range(_ORDERS):
            for power in range(_DEGREE + 1 - order):
                self._table[power, order] = perm(power + order, order) * terms[power + order]

    def __call__(self, s: Array, orders: slice) -> Array:
        piece = self._inner.searchsorted(s, side="right")
        along = s - self._begins[piece]
        *lower, q = self._table[:, orders].take(piece, axis=3)
        for term in reversed(lower):
            q *= along
            q += term
        return np.asarray(q)


class _Backwards:
    """A curve, from its end to its beginning."""

    def __init__(self, curve: _Curve, length: float) -> None:
        self._curve, self._length = curve, length

    def __call__(self, s: Array, orders: slice) -> Array:
        return np.asarray(self._curve(self._length - s, orders) * _TURNED[orders])


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
        length = float(_norm((q_end - q_start) / velocity))
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
        count = max(_KNOTS, len(q)) * _FINE
        values, slopes = _sampling(len(q), count)
        u_step = 1.0 / count
        rate = _norm(slopes @ q / velocity)
        s = np.concatenate([[0.0], np.cumsum((rate[1:] + rate[:-1]) * (u_step / 2))])
        length = float(s[-1])
        if length <= _NOWHERE:
            return cls(_Line(q[0], np.zeros(6)), 0.0)
        # Both q(u) and s(u) are smooth, and s increases: so is q(s), through its values there.
        return cls(_Spline(s[::_FINE], values @ q), length)

    def reversed(self) -> Path:
        """Return the way back."""
        direction = None if self.direction is None else -self.direction
        path = Path(_Backwards(self._curve, self.length), self.length, direction)
        path.there = self.there
        return path

    def __call__(self, s: Array, order: int = 0) -> Array:
        """Return the derivative of that order (0 to 3) of q with respect to s: (N,) -> (N, 6)."""
        return np.ascontiguousarray(self._curve(np.asarray(s), slice(order, order + 1))[0].T)

    def derivatives(self, s: Array) -> Array:
        """Return q and its first three derivatives with respect to s: (N,) -> (4, 6, N)."""
        return self._curve(s, slice(None))

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


def _norm(x: Array) -> Array:
    """Return the 8-norm over joints that defines the arc length: (..., 6) -> (...)."""
    eighth = np.square(np.square(np.square(x)))
    return np.asarray(np.sqrt(np.sqrt(np.sqrt(np.sum(eighth, axis=-1)))))


@cache
def _sampling(samples: int, count: int) -> tuple[Array, Array]:
    """Return what makes values and slopes of the spline through samples, evenly along it.

    The spline through samples (N, d) at even u in [0, 1] is linear in them.

    Args:
        samples: how many they are, N.
        count: pieces of equal length.

    Returns:
        (count / _FINE + 1, N) for the values between groups of _FINE pieces, and (count + 1, N)
        for the slopes dq/du at all ends of pieces.
    """
    spline = make_interp_spline(np.linspace(0.0, 1.0, samples), np.eye(samples), k=_DEGREE)
    u = np.linspace(0.0, 1.0, count + 1)
    return np.asarray(spline(u[::_FINE])), np.asarray(spline(u, 1))
