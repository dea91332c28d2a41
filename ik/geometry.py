"""From a chain of joints to an `Arm`, or to the geometric reason why it is none."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .arm import Arm
from .chain import Axes, chain_axes
from .exceptions import UnsupportedArm
from .tolerances import ANGLE_TOLERANCE, LENGTH_TOLERANCE

FloatArray = NDArray[np.float64]

SLANT = 1e-3
"""Axes at a smaller angle than this have no usable common normal [rad]."""

DIGITS = 15
"""Decimals to which lengths and offsets are rounded, so that 0.054 stays 0.054 [m and rad]."""


def from_chain(
    origins: ArrayLike,
    axes: ArrayLike,
    T_tip: ArrayLike | None = None,
    *,
    angle_tolerance: float = ANGLE_TOLERANCE,
    length_tolerance: float = LENGTH_TOLERANCE,
    name: str = "",
) -> Arm:
    """Recognise an arm of the class in a chain of joints.

    Works from the axes as lines in the zero pose, so it does not matter how the frames of the
    chain are turned, which way its axes point, or where along an axis a joint has its origin.

    Args:
        origins: Fixed transform from the parent link to each joint. Shape (n, 4, 4).
        axes: Axis of each joint in its own frame; zeros for a fixed joint, anywhere in the
            chain. Shape (n, 3).
        T_tip: Pose of the tool in the last link. Shape (4, 4); the last link itself by default.
        angle_tolerance: How far axes may be from parallel or perpendicular [rad]. What is
            accepted is solved as if it were exact, so poses may be off by the deviation.
        length_tolerance: How far axes 4, 5 and 6 may miss their common point [m].
        name: For messages only.

    Returns:
        The arm, whose base frame, tool and joint angles are those of the chain.

    Raises:
        UnsupportedArm: The chain is no arm of the class; the message says which axes fail to
            meet, to be parallel or to be perpendicular, and by how much.
        IKError: The arrays describe no chain.
    """
    lines = chain_axes(origins, axes, T_tip)
    reasons = misfits(lines, angle_tolerance, length_tolerance)
    if reasons:
        raise UnsupportedArm(
            reasons,
            f"tolerance {angle_tolerance:g} rad and {length_tolerance:g} m; if the description "
            "holds rounded angles, such as 1.5708 for pi/2, give a larger one",
        )
    return _arm(lines, length_tolerance, name)


def misfits(lines: Axes, angle_tolerance: float, length_tolerance: float) -> tuple[str, ...]:
    """List the conditions of the class that a set of axes fails, in geometric words.

    Args:
        lines: Axes in the zero pose. The conditions bind neighbouring axes only, so they hold in
            every pose or in none.
        angle_tolerance: See `from_chain` [rad].
        length_tolerance: See `from_chain` [m].

    Returns:
        One sentence for each failed condition; empty for an arm of the class.
    """
    count = len(lines.points)
    if count != 6:
        return (f"it has {count} moving joints, and the class has six",)
    reasons = []
    z = lines.directions
    for i, j, wanted in ((1, 2, 90), (2, 3, 0), (3, 4, 90), (4, 5, 90), (5, 6, 90)):
        angle = _angle(z[i - 1], z[j - 1])
        if abs(angle - math.radians(wanted)) > angle_tolerance:
            word = "parallel" if wanted == 0 else "perpendicular"
            reasons.append(f"axes {i} and {j} are not {word}: {_degrees(angle)} apart")
    reasons += _wrist_misfits(lines, length_tolerance)
    if not reasons:
        reasons += _length_misfits(lines, length_tolerance)
    return tuple(reasons)


def _wrist_misfits(lines: Axes, tolerance: float) -> list[str]:
    """Say how axes 4, 5 and 6 fail to meet in one point."""
    reasons = []
    points_5 = []
    for i in (4, 6):
        pair = f"axes {min(i, 5)} and {max(i, 5)}"
        if _angle(lines.directions[i - 1], lines.directions[4]) < SLANT:
            return [f"{pair} of the wrist are parallel"]
        on_i, on_5 = nearest_points(lines, i - 1, 4)
        points_5.append(on_5)
        gap = float(np.linalg.norm(on_i - on_5))
        if gap > tolerance:
            reasons.append(f"{pair} do not meet: they pass {gap:.6g} m apart")
    apart = float(np.linalg.norm(points_5[0] - points_5[1]))
    if apart > tolerance:
        reasons.append(f"axes 4 and 6 meet axis 5 {apart:.6g} m apart, not in one point")
    return reasons


def _length_misfits(lines: Axes, tolerance: float) -> list[str]:
    """Say which of the two long lengths of the arm is none."""
    reasons = []
    center = wrist_point(lines)
    for i, j, point in ((2, 3, lines.points[2]), (3, 0, center)):
        line, z = lines.points[i - 1], lines.directions[i - 1]
        offset = point - line
        if np.linalg.norm(offset - (offset @ z) * z) <= tolerance:
            what = f"axis {j}" if j else "the wrist center"
            reasons.append(f"{what} lies on axis {i}")
    return reasons


def _arm(lines: Axes, tolerance: float, name: str) -> Arm:
    """Read the lengths, signs and offsets off the axes of an arm of the class."""
    p, z = lines.points, lines.directions
    center = wrist_point(lines)
    # the arm's own base frame: z along axis 1 and up, x from axis 1 to axis 2
    Z = z[0] * _leading_sign(z[0])
    side = _unit(z[1] - (z[1] @ Z) * Z)
    X = np.cross(side, Z)
    a1 = float((p[1] - p[0]) @ X)
    X = X * (math.copysign(1.0, a1) if abs(a1) > tolerance else _leading_sign(X))
    Y = np.cross(Z, X)
    foot = p[0] - (p[0] @ Z) * Z  # of the perpendicular from the base origin to axis 1
    shoulder, elbow = p[1] - foot, p[2] - foot
    upper = elbow - shoulder
    theta2 = math.atan2(upper @ X, upper @ Z)
    # the forearm: x along axis 4 towards the wrist center
    forearm = center - p[2]
    X4 = _unit(z[3] - (z[3] @ Y) * Y)
    X4 = X4 * (1.0 if forearm @ X4 >= -tolerance else -1.0)
    Z4 = np.cross(X4, Y)
    theta23 = math.atan2(-(X4 @ Z), X4 @ X)
    # the wrist: the smaller of both offsets of axes 4 and 5
    Y5 = z[4] - (z[4] @ X4) * X4
    Y5 = _unit(Y5) * (1.0 if Y5 @ Y >= -tolerance else -1.0)
    theta4 = math.atan2(Y5 @ Z4, Y5 @ Y)
    X6 = z[5] - (z[5] @ Y5) * Y5
    ahead = X6 @ X4 if abs(X6 @ X4) > tolerance else X6 @ (lines.T_tip[:3, 3] - center)
    X6 = _unit(X6) * (1.0 if ahead >= -tolerance else -1.0)
    theta5 = math.atan2(-(X6 @ np.cross(X4, Y5)), X6 @ X4)
    theta = (0.0, theta2, _wrapped(theta23 - theta2), theta4, theta5, 0.0)
    own = (Z, Y, Y, X4, Y5, X6)
    T_wrist = _pose(X6, Y5, np.cross(X6, Y5), center)
    return Arm(
        a1=_rounded(shoulder @ X),
        d1=_rounded(shoulder @ Z),
        L2=_rounded(math.hypot(upper @ X, upper @ Z)),
        a3=_rounded(forearm @ Z4),
        d4=_rounded(forearm @ X4),
        b=_rounded((center - foot) @ Y),
        signs=tuple(1 if a @ b > 0.0 else -1 for a, b in zip(own, z, strict=True)),
        offsets=tuple(_rounded(t) for t in theta),
        T_base=_tidy(_pose(X, Y, Z, foot)),
        T_tool=_tidy(np.linalg.inv(T_wrist) @ lines.T_tip),
        name=name,
    )


def wrist_point(lines: Axes) -> FloatArray:
    """Return the common point of axes 4, 5 and 6 in the zero pose [m], shape (3,)."""
    on_4, on_5 = nearest_points(lines, 3, 4)
    return np.asarray(0.5 * (on_4 + on_5))


def nearest_points(lines: Axes, i: int, j: int) -> tuple[FloatArray, FloatArray]:
    """Return the feet of the common normal of two axes that are not parallel [m].

    Args:
        lines: The axes.
        i: Index of the first axis, from 0.
        j: Index of the second axis, from 0.

    Returns:
        The foot on axis i and the foot on axis j. Shapes (3,).
    """
    (p, q), (a, b) = lines.points[[i, j]], lines.directions[[i, j]]
    normal = np.cross(a, b)
    offset, n2 = q - p, normal @ normal
    s, t = np.cross(offset, b) @ normal / n2, np.cross(offset, a) @ normal / n2
    return p + s * a, q + t * b


def _angle(a: FloatArray, b: FloatArray) -> float:
    """Angle between two undirected lines, 0 to pi/2 [rad], accurate at both ends."""
    return math.atan2(float(np.linalg.norm(np.cross(a, b))), abs(float(a @ b)))


def _degrees(angle: float) -> str:
    return f"{math.degrees(angle):.7g} deg"


def _unit(a: FloatArray) -> FloatArray:
    return np.asarray(a / np.linalg.norm(a))


def _leading_sign(a: FloatArray) -> float:
    """Sign of the component that is largest in magnitude."""
    return math.copysign(1.0, a[np.argmax(np.abs(a).round(6))])


def _wrapped(angle: float) -> float:
    return math.remainder(angle, math.tau)


def _rounded(x: float) -> float:
    """Clear a number of rounding, including a negative zero."""
    return round(float(x), DIGITS) + 0.0


def _pose(x: FloatArray, y: FloatArray, z: FloatArray, p: FloatArray) -> FloatArray:
    T = np.eye(4)
    T[:3] = np.column_stack([x, y, z, p])
    return T


def _tidy(T: FloatArray) -> FloatArray:
    """Clear a transform of rounding; a rotation by right angles becomes exactly one."""
    R = T[:3, :3]
    if np.abs(R - np.rint(R)).max() < 10.0**-DIGITS:
        T[:3, :3] = np.rint(R)
    T[:3, 3] = np.round(T[:3, 3], DIGITS)
    return T + 0.0
