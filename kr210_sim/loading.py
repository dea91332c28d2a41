"""A robot file and what is said about it -> robot and MJCF: the whole way in, notes collected."""

from __future__ import annotations

from dataclasses import dataclass

import mujoco

from kr210_sim.arm import isolate_arm
from kr210_sim.description import Description, load_description
from kr210_sim.effort import rate_efforts
from kr210_sim.mjcf import build_robot
from kr210_sim.packages import Packages
from kr210_sim.robot import Robot, bundled_robot, find_robot
from kr210_sim.source import RobotSource


@dataclass(frozen=True, kw_only=True)
class RobotModel:
    """A robot ready to stand in a scene.

    Attributes:
        description: of the arm and its gripper, repaired.
        robot: what the arm is.
        spec: its MJCF.
        notes: everything that was changed or guessed on the way, in order.
    """

    description: Description
    robot: Robot
    spec: mujoco.MjSpec
    notes: tuple[str, ...]


def read_robot(source: RobotSource) -> tuple[Description, Robot]:
    """Read a description and find its arm and gripper.

    Raises:
        BadInput: naming file, field and remedy.
    """
    path = source.path or bundled_robot()
    packages = Packages(path, source.packages)
    description = isolate_arm(load_description(path, packages, source.arguments), source.choice)
    return description, rate_efforts(description, find_robot(description))


def load_robot(source: RobotSource) -> RobotModel:
    """Read a robot and build its MJCF.

    Raises:
        BadInput: naming file, field and remedy.
    """
    description, robot = read_robot(source)
    spec, notes = build_robot(description, robot)
    return RobotModel(
        description=description,
        robot=robot,
        spec=spec,
        notes=(*description.notes, *robot.notes, *notes),
    )
