"""What a gripper feels of a target between its fingers: their position, force, and the load."""

from __future__ import annotations

from collections import deque

import numpy as np

from kr210_sim.arrays import Array
from kr210_sim.simulation import Simulation

STROKE_END = 1e-3
"""Fingers this close to the end of their stroke have closed on nothing [m]."""

FORCE_LOST = 0.2
"""A pad that presses with less than this share of a finger's grip force has lost the target."""

CLOSING_LOST = 5e-3
"""Fingers that have closed this much further than when they gripped have lost the target [m]."""

LOAD_LOST = 0.5
"""Share of the load carried so far below which the target has been lost."""

LOAD_PER_MASS = 4.0
"""The load is weighed while it would be at least this much per mass [m/s^2]: at the top of a quick
lift a target is next to weightless."""

LOAD_LEAST = 0.02
"""Less than this is no target, of whatever mass [kg]."""

RISEN = 5e-3
"""The load counts once the TCP has risen this far [m]: before, the board carries its share."""

_WINDOW = 3  # record steps over which the load is weighed
_BELOW = 2  # times in a row that it must be too small


class Grip:
    """Feels with what a gripper has: finger encoders, and pads that measure force in three axes.

    The load is the force of both pads together; what the target pushes against them cancels out.
    Over the acceleration of the TCP, which the arm's encoders tell, it gives the mass carried.

    Args:
        simulation: the world.
        record_step: time between two calls of `feel` [s].
    """

    def __init__(self, simulation: Simulation, record_step: float) -> None:
        robot, scene = simulation.scene.robot, simulation.scene
        columns = simulation.columns
        self._pads = [columns[f"target_{side}"] for side in ("right", "left")]
        self._tcp = columns["tcp_position"]
        self._joints = [
            columns[f"finger/{name}"].start for name in (robot.finger_joint, robot.mimic_joint)
        ]
        self._closed = robot.finger_positions(robot.finger_closed)
        self._opening = np.sign(robot.open_positions - self._closed)
        self._least_force = FORCE_LOST * robot.grip_force / 2
        self._step = record_step
        gravity = np.array(simulation.model.opt.gravity)
        self._gravity = scene.T_world_base[:3, :3].T @ gravity
        self._R_base_world = scene.T_world_base[:3, :3].T
        self.let_go()

    def let_go(self) -> None:
        """Forget the target."""
        self._gripped: Array | None = None
        self._height = np.inf
        self._carried, self._below = 0.0, 0
        self._seen: deque[tuple[Array, Array]] = deque(maxlen=_WINDOW + 2)

    def empty(self, finger_position: Array) -> bool:
        """Tell whether the fingers, joint positions (2,) [m], have closed on nothing."""
        return bool(np.max(np.abs(finger_position - self._closed)) < STROKE_END)

    def feel(self, rows: Array) -> str | None:
        """Take in the measurements (n, m) of a record step; return what tells of a lost target."""
        position = rows[-1, self._joints]
        if self._gripped is None:
            self._gripped = np.array(position)
            self._height = float(rows[0, self._tcp][2])
        force = [float(np.linalg.norm(rows[-1, pad][1:4])) for pad in self._pads]
        if min(force) < self._least_force:
            side = ("right", "left")[int(np.argmin(force))]
            return f"the {side} pad feels {min(force):.0f} N"
        if np.any((self._gripped - position) * self._opening > CLOSING_LOST):
            return "the fingers have closed further"
        mass = self._weigh(rows)
        if mass is None or rows[-1, self._tcp][2] < self._height + RISEN:
            return None
        self._carried = max(self._carried, mass)
        too_little = mass < max(LOAD_LOST * self._carried, LOAD_LEAST)
        self._below = self._below + 1 if too_little else 0
        if self._below >= _BELOW:
            return f"the pads carry {mass:.2f} kg, {self._carried:.2f} kg before"
        return None

    def _weigh(self, rows: Array) -> float | None:
        """Return the mass that the pads have carried lately [kg], None while that says nothing."""
        load = -sum(np.mean(rows[:, pad][:, 1:4], axis=0) for pad in self._pads)
        self._seen.append((np.array(rows[-1, self._tcp]), self._R_base_world @ load))
        if len(self._seen) < _WINDOW + 2:
            return None
        p = np.array([position for position, _ in self._seen])
        v = np.diff(p, axis=0) / self._step
        wanted = (v[-1] - v[0]) / (_WINDOW * self._step) - self._gravity  # per mass
        size = float(wanted @ wanted)
        if size < LOAD_PER_MASS**2:
            return None
        carried = np.mean([load for _, load in list(self._seen)[2:]], axis=0)
        return float(carried @ wanted) / size
