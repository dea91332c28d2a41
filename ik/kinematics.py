"""Forward kinematics of an arm: poses, wrist center, Jacobian, distances from singularities."""

from __future__ import annotations

from collections.abc import Sequence
from math import cos, sin
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .arm import Arm
from .exceptions import IKError
from .tolerances import SINGULAR_TOLERANCE

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]

Vector = tuple[Any, Any, Any]
"""Three components, each a float or an array: the formulas below serve both."""


class Frame(NamedTuple):
    """A frame in the base frame: its three axes and its origin [m]."""

    x: Vector
    y: Vector
    z: Vector
    p: Vector


def forward(arm: Arm, q: ArrayLike) -> FloatArray:
    """Compute the pose of the tool in the base frame.

    Args:
        arm: The arm.
        q: Joint angles [rad]. Shape (..., 6).

    Returns:
        T_base_tool. Shape (..., 4, 4).

    Raises:
        IKError: The last dimension of q is not 6.
    """
    return np.asarray(_matrices(own_frames(arm, q)[6:])[..., 0, :, :])


def link_frames(arm: Arm, q: ArrayLike) -> FloatArray:
    """Compute the poses of the six links and of the tool in the base frame.

    These are the arm's own frames (figure in README.md): those of links 1, 2 and 3 have their
    origin at the shoulder, the shoulder in the arm plane, and the elbow, those of links 4, 5 and 6
    at the wrist center. In the arm's zero pose all are parallel to its base. The link frames of a
    robot description come from `chain_frames`.

    Args:
        arm: The arm.
        q: Joint angles [rad]. Shape (..., 6).

    Returns:
        T_base_link for links 1 to 6, then T_base_tool. Shape (..., 7, 4, 4).

    Raises:
        IKError: The last dimension of q is not 6.
    """
    return _matrices(own_frames(arm, q))


def wrist_center(arm: Arm, T: ArrayLike) -> FloatArray:
    """Compute where a pose of the tool puts the wrist center (step 1 of README.md).

    Args:
        arm: The arm.
        T: T_base_tool. Shape (..., 4, 4).

    Returns:
        The common point of axes 4, 5 and 6 in the base frame [m]. Shape (..., 3).
    """
    poses = np.asarray(T, dtype=np.float64)
    return np.asarray(poses[..., :3, 3] - poses[..., :3, :3] @ np.array(arm.constants.c_tool))


def jacobian(arm: Arm, q: ArrayLike) -> FloatArray:
    """Compute the geometric Jacobian of the tool in the base frame.

    Column i is (z_i x (p - o_i), z_i), with z_i the direction of axis i, o_i a point on it and p
    the tool's origin (Siciliano et al., "Robotics", eq. 3.30).

    Args:
        arm: The arm.
        q: Joint angles [rad]. Shape (..., 6).

    Returns:
        Rows 0 to 2: velocity of the tool's origin [m/rad]; rows 3 to 5: angular velocity
        [rad/rad]. Shape (..., 6, 6).

    Raises:
        IKError: The last dimension of q is not 6.
    """
    columns = jacobian_columns(arm, own_frames(arm, q))
    shape = np.shape(columns[0][0])
    J = np.empty((*shape, 6, 6))
    for j, column in enumerate(columns):
        for i, entry in enumerate(column):
            J[..., i, j] = entry
    return J


def singularity_distances(arm: Arm, q: ArrayLike) -> FloatArray:
    """Compute how far a configuration is from the three singularities of the class.

    Args:
        arm: The arm.
        q: Joint angles [rad]. Shape (..., 6).

    Returns:
        Shoulder: distance of the wrist center from axis 1 within the arm plane, over L2 + L3.
        Elbow: |sin gamma|, gamma the angle by which the elbow is bent. Wrist: |sin theta5|.
        All [1], zero at the singularity. Shape (..., 3).

    Raises:
        IKError: The last dimension of q is not 6.
    """
    theta = own_angles(arm, q)
    k = arm.constants
    t2, t3, t5 = theta[..., 1], theta[..., 2], theta[..., 4]
    rho = arm.a1 + arm.L2 * np.sin(t2) + arm.d4 * np.cos(t2 + t3) + arm.a3 * np.sin(t2 + t3)
    distances = (rho / k.reach, np.cos(t3 + k.phi), np.sin(t5))
    return np.asarray(np.abs(np.stack(distances, axis=-1)))


def singular(arm: Arm, q: ArrayLike, tolerance: float = SINGULAR_TOLERANCE) -> BoolArray:
    """Flag the singularities that a configuration is at.

    Args:
        arm: The arm.
        q: Joint angles [rad]; NaN is not singular. Shape (..., 6).
        tolerance: Largest of the `singularity_distances` that counts [1].

    Returns:
        Shoulder, elbow, wrist. Shape (..., 3).

    Raises:
        IKError: The last dimension of q is not 6.
    """
    return np.asarray(singularity_distances(arm, q) < tolerance)


def manipulability(arm: Arm, q: ArrayLike) -> FloatArray:
    """Compute Yoshikawa's measure sqrt(det(J J^T)) = |det J|.

    The Jacobian at the wrist center is block triangular, so the determinant is the product
    rho * L2 * L3 * sin gamma * sin theta5 of what vanishes at the three singularities. As a
    product it keeps its digits next to them.

    Args:
        arm: The arm.
        q: Joint angles [rad]. Shape (..., 6).

    Returns:
        [m^3]. Shape (...).

    Raises:
        IKError: The last dimension of q is not 6.
    """
    k = arm.constants
    product = singularity_distances(arm, q).prod(axis=-1)
    return np.asarray(product * (k.reach * arm.L2 * k.L3))


def own_angles(arm: Arm, q: ArrayLike) -> FloatArray:
    """Convert a robot's joint angles to the arm's own, theta = signs * q + offsets.

    Args:
        arm: The arm.
        q: Joint angles [rad]. Shape (..., 6).

    Returns:
        theta [rad]. Shape (..., 6).

    Raises:
        IKError: The last dimension of q is not 6.
    """
    angles = np.asarray(q, dtype=np.float64)
    if angles.ndim < 1 or angles.shape[-1] != 6:
        raise IKError(f"q must have shape (..., 6), got {angles.shape}")
    return angles if arm.constants.plain_joints else angles * arm.signs + arm.offsets


def own_frames(arm: Arm, q: ArrayLike) -> list[Frame]:
    """Lay the frames of the six links and of the tool, one rotation after the other.

    Args:
        arm: The arm.
        q: Joint angles [rad]. Shape (..., 6).

    Returns:
        Seven frames in the base frame; in floats for one configuration, else in arrays (...).

    Raises:
        IKError: The last dimension of q is not 6.
    """
    c, s = _cos_sin(own_angles(arm, q))
    k = arm.constants
    x, y, z = k.axes_base
    p = _along(k.p_base, z, arm.d1)
    x, y = _turn(x, y, c[0], s[0])
    result = [Frame(x, y, z, p)]
    p = _along(_along(p, x, arm.a1), y, arm.b)
    z, x = _turn(z, x, c[1], s[1])
    result.append(Frame(x, y, z, p))
    p = _along(p, z, arm.L2)
    z, x = _turn(z, x, c[2], s[2])
    result.append(Frame(x, y, z, p))
    p = _along(_along(p, x, arm.d4), z, arm.a3)
    y, z = _turn(y, z, c[3], s[3])
    result.append(Frame(x, y, z, p))
    z, x = _turn(z, x, c[4], s[4])
    result.append(Frame(x, y, z, p))
    y, z = _turn(y, z, c[5], s[5])
    result.append(Frame(x, y, z, p))
    t = k.p_tool
    p = _along(_along(_along(p, x, t[0]), y, t[1]), z, t[2])
    if k.R_tool is not None:
        columns = [k.R_tool[i::3] for i in range(3)]
        x, y, z = (_mix(x, y, z, column) for column in columns)
    return [*result, Frame(x, y, z, p)]


def jacobian_columns(arm: Arm, links: Sequence[Frame]) -> list[tuple[Any, ...]]:
    """Compute the columns of the Jacobian from the frames of `own_frames`.

    Args:
        arm: The arm.
        links: Frames of the six links and of the tool.

    Returns:
        Six columns of six entries, floats or arrays.
    """
    tip = links[6].p
    columns = []
    for sign, link, letter in zip(arm.signs, links, "zyyxyx", strict=False):
        a, b, c = getattr(link, letter)
        u, v, w = tip[0] - link.p[0], tip[1] - link.p[1], tip[2] - link.p[2]
        column = (b * w - c * v, c * u - a * w, a * v - b * u, a, b, c)
        columns.append(column if sign == 1 else tuple(-entry for entry in column))
    return columns


def _cos_sin(theta: FloatArray) -> tuple[Sequence[Any], Sequence[Any]]:
    """Return cosines and sines joint by joint; as floats for a single configuration."""
    if theta.ndim == 1:
        angles = theta.tolist()
        return [cos(t) for t in angles], [sin(t) for t in angles]
    joints = np.ascontiguousarray(np.moveaxis(theta, -1, 0))
    return list(np.cos(joints)), list(np.sin(joints))


def _turn(a: Vector, b: Vector, c: Any, s: Any) -> tuple[Vector, Vector]:
    """Turn two axes by the angle from the first to the second whose cosine and sine are given."""
    return (
        (c * a[0] + s * b[0], c * a[1] + s * b[1], c * a[2] + s * b[2]),
        (c * b[0] - s * a[0], c * b[1] - s * a[1], c * b[2] - s * a[2]),
    )


def _along(p: Vector, a: Vector, length: float) -> Vector:
    """Move a point along an axis."""
    if length == 0.0:
        return p
    return p[0] + length * a[0], p[1] + length * a[1], p[2] + length * a[2]


def _mix(x: Vector, y: Vector, z: Vector, t: Sequence[float]) -> Vector:
    """Combine three axes."""
    u, v, w = t
    return (
        u * x[0] + v * y[0] + w * z[0],
        u * x[1] + v * y[1] + w * z[1],
        u * x[2] + v * y[2] + w * z[2],
    )


def _matrices(links: Sequence[Frame]) -> FloatArray:
    """Stack frames as transforms (..., len(links), 4, 4)."""
    shape = np.broadcast_shapes(*(np.shape(entry) for entry in links[-1].p))
    if not shape:  # one configuration: a nested list is faster than entry by entry
        rows = [(*zip(*link, strict=True), (0.0, 0.0, 0.0, 1.0)) for link in links]
        return np.array(rows)
    T = np.zeros((*shape, len(links), 4, 4))
    T[..., 3, 3] = 1.0
    for n, link in enumerate(links):
        for j, column in enumerate(link):
            for i, entry in enumerate(column):
                T[..., n, i, j] = entry
    return T
