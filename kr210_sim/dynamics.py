"""Gravity torque and reflected inertia of an arm, from the inertials of its description."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

import ik
from kr210_sim.arrays import Array
from kr210_sim.gripper import chain_to, joint_origin
from kr210_sim.robot import Robot

GRAVITY = 9.81  # [m/s^2], along -z of the base frame


@dataclass(frozen=True, kw_only=True)
class ArmLoad:
    """What each arm joint carries over a set of configurations; arrays of shape (N, 6).

    Attributes:
        gravity: torque that holds the links and a load still [N m].
        inertia: of everything beyond the joint, about its axis, other joints locked [kg m^2].
    """

    gravity: Array
    inertia: Array


def arm_load(model: Any, robot: Robot, q: Array, *, load: float = 0.0) -> ArmLoad:
    """Return gravity torques and reflected inertias of an arm, the gripper as at 0.

    The links beyond joint i are a rigid body while it turns alone, so with c and I of each link's
    inertial in the base frame, r = c - p_i from a point of axis z_i:

        tau_i = -z_i . sum r x (m g),    M_i = sum z_i . I z_i + m |z_i x r|^2

    Args:
        model: `yourdfpy.URDF` of the robot.
        robot: its arm.
        q: (N, 6) configurations [rad].
        load: point mass at the TCP [kg].
    """
    frames = np.asarray(ik.chain_frames(robot.chain.origins, robot.chain.axes, q))
    gravity, inertia = np.zeros((2, len(q), 6))
    for group, mass, centre, tensor in _bodies(model, robot, load):
        T = frames[:, group]
        p = T[:, :3, 3] + T[:, :3, :3] @ centre
        tensor_base = T[:, :3, :3] @ tensor @ np.swapaxes(T[:, :3, :3], 1, 2)
        for joint in range(group + 1):
            z = frames[:, joint, :3, :3] @ robot.chain.axes[joint]
            lever = np.cross(z, p - frames[:, joint, :3, 3])
            gravity[:, joint] += mass * GRAVITY * lever[:, 2]
            inertia[:, joint] += np.einsum("ni,nij,nj->n", z, tensor_base, z)
            inertia[:, joint] += mass * np.sum(lever**2, axis=1)
    return ArmLoad(gravity=gravity, inertia=inertia)


def _bodies(model: Any, robot: Robot, load: float) -> list[tuple[int, float, Array, Array]]:
    """Return arm joint, mass, centre (3,) and inertia (3, 3) in that joint's frame, per link."""
    joints = model.robot.joints
    bodies = []
    for link in model.robot.links:
        chain = chain_to(link.name, joints)
        arm = [i for i, joint in enumerate(chain) if joint.name in robot.arm_joints]
        if link.inertial is None or not arm:
            continue
        T = np.eye(4)
        for joint in chain[arm[-1] + 1 :]:
            T = T @ joint_origin(joint)
        origin = link.inertial.origin
        T = T if origin is None else T @ origin
        tensor = T[:3, :3] @ link.inertial.inertia @ T[:3, :3].T
        bodies.append((len(arm) - 1, float(link.inertial.mass), T[:3, 3], tensor))
    if load:
        T_last_tcp = robot.chain.T_last_palm @ robot.T_palm_tcp
        bodies.append((5, load, T_last_tcp[:3, 3], np.zeros((3, 3))))
    return bodies
