"""Denavit-Hartenberg tables: to an arm, from a chain, as matrices and as formulas.

Modified (Craig): T_{i-1,i} = Rx(alpha_{i-1}) Tx(a_{i-1}) Rz(theta_i) Tz(d_i).
Classic (Denavit and Hartenberg): T_{i-1,i} = Rz(theta_i) Tz(d_i) Tx(a_i) Rx(alpha_i).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, fields
from itertools import pairwise
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .arm import Arm
from .chain import Axes, chain_axes
from .exceptions import IKError
from .geometry import SLANT, from_chain, nearest_points
from .poses import check_poses
from .tolerances import ANGLE_TOLERANCE, LENGTH_TOLERANCE

FloatArray = NDArray[np.float64]

Z_AXIS = np.array([0.0, 0.0, 1.0])
DIGITS = 14
"""Decimals to which derived parameters are rounded [m and rad]."""


@dataclass(frozen=True, kw_only=True, eq=False)
class DH:
    """A table of Denavit-Hartenberg parameters, one entry per row in each field.

    Rows beyond the number of signs are fixed; the seventh row of a six-axis arm usually is the
    distance to its tool.

    Raises:
        IKError: The fields differ in length, are not finite, or a sign is not +-1.
    """

    alpha: FloatArray
    """Link twist: alpha_{i-1} (modified) or alpha_i (classic) [rad]. Shape (n,)."""
    a: FloatArray
    """Link length: a_{i-1} (modified) or a_i (classic) [m]. Shape (n,)."""
    d: FloatArray
    """Link offset [m]. Shape (n,)."""
    theta: FloatArray
    """Joint angle at q = 0 [rad]. Shape (n,)."""
    signs: tuple[int, ...] = (1, 1, 1, 1, 1, 1)
    """+1 or -1 for each joint: theta_i = sign * q_i + theta [1]."""
    convention: Literal["modified", "classic"] = "modified"
    """Which of the two products the rows stand for."""
    T_base: FloatArray = field(default_factory=lambda: np.eye(4))
    """Pose of frame 0 in the base frame. Shape (4, 4)."""
    T_tool: FloatArray = field(default_factory=lambda: np.eye(4))
    """Pose of the tool in the last frame. Shape (4, 4)."""

    def __post_init__(self) -> None:
        """Check the fields and make the arrays read-only."""
        for f in fields(self)[:4]:
            value = np.array(getattr(self, f.name), dtype=np.float64)
            if value.ndim != 1 or len(value) != len(self.alpha) or not np.isfinite(value).all():
                raise IKError(f"{f.name} must be {len(self.alpha)} finite numbers, got {value}")
            value.setflags(write=False)
            object.__setattr__(self, f.name, value)
        object.__setattr__(self, "signs", tuple(int(s) for s in self.signs))
        if any(abs(s) != 1 for s in self.signs) or len(self.signs) > len(self.alpha):
            raise IKError(f"signs must be +1 or -1, at most one per row, got {self.signs}")
        if self.convention not in ("modified", "classic"):
            raise IKError(f"convention must be modified or classic, got {self.convention!r}")
        for key in ("T_base", "T_tool"):
            pose = np.array(getattr(self, key), dtype=np.float64)
            check_poses(pose, key)
            pose.setflags(write=False)
            object.__setattr__(self, key, pose)

    def transforms(self, q: ArrayLike) -> FloatArray:
        """Evaluate the transform of each row.

        Args:
            q: Joint angles [rad]. Shape (..., m), m the number of signs.

        Returns:
            T_{i-1,i}; their product between `T_base` and `T_tool` is the pose of the tool.
            Shape (..., n, 4, 4).

        Raises:
            IKError: q has the wrong length.
        """
        angles = np.asarray(q, dtype=np.float64)
        m = len(self.signs)
        if angles.ndim < 1 or angles.shape[-1] != m:
            raise IKError(f"q must have shape (..., {m}), got {angles.shape}")
        theta = np.broadcast_to(self.theta, (*angles.shape[:-1], len(self.theta))).copy()
        theta[..., :m] += angles * self.signs
        spin = _screw_z(theta, self.d)
        twist = _screw_x(self.alpha, self.a)
        return twist @ spin if self.convention == "modified" else spin @ twist

    def forward(self, q: ArrayLike) -> FloatArray:
        """Compute the pose of the tool in the base frame.

        Args:
            q: Joint angles [rad]. Shape (..., m).

        Returns:
            T_base_tool. Shape (..., 4, 4).

        Raises:
            IKError: q has the wrong length.
        """
        steps = self.transforms(q)
        T = self.T_base
        for i in range(len(self.alpha)):
            T = T @ steps[..., i, :, :]
        return np.asarray(T @ self.T_tool)


def from_dh(
    dh: DH,
    *,
    angle_tolerance: float = ANGLE_TOLERANCE,
    length_tolerance: float = LENGTH_TOLERANCE,
    name: str = "",
) -> Arm:
    """Recognise an arm of the class in a Denavit-Hartenberg table.

    Args:
        dh: The table, modified or classic.
        angle_tolerance: See `from_chain` [rad].
        length_tolerance: See `from_chain` [m].
        name: For messages only.

    Returns:
        The arm, whose base frame, tool and joint angles are those of the table.

    Raises:
        UnsupportedArm: The table is no arm of the class.
    """
    n, m = len(dh.alpha), len(dh.signs)
    twist = _screw_x(dh.alpha, dh.a)
    if dh.convention == "modified":
        # a joint turns about z behind its twist
        origins = twist @ _screw_z(dh.theta, dh.d)
        tail = np.eye(4)
    else:
        # a joint turns about the z before: the rest of its row comes behind it
        rest = _screw_z(np.zeros(n), dh.d) @ twist
        turn = _screw_z(dh.theta, np.zeros(n))
        origins = np.concatenate([turn[:1], rest[:-1] @ turn[1:]])
        tail = rest[-1]
    origins[0] = dh.T_base @ origins[0]
    axes = np.zeros((n, 3))
    axes[:m, 2] = dh.signs
    return from_chain(
        origins,
        axes,
        tail @ dh.T_tool,
        angle_tolerance=angle_tolerance,
        length_tolerance=length_tolerance,
        name=name,
    )


def dh_from_chain(origins: ArrayLike, axes: ArrayLike, T_tip: ArrayLike | None = None) -> DH:
    """Derive the modified Denavit-Hartenberg table of any serial chain of revolute joints.

    z_i lies along joint i and x_i along the common normal from axis i to axis i + 1 (Craig,
    "Introduction to Robotics", section 3.4). Where that leaves a choice, it falls on d_i = 0, then
    on the smaller |theta_i|, then on a_i > 0. Frame 0 is frame 1 at q_1 = 0, moved along the axis
    to the height of the base; a last fixed row goes along z_n to the height of the tip.

    Args:
        origins: Fixed transform from the parent link to each joint. Shape (n, 4, 4).
        axes: Axis of each joint in its own frame; zeros for a fixed joint. Shape (n, 3).
        T_tip: Pose of the tool in the last link. Shape (4, 4); the last link itself by default.

    Returns:
        The table, with one row per moving joint and one for the tool. All signs are +1.

    Raises:
        IKError: The arrays describe no chain, or none of its joints moves.
    """
    lines = chain_axes(origins, axes, T_tip)
    if len(lines.points) == 0:
        raise IKError("the chain has no moving joint")
    frames = _frames(lines)
    T_first = frames[0]
    rows = [_row(A, B) for A, B in pairwise(frames)]
    T_last_tip = np.linalg.inv(frames[-1]) @ lines.T_tip
    rise = round(float(T_last_tip[2, 3]), DIGITS)
    T_last_tip[2, 3] = 0.0
    rows.append((0.0, 0.0, rise, 0.0))
    alpha, a, d, theta = np.array(rows).T
    return DH(
        alpha=alpha,
        a=a,
        d=d,
        theta=theta,
        signs=(1,) * len(lines.points),
        T_base=_rounded(T_first),
        T_tool=_rounded(T_last_tip),
    )


def _frames(lines: Axes) -> list[FloatArray]:
    """Lay the frames 0 to n of the modified convention into the zero pose."""
    n = len(lines.points)
    z = lines.directions
    foot = lines.points[0] - (lines.points[0] @ z[0]) * z[0]  # of the base origin on axis 1
    reference = np.eye(3)[0] if np.abs(z[0][0]) < math.cos(SLANT) else Z_AXIS
    x_before = _perpendicular(reference, z[0])
    frames = []
    for i in range(n):
        origin, x, a = foot, x_before, 0.0
        if i + 1 < n:
            parallel = np.linalg.norm(np.cross(z[i], z[i + 1])) < SLANT
            if parallel:
                offset = lines.points[i + 1] - foot
                offset = offset - (offset @ z[i]) * z[i]
                foot = foot + offset
                a = float(np.linalg.norm(offset))
                x = offset / a if a > LENGTH_TOLERANCE else _perpendicular(x_before, z[i])
            else:
                origin, foot = nearest_points(lines, i, i + 1)
                x = np.cross(z[i], z[i + 1])
                x = x / np.linalg.norm(x)
                a = float((foot - origin) @ x)
        along = float(x @ x_before)
        if along < -ANGLE_TOLERANCE or (along < ANGLE_TOLERANCE and a < -LENGTH_TOLERANCE):
            x = -x
        frames.append(_frame(x, z[i], origin))
        x_before = x
    first = frames[0].copy()
    first[:3, 3] -= ((first[:3, 3]) @ z[0]) * z[0]
    return [first, *frames]


def _row(A: FloatArray, B: FloatArray) -> tuple[float, float, float, float]:
    """Read alpha, a, d and theta off two frames that follow each other."""
    (xA, _, zA, pA), (xB, _, zB, pB) = A[:3].T, B[:3].T
    alpha = math.atan2(float(np.cross(zA, zB) @ xA), float(zA @ zB))
    theta = math.atan2(float(np.cross(xA, xB) @ zB), float(xA @ xB))
    a, d = float((pB - pA) @ xA), float((pB - pA) @ zB)
    return _tidy_angle(alpha), round(a, DIGITS), round(d, DIGITS), _tidy_angle(theta)


def _tidy_angle(angle: float) -> float:
    """Snap an angle within rounding of a multiple of pi/2 to it."""
    quarter = round(angle / (0.5 * math.pi))
    exact = quarter * 0.5 * math.pi
    return exact if abs(angle - exact) < 10.0**-DIGITS else angle


def _rounded(T: FloatArray) -> FloatArray:
    """Clear a transform of rounding, including negative zeros."""
    return np.asarray(np.round(T, DIGITS) + 0.0)


def _perpendicular(a: FloatArray, z: FloatArray) -> FloatArray:
    """Return the unit vector along the part of a that is perpendicular to z."""
    a = a - (a @ z) * z
    return np.asarray(a / np.linalg.norm(a))


def _frame(x: FloatArray, z: FloatArray, p: FloatArray) -> FloatArray:
    T = np.eye(4)
    T[:3] = np.column_stack([x, np.cross(z, x), z, p])
    return T


def _screw_x(angle: FloatArray, length: FloatArray) -> FloatArray:
    """Rotate about x and move along it. Shapes (..., n) -> (..., n, 4, 4)."""
    return _screw(angle, length, 1, 2, 0)


def _screw_z(angle: FloatArray, length: FloatArray) -> FloatArray:
    """Rotate about z and move along it. Shapes (..., n) -> (..., n, 4, 4)."""
    return _screw(angle, length, 0, 1, 2)


def _screw(angle: FloatArray, length: FloatArray, i: int, j: int, k: int) -> FloatArray:
    """Rotate from axis i to axis j, about axis k, and move along k."""
    T = np.zeros((*np.shape(angle), 4, 4))
    T[..., i, i] = T[..., j, j] = np.cos(angle)
    T[..., j, i] = np.sin(angle)
    T[..., i, j] = -T[..., j, i]
    T[..., k, k] = T[..., 3, 3] = 1.0
    T[..., k, 3] = length
    return T
