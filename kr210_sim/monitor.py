"""The observer of a cycle: reduces every physics step's measurements to the series of a record."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from kr210_sim.arrays import Array
from kr210_sim.control import Commands
from kr210_sim.criteria import (
    EFFORT_RATIO_LIMIT,
    JUMP_SLACK,
    LIFT_HEIGHT_LIMIT,
    POSITION_SLACK,
    REST_SPEED,
    REST_SPIN,
    SLIP_LIMIT,
    SPEED_RATIO_LIMIT,
)
from kr210_sim.record import STAGES, Event
from kr210_sim.simulation import Simulation

GRIP_READY = 0.9
"""Share of the grip force from which a finger counts as pressing."""


class Monitor:
    """Watches one target through one cycle.

    Attributes:
        events: conditions broken so far, in order of time.
        lifted: whether the target has been held clear at the height that counts.
        resting_for: how long the target has been at rest [s].
        force: (2,) latest contact force of the right and left finger [N].
        friction_ratio: (2,) its part along the jaw over its part across, 0 without contact.
        touching: (2,) whether they touched the target at the latest step.
        finger_position: (2,) latest finger joint positions [m].
        pressing_for: how long both fingers have touched the target and pressed at the end of each
            record step with the force that a grip has [s].
        q: (6,) latest arm configuration [rad].
        tracking: largest distance of measured from commanded TCP in the latest record step [m].
    """

    def __init__(self, simulation: Simulation) -> None:
        robot, self._columns = simulation.scene.robot, simulation.columns
        self._simulation = simulation
        # The driven finger has limits of position and speed too; its force is the grip.
        strokes = sorted((robot.finger_open, robot.finger_closed))
        self._joints = (*robot.arm_joints, robot.finger_joint)
        self._lower = np.append(robot.lower, strokes[0])
        self._upper = np.append(robot.upper, strokes[1])
        self._velocity = np.append(robot.velocity, robot.finger_velocity)
        self._effort = robot.effort
        self._step = float(simulation.model.opt.timestep)
        first = self._columns["q/" + robot.arm_joints[0]].start
        self._q = slice(first, first + 6)
        self._qd = slice(first + 6, first + 12)
        self._tau = slice(first + 12, first + 18)
        self._fingers = slice(first + 18, first + 20)
        self._finger = [first + 18]
        self._finger_speed = [first + 20]
        self._rest_height = float(simulation.data.sensordata[self._columns["target_position"]][2])
        self._lift_off: tuple[Array, Array] | None = None
        self._last: tuple[Array, float] | None = None
        self._series: dict[str, list[Array]] = {}
        self.time = 0.0
        self.events: list[Event] = []
        self.lifted = False
        self.released = False
        self.resting_for = self.pressing_for = self.tracking = 0.0
        self._grip = GRIP_READY * robot.grip_force / 2
        self.force = np.zeros(2)
        self.friction_ratio = np.zeros(2)
        self._R_world_base = simulation.scene.T_world_base[:3, :3]
        self.touching = np.zeros(2, dtype=bool)
        self.q = np.array(simulation.data.sensordata[self._q])
        self.finger_position = np.array(simulation.data.sensordata[self._fingers])

    def series(self) -> dict[str, Array]:
        """Return the series so far, name -> (n, ...)."""
        series = {name: np.array(values) for name, values in self._series.items()}
        if series:
            series["tcp_commanded"] = position_quaternion(series["tcp_commanded"])
        return series

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
        only_fingers = touch.all(axis=1) & (column["target_all"][:, 0] == right[:, 0] + left[:, 0])
        slip_m, slip_rad = self._slip(column, touch)
        foreign = rows @ self._simulation.foreign_weights
        q = np.concatenate([rows[:, self._q], rows[:, self._finger]], axis=1)
        qd = np.concatenate([rows[:, self._qd], rows[:, self._finger_speed]], axis=1)
        used = np.abs(rows[:, self._tau]) / self._effort
        excess = np.maximum(self._lower - q, q - self._upper)
        speed = np.linalg.norm(column["target_velocity"], axis=1)
        spin = np.linalg.norm(column["target_spin"], axis=1)
        strayed = column["tcp_position"] - commands.T_base_tcp[: len(rows), :3, 3]
        self.tracking = float(np.max(np.linalg.norm(strayed, axis=1)))
        self._press(touch, right, left, column["tcp_quat_wxyz"][-1])
        self.touching, self.q = touch[-1], np.array(q[-1, :6])
        self.finger_position = np.array(rows[-1, self._fingers])
        clear = np.where(only_fingers, height, 0.0)
        self.lifted = self.lifted or bool(clear.max() >= LIFT_HEIGHT_LIMIT)
        self._rest(speed, spin)
        kept = {
            "time": self.time,
            "stage": STAGES.index(stage),
            "qpos": np.array(self._simulation.measured),
            "ctrl": commands.ctrl[len(rows) - 1],
            "tcp_commanded": commands.T_base_tcp[len(rows) - 1],
            "tcp_measured": np.hstack([column["tcp_position"][-1], column["tcp_quat_wxyz"][-1]]),
            "tracking_max": self.tracking,
            "grip_force": np.concatenate([right[-1, 1:], left[-1, 1:]]),
            "finger_force": self.force.copy(),
            "friction_ratio": self.friction_ratio.copy(),
            "fingers_touch": touch.all(axis=0),
            "finger_contacts_min": np.array([right[:, 0].min(), left[:, 0].min()]),
            "clear_height_max": clear.max(),
            "slip_m_max": slip_m.max(),
            "slip_rad_max": slip_rad.max(),
            "position_excess_max": max(0.0, excess.max()),
            "speed_ratio_max": np.max(np.abs(qd) / self._velocity),
            "effort_ratio_max": np.max(used),
            "target_speed_max": speed.max(),
            "target_spin_max": spin.max(),
            "foreign_contacts_max": foreign.max(),
        }
        for name, value in kept.items():
            self._series.setdefault(name, []).append(np.asarray(value, dtype=float))
        found = [
            *self._foreign(foreign),
            *self._limits(excess, np.abs(qd) / self._velocity, used),
            *self._losses(touch, slip_m),
            *self._jumps(column["target_position"], speed),
        ]
        self._note(found, start, stage)

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
        # Half the angle between unit quaternions (Kahan): well conditioned for small turns, too.
        start = self._lift_off[1] * np.where(quat_wxyz @ self._lift_off[1] < 0, -1.0, 1.0)[:, None]
        apart = np.linalg.norm(quat_wxyz - start, axis=1)
        turn = 4 * np.arctan2(apart, np.linalg.norm(quat_wxyz + start, axis=1))
        return np.where(held, shift, 0.0), np.where(held, turn, 0.0)

    def _rest(self, speed: Array, spin: Array) -> None:
        moving = np.flatnonzero((speed >= REST_SPEED) | (spin >= REST_SPIN))
        if len(moving):
            self.resting_for = (len(speed) - 1 - int(moving[-1])) * self._step
        else:
            self.resting_for += len(speed) * self._step

    def _press(self, touch: NDArray[np.bool_], right: Array, left: Array, quat_wxyz: Array) -> None:
        """Take in contacts (n, 2), the measured force of each finger (n, 4), and the TCP's turn."""
        w, x, y, z = quat_wxyz
        across = self._R_world_base @ [
            2 * (x * y - w * z),
            1 - 2 * (x * x + z * z),
            2 * (y * z + w * x),
        ]
        for finger, side in enumerate((right, left)):
            force = side[-1, 1:]
            normal = float(force @ across)
            along = np.linalg.norm(force - normal * across)
            self.force[finger] = np.linalg.norm(force)
            self.friction_ratio[finger] = along / abs(normal) if normal else 0.0
        if touch.all() and bool(np.min(self.force) >= self._grip):
            self.pressing_for += len(touch) * self._step
        else:
            self.pressing_for = 0.0

    def _foreign(self, count: Array) -> Iterator[_Breach]:
        """Yield the first contact that is not permitted."""
        if np.any(count > 0):
            yield _Breach(int(np.argmax(count > 0)), "collision", self._simulation.foreign_pair())

    def _limits(self, excess: Array, speed: Array, effort: Array) -> Iterator[_Breach]:
        """Yield the first breach of the position, speed and effort limits, (n, 6) each."""
        for breach, what in (
            (excess > POSITION_SLACK, "position limit crossed"),
            (speed > SPEED_RATIO_LIMIT, "speed limit exceeded"),
            (effort >= EFFORT_RATIO_LIMIT, "motor saturated"),
        ):
            if np.any(breach):
                step, joint = np.unravel_index(int(np.argmax(breach)), breach.shape)
                yield _Breach(int(step), "limits_exceeded", f"{self._joints[joint]}: {what}")

    def _losses(self, touch: Array, slip_m: Array) -> Iterator[_Breach]:
        """Yield the first step at which a target being carried is lost."""
        if not self.lifted or self.released:
            return
        lost = ~np.all(touch, axis=1)
        if np.any(lost):
            step = int(np.argmax(lost))
            finger = self._simulation.scene.robot.fingers[int(np.argmin(touch[step]))]
            yield _Breach(step, "dropped", f"{finger} lost the target")
        if np.any(slip_m >= SLIP_LIMIT):
            detail = f"slipped {1000 * slip_m.max():.1f} mm"
            yield _Breach(int(np.argmax(slip_m >= SLIP_LIMIT)), "dropped", detail)

    def _jumps(self, position: Array, speed: Array) -> Iterator[_Breach]:
        """Yield the first step at which the target moved further than its speed explains."""
        if self._last is not None:
            before, v_before = self._last
            position = np.concatenate([before[None], position])
            speed = np.append(v_before, speed)
        self._last = np.array(position[-1]), float(speed[-1])
        moved = np.linalg.norm(np.diff(position, axis=0), axis=1)
        explained = np.maximum(speed[:-1], speed[1:]) * self._step + JUMP_SLACK
        if np.any(moved > explained):
            held = "dropped" if self.lifted else "missed_grasp"
            reason = "outside_bin" if self.released else held
            step = int(np.argmax(moved > explained))
            yield _Breach(step, reason, f"the target jumped by {1000 * moved[step]:.1f} mm")

    def _note(self, found: list[_Breach], start: float, stage: str) -> None:
        """Append the first breach for each reason to the events, earliest first."""
        known = {event.reason for event in self.events}
        for step, reason, detail in sorted(found, key=lambda breach: breach.step):
            if reason not in known:
                known.add(reason)
                time = start + step * self._step
                self.events.append(Event(reason=reason, stage=stage, time=time, detail=detail))


class _Breach(NamedTuple):
    """A condition broken at a physics step, counted from the start of the record step."""

    step: int
    reason: str
    detail: str


def position_quaternion(T: Array) -> Array:
    """Return position and quat_wxyz (n, 7) of poses (n, 4, 4)."""
    quat_xyzw = Rotation.from_matrix(T[:, :3, :3]).as_quat(canonical=True)
    return np.concatenate([T[:, :3, 3], quat_xyzw[:, [3, 0, 1, 2]]], axis=1)
