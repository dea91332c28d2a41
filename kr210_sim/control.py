"""Trajectory -> ctrl rows, one per physics step, for the arm servos and the gripper."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from kr210_sim.arrays import Array
from kr210_sim.limits import JERK_TIME
from kr210_sim.robot import ACCELERATION_TIME
from kr210_sim.simulation import Simulation
from kr210_sim.time_law import TimeLaw
from kr210_sim.trajectory import Trajectory

FINGER_QUICKNESS = 5.0
"""Fingers reach their velocity limit this many times sooner than the arm joints theirs."""

BRAKE_TIMES = (0.15, 0.2, 0.3, 0.45, 0.7, 1.0)
"""Times in which to come to rest on the way, the first that the acceleration limits allow [s]."""


@dataclass(frozen=True, kw_only=True)
class Commands:
    """What is commanded over some physics steps.

    Attributes:
        ctrl: (n, nu) actuator commands.
        q: (n, 6) desired arm configuration [rad] at the beginning of each step.
        T_base_tcp: (n, 4, 4) its TCP pose.
    """

    ctrl: Array
    q: Array
    T_base_tcp: Array


class Controller:
    """Feeds the position actuators of one robot.

    An actuator's force is kp (ctrl - q) - kv qd, so ctrl = q_des + (kv/kp) qd_des cancels the drag
    of the velocity term: the servo then follows without a speed-dependent lag. The desired state
    is sampled at the beginning of each step, not one step ahead.

    Args:
        simulation: the world; its present commands are where the first motion begins.
        delay: by which commands reach the servos late [s], whole physics steps.
    """

    def __init__(self, simulation: Simulation, delay: float = 0.0) -> None:
        model, address = simulation.model, simulation.addresses
        self._robot = simulation.scene.robot
        self._step = float(model.opt.timestep)
        self._longest = simulation.scene.time_limit + 1.0
        self._lead = (
            -model.actuator_biasprm[address.arm_ctrl, 2]
            / (model.actuator_gainprm[address.arm_ctrl, 0])
        )
        self._arm_ctrl, self._finger_ctrl, self._nu = (
            address.arm_ctrl,
            address.finger_ctrl,
            model.nu,
        )
        q = np.array(simulation.data.ctrl[address.arm_ctrl])[None]
        self._arm = Commands(ctrl=q, q=q, T_base_tcp=self._robot.forward(q))
        self._finger = np.array([simulation.data.ctrl[address.finger_ctrl]])
        self._trajectory: Trajectory | None = None
        self._arm_done = self._finger_done = 0
        self._on_the_way = np.repeat(self._wanted(1), round(delay / self._step), axis=0)
        self._before = self._arm_done, self._finger_done, self._on_the_way

    @property
    def goal(self) -> Array:
        """Last configuration (6,) that the arm is commanded to [rad]."""
        return np.array(self._arm.q[-1])

    @property
    def moving(self) -> bool:
        """Whether the current trajectory has steps left."""
        return self.left > 0

    @property
    def left(self) -> int:
        """Number of physics steps that the current trajectory has left."""
        return max(0, len(self._arm.q) - self._arm_done)

    def follow(self, trajectory: Trajectory) -> None:
        """Start a trajectory at the next physics step."""
        # A very slow motion is cut where the cycle will have run into its time limit anyway.
        longest = min(trajectory.duration, self._longest)
        count = int(np.ceil(longest / self._step - 1e-9)) + 1
        q, qd = trajectory.motion(np.arange(count) * self._step)
        self._trajectory = trajectory
        self._hold(q, qd)

    def _hold(self, q: Array, qd: Array) -> None:
        """Make configurations (n, 6), one per physics step, and their speeds the next commands."""
        self._arm = Commands(ctrl=q + self._lead * qd, q=q, T_base_tcp=self._robot.forward(q))
        self._arm_done = 0

    def brake(self, acceleration: Array) -> None:
        """Come to rest along the present trajectory, as soon as acceleration limits (6,) allow.

        Time itself slows down, so the arm does not leave the path that was found free.

        Args:
            acceleration: limit of each joint [rad/s^2].
        """
        if self._trajectory is None or not self.moving:
            return
        begin = self._arm_done * self._step
        for duration in BRAKE_TIMES:
            x = np.arange(int(np.ceil(duration / self._step)) + 1) * self._step / duration
            x = np.minimum(x, 1.0)
            rate = 1.0 - x**2 * (3.0 - 2.0 * x)
            q, qd = self._trajectory.motion(begin + duration * (x - x**3 + x**4 / 2.0))
            qd *= rate[:, None]
            if np.all(np.abs(np.diff(qd, axis=0)) <= acceleration * self._step):
                break
        self._hold(q, qd)

    def drive_fingers(self, position: float, *, speed: float = 1.0) -> None:
        """Start moving the finger command to a joint position [m], jerk-limited.

        Args:
            position: of the driven finger joint [m].
            speed: share of the fingers' velocity limit.
        """
        start = float(self._finger[min(self._finger_done, len(self._finger) - 1)])
        velocity = speed * self._robot.finger_velocity
        acceleration = velocity / ACCELERATION_TIME * FINGER_QUICKNESS
        jerk = acceleration / JERK_TIME * FINGER_QUICKNESS
        law = TimeLaw(abs(position - start), velocity, acceleration, jerk)
        times = np.arange(int(np.ceil(law.duration / self._step - 1e-9)) + 1) * self._step
        self._finger = start + np.sign(position - start) * law(times)[0]
        self._finger_done = 0

    def fingers_need(self, position: float) -> float:
        """Return the time until the finger command passes a joint position [s], 0 if never."""
        ahead = self._finger[self._finger_done :]
        passed = (ahead - position) * np.sign(self._finger[-1] - self._finger[0]) >= 0
        return float(np.argmax(passed)) * self._step if passed.any() else 0.0

    def next(self, count: int) -> Commands:
        """Return the commands of the next physics steps; a finished motion holds its end.

        What the servos get, `ctrl`, is what was wanted the delay before.
        """
        self._before = self._arm_done, self._finger_done, self._on_the_way
        wanted = np.concatenate([self._on_the_way, self._wanted(count)])
        ctrl, self._on_the_way = wanted[:count], wanted[count:]
        arm = np.minimum(np.arange(count) + self._arm_done, len(self._arm.q) - 1)
        self._arm_done += count
        self._finger_done += count
        return Commands(ctrl=ctrl, q=self._arm.q[arm], T_base_tcp=self._arm.T_base_tcp[arm])

    def undo(self) -> None:
        """Take the latest commands back: `next` starts where it did then."""
        self._arm_done, self._finger_done, self._on_the_way = self._before

    def _wanted(self, count: int) -> Array:
        """Return ctrl (count, nu) of the next physics steps, as if it arrived at once."""
        arm = np.minimum(np.arange(count) + self._arm_done, len(self._arm.q) - 1)
        finger = np.minimum(np.arange(count) + self._finger_done, len(self._finger) - 1)
        ctrl = np.zeros((count, self._nu))  # actuators of the scene's own stay at zero
        ctrl[:, self._arm_ctrl] = self._arm.ctrl[arm]
        ctrl[:, self._finger_ctrl] = self._finger[finger]
        return ctrl
