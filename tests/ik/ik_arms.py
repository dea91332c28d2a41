"""What the tests of `ik` share: robot descriptions, and forward kinematics of their own.

The forward kinematics here multiplies the chain of a description out, in any precision, and shares
nothing with `ik`.
"""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

DEG = np.pi / 180.0


@dataclass(frozen=True)
class Chain:
    """A description as arrays: one row per joint, fixed ones with a zero axis."""

    origins: np.ndarray
    axes: np.ndarray
    lower: np.ndarray
    upper: np.ndarray
    velocity: np.ndarray

    def forward(self, q: np.ndarray, dtype: Any = np.longdouble) -> np.ndarray:
        """T_base_tip (..., 4, 4) by multiplying the chain out, joint by joint."""
        q = np.asarray(q, dtype)
        T: Entries = list(np.eye(3, 4, dtype=dtype))
        joint = 0
        for origin, axis in zip(self.origins.astype(dtype), self.axes.astype(dtype), strict=True):
            T = product(T, origin)
            if axis.any():
                T = product(T, rotation(axis, q[..., joint]))
                joint += 1
        return matrix(T, q[..., 0])


Entries = Sequence[Sequence[Any]]
"""The upper three rows of transforms, an array (...) or a number for all of them per entry: this
is faster in extended precision than matmul, and zeros cost nothing."""


def product(A: Entries, B: Entries) -> Entries:
    """Entries of A @ B."""
    C = [[total(times(a[k], B[k][j]) for k in range(3)) for j in range(4)] for a in A]
    for a, c in zip(A, C, strict=True):
        c[3] = total((c[3], a[3]))
    return C


def times(a: Any, b: Any) -> Any:
    return 0 if is_nothing(a) or is_nothing(b) else a * b


def total(terms: Iterable[Any]) -> Any:
    return sum(term for term in terms if not is_nothing(term))


def is_nothing(entry: Any) -> bool:
    return np.ndim(entry) == 0 and entry == 0


def matrix(entries: Entries, like: np.ndarray) -> np.ndarray:
    """Transforms (..., 4, 4) of their entries, as many and as precise as `like` (...)."""
    T = np.zeros((*like.shape, 4, 4), like.dtype)
    for i, row in enumerate(entries):
        for j, entry in enumerate(row):
            T[..., i, j] = entry
    T[..., 3, 3] = 1
    return T


def rotation(axis: np.ndarray, angle: np.ndarray) -> Entries:
    """Entries of the rotation about an axis."""
    x, y, z = axis / np.sqrt((axis * axis).sum())
    c, s = np.cos(angle), np.sin(angle)
    xs, ys, zs = times(x, s), times(y, s), times(z, s)
    xx, yy, zz = (total((c, times(u * u, 1 - c))) for u in (x, y, z))
    xy, yz, zx = (times(u * v, 1 - c) for u, v in ((x, y), (y, z), (z, x)))
    return (
        (xx, total((xy, -zs)), total((zx, ys)), 0),
        (total((xy, zs)), yy, total((yz, -xs)), 0),
        (total((zx, -ys)), total((yz, xs)), zz, 0),
    )


def parse_urdf(text: str) -> Chain:
    """Read a URDF that is one chain from its root to its tip."""
    rows = []
    for joint in ET.fromstring(text).findall("joint"):
        origin, axis, limit = joint.find("origin"), joint.find("axis"), joint.find("limit")
        T = np.eye(4)
        if origin is not None:
            roll, pitch, yaw = numbers(origin.get("rpy", "0 0 0"))
            T = turn_about(2, yaw) @ turn_about(1, pitch) @ turn_about(0, roll)
            T[:3, 3] = numbers(origin.get("xyz", "0 0 0"))
        moving = joint.get("type") in ("revolute", "continuous")
        a = numbers(axis.get("xyz", "1 0 0")) if moving and axis is not None else np.zeros(3)
        keys = ("lower", "upper", "velocity") if moving else ()
        rows.append((T, a, [float(limit.get(key)) for key in keys]))
    limits = np.array([bounds for _, _, bounds in rows if bounds]).T
    return Chain(np.array([r[0] for r in rows]), np.array([r[1] for r in rows]), *limits)


def turn_about(k: int, angle: float) -> np.ndarray:
    """Rotation about coordinate axis k (4, 4)."""
    return matrix(rotation(np.eye(3)[k], np.array(angle)), np.array(angle))


def numbers(text: str) -> np.ndarray:
    """Three numbers of an attribute."""
    return np.array([float(x) for x in text.split()])


def urdf(*joints: tuple[str, str, str, float, float]) -> str:
    """Write a chain: xyz, rpy, axis (empty for a fixed joint), lower and upper limit [deg]."""
    text = "<robot name='arm'>"
    for i, (xyz, rpy, axis, lower, upper) in enumerate(joints):
        text += (
            f"<joint name='j{i}' type='{'revolute' if axis else 'fixed'}'>"
            f"<parent link='l{i}'/><child link='l{i + 1}'/>"
            f"<origin xyz='{xyz}' rpy='{rpy}'/><axis xyz='{axis or '1 0 0'}'/>"
            f"<limit lower='{lower * DEG!r}' upper='{upper * DEG!r}' velocity='2' effort='0'/>"
            "</joint>"
        )
    return text + "</robot>"


O = "0 0 0"  # noqa: E741
X, Y, Z = "1 0 0", "0 1 0", "0 0 1"
MX, MY, MZ = "-1 0 0", "0 -1 0", "0 0 -1"
P = repr(np.pi)
H = repr(np.pi / 2)

KR210 = urdf(
    ("0 0 0", O, "", 0, 0),
    ("0 0 0.33", O, Z, -185, 185),
    ("0.35 0 0.42", O, Y, -45, 85),
    ("0 0 1.25", O, Y, -210, 65),
    ("0.96 0 -0.054", O, X, -350, 350),
    ("0.54 0 0", O, Y, -125, 125),
    ("0.193 0 0", O, X, -350, 350),
    ("0.11 0 0", O, "", 0, 0),
)
KR210_VELOCITY = np.array([123, 115, 112, 179, 172, 219]) * DEG

# the other arms have the proportions of real ones, and are not exact models of them
OTHERS = {
    # KUKA's own convention: axes 1, 4 and 6 point backwards, the arm is stretched along x at zero
    "small KUKA": urdf(
        ("0 0 0", O, MZ, -170, 170),
        ("0.025 0 0.4", O, Y, -190, 45),
        ("0.455 0 0", O, Y, -120, 156),
        ("0 0 0.035", O, MX, -185, 185),
        ("0.42 0 0", O, Y, -120, 120),
        ("0.08 0 0", O, MX, -350, 350),
        ("0 0 0", f"0 {H} 0", "", 0, 0),
    ),
    # equal upper arm and forearm: it folds onto its own shoulder
    "KUKA that folds": urdf(
        ("0 0 0.4", f"{P} 0 0", Z, -155, 155),
        ("0.18 0 0", f"{H} 0 0", Z, -180, 65),
        ("0.6 0 0", O, Z, -15, 158),
        ("0 0 0", f"{H} 0 0", MZ, -350, 350),
        ("0 0 -0.6", f"-{H} 0 0", Z, -130, 130),
        ("0 0 0", f"{H} 0 0", MZ, -350, 350),
        ("0 0 -0.115", f"0 {P} 0", "", 0, 0),
    ),
    # ABB's: no offset of axis 2, elbow offset upwards, signs of the lower axes as printed
    "ABB": urdf(
        ("0 0 0.29", O, Z, -165, 165),
        ("0 0 0", O, Y, -110, 110),
        ("0 0 0.27", O, MY, -70, 110),
        ("0 0 0.07", O, X, -160, 160),
        ("0.302 0 0", O, Y, -120, 120),
        ("0.072 0 0", O, MX, -400, 400),
        ("0 0 0", f"0 {H} 0", "", 0, 0),
    ),
    "lateral offset": urdf(
        ("0 0 0.5", O, Z, -180, 180),
        ("0.15 0.2 0.1", O, Y, -90, 150),
        ("0 -0.05 0.6", O, Y, -180, 80),
        ("0.3 -0.03 0.2", O, X, -200, 200),
        ("0.34 0 0", O, Y, -125, 125),
        ("0.08 0 0", O, X, -360, 360),
    ),
    "turned base and tool": urdf(
        ("0.3 -0.2 0.9", "0.4 -1.1 2.5", "", 0, 0),
        ("0 0 0.2", "0 0 0.7", Z, -170, 170),
        ("0.2 0 0.3", f"-{H} 0.3 0", Z, -120, 100),
        ("0.5 0.6 0.02", "0 0 -0.8", MZ, -150, 190),
        ("0 0.1 0", f"0 {H} 0.5", Z, -190, 190),
        ("0 0 0.7", f"-{H} 0 0.2", MZ, -120, 120),
        ("0 0 0", f"{H} 0 -0.6", Z, -350, 350),
        ("0.05 -0.1 0.2", "2.2 0.4 -1.3", "", 0, 0),
    ),
    # axis 1 along x, axes 2 and 3 along z, axes 4 and 6 along y
    "mixed axes": urdf(
        ("0.1 0 0", O, X, -170, 170),
        ("0.4 0.3 0", O, MZ, -100, 100),
        ("0.7 0 0", O, Z, -150, 150),
        ("0.05 0.2 0", O, Y, -180, 180),
        ("0 0.45 0", O, MX, -120, 120),
        ("0 0.1 0", O, MY, -180, 180),
        ("0 0 0.1", O, "", 0, 0),
    ),
}

UR_LIKE = urdf(
    ("0 0 0.089", O, Z, -360, 360),
    ("0 0.136 0", f"0 {H} 0", Y, -360, 360),
    ("0 -0.12 0.425", O, Y, -360, 360),
    ("0 0 0.392", f"0 {H} 0", Y, -360, 360),
    ("0 0.093 0", O, Z, -360, 360),
    ("0 0 0.095", O, Y, -360, 360),
    ("0 0.082 0", O, "", 0, 0),
)
SEVEN_AXES = urdf(
    ("0 0 0.34", O, Z, -170, 170),
    ("0 0 0", O, Y, -120, 120),
    ("0 0 0.2", O, Z, -170, 170),
    ("0 0 0.2", O, MY, -120, 120),
    ("0 0 0.2", O, Z, -170, 170),
    ("0 0 0.2", O, Y, -120, 120),
    ("0 0 0.126", O, Z, -175, 175),
)


def residuals(T: np.ndarray, target: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Distance [m] and angle [rad] between poses, in the precision of T."""
    dp = T[..., :3, 3] - target[..., :3, 3]
    A, B = T[..., :3, :3], target[..., :3, :3].astype(T.dtype)
    # the columns' cross products add up to twice the sine of the angle, along its axis
    twist = sum(np.stack(cross(A[..., k], B[..., k])) for k in range(3)) / 2
    return np.sqrt((dp * dp).sum(axis=-1)), np.sqrt((twist * twist).sum(axis=0))


def cross(a: np.ndarray, b: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Components of a x b for vectors along the last dimension."""
    return (
        a[..., 1] * b[..., 2] - a[..., 2] * b[..., 1],
        a[..., 2] * b[..., 0] - a[..., 0] * b[..., 2],
        a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0],
    )


def wrapped(angle: np.ndarray) -> np.ndarray:
    """Angles to [-pi, pi)."""
    return (angle + np.pi) % (2 * np.pi) - np.pi
