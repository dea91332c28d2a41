"""The observer of a cycle: reduces every physics step's measurements to the series of a record."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from scipy.spatial.transform import Rotation

from kr210_sim.control import Commands
from kr210_sim.criteria import (
    EFFORT_RATIO_LIMIT,
    LIFT_HEIGHT_LIMIT,
    POSITION_SLACK,
    REST_SPEED,
    REST_SPIN,
    SLIP_LIMIT,
    SPEED_RATIO_LIMIT,
)
from kr210_sim.record import STAGES, Event
from kr210_sim.simulation import Simulation

Array = NDArray[np.float64]


class Monitor:
    """Watches one target through one cycle.

    Attributes:
        events: conditions broken so far, in order of time.
        lifted: whether the target has been held clear at the height that counts.
        resting_for: how long the target has been at rest [s].
        force: (2,) latest contact force of the right and left finger [N].
        touching: (2,) whether they touched the target at the latest step.
        finger_position: (2,) latest finger joint positions [m].
        q: (6,) latest arm configuration [rad].
    """

    def __init__(self, simulation: Simulation) -> None:
        robot, self._columns = simulation.scene.robot, simulation.columns
        self._simulation = simulation
        self._lower, self._upper = robot.lower, robot.upper
        self._velocity, self._effort = robot.velocity, robot.effort
        self._joints = robot.arm_joints
        self._step = float(simulation.model.opt.timestep)
        first = self._columns["q/" + robot.arm_joints[0]].start
        self._q = slice(first, first + 6)
        self._qd = slice(first + 6, first + 12)
        self._tau = slice(first + 12, first + 18)
        self._fingers = slice(first + 18, first + 20)
        self._rest_height = float(simulation.data.sensordata[self._columns["target_position"]][2])
        self._lift_off: tuple[Array, Array] | None = None
        self._series: dict[str, list[Array]] = {}
        self.time = 0.0
        self.events: list[Event] = []
        self.lifted = False
        self.released = False
        self.resting_for = 0.0
        self.force = np.zeros(2)
        self.touching = np.zeros(2, dtype=bool)
        self.q = np.array(simulation.data.sensordata[self._q])
        self.finger_position = np.array(simulation.data.sensordata[self._fingers])

    def series(self) -> dict[str, Array]:
        """Return the series so far, name -> (n, ...)."""
        return {name: np.array(values) for name, values in self._series.items()}

    def observe(self, rows: Array, commands: Commands, stage: str) -> None:
        """Take in the measurements (n, m) of the physics steps of one record step."""
        if not len(rows):
            return
        start = self.time
        self.time += len(rows) * self._step
        column = {name: rows[:, where] for name, where in self._columns.items()}
        right, left = column["target_right"], column["target_left"]
        touch = np.stack([right[:, 0] > 0, left[:, 0] > 0], axis=1)
        height = column["target_position"][:, 2] - self._rest_height
        only_fingers = touch.all(axis=1) & (
            column["target_all"][:, 0] == right[:, 0] + left[:, 0]
        )
        slip_m, slip_rad = self._slip(column, touch)
        foreign = rows @ self._simulation.foreign_weights
        q, qd, effort = rows[:, self._q], rows[:, self._qd], rows[:, self._tau]
        excess = np.maximum(self._lower - q, q - self._upper)
        speed = np.linalg.norm(column["target_velocity"], axis=1)
        spin = np.linalg.norm(column["target_spin"], axis=1)
        tracking = np.linalg.norm(
            column["tcp_position"] - commands.T_base_tcp[: len(rows), :3, 3], axis=1
        )
        self.force = np.array([np.linalg.norm(side[-1, 1:]) for side in (right, left)])
        self.touching, self.q = touch[-1], np.array(q[-1])
        self.finger_position = np.array(rows[-1, self._fingers])
        clear = np.where(only_fingers, height, 0.0)
        self.lifted = self.lifted or bool(clear.max() >= LIFT_HEIGHT_LIMIT)
        self._rest(speed, spin)
        kept = {
            "time": self.time,
            "stage": STAGES.index(stage),
            "qpos": np.array(self._simulation.data.qpos),
            "ctrl": commands.ctrl[len(rows) - 1],
            "tcp_commanded": _position_quaternion(commands.T_base_tcp[len(rows) - 1]),
            "tcp_measured": np.concatenate([column["tcp_position"][-1], column["tcp_quat_wxyz"][-1]]),
            "tracking_max": tracking.max(),
            "finger_force": self.force,
            "fingers_touch": touch.all(axis=0),
            "clear_height_max": clear.max(),
            "slip_m_max": slip_m.max(),
            "slip_rad_max": slip_rad.max(),
            "position_excess_max": max(0.0, excess.max()),
            "speed_ratio_max": np.max(np.abs(qd) / self._velocity),
            "effort_ratio_max": np.max(np.abs(effort) / self._effort),
            "target_speed_max": speed.max(),
            "target_spin_max": spin.max(),
            "foreign_contacts_max": foreign.max(),
        }
        for name, value in kept.items():
            self._series.setdefault(name, []).append(np.asarray(value, dtype=float))
        times = start + self._step * np.arange(len(rows))
        self._note_events(times, stage, foreign, excess, qd, effort, touch, slip_m)

    def _slip(self, column: dict[str, Array], touch: NDArray[np.bool_]) -> tuple[Array, Array]:
        """Return shift [m] and turn [rad] of the target in the TCP frame since lift-off, (n,)."""
        count = len(touch)
        position, quat_wxyz = column["held_position"], column["held_quat_wxyz"]
        begin = 0
        if self._lift_off is None:
            off = touch.all(axis=1) & (column["target_support"][:, 0] == 0)
            if not off.any():
                return np.zeros(count), np.zeros(count)
            begin = int(np.argmax(off))
            self._lift_off = np.array(position[begin]), np.array(quat_wxyz[begin])
        if self.released:
            return np.zeros(count), np.zeros(count)
        held = np.arange(count) >= begin
        shift = np.linalg.norm(position - self._lift_off[0], axis=1)
        # The vector part of q0^-1 q is sin(angle/2): well conditioned for small turns.
        dot = np.clip(np.abs(quat_wxyz @ self._lift_off[1]), 0.0, 1.0)
        turn = 2 * np.arctan2(np.sqrt(np.maximum(0.0, 1 - dot**2)), dot)
        return np.where(held, shift, 0.0), np.where(held, turn, 0.0)

    def _rest(self, speed: Array, spin: Array) -> None:
        moving = np.flatnonzero((speed >= REST_SPEED) | (spin >= REST_SPIN))
        if len(moving):
            self.resting_for = (len(speed) - 1 - int(moving[-1])) * self._step
        else:
            self.resting_for += len(speed) * self._step

    def _note_events(
        self,
        times: Array,
        stage: str,
        foreign: Array,
        excess: Array,
        qd: Array,
        effort: Array,
        touch: NDArray[np.bool_],
        slip_m: Array,
    ) -> None:
        """Append the first breach of each condition in these steps, earliest first."""
        found: list[Event] = []

        def first(mask: NDArray[np.bool_], reason: str, detail: str) -> None:
            if mask.any():
                when = float(times[int(np.argmax(mask))])
                found.append(Event(reason=reason, stage=stage, time=when, detail=detail))

        if (foreign > 0).any():
            first(foreign > 0, "collision", self._simulation.foreign_pair())
        for values, limit, what in (
            (excess, POSITION_SLACK, "position limit crossed"),
            (np.abs(qd) / self._velocity, SPEED_RATIO_LIMIT, "speed limit exceeded"),
            (np.abs(effort) / self._effort, EFFORT_RATIO_LIMIT, "motor saturated"),
        ):
            breach = values >= limit if what == "motor saturated" else values > limit
            if breach.any():
                joint = self._joints[int(np.argmax(breach.any(axis=0)))]
                first(breach.any(axis=1), "limits_exceeded", f"{joint}: {what}")
        if self._lift_off is not None and not self.released and self.lifted:
            lost = ~touch.all(axis=1)
            first(lost, "dropped", "a finger lost the target")
            first(slip_m >= SLIP_LIMIT, "dropped", f"slipped {1000 * slip_m.max():.1f} mm")
        known = {event.reason for event in self.events}
        for event in sorted(found, key=lambda event: event.time):
            if event.reason not in known:
                known.add(event.reason)
                self.events.append(event)


def _position_quaternion(T: Array) -> Array:
    """Return position and quat_wxyz (7,) of a pose (4, 4)."""
    x, y, z, w = Rotation.from_matrix(T[:3, :3]).as_quat(canonical=True)
    return np.array([*T[:3, 3], w, x, y, z])
