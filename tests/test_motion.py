"""The motions of a cycle as they are run: limits, straight lines, corners, speed and stages."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from conftest import standing_target

from kr210_sim.collision import MujocoOracle
from kr210_sim.cycle import CLOSE_EARLY, FINGERS_FREE, TimedMotion
from kr210_sim.limits import MotionLimits
from kr210_sim.motions import timed_motions
from kr210_sim.planning import CyclePlan, CyclePlanner
from kr210_sim.record import RECORD_STEP, STAGES
from kr210_sim.simulation import Simulation
from kr210_sim.task import pick_options, place_options, release_point

pytestmark = pytest.mark.slow

SLACK = 1 + 1e-3
LINES = ("APPROACH", "LIFT", "WITHDRAW", "LOWER", "RETREAT")


def plan_and_oracle(scene, cell: int) -> tuple[CyclePlan, MujocoOracle]:
    simulation = Simulation(scene)
    target = standing_target(scene, cell)
    simulation.add(target)
    oracle = MujocoOracle(simulation, scene, target)
    place = scene.place
    release = release_point(place.T_base_place, place.half_size, place.kind, target.length, [])
    plan = CyclePlanner(scene.robot, oracle).plan(
        q_home=np.zeros(6),
        picks=pick_options(target.T_base_target, scene.cell(cell).T_base_cell),
        places=place_options(release),
    )
    return plan, oracle


@pytest.fixture(scope="module", params=[1, 5, 9])
def planned(request, scene):
    """Return the plan for a cell in the real world, and the oracle of that world."""
    return plan_and_oracle(scene, request.param)


@pytest.fixture(scope="module")
def motions(planned, limits) -> list[TimedMotion]:
    plan, oracle = planned
    return timed_motions(plan.motions, oracle, limits)


def alone(trajectory, index: int) -> tuple[float, float]:
    """Return when the motion of one leg begins and ends to be the only one under way [s]."""
    begin = trajectory.ends[index - 1] if index else 0.0
    last = index + 1 == len(trajectory.starts)
    return begin, trajectory.duration if last else trajectory.starts[index + 1]


def overlaps(trajectory) -> np.ndarray:
    return trajectory.ends[:-1] - trajectory.starts[1:]


# ---- as planned -----------------------------------------------------------------------------


def test_the_motions_hold_all_limits(motions, limits):
    rng = np.random.default_rng(41)
    for motion in motions:
        trajectory = motion.trajectory
        count = int(np.ceil(trajectory.duration * 1000)) + 1
        grid = np.linspace(0.0, trajectory.duration, count)
        t = np.concatenate([grid, rng.uniform(0.0, trajectory.duration, 10 * count)])
        _, qd, qdd, qddd = trajectory.derivatives(t)
        assert np.all(np.abs(qd) <= limits.velocity * SLACK)
        assert np.all(np.abs(qdd) <= limits.acceleration * SLACK)
        assert np.all(np.abs(qddd) <= limits.jerk * SLACK)


def test_the_motions_stay_within_the_joint_limits(motions, robot):
    for motion in motions:
        q = motion.trajectory(np.linspace(0.0, motion.trajectory.duration, 2000))[0]
        assert np.all((q >= robot.lower - 1e-9) & (q <= robot.upper + 1e-9))


def test_motions_join_at_the_stops_from_home_to_home(planned, motions):
    plan, _ = planned
    np.testing.assert_allclose(motions[0].trajectory(np.zeros(1))[0][0], 0.0, atol=1e-9)
    np.testing.assert_allclose(motions[-1].trajectory.end, 0.0, atol=1e-9)
    for one, other in pairwise(motions):
        start = other.trajectory(np.zeros(1))[0][0]
        np.testing.assert_allclose(one.trajectory.end, start, atol=1e-9)
    for motion, legs in zip(motions, plan.motions, strict=True):
        assert motion.stages == tuple(leg.stage for leg in legs)


def test_lines_are_straight_once_no_other_leg_overlaps_them(motions, robot):
    """Above all the last part of the approach, on which the fingers pass the target."""
    seen = []
    for motion in motions:
        for index, stage in enumerate(motion.stages):
            if stage not in LINES:
                continue
            begin, end = alone(motion.trajectory, index)
            T = robot.forward(motion.trajectory(np.linspace(begin, end, 300))[0])
            start, chord = T[0, :3, 3], T[-1, :3, 3] - T[0, :3, 3]
            length = np.linalg.norm(chord)
            if length < 1e-6:
                continue
            seen.append(stage)
            along = (T[:, :3, 3] - start) @ chord / length
            aside = T[:, :3, 3] - start - along[:, None] * chord / length
            assert np.max(np.linalg.norm(aside, axis=1)) < 5e-4, stage
            assert np.all(np.diff(along) > -1e-6), stage
            if stage == "APPROACH":
                assert length > 0.03
    assert {"APPROACH", "LIFT", "WITHDRAW", "LOWER", "RETREAT"} == set(seen)


def test_no_motion_stops_on_its_way_unless_the_limits_or_the_world_force_it(motions, limits):
    for motion in motions:
        trajectory = motion.trajectory
        t = np.linspace(0.0, trajectory.duration, 4001)
        speed = np.max(np.abs(trajectory(t)[1]) / limits.velocity, axis=1)
        forced = trajectory.starts[1:][overlaps(trajectory) < 1e-9]
        ends = np.concatenate([[0.0, trajectory.duration], forced])
        away = np.min(np.abs(t[:, None] - ends), axis=1) > 2e-3
        assert np.all(speed[away] > 0.0)
        assert np.min(speed[np.min(np.abs(t[:, None] - ends), axis=1) > 0.02]) > 1e-5


def test_rounded_corners_are_clear_asked_densely_and_again(planned, motions):
    """At other instants than those that were asked about, and four times as many."""
    plan, oracle = planned
    for motion, legs in zip(motions, plan.motions, strict=True):
        trajectory = motion.trajectory
        for corner, (before, after) in enumerate(pairwise(legs)):
            count = 4 * int(overlaps(trajectory)[corner] * 1000) + 2
            t = np.linspace(trajectory.starts[corner + 1], trajectory.ends[corner], count)
            q = trajectory(t)[0]
            clearance = min(before.clearance, after.clearance) - 1e-4
            assert oracle.blocked(q, hand=after.hand, clearance=clearance) is None


def test_a_cycle_takes_its_time_in_proportion_and_its_way_not_at_all(planned, motions, robot):
    plan, oracle = planned
    for speed in (0.5, 0.3):
        slow_limits = MotionLimits.from_velocity(robot.velocity, speed)
        slow_motions = timed_motions(plan.motions, oracle, slow_limits)
        for quick, slow in zip(motions, [one.trajectory for one in slow_motions], strict=True):
            assert slow.duration * speed == pytest.approx(quick.trajectory.duration, rel=1e-6)
            t = np.linspace(0.0, quick.trajectory.duration, 1000)
            p_slow = robot.forward(slow(t / speed)[0])[:, :3, 3]
            p_quick = robot.forward(quick.trajectory(t)[0])[:, :3, 3]
            np.testing.assert_allclose(p_slow, p_quick, atol=1e-5)


def test_every_stage_of_a_motion_lasts_longer_than_a_record_step(motions):
    for motion in motions:
        t = np.arange(0.0, motion.trajectory.duration, RECORD_STEP)
        parts = [motion.trajectory.part_at(time) for time in t]
        assert parts[0] == 0
        assert set(parts) == set(range(len(motion.stages)))
        assert set(np.diff(parts)) <= {0, 1}


def fingers_of(record) -> np.ndarray:
    """Return the finger positions (n, 2) of a record [m]."""
    columns, first = [], 0
    for name, values in record.start.items():
        columns += [first] if "finger" in name else []
        first += len(values)
    return record.series["qpos"][:, columns]


# ---- as run ---------------------------------------------------------------------------------


def test_every_stage_occurs_once_in_its_order(default_run):
    """SETTLE waits for the target, and takes no time if that has come to rest meanwhile."""
    for score in default_run.scores:
        stages = score.record.series["stage"]
        changes = np.concatenate([[stages[0]], stages[1:][np.diff(stages) != 0]])
        to_home = list(STAGES[: STAGES.index("MOVE_HOME") + 1])
        stages_seen = [STAGES[int(index)] for index in changes]
        assert stages_seen in (to_home, [*to_home, "SETTLE"])


def test_the_fingers_start_to_close_shortly_before_the_arm_stops(default_run, robot):
    for score in default_run.scores:
        series = score.record.series
        stage, time = series["stage"], series["time"]
        approach = np.flatnonzero(stage == STAGES.index("APPROACH"))
        fingers = np.max(np.abs(fingers_of(score.record) - robot.finger_open), axis=1)
        begun = time[np.argmax(fingers > 1e-4)]
        stop = time[approach[-1]]
        assert begun < stop + 3 * RECORD_STEP
        assert begun > stop - CLOSE_EARLY - 3 * RECORD_STEP
        early = approach[time[approach] < stop - CLOSE_EARLY - 3 * RECORD_STEP]
        assert np.max(fingers[early]) < 1e-3


def test_the_retreat_begins_when_the_fingers_are_free_and_not_much_later(default_run):
    for score in default_run.scores:
        series = score.record.series
        opening = np.flatnonzero(series["stage"] == STAGES.index("OPEN_GRIPPER"))
        fingers = fingers_of(score.record)
        opened = np.min(np.abs(fingers[opening] - fingers[opening[0] - 1]), axis=1)
        assert opened[-1] > FINGERS_FREE
        assert np.all(series["finger_force"][opening[-1]] == 0.0)
        touching = np.any(series["finger_force"][opening[:-1]] > 0.0, axis=1)
        assert np.all((opened[:-1] <= FINGERS_FREE) | touching)
