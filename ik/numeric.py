"""Numeric inverse kinematics, for comparison: damped least squares with random restarts.

It needs no closed form, and shows what one buys: it returns one configuration of the up to eight,
takes a hundred times as long, and can fail on a pose that is reachable. It never asks `inverse`.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .arm import Arm
from .choice import nearest
from .exceptions import IKError
from .kinematics import Frame, jacobian_columns, own_frames
from .limits import check_limits
from .poses import check_poses

FloatArray = NDArray[np.float64]


class NumericOptions(NamedTuple):
    """When the iteration is done, and when it gives up."""

    tolerance: float = 1e-10
    """Error at which a pose counts as reached, position [m] and rotation [rad] together."""
    iterations: int = 60
    """Steps from one start."""
    restarts: int = 40
    """Random starts after the given one, until the pose is given up."""
    damping: float = 1e-12
    """Damping that remains when the error vanishes; the error itself is added to it."""


def numeric_solver(
    arm: Arm,
    lower: ArrayLike,
    upper: ArrayLike,
    *,
    seed: int = 0,
    options: NumericOptions | None = None,
) -> Callable[[FloatArray, FloatArray], FloatArray]:
    """Make a solver f(T (n, 4, 4), q_start (6,)) -> q (n, 6), NaN rows for no answer.

    Args:
        arm: The arm.
        lower: Lower limits [rad], finite. Shape (6,).
        upper: Upper limits [rad], finite. Shape (6,).
        seed: Each call of the solver draws its restarts from a generator of its own with this
            seed, so its answer depends on its arguments alone.
        options: Defaults are those of `NumericOptions`.

    Returns:
        `inverse_numeric` with these arguments filled in.

    Raises:
        IKError: Limits have a wrong shape or value.
    """
    low, high, _ = check_limits(lower, upper)

    def solve(T: FloatArray, q_start: FloatArray) -> FloatArray:
        return inverse_numeric(arm, T, q_start, low, high, rng=seed, options=options)

    return solve


def inverse_numeric(
    arm: Arm,
    T: ArrayLike,
    q_start: ArrayLike,
    lower: ArrayLike,
    upper: ArrayLike,
    *,
    rng: np.random.Generator | int = 0,
    options: NumericOptions | None = None,
) -> FloatArray:
    """Find one configuration inside of the limits for each pose of a sequence.

    Each pose starts from the answer to the one before, as a path wants it; where that fails, from
    configurations drawn evenly from inside of the limits.

    Args:
        arm: The arm.
        T: T_base_tool. Shape (n, 4, 4).
        q_start: Where the first pose starts from [rad]. Shape (6,).
        lower: Lower limits [rad], finite. Shape (6,).
        upper: Upper limits [rad], finite. Shape (6,).
        rng: Generator for the restarts, or the seed of one.
        options: Defaults are those of `NumericOptions`.

    Returns:
        Joint angles [rad], a row of NaN where none was found. Shape (n, 6).

    Raises:
        InvalidPose: A matrix is no rigid transform.
        IKError: Another argument has a wrong shape or value.
    """
    poses = np.asarray(T, dtype=np.float64)
    if poses.ndim != 3:
        raise IKError(f"T must have shape (n, 4, 4), got {poses.shape}")
    check_poses(poses)
    low, high, _ = check_limits(lower, upper)
    q = np.array(q_start, dtype=np.float64)
    if q.shape != (6,) or not np.isfinite(q).all():
        raise IKError(f"q_start must be six finite angles in rad, got {q_start!r}")
    if not (np.isfinite(low).all() and np.isfinite(high).all()):
        raise IKError("random restarts need finite limits; give a continuous joint +-pi")
    generator = np.random.default_rng(rng)
    result = np.full((len(poses), 6), np.nan)
    for i, pose in enumerate(poses):
        found = _solve_one(arm, pose, q, low, high, generator, options or NumericOptions())
        if found is not None:
            result[i] = q = found
    return result


def _solve_one(
    arm: Arm,
    pose: FloatArray,
    q: FloatArray,
    low: FloatArray,
    high: FloatArray,
    rng: np.random.Generator,
    options: NumericOptions,
) -> FloatArray | None:
    """Descend from the given start, then from random ones, to an answer inside of the limits."""
    for attempt in range(options.restarts + 1):
        start = q if attempt == 0 else rng.uniform(low, high)
        end = _descend(arm, pose, start, options)
        if end is not None:
            inside = nearest(end[None], start, low, high)
            if not np.isnan(inside[0]):
                return inside
    return None


def _descend(
    arm: Arm, pose: FloatArray, start: FloatArray, options: NumericOptions
) -> FloatArray | None:
    """Iterate q += (J^T J + (e^2 / 2 + damping) I)^-1 J^T e until the error e is small.

    Damping by the squared error makes large errors safe and small ones converge quadratically
    (Sugihara, "Solvability-unconcerned inverse kinematics by the Levenberg-Marquardt method",
    IEEE Transactions on Robotics, 2011, eq. 20).
    """
    q = start.copy()
    target = pose[:3].tolist()
    best = math.inf
    for _ in range(options.iterations):
        links = own_frames(arm, q)
        error = _error(target, links[6])
        size = float(error @ error)
        if size < options.tolerance**2 and size >= 0.25 * best:
            return q  # and it gets no better
        best = min(best, size)
        J = np.array(jacobian_columns(arm, links))  # its rows are the columns of the Jacobian
        H = J @ J.T
        H.flat[::7] += 0.5 * size + options.damping
        q = q + np.linalg.solve(H, J @ error)
    return q if best < options.tolerance**2 else None


def _error(target: list[list[float]], tip: Frame) -> FloatArray:
    """Return the position error [m] and the rotation vector that is missing [rad], in the base."""
    (xx, xy, xz, px), (yx, yy, yz, py), (zx, zy, zz, pz) = target
    x, y, z, p = tip
    # half the sum of a_i x t_i over the columns of both rotations is sin(angle) * axis
    u = 0.5 * (x[1] * zx - x[2] * yx + y[1] * zy - y[2] * yy + z[1] * zz - z[2] * yz)
    v = 0.5 * (x[2] * xx - x[0] * zx + y[2] * xy - y[0] * zy + z[2] * xz - z[0] * zz)
    w = 0.5 * (x[0] * yx - x[1] * xx + y[0] * yy - y[1] * xy + z[0] * yz - z[1] * xz)
    sine = math.sqrt(u * u + v * v + w * w)
    trace = x[0] * xx + x[1] * yx + x[2] * zx + y[0] * xy + y[1] * yy + y[2] * zy
    trace += z[0] * xz + z[1] * yz + z[2] * zz
    angle = math.atan2(sine, 0.5 * (trace - 1.0))
    # half a turn off, the axis is lost in rounding: any axis leads away from there
    u, v, w, sine = (u, v, w, sine) if sine > 1e-9 or angle < 1.0 else (1.0, 0.0, 0.0, 1.0)
    scale = angle / sine if sine > 0.0 else 1.0
    return np.array([px - p[0], py - p[1], pz - p[2], u * scale, v * scale, w * scale])
