"""The formulas for one pose, in Python floats.

A NumPy call costs as much as thirty operations on Python floats, so for one pose this is some ten
times faster than `_batch.py`, which holds the same formulas for many; a test keeps both equal. The
step numbers are those of README.md, which derives them.
"""

from __future__ import annotations

from math import atan2, copysign, nan, pi, remainder, sqrt, tau

from .arm import Arm
from .tolerances import REACH_TOLERANCE, ROTATION_TOLERANCE, SMALL

Row = tuple[float, ...]
Matrix = list[list[float]]

HALF_PI = 0.5 * pi
NO_BRANCH: Row = (nan,) * 6
_NO_ELBOW = (NO_BRANCH,) * 4


def is_rigid(T: Matrix) -> bool:
    """Tell whether one matrix is a rigid transform; `poses.is_rigid` does it for many.

    Args:
        T: Rows of the matrix. Shape (4, 4).

    Returns:
        False for a scaled, sheared or reflected rotation, a wrong bottom row, or NaN or infinity.
    """
    (xx, xy, xz, px), (yx, yy, yz, py), (zx, zy, zz, pz), (e0, e1, e2, e3) = T
    tol = ROTATION_TOLERANCE
    return (
        -tol <= xx * xx + xy * xy + xz * xz - 1.0 <= tol
        and -tol <= yx * yx + yy * yy + yz * yz - 1.0 <= tol
        and -tol <= xx * yx + xy * yy + xz * yz <= tol
        and -tol <= xy * yz - xz * yy - zx <= tol
        and -tol <= xz * yx - xx * yz - zy <= tol
        and -tol <= xx * yy - xy * yx - zz <= tol
        and -tol <= e0 <= tol
        and -tol <= e1 <= tol
        and -tol <= e2 <= tol
        and -tol <= e3 - 1.0 <= tol
        and (px + py + pz) * 0.0 == 0.0
    )


def solve(arm: Arm, T: Matrix) -> tuple[Row, ...]:
    """Compute all branches of one pose.

    Args:
        arm: The arm.
        T: Rows of T_base_tool, a rigid transform. Shape (4, 4).

    Returns:
        Eight rows of q [rad] in the order of the branch table; `NO_BRANCH` where there is none.
    """
    R, wx, wy, wz = _wrist_pose(arm, T)
    b = arm.b
    r = sqrt(wx * wx + wy * wy)
    if r < SMALL:  # on axis 1, where any q1 is right
        r, wx, wy = 0.0, 1.0, 0.0
    else:
        wx, wy = wx / r, wy / r
    if b == 0.0:  # steps 2 and 3 without a lateral offset
        rows = _shoulder(arm, R, wz, wx, wy, r) + _shoulder(arm, R, wz, -wx, -wy, -r)
    elif r < abs(b) - REACH_TOLERANCE * arm.constants.reach:
        return _NO_ELBOW + _NO_ELBOW
    else:
        rho = sqrt((r - abs(b)) * (r + abs(b))) if r > abs(b) else 0.0
        f, g = (rho / r, b / r) if rho > 0.0 else (0.0, copysign(1.0, b))
        x, y = wx * f, wy * f
        rows = _shoulder(arm, R, wz, x + wy * g, y - wx * g, rho)
        rows += _shoulder(arm, R, wz, wy * g - x, -wx * g - y, -rho)
    return rows if arm.constants.plain_joints else tuple(_robot_angles(arm, row) for row in rows)


def _wrist_pose(arm: Arm, T: Matrix) -> tuple[Matrix, float, float, float]:
    """Move a pose of the tool in the base to the wrist, in the arm's own base frame (step 1)."""
    k = arm.constants
    (xx, xy, xz, px), (yx, yy, yz, py), (zx, zy, zz, pz), _ = T
    x, y, z = k.c_tool
    bx, by, bz = k.p_base
    wx = px - bx - (xx * x + xy * y + xz * z)
    wy = py - by - (yx * x + yy * y + yz * z)
    wz = pz - bz - (zx * x + zy * y + zz * z)
    R = T
    if k.R_base is not None:
        b0, b1, b2, b3, b4, b5, b6, b7, b8 = k.R_base
        wx, wy, wz = (
            b0 * wx + b3 * wy + b6 * wz,
            b1 * wx + b4 * wy + b7 * wz,
            b2 * wx + b5 * wy + b8 * wz,
        )
        R = [
            [b0 * xx + b3 * yx + b6 * zx, b0 * xy + b3 * yy + b6 * zy, b0 * xz + b3 * yz + b6 * zz],
            [b1 * xx + b4 * yx + b7 * zx, b1 * xy + b4 * yy + b7 * zy, b1 * xz + b4 * yz + b7 * zz],
            [b2 * xx + b5 * yx + b8 * zx, b2 * xy + b5 * yy + b8 * zy, b2 * xz + b5 * yz + b8 * zz],
        ]
    if k.R_tool is not None:
        t0, t1, t2, t3, t4, t5, t6, t7, t8 = k.R_tool
        R = [
            [
                t0 * row[0] + t1 * row[1] + t2 * row[2],
                t3 * row[0] + t4 * row[1] + t5 * row[2],
                t6 * row[0] + t7 * row[1] + t8 * row[2],
            ]
            for row in R[:3]
        ]
    return R, wx, wy, wz


def _shoulder(
    arm: Arm, R: Matrix, wz: float, c1: float, s1: float, rho: float
) -> tuple[Row, ...]:
    """Solve elbow and wrist of one shoulder branch (steps 3 to 6); rho < 0 on the back one."""
    L3, phi, reach, inner, fold, K, *_ = arm.constants
    u, v = rho - arm.a1, wz - arm.d1
    D = sqrt(u * u + v * v)
    if not fold < D < reach:
        edge = reach if D > fold else fold
        if not abs(D - edge) <= REACH_TOLERANCE * reach:
            return _NO_ELBOW
        if D <= SMALL:  # folded onto the shoulder, where any q2 is right
            u, v, D = 0.0, edge, edge
        else:
            u, v, D = u * (edge / D), v * (edge / D), edge
    D2 = D * D
    S = sqrt((reach - D) * (reach + D) * (D - inner) * (D + inner))
    gamma = atan2(S, D2 - arm.L2 * arm.L2 - L3 * L3)
    A, f = D2 + K, 0.5 / D2
    (x0, x1, x2, *_), (y0, y1, y2, *_), (z0, z1, z2, *_), *_ = R
    n0, n1, n2 = c1 * x0 + s1 * y0, c1 * x1 + s1 * y1, c1 * x2 + s1 * y2
    m0, m1, m2 = c1 * y0 - s1 * x0, c1 * y1 - s1 * x1, c1 * y2 - s1 * x2
    q1 = atan2(s1, c1)
    a, d, g = arm.a3 / (L3 * L3), arm.d4 / (L3 * L3), HALF_PI + phi
    x, z = A * u - S * v, A * v + S * u
    up = q1, atan2(x, z), gamma - g, u - x * f, z * f - v
    x, z = A * u + S * v, A * v - S * u
    down = q1, atan2(x, z), -gamma - g, u - x * f, z * f - v
    rows: list[Row] = []
    for q1, q2, q3, x, z in (up, down):
        c, s = d * x - a * z, d * z + a * x
        k0, k1, k2 = s * n0 + c * z0, s * n1 + c * z1, s * n2 + c * z2
        h = sqrt(m0 * m0 + k0 * k0)
        q5 = atan2(h, c * n0 - s * z0)
        if h == 0.0:  # only q4 + q6 is given there: take q4 = 0
            k0 = -1.0
        q4, q6 = atan2(m0, -k0), atan2(k0 * m2 - m0 * k2, m0 * k1 - k0 * m1)
        rows.append((q1, q2, q3, q4, q5, q6))
        rows.append((q1, q2, q3, q4 - copysign(pi, q4), -q5, q6 - copysign(pi, q6)))
    return tuple(rows)


def _robot_angles(arm: Arm, theta: Row) -> Row:
    """Convert the arm's own angles to the robot's, within [-pi, pi] (step 7)."""
    q = (s * (t - o) for s, t, o in zip(arm.signs, theta, arm.offsets, strict=True))
    return tuple(remainder(x, tau) for x in q)
