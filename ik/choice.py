"""Choose among branches and turns: the candidates for a pose, and the one nearest to a seed."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .arm import Arm
from .exceptions import IKError
from .limits import TWO_PI, check_limits
from .tolerances import LIMIT_SLACK, SLIDE_TOLERANCE

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]


def joint_time(q_from: ArrayLike, q_to: ArrayLike, velocity: ArrayLike) -> FloatArray:
    """Compute the time of a joint motion at the velocity limits, max over joints |dq| / v_max.

    Args:
        q_from: Joint angles [rad]. Shape (..., 6).
        q_to: Joint angles [rad]. Shape (..., 6).
        velocity: Velocity limits [rad/s]. Shape (6,).

    Returns:
        [s]. Shape (...).
    """
    dq = np.abs(np.asarray(q_to, dtype=np.float64) - np.asarray(q_from, dtype=np.float64))
    return np.asarray((dq / np.asarray(velocity, dtype=np.float64)).max(axis=-1))


def nearest(
    q: ArrayLike,
    seed: ArrayLike,
    lower: ArrayLike,
    upper: ArrayLike,
    *,
    velocity: ArrayLike = (1.0, 1.0, 1.0, 1.0, 1.0, 1.0),
    slack: float = LIMIT_SLACK,
) -> FloatArray:
    """Choose the branch and the turns that are nearest to a seed, inside of the limits.

    Args:
        q: Branches, as `inverse` returns them [rad]; NaN rows are none. Shape (..., 8, 6).
        seed: Joint angles to be near to [rad]. Shape (6,) or (..., 6).
        lower: Lower limits [rad], -inf for none. Shape (6,).
        upper: Upper limits [rad], +inf for none. Shape (6,).
        velocity: Velocity limits, by which distances are weighed: nearest is what takes the
            shortest `joint_time` [rad/s]. Shape (6,).
        slack: How far outside of the limits still counts as inside [rad].

    Returns:
        The configuration; a row of NaN where no branch is inside of the limits. Shape (..., 6).

    Raises:
        IKError: Limits or velocities have a wrong shape or value.
    """
    low, high, v = check_limits(lower, upper, velocity)
    branches = np.asarray(q, dtype=np.float64)
    target = np.asarray(seed, dtype=np.float64)[..., None, :]
    near = branches + TWO_PI * np.rint((target - branches) / TWO_PI)
    above, below = near - high - slack, low - slack - near
    with np.errstate(invalid="ignore"):  # rows of NaN
        near = near - TWO_PI * np.ceil(np.maximum(above, 0.0) / TWO_PI)
        near = near + TWO_PI * np.ceil(np.maximum(below, 0.0) / TWO_PI)
        inside = ((near >= low - slack) & (near <= high + slack)).all(axis=-1)
    time = np.where(inside, joint_time(target, near, v), np.inf)
    best = time.argmin(axis=-1)[..., None]
    found = np.isfinite(np.take_along_axis(time, best, axis=-1))
    chosen = np.take_along_axis(near, best[..., None], axis=-2)[..., 0, :]
    return np.where(found, chosen, np.nan)


def slide_wrist(arm: Arm, q: ArrayLike, q4: ArrayLike) -> FloatArray:
    """Give joint 4 another angle at a wrist singularity, without moving the tool.

    At theta5 = 0 only theta4 + theta6 is given by the pose, at theta5 = +-pi only theta4 - theta6,
    and `inverse` returns one split of it. Next to the singularity, above `SLIDE_TOLERANCE`, the
    split is given by the pose, and the configuration is returned as it is.

    Args:
        arm: The arm.
        q: Joint angles [rad]. Shape (..., 6).
        q4: Wanted angles of joint 4 [rad]. Shape (...).

    Returns:
        Joint angles [rad], joint 6 within pi of where it was. Shape (..., 6).

    Raises:
        IKError: The last dimension of q is not 6.
    """
    angles = np.asarray(q, dtype=np.float64)
    if angles.ndim < 1 or angles.shape[-1] != 6:
        raise IKError(f"q must have shape (..., 6), got {angles.shape}")
    theta5 = arm.signs[4] * angles[..., 4] + arm.offsets[4]
    at = np.abs(np.sin(theta5)) <= SLIDE_TOLERANCE
    step = np.where(at, np.asarray(q4, dtype=np.float64) - angles[..., 3], 0.0)
    same = np.where(np.cos(theta5) > 0.0, -1.0, 1.0) * arm.signs[3] * arm.signs[5]
    result = np.array(np.broadcast_to(angles, (*np.shape(step), 6)))
    result[..., 3] += step
    result[..., 5] += np.remainder(same * step + np.pi, TWO_PI) - np.pi
    return result
