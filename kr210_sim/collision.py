"""The clearance oracle that planning asks, answered by MuJoCo's own collision detection."""

from __future__ import annotations

import copy

import mujoco
import numpy as np
from numpy.typing import NDArray

from kr210_sim.arrays import Array
from kr210_sim.planning import CLEARANCE_FREE, Hand
from kr210_sim.scene import Scene, Target
from kr210_sim.simulation import Simulation

_SELF_CLEARANCE = 0.002
"""Kept between links of the robot itself [m]; neighbours of neighbours are always close."""

_FIXTURE, _ROBOT, _FINGER, _TARGET, _SUPPORT = range(5)


class MujocoOracle:
    """Clearance of the arm, gripper and held target to everything else in a simulated world.

    It works on its own copy of the model, with contact margins wide enough to see what is near,
    and on the state of the world at the moment it is made: targets that lie in the bin are
    obstacles where they lie.
    """

    def __init__(self, simulation: Simulation, scene: Scene, target: Target) -> None:
        robot = scene.robot
        self._model = copy.copy(simulation.model)
        self._data = mujoco.MjData(self._model)
        self._data.qpos[:] = simulation.data.qpos
        self._model.geom_margin[:] = CLEARANCE_FREE
        self._model.body_margin[:] = CLEARANCE_FREE  # what the broad phase goes by
        self._model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_MULTICCD
        self._arm = simulation.addresses.arm
        self._fingers = simulation.addresses.fingers
        self._open = robot.open_positions
        self._target = int(self._model.joint(target.name).qposadr[0])
        self._T_base_target = target.T_base_target
        # The pick options all put the TCP on the target's centre, z along its axis.
        self._T_tcp_target = np.eye(4)
        self._T_world_base = scene.T_world_base
        self._robot = robot
        self._kind = self._classify(simulation, scene, target)

    def _classify(self, simulation: Simulation, scene: Scene, target: Target) -> NDArray[np.int64]:
        """Return what each geom is, for the pair rules of `_worst`."""
        model = self._model
        kind = np.full(model.ngeom, _FIXTURE)
        fingers = [simulation.body_id(name) for name in scene.robot.fingers]
        root = simulation.body_id(scene.robot.root)
        for geom in range(model.ngeom):
            body = int(model.geom_bodyid[geom])
            if any(_descends(model, body, finger) for finger in fingers):
                kind[geom] = _FINGER
            elif _descends(model, body, root):
                kind[geom] = _ROBOT
            elif model.body(body).name == target.name:
                kind[geom] = _TARGET
            elif model.geom(geom).name == scene.cell(target.cell).support:
                kind[geom] = _SUPPORT
        return kind

    def blocked(self, q: Array, *, hand: Hand, clearance: float) -> str | None:
        """Return None if all configurations (N, 6) keep that clearance [m], else what is near."""
        model, data = self._model, self._data
        for row in q[_coarse_to_fine(len(q))]:
            data.qpos[self._arm] = row
            data.qpos[self._fingers] = self._open
            self._put_target(row, hand)
            mujoco.mj_kinematics(model, data)
            mujoco.mj_collision(model, data)
            if data.ncon and (what := self._worst(hand, clearance)):
                return what
        return None

    def _put_target(self, q: Array, hand: Hand) -> None:
        T_base_target = self._T_base_target
        if hand in (Hand.LIFTING, Hand.HOLDING):
            T_base_target = self._robot.forward(q) @ self._T_tcp_target
        T = self._T_world_base @ T_base_target
        address = self._target
        self._data.qpos[address : address + 3] = T[:3, 3]
        quat_wxyz = np.empty(4)
        mujoco.mju_mat2Quat(quat_wxyz, np.ascontiguousarray(T[:3, :3]).ravel())
        self._data.qpos[address + 3 : address + 7] = quat_wxyz

    def _worst(self, hand: Hand, clearance: float) -> str | None:
        """Apply the pair rules to the contacts of the current configuration."""
        geoms = self._data.contact.geom
        kinds = np.sort(self._kind[geoms], axis=1)
        low, high = kinds[:, 0], kinds[:, 1]
        held = hand in (Hand.LIFTING, Hand.HOLDING)
        is_robot = (low == _ROBOT) | (low == _FINGER) | (high == _ROBOT) | (high == _FINGER)
        on_target = (low == _TARGET) | (high == _TARGET)
        moving = is_robot | (on_target if held else False)
        both_robot = (low >= _ROBOT) & (high <= _FINGER)
        required = np.where(both_robot, _SELF_CLEARANCE, clearance)
        ignored = ~moving
        if hand is Hand.RELEASED:
            ignored |= on_target
        if held:
            ignored |= (low == _FINGER) & (high == _TARGET)
        if hand is Hand.LIFTING:
            ignored |= (low == _TARGET) & (high == _SUPPORT)
        bad = ~ignored & (self._data.contact.dist < required)
        if not np.any(bad):
            return None
        index = int(np.argmin(np.where(bad, self._data.contact.dist - required, np.inf)))
        first, second = (self._name(int(geom)) for geom in geoms[index])
        distance = 1000 * float(self._data.contact.dist[index])
        return f"{first} within {distance:.0f} mm of {second}"

    def _name(self, geom: int) -> str:
        return str(self._model.body(int(self._model.geom_bodyid[geom])).name or "world")


def _coarse_to_fine(count: int) -> NDArray[np.int64]:
    """Return all indices below count, spread first, so that a blocked path is refused early."""
    bits = max(1, int(count - 1).bit_length())
    mirrored = [int(f"{index:0{bits}b}"[::-1], 2) for index in range(1 << bits)]
    return np.array([index for index in mirrored if index < count])


def _descends(model: mujoco.MjModel, body: int, ancestor: int) -> bool:
    while body > 0:
        if body == ancestor:
            return True
        body = int(model.body_parentid[body])
    return False
