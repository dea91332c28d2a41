"""The formulas for many poses, in NumPy.

The poses go through in chunks that fit the second-level cache, each quantity as one contiguous
array over the chunk. Nothing outlives a call, so that threads may share an arm. `_single.py` holds
the same formulas for one pose; a test keeps both equal. The step numbers are those of README.md.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from .arm import Arm
from .poses import is_rigid
from .tolerances import REACH_TOLERANCE, SMALL

FloatArray = NDArray[np.float64]

CHUNK = 2048
"""Poses at a time: 16 KB for an array, under 2 MB for all of them."""

HALF_PI = 0.5 * np.pi
TWO_PI = 2.0 * np.pi


def solve(arm: Arm, T: FloatArray, q: FloatArray) -> bool:
    """Compute all branches of many poses.

    Args:
        arm: The arm.
        T: T_base_tool. Shape (n, 4, 4).
        q: Filled with the angles [rad], NaN where there is no branch. Shape (n, 8, 6).

    Returns:
        False as soon as a chunk holds a matrix that is no rigid transform.
    """
    flat = T.reshape(len(T), 16)
    # divisions by zero and roots of negative numbers are meant: NaN marks a branch that is none
    with np.errstate(invalid="ignore", divide="ignore", over="ignore", under="ignore"):
        for start in range(0, len(T), CHUNK):
            c = np.ascontiguousarray(flat[start : start + CHUNK].T)
            if not is_rigid(c):
                return False
            _solve_chunk(arm, c, q[start : start + CHUNK])
    return True


def _solve_chunk(arm: Arm, c: FloatArray, q: FloatArray) -> None:
    """Solve the poses whose 16 entries are the rows of c (16, n) into q (n, 8, 6)."""
    R, wx, wy, wz = _wrist_pose(arm, c)
    b = arm.b
    r = np.sqrt(wx * wx + wy * wy)
    if r.min() < SMALL:  # on axis 1, where any q1 is right
        axis = r < SMALL
        wx, wy = np.where(axis, 1.0, wx), np.where(axis, 0.0, wy)
        wx, wy = wx / np.where(axis, 1.0, r), wy / np.where(axis, 1.0, r)
        r = np.where(axis, 0.0, r)
    else:
        wx, wy = wx / r, wy / r
    if b == 0.0:  # steps 2 and 3 without a lateral offset
        _shoulder(arm, R, wz, wx, wy, r, q[:, :4])
        _shoulder(arm, R, wz, -wx, -wy, -r, q[:, 4:])
    else:
        rho = np.sqrt(np.maximum((r - abs(b)) * (r + abs(b)), 0.0))
        rho[r < abs(b) - REACH_TOLERANCE * arm.constants.reach] = np.nan
        on_edge = rho == 0.0
        f, g = np.where(on_edge, 0.0, rho / r), np.where(on_edge, np.copysign(1.0, b), b / r)
        x, y = wx * f, wy * f
        _shoulder(arm, R, wz, x + wy * g, y - wx * g, rho, q[:, :4])
        _shoulder(arm, R, wz, wy * g - x, -wx * g - y, -rho, q[:, 4:])
    if not arm.constants.plain_joints:  # step 7
        q -= arm.offsets
        q *= arm.signs
        q -= TWO_PI * np.rint(q / TWO_PI)


def _wrist_pose(
    arm: Arm, c: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Move poses of the tool in the base to the wrist, in the arm's own base frame (step 1)."""
    k = arm.constants
    R = c[:12].reshape(3, 4, -1)
    w = [R[i, 3] - k.p_base[i] - _dot(k.c_tool, R[i]) for i in range(3)]
    if k.R_base is not None:
        columns = [k.R_base[j::3] for j in range(3)]
        w = [_dot(column, w) for column in columns]
        R = np.array([[_dot(column, R[:, j]) for j in range(3)] for column in columns])
    if k.R_tool is not None:
        rows = [k.R_tool[3 * j : 3 * j + 3] for j in range(3)]
        R = np.array([[_dot(row, R[i]) for row in rows] for i in range(3)])
    return R, w[0], w[1], w[2]


def _dot(a, x):
    return a[0] * x[0] + a[1] * x[1] + a[2] * x[2]


def _shoulder(
    arm: Arm,
    R: FloatArray,
    wz: FloatArray,
    c1: FloatArray,
    s1: FloatArray,
    rho: FloatArray,
    q: FloatArray,
) -> None:
    """Solve elbow and wrist of one shoulder branch into q (n, 4, 6) (steps 3 to 6)."""
    L3, phi, reach, inner, fold, K, *_ = arm.constants
    u, v = rho - arm.a1, wz - arm.d1
    D = np.sqrt(u * u + v * v)
    edge = np.clip(D, fold, reach)
    outside = ~(np.abs(D - edge) <= REACH_TOLERANCE * reach)
    if D.min() <= SMALL:  # folded onto the shoulder, where any q2 is right
        folded = D <= SMALL
        u[folded], v[folded], D[folded] = 0.0, fold, fold
    stretch = edge / D
    u *= stretch
    v *= stretch
    D = edge
    D2 = D * D
    S = np.sqrt((reach - D) * (reach + D) * (D - inner) * (D + inner))
    S[outside] = np.nan
    gamma = np.arctan2(S, D2 - arm.L2 * arm.L2 - L3 * L3)
    A, f = D2 + K, 0.5 / D2
    (x0, x1, x2), (y0, y1, y2), (z0, z1, z2) = R[:, 0:3]
    n0, n1, n2 = c1 * x0 + s1 * y0, c1 * x1 + s1 * y1, c1 * x2 + s1 * y2
    m0, m1, m2 = c1 * y0 - s1 * x0, c1 * y1 - s1 * x1, c1 * y2 - s1 * x2
    q1 = np.arctan2(s1, c1)
    q1[outside] = np.nan
    a, d, g = arm.a3 / (L3 * L3), arm.d4 / (L3 * L3), HALF_PI + phi
    q[:, :, 0] = q1[:, None]
    for i, sign in enumerate((1.0, -1.0)):
        Se = sign * S
        x, z = A * u - Se * v, A * v + Se * u
        q2 = np.arctan2(x, z)
        q3 = sign * gamma - g
        x, z = u - x * f, z * f - v
        c, s = d * x - a * z, d * z + a * x
        k0, k1, k2 = s * n0 + c * z0, s * n1 + c * z1, s * n2 + c * z2
        h = np.sqrt(m0 * m0 + k0 * k0)
        q5 = np.arctan2(h, c * n0 - s * z0)
        if h.min() == 0.0 or True:
            k0[h == 0.0] = -1.0
        q4 = np.arctan2(m0, -k0)
        q6 = np.arctan2(k0 * m2 - m0 * k2, m0 * k1 - k0 * m1)
        j = 2 * i
        q[:, j : j + 2, 1] = q2[:, None]
        q[:, j : j + 2, 2] = q3[:, None]
        q[:, j, 3] = q4
        q[:, j + 1, 3] = q4 - np.copysign(np.pi, q4)
        q[:, j, 4] = q5
        q[:, j + 1, 4] = -q5
        q[:, j, 5] = q6
        q[:, j + 1, 5] = q6 - np.copysign(np.pi, q6)
