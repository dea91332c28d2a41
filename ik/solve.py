"""Inverse kinematics: all branches of one pose or of a million, by the same call."""

from __future__ import annotations

import struct
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from . import _batch, _single
from .arm import Arm
from .exceptions import InvalidPose
from .poses import explain

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]

_pack = struct.Struct("48d").pack_into


class Solutions(NamedTuple):
    """All branches of each pose, in the order of the branch table in README.md.

    Branch 4 * shoulder + 2 * elbow + wrist: shoulder 0 has the wrist center in front of axis 1, 1
    behind it; elbow 0 has theta3 above the stretched arm's, 1 below; wrist 0 has theta5 >= 0, 1
    theta5 <= 0. The angles are the robot's, so a negative sign of axis 5 swaps what is seen.
    """

    q: FloatArray
    """Joint angles [rad], within [-pi, pi]; NaN where a branch does not exist. Shape (..., 8, 6)."""
    valid: BoolArray
    """The branch exists, limits apart. Shape (..., 8)."""


def inverse(arm: Arm, T: ArrayLike) -> Solutions:
    """Compute every configuration that brings the tool to a pose.

    Args:
        arm: The arm.
        T: T_base_tool. Shape (..., 4, 4). One matrix takes a path of its own that costs
            microseconds.

    Returns:
        Eight branches per pose. An unreachable pose has no valid branch; that is no error.

    Raises:
        InvalidPose: A matrix is no rigid transform (see `check_poses`).
    """
    poses = np.asarray(T, dtype=np.float64)
    if poses.shape == (4, 4):
        rows = poses.tolist()
        if not _single.is_rigid(rows):
            raise explain(poses[None], ())
        branches = _single.solve(arm, rows)
        q = np.empty((8, 6))
        a, b, c, d, e, f, g, h = branches
        _pack(q, 0, *a, *b, *c, *d, *e, *f, *g, *h)
        return Solutions(q, q[:, 0] == q[:, 0])
    if poses.ndim < 2 or poses.shape[-2:] != (4, 4):
        raise InvalidPose(f"T must have shape (..., 4, 4), got {poses.shape}")
    flat = np.ascontiguousarray(poses).reshape(-1, 4, 4)
    q = np.empty((len(flat), 8, 6))
    if not _batch.solve(arm, flat, q):
        raise explain(flat, poses.shape[:-2])
    q = q.reshape(*poses.shape[:-2], 8, 6)
    return Solutions(q, ~np.isnan(q[..., 0]))
