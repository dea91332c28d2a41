"""The observer of a cycle: reduces every physics step's measurements to the series of a record."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, NamedTuple

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
from kr210_sim.seen import Seen
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
        tracking: largest distance of measured from commanded TCP in the latest record step [m].
        q: (6,) latest arm configuration [rad].
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
        series = {name: np.concatenate(values) for name, values in self._series.items()}
        if series:
            series["tcp_commanded"] = position_quaternion(series["tcp_commanded"])
        return series

    def start_over(self) -> None:
        """Judge the grasp anew: the last one was given up, and what befell it is kept elsewhere."""
        self.events, self.lifted, self.released = [], False, False
        self._lift_off, self.pressing_for = None, 0.0

    def observe(self, rows: Array, commands: Commands, stage: str) -> None:
        """Take in the measurements (n, m) of the physics steps of one record step."""
        if not len(rows):
            return
        start, seen = self.time, self._see(rows, commands, 1)
        found = list(self._breaches(seen))
        self._take(seen, commands, stage)
        self._note(found, start, stage)

    def observe_calm(self, rows: Array, commands: Commands, stage: str, count: int) -> bool:
        """Take in several record steps of equal length, unless a condition breaks in them.

        Returns:
            Whether none broke; else nothing is taken in.
        """
        seen = self._see(rows, commands, count)
        if next(self._breaches(seen), None) is not None:
            return False
        self._take(seen, commands, stage)
        return True

    def _see(self, rows: Array, commands: Commands, count: int) -> Seen:
        """Return what measurements (n, m) of some record steps mean; nothing is changed."""
        column = {name: rows[:, where] for name, where in self._columns.items()}
        right, left = column["target_right"], column["target_left"]
        touch = np.stack([right[:, 0] > 0, left[:, 0] > 0], axis=1)
        height = column["target_position"][:, 2] - self._rest_height
        only_fingers = touch.all(axis=1) & (column["target_all"][:, 0] == right[:, 0] + left[:, 0])
        clear = np.where(only_fingers, height, 0.0)
        lifted = clear.reshape(count, -1).max(axis=1) >= LIFT_HEIGHT_LIMIT
        slip_m, slip_rad, lift_off = self._slip(column, touch)
        q = np.concatenate([rows[:, self._q], rows[:, self._finger]], axis=1)
        qd = np.concatenate([rows[:, self._qd], rows[:, self._finger_speed]], axis=1)
        return Seen(
            count=count,
            rows=rows,
            column=column,
            touch=touch,
            clear=clear,
            lifted=np.logical_or.accumulate(lifted) | self.lifted,
            slip_m=slip_m,
            slip_rad=slip_rad,
            lift_off=lift_off,
            foreign=rows @ self._simulation.foreign_weights,
            excess=np.maximum(self._lower - q, q - self._upper),
            speed_ratio=np.abs(qd) / self._velocity,
            effort_ratio=np.abs(rows[:, self._tau]) / self._effort,
            tracking=np.linalg.norm(
                column["tcp_position"] - commands.T_base_tcp[: len(rows), :3, 3], axis=1
            ),
            speed=np.linalg.norm(column["target_velocity"], axis=1),
            spin=np.linalg.norm(column["target_spin"], axis=1),
        )

    def _take(self, seen: Seen, commands: Commands, stage: str) -> None:
        """Go on to the end of some record steps and keep their series."""
        rows, column, count = seen.rows, seen.column, seen.count
        length = len(rows) // count
        duration = length * self._step
        times = []
        for _ in range(count):
            self.time += duration
            times.append(self.time)
        ends = slice(length - 1, None, length)
        sides = [column[name] for name in ("target_right", "target_left")]
        forces = np.stack([side[ends, 1:] for side in sides], axis=1)
        force = _length(forces)
        friction_ratio = self._friction_ratio(forces, column["tcp_quat_wxyz"][ends])
        touching = np.all(seen.each(seen.touch), axis=1)
        self._press(np.all(touching, axis=1) & (force.min(axis=1) >= self._grip), duration)
        self._rest(seen.each((seen.speed >= REST_SPEED) | (seen.spin >= REST_SPIN)))
        self.force, self.friction_ratio = force[-1], friction_ratio[-1]
        self.touching, self.lifted = seen.touch[-1], bool(seen.lifted[-1])
        self.q = np.array(rows[-1, self._q])
        self.finger_position = np.array(rows[-1, self._fingers])
        peaks = seen.peaks()
        self.tracking = float(peaks["tracking_max"][-1])
        self._lift_off = seen.lift_off
        self._last = np.array(column["target_position"][-1]), float(seen.speed[-1])
        kept = {
            "time": times,
            "stage": np.full(count, STAGES.index(stage)),
            "qpos": self._simulation.measured[ends],
            "ctrl": commands.ctrl[: len(rows)][ends],
            "tcp_commanded": commands.T_base_tcp[: len(rows)][ends],
            "tcp_measured": np.concatenate(
                [column["tcp_position"][ends], column["tcp_quat_wxyz"][ends]], axis=1
            ),
            "grip_force": forces.reshape(count, 6),
            "finger_force": force,
            "friction_ratio": friction_ratio,
            "fingers_touch": touching,
            "finger_contacts_min": np.stack(
                [np.min(seen.each(side[:, 0]), axis=1) for side in sides], axis=1
            ),
        } | peaks
        for name, value in kept.items():
            self._series.setdefault(name, []).append(np.array(value, dtype=float))

    def _breaches(self, seen: Seen) -> Iterator[_Breach]:
        """Yield the first breach of every condition."""
        yield from self._foreign(seen.foreign)
        yield from self._limits(seen.excess, seen.speed_ratio, seen.effort_ratio)
        yield from self._losses(seen)
        yield from self._jumps(seen)

    def _slip(self, column: dict[str, Array], touch: NDArray[np.bool_]) -> tuple[Array, Array, Any]:
        """Return shift [m] and turn [rad] of the target in the TCP frame since lift-off, (n,).

        Third is its pose there at lift-off, None before.
        """
        count = len(touch)
        position, quat_wxyz = column["held_position"], column["held_quat_wxyz"]
        begin, lift_off = 0, self._lift_off
        if lift_off is None:
            off = touch.all(axis=1) & (column["target_support"][:, 0] == 0)
            if not off.any():
                return np.zeros(count), np.zeros(count), None
            begin = int(np.argmax(off))
            lift_off = np.array(position[begin]), np.array(quat_wxyz[begin])
        if self.released:
            return np.zeros(count), np.zeros(count), lift_off
        held = np.arange(count) >= begin
        shift = np.linalg.norm(position - lift_off[0], axis=1)
        # Half the angle between unit quaternions (Kahan): well conditioned for small turns, too.
        start = lift_off[1] * np.where(quat_wxyz @ lift_off[1] < 0, -1.0, 1.0)[:, None]
        apart = np.linalg.norm(quat_wxyz - start, axis=1)
        turn = 4 * np.arctan2(apart, np.linalg.norm(quat_wxyz + start, axis=1))
        return np.where(held, shift, 0.0), np.where(held, turn, 0.0), lift_off

    def _friction_ratio(self, forces: Array, quat_wxyz: Array) -> Array:
        """Return the part of forces (n, 2, 3) along the jaws over that across them, (n, 2).

        Args:
            forces: of both fingers in the world frame [N].
            quat_wxyz: (n, 4) the TCP's turn in the base frame.
        """
        w, x, y, z = quat_wxyz.T
        y_base = np.stack(
            [2 * (x * y - w * z), 1 - 2 * (x * x + z * z), 2 * (y * z + w * x)], axis=1
        )
        across = np.sum(self._R_world_base * y_base[:, None], axis=2)[:, None]
        normal = np.sum(forces * across, axis=2)
        along = _length(forces - normal[:, :, None] * across)
        ratio = np.zeros_like(along)
        np.divide(along, np.abs(normal), out=ratio, where=normal != 0)
        return ratio

    def _rest(self, moving: NDArray[np.bool_]) -> None:
        """Take in whether the target moved, (record steps, physics steps)."""
        for steps in moving:
            last = np.flatnonzero(steps)
            if len(last):
                self.resting_for = (len(steps) - 1 - int(last[-1])) * self._step
            else:
                self.resting_for += len(steps) * self._step

    def _press(self, pressed: NDArray[np.bool_], duration: float) -> None:
        """Take in whether both fingers pressed with the force of a grip, (record steps,)."""
        for holds in pressed.tolist():
            self.pressing_for = self.pressing_for + duration if holds else 0.0

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

    def _losses(self, seen: Seen) -> Iterator[_Breach]:
        """Yield the first step at which a target being carried is lost."""
        if not seen.lifted[-1] or self.released:
            return
        carried = np.repeat(seen.lifted, len(seen.rows) // seen.count)
        lost = carried & ~np.all(seen.touch, axis=1)
        if np.any(lost):
            step = int(np.argmax(lost))
            finger = self._simulation.scene.robot.fingers[int(np.argmin(seen.touch[step]))]
            yield _Breach(step, "dropped", f"{finger} lost the target")
        slipped = carried & (seen.slip_m >= SLIP_LIMIT)
        if np.any(slipped):
            detail = f"slipped {1000 * seen.slip_m.max():.1f} mm"
            yield _Breach(int(np.argmax(slipped)), "dropped", detail)

    def _jumps(self, seen: Seen) -> Iterator[_Breach]:
        """Yield the first step at which the target moved further than its speed explains."""
        position, speed = seen.column["target_position"], seen.speed
        if self._last is not None:
            before, v_before = self._last
            position = np.concatenate([before[None], position])
            speed = np.append(v_before, speed)
        moved = np.linalg.norm(np.diff(position, axis=0), axis=1)
        explained = np.maximum(speed[:-1], speed[1:]) * self._step + JUMP_SLACK
        if np.any(moved > explained):
            held = "dropped" if seen.lifted[-1] else "missed_grasp"
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


def _length(vectors: Array) -> Array:
    """Return the lengths (...) of vectors (..., 3), with the same bits for any number of them."""
    return np.asarray(np.linalg.norm(vectors, axis=-1))


def position_quaternion(T: Array) -> Array:
    """Return position and quat_wxyz (n, 7) of poses (n, 4, 4)."""
    quat_xyzw = Rotation.from_matrix(T[:, :3, :3]).as_quat(canonical=True)
    return np.concatenate([T[:, :3, 3], quat_xyzw[:, [3, 0, 1, 2]]], axis=1)
