"""The arm and gripper found in a description: the only place that knows joint and link names."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

import ik
from kr210_sim.arrays import Array
from kr210_sim.description import Description
from kr210_sim.exceptions import BadInput
from kr210_sim.resources import resource

TCP_LINK = "tcp"


class Chain(NamedTuple):
    """The six arm joints as `ik.from_chain` takes them, fixed joints folded in.

    Attributes:
        origins: (6, 4, 4) transform from the joint before, or the base, to each joint.
        axes: (6, 3) axis of each joint in its own frame.
        T_last_palm: (4, 4) the palm in the frame of joint 6.
    """

    origins: Array
    axes: Array
    T_last_palm: Array


@dataclass(frozen=True, kw_only=True)
class Robot:
    """A six-axis arm with a two-finger gripper, read off a URDF tree.

    All arrays over arm joints have shape (6,), in chain order, and are read-only.

    Attributes:
        path: the description it was read from.
        root: root link; it stands at the scene's `robot_base` site and is the base frame.
        arm_joints: names of the six revolute joints, base to tip.
        fingers: names of the two finger links, right (-y side of the palm) first.
        finger_joint: the driven finger joint; the other finger mimics it.
        mimic_joint: the finger joint that follows.
        palm: link that carries the fingers; its frame is what the IK solves for.
        lower, upper: joint limits [rad].
        velocity: joint velocity limits [rad/s].
        effort: joint effort limits [N m].
        chain: the arm's joints, base frame to palm frame.
        geometry: the arm as `ik` solves it.
        T_palm_tcp: (4, 4), the TCP in the palm frame.
        finger_open, finger_closed: limits of the driven finger joint [m], positive closing.
        finger_velocity: its velocity limit [m/s].
        grip_force: its effort limit [N]; the mimic coupling gives each finger half of it.
    """

    path: Path
    root: str
    arm_joints: tuple[str, ...]
    fingers: tuple[str, str]
    finger_joint: str
    mimic_joint: str
    palm: str
    lower: Array
    upper: Array
    velocity: Array
    effort: Array
    chain: Chain
    geometry: ik.Arm
    T_palm_tcp: Array
    finger_open: float
    finger_closed: float
    finger_velocity: float
    grip_force: float

    @property
    def max_payload(self) -> float:
        """Largest target mass [kg] that the pads hold: 15 N of pad force per kg and finger."""
        return self.grip_force / 2.0 / 15.0

    def tcp_to_palm(self, T_base_tcp: Array) -> Array:
        """Return the palm poses (..., 4, 4) that put the TCP at `T_base_tcp` (..., 4, 4)."""
        return T_base_tcp @ np.linalg.inv(self.T_palm_tcp)

    def forward(self, q: Array) -> Array:
        """Return T_base_tcp (..., 4, 4) at arm configurations q (..., 6) [rad]."""
        return ik.forward(self.geometry, q) @ self.T_palm_tcp


def bundled_robot() -> Path:
    """Return the description of the bundled KR210."""
    return resource("assets", "kr210", "kr210.urdf.xacro")


def find_robot(description: Description) -> Robot:
    """Find arm, gripper and TCP in the link tree.

    The arm is the chain of revolute joints from the root to the palm; the palm is the parent of the
    two opposed prismatic joints; the TCP is the link named "tcp" fixed to the palm.

    Raises:
        BadInput: if the tree does not hold exactly that, naming what is missing.
    """
    robot = description.model.robot
    where = str(description.path)
    parent_joint = {joint.child: joint for joint in robot.joints}
    driven, mimic = _finger_joints(where, robot.joints)
    palm = driven.parent
    chain = _chain_to(palm, parent_joint)
    arm = [joint for joint in chain if joint.type != "fixed"]
    if len(arm) != 6 or any(joint.type != "revolute" for joint in arm):
        found = ", ".join(f"{joint.name} ({joint.type})" for joint in arm) or "none"
        raise BadInput(
            f"{where}: between root and '{palm}' an arm of six revolute joints with limits is "
            f"needed; found {found}"
        )
    tcp = parent_joint.get(TCP_LINK)
    if tcp is None or tcp.parent != palm or tcp.type != "fixed":
        raise BadInput(
            f"{where}: link '{TCP_LINK}' is missing; fix one to '{palm}' on the axis of a grasped "
            "cylinder, +x along the approach"
        )
    folded = _fold(chain)
    right, left = sorted((driven, mimic), key=lambda joint: float(_origin(joint)[1, 3]))
    return Robot(
        path=description.path,
        root=chain[0].parent if chain else palm,
        arm_joints=tuple(joint.name for joint in arm),
        fingers=(right.child, left.child),
        finger_joint=driven.name,
        mimic_joint=mimic.name,
        palm=palm,
        lower=_limits(arm, "lower"),
        upper=_limits(arm, "upper"),
        velocity=_limits(arm, "velocity"),
        effort=_limits(arm, "effort"),
        chain=folded,
        geometry=_geometry(where, folded),
        T_palm_tcp=_origin(tcp),
        finger_open=float(driven.limit.lower),
        finger_closed=float(driven.limit.upper),
        finger_velocity=float(driven.limit.velocity),
        grip_force=float(driven.limit.effort),
    )


def _finger_joints(where: str, joints: list[Any]) -> tuple[Any, Any]:
    """Return the driven finger joint and the one that mimics it."""
    prismatic = [joint for joint in joints if joint.type == "prismatic"]
    if len(prismatic) != 2 or len({joint.parent for joint in prismatic}) != 1:
        raise BadInput(
            f"{where}: found {len(prismatic)} prismatic joints; a gripper needs two opposed "
            "prismatic finger joints on one palm link"
        )
    driven, mimic = sorted(prismatic, key=lambda joint: joint.mimic is not None)
    if driven.mimic is not None or mimic.mimic is None or mimic.mimic.joint != driven.name:
        raise BadInput(
            f"{where}: exactly one finger joint must carry <mimic> of the other, as the jaws of a "
            "parallel gripper are coupled"
        )
    return driven, mimic


def _chain_to(link: str, parent_joint: dict[str, Any]) -> list[Any]:
    chain: list[Any] = []
    while link in parent_joint:
        chain.append(parent_joint[link])
        link = parent_joint[link].parent
    return chain[::-1]


def _origin(joint: Any) -> Array:
    return np.eye(4) if joint.origin is None else np.array(joint.origin, dtype=float)


def _limits(joints: list[Any], field: str) -> Array:
    values = np.array([float(getattr(joint.limit, field)) for joint in joints])
    values.flags.writeable = False
    return values


def _fold(chain: list[Any]) -> Chain:
    """Fold the fixed joints into the origins of the moving ones."""
    origins, axes = [], []
    pending = np.eye(4)
    for joint in chain:
        pending = pending @ _origin(joint)
        if joint.type == "fixed":
            continue
        origins.append(pending)
        axes.append(np.array(joint.axis, dtype=float))
        pending = np.eye(4)
    return Chain(np.array(origins), np.array(axes), pending)


def _geometry(where: str, chain: Chain) -> ik.Arm:
    try:
        return ik.from_chain(chain.origins, chain.axes, chain.T_last_palm)
    except ValueError as error:
        raise BadInput(f"{where}: the arm has no closed-form IK here: {error}") from error
