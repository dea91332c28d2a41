"""Configurations -> what MuJoCo finds near what, on a copy of the world that is made for asking."""

from __future__ import annotations

from itertools import product
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from kr210_sim import pairs
from kr210_sim.arrays import Array
from kr210_sim.chain import Chain
from kr210_sim.distances import GeomPairs
from kr210_sim.pairs import BASE, FIXED, FIXTURE, GROUPS, HAND, NEAR, NEAR_SELF, Seen
from kr210_sim.scene import ROBOT_PREFIX, Scene, Target
from kr210_sim.simulation import Simulation

_STILL = np.eye(4)
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
        data = mujoco.MjData(model)
        data.qpos[:] = simulation.data.qpos
        data.qpos[simulation.addresses.fingers] = robot.open_positions
        data.qpos[simulation.addresses.arm] = 0.0
        first = int(model.joint(target.name).qposadr[0])
        T_world_target = scene.T_world_base @ target.T_base_target
        data.qpos[first : first + 3] = T_world_target[:3, 3]
        mujoco.mju_mat2Quat(data.qpos[first + 3 : first + 7], T_world_target[:3, :3].ravel())
        mujoco.mj_kinematics(model, data)
        joints = np.array([model.joint(ROBOT_PREFIX + n).id for n in robot.arm_joints])
        self._chain = Chain(data.xanchor[joints], data.xaxis[joints])
        # The pick options all put the TCP on the target's centre, z along its axis.
        tcp = data.site(ROBOT_PREFIX + "tcp")
        T_world_tcp = np.eye(4)
        T_world_tcp[:3, 3], T_world_tcp[:3, :3] = tcp.xpos, tcp.xmat.reshape(3, 3)
        self._taken = T_world_tcp @ np.linalg.inv(T_world_target)
        root = simulation.body_id(robot.root)
        self._role = _roles(simulation, scene, target)
        self._group = _groups(model, np.array([root, *model.jnt_bodyid[joints]]))
        # What may be held is a part of its own.
        part = np.where(self._role == pairs.TARGET, GROUPS, self._group)
        far = np.full((GROUPS + 1, GROUPS + 1), NEAR)
        far[BASE:GROUPS, BASE:GROUPS] = NEAR_SELF
        self._pairs = GeomPairs(model, data, part, far)
        sorts = (self._role * GROUPS + self._group)[self._pairs.geoms]
        self._kind, self._pair = (table[:, *sorts.T] for table in pairs.tables())
        # Of hand or target and what is fixed, the one that may be carried.
        group = np.where(self._role == pairs.TARGET, HAND, self._group)[self._pairs.geoms]
        second = np.argmax(group, axis=1)
        self._mover = self._pairs.geoms[np.arange(len(group)), second]
        self._sign = 1.0 - 2.0 * second[:, None]
        # By whether the target is held; it belongs to the hand then, all else is as before.
        self._centers, self._radii = np.ones((2, HAND, 4)), np.zeros((2, HAND))
        corners = _corners(model, data)
        target_corners = corners[part == GROUPS].reshape(-1, 3)
        taken = target_corners @ self._taken[:3, :3].T + self._taken[:3, 3]
        for index in range(HAND):
            own = corners[part == BASE + index].reshape(-1, 3)
            for held, around in enumerate((own, np.concatenate([own, taken]))):
                if index == HAND - 1 or not held:
                    ball = _ball(around)
                    self._centers[held:, index, :3], self._radii[held:, index] = ball
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
        held = pairs.HELD[hands]
        moved = np.empty((len(q), GROUPS, 4, 4))
        moved[:, :HAND] = links = self._chain.moved(q)
        moved[:, HAND] = np.where(held[:, None, None], links[:, -1] @ self._taken, _STILL)
        anchor, axis = self._chain.axes(links)
        held = held.astype(np.int64)
        return Seen(
            **self._found(hands, required, self._pairs.posed(moved)),
            centers=(links @ self._centers[held][..., None])[..., :3, 0],
            radii=self._radii[held],
            anchor=anchor,
            axis=axis,
        )

    def name(self, geom: int) -> str:
        """Return the name of the body that a geom belongs to."""
        return str(self._model.body(int(self._model.geom_bodyid[geom])).name or "world")

    def _found(
        self, hands: NDArray[np.int64], required: Array, posed: Array
    ) -> dict[str, NDArray[Any]]:
        """Return row, geoms, kind, pair and distance of what is near.

        Args:
            hands: as for `see`.
            required: as for `see`.
            posed: (B, 3, M, 5) of the geoms that move, by `GeomPairs.posed`.
        """
        bounds = self._pairs.bounds(posed)
        kind = self._kind[hands[bounds[0]], bounds[1]]
        counts = kind != pairs.IGNORED
        row, pair, distance, direction = (x[counts] for x in bounds)
        kind = kind[counts]
        self._pairs.sharpen((row, pair, distance, direction), required[row, kind], posed)
        mover = self._mover[pair]
        return {
            "row": row,
            "geoms": self._pairs.geoms[pair],
            "kind": kind,
            "pair": self._pair[hands[row], pair],
            "distance": distance,
            "direction": self._sign[pair] * direction,
            "spot": self._pairs.positions(posed, row, mover),
            "size": self._model.geom_rbound[mover],
        }


def _corners(model: mujoco.MjModel, data: mujoco.MjData) -> Array:
    """Return the corners (ngeom, 8, 3) of the boxes around the geoms; NaN of what is not solid."""
    solid = (model.geom_contype != 0) | (model.geom_conaffinity != 0)
    corners = model.geom_aabb[:, None, :3] + model.geom_aabb[:, None, 3:] * _CORNERS
    corners = corners @ data.geom_xmat.reshape(-1, 3, 3).swapaxes(1, 2) + data.geom_xpos[:, None]
    return np.where(solid[:, None, None], corners, np.nan)


def _ball(points: Array) -> tuple[Array, float]:
    """Return a ball around points (N, 3), NaN rows left out: center (3,), radius [m]."""
    points = points[~np.isnan(points[:, 0])]
    if not len(points):
        return np.zeros(3), 0.0
    center = (np.min(points, axis=0) + np.max(points, axis=0)) / 2
    return center, float(np.sqrt(np.max(np.sum((points - center) ** 2, axis=1))))


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
