"""Controller, simulation and monitor of a cycle, advanced by record steps."""

from __future__ import annotations

from collections.abc import Callable

import mujoco
import numpy as np

from kr210_sim.arrays import Array
from kr210_sim.control import Controller
from kr210_sim.exceptions import CycleFailure
from kr210_sim.monitor import Monitor
from kr210_sim.record import RECORD_STEP
from kr210_sim.simulation import Simulation

Probe = Callable[[Simulation, str, float], None]
"""Called before every record step with the simulation, the stage and the time [s]: tests disturb
the world here, a viewer may look."""

TRACKING_LIMIT = 0.05
"""Following error of a joint at which the drives stop [rad]."""

LONGEST = 25
"""Record steps that are simulated at once at most; more would save nothing."""


class Stopped(Exception):
    """A condition of success broke; the monitor holds the event."""


class Stepping:
    """What runs a cycle, but for what is decided in it.

    Where nothing is decided between several record steps, they are simulated at once and then
    looked at together, which costs less; if anything happened in them that ends a cycle, that is
    undone and they are simulated one by one.

    Attributes:
        simulation, controller, monitor: of the cycle.
        scene: of the simulation.
        probe: called before every record step, none of which is taken together then.
        stage: under way.
        home_time: when the arm was back at home [s], or None.
    """

    def __init__(self, simulation: Simulation, delay: float, probe: Probe | None) -> None:
        self.simulation, self.probe, self.scene = simulation, probe, simulation.scene
        self.monitor = Monitor(simulation)
        self.controller = Controller(simulation, delay)
        self.stage = "MOVE_TO_PICK"
        self.home_time: float | None = None
        step = float(simulation.model.opt.timestep)
        self._length = round(RECORD_STEP / step)  # physics steps
        self._duration = self._length * step  # as the monitor counts

    def advance(self, count: int = 1) -> None:
        """Simulate record steps in which nothing is decided.

        Raises:
            Stopped: at the end of the first record step in which a condition broke.
            CycleFailure: at the end of the first after which the cycle cannot go on.
        """
        if count > 1 and self.probe is None and self._advance_together(count):
            return
        for _ in range(count):
            self._advance()

    def _advance(self) -> None:
        if self.probe is not None:
            self.probe(self.simulation, self.stage, self.monitor.time)
        commands = self.controller.next(self._length)
        rows = self.simulation.step(commands.ctrl)
        if self.simulation.diverged or not np.all(np.isfinite(rows)):
            raise CycleFailure("simulation_diverged", "MuJoCo reports an impossible state")
        self.monitor.observe(rows, commands, self.stage)
        self.judge(rows)
        error = np.abs(self.monitor.q - commands.q[-1])
        if np.max(error) > TRACKING_LIMIT:
            joint = self.scene.robot.arm_joints[int(np.argmax(error))]
            detail = f"{joint} is {np.max(error):.3f} rad from its command"
            raise CycleFailure("tracking", detail)
        if self.home_time is None and self.monitor.time > self.scene.time_limit:
            raise CycleFailure("timeout", f"not home after {self.scene.time_limit:g} s")

    def judge(self, rows: Array) -> None:
        """Stop the cycle if a condition broke in a record step with measurements (n, m)."""
        if self.monitor.events:
            raise Stopped

    def _advance_together(self, count: int) -> bool:
        """Simulate record steps if nothing happens in them; else change nothing."""
        commands = self.controller.next(count * self._length)
        try:
            rows = self.simulation.step(commands.ctrl)
        except mujoco.FatalError:
            rows = np.empty((0, 0))
        ends = slice(self._length - 1, None, self._length)
        if (
            len(rows) == len(commands.ctrl)
            and not self.simulation.diverged
            and np.all(np.isfinite(rows))
            and np.max(np.abs(self._measured_q(ends) - commands.q[ends])) <= TRACKING_LIMIT
            and (self.home_time is not None or self._within_time(count))
            and self.monitor.observe_calm(rows, commands, self.stage, count)
        ):
            return True
        self.simulation.undo()
        self.controller.undo()
        return False

    def _measured_q(self, which: slice) -> Array:
        """Return arm configurations (n, 6) of the latest physics steps [rad]."""
        return self.simulation.measured[which][:, self.simulation.addresses.arm]

    def _within_time(self, count: int) -> bool:
        """Whether some more record steps surely end within the time limit."""
        return self.monitor.time + (count + 1) * self._duration < self.scene.time_limit

    def steps_alike(self, due: Callable[[float], object]) -> int:
        """Return for how many record steps the same is due, up to the end of the trajectory.

        Args:
            due: tells what is, at a time of the cycle [s].
        """
        count, time = 1, self.monitor.time
        now = due(time)
        while count < min(LONGEST, self.controller.left / self._length):
            time += self._duration
            if due(time) != now:
                break
            count += 1
        return count

    def wait(
        self,
        done: Callable[[], bool],
        limit: float,
        failure: Exception,
        least: Callable[[], float] = lambda: 0.0,
    ) -> None:
        """Advance until a condition on the simulation holds, or fail.

        Args:
            done: the condition.
            limit: longest wait [s].
            failure: raised then.
            least: time that passes at least before the condition can hold [s].
        """
        deadline = self.monitor.time + limit
        while not done():
            if self.monitor.time > deadline:
                raise failure
            sure = min(least(), deadline - self.monitor.time)
            self.advance(max(1, min(LONGEST, int(sure / self._duration))))
