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
from kr210_sim.pairs import BASE, FIXED, FIXTURE, GROUPS, HAND, NEAR, NEAR_SELF, TOLERANCE, Seen
from kr210_sim.scene import ROBOT_PREFIX, Scene, Target
from kr210_sim.simulation import Simulation

_STILL = np.eye(4)
_WORTHWHILE = np.full(pairs.TOGETHER + 1, 0.02)
_WORTHWHILE[pairs.TOGETHER] = TOLERANCE
"""A lower bound this much above what is required is as good as the distance [m], by group of pairs:
of what does not move against each other, only whether it is too near counts."""
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
        one, other = (self._role * GROUPS + self._group)[self._pairs.geoms].T
        self._kind, self._pair = (
            np.take(table.reshape(len(table), -1), one * table.shape[2] + other, axis=1)
            for table in pairs.tables()
        )
        # Of hand or target and what is fixed, the one that may be carried.
        group = np.where(self._role == pairs.TARGET, HAND, self._group)[self._pairs.geoms]
        second = np.argmax(group, axis=1)
        self._mover = self._pairs.geoms[np.arange(len(group)), second]
        self._sign = 1.0 - 2.0 * second[:, None]
        # By whether the target is held; it belongs to the hand then, all else is as before.
        self._centers, self._radii = np.ones((2, HAND, 4)), np.zeros((2, HAND))
        moving = self._pairs.moving
        corners, of = _corners(model, data, moving), np.minimum(part[moving], HAND) - BASE
        own = np.searchsorted(part[moving], GROUPS)
        taken = corners[own:].reshape(-1, 3) @ self._taken[:3, :3].T + self._taken[:3, 3]
        corners[own:] = taken.reshape(-1, 8, 3)
        for held, count in enumerate((own, len(moving))):
            balls = _balls(corners[:count], of[:count])
            self._centers[held, :, :3], self._radii[held] = balls
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
        group = self._pair[hands[row], pair]
        limit = required[row, kind] + _WORTHWHILE[group]
        self._pairs.sharpen((row, pair, distance, direction), limit, posed)
        mover = self._mover[pair]
        return {
            "row": row,
            "geoms": self._pairs.geoms[pair],
            "kind": kind,
            "pair": group,
            "distance": distance,
            "direction": self._sign[pair] * direction,
            "spot": self._pairs.positions(posed, row, mover),
            "size": self._model.geom_rbound[mover],
        }


def _corners(model: mujoco.MjModel, data: mujoco.MjData, geoms: NDArray[np.int64]) -> Array:
    """Return the corners (n, 8, 3) of the boxes around geoms (n,)."""
    boxes = model.geom_aabb[geoms, None]
    corners = boxes[..., :3] + boxes[..., 3:] * _CORNERS
    rotation = data.geom_xmat[geoms].reshape(-1, 3, 3)
    return np.asarray(corners @ rotation.swapaxes(1, 2) + data.geom_xpos[geoms, None])


def _balls(corners: Array, of: NDArray[np.int64]) -> tuple[Array, Array]:
    """Return a ball around each link: centers (HAND, 3), radii (HAND,) [m]; 0 of what is bare.

    Args:
        corners: (n, 8, 3) of the boxes of the geoms.
        of: (n,) the link of each geom, ascending.
    """
    centers, radii = np.zeros((HAND, 3)), np.zeros(HAND)
    links = np.flatnonzero(np.bincount(of))
    begin = 8 * np.searchsorted(of, links)
    points = corners.reshape(-1, 3).T
    low = np.minimum.reduceat(points, begin, axis=1)
    high = np.maximum.reduceat(points, begin, axis=1)
    centers[links] = (low + high).T / 2
    x, y, z = (points - np.repeat(centers[of], 8, axis=0).T) ** 2
    radii[links] = np.sqrt(np.maximum.reduceat(x + y + z, begin))
    return centers, radii


def _roles(simulation: Simulation, scene: Scene, target: Target) -> NDArray[np.int64]:
    """Return the role of each geom."""
    model = simulation.model
    body_role = [FIXTURE] * model.nbody
    body_role[simulation.body_id(scene.robot.root)] = pairs.ROBOT
    for name in scene.robot.fingers:
        body_role[simulation.body_id(name)] = pairs.FINGER
    parents = model.body_parentid.tolist()
    for body in range(1, model.nbody):  # parents come first
        body_role[body] = max(body_role[body], body_role[parents[body]])
    body_role[model.body(target.name).id] = pairs.TARGET
    role = np.array(body_role)[model.geom_bodyid]
    role[model.geom(scene.cell(target.cell).support).id] = pairs.SUPPORT
    return np.asarray(role)


def _groups(model: mujoco.MjModel, links: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return the group of each geom from the base link and the links of the arm joints (7,)."""
    group = [FIXED] * model.nbody
    parents, begins = model.body_parentid.tolist(), set(links.tolist())
    for body in range(1, model.nbody):
        group[body] = group[parents[body]] + (body in begins)
    return np.asarray(np.array(group)[model.geom_bodyid])
