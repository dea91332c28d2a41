"""Check that matrices are rigid transforms, with errors that say what is wrong with them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from .exceptions import InvalidPose
from .tolerances import ROTATION_TOLERANCE

FloatArray = NDArray[np.float64]


def is_rigid(c: FloatArray) -> bool:
    """Tell whether all matrices of a batch, given entry by entry, are rigid transforms.

    Rows 0 and 1 are orthonormal and row 2 is their cross product: that is R R^T = I and det R = +1
    in 27 operations instead of 50. A NaN or an infinity anywhere fails one of the comparisons.

    Args:
        c: Entries of the matrices, row by row. Shape (16, n).

    Returns:
        False when at least one is none.
    """
    if c.shape[1] == 0:
        return True
    x, y, z, last = c[0:3], c[4:7], c[8:11], c[12:16]
    error = np.empty((6, c.shape[1]))
    np.subtract(_dot(x, x), 1.0, out=error[0])
    np.subtract(_dot(y, y), 1.0, out=error[1])
    error[2] = _dot(x, y)
    for i, j, k in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
        np.subtract(x[j] * y[k] - x[k] * y[j], z[i], out=error[3 + i])
    return bool(
        _within_tolerance(error)
        and _within_tolerance(last[:3])
        and _within_tolerance(last[3] - 1.0)
        and np.isfinite(c[3:12:4]).all()
    )


def _dot(a: FloatArray, b: FloatArray) -> FloatArray:
    return np.asarray(a[0] * b[0] + a[1] * b[1] + a[2] * b[2])


def _within_tolerance(error: FloatArray) -> bool:
    # two reductions, where abs would make a copy; both are NaN if any error is
    return bool(error.max() <= ROTATION_TOLERANCE and error.min() >= -ROTATION_TOLERANCE)


def check_poses(T: FloatArray, name: str = "T") -> None:
    """Raise unless every matrix is a rigid transform.

    Args:
        T: Matrices. Shape (..., 4, 4).
        name: What to call them in the message.

    Raises:
        InvalidPose: Wrong shape, a value that is not finite, a bottom row other than 0 0 0 1, a
            scaled, sheared or reflected rotation.
    """
    if T.ndim < 2 or T.shape[-2:] != (4, 4):
        raise InvalidPose(f"{name} must have shape (..., 4, 4), got {T.shape}")
    flat = T.reshape(-1, 4, 4)
    with np.errstate(all="ignore"):
        if not is_rigid(flat.reshape(-1, 16).T):
            raise explain(flat, T.shape[:-2], name)


def explain(flat: FloatArray, shape: tuple[int, ...], name: str = "T") -> InvalidPose:
    """Say what is wrong with the first matrix that is no rigid transform.

    Args:
        flat: Matrices, at least one of them bad. Shape (n, 4, 4).
        shape: Leading dimensions the caller knows them by, for the index in the message.
        name: What to call them in the message.

    Returns:
        The error, to be raised.
    """
    first, count = 0, len(flat)
    with np.errstate(all="ignore"):
        while count > 1:  # halve the range that has it
            half = count // 2
            if is_rigid(flat[first : first + half].reshape(-1, 16).T):
                first, count = first + half, count - half
            else:
                count = half
        index = [int(k) for k in np.unravel_index(first, shape)] if shape else ""
        return InvalidPose(f"{name}{index} {_fault(flat[first])}")


def _fault(pose: FloatArray) -> str:
    """Describe what is wrong with one matrix (4, 4)."""
    if not np.isfinite(pose).all():
        return "has a value that is not finite"
    if np.abs(pose[3] - (0.0, 0.0, 0.0, 1.0)).max() > ROTATION_TOLERANCE:
        return f"has the bottom row {pose[3].tolist()}, not 0 0 0 1"
    R = pose[:3, :3]
    error = float(np.abs(R @ R.T - np.eye(3)).max())
    det = float(np.linalg.det(R))
    if det < 0.0:
        return f"is a reflection, not a rotation: det R = {det:.6g}"
    lengths = np.linalg.norm(R, axis=1)
    return (
        f"has a rotation part that is not orthonormal: |R R^T - I| = {error:.3g} (tolerance "
        f"{ROTATION_TOLERANCE:g}), rows of length {lengths.round(6).tolist()}; normalise it"
    )
