"""Where a target can stand and an arm can start: the checks behind drawing again."""

from __future__ import annotations

from dataclasses import replace
from functools import cached_property

import mujoco
import numpy as np

from kr210_sim.arrays import Array
from kr210_sim.collision import MujocoOracle
from kr210_sim.criteria import CLEARANCE_FREE
from kr210_sim.legs import Hand
from kr210_sim.scene import ROBOT_PREFIX, Scene, Target
from kr210_sim.simulation import Simulation

_RIM_POINTS = 16
_ABOVE = 0.01
"""Where the rays start that look for the board under a target's rim [m]."""

_ON_BOARD = 1e-3
"""How far below the rim the board may be [m]; as for a cell's site."""


class Room:
    """The free space of a scene, without the targets of other cycles.

    Args:
        scene: world and robot.
        largest: a target of the largest radius and length that will be asked for.
    """

    def __init__(self, scene: Scene, largest: Target) -> None:
        self._scene, self._largest = scene, largest

    @cached_property
    def _simulation(self) -> Simulation:
        simulation = Simulation(self._scene)
        simulation.add(self._largest)
        return simulation

    @cached_property
    def _fixtures(self) -> list[int]:
        """Geoms that a target can touch, those of the robot apart."""
        model = self._simulation.model
        bodies = [model.body(int(body)).name for body in model.geom_bodyid]
        return [
            geom
            for geom, body in enumerate(bodies)
            if (model.geom_contype[geom] or model.geom_conaffinity[geom])
            and not body.startswith(ROBOT_PREFIX)
            and body != self._largest.name
        ]

    def stands_free(self, target: Target) -> bool:
        """Tell whether a target stands on its board with its whole rim, and in nothing else."""
        model, data = self._simulation.model, self._simulation.data
        T = self._scene.T_world_base @ target.T_base_target
        cylinder = int(model.geom(f"{self._largest.name}_visual").id)
        # Only made smaller: the bounds that the compiler derived from the largest stay valid.
        model.geom_size[cylinder] = [target.radius, target.length / 2, 0.0]
        data.geom_xpos[cylinder], data.geom_xmat[cylinder] = T[:3, 3], T[:3, :3].ravel()
        support = int(model.geom(self._scene.cell(target.cell).support).id)
        for geom in self._fixtures:
            gap = mujoco.mj_geomDistance(model, data, cylinder, geom, _ABOVE, None)
            if geom != support and gap <= 0.0:
                return False
        angle = 2 * np.pi * np.arange(_RIM_POINTS) / _RIM_POINTS
        below, body = np.full(1, -1, dtype=np.int32), int(model.body(self._largest.name).id)
        for x, y in target.radius * np.stack([np.cos(angle), np.sin(angle)], axis=1):
            rim = T[:3, :3] @ [x, y, _ABOVE - target.length / 2] + T[:3, 3]
            distance = mujoco.mj_ray(model, data, rim, -T[:3, 2], None, True, body, below)
            if below[0] != support or abs(distance - _ABOVE) > _ON_BOARD:
                return False
        return True

    def clear(self, q: Array, target: Target) -> bool:
        """Tell whether configurations (N, 6) [rad] are within the limits and away from everything.

        The target counts as the largest that will be asked for, standing where it stands.
        """
        robot = self._scene.robot
        if np.any((q < robot.lower) | (q > robot.upper)):
            return False
        there = replace(self._largest, T_base_target=target.T_base_target)
        oracle = MujocoOracle(self._simulation, self._scene, there)
        return oracle.blocked(q, hand=Hand.EMPTY, clearance=CLEARANCE_FREE) is None
