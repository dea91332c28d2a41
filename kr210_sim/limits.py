"""Velocity, acceleration and jerk limits of a motion, and how far they are used."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import accumulate, pairwise

import numpy as np

from kr210_sim.arrays import Array
from kr210_sim.path import Path, derivatives_of
from kr210_sim.robot import ACCELERATION_TIME
from kr210_sim.time_law import TimeLaw, laws_at

JERK_TIME = 0.05
"""Time from zero to the acceleration limit at the jerk limit [s]."""

_INSTANT = 1e-9  # [s]
_STEP = 1 / 125  # of samples of a motion, as a share of the time to accelerate to full speed
_PEAK = 0.98  # share of the greatest value that a peak must have to be looked at closely
_FLAT = 1e-9  # curvature over a step below which nothing is hidden between the samples
_ASIDE = np.delete(np.linspace(-0.9, 0.9, 19), 9)  # in steps


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

    @cached_property
    def orders(self) -> Array:
        """The three limits (3, 6, 1), one below the other."""
        return np.array([self.velocity, self.acceleration, self.jerk])[:, :, None]

    @cached_property
    def step(self) -> float:
        """Spacing of samples of a motion [s], the same points of its path at any speed."""
        return _STEP * float(np.min(self.velocity / self.acceleration))

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


def shift(path: Path, law: TimeLaw, t: Array) -> Array:
    """Return q - q(0) (6, N) [rad] of one motion at times t (N,) [s]; zero before it begins."""
    s = law.position(t)
    if path.direction is not None:
        return np.asarray(path.direction[:, None] * s)
    return np.asarray((path(s) - path.start).T)


def states(path: Path, law: TimeLaw, t: Array) -> Array:
    """Return q - q(0) and its first three derivatives (4, 6, N) of one motion at times t (N,) [s].

    After its end a motion stays where it is.
    """
    return states_of([path], [law], [t])


def states_of(paths: Sequence[Path], laws: Sequence[TimeLaw], times: Sequence[Array]) -> Array:
    """Return q - q(0) and its first three derivatives (4, 6, N) of motions, in one pass.

    Args:
        paths: of the motions; their columns stand side by side.
        laws: of the motions.
        times: (N_k,) of each [s]; N is their sum.
    """
    along = laws_at(laws, times)
    counts = [len(t) for t in times]
    found = np.empty((4, 6, along.shape[1]))
    bent = []
    for path, part in zip(paths, slices(counts), strict=True):
        if path.direction is None:
            bent.append((path, part))
        else:
            np.multiply(along[:, None, part], path.direction[:, None], out=found[:, :, part])
    if bent:
        curved = derivatives_of([path for path, _ in bent], [along[0, part] for _, part in bent])
        own = slices([part.stop - part.start for _, part in bent])
        chain(curved[1:], np.concatenate([along[1:, part] for _, part in bent], axis=1))
        for (path, part), columns in zip(bent, own, strict=True):
            curved[0, :, columns] -= path.start[:, None]
            found[:, :, part] = curved[:, :, columns]
    return found


def slices(counts: Sequence[int]) -> list[slice]:
    """Return which columns belong to each of some things that stand side by side."""
    ends = [0, *accumulate(counts)]
    return [slice(first, end) for first, end in pairwise(ends)]


def chain(along: Array, law: Array) -> None:
    """Turn the first three derivatives of q(s) into those of q(s(t)), in place: the chain rule.

    Args:
        along: (3, 6, ...) of q with respect to s; becomes that with respect to t.
        law: (3, ...) of s with respect to t.
    """
    q1, q2, q3 = along
    ds, dds, ddds = law
    squared = ds * ds
    q3 *= squared * ds
    q3 += q1 * ddds + q2 * (3 * ds * dds)
    q2 *= squared
    q2 += q1 * dds
    q1 *= ds


def around(times: Array) -> Array:
    """Return instants just before and just after each, for what jumps there."""
    return np.concatenate([times - _INSTANT, times + _INSTANT])


def usages(derivatives: Array, limits: MotionLimits) -> Array:
    """Return the largest |qd|/v, |qdd|/a and |qddd|/j (3, N) of derivatives (3, 6, N) of q."""
    return np.asarray(np.max(np.abs(derivatives) / limits.orders, axis=1))


def about_peaks(t: Array, values: Array) -> Array:
    """Return where smooth functions may be greatest: instants (M,) about their highest peaks.

    Args:
        t: (N,) even times.
        values: (K, N) of the functions there.
    """
    framed = np.full((len(values), len(t) + 2), -np.inf)
    framed[:, 1:-1] = values
    before, after = framed[:, :-2], framed[:, 2:]
    peak = (values > _PEAK * np.max(values)) & (values >= before) & (values >= after)
    peak &= 2 * values - before - after > _FLAT
    about = (t[np.nonzero(peak)[1], None] + (t[1] - t[0]) * _ASIDE).ravel()
    return np.asarray(about[(about > t[0]) & (about < t[-1])])
