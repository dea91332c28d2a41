"""The geometry of an arm as one frozen value, and the bundled KUKA KR210.

An arm of the class has an ortho-parallel base (axis 1 perpendicular to axis 2, axis 2 parallel to
axis 3, axis 3 perpendicular to axis 4) and a spherical wrist (axes 4, 5 and 6 meet in one point,
each perpendicular to the next). `README.md` has the figure.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .exceptions import IKError
from .poses import check_poses
from .tolerances import SHARPEN, SMALL

FloatArray = NDArray[np.float64]
Triple = tuple[float, float, float]


class Constants(NamedTuple):
    """Numbers derived from an `Arm` that the formulas use; plain floats, because those are fast."""

    L3: float
    """Distance from axis 3 to the wrist center [m]."""
    phi: float
    """Sag angle, atan2(-a3, d4): from the forearm to the line from axis 3 to the wrist [rad]."""
    reach: float
    """Largest distance from axis 2 to the wrist center, L2 + L3 [m]."""
    elbow: tuple[float, ...]
    """For steps 3 to 5: a1, d1, reach, smallest distance |L3 - L2|, the same but at least
    `tolerances.SMALL` [m], L2^2 - L3^2, L2^2 + L3^2 [m^2], pi/2 + phi [rad], a3 / L3^2 and
    d4 / L3^2 [1/m]."""
    plain_reach: tuple[float, float]
    """Between these distances from axis 2 to the wrist center the elbow needs no more than double
    precision [m]; an arm that folds onto its shoulder has no edge there."""
    p_base: Triple
    """Origin of the arm's own base frame in the base frame [m]."""
    axes_base: tuple[Triple, Triple, Triple]
    """Axes x, y, z of the arm's own base frame in the base frame."""
    p_tool: Triple
    """The tool's origin seen from the wrist center, in the wrist frame [m]."""
    c_tool: Triple
    """The tool's origin seen from the wrist center, in the tool frame [m]."""
    R_base: tuple[float, ...] | None
    """Rotation of `T_base`, row by row; None when it is the identity."""
    R_tool: tuple[float, ...] | None
    """Rotation of `T_tool`, row by row; None when it is the identity."""
    plain_joints: bool
    """True when all signs are +1 and all offsets 0."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Arm:
    """Lengths, joint signs and offsets, base and tool of an arm of the class.

    In the arm's own zero pose (all theta = 0) the upper arm points along +z and the forearm along
    +x; axis 1 is +z, axes 2, 3 and 5 are +y, axes 4 and 6 are +x. The angles of the caller's robot
    are q, with theta = signs * q + offsets.

    Raises:
        IKError: A length is not finite or L2 or L3 is zero, a sign is not +-1, an offset is not
            finite, or a transform is not rigid.
    """

    a1: float
    """Distance from axis 1 to axis 2 along x [m]."""
    d1: float
    """Height of axis 2 above the origin of the arm's base frame [m]."""
    L2: float
    """Length of the upper arm, axis 2 to axis 3 [m]."""
    a3: float
    """Offset from axis 3 to axis 4 along z [m]; -0.054 on the KR210, axis 4 below axis 3."""
    d4: float
    """Length of the forearm, axis 3 to the wrist center along axis 4 [m]."""
    b: float = 0.0
    """Lateral offset of the arm plane from axis 1, along y [m]."""
    signs: tuple[int, ...] = (1, 1, 1, 1, 1, 1)
    """+1 or -1 for each joint [1]."""
    offsets: tuple[float, ...] = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    """theta at q = 0 for each joint [rad]."""
    T_base: FloatArray = field(default_factory=lambda: np.eye(4))
    """Pose of the arm's own base frame in the caller's base frame. Shape (4, 4)."""
    T_tool: FloatArray = field(default_factory=lambda: np.eye(4))
    """Pose of the tool in the wrist frame, which is at the wrist center. Shape (4, 4)."""
    name: str = ""
    """For messages only."""
    constants: Constants = field(init=False, repr=False)
    """Derived numbers; see `Constants`."""

    def __post_init__(self) -> None:
        """Check and freeze the fields, and derive the constants."""
        set_ = object.__setattr__  # the dataclass is frozen
        for key in ("a1", "d1", "L2", "a3", "d4", "b"):
            set_(self, key, float(getattr(self, key)))
            if not math.isfinite(getattr(self, key)):
                raise IKError(f"{key} must be a finite length in metres, got {getattr(self, key)}")
        set_(self, "signs", tuple(int(s) for s in self.signs))
        set_(self, "offsets", tuple(float(o) for o in self.offsets))
        if len(self.signs) != 6 or any(abs(s) != 1 for s in self.signs):
            raise IKError(f"signs must be six values of +1 or -1, got {self.signs}")
        if len(self.offsets) != 6 or not all(map(math.isfinite, self.offsets)):
            raise IKError(f"offsets must be six finite angles in rad, got {self.offsets}")
        if self.L2 <= 0.0 or math.hypot(self.d4, self.a3) <= 0.0:
            raise IKError("L2 must be positive, and d4 and a3 must not both be zero")
        for key in ("T_base", "T_tool"):
            set_(self, key, _frozen_pose(getattr(self, key), key))
        set_(self, "constants", _derive(self))

    def _key(self) -> tuple[object, ...]:
        lengths = (self.a1, self.d1, self.L2, self.a3, self.d4, self.b)
        poses = (*self.T_base.ravel().tolist(), *self.T_tool.ravel().tolist())
        return lengths + self.signs + self.offsets + poses

    def __eq__(self, other: object) -> bool:
        """Compare the numbers; the name does not count."""
        return self._key() == other._key() if isinstance(other, Arm) else NotImplemented

    def __hash__(self) -> int:
        """Hash the numbers."""
        return hash(self._key())


def _frozen_pose(T: ArrayLike, name: str) -> FloatArray:
    """Return a read-only copy of a rigid transform (4, 4)."""
    pose = np.array(T, dtype=np.float64)
    if pose.shape != (4, 4):
        raise IKError(f"{name} must have shape (4, 4), got {pose.shape}")
    check_poses(pose, name)
    pose.setflags(write=False)
    return pose


def _derive(arm: Arm) -> Constants:
    """Compute the constants of the formulas (README.md, section "The formulas")."""
    L3, phi = math.hypot(arm.d4, arm.a3), math.atan2(-arm.a3, arm.d4)
    reach, inner = arm.L2 + L3, abs(L3 - arm.L2)
    R_base, R_tool = arm.T_base[:3, :3], arm.T_tool[:3, :3]
    eye = np.eye(3)
    return Constants(
        L3=L3,
        phi=phi,
        reach=reach,
        elbow=(
            arm.a1,
            arm.d1,
            reach,
            inner,
            max(inner, SMALL),
            (arm.L2 - L3) * reach,
            arm.L2 * arm.L2 + L3 * L3,
            math.remainder(0.5 * math.pi + phi, math.tau),
            arm.a3 / (L3 * L3),
            arm.d4 / (L3 * L3),
        ),
        plain_reach=(inner + SHARPEN * reach if inner else SMALL, reach - SHARPEN * reach),
        p_base=_triple(arm.T_base[:3, 3]),
        axes_base=(_triple(R_base[:, 0]), _triple(R_base[:, 1]), _triple(R_base[:, 2])),
        p_tool=_triple(arm.T_tool[:3, 3]),
        c_tool=_triple(R_tool.T @ arm.T_tool[:3, 3]),
        R_base=None if np.array_equal(R_base, eye) else tuple(R_base.ravel().tolist()),
        R_tool=None if np.array_equal(R_tool, eye) else tuple(R_tool.ravel().tolist()),
        plain_joints=arm.signs == (1,) * 6 and arm.offsets == (0.0,) * 6,
    )


def _triple(a: FloatArray) -> Triple:
    x, y, z = a.tolist()
    return x, y, z


def _kr210() -> Arm:
    T_tool = np.eye(4)
    T_tool[0, 3] = 0.303  # wrist center to flange 0.193, flange to gripper_link 0.11
    return Arm(a1=0.35, d1=0.75, L2=1.25, a3=-0.054, d4=1.5, T_tool=T_tool, name="KUKA KR210")


KR210 = _kr210()
"""The bundled arm. Base frame: base_link. Tool: gripper_link, 0.303 m from the wrist center."""
