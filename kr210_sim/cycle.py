"""The sequencer: one pick and place, stage by stage, from home to home -> CycleRecord."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass

import mujoco
import numpy as np

from kr210_sim.collision import MujocoOracle
from kr210_sim.control import Controller
from kr210_sim.criteria import REST_TIME
from kr210_sim.exceptions import CycleFailure
from kr210_sim.monitor import Monitor
from kr210_sim.offsets import ik_offsets
from kr210_sim.planning import CyclePlan, CyclePlanner
from kr210_sim.record import RECORD_STEP, CycleRecord, Event
from kr210_sim.scene import Target
from kr210_sim.simulation import Simulation
from kr210_sim.task import pick_options, place_options, release_point
from kr210_sim.tracks import Solver
from kr210_sim.trajectory import MotionLimits, time_path

Probe = Callable[[Simulation, str, float], None]
"""Called before every record step with the simulation, the stage and the time [s]: tests disturb
the world here, a viewer may look."""

TRACKING_LIMIT = 0.05
"""Following error of a joint at which the drives stop [rad]."""

ARRIVED = 1e-4
"""A motion has ended when every joint is this close to its end [rad]."""

GRIP_READY = 0.9
"""Share of the grip force at which the lift may start."""

FINGERS_OPEN = 1e-3
"""The gripper counts as open this close to its open position [m]."""

WAIT_LIMIT = 2.0
"""Longest wait for a motion to arrive or the fingers to open or close [s]."""

SETTLE_LIMIT = 8.0
"""Longest wait for a released target to come to rest after the return home [s]."""


@dataclass(frozen=True, kw_only=True)
class CycleSetup:
    """What identifies a cycle and how fast it may be.

    Attributes:
        cycle, episode, seed: for the record.
        limits: joint limits of every motion.
        solver: an IK that takes the place of the analytic one.
    """

    cycle: int
    episode: int
    seed: int
    limits: MotionLimits
    solver: Solver | None = None


class _Cycle:
    """The state of a running cycle."""

    def __init__(
        self, simulation: Simulation, target: Target, setup: CycleSetup, probe: Probe | None
    ) -> None:
        self.simulation, self.target, self.setup, self.probe = simulation, target, setup, probe
        self.scene = simulation.scene
        self.monitor = Monitor(simulation)
        self.controller = Controller(simulation)
        self.stage = "MOVE_TO_PICK"
        self.home_time: float | None = None
        self._chunk = round(RECORD_STEP / simulation.model.opt.timestep)

    def advance(self) -> None:
        """Simulate one record step; stop the cycle if a condition breaks."""
        if self.probe is not None:
            self.probe(self.simulation, self.stage, self.monitor.time)
        commands = self.controller.next(self._chunk)
        rows = self.simulation.step(commands.ctrl)
        if self.simulation.diverged or not np.all(np.isfinite(rows)):
            raise CycleFailure("simulation_diverged", "MuJoCo reports an impossible state")
        self.monitor.observe(rows, commands, self.stage)
        if self.monitor.events:
            raise _Stopped
        error = np.max(np.abs(self.monitor.q - commands.q[-1]))
        if error > TRACKING_LIMIT:
            raise CycleFailure("tracking", f"a joint is {error:.3f} rad from its command")
        if self.home_time is None and self.monitor.time > self.scene.time_limit:
            raise CycleFailure("timeout", f"not home after {self.scene.time_limit:g} s")

    def wait(self, done: Callable[[], bool], limit: float, failure: CycleFailure) -> None:
        """Advance until a condition on the simulation holds, or fail."""
        deadline = self.monitor.time + limit
        while not done():
            if self.monitor.time > deadline:
                raise failure
            self.advance()

    def move(self, plan: CyclePlan, stage: str) -> None:
        """Run one planned motion to its end."""
        self.stage = stage
        path = plan.legs[stage].path
        self.controller.follow(time_path(path, self.setup.limits))
        while self.controller.moving:
            self.advance()
        end = path.end
        self.wait(
            lambda: bool(np.max(np.abs(self.monitor.q - end)) < ARRIVED),
            WAIT_LIMIT,
            CycleFailure(
                "not_home" if stage == "MOVE_HOME" else "tracking", "the arm does not arrive"
            ),
        )

    def run(self, plan: CyclePlan) -> None:
        """Go through the stages; raises CycleFailure or _Stopped where one cannot go on."""
        robot, monitor = self.scene.robot, self.monitor
        self.move(plan, "MOVE_TO_PICK")
        self.move(plan, "APPROACH")
        self.stage = "CLOSE_GRIPPER"
        self.controller.drive_fingers(robot.finger_closed)
        enough = GRIP_READY * robot.grip_force / 2
        self.wait(
            lambda: bool(np.min(monitor.force) >= enough),
            WAIT_LIMIT,
            CycleFailure("missed_grasp", "the fingers do not close on the target"),
        )
        self.move(plan, "LIFT")
        if not monitor.lifted:
            raise CycleFailure("missed_grasp", "the target did not come along")
        for stage in ("WITHDRAW", "MOVE_TO_PLACE", "LOWER"):
            self.move(plan, stage)
        self.stage = "OPEN_GRIPPER"
        monitor.released = True
        self.controller.drive_fingers(robot.finger_open)
        self.wait(
            lambda: self.fingers_open() and not monitor.touching.any(),
            WAIT_LIMIT,
            CycleFailure("not_released", "the fingers do not come free of the target"),
        )
        self.move(plan, "RETREAT")
        self.move(plan, "MOVE_HOME")
        self.home_time = monitor.time
        self.stage = "SETTLE"
        self.wait(
            lambda: monitor.resting_for >= REST_TIME,
            SETTLE_LIMIT,
            CycleFailure("outside_bin", "the target does not come to rest"),
        )

    def fingers_open(self) -> bool:
        opening = self.scene.robot.open_positions
        return bool(np.max(np.abs(self.monitor.finger_position - opening)) < FINGERS_OPEN)

    def home_distance(self) -> float:
        """Return the largest distance of a joint from the home configuration [rad]."""
        return float(np.max(np.abs(self.monitor.q)))

    def final(self) -> dict[str, float]:
        """Return the facts at the end that the verdict needs."""
        simulation, name = self.simulation, self.target.name
        row, columns = simulation.data.sensordata, simulation.columns
        supports = [
            where
            for column, where in columns.items()
            if column == "target_bin" or column.startswith("target_neighbour/")
        ]
        position = row[columns["target_position"]]
        return {
            "fingers_open": float(self.fingers_open()),
            "finger_contacts": float(self.monitor.touching.sum()),
            "resting_for": self.monitor.resting_for,
            "in_place_volume": float(simulation.in_place_volume(name)),
            "supported": float(any(row[where][0] > 0 for where in supports)),
            "home_distance": self.home_distance(),
            "target_x": float(position[0]),
            "target_y": float(position[1]),
            "target_z": float(position[2]),
        }


class _Stopped(Exception):
    """A condition of success broke; the monitor holds the event."""


def run_cycle(
    simulation: Simulation, target: Target, setup: CycleSetup, *, probe: Probe | None = None
) -> CycleRecord:
    """Pick one target and place it in the bin; the robot starts at home, gripper open.

    A cycle that cannot go on ends where it is: the record then holds the event that ended it.

    Args:
        simulation: the world; `target` stands in it.
        target: what to pick.
        setup: identity and limits.
        probe: called before every record step.
    """
    simulation.watch(target)
    cycle = _Cycle(simulation, target, setup, probe)
    record = CycleRecord(
        cycle=setup.cycle,
        episode=setup.episode,
        seed=setup.seed,
        cell=target.cell,
        target={"mass_kg": target.mass, "radius_m": target.radius, "length_m": target.length},
        start=simulation.positions(),
    )
    started = time.perf_counter()
    events: list[Event] = []
    try:
        plan = _plan(cycle, record)
        cycle.run(plan)
    except CycleFailure as failure:
        events.append(
            Event(
                reason=failure.reason,
                stage=failure.stage or cycle.stage,
                time=cycle.monitor.time,
                detail=failure.detail,
            )
        )
    except _Stopped:
        pass
    except mujoco.FatalError as error:
        detail = " ".join(str(error).split())
        events.append(
            Event(
                reason="simulation_diverged",
                stage=cycle.stage,
                time=cycle.monitor.time,
                detail=detail,
            )
        )
    record.events = cycle.monitor.events + events
    record.series = cycle.monitor.series()
    record.final = cycle.final()
    record.home_time = cycle.home_time
    record.wall_clock["wall_time_s"] = time.perf_counter() - started
    return record


def _plan(cycle: _Cycle, record: CycleRecord) -> CyclePlan:
    """Plan the cycle and note in the record what was asked and answered."""
    simulation, target, scene = cycle.simulation, cycle.target, cycle.scene
    started = time.perf_counter()
    oracle = MujocoOracle(simulation, scene, target)
    planner = CyclePlanner(scene.robot, oracle, cycle.setup.solver)
    place = scene.place
    release = release_point(
        place.T_base_place, place.half_size, place.kind, target.length, simulation.placed()
    )
    try:
        plan = planner.plan(
            q_home=np.zeros(6),
            picks=pick_options(target.T_base_target, scene.cell(target.cell).T_base_cell),
            places=place_options(release),
        )
    finally:
        record.wall_clock["plan_time_s"] = time.perf_counter() - started
    record.wall_clock["ik_time_s"] = plan.seconds_per_pose
    record.p_base_release = plan.p_base_release
    record.ik_offset_m, record.ik_offset_rad = ik_offsets(simulation, plan.solved)
    return plan
