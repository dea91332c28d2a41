"""Inverse kinematics: all branches of one pose or of a million, by the same call."""

from __future__ import annotations

import math
import struct
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from . import _batch, _single
from .arm import Arm
from .exceptions import InvalidPose
from .kinematics import singular
from .limits import Bounds, find_bounds
from .poses import explain

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]

NO_BRANCHES = [math.nan] * 24
EXISTS = {
    (front, back): np.array([front] * 4 + [back] * 4, dtype=np.bool_)
    for front in (False, True)
    for back in (False, True)
}
"""The masks a pose can have: a shoulder reaches it with both elbows and both wrists, or not."""
for _mask in EXISTS.values():
    _mask.setflags(write=False)

# both take half the time of the NumPy functions that do the same
_store: Callable[..., None] = struct.Struct("48d").pack_into
_BOOL = np.dtype(np.bool_)


class Solutions(NamedTuple):
    """All branches of each pose, in the order of the branch table in README.md.

    Branch 4 * shoulder + 2 * elbow + wrist: shoulder 0 ("front") has the wrist center in front of
    axis 1, 1 ("back") behind it; elbow 0 ("up") has theta3 above that of the stretched arm, 1
    ("down") below; wrist 0 ("+") has theta5 >= 0, 1 ("-") theta5 <= 0.
    """

    arm: Arm
    """The arm they are for."""
    q: FloatArray
    """Joint angles [rad], within [-pi, pi] but for the turns that limits ask for; NaN where a
    branch does not exist. Shape (..., 8, 6)."""
    valid: BoolArray
    """The branch exists, limits apart. Shape (..., 8)."""
    in_limits: BoolArray
    """The branch exists, and its q is inside of the limits if any were given. Shape (..., 8)."""

    @property
    def singular(self) -> BoolArray:
        """The branch is at its shoulder, elbow or wrist singularity. Shape (..., 8, 3).

        There its joint angles are one choice of infinitely many (shoulder, wrist), or it coincides
        with another branch (elbow, and shoulder or wrist too). See README.md for the choice.
        """
        return singular(self.arm, self.q)


def inverse(arm: Arm, T: ArrayLike, limits: tuple[ArrayLike, ArrayLike] | None = None) -> Solutions:
    """Compute every configuration that brings the tool to a pose.

    Args:
        arm: The arm.
        T: T_base_tool. Shape (..., 4, 4). One matrix takes a path of its own, which costs
            microseconds.
        limits: Lower and upper joint limits [rad], shapes (6,). Branches that a number of turns
            brings inside, `LIMIT_SLACK` allowed, are turned by the least number upwards from the
            lower limit; use `turns` to have all.

    Returns:
        Eight branches per pose. An unreachable pose has no valid branch; that is no error.

    Raises:
        InvalidPose: A matrix is no rigid transform (see `check_poses`).
        IKError: The limits have a wrong shape or value.
    """
    poses = np.asarray(T, dtype=np.float64)
    bounds = None if limits is None else find_bounds(*limits)
    if poses.shape == (4, 4) and (single := _inverse_single(arm, poses, bounds)):
        return single
    if poses.ndim < 2 or poses.shape[-2:] != (4, 4):
        raise InvalidPose(f"T must have shape (..., 4, 4), got {poses.shape}")
    shape = poses.shape[:-2]
    flat = np.ascontiguousarray(poses).reshape(-1, 4, 4)
    q = np.empty((len(flat), 8, 6))
    valid, inside = np.empty((2, len(flat), 8), dtype=np.bool_)
    if not _batch.solve(arm, flat, q, valid, bounds, inside):
        raise explain(flat, shape)
    return Solutions(
        arm, q.reshape(*shape, 8, 6), valid.reshape(*shape, 8), inside.reshape(*shape, 8)
    )


def _inverse_single(arm: Arm, pose: FloatArray, bounds: Bounds | None) -> Solutions | None:
    """Solve one pose (4, 4) in Python floats, unless it is next to the edge of reach."""
    rows = pose.tolist()
    if not _single.is_rigid(rows):
        raise explain(pose[None], ())
    branches = _single.solve(arm, rows)
    if branches is None:
        return None
    front, back = branches
    valid = EXISTS[bool(front), bool(back)].copy()
    angles = (front or NO_BRANCHES) + (back or NO_BRANCHES)
    if bounds:
        inside = np.ndarray(8, _BOOL, _single.turn_into_limits(angles, bounds))
    else:
        inside = valid.copy()
    q = np.empty((8, 6))
    _store(q, 0, *angles)
    return Solutions(arm, q, valid, inside)
