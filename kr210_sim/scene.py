"""A world in plain MJCF plus the robot plus targets: what is simulated, and what its names mean."""

from __future__ import annotations

import os
import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from kr210_sim.arrays import Array
from kr210_sim.exceptions import BadInput
from kr210_sim.mjcf import PAD_PRIORITY
from kr210_sim.physics import PLAIN_CONTACT, apply_physics
from kr210_sim.resources import resource
from kr210_sim.robot import Robot

ROBOT_PREFIX = "robot/"
DEFAULT_TIME_LIMIT = 60.0  # [s]
PRISM_SIDES = 32

_RESERVED = re.compile(r"robot/|measure/|prism_|target_\d+(_visual)?$|cycle_\d+$|scene_joint_")
"""Names that a run gives to robot, measurements, targets and keyframes."""

_TARGET_FRICTION = (1.0, 0.005, 0.002)
"""Sliding, torsional [m], rolling [m]: what lies on others rocks and rolls itself to rest."""

_OWN_FRICTION = PAD_PRIORITY - 1
"""Contact priority of a target whose friction is its own."""

_TARGET_COLOR = (0.13, 0.42, 0.78, 1.0)


@dataclass(frozen=True, kw_only=True)
class Cell:
    """A place a target stands on: `T_base_cell` (4, 4), +z up, +x the way the tool goes in.

    `support` names the geom under it, the only part of the shelf that its target may touch.
    """

    number: int
    T_base_cell: Array
    support: str


@dataclass(frozen=True, kw_only=True)
class PlaceVolume:
    """The volume in which a target's centre counts as placed, a box or an upright cylinder.

    Attributes:
        kind: "box" or "cylinder".
        T_base_place: (4, 4) pose of its centre.
        half_size: (3,) half extents [m]; a cylinder has its radius twice, then half its height.
    """

    kind: str
    T_base_place: Array
    half_size: Array

    def contains(self, p_base: Array) -> bool:
        """Tell whether a point (3,) in the base frame lies inside."""
        local = (p_base - self.T_base_place[:3, 3]) @ self.T_base_place[:3, :3]
        if self.kind == "cylinder":
            inside = np.hypot(local[0], local[1]) <= self.half_size[0]
            return bool(inside and abs(local[2]) <= self.half_size[2])
        return bool(np.all(np.abs(local) <= self.half_size))


@dataclass(frozen=True, kw_only=True)
class Target:
    """A cylinder to pick: its number in the episode, shape, mass and where it stands.

    Attributes:
        number: counts from 0 within the episode.
        cell: number of the cell it stands in.
        radius, length: [m].
        mass: [kg].
        T_base_target: (4, 4) start pose; origin in the middle, z along the axis.
        com: centre of mass above the middle, along the axis [m].
        friction: coefficient against all but the pads; None: 1, and a rougher partner's counts.
    """

    number: int
    cell: int
    mass: float
    T_base_target: Array
    radius: float = 0.05
    length: float = 0.25
    com: float = 0.0
    friction: float | None = None

    @property
    def name(self) -> str:
        """Body name in the model."""
        return f"target_{self.number}"


@dataclass(frozen=True, kw_only=True)
class Scene:
    """What the naming convention of a scene file says, beside the spec itself.

    Attributes:
        name: file stem.
        path: file it was read from.
        spec: world and robot, without targets; copied, never changed.
        robot: the robot standing at `robot_base`.
        T_world_base: (4, 4) pose of `robot_base`.
        cells: in order of their numbers.
        place: the place volume.
        time_limit: per cycle [s].
        cameras: names, in file order.
        notes: what a reader of the run should know, e.g. physics options that were overridden.
    """

    name: str
    path: Path
    spec: mujoco.MjSpec
    robot: Robot
    T_world_base: Array
    cells: tuple[Cell, ...]
    place: PlaceVolume
    time_limit: float
    cameras: tuple[str, ...]
    notes: tuple[str, ...]

    def cell(self, number: int) -> Cell:
        """Return a cell by its number."""
        return self.cells[number - 1]

    def stand_in_cell(self, number: int, length: float) -> Array:
        """Return T_base_target (4, 4) of a target of that length [m] standing in a cell."""
        T_base_target = self.cell(number).T_base_cell.copy()
        T_base_target[:3, 3] += T_base_target[:3, 2] * (length / 2)
        return T_base_target


def list_scenes() -> list[str]:
    """Return the names of the bundled scenes."""
    return sorted(path.stem for path in resource("scenes").glob("*.xml"))


def find_scene(name_or_path: str) -> Path:
    """Return the file of a bundled scene by name, or the path as given.

    Raises:
        BadInput: if there is neither.
    """
    if name_or_path in list_scenes():
        return resource("scenes", f"{name_or_path}.xml")
    path = Path(name_or_path)
    if os.path.isfile(path):  # Path.is_file raises for some impossible names
        return path
    known = ", ".join(list_scenes())
    raise BadInput(f"--scene: no scene or file '{name_or_path}'; bundled scenes: {known}")


def build_scene(path: Path, robot: Robot, robot_spec: mujoco.MjSpec) -> Scene:
    """Read a scene file, check it against the convention, and attach the robot.

    Args:
        path: plain MJCF without a robot.
        robot: what the robot is.
        robot_spec: its MJCF; a copy is attached at site `robot_base`.

    Raises:
        BadInput: if MuJoCo cannot read the file or the convention is broken, naming the element.
    """
    try:
        spec = mujoco.MjSpec.from_file(str(path))
        world = spec.compile()
    except (ValueError, mujoco.FatalError) as error:
        why = " ".join(str(error).split())
        raise BadInput(f"{path}: MuJoCo cannot read it ({why}); give an MJCF file") from error
    data = mujoco.MjData(world)
    mujoco.mj_kinematics(world, data)
    T_world_base = _site_pose(path, world, data, "robot_base")
    T_base_world = np.linalg.inv(T_world_base)
    if T_world_base[2, 2] < 1 - 1e-6:
        raise BadInput(f"{path}: site 'robot_base' is tilted; its +z axis must point up")
    _check_names(path, spec)
    for number, joint in enumerate(spec.joints):  # records and restarts go by name
        joint.name = joint.name or f"scene_joint_{number}"
    for body in ("shelf", "bin"):
        if mujoco.mj_name2id(world, mujoco.mjtObj.mjOBJ_BODY, body) < 0:
            raise BadInput(f"{path}: body '{body}' is missing; name the fixture's body so")
    _check_fixed(path, world)
    limit = mujoco.mj_name2id(world, mujoco.mjtObj.mjOBJ_NUMERIC, "time_limit")
    time_limit = DEFAULT_TIME_LIMIT if limit < 0 else float(world.numeric("time_limit").data[0])
    if not (np.isfinite(time_limit) and time_limit > 0):
        raise BadInput(f"{path}: numeric 'time_limit' is {time_limit}; give seconds above 0")
    cells = _cells(path, spec, world, data, T_base_world)
    place = _place(path, world, data, T_base_world)
    try:
        # before the robot comes, whose options would be reported as a conflict
        notes = apply_physics(spec)
        spec.attach(robot_spec.copy(), prefix=ROBOT_PREFIX, site=spec.site("robot_base"))
        spec.compile()
    except (ValueError, mujoco.FatalError) as error:
        reason = " ".join(str(error).split())
        raise BadInput(f"{path}: the robot cannot be attached: {reason}") from error
    return Scene(
        name=path.stem,
        path=path,
        spec=spec,
        robot=robot,
        T_world_base=T_world_base,
        cells=cells,
        place=place,
        time_limit=time_limit,
        cameras=tuple(world.camera(i).name for i in range(world.ncam)),
        notes=notes,
    )


def add_target(spec: mujoco.MjSpec, scene: Scene, target: Target) -> Any:
    """Add a target to a spec: free body, true cylinder inertia, 32-sided prism as contact shape.

    MuJoCo's cylinder geom reports false depths cap against side; the prism, with its edges on the
    cylinder, does not and settles better.

    A centre of mass off the middle is that of a density that grows evenly along the axis: about
    the middle the inertia stays that of an even density, about the centre of mass m com^2 less.
    """
    T_world_target = scene.T_world_base @ target.T_base_target
    quat_wxyz = np.empty(4)
    mujoco.mju_mat2Quat(quat_wxyz, np.ascontiguousarray(T_world_target[:3, :3]).ravel())
    body = spec.worldbody.add_body(
        name=target.name, pos=T_world_target[:3, 3], quat=quat_wxyz, explicitinertial=True
    )
    across = target.mass * ((3 * target.radius**2 + target.length**2) / 12 - target.com**2)
    body.mass = target.mass
    body.ipos = [0.0, 0.0, target.com]
    body.iquat = [1.0, 0.0, 0.0, 0.0]
    body.inertia = [across, across, target.mass * target.radius**2 / 2]
    body.add_freejoint(name=target.name)
    mesh = _prism(spec, target.radius, target.length)
    contact = dict(PLAIN_CONTACT)
    friction = _TARGET_FRICTION
    if target.friction is not None:  # or the rougher of two would count; pads have priority still
        contact["priority"] = _OWN_FRICTION
        friction = (target.friction, *_TARGET_FRICTION[1:])
    body.add_geom(
        name=target.name,
        type=mujoco.mjtGeom.mjGEOM_MESH,
        meshname=mesh,
        friction=friction,
        condim=6,
        group=3,
        **contact,
    )
    body.add_geom(
        name=f"{target.name}_visual",
        type=mujoco.mjtGeom.mjGEOM_CYLINDER,
        size=[target.radius, target.length / 2, 0],
        rgba=_TARGET_COLOR,
        contype=0,
        conaffinity=0,
        group=2,
        density=0.0,
    )
    return body


def _prism(spec: mujoco.MjSpec, radius: float, length: float) -> str:
    """Add, once per size, the prism mesh; return its name."""
    name = f"prism_{radius:.6f}_{length:.6f}"
    if all(mesh.name != name for mesh in spec.meshes):
        angle = 2 * np.pi * np.arange(PRISM_SIDES) / PRISM_SIDES
        ring = np.stack([radius * np.cos(angle), radius * np.sin(angle)], axis=1)
        ends = [np.column_stack([ring, np.full(PRISM_SIDES, z)]) for z in (-length / 2, length / 2)]
        spec.add_mesh(name=name, uservert=np.concatenate(ends).ravel(), scale=[1.0, 1.0, 1.0])
    return name


def _check_names(path: Path, spec: mujoco.MjSpec) -> None:
    """Refuse names that robot, targets, measurements and keyframes of a run will take."""
    kinds = ("body", "geom", "joint", "site", "mesh", "sensor", "key", "actuator", "material")
    plural = {"body": "bodies", "mesh": "meshes"}
    for kind in kinds:
        for element in getattr(spec, plural.get(kind, f"{kind}s")):
            if _RESERVED.match(element.name or ""):
                raise BadInput(f"{path}: {kind} '{element.name}' has a reserved name; rename it")


def _check_fixed(path: Path, world: mujoco.MjModel) -> None:
    """Refuse fixtures that could move: what their sites mean is read once."""
    bodies = {name: world.body(name).id for name in ("shelf", "bin")}
    for index in range(world.nsite):
        name = world.site(index).name
        if name in ("robot_base", "place") or name.startswith("cell_"):
            bodies[name] = world.site(index).bodyid[0]
    for name, body in bodies.items():
        if world.body_weldid[body] != 0:
            raise BadInput(f"{path}: '{name}' is on a body that can move; remove its joints")


def _pose(position: Array, rotation: Array) -> Array:
    T = np.eye(4)
    T[:3, 3] = position
    T[:3, :3] = np.asarray(rotation).reshape(3, 3)
    return T


def _site_pose(path: Path, model: mujoco.MjModel, data: mujoco.MjData, name: str) -> Array:
    if mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_SITE, name) < 0:
        raise BadInput(f"{path}: site '{name}' is missing; add it as the scene convention asks")
    site = data.site(name)
    return _pose(site.xpos, site.xmat)


def _cells(
    path: Path,
    spec: mujoco.MjSpec,
    model: mujoco.MjModel,
    data: mujoco.MjData,
    T_base_world: Array,
) -> tuple[Cell, ...]:
    names = [model.site(i).name for i in range(model.nsite)]
    found = [re.fullmatch(r"cell_(\d+)", name) for name in names]
    numbers = sorted(int(match[1]) for match in found if match)
    if not numbers or numbers != list(range(1, len(numbers) + 1)):
        raise BadInput(f"{path}: cell sites are {numbers}; number them cell_1 ... cell_N, no gaps")
    cells = []
    for number in numbers:
        T_world_cell = _site_pose(path, model, data, f"cell_{number}")
        if T_world_cell[2, 2] < 1 - 1e-6:
            raise BadInput(f"{path}: site 'cell_{number}' is tilted; its +z axis must point up")
        support = _support(path, spec, model, data, number, T_world_cell[:3, 3])
        T_base_cell = T_base_world @ T_world_cell
        cells.append(Cell(number=number, T_base_cell=T_base_cell, support=support))
    return tuple(cells)


def _support(
    path: Path,
    spec: mujoco.MjSpec,
    model: mujoco.MjModel,
    data: mujoco.MjData,
    number: int,
    p_world: Array,
) -> str:
    """Return the name of the geom right under a cell site, naming it if it has none."""
    height, geom = 0.01, np.full(1, -1, dtype=np.int32)
    start, down = np.array([*p_world[:2], p_world[2] + height]), np.array([0.0, 0.0, -1.0])
    while (distance := mujoco.mj_ray(model, data, start, down, None, True, -1, geom)) >= 0:
        start[2] -= distance + 1e-9
        if model.geom_contype[geom[0]] or model.geom_conaffinity[geom[0]]:
            break  # anything else is decoration, which supports nothing
    if geom[0] < 0 or abs(start[2] - p_world[2]) > 1e-3:
        raise BadInput(
            f"{path}: site 'cell_{number}' is not on a supporting surface; put it there within 1 mm"
        )
    support = next(element for element in spec.geoms if element.id == geom[0])
    support.name = support.name or f"cell_{number}_support"
    return str(support.name)


def _place(
    path: Path, model: mujoco.MjModel, data: mujoco.MjData, T_base_world: Array
) -> PlaceVolume:
    T_world_place = _site_pose(path, model, data, "place")
    shape, size = model.site("place").type[0], model.site("place").size
    if T_world_place[2, 2] < 1 - 1e-6:
        raise BadInput(f"{path}: site 'place' is tilted; its +z axis must point up")
    if not np.all(np.isfinite(size)) or np.any(size[:2] <= 0):
        raise BadInput(f"{path}: site 'place' has size {size}; give finite sizes above 0")
    if shape == mujoco.mjtGeom.mjGEOM_BOX:
        kind, half_size = "box", np.array(size)
    elif shape == mujoco.mjtGeom.mjGEOM_CYLINDER:
        kind, half_size = "cylinder", np.array([size[0], size[0], size[1]])
    else:
        raise BadInput(f"{path}: site 'place' must be of type box or cylinder")
    return PlaceVolume(kind=kind, T_base_place=T_base_world @ T_world_place, half_size=half_size)
