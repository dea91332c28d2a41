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
from kr210_sim.gripper import chain_to, coupling, find_gripper, find_tcp, joint_axis, joint_origin
from kr210_sim.resources import resource

ACCELERATION_TIME = 0.25
"""Time in which planned motions go from rest to the velocity limit [s]."""

MAX_GRIP = 500.0
"""Largest grip force [N], and what a gripper without a figure is given."""


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
        mimic_multiplier, mimic_offset: its position is multiplier * q + offset [m].
        palm: link that carries the fingers; its frame is what the IK solves for.
        lower, upper: joint limits [rad].
        velocity: joint velocity limits [rad/s].
        effort: joint effort limits [N m].
        chain: the arm's joints, base frame to palm frame.
        geometry: the arm as `ik` solves it.
        T_palm_tcp: (4, 4), the TCP in the palm frame.
        finger_open, finger_closed: positions of the driven finger joint [m] at its limits.
        finger_velocity: its velocity limit [m/s].
        grip_force: its effort limit [N]; the mimic coupling gives each finger half of it.
        notes: what was guessed or changed, for the report.
    """

    path: Path
    root: str
    arm_joints: tuple[str, ...]
    fingers: tuple[str, str]
    finger_joint: str
    mimic_joint: str
    mimic_multiplier: float
    mimic_offset: float
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
    notes: tuple[str, ...] = ()

    @property
    def open_positions(self) -> Array:
        """Positions (2,) of the driven and the following finger joint, gripper open [m]."""
        return self.finger_positions(self.finger_open)

    def finger_positions(self, driven: float) -> Array:
        """Return the positions (2,) of both finger joints [m] from that of the driven one."""
        return np.array([driven, self.mimic_multiplier * driven + self.mimic_offset])

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
    two opposed prismatic joints; the TCP is the link named "tcp" or, without one, midway between
    the fingers (`gripper.find_tcp`).

    Raises:
        BadInput: if the tree does not hold exactly that, naming what is missing.
    """
    robot = description.model.robot
    where = str(description.path)
    gripper = find_gripper(where, robot.joints)
    chain = chain_to(gripper.palm, robot.joints)
    arm = [joint for joint in chain if joint.type != "fixed"]
    if len(arm) != 6 or any(joint.type != "revolute" for joint in arm):
        found = ", ".join(f"{joint.name} ({joint.type})" for joint in arm) or "none"
        raise BadInput(
            f"{where}: between root and '{gripper.palm}' an arm of six revolute joints with limits "
            f"is needed; found {found}; --base, --tip and --joints say which it is"
        )
    folded = _fold(chain)
    geometry = _geometry(where, folded)
    T_palm_tcp, notes = find_tcp(where, robot, gripper, _hand_axis(folded), description.packages)
    multiplier, offset = coupling(gripper.mimic)
    grip_force, force_notes = _grip_force(gripper.driven)
    return Robot(
        path=description.path,
        root=chain[0].parent,
        arm_joints=tuple(joint.name for joint in arm),
        fingers=gripper.links,
        finger_joint=gripper.driven.name,
        mimic_joint=gripper.mimic.name,
        mimic_multiplier=multiplier,
        mimic_offset=offset,
        palm=gripper.palm,
        lower=_limits(arm, "lower"),
        upper=_limits(arm, "upper"),
        velocity=_limits(arm, "velocity"),
        effort=_limits(arm, "effort"),
        chain=folded,
        geometry=geometry,
        T_palm_tcp=T_palm_tcp,
        finger_open=gripper.open,
        finger_closed=gripper.closed,
        finger_velocity=float(gripper.driven.limit.velocity),
        grip_force=grip_force,
        notes=notes + force_notes,
    )


def _hand_axis(chain: Chain) -> Array:
    """Return the direction (3,) of axis 6 in the palm frame, away from the wrist center.

    Where the palm is at the wrist center, the direction in which the axis is positive.
    """
    axis = chain.axes[5] / np.linalg.norm(chain.axes[5])
    T_5_palm = chain.origins[5] @ chain.T_last_palm
    axis_in_5 = chain.origins[5][:3, :3] @ axis
    # The wrist center is where axes 5 and 6 meet: the point of axis 6 nearest to axis 5.
    axis_5 = chain.axes[4] / np.linalg.norm(chain.axes[4])
    p = chain.origins[5][:3, 3]
    across = np.cross(axis_5, np.cross(axis_5, axis_in_5))
    center = p - axis_in_5 * (across @ p) / (across @ axis_in_5)
    away = axis_in_5 @ (T_5_palm[:3, 3] - center)
    direction = axis_in_5 if away >= -1e-6 else -axis_in_5
    return np.asarray(T_5_palm[:3, :3].T @ direction)


def _grip_force(joint: Any) -> tuple[float, tuple[str, ...]]:
    """Return the grip force [N] of the driven finger and what was changed."""
    effort = float(joint.limit.effort)
    if 0 < effort <= MAX_GRIP:
        return effort, ()
    return MAX_GRIP, (
        f"joint '{joint.name}': effort {effort:g} N is replaced by a grip force of {MAX_GRIP:g} N",
    )


def _limits(joints: list[Any], field: str) -> Array:
    values = np.array([float(getattr(joint.limit, field)) for joint in joints])
    values.flags.writeable = False
    return values


def _fold(chain: list[Any]) -> Chain:
    """Fold the fixed joints into the origins of the moving ones."""
    origins, axes = [], []
    pending = np.eye(4)
    for joint in chain:
        pending = pending @ joint_origin(joint)
        if joint.type == "fixed":
            continue
        origins.append(pending)
        axes.append(joint_axis(joint))
        pending = np.eye(4)
    return Chain(np.array(origins), np.array(axes), pending)


def _geometry(where: str, chain: Chain) -> ik.Arm:
    try:
        return ik.from_chain(chain.origins, chain.axes, chain.T_last_palm)
    except ValueError as error:
        raise BadInput(f"{where}: the arm has no closed-form IK here: {error}") from error
