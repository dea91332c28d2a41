"""The formulas for many poses, in NumPy.

The poses go through in chunks that fit the second-level cache, each quantity as one contiguous
array over the chunk, with the two shoulders and the four elbows of a pose as leading dimensions.
Nothing outlives a call, so threads may share an arm. `_single.py` holds the same formulas for one
pose; a test keeps both equal. The step numbers are those of README.md, which derives them.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from .arm import Arm
from .limits import TWO_PI, Bounds
from .poses import is_rigid
from .tolerances import REACH_TOLERANCE, SMALL

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]

CHUNK = 2048
"""Poses at a time: 16 KB for one quantity of a pose, and under 2 MB for all of them."""


def solve(
    arm: Arm,
    T: FloatArray,
    q: FloatArray,
    valid: BoolArray,
    bounds: Bounds | None,
    inside: BoolArray,
) -> bool:
    """Compute all branches of many poses.

    Args:
        arm: The arm.
        T: T_base_tool. Shape (n, 4, 4).
        q: Filled with the angles [rad], NaN where there is no branch. Shape (n, 8, 6).
        valid: Filled with the branches that exist. Shape (n, 8).
        bounds: The limits; None if they leave nothing out, or there are none.
        inside: Filled with the branches that are inside of the limits after some turns, which are
            added to q. Shape (n, 8).

    Returns:
        False as soon as a chunk holds a matrix that is no rigid transform.
    """
    entries, angles = T.reshape(len(T), 16), q.reshape(len(T), 48)
    exists = valid.reshape(len(T), 2, 4)
    with np.errstate(all="ignore"):  # poses at absurd distances overflow, and are out of reach
        for start in range(0, len(T), CHUNK):
            part = slice(start, start + CHUNK)
            c = np.ascontiguousarray(entries[part].T)
            if not is_rigid(c):
                return False
            solved, reached = _solve_chunk(arm, c)
            if bounds:
                inside[part] = _turn_into_limits(solved, bounds).reshape(8, -1).T
            angles[part] = solved.reshape(48, -1).T
            exists[part] = reached.T[:, :, None]
    # what stands in the other rows is finite and wrong
    q.reshape(len(T), 2, 24)[~exists[:, :, 0]] = np.nan
    if bounds:
        inside &= valid
    else:
        inside[:] = valid
    return True


def _solve_chunk(arm: Arm, c: FloatArray) -> tuple[FloatArray, BoolArray]:
    """Solve the poses whose 16 entries are the rows of c (16, n).

    Returns:
        The angles by shoulder, elbow, wrist and joint, (2, 2, 2, 6, n), and which shoulders reach
        the pose, (2, n): both elbows and both wrists do then. The angles of others are no answers.
    """
    q = np.empty((2, 2, 2, 6, c.shape[1]))
    R, w = _wrist_pose(arm, c)
    c1, s1, rho, turned = _shoulders(arm, w)
    c23, s23, reached = _elbows(arm, c, rho, w[2], q)
    q[:, :, :, 0] = np.arctan2(s1, c1)[:, None, None]
    _wrists(R, c1, s1, c23, s23, q)
    if not arm.constants.plain_joints:  # step 7
        q -= np.array(arm.offsets)[:, None]
        q *= np.array(arm.signs)[:, None]
        q -= TWO_PI * np.rint(q / TWO_PI)
    return q, reached & turned


def _wrist_pose(arm: Arm, c: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Move poses of the tool to the wrist, in the arm's own base frame (step 1).

    Returns:
        The wrist's rotation (3, 3, n) and position (3, n).
    """
    k = arm.constants
    R = c[:12].reshape(3, 4, -1)
    w = np.array([R[i, 3] - k.p_base[i] - _dot(k.c_tool, R[i]) for i in range(3)])
    R = R[:, :3]
    if k.R_base is not None:
        columns = [k.R_base[j::3] for j in range(3)]
        w = np.array([_dot(column, w) for column in columns])
        R = np.array([_dot(column, R) for column in columns])
    if k.R_tool is not None:
        rows = [k.R_tool[3 * j : 3 * j + 3] for j in range(3)]
        R = np.array([[_dot(row, R[i]) for row in rows] for i in range(3)])
    return R, w


def _dot(a: Sequence[float], x: FloatArray) -> FloatArray:
    """Combine the first three rows of x."""
    return np.asarray(a[0] * x[0] + a[1] * x[1] + a[2] * x[2])


def _shoulders(arm: Arm, w: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray, BoolArray]:
    """Turn the arm plane through the wrist center, forwards and backwards (step 2).

    Returns:
        cos and sin of theta1 and the signed distance of the wrist center from axis 1 within the
        arm plane, (2, n), and whether the plane can be turned that far inwards, (n,).
    """
    x, y = w[0], w[1]
    r = np.sqrt(x * x + y * y)
    on_axis = r < SMALL
    if on_axis.any():  # there any theta1 is right
        r[on_axis] = 1.0
        x, y = np.where(on_axis, 1.0, x / r), np.where(on_axis, 0.0, y / r)
        r[on_axis] = 0.0
    else:
        x, y = x / r, y / r
    if arm.b == 0.0:
        return np.stack([x, -x]), np.stack([y, -y]), np.stack([r, -r]), np.ones(r.shape, np.bool_)
    b = abs(arm.b)
    turned = r >= b - REACH_TOLERANCE * arm.constants.reach
    rho = np.sqrt(np.maximum((r - b) * (r + b), 0.0))
    on_edge = rho == 0.0
    f, g = np.where(on_edge, 0.0, rho / r), np.where(on_edge, np.copysign(1.0, arm.b), arm.b / r)
    xf, yf, xg, yg = x * f, y * f, x * g, y * g
    c1, s1 = np.stack([xf + yg, yg - xf]), np.stack([yf - xg, -xg - yf])
    return c1, s1, np.stack([rho, -rho]), turned


def _elbows(
    arm: Arm, c: FloatArray, rho: FloatArray, wz: FloatArray, q: FloatArray
) -> tuple[FloatArray, FloatArray, BoolArray]:
    """Bend the arm to the wrist center, elbow to either side (steps 3 to 5).

    Args:
        arm: The arm.
        c: Entries of the poses. Shape (16, n).
        rho: Signed distance of the wrist center from axis 1. Shape (2, n).
        wz: Height of the wrist center. Shape (n,).
        q: Its theta2 and theta3 are filled in. Shape (2, 2, 2, 6, n).

    Returns:
        cos and sin of theta2 + theta3, (2, 2, n), and whether the wrist center is in reach,
        (2, n); if not, the angles are those of its nearest point that is.
    """
    _, _, reach, inner, _, K, C, bend, a, d = arm.constants.elbow
    u, v, D, S, distance = _triangle(arm, rho, wz, reach, inner)
    nearest, farthest = arm.constants.plain_reach
    reached = np.abs(distance - D) <= REACH_TOLERANCE * reach
    close = reached & ((D < nearest) | (D > farthest))
    if close.any():
        _sharpen(arm, c, close, (u, v, D, S))
    D2 = D * D
    gamma = np.arctan2(S, D2 - C)
    A = D2 + K
    Au, Av, Su, Sv = A * u, A * v, S * u, S * v
    x, z = np.empty((2, *q.shape[:2], q.shape[-1]))
    np.subtract(Au, Sv, out=x[:, 0])
    np.add(Au, Sv, out=x[:, 1])
    np.add(Av, Su, out=z[:, 0])
    np.subtract(Av, Su, out=z[:, 1])
    q[:, :, :, 1] = np.arctan2(x, z)[:, :, None]
    for e, q3 in enumerate((gamma - bend, -gamma - bend)):
        q[:, e, :, 2] = (q3 - TWO_PI * np.rint(q3 / TWO_PI))[:, None]
    # the forearm, from elbow to wrist center
    f = (0.5 / D2)[:, None]
    x *= f
    np.subtract(u[:, None], x, out=x)
    z *= f
    z -= v[:, None]
    return d * x - a * z, d * z + a * x, reached


def _triangle(
    arm: Arm, rho: FloatArray, wz: FloatArray, reach: float, inner: float
) -> tuple[FloatArray, ...]:
    """Relate the wrist center to axis 2 (step 3), and bend the triangle of the arm (step 4).

    Args:
        arm: The arm.
        rho: Signed distance of the wrist center from axis 1. Shape (2, n).
        wz: Height of the wrist center. Shape (n,).
        reach: L2 + L3.
        inner: |L3 - L2|.

    Returns:
        u, v and D of the nearest point in reach, S, and D of the wrist center, each (2, n).
    """
    u = rho - arm.a1
    v = np.broadcast_to(wz - arm.d1, u.shape)
    D = distance = np.sqrt(u * u + v * v)
    fold = max(inner, SMALL)
    folded = D <= SMALL
    if folded.any():  # onto the shoulder, where any theta2 is right
        u, v, D = np.where(folded, 0.0, u), np.where(folded, fold, v), np.where(folded, fold, D)
    edge = np.minimum(np.maximum(D, fold), reach)
    u, v = u * (edge / D), v * (edge / D)
    S = np.sqrt((reach - edge) * (reach + edge) * (edge - inner) * (edge + inner))
    return u, v, edge, S, distance


def _sharpen(arm: Arm, c: FloatArray, close: BoolArray, triangle: Sequence[FloatArray]) -> None:
    """Compute the triangle again where it is all but flat, in extended precision.

    Its angle - there S / (2 L2 L3) - is the square root of what the wrist center is short of the
    edge of reach, of which rounding each step from the pose to there leaves few digits.

    Args:
        arm: The arm.
        c: Entries of the poses. Shape (16, n).
        close: Which to correct. Shape (2, n).
        triangle: u, v, D and S, corrected where close. Shapes (2, n).
    """
    some = close.any(axis=0)
    L2, L3 = np.longdouble(arm.L2), np.sqrt(np.longdouble(arm.d4) ** 2 + np.longdouble(arm.a3) ** 2)
    _, w = _wrist_pose(arm, c[:, some].astype(np.longdouble))
    _, _, rho, _ = _shoulders(arm, w)
    exact = _triangle(arm, rho, w[2], L2 + L3, abs(L3 - L2))[:4]
    for rough, sharp in zip(triangle, exact, strict=True):
        rough[:, some] = np.where(close[:, some], sharp, rough[:, some])


def _wrists(
    R: FloatArray,
    c1: FloatArray,
    s1: FloatArray,
    c23: FloatArray,
    s23: FloatArray,
    q: FloatArray,
) -> None:
    """Turn the wrist to the tool, flipped and not (step 6).

    Args:
        R: Rotation of the wrist. Shape (3, 3, n).
        c1: cos(theta1). Shape (2, n).
        s1: sin(theta1). Shape (2, n).
        c23: cos(theta2 + theta3). Shape (2, 2, n).
        s23: sin(theta2 + theta3). Shape (2, 2, n).
        q: Its theta4, theta5 and theta6 are filled in. Shape (2, 2, 2, 6, n).
    """
    x, y, z = R
    c1, s1 = c1[:, None], s1[:, None]
    # Rz(-theta1) R, its rows 0 and 1; + 0.0 makes 0.0 of -0.0, of which atan2 would make pi
    n, m = c1 * x + s1 * y, c1 * y - s1 * x + 0.0
    k0 = s23 * n[:, None, 0] + c23 * z[0]
    k1 = s23 * n[:, None, 1] + c23 * z[1]
    k2 = s23 * n[:, None, 2] + c23 * z[2]
    m0, m1, m2 = m[:, None, 0], m[:, None, 1], m[:, None, 2]
    h = np.sqrt(m0 * m0 + k0 * k0)
    q5 = np.arctan2(h, c23 * n[:, None, 0] - s23 * z[0])
    if not h.all():  # only theta4 + theta6 is given there: take theta4 = 0
        k0[h == 0.0] = -1.0
    q4 = np.arctan2(m0, -k0)
    q6 = np.arctan2(k0 * m2 - m0 * k2 + 0.0, m0 * k1 - k0 * m1)
    q[:, :, 0, 3], q[:, :, 0, 4], q[:, :, 0, 5] = q4, q5, q6
    np.subtract(q4, np.copysign(np.pi, q4), out=q[:, :, 1, 3])
    np.negative(q5, out=q[:, :, 1, 4])
    np.subtract(q6, np.copysign(np.pi, q6), out=q[:, :, 1, 5])


def _turn_into_limits(q: FloatArray, bounds: Bounds) -> BoolArray:
    """Add the turns to q (2, 2, 2, 6, n) that bring it inside of the limits.

    Returns:
        Where that was possible. Shape (2, 2, 2, n).
    """
    inside = np.ones((2, 2, 2, q.shape[-1]), dtype=np.bool_)
    turns = []
    for j, low, high, can_turn in (*bounds.arm, *bounds.wrist):
        # joint 1 is the same for both elbows, and joints 1 to 3 are for both wrists, unless turned
        angle = q[:, : 1 if j < 1 else 2, : 1 if j < 3 else 2, j]
        fits = (angle >= low) & (angle <= high)
        if can_turn:
            lowest = angle + TWO_PI * np.ceil((low - angle) / TWO_PI)
            turned = ~fits & (lowest <= high)
            fits |= turned
            turns.append((j, turned, lowest))
        inside &= fits
    for j, turned, lowest in turns:
        q[:, :, :, j] = np.where(turned & inside, lowest, q[:, :, :, j])
    return inside
