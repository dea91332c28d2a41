"""One configuration of an arm -> its frames, its tool poses and all eight branches, as numbers."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

import ik
from kr210_sim.arrays import Array
from kr210_sim.kinematics import solve_report
from kr210_sim.robot import Robot


@dataclass(frozen=True, kw_only=True, eq=False)
class Branch:
    """One of the eight answers of the inverse kinematics to the pose of the palm.

    Attributes:
        name: shoulder, elbow and wrist, e.g. "front up +".
        q: (6,) [rad], or None where the branch does not exist.
        within_limits: whether some turn of it is inside the joint limits.
        current: whether this is the branch the arm is in.
    """

    name: str
    q: Array | None
    within_limits: bool
    current: bool


@dataclass(frozen=True, kw_only=True, eq=False)
class ArmState:
    """Where an arm is; all frames are in the base frame.

    Attributes:
        q: (6,) [rad].
        T_base_tcp, T_base_palm: (4, 4).
        p_base_wrist_center: (3,) [m].
        T_base_dh: (n + 1, 4, 4) the frames 0 to n of the modified DH table.
        branches: eight, in the fixed order of `ik.inverse`.
    """

    q: Array
    T_base_tcp: Array
    T_base_palm: Array
    p_base_wrist_center: Array
    T_base_dh: Array
    branches: tuple[Branch, ...]


_SAME = 1e-6
"""Angles closer than this, whole turns apart, are the same [rad]."""


def arm_state(robot: Robot, q: Array) -> ArmState:
    """Return everything about a configuration q (6,) [rad]."""
    T_base_palm = ik.forward(robot.geometry, q)
    report = solve_report(robot, T_base_palm)
    return ArmState(
        q=np.array(q),
        T_base_tcp=robot.forward(q),
        T_base_palm=T_base_palm,
        p_base_wrist_center=np.array(report["wrist_center_m"]),
        T_base_dh=_dh_frames(robot, q),
        branches=tuple(_branch(found, q) for found in report["branches"]),
    )


def nearest_solution(robot: Robot, T_base_palm: Array, q: Array) -> Array | None:
    """Return the configuration (6,) within limits that reaches a pose and is nearest to q.

    None if there is none.
    """
    answers = ik.inverse(robot.geometry, T_base_palm).q
    best = ik.nearest(answers, q, robot.lower, robot.upper, velocity=robot.velocity)
    return None if np.isnan(best).any() else best


def _dh_frames(robot: Robot, q: Array) -> Array:
    chain = robot.chain
    table = ik.dh_from_chain(chain.origins, chain.axes, chain.T_last_palm)
    frames = [table.T_base]
    for step in table.transforms(q):
        frames.append(frames[-1] @ step)
    return np.array(frames)


def _branch(found: dict[str, Any], q: Array) -> Branch:
    name = f"{found['shoulder']} {found['elbow']} {found['wrist']}"
    if not found["exists"]:
        return Branch(name=name, q=None, within_limits=False, current=False)
    answer = np.array(found["q_rad"])
    apart = np.abs(np.remainder(answer - q + np.pi, 2 * np.pi) - np.pi)
    return Branch(
        name=name,
        q=answer,
        within_limits=found["configurations_within_limits"] > 0,
        current=bool(np.max(apart) < _SAME),
    )
