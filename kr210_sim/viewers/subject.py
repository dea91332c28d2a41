"""What `view` is to show: a robot alone, a scene with a robot in it, or a run."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import mujoco
import numpy as np

from kr210_sim.arrays import Array
from kr210_sim.exceptions import BadInput
from kr210_sim.loading import load_robot
from kr210_sim.robot import Robot
from kr210_sim.scene import ROBOT_PREFIX, build_scene, find_scene, list_scenes
from kr210_sim.source import RobotSource
from kr210_sim.viewers.puppet import Puppet, View

_FLOOR_RGBA = (0.67, 0.68, 0.70, 1.0)

_ASIDE = (-0.45, -0.80, 0.30)
"""Direction in which the camera of a model without cameras stands."""

_AWAY = 1.6
"""How far it stands, in extents of the model."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Subject:
    """A model with a robot in it.

    Attributes:
        title: for people.
        model: as it is compiled.
        robot: what stands in it.
        prefix: before the robot's names.
        T_world_base: (4, 4) where it stands.
        notes: what was changed or guessed on the way.
    """

    title: str
    model: mujoco.MjModel
    robot: Robot
    prefix: str
    T_world_base: Array
    notes: tuple[str, ...]

    def first_view(self) -> View:
        """Return the view to begin with: the scene's first camera, else one from aside."""
        views = Puppet(self.model).views()
        if views:
            return next(iter(views.values()))
        center, extent = np.array(self.model.stat.center), float(self.model.stat.extent)
        aside = np.array(_ASIDE) / np.linalg.norm(_ASIDE)
        return View(
            position=center + _AWAY * extent * aside,
            look_at=center,
            fovy=float(np.radians(self.model.vis.global_.fovy)),
        )


def load_subject(name: str | None, source: RobotSource) -> Subject:
    """Load a robot or a scene.

    Args:
        name: a .xacro or .urdf, a bundled scene, the path of a scene, or None for the robot of
            `source` alone.
        source: the robot of a scene, and how any robot is to be read.

    Raises:
        BadInput: if it is none of them, or cannot be read.
    """
    if name is not None and Path(name).suffix.lower() in (".xacro", ".urdf"):
        if source.path is not None:
            raise BadInput(f"--robot: '{name}' is a robot already; give a scene or leave it out")
        source, name = replace(source, path=Path(name)), None
    loaded = load_robot(source)
    if name is None:
        return Subject(
            title=loaded.spec.modelname or loaded.robot.path.name,
            model=_on_a_floor(loaded.spec),
            robot=loaded.robot,
            prefix="",
            T_world_base=np.eye(4),
            notes=loaded.notes,
        )
    try:
        path = find_scene(name)
    except BadInput as error:
        known = ", ".join(list_scenes())
        raise BadInput(
            f"view: '{name}' is no robot (.xacro, .urdf), scene or run; bundled scenes: {known}"
        ) from error
    scene = build_scene(path, loaded.robot, loaded.spec)
    return Subject(
        title=scene.name,
        model=scene.spec.compile(),
        robot=scene.robot,
        prefix=ROBOT_PREFIX,
        T_world_base=scene.T_world_base,
        notes=(*loaded.notes, *scene.notes),
    )


def _on_a_floor(robot_spec: mujoco.MjSpec) -> mujoco.MjModel:
    spec = robot_spec.copy()
    spec.worldbody.add_geom(
        type=mujoco.mjtGeom.mjGEOM_PLANE, size=[0, 0, 0.05], rgba=_FLOOR_RGBA, group=0
    )
    return spec.compile()
