"""The sequencer: one pick and place, stage by stage, from home to home -> CycleRecord."""

from __future__ import annotations

import time

import mujoco
import numpy as np

from kr210_sim.clearance import least_clearance
from kr210_sim.collision import MujocoOracle
from kr210_sim.criteria import HOME_SLACK, LIFT_HEIGHT_LIMIT, REST_TIME
from kr210_sim.exceptions import CycleFailure
from kr210_sim.monitor import position_quaternion
from kr210_sim.motions import CycleSetup, TimedMotion, plan_cycle
from kr210_sim.offsets import ik_offsets
from kr210_sim.record import CycleRecord, Event, unplayed_record
from kr210_sim.scene import Target
from kr210_sim.simulation import Simulation
from kr210_sim.stepping import Probe, Stepping, Stopped

__all__ = ["CycleSetup", "Probe", "TimedMotion", "plan_cycle", "run_cycle"]

ARRIVED = 2e-3
"""A motion has ended when every joint is this close to its end [rad]; a load that the controller
does not know makes the arm sag a little."""

GRIP_STEADY = 0.02
"""The lift may start when both fingers have pressed for this long without losing contact [s]: jaws
that have just struck the target bounce."""

CLOSE_SPEED = 0.9
"""Share of the fingers' velocity limit at which they close: a target that stands nearer to one jaw
is struck by it first, and the rebound is quicker than the command."""

CLOSE_EARLY = 0.08
"""The fingers start to close this long before the arm stops around the target [s]."""

FINGERS_FREE = 6e-3
"""The arm may retreat when both fingers have opened this far and touch nothing [m]."""

FINGERS_OPEN = 1e-3
"""The gripper counts as open this close to its open position [m]."""

WAIT_LIMIT = 2.0
"""Longest wait for a motion to arrive or the fingers to open or close [s]."""

SETTLE_LIMIT = 8.0
"""Longest wait for a released target to come to rest after the return home [s]."""


class _Cycle(Stepping):
    """The state of a running cycle."""

    def __init__(
        self, simulation: Simulation, target: Target, setup: CycleSetup, probe: Probe | None
    ) -> None:
        super().__init__(simulation, setup.variation.delay, probe)
        self.target, self.setup, self.closing = target, setup, False

    def move(self, motion: TimedMotion) -> None:
        """Run one planned motion to its end, stage by stage."""
        begun = self.monitor.time

        def due(time: float) -> tuple[str, bool]:
            """Return the stage at a time, and whether the gripper must be closing then."""
            elapsed = time - begun
            stage = motion.stages[motion.trajectory.part_at(elapsed)]
            return stage, stage == "APPROACH" and motion.trajectory.duration - elapsed < CLOSE_EARLY

        self.controller.follow(motion.trajectory)
        while self.controller.moving:
            stage, closing = due(self.monitor.time)
            self.enter(stage)
            if closing:
                self.close_gripper()
            self.advance(self.steps_alike(due))
        end, stage = motion.trajectory.end, self.stage
        homing = stage == "MOVE_HOME"
        near = HOME_SLACK if homing else ARRIVED
        self.wait(
            lambda: bool(np.max(np.abs(self.monitor.q - end)) <= near),
            WAIT_LIMIT,
            CycleFailure("not_home" if homing else "tracking", "the arm does not arrive"),
        )

    def enter(self, stage: str) -> None:
        """Go on to a stage; a target that did not come along with the lift ends the cycle."""
        if self.stage == "LIFT" and stage != "LIFT" and not self.monitor.lifted:
            if self.monitor.tracking > LIFT_HEIGHT_LIMIT:  # then it is the arm that did not lift
                away = 1000 * self.monitor.tracking
                raise CycleFailure("tracking", f"the TCP is {away:.0f} mm from its command")
            raise CycleFailure("missed_grasp", "the target did not come along")
        self.stage = stage

    def run(self, motions: list[TimedMotion]) -> None:
        """Go through the stages; raises CycleFailure or Stopped where one cannot go on."""
        for motion in motions:
            self.move(motion)
            if self.stage == "APPROACH":
                self.grasp()
            elif self.stage == "LOWER":
                self.release()
        self.home_time = self.monitor.time
        self.stage = "SETTLE"
        self.wait(
            lambda: self.monitor.resting_for >= REST_TIME,
            SETTLE_LIMIT,
            CycleFailure("outside_bin", "the target does not come to rest"),
            least=lambda: REST_TIME - self.monitor.resting_for,
        )

    def close_gripper(self) -> None:
        """Start closing, once."""
        if not self.closing:
            self.closing = True
            self.controller.drive_fingers(self.scene.robot.finger_closed, speed=CLOSE_SPEED)

    def grasp(self) -> None:
        """Close on the target until the grip force is there."""
        self.stage = "CLOSE_GRIPPER"
        self.close_gripper()
        self.wait(
            lambda: self.monitor.pressing_for >= GRIP_STEADY,
            WAIT_LIMIT,
            CycleFailure("missed_grasp", "the fingers do not close on the target"),
        )

    def release(self) -> None:
        """Open until the fingers have come free of the target; they go on opening meanwhile."""
        self.stage = "OPEN_GRIPPER"
        self.monitor.released = True
        held = np.array(self.monitor.finger_position)
        self.controller.drive_fingers(self.scene.robot.finger_open)
        self.wait(
            lambda: (
                not self.monitor.touching.any()
                and bool(np.min(np.abs(self.monitor.finger_position - held)) > FINGERS_FREE)
            ),
            WAIT_LIMIT,
            CycleFailure("not_released", "the fingers do not come free of the target"),
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


def run_cycle(
    simulation: Simulation, target: Target, setup: CycleSetup, *, probe: Probe | None = None
) -> CycleRecord:
    """Pick one target and place it in the bin; the robot starts at rest, gripper open.

    A cycle that cannot go on ends where it is: the record then holds the event that ended it.

    Args:
        simulation: the world; `target` stands in it.
        target: what to pick.
        setup: identity and limits.
        probe: called before every record step.
    """
    setup.variation.prepare(simulation, target)
    cycle = _Cycle(simulation, target, setup, probe)
    record = unplayed_record(target, cycle=setup.cycle, episode=setup.episode, seed=setup.seed)
    record.drawn = setup.variation.drawn
    record.start = simulation.positions()
    started = time.perf_counter()
    events: list[Event] = []
    try:
        cycle.run(_plan(cycle, record))
    except CycleFailure as failure:
        events.append(
            Event(
                reason=failure.reason,
                stage=failure.stage or cycle.stage,
                time=cycle.monitor.time,
                detail=failure.detail,
            )
        )
    except Stopped:
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


def _plan(cycle: _Cycle, record: CycleRecord) -> list[TimedMotion]:
    """Plan the cycle and note in the record what was asked and answered."""
    started = time.perf_counter()
    believed = cycle.setup.variation.believed(cycle.target, cycle.scene)
    oracle = MujocoOracle(cycle.simulation, cycle.scene, believed)
    try:
        plan, motions = plan_cycle(cycle.simulation, believed, cycle.setup, oracle)
    finally:
        record.wall_clock["plan_time_s"] = time.perf_counter() - started
    record.wall_clock["ik_time_s"] = plan.seconds_per_pose
    record.slowed_to = min(motion.slowed_to for motion in motions)
    record.p_base_release = plan.p_base_release
    record.sampled_motions = plan.sampled_motions
    T_base_tcp = plan.solved.T_base_palm @ cycle.scene.robot.T_palm_tcp
    record.ik_tcp = position_quaternion(T_base_tcp)
    record.ik_offset_m, record.ik_offset_rad = ik_offsets(cycle.simulation, plan.solved)
    for legs, motion in zip(plan.motions, motions, strict=True):
        record.clearance_m |= least_clearance(legs, motion.trajectory, oracle)
    return motions
