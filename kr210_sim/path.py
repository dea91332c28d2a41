"""A joint path: the geometry of a motion, without time."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache, cached_property
from math import perm

import numpy as np

from kr210_sim import spline
from kr210_sim.arrays import Array

_ORDERS = 4
"""A path is known with its first three derivatives."""

_POWERS = range(spline.DEGREE + 1)
# The derivative of order m of x^p is _FACTORS[p, m] x^_LOWER[p, m].
_FACTORS = np.array([[[float(perm(p, m))] for m in range(_ORDERS)] for p in _POWERS])
_LOWER = np.maximum(np.subtract.outer(_POWERS, np.arange(_ORDERS)), 0)

_KNOTS = 60  # steps between the values that the spline by arc length passes through, at least
_FINE = 6  # steps of the arc-length integral for each of them
_NOWHERE = 1e-12  # length up to which a path goes nowhere [s]


class _Curve:
    """q(s) as a table of its pieces, each a polynomial of s.

    Args:
        table: (power, 6, piece), what multiplies the powers of s - origin.
        origins: (piece,).
        inner: s between the pieces, one less than pieces.
    """

    def __init__(self, table: Array, origins: Array, inner: Array) -> None:
        self.table, self.origins, self._inner = table, origins, inner

    @classmethod
    def line(cls, start: Array, direction: Array) -> _Curve:
        """Return a straight line through joint space."""
        return cls(np.array([start, direction])[:, :, None], np.zeros(1), np.zeros(0))

    @classmethod
    def spline(cls, q: Array, step: float = 1.0) -> _Curve:
        """Return the quintic spline through values q (M, 6) at s = 0, step, 2 step, ..."""
        pieces, begins = spline.pieces(len(q))
        table = (pieces @ q).swapaxes(1, 2) / step ** np.arange(len(pieces))[:, None, None]
        return cls(np.ascontiguousarray(table), begins * step, begins[1:] * step)

    def reversed(self, length: float) -> _Curve:
        """Return the way back along it: q(length - s)."""
        turned = self.table[:, :, ::-1].copy()
        turned[1::2] *= -1.0
        return _Curve(turned, length - self.origins[::-1], length - self._inner[::-1])

    def pieces(self, s: Array) -> Array:
        """Return in which piece each of s (N,) is."""
        return self._inner.searchsorted(s, side="right")

    def __call__(self, s: Array) -> Array:
        """Return q (6, N) at s (N,)."""
        piece = self.pieces(s)
        along = s - self.origins[piece]
        *lower, q = self.table.take(piece, axis=2)
        for term in reversed(lower):
            q *= along
            q += term
        return np.asarray(q)


class Path:
    """A curve q(s) through joint space, s in [0, length].

    s is arc length in the velocity-weighted norm (sum_j |dq_j / v_j|^8)^(1/8), unit seconds: at
    ds/dt = 1 about the fastest joint moves at its velocity limit.

    Attributes:
        length: [s]; 0 for a path that goes nowhere.
        there: the path of which this is the way back, else itself.
        direction: (6,) dq/ds of a straight line in joint space [rad/s], None if it bends.
        curve: q(s).
    """

    def __init__(self, curve: _Curve, length: float, direction: Array | None = None) -> None:
        self.there = self
        self.direction = direction
        self.curve = curve
        self.length = length

    @classmethod
    def straight(cls, q_start: Array, q_end: Array, velocity: Array) -> Path:
        """Return the straight joint line between two configurations (6,) [rad]."""
        length = float(_norm((q_end - q_start) / velocity))
        length = length if length > _NOWHERE else 0.0
        direction = (q_end - q_start) / (length or 1.0)
        return cls(_Curve.line(q_start, direction), length, direction)

    @classmethod
    def through(cls, q: Array, velocity: Array) -> Path:
        """Return a smooth path through samples of a smooth curve.

        Args:
            q: (N, 6) samples [rad], N >= 6, spaced about evenly along the curve.
            velocity: (6,) velocity limits [rad/s], the weights of the arc length.
        """
        steps = max(_KNOTS, len(q))
        u = np.linspace(0.0, len(q) - 1.0, steps * _FINE + 1)
        rate = _norm(_slopes(len(q), len(u)) @ q / velocity)
        s = np.concatenate([[0.0], np.cumsum((rate[1:] + rate[:-1]) * (u[1] / 2))])
        length = float(s[-1])
        if length <= _NOWHERE:
            return cls(_Curve.line(q[0], np.zeros(6)), 0.0)
        # Both q(u) and u(s) are smooth: so is q(s), through its values at even s.
        even = np.linspace(0.0, length, steps + 1)
        before = np.minimum(s.searchsorted(even, side="right"), len(s) - 1) - 1
        # Between two of u, s is the parabola with the slopes there.
        rest, slope = even - s[before], rate[before]
        root = np.sqrt(np.maximum(slope**2 + 2 * rest * np.diff(rate)[before] / u[1], 0.0))
        there = u[before] + 2 * rest / np.maximum(slope + root, _NOWHERE)
        return cls(_Curve.spline(_Curve.spline(q)(there).T, length / steps), length)

    def reversed(self) -> Path:
        """Return the way back."""
        direction = None if self.direction is None else -self.direction
        path = Path(self.curve.reversed(self.length), self.length, direction)
        path.there = self.there
        return path

    def __call__(self, s: Array, order: int = 0) -> Array:
        """Return the derivative of that order (0 to 3) of q with respect to s: (N,) -> (N, 6)."""
        s = np.asarray(s)
        return np.ascontiguousarray((self.derivatives(s)[order] if order else self.curve(s)).T)

    def derivatives(self, s: Array) -> Array:
        """Return q and its first three derivatives with respect to s: (N,) -> (4, 6, N)."""
        return derivatives_of([self], [s])

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


def derivatives_of(paths: Sequence[Path], s: Sequence[Array]) -> Array:
    """Return q and its first three derivatives with respect to s (4, 6, N) of alike paths.

    All in one pass: there is one look-up in all their tables, and one sum over powers.

    Args:
        paths: all straight, or all splines.
        s: (N_k,) of each; N is their sum.
    """
    curves = [path.curve for path in paths]
    firsts = np.cumsum([0, *(len(curve.origins) for curve in curves)]).tolist()
    pieces = [curve.pieces(x) + k for curve, x, k in zip(curves, s, firsts, strict=False)]
    piece = np.concatenate(pieces)
    along = np.concatenate(s) - np.concatenate([curve.origins for curve in curves])[piece]
    table = np.concatenate([curve.table for curve in curves], axis=2)
    powers = np.empty((len(table), len(along)))
    powers[0], powers[1:] = 1.0, along
    np.multiply.accumulate(powers, axis=0, out=powers)
    slopes = powers.take(_LOWER[: len(table)], axis=0)
    slopes *= _FACTORS[: len(table)]
    return np.asarray(np.einsum("pjn,pon->ojn", table.take(piece, axis=2), slopes))


def _norm(x: Array) -> Array:
    """Return the 8-norm over joints that defines the arc length: (..., 6) -> (...)."""
    eighth = np.square(np.square(np.square(x)))
    return np.asarray(np.sqrt(np.sqrt(np.sqrt(np.sum(eighth, axis=-1)))))


@cache
def _slopes(samples: int, count: int) -> Array:
    """Return what makes the slopes (count, 6), evenly along it, of the spline through samples.

    Args:
        samples: how many they are, at x = 0, 1, 2, ...
        count: how many slopes.

    Returns:
        (count, samples).
    """
    pieces, begins = spline.pieces(samples)
    x = np.linspace(0.0, samples - 1.0, count)
    piece = begins[1:].searchsorted(x, side="right")
    along = (x - begins[piece])[:, None] ** _LOWER[:, 1] * _FACTORS[:, 1, 0]
    return np.asarray(np.einsum("np,pnk->nk", along, pieces[:, piece]))
