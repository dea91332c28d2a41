"""Proof that a model is its description: frames, inertials, limits and bounds, link by link."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np

from kr210_sim.arrays import Array
from kr210_sim.description import Description
from kr210_sim.meshes import is_convex, load_mesh
from kr210_sim.robot import Robot
from kr210_sim.shapes import shape_points

TOLERANCE = 1e-9
"""Of frames [m and matrix entries], masses, centres of mass, inertias and limits (relative)."""

BOUNDS_TOLERANCE = 2e-6
"""Of the bounds of shapes [m]: MuJoCo keeps the vertices of meshes in single precision."""

SPLIT_TOLERANCE = 0.05
"""Of the bounds of a concave collision mesh that was split, as share of its diagonal."""

CONFIGURATIONS = 100


@dataclass(frozen=True, kw_only=True)
class Finding:
    """One kind of comparison over all links or joints.

    Attributes:
        what: what was compared.
        count: how many links or joints.
        worst: largest difference, over its tolerance.
        where: link or joint of the largest difference.
        difference: the largest difference itself.
    """

    what: str
    count: int
    worst: float
    where: str
    difference: float

    @property
    def passed(self) -> bool:
        """Whether every difference is within its tolerance."""
        return self.worst <= 1.0


def check_parity(
    description: Description, robot: Robot, model: mujoco.MjModel
) -> tuple[Finding, ...]:
    """Compare a compiled robot with its description, for every link and joint.

    Frames are compared with yourdfpy's forward kinematics at random configurations.

    Args:
        description: of the arm and its gripper, repaired.
        robot: what the arm is; its efforts may be replaced ones.
        model: the robot alone, in memory or loaded from disk.
    """
    return (
        _frames(description, robot, model),
        *_inertials(description, model),
        *_limits(description, robot, model),
        _bounds("visual bounds", description, model, visual=True),
        _bounds("collision bounds", description, model, visual=False),
    )


def parity_text(findings: tuple[Finding, ...]) -> str:
    """Return the findings as a table."""
    lines = [f"{'parity':<18}{'count':>6}{'largest difference':>20}  at"]
    for item in findings:
        verdict = "" if item.passed else "  FAILED"
        lines.append(
            f"{item.what:<18}{item.count:>6}{item.difference:>20.1e}  {item.where}{verdict}"
        )
    return "\n".join(lines)


class _Worst:
    """The largest of many differences, each over its own tolerance."""

    def __init__(self, what: str) -> None:
        self._what = what
        self._worst, self._where, self._difference = 0.0, "-", 0.0
        self._names: set[str] = set()

    def add(self, name: str, difference: float, tolerance: float = TOLERANCE) -> None:
        self._names.add(name)
        share = difference / tolerance
        if not share <= self._worst:  # NaN counts as larger
            self._worst, self._where, self._difference = share, name, difference

    def finding(self) -> Finding:
        return Finding(
            what=self._what,
            count=len(self._names),
            worst=self._worst,
            where=self._where,
            difference=self._difference,
        )


def _frames(description: Description, robot: Robot, model: mujoco.MjModel) -> Finding:
    worst, data, urdf = _Worst("frames"), mujoco.MjData(model), description.model
    rng = np.random.default_rng(0)
    fingers = (robot.finger_joint, robot.mimic_joint)
    for _ in range(CONFIGURATIONS):
        narrow, wide = sorted((robot.finger_open, robot.finger_closed))
        opening = float(rng.uniform(narrow, wide))
        q = dict(zip(robot.arm_joints, rng.uniform(robot.lower, robot.upper), strict=True))
        q |= dict(zip(fingers, robot.finger_positions(opening), strict=True))
        for name, value in q.items():
            data.qpos[model.joint(name).qposadr[0]] = value
        mujoco.mj_kinematics(model, data)
        urdf.update_cfg(q)
        for link in urdf.robot.links:
            T, body = urdf.get_transform(link.name, robot.root), data.body(link.name)
            off = max(
                float(np.max(np.abs(body.xpos - T[:3, 3]))),
                float(np.max(np.abs(body.xmat.reshape(3, 3) - T[:3, :3]))),
            )
            worst.add(link.name, off)
    return worst.finding()


def _inertials(description: Description, model: mujoco.MjModel) -> tuple[Finding, ...]:
    masses, centres, inertias = _Worst("masses"), _Worst("centres of mass"), _Worst("inertias")
    for link in description.model.robot.links:
        body = model.body(link.name)
        if link.inertial is None:
            masses.add(link.name, float(body.mass[0]))
            continue
        T = np.eye(4) if link.inertial.origin is None else link.inertial.origin
        rotation = np.empty(9)
        mujoco.mju_quat2Mat(rotation, body.iquat)
        axes = rotation.reshape(3, 3)
        expected = T[:3, :3] @ link.inertial.inertia @ T[:3, :3].T
        off = np.max(np.abs(axes @ np.diag(body.inertia) @ axes.T - expected))
        masses.add(link.name, abs(float(body.mass[0]) / link.inertial.mass - 1))
        centres.add(link.name, float(np.max(np.abs(body.ipos - T[:3, 3]))))
        inertias.add(link.name, float(off / np.max(np.abs(expected))))
    return masses.finding(), centres.finding(), inertias.finding()


def _limits(description: Description, robot: Robot, model: mujoco.MjModel) -> tuple[Finding, ...]:
    ranges, efforts, speeds = _Worst("joint ranges"), _Worst("effort limits"), _Worst("velocities")
    joints = {joint.name: joint for joint in description.model.robot.joints}
    kept = model.numeric("joint_velocity_limit").data
    for index, name in enumerate(robot.arm_joints):
        speeds.add(name, abs(float(kept[index]) / float(joints[name].limit.velocity) - 1))
    rated = dict(zip(robot.arm_joints, robot.effort.tolist(), strict=True))
    rated |= dict.fromkeys((robot.finger_joint, robot.mimic_joint), robot.grip_force)
    for name, effort in rated.items():
        limit, index = joints[name].limit, model.joint(name).id
        off = np.abs(model.jnt_range[index] - [limit.lower, limit.upper])
        ranges.add(name, float(np.max(off)))
        efforts.add(name, abs(float(model.jnt_actfrcrange[index, 1]) / effort - 1))
    return ranges.finding(), efforts.finding(), speeds.finding()


def _bounds(what: str, description: Description, model: mujoco.MjModel, *, visual: bool) -> Finding:
    worst = _Worst(what)
    for link in description.model.robot.links:
        elements = link.visuals if visual else link.collisions
        expected = shape_points(elements, description.packages) if elements else np.empty((0, 3))
        found = _model_points(model, link.name, visual=visual)
        if not len(expected) and (visual or not len(found)):
            continue  # nothing to see, or drawn by its collision shapes
        if not len(found):
            worst.add(link.name, np.inf)
            continue
        off = max(
            float(np.max(np.abs(bound(expected, axis=0) - bound(found, axis=0))))
            for bound in _BOUNDS
        )
        split = not visual and not all(_kept_whole(item, description) for item in elements)
        diagonal = float(np.linalg.norm(np.ptp(expected, axis=0)))
        worst.add(link.name, off, SPLIT_TOLERANCE * diagonal if split else BOUNDS_TOLERANCE)
    return worst.finding()


_BOUNDS: tuple[Callable[..., Array], ...] = (np.min, np.max)


def _kept_whole(element: Any, description: Description) -> bool:
    mesh = element.geometry.mesh
    if mesh is None:
        return True
    where = description.path.name
    path = description.packages.resolve(mesh.filename, where=where)
    return is_convex(load_mesh(path, mesh.scale, where=where))


def _model_points(model: mujoco.MjModel, link: str, *, visual: bool) -> Array:
    """Return points (n, 3) that bound the shapes of a body, in its frame."""
    found = [np.empty((0, 3))]
    body = model.body(link).id
    corners = np.array(np.meshgrid(*[[-1.0, 1.0]] * 3)).reshape(3, -1).T
    for index in np.flatnonzero(model.geom_bodyid == body):
        if (model.geom_contype[index] == 0) != visual:
            continue
        size, kind = model.geom_size[index], model.geom_type[index]
        if kind == mujoco.mjtGeom.mjGEOM_MESH:
            mesh = model.geom_dataid[index]
            first = model.mesh_vertadr[mesh]
            points = model.mesh_vert[first : first + model.mesh_vertnum[mesh]].astype(float)
        elif kind == mujoco.mjtGeom.mjGEOM_CYLINDER:
            points = corners * [size[0], size[0], size[1]]
        elif kind == mujoco.mjtGeom.mjGEOM_SPHERE:
            points = corners * size[0]
        else:
            points = corners * size
        rotation = np.empty(9)
        mujoco.mju_quat2Mat(rotation, model.geom_quat[index])
        found.append(points @ rotation.reshape(3, 3).T + model.geom_pos[index])
    return np.concatenate(found)
