"""tf.transformations: homogeneous matrices, quaternions xyzw and the 24 kinds of Euler angles."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from kr210_sim.arrays import Array

_EPS = 4.0 * float(np.finfo(float).eps)
_AXES = "xyz"


def _order(axes: Any) -> tuple[bool, int, int, int]:
    """Return whether the axes rotate with the body, and the axes of the fixed order."""
    text = str(axes).lower()
    if len(text) != 4 or text[0] not in "sr" or any(axis not in _AXES for axis in text[1:]):
        raise KeyError(axes)
    first, second, third = (_AXES.index(axis) for axis in text[1:])
    if first == second or second == third:
        raise KeyError(axes)
    rotating = text[0] == "r"
    return (rotating, third, second, first) if rotating else (rotating, first, second, third)


def _about(axis: int, angle: float) -> Array:
    c, s = math.cos(angle), math.sin(angle)
    j, k = (axis + 1) % 3, (axis + 2) % 3
    R = np.eye(3)
    R[j, j], R[j, k], R[k, j], R[k, k] = c, -s, s, c
    return R


def _homogeneous(R: Array) -> Array:
    T = np.identity(4)
    T[:3, :3] = R
    return T


def identity_matrix() -> Array:
    """Return the transform (4, 4) that does nothing."""
    return np.identity(4)


def translation_matrix(direction: Sequence[float]) -> Array:
    """Return the transform (4, 4) of a translation."""
    T = np.identity(4)
    T[:3, 3] = direction[:3]
    return T


def translation_from_matrix(matrix: Any) -> Array:
    """Return the translation (3,) of a transform."""
    return np.array(matrix, dtype=float)[:3, 3].copy()


def rotation_matrix(angle: float, direction: Sequence[float], point: Any = None) -> Array:
    """Return the transform (4, 4) of a rotation about an axis, by default through the origin."""
    x, y, z = unit_vector(direction[:3])
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    R = np.eye(3) + math.sin(angle) * cross + (1.0 - math.cos(angle)) * cross @ cross
    T = _homogeneous(R)
    if point is not None:
        fixed = np.array(point[:3], dtype=float)
        T[:3, 3] = fixed - R @ fixed
    return T


def inverse_matrix(matrix: Any) -> Array:
    """Return the inverse of a square matrix."""
    return np.asarray(np.linalg.inv(np.array(matrix, dtype=float)))


def concatenate_matrices(*matrices: Any) -> Array:
    """Return the product of transforms, from left to right."""
    product = np.identity(4)
    for matrix in matrices:
        product = product @ np.array(matrix, dtype=float)
    return product


def unit_vector(data: Any, axis: int | None = None, out: Any = None) -> Any:
    """Return a vector, or the vectors along an axis, at length one; in `out` if it is given."""
    vector = np.array(data, dtype=float)
    unit = vector / np.linalg.norm(vector, axis=axis, keepdims=axis is not None)
    if out is None:
        return unit
    out[:] = unit
    return None


def vector_norm(data: Any, axis: int | None = None) -> Any:
    """Return the length of a vector, or of the vectors along an axis."""
    return np.linalg.norm(np.array(data, dtype=float), axis=axis)


# ---- Euler angles ---------------------------------------------------------------------------


def euler_matrix(ai: float, aj: float, ak: float, axes: Any = "sxyz") -> Array:
    """Return the rotation (4, 4) of three angles about the axes named."""
    rotating, first, second, third = _order(axes)
    a, c = (ak, ai) if rotating else (ai, ak)
    return _homogeneous(_about(third, c) @ _about(second, aj) @ _about(first, a))


def euler_from_matrix(matrix: Any, axes: Any = "sxyz") -> tuple[float, float, float]:
    """Return the three angles about the axes named, of a rotation (3, 3) or (4, 4).

    With R = R_third(c) R_second(b) R_first(a) about fixed axes; rotating axes are the same in
    reverse order.
    """
    rotating, i, j, last = _order(axes)
    R = np.array(matrix, dtype=float)[:3, :3]
    k = 3 - i - j
    sign = 1.0 if (j - i) % 3 == 1 else -1.0
    if last == i:
        sin_b = math.hypot(R[i, j], R[i, k])
        b = math.atan2(sin_b, R[i, i])
        regular = sin_b > _EPS
        a = math.atan2(R[i, j], sign * R[i, k]) if regular else 0.0
        c = math.atan2(R[j, i], -sign * R[k, i]) if regular else 0.0
        # with c = 0 the rotation about the first axis is all that is left
        a = a if regular else math.atan2(-sign * R[j, k], R[j, j])
    else:
        cos_b = math.hypot(R[i, i], R[j, i])
        b = math.atan2(-sign * R[k, i], cos_b)
        regular = cos_b > _EPS
        a = math.atan2(sign * R[k, j], R[k, k]) if regular else 0.0
        c = math.atan2(sign * R[j, i], R[i, i]) if regular else 0.0
        a = a if regular else math.atan2(-sign * R[j, k], R[j, j])
    return (c, b, a) if rotating else (a, b, c)


def euler_from_quaternion(quaternion: Any, axes: Any = "sxyz") -> tuple[float, float, float]:
    """Return the three angles about the axes named, of a quaternion xyzw."""
    return euler_from_matrix(quaternion_matrix(quaternion), axes)


# ---- quaternions ----------------------------------------------------------------------------


def quaternion_matrix(quaternion: Any) -> Array:
    """Return the rotation (4, 4) of a quaternion xyzw of any length but zero."""
    q = np.array(quaternion[:4], dtype=float)
    length = float(q @ q)
    if length < _EPS:
        return np.identity(4)
    x, y, z, w = q / math.sqrt(length)
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return _homogeneous(np.eye(3) + 2.0 * w * cross + 2.0 * cross @ cross)


def quaternion_from_matrix(matrix: Any) -> Array:
    """Return the quaternion xyzw (4,) of a rotation (3, 3) or (4, 4)."""
    R = np.array(matrix, dtype=float)[:3, :3]
    # The largest of the four components is found first, so that no division is by little.
    squares = np.array(
        [
            1.0 + R[0, 0] - R[1, 1] - R[2, 2],
            1.0 - R[0, 0] + R[1, 1] - R[2, 2],
            1.0 - R[0, 0] - R[1, 1] + R[2, 2],
            1.0 + R[0, 0] + R[1, 1] + R[2, 2],
        ]
    )
    largest = int(np.argmax(squares))
    q = np.empty(4)
    if largest == 3:
        q[:3] = R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]
    else:
        j, k = (largest + 1) % 3, (largest + 2) % 3
        q[j] = R[j, largest] + R[largest, j]
        q[k] = R[k, largest] + R[largest, k]
        q[3] = R[k, j] - R[j, k]
    q[largest] = squares[largest]
    return np.asarray(q / np.linalg.norm(q))


def quaternion_from_euler(ai: float, aj: float, ak: float, axes: Any = "sxyz") -> Array:
    """Return the quaternion xyzw (4,) of three angles about the axes named."""
    return quaternion_from_matrix(euler_matrix(ai, aj, ak, axes))


def quaternion_about_axis(angle: float, axis: Sequence[float]) -> Array:
    """Return the quaternion xyzw (4,) of a rotation about an axis."""
    return np.append(math.sin(angle / 2.0) * unit_vector(axis[:3]), math.cos(angle / 2.0))


def quaternion_multiply(quaternion1: Any, quaternion0: Any) -> Array:
    """Return the product (4,) of two quaternions xyzw."""
    a, b = np.array(quaternion1, dtype=float), np.array(quaternion0, dtype=float)
    vector = a[3] * b[:3] + b[3] * a[:3] + np.cross(a[:3], b[:3])
    return np.append(vector, a[3] * b[3] - a[:3] @ b[:3])


def quaternion_conjugate(quaternion: Any) -> Array:
    """Return the conjugate (4,) of a quaternion xyzw."""
    q = np.array(quaternion, dtype=float)
    return np.append(-q[:3], q[3])


def quaternion_inverse(quaternion: Any) -> Array:
    """Return the inverse (4,) of a quaternion xyzw."""
    q = np.array(quaternion, dtype=float)
    return np.asarray(quaternion_conjugate(q) / (q @ q))
