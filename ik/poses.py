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
    tol = ROTATION_TOLERANCE
    x, y, z = c[0:3], c[4:7], c[8:11]
    worst = np.abs(x[0] * x[0] + x[1] * x[1] + x[2] * x[2] - 1.0)
    for error in (
        y[0] * y[0] + y[1] * y[1] + y[2] * y[2] - 1.0,
        x[0] * y[0] + x[1] * y[1] + x[2] * y[2],
        x[1] * y[2] - x[2] * y[1] - z[0],
        x[2] * y[0] - x[0] * y[2] - z[1],
        x[0] * y[1] - x[1] * y[0] - z[2],
        c[15] - 1.0,
        c[12],
        c[13],
        c[14],
    ):
        np.maximum(worst, np.abs(error), out=worst)  # maximum passes NaN on
    finite = c[3] * 0.0 + c[7] * 0.0 + c[11] * 0.0  # NaN where a position is NaN or infinite
    return bool(worst.max() <= tol and finite.max() == 0.0)


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
    with np.errstate(invalid="ignore", over="ignore"):
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
    for i, pose in enumerate(flat):
        if not is_rigid(pose.reshape(16, 1)):
            index = np.unravel_index(i, shape) if shape else ()
            where = name + (str([int(k) for k in index]) if index else "")
            return InvalidPose(f"{where} {_fault(pose)}")
    return InvalidPose(f"{name} is no rigid transform")


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
