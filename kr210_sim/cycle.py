"""The sequencer: one pick and place, stage by stage, from home to home -> CycleRecord."""

from __future__ import annotations

import time
from collections.abc import Callable

import mujoco
import numpy as np

from kr210_sim.arrays import Array
from kr210_sim.clearance import least_clearance
from kr210_sim.collision import MujocoOracle
from kr210_sim.criteria import HOME_SLACK, LIFT_HEIGHT_LIMIT, REST_TIME
from kr210_sim.exceptions import CycleFailure
from kr210_sim.grip import Grip
from kr210_sim.monitor import position_quaternion
from kr210_sim.motions import CycleSetup, TimedMotion, plan_cycle
from kr210_sim.offsets import ik_offsets
from kr210_sim.record import RECORD_STEP, CycleRecord, Event, Retry, unplayed_record
from kr210_sim.recovery import LOOK_TIME, GraspLost, look_again, way_out
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

REACTION_TIME = 0.1
"""A grasp that fails in the cell may be tried again if the gripper notices within this time [s]."""

IN_CELL = frozenset({"LIFT", "WITHDRAW"})
"""Stages in which a target that is lost falls back into its cell."""

FORGIVABLE = frozenset({"missed_grasp", "dropped"})
"""Reasons for which a grasp may be tried again."""


class _Cycle(Stepping):
    """The state of a running cycle."""

    def __init__(
        self, simulation: Simulation, target: Target, setup: CycleSetup, probe: Probe | None
    ) -> None:
        super().__init__(simulation, setup.variation.delay, probe)
        self.target, self.setup, self.closing = target, setup, False
        self.retries: list[Retry] = []
        self._grip = Grip(simulation, RECORD_STEP)

    @property
    def may_retry(self) -> bool:
        """Whether another try at the grasp is allowed."""
        return len(self.retries) < self.setup.retries

    @property
    def feeling(self) -> bool:
        """Whether every record step may tell the gripper that it has no target."""
        return self.may_retry and self.stage in IN_CELL

    def judge(self, rows: Array) -> None:
        """Stop the cycle if a condition broke, but let the gripper notice first if it may retry.

        What broke is never told to the gripper: it goes by the measurements (n, m) of its own.
        """
        events, feeling = self.monitor.events, self.feeling
        lost = self._grip.feel(rows) if feeling else None
        forgivable = feeling and all(event.reason in FORGIVABLE for event in events)
        if forgivable and lost is not None:
            raise GraspLost(lost)
        if events and not (forgivable and self.monitor.time <= events[0].time + REACTION_TIME):
            raise Stopped

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
            self.advance(1 if self.feeling else self.steps_alike(due))
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
            failure = CycleFailure("missed_grasp", "the target did not come along")
            if not self.may_retry:
                raise failure
            self.monitor.events.append(self.event(failure))
        self.stage = stage

    def event(self, failure: CycleFailure) -> Event:
        """Return a failure as an event of the present stage and time."""
        return Event(
            reason=failure.reason,
            stage=failure.stage or self.stage,
            time=self.monitor.time,
            detail=failure.detail,
        )

    def run(self, motions: list[TimedMotion], again: Callable[[], list[TimedMotion]]) -> None:
        """Go through the stages; raises CycleFailure or Stopped where one cannot go on.

        Args:
            motions: from the start to home.
            again: plans them anew from out of the cell, after a grasp that failed.
        """
        while not self.deliver(motions):
            motions = again()
            self.retries[-1].until = self.monitor.time
            self.monitor.start_over()
        self.home_time = self.monitor.time
        self.stage = "SETTLE"
        self.wait(
            lambda: self.monitor.resting_for >= REST_TIME,
            SETTLE_LIMIT,
            CycleFailure("outside_bin", "the target does not come to rest"),
            least=lambda: REST_TIME - self.monitor.resting_for,
        )

    def deliver(self, motions: list[TimedMotion]) -> bool:
        """Go through the stages to home; False if the grasp failed, and the arm is out again."""
        try:
            for motion in motions:
                self.move(motion)
                if self.stage == "APPROACH":
                    self.grasp()
                elif self.stage == "LOWER":
                    self.release()
        except GraspLost as lost:
            self.give_up(str(lost), motions[0].trajectory.end)
            return False
        return True

    def give_up(self, what: str, q_grasp: Array) -> None:
        """Stop, open, and go back out of the cell for another try.

        Args:
            what: the gripper felt.
            q_grasp: (6,) where the grasp was to be [rad].
        """
        failure = CycleFailure("dropped" if self.monitor.lifted else "missed_grasp", what)
        self.retries.append(Retry(event=self.event(failure)))
        self.stage = "BACK_OUT"
        self.monitor.start_over()
        self.monitor.released = True
        self.controller.brake(self.setup.limits.acceleration)
        while self.controller.moving:
            self.advance()
        self.controller.drive_fingers(self.scene.robot.finger_open)
        stuck = CycleFailure("not_released", "the fingers do not open for another try")
        self.wait(self.fingers_open, WAIT_LIMIT, stuck)
        motion = way_out(self.simulation, self.target, self.setup, self.controller.goal, q_grasp)
        if motion is not None:
            self.move(motion)
        looked = self.monitor.time + LOOK_TIME
        self.wait(lambda: self.monitor.time >= looked, WAIT_LIMIT, stuck)
        self.closing = False
        self._grip.let_go()

    def close_gripper(self) -> None:
        """Start closing, once."""
        if not self.closing:
            self.closing = True
            self.controller.drive_fingers(self.scene.robot.finger_closed, speed=CLOSE_SPEED)

    def grasp(self) -> None:
        """Close on the target until the grip force is there."""
        self.stage = "CLOSE_GRIPPER"
        self.close_gripper()
        failure: Exception = CycleFailure("missed_grasp", "the fingers do not close on the target")
        if self.may_retry:
            failure = GraspLost("the fingers do not press on a target")
        self.wait(
            lambda: self.monitor.pressing_for >= GRIP_STEADY or self._felt_nothing(),
            WAIT_LIMIT,
            failure,
            least=lambda: 0.0 if self.may_retry else GRIP_STEADY - self.monitor.pressing_for,
        )
        if self._felt_nothing():
            raise GraspLost("the fingers have closed on nothing")

    def _felt_nothing(self) -> bool:
        return self.may_retry and self._grip.empty(self.monitor.finger_position)

    def release(self) -> None:
        """Open until the fingers have come free of the target; they go on opening meanwhile."""
        self.stage = "OPEN_GRIPPER"
        self.monitor.released = True
        held = np.array(self.monitor.finger_position)
        self.controller.drive_fingers(self.scene.robot.finger_open)
        # A finger cannot be free before its command is.
        opening = np.sign(self.scene.robot.finger_open - self.scene.robot.finger_closed)
        free = float(held[0] + opening * FINGERS_FREE)
        self.wait(
            lambda: (
                not self.monitor.touching.any()
                and bool(np.min(np.abs(self.monitor.finger_position - held)) > FINGERS_FREE)
            ),
            WAIT_LIMIT,
            CycleFailure("not_released", "the fingers do not come free of the target"),
            least=lambda: self.controller.fingers_need(free),
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
        believed = setup.variation.believed(target, cycle.scene)
        cycle.run(_plan(cycle, record, believed), lambda: _plan_again(cycle, record))
    except CycleFailure as failure:
        events.append(cycle.event(failure))
    except Stopped:
        pass
    except mujoco.FatalError as error:
        detail = " ".join(str(error).split())
        events.append(cycle.event(CycleFailure("simulation_diverged", detail)))
    record.retries = cycle.retries
    record.events = cycle.monitor.events + events
    record.series = cycle.monitor.series()
    record.final = cycle.final()
    record.home_time = cycle.home_time
    record.wall_clock["wall_time_s"] = time.perf_counter() - started
    return record


def _plan_again(cycle: _Cycle, record: CycleRecord) -> list[TimedMotion]:
    """Look at the target again and plan the rest of the cycle from where the arm is."""
    believed, drawn = look_again(cycle.simulation, cycle.target, cycle.setup)
    cycle.retries[-1].drawn = drawn
    return _plan(cycle, record, believed, q_start=cycle.controller.goal)


def _plan(
    cycle: _Cycle, record: CycleRecord, believed: Target, q_start: Array | None = None
) -> list[TimedMotion]:
    """Plan the cycle and add to the record what was asked and answered.

    Args:
        cycle: to plan for.
        record: of it.
        believed: the target as it is believed to be.
        q_start: (6,) where the arm is [rad]; by default where the cycle starts.
    """
    started = time.perf_counter()
    oracle = MujocoOracle(cycle.simulation, cycle.scene, believed)
    clock = record.wall_clock
    try:
        plan, motions = plan_cycle(cycle.simulation, believed, cycle.setup, oracle, q_start=q_start)
    finally:
        clock["plan_time_s"] = clock.get("plan_time_s", 0.0) + time.perf_counter() - started
    clock["ik_time_s"] = plan.seconds_per_pose
    slowed_to = min(motion.slowed_to for motion in motions)
    record.slowed_to = min(slowed_to, record.slowed_to or 1.0)
    record.p_base_release = plan.p_base_release
    record.sampled_motions += plan.sampled_motions
    poses = position_quaternion(plan.solved.T_base_palm @ cycle.scene.robot.T_palm_tcp)
    offset_m, offset_rad = ik_offsets(cycle.simulation, plan.solved)
    record.ik_tcp = np.concatenate([record.ik_tcp, poses])
    record.ik_offset_m = np.concatenate([record.ik_offset_m, offset_m])
    record.ik_offset_rad = np.concatenate([record.ik_offset_rad, offset_rad])
    for legs, motion in zip(plan.motions, motions, strict=True):
        for stage, found in least_clearance(legs, motion.trajectory, oracle).items():
            record.clearance_m[stage] = min(found, record.clearance_m.get(stage, found))
    return motions
