"""Any serial chain of revolute joints, as arrays: its frames, and its axes in the zero pose.

A chain is what a robot description lists: for each joint the fixed transform from the parent link
to the joint (`origins`), and the joint's axis in that frame (`axes`). A row of zeros in `axes` is a
fixed joint. Reading a description file is up to the caller.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .exceptions import IKError
from .poses import check_poses

FloatArray = NDArray[np.float64]


class Axes(NamedTuple):
    """The axes of the moving joints as lines in the base frame, all joints at zero."""

    points: FloatArray
    """A point on each axis, its joint's origin [m]. Shape (m, 3)."""
    directions: FloatArray
    """Unit vectors; positive angles turn by the right-hand rule. Shape (m, 3)."""
    T_tip: FloatArray
    """Pose of the chain's end. Shape (4, 4)."""


def chain_frames(origins: ArrayLike, axes: ArrayLike, q: ArrayLike) -> FloatArray:
    """Compute the pose of every link of a chain in its base frame.

    The rotation about an axis is Rodrigues' formula, so this shares nothing with the formulas of
    `forward` and can check them.

    Args:
        origins: Fixed transform from the parent link to each joint. Shape (n, 4, 4).
        axes: Axis of each joint in its own frame, any length; zeros for a fixed joint.
            Shape (n, 3).
        q: Angles of the m moving joints [rad]. Shape (..., m).

    Returns:
        T_base_link of the link behind each joint, fixed ones included. Shape (..., n, 4, 4).

    Raises:
        IKError: Shapes do not match, an axis is not finite, or q has the wrong length.
        InvalidPose: An origin is no rigid transform.
    """
    T_joint, unit = _checked(origins, axes)
    moving = np.flatnonzero(unit.any(axis=1))
    angles = np.asarray(q, dtype=np.float64)
    if angles.ndim < 1 or angles.shape[-1] != len(moving):
        raise IKError(f"q must have shape (..., {len(moving)}), got {angles.shape}")
    frames = np.empty((*angles.shape[:-1], len(unit), 4, 4))
    T = np.broadcast_to(np.eye(4), (*angles.shape[:-1], 4, 4))
    for i, axis in enumerate(unit):
        T = T @ T_joint[i]
        if axis.any():
            T = T @ rotation_about(axis, angles[..., np.searchsorted(moving, i)])
        frames[..., i, :, :] = T
    return frames


def chain_axes(origins: ArrayLike, axes: ArrayLike, T_tip: ArrayLike | None = None) -> Axes:
    """Find the axes of a chain in its zero pose, fixed joints folded in.

    Args:
        origins: Fixed transform from the parent link to each joint. Shape (n, 4, 4).
        axes: Axis of each joint in its own frame, any length; zeros for a fixed joint.
            Shape (n, 3).
        T_tip: Pose of the tip in the last link. Shape (4, 4); the last link itself by default.

    Returns:
        The axes of the m moving joints and the pose of the tip.

    Raises:
        IKError: Shapes do not match or an axis is not finite.
        InvalidPose: An origin or the tip is no rigid transform.
    """
    T_joint, unit = _checked(origins, axes)
    tip = np.eye(4) if T_tip is None else np.array(T_tip, dtype=np.float64)
    if tip.shape != (4, 4):
        raise IKError(f"T_tip must have shape (4, 4), got {tip.shape}")
    check_poses(tip, "T_tip")
    points, directions = [], []
    T = np.eye(4)
    for origin, axis in zip(T_joint, unit, strict=True):
        T = T @ origin
        if axis.any():
            points.append(T[:3, 3])
            directions.append(T[:3, :3] @ axis)
    m = len(points)
    return Axes(np.reshape(points, (m, 3)), np.reshape(directions, (m, 3)), T @ tip)


def rotation_about(axis: FloatArray, angle: FloatArray) -> FloatArray:
    """Return homogeneous rotations about a unit axis (Rodrigues' formula).

    Args:
        axis: Unit vector. Shape (3,).
        angle: [rad]. Shape (...).

    Returns:
        Shape (..., 4, 4).
    """
    x, y, z = axis
    K = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    s, c = np.sin(angle)[..., None, None], np.cos(angle)[..., None, None]
    T = np.zeros((*np.shape(angle), 4, 4))
    T[..., :3, :3] = c * np.eye(3) + s * K + (1.0 - c) * np.outer(axis, axis)
    T[..., 3, 3] = 1.0
    return T


def _checked(origins: ArrayLike, axes: ArrayLike) -> tuple[FloatArray, FloatArray]:
    """Return the origins (n, 4, 4) and the axes (n, 3) scaled to unit length, zeros kept."""
    T = np.asarray(origins, dtype=np.float64)
    a = np.asarray(axes, dtype=np.float64)
    if T.ndim != 3 or T.shape[1:] != (4, 4) or a.shape != (len(T), 3):
        raise IKError(f"want origins (n, 4, 4) and axes (n, 3), got {T.shape} and {a.shape}")
    check_poses(T, "origins")
    if not np.isfinite(a).all():
        raise IKError("axes must be finite; a row of zeros is a fixed joint")
    length = np.linalg.norm(a, axis=1, keepdims=True)
    return T, np.where(length > 0.0, a / np.where(length > 0.0, length, 1.0), 0.0)
