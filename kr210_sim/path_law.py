"""Paths + limits -> the quickest jerk-limited time laws along them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from kr210_sim.arrays import Array
from kr210_sim.limits import MotionLimits, about_peaks, around, chain, slices, states_of, usages
from kr210_sim.path import Path, derivatives_of
from kr210_sim.time_law import TimeLaw

_MARGIN = 1.0 - 1e-4  # share of the limits that is used, for what lies between the samples
_GRID = 81  # points of a path at which its limits are estimated
_INSTANTS = 3  # of each phase of constant jerk at which shapes are compared
_SAMPLES = 200  # instants of a motion at which its limits are evaluated, at least
_SIGNS = np.array([1.0, 0.0, -1.0, 0.0, -1.0, 0.0, 1.0])[:, None]  # of the jerk in its phases
_ROOTS = 1 / np.arange(1.0, 4.0)[:, None]  # orders of what a time scale changes
_SPEEDS = np.geomspace(0.1, 1.0, 8)  # shares of the speed limit tried on a curved path
_JERK_SHARES = np.array([1.0, 0.7, 0.4])  # of the acceleration limit: jerk is left for curvature
_NONE = 1e-12  # derivative below which a joint stands still
_LEAST = 0.05  # of the acceleration and jerk limits that a shape keeps on a tight curve


def quickest_laws(paths: Sequence[Path], limits: MotionLimits) -> list[TimeLaw]:
    """Return for each path the quickest of the laws that just hold the joint limits along it.

    Their shapes come from path limits (V, A, J) with |q1| V <= v, |q2| V^2 + |q1| A <= a and
    |q3| V^3 + 3 |q2| V A + |q1| J <= j, where q1, q2, q3 are the derivatives of the path. Each
    choice of V and A shares out differently what the curvature leaves.
    """
    bent = [path for path in paths if path.length > 0.0 and path.direction is None]
    curved = iter(_curved_laws(bent, limits)) if bent else iter(())
    return [
        next(curved) if path.length > 0.0 and path.direction is None else _plain_law(path, limits)
        for path in paths
    ]


def _plain_law(path: Path, limits: MotionLimits) -> TimeLaw:
    """Return the quickest law along a straight line of the joints, or nowhere."""
    if path.length == 0.0 or path.direction is None:
        return TimeLaw(0.0, 1.0, 1.0, 1.0)
    first = np.maximum(np.abs(path.direction), _NONE)
    v, a, j = np.min(limits.orders[:, :, 0] / first, axis=1).tolist()
    return TimeLaw(path.length, v * _MARGIN, a * _MARGIN**2, j * _MARGIN**3)


def _curved_laws(paths: Sequence[Path], limits: MotionLimits) -> list[TimeLaw]:
    """Return the quickest laws along P paths that bend, compared together."""
    length = np.array([path.length for path in paths])
    points = [np.linspace(0.0, path.length, _GRID) for path in paths]
    derivatives = derivatives_of(paths, points)[1:].reshape(3, 6, len(paths), _GRID)
    # Axes: path, choice of speed, share of the acceleration, joint and point of the path.
    steep = np.abs(derivatives).swapaxes(1, 2)
    first, second, third = steep.reshape(3, len(paths), 1, 1, -1)
    first = 1 / np.maximum(first, _NONE)
    full = [np.repeat(limit, _GRID) * first for limit in limits.orders]
    second *= first
    third *= first
    fastest, quickest, sharpest = (np.min(x, axis=3, keepdims=True) for x in full)
    v = fastest * _SPEEDS[:, None, None]
    a = np.min(full[1] - second * v**2, axis=3, keepdims=True)
    a = _JERK_SHARES[:, None] * np.maximum(a, _LEAST * quickest)
    taken = second * (3 * v * a)
    rest = np.subtract(full[2] - third * v**3, taken, out=taken)
    j = np.maximum(np.min(rest, axis=3, keepdims=True), _LEAST * sharpest)
    shapes = np.array(np.broadcast_arrays(v, a, j)).reshape(3, len(paths), -1)
    best = np.argmin(_durations(length, shapes, derivatives, limits), axis=1)
    chosen = shapes[:, np.arange(len(paths)), best].T.tolist()
    laws = [TimeLaw(path.length, *shape) for path, shape in zip(paths, chosen, strict=True)]
    return _fitted(paths, laws, limits)


def _durations(length: Array, shapes: Array, derivatives: Array, limits: MotionLimits) -> Array:
    """Return how long laws within path limits take once they are scaled to the joint limits.

    Args:
        length: (P,) of the paths [s].
        shapes: (3, P, n) path limits V, A and J.
        derivatives: (3, 6, P, N) of the paths, evenly along each.
        limits: of the joints.

    Returns:
        (P, n) [s].
    """
    count, points = shapes.shape[2], derivatives.shape[3]
    length, owner = (np.repeat(x, count) for x in (length, np.arange(len(length))))
    v, a, j = shapes.reshape(3, -1)
    phases = _phases(length, v, a, j)
    s, *law = _states(phases, j)
    at = np.minimum(np.maximum(s / length, 0.0), 1.0) * (points - 1)
    index = np.minimum(at.astype(np.int64), points - 2)
    share = at - index
    index += points * owner
    rows = derivatives.reshape(3, 6, -1)
    used = np.diff(rows, append=0.0).take(index, axis=2)
    used *= share
    used += rows.take(index, axis=2)
    chain(used, np.array(law))
    used = np.max(np.abs(used, out=used), axis=2) / limits.orders
    stretch = np.max(np.max(used, axis=1) ** _ROOTS, axis=0)
    return np.asarray(np.sum(phases, axis=0) * stretch).reshape(-1, count)


def _phases(length: Array, v: Array, a: Array, j: Array) -> Array:
    """Return the durations (7, n) of the phases of constant jerk, from rest to rest.

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
    return np.array([ramp, hold, ramp, cruise, ramp, hold, ramp])


def _states(phases: Array, jerk: Array) -> tuple[Array, Array, Array, Array]:
    """Return s and its derivatives (7 m, n) at m instants in each phase, its ends included."""
    ddds = _SIGNS * jerk
    dds = _before(phases * ddds)
    ds = _before(phases * (dds + phases * ddds / 2))
    s = _before(phases * (ds + phases * (dds / 2 + phases * ddds / 6)))
    t = phases[:, None] * np.linspace(0.0, 1.0, _INSTANTS)[:, None]
    s, ds, dds, ddds = (x[:, None] for x in (s, ds, dds, ddds))
    found = (
        s + t * (ds + t * (dds / 2 + t * ddds / 6)),
        ds + t * (dds + t * ddds / 2),
        dds + t * ddds,
        np.repeat(ddds, _INSTANTS, axis=1),
    )
    s, ds, dds, ddds = (x.reshape(-1, len(jerk)) for x in found)
    return s, ds, dds, ddds


def _before(gains: Array) -> Array:
    """Return what has been gained before each phase (7, n), from the gains in each (7, n)."""
    sums = np.zeros_like(gains)
    np.cumsum(gains[:-1], axis=0, out=sums[1:])
    return sums


def _fitted(paths: Sequence[Path], laws: Sequence[TimeLaw], limits: MotionLimits) -> list[TimeLaw]:
    """Return laws along paths, each scaled in time until it touches its tightest limit."""
    counts = [max(_SAMPLES, int(np.ceil(law.duration / limits.step)) + 1) for law in laws]
    times = [np.linspace(0.0, law.duration, count) for law, count in zip(laws, counts, strict=True)]
    stretches = _stretches(paths, laws, times, limits)
    closer = [
        np.concatenate([around(law.changes), about_peaks(t, stretch)])
        for law, t, stretch in zip(laws, times, stretches, strict=True)
    ]
    peaks = _stretches(paths, laws, closer, limits)
    return [
        law.slowed(_MARGIN / max(float(np.max(stretch)), float(np.max(peak))))
        for law, stretch, peak in zip(laws, stretches, peaks, strict=True)
    ]


def _stretches(
    paths: Sequence[Path], laws: Sequence[TimeLaw], times: Sequence[Array], limits: MotionLimits
) -> list[Array]:
    """Return how much slower laws must be for the limits of each order (3, N) at times (N,)."""
    found = usages(states_of(paths, laws, times)[1:], limits) ** _ROOTS
    return [found[:, part] for part in slices([len(t) for t in times])]
