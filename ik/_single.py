"""The formulas for one pose, in Python floats.

A NumPy call costs as much as thirty operations on Python floats, so for one pose this is some ten
times faster than `_batch.py`, which holds the same formulas for many; a test keeps both equal. The
step numbers are those of README.md, which derives them.
"""

from __future__ import annotations

from math import atan2, ceil, copysign, pi, remainder, sqrt, tau

from .arm import Arm, Constants
from .limits import Bounds
from .tolerances import REACH_TOLERANCE, ROTATION_TOLERANCE, SMALL

Row = tuple[float, ...]
Matrix = list[list[float]]


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


def solve(arm: Arm, T: Matrix) -> tuple[list[float], list[float]] | None:
    """Compute all branches of one pose.

    Args:
        arm: The arm.
        T: Rows of T_base_tool, a rigid transform. Shape (4, 4).

    Returns:
        q [rad] of the four branches with the shoulder in front, one after the other in the order of
        the branch table, and of the four with it behind. Lengths 24, or 0 for out of reach. None
        for a pose next to the edge of reach, which is for `_batch.py` and its extended precision.
    """
    R, wx, wy, wz = _wrist_pose(arm, T)
    k = arm.constants
    b = arm.b
    r = sqrt(wx * wx + wy * wy)
    if r < SMALL:  # on axis 1, where any theta1 is right
        r, wx, wy = 0.0, 1.0, 0.0
    else:
        wx, wy = wx / r, wy / r
    if b == 0.0:
        front = _shoulder(k, R, wz, wx, wy, r)
        back = _shoulder(k, R, wz, -wx, -wy, -r)
    elif r < abs(b) - REACH_TOLERANCE * k.reach:
        return [], []
    else:
        rho = sqrt(max((r - abs(b)) * (r + abs(b)), 0.0))
        f, g = (rho / r, b / r) if rho > 0.0 else (0.0, copysign(1.0, b))
        xf, yf, xg, yg = wx * f, wy * f, wx * g, wy * g
        front = _shoulder(k, R, wz, xf + yg, yf - xg, rho)
        back = _shoulder(k, R, wz, yg - xf, -xg - yf, -rho)
    if front is None or back is None:
        return None
    if k.plain_joints:
        return front, back
    return _robot_angles(arm, front), _robot_angles(arm, back)


def _wrist_pose(arm: Arm, T: Matrix) -> tuple[Row, float, float, float]:
    """Move a pose of the tool in the base to the wrist, in the arm's own base frame (step 1)."""
    k = arm.constants
    (xx, xy, xz, px), (yx, yy, yz, py), (zx, zy, zz, pz), _ = T
    x, y, z = k.c_tool
    bx, by, bz = k.p_base
    wx = px - bx - (x * xx + y * xy + z * xz)
    wy = py - by - (x * yx + y * yy + z * yz)
    wz = pz - bz - (x * zx + y * zy + z * zz)
    if k.R_base is not None:
        a, b, c, d, e, f, g, h, i = k.R_base
        wx, wy, wz = a * wx + d * wy + g * wz, b * wx + e * wy + h * wz, c * wx + f * wy + i * wz
        xx, yx, zx = a * xx + d * yx + g * zx, b * xx + e * yx + h * zx, c * xx + f * yx + i * zx
        xy, yy, zy = a * xy + d * yy + g * zy, b * xy + e * yy + h * zy, c * xy + f * yy + i * zy
        xz, yz, zz = a * xz + d * yz + g * zz, b * xz + e * yz + h * zz, c * xz + f * yz + i * zz
    if k.R_tool is not None:
        a, b, c, d, e, f, g, h, i = k.R_tool
        xx, xy, xz = a * xx + b * xy + c * xz, d * xx + e * xy + f * xz, g * xx + h * xy + i * xz
        yx, yy, yz = a * yx + b * yy + c * yz, d * yx + e * yy + f * yz, g * yx + h * yy + i * yz
        zx, zy, zz = a * zx + b * zy + c * zz, d * zx + e * zy + f * zz, g * zx + h * zy + i * zz
    return (xx, xy, xz, yx, yy, yz, zx, zy, zz), wx, wy, wz


def _shoulder(
    k: Constants, R: Row, wz: float, c1: float, s1: float, rho: float
) -> list[float] | None:
    """Solve elbow and wrist of one shoulder branch (steps 3 to 6); rho < 0 on the back one.

    Returns:
        Four branches in a row; none out of reach; None next to the edge of reach.
    """
    a1, d1, reach, inner, fold, K, C, bend, a, d = k.elbow
    u, v = rho - a1, wz - d1
    D = sqrt(u * u + v * v)
    nearest, farthest = k.plain_reach
    if not nearest < D < farthest:
        tolerance = REACH_TOLERANCE * reach
        return None if fold - tolerance <= D <= reach + tolerance else []
    D2 = D * D
    S = sqrt((reach - D) * (reach + D) * (D - inner) * (D + inner))
    gamma = atan2(S, D2 - C)
    A, f = D2 + K, 0.5 / D2
    Au, Av, Su, Sv = A * u, A * v, S * u, S * v
    x0, x1, x2, y0, y1, y2, z0, z1, z2 = R
    n0, n1, n2 = c1 * x0 + s1 * y0, c1 * x1 + s1 * y1, c1 * x2 + s1 * y2
    # + 0.0 makes 0.0 of -0.0, here and below: atan2 would make pi of it
    m0, m1, m2 = c1 * y0 - s1 * x0 + 0.0, c1 * y1 - s1 * x1, c1 * y2 - s1 * x2
    q1 = atan2(s1, c1)
    q: list[float] = []
    for x, z, q3 in ((Au - Sv, Av + Su, gamma - bend), (Au + Sv, Av - Su, -gamma - bend)):
        q2 = atan2(x, z)
        if not -pi <= q3 <= pi:
            q3 -= copysign(tau, q3)
        x, z = u - x * f, z * f - v
        c, s = d * x - a * z, d * z + a * x
        k0, k1, k2 = s * n0 + c * z0, s * n1 + c * z1, s * n2 + c * z2
        h = sqrt(m0 * m0 + k0 * k0)
        q5 = atan2(h, c * n0 - s * z0)
        if h == 0.0:  # only theta4 + theta6 is given there: take theta4 = 0
            k0 = -1.0
        q4, q6 = atan2(m0, -k0), atan2(k0 * m2 - m0 * k2 + 0.0, m0 * k1 - k0 * m1)
        f4, f6 = q4 - pi if q4 >= 0.0 else q4 + pi, q6 - pi if q6 >= 0.0 else q6 + pi
        q += (q1, q2, q3, q4, q5, q6, q1, q2, q3, f4, -q5, f6)
    return q


def _robot_angles(arm: Arm, theta: list[float]) -> list[float]:
    """Convert the arm's own angles of some branches to the robot's, within [-pi, pi] (step 7)."""
    joints = list(zip(arm.signs, arm.offsets, strict=True)) * (len(theta) // 6)
    return [
        remainder(sign * (angle - offset), tau)
        for angle, (sign, offset) in zip(theta, joints, strict=True)
    ]


def turn_into_limits(q: list[float], bounds: Bounds) -> bytearray:
    """Add the turns to each branch that bring it inside of the limits.

    Args:
        q: The eight branches in a row [rad], within [-pi, pi] or NaN; gets the turns. Length 48.
        bounds: The limits.

    Returns:
        1 for each branch that is inside now, 0 for the others.
    """
    inside = bytearray(8)
    for elbow in (0, 12, 24, 36):
        if q[elbow] != q[elbow]:  # no branch
            continue
        shared: tuple[tuple[int, float], ...] = ()
        for j, low, high, turns in bounds.arm:  # the same for both wrists
            angle = q[elbow + j]
            if not low <= angle <= high:
                if not turns:
                    break
                angle += tau * ceil((low - angle) / tau)
                if angle > high:
                    break
                shared += ((j, angle),)
        else:
            for branch in (elbow, elbow + 6):
                turned = shared
                for j, low, high, turns in bounds.wrist:
                    angle = q[branch + j]
                    if not low <= angle <= high:
                        if not turns:
                            break
                        angle += tau * ceil((low - angle) / tau)
                        if angle > high:
                            break
                        turned += ((j, angle),)
                else:
                    inside[branch // 6] = 1
                    for j, angle in turned:
                        q[branch + j] = angle
    return inside
