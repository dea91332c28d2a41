"""Configurations -> what MuJoCo finds near what, on a copy of the world that is made for asking."""

from __future__ import annotations

from itertools import product
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from kr210_sim import pairs
from kr210_sim.arrays import Array
from kr210_sim.distances import GeomPairs
from kr210_sim.pairs import BASE, FIXED, FIXTURE, GROUPS, HAND, NEAR, NEAR_SELF, Seen
from kr210_sim.scene import ROBOT_PREFIX, Scene, Target
from kr210_sim.simulation import Simulation

_CORNERS = np.array(list(product((-1.0, 1.0), repeat=3)))


class Eyes:
    """Sees what is near the arm, gripper and target at any configuration.

    It works on the state of the world at the moment it is made.

    Attributes:
        looks: number of configurations looked at so far.
        calls: number of times `see` was called.
    """

    def __init__(self, simulation: Simulation, scene: Scene, target: Target) -> None:
        robot = scene.robot
        self._model = model = simulation.model
        self._data = mujoco.MjData(model)
        self._data.qpos[:] = simulation.data.qpos
        self._data.qpos[simulation.addresses.fingers] = robot.open_positions
        self._arm = simulation.addresses.arm
        self._joints = np.array([model.joint(ROBOT_PREFIX + n).id for n in robot.arm_joints])
        root = simulation.body_id(robot.root)
        self._links = np.array([root, *model.jnt_bodyid[self._joints]])
        self._tcp = int(model.site(ROBOT_PREFIX + "tcp").id)
        first = int(model.joint(target.name).qposadr[0])
        self._target = self._data.qpos[first : first + 7]
        T = scene.T_world_base @ target.T_base_target
        self._standing = np.empty(7)
        _write_pose(self._standing, T[:3, 3], T[:3, :3].ravel())
        self._role = _roles(simulation, scene, target)
        self._group = _groups(model, self._links)
        mujoco.mj_kinematics(model, self._data)
        # What may be held is a part of its own.
        part = np.where(self._role == pairs.TARGET, GROUPS, self._group)
        far = np.full((GROUPS + 1, GROUPS + 1), NEAR)
        far[BASE:GROUPS, BASE:GROUPS] = NEAR_SELF
        self._pairs = GeomPairs(model, self._data, part, far)
        sorts = (self._role * GROUPS + self._group)[self._pairs.geoms]
        self._kind, self._pair = (table[:, *sorts.T] for table in pairs.tables())
        # Of hand or target and what is fixed, the one that may be carried.
        group = np.where(self._role == pairs.TARGET, HAND, self._group)[self._pairs.geoms]
        second = np.argmax(group, axis=1)
        self._mover = self._pairs.geoms[np.arange(len(group)), second]
        self._sign = 1.0 - 2.0 * second[:, None]
        # By whether the target is held; it belongs to the hand then, all else is as before.
        self._centers, self._radii = np.zeros((2, HAND, 3)), np.zeros((2, HAND))
        for index in range(HAND):
            self._centers[:, index], self._radii[:, index] = self._ball(index, held=False)
        self._centers[1, -1], self._radii[1, -1] = self._ball(HAND - 1, held=True)
        self.looks = self.calls = 0

    def see(self, q: Array, hands: NDArray[np.int64], required: Array) -> Seen:
        """Return what is near at some configurations.

        Args:
            q: (B, 6) [rad].
            hands: (B,) what the gripper and the target do, by `pairs.HANDS`.
            required: (B, 3) of each kind of pairs: distances are exact that are not far above [m].
        """
        self.looks += len(q)
        self.calls += 1
        data, held = self._data, pairs.HELD[hands]
        fields = (
            data.xpos, data.xmat, data.xanchor, data.xaxis, data.geom_xpos, data.geom_xmat
        )  # fmt: skip
        copies = [np.empty((len(q), *field.shape)) for field in fields]
        for index, row in enumerate(q):
            data.qpos[self._arm] = row
            self._pose(bool(held[index]))
            for copied, field in zip(copies, fields, strict=True):
                copied[index] = field
        position, rotation, anchor, axis, *poses = copies
        position = position[:, self._links]
        rotation = rotation[:, self._links].reshape(-1, 7, 3, 3)
        centers = position + (rotation @ self._centers[held.astype(int)][..., None])[..., 0]
        return Seen(
            **self._found(hands, required, poses),
            centers=centers,
            radii=self._radii[held.astype(int)],
            anchor=anchor[:, self._joints],
            axis=axis[:, self._joints],
        )

    def name(self, geom: int) -> str:
        """Return the name of the body that a geom belongs to."""
        return str(self._model.body(int(self._model.geom_bodyid[geom])).name or "world")

    def _found(
        self, hands: NDArray[np.int64], required: Array, poses: list[Array]
    ) -> dict[str, NDArray[Any]]:
        """Return row, geoms, kind, pair and distance of what is near.

        Args:
            hands: as for `see`.
            required: as for `see`.
            poses: (B, ngeom, 3), (B, ngeom, 9) of the geoms.
        """
        bounds = self._pairs.bounds(*poses)
        kind = self._kind[hands[bounds[0]], bounds[1]]
        counts = kind != pairs.IGNORED
        row, pair, distance, direction = (x[counts] for x in bounds)
        kind = kind[counts]
        self._pairs.sharpen(
            (row, pair, distance, direction), required[row, kind], self._data, poses
        )
        mover = self._mover[pair]
        return {
            "row": row,
            "geoms": self._pairs.geoms[pair],
            "kind": kind,
            "pair": self._pair[hands[row], pair],
            "distance": distance,
            "direction": self._sign[pair] * direction,
            "spot": poses[0][row, mover],
            "size": self._model.geom_rbound[mover],
        }

    def _pose(self, held: bool) -> None:
        """Compute where everything is, the target in the hand or where it stands."""
        model, data = self._model, self._data
        if not held:
            self._target[:] = self._standing
        mujoco.mj_kinematics(model, data)
        if held:
            # The pick options all put the TCP on the target's centre, z along its axis.
            _write_pose(self._target, data.site_xpos[self._tcp], data.site_xmat[self._tcp])
            mujoco.mj_kinematics(model, data)

    def _ball(self, index: int, *, held: bool) -> tuple[Array, float]:
        """Return a ball around the boxes around the geoms of a group: center (3,), radius [m].

        Args:
            index: of the link (7,) that carries the group; the center is in its frame.
            held: whether the target is in the hand.
        """
        model, data, link = self._model, self._data, self._links[index]
        group = np.where(self._role == pairs.TARGET, HAND if held else FIXED, self._group)
        solid = (model.geom_contype != 0) | (model.geom_conaffinity != 0)
        geoms = np.flatnonzero(solid & (group == BASE + index))
        if not len(geoms):
            return np.zeros(3), 0.0
        self._pose(held)
        middle, half = model.geom_aabb[geoms, :3], model.geom_aabb[geoms, 3:]
        corners = middle[:, None] + half[:, None] * _CORNERS
        rotation = data.geom_xmat[geoms].reshape(-1, 1, 3, 3)
        corners = (rotation @ corners[..., None])[..., 0] + data.geom_xpos[geoms][:, None]
        corners = (corners.reshape(-1, 3) - data.xpos[link]) @ data.xmat[link].reshape(3, 3)
        center = (np.min(corners, axis=0) + np.max(corners, axis=0)) / 2
        return center, float(np.sqrt(np.max(np.sum((corners - center) ** 2, axis=1))))


def _write_pose(qpos: Array, position: Array, rotation: Array) -> None:
    """Write a pose into the part (7,) of `qpos` of a free joint; rotation (9,) row by row."""
    qpos[:3] = position
    mujoco.mju_mat2Quat(qpos[3:], rotation)


def _roles(simulation: Simulation, scene: Scene, target: Target) -> NDArray[np.int64]:
    """Return the role of each geom."""
    model = simulation.model
    body_role = np.full(model.nbody, FIXTURE)
    body_role[simulation.body_id(scene.robot.root)] = pairs.ROBOT
    body_role[[simulation.body_id(name) for name in scene.robot.fingers]] = pairs.FINGER
    for body in range(1, model.nbody):  # parents come first
        body_role[body] = max(body_role[body], body_role[model.body_parentid[body]])
    body_role[model.body(target.name).id] = pairs.TARGET
    role = body_role[model.geom_bodyid]
    role[model.geom(scene.cell(target.cell).support).id] = pairs.SUPPORT
    return np.asarray(role)


def _groups(model: mujoco.MjModel, links: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return the group of each geom from the base link and the links of the arm joints (7,)."""
    group = np.full(model.nbody, FIXED)
    for body in range(1, model.nbody):
        group[body] = group[model.body_parentid[body]]
        if body in links:
            group[body] += 1
    return np.asarray(group[model.geom_bodyid])
