"""Plans join end to end, keep to straight lines and limits, and fail with the right reason."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from conftest import densified
from planned import (
    FINE,
    HOME,
    Detour,
    Doorway,
    Free,
    Wall,
    along,
    failure_of,
    leg_of,
    legs_of,
    plan_in,
    stages_of,
)

import ik
from kr210_sim.criteria import CLEARANCE_FREE
from kr210_sim.planning import (
    CLEARANCE_CELL,
    MAX_TRIALS,
    STOPS,
    Hand,
)
from kr210_sim.task import PLACE_DEPTHS

STAGES = (
    "MOVE_TO_PICK", "APPROACH", "LIFT", "WITHDRAW",
    "MOVE_TO_PLACE", "LOWER", "RETREAT", "MOVE_HOME",
)  # fmt: skip
STRAIGHT = ("APPROACH", "LIFT", "WITHDRAW", "LOWER", "RETREAT")
MOVES = ("MOVE_TO_PICK", "MOVE_TO_PLACE", "MOVE_HOME")
HANDS = {
    "MOVE_TO_PICK": Hand.EMPTY, "APPROACH": Hand.AROUND, "LIFT": Hand.LIFTING,
    "WITHDRAW": Hand.HOLDING, "MOVE_TO_PLACE": Hand.HOLDING, "LOWER": Hand.HOLDING,
    "RETREAT": Hand.RELEASED, "MOVE_HOME": Hand.RELEASED,
}  # fmt: skip
NEAR = ("APPROACH", "LIFT", "WITHDRAW")


@pytest.fixture(scope="module")
def plans(scene, turned_scene):
    """Plans for all cells of both scenes, in a free world."""
    return [
        plan_in(world, Free(), cell.number)
        for world in (scene, turned_scene)
        for cell in world.cells
    ]


# ---- a plan ---------------------------------------------------------------------------------


def test_a_plan_has_legs_for_every_motion_in_order(plans):
    for plan in plans:
        assert stages_of(plan) == STAGES
        for stage in STAGES:
            count = sum(leg.stage == stage for leg in legs_of(plan))
            assert count in ((1, 2) if stage in MOVES else (1,)), stage


def test_the_arm_stops_to_grasp_to_release_and_at_home_and_nowhere_else(plans):
    assert STOPS == {"APPROACH", "LOWER"}
    for plan in plans:
        assert [motion[-1].stage for motion in plan.motions] == ["APPROACH", "LOWER", "MOVE_HOME"]
        for motion in plan.motions:
            assert not any(leg.stage in STOPS for leg in motion[:-1])


def test_no_leg_goes_nowhere(plans):
    for plan in plans:
        assert min(leg.path.length for leg in legs_of(plan)) > 0.005


def test_a_leg_says_what_it_was_checked_for(plans):
    for plan in plans:
        for leg in legs_of(plan):
            assert leg.hand is HANDS[leg.stage]
            assert leg.clearance == (CLEARANCE_CELL if leg.stage in NEAR else CLEARANCE_FREE)


def test_legs_join_end_to_end_from_home_to_home(plans):
    for plan in plans:
        legs = legs_of(plan)
        np.testing.assert_allclose(legs[0].path.start, HOME, atol=1e-9)
        np.testing.assert_allclose(legs[-1].path.end, HOME, atol=1e-9)
        for one, next_one in pairwise(legs):
            np.testing.assert_allclose(one.path.end, next_one.path.start, atol=1e-9)


def test_straight_legs_move_the_tcp_on_a_straight_line_without_turning_it(plans, robot):
    for plan in plans:
        for stage in STRAIGHT:
            T = robot.forward(along(leg_of(plan, stage)))
            start, chord = T[0, :3, 3], T[-1, :3, 3] - T[0, :3, 3]
            share = (T[:, :3, 3] - start) @ chord / (chord @ chord)
            aside = T[:, :3, 3] - start - share[:, None] * chord
            assert np.max(np.linalg.norm(aside, axis=1)) < 1e-4, stage
            assert np.all(np.diff(share) > -1e-9), stage
            turn = np.linalg.norm(T[:, :3, :3] - T[0, :3, :3], axis=(1, 2)) / np.sqrt(2)
            assert np.max(turn) < 1e-4, stage


def test_no_leg_jumps_and_every_leg_keeps_the_joint_limits(plans, robot):
    for plan in plans:
        for leg in legs_of(plan):
            q = along(leg)
            assert np.all((q >= robot.lower - 1e-9) & (q <= robot.upper + 1e-9)), leg.stage
            travel = np.sum(np.abs(np.diff(q, axis=0)), axis=0)
            assert np.all(np.abs(np.diff(q, axis=0)) <= 4 * travel.max() / len(FINE)), leg.stage


def test_no_joint_swings_further_than_it_must(plans):
    """No needless turn: within a cycle every joint moves less than one and a half revolutions."""
    for plan in plans:
        q = np.concatenate([along(leg, FINE[::8]) for leg in legs_of(plan)])
        assert np.all(np.ptp(q, axis=0) < 3 * np.pi)


def test_the_tcp_is_where_the_task_wants_it_when_the_fingers_move(plans, scene, turned_scene):
    cells = [(world, cell) for world in (scene, turned_scene) for cell in world.cells]
    for plan, (world, cell) in zip(plans, cells, strict=True):
        T_base_target = world.stand_in_cell(cell.number, 0.25)
        grasp = world.robot.forward(leg_of(plan, "APPROACH").path.end)
        np.testing.assert_allclose(grasp[:3, 3], T_base_target[:3, 3], atol=1e-9)
        release = world.robot.forward(leg_of(plan, "LOWER").path.end)
        np.testing.assert_allclose(release[:3, 3], plan.p_base_release, atol=1e-9)


def test_every_pose_that_was_solved_is_reached(plans, robot):
    for plan in plans:
        T = ik.forward(robot.geometry, plan.solved.q)
        np.testing.assert_allclose(T, plan.solved.T_base_palm, atol=1e-12)
        assert len(plan.solved.q) > 50


def test_a_plan_depends_on_nothing_but_its_question(scene):
    first, second = plan_in(scene, Free()), plan_in(scene, Free())
    assert stages_of(first) == stages_of(second)
    for one, other in zip(legs_of(first), legs_of(second), strict=True):
        np.testing.assert_array_equal(along(one), along(other))


# ---- asking for clearance -------------------------------------------------------------------


def test_every_leg_is_checked_as_it_will_be_run(scene):
    oracle = Free()
    plan = plan_in(scene, oracle)
    for stage, expected in HANDS.items():
        legs = [leg for leg in legs_of(plan) if leg.stage == stage]
        first, last = legs[0].path.start, legs[-1].path.end
        matches = [
            (hand, clearance)
            for q, hand, clearance in oracle.asked
            if np.allclose(q[0], first) and np.allclose(q[-1], last)
        ]
        assert matches, stage
        assert any(hand is expected for hand, _ in matches), (stage, matches)
        near = stage in NEAR
        assert all(c == (CLEARANCE_CELL if near else CLEARANCE_FREE) for _, c in matches), stage


@pytest.mark.parametrize("hand", [Hand.EMPTY, Hand.HOLDING, Hand.RELEASED])
def test_a_detour_is_two_straight_legs_of_one_stage_checked_on_both(scene, hand):
    """The direct way is closed; the question about the way taken covers both legs."""
    oracle = Detour(hand)
    plan = plan_in(scene, oracle)
    stage = {Hand.EMPTY: "MOVE_TO_PICK", Hand.HOLDING: "MOVE_TO_PLACE"}.get(hand, "MOVE_HOME")
    legs = [leg for leg in legs_of(plan) if leg.stage == stage]
    assert len(legs) == 2
    for leg in legs:
        chord = leg.path.end - leg.path.start
        np.testing.assert_allclose(along(leg), leg.path.start + FINE[:, None] * chord, atol=1e-9)
    checked = densified(oracle.passed)
    for leg in legs:
        for q in along(leg, FINE[::20]):
            assert np.min(np.max(np.abs(checked - q), axis=1)) <= 0.012


def test_the_question_about_a_line_follows_it_to_a_tenth_of_a_millimetre(scene, robot):
    """The oracle is asked about straight pieces in joint space; the path is a curve in it."""
    oracle = Free()
    plan = plan_in(scene, oracle, cell=9)
    for leg in legs_of(plan):
        asked = min((q for q, _, _ in oracle.asked), key=lambda q: gap(q, leg))
        middles = robot.forward((asked[1:] + asked[:-1]) / 2)[:, :3, 3]
        curve = robot.forward(along(leg, np.linspace(0.0, 1.0, 20001)))[:, :3, 3]
        aside = [
            np.min(np.linalg.norm(curve - p, axis=1)) for p in middles[:: len(middles) // 12 + 1]
        ]
        assert max(aside) < 1.5e-4, leg.stage


def gap(q: np.ndarray, leg) -> float:
    """Return how far the ends of some configurations are from those of a leg [rad]."""
    return float(np.max(np.abs(np.stack([q[0] - leg.path.start, q[-1] - leg.path.end]))))


def test_the_clearance_asked_for_is_that_of_the_moves_outside_the_cells(scene):
    oracle = Free()
    plan = plan_in(scene, oracle, clearance=0.05)
    for leg in legs_of(plan):
        assert leg.clearance == (CLEARANCE_CELL if leg.stage in NEAR else 0.05)
    assert {clearance for _, _, clearance in oracle.asked} == {CLEARANCE_CELL, 0.05}


@pytest.mark.parametrize("hand", [Hand.EMPTY, Hand.AROUND, Hand.HOLDING, Hand.RELEASED])
def test_another_way_is_tried_when_the_first_is_blocked(scene, hand):
    oracle = Doorway(hand, tries=4)
    plan = plan_in(scene, oracle)
    assert oracle.left <= 0
    assert stages_of(plan) == STAGES


@pytest.mark.parametrize("hand", [None, Hand.AROUND, Hand.HOLDING, Hand.RELEASED])
def test_a_blocked_world_is_no_path_after_a_bounded_number_of_questions(scene, hand):
    oracle = Wall(hand)
    failure = failure_of(scene, oracle)
    assert failure.reason == "no_path"
    assert "a wall" in failure.detail
    assert len(oracle.asked) < 25 * MAX_TRIALS * len(PLACE_DEPTHS)


# ---- failing --------------------------------------------------------------------------------


def test_a_target_out_of_reach_is_unreachable(scene):
    failure = failure_of(scene, Free(), lift_target=3.0)
    assert (failure.reason, failure.stage) == ("unreachable", "MOVE_TO_PICK")


def test_a_place_out_of_reach_is_unreachable(scene):
    failure = failure_of(scene, Free(), shift_place=6.0)
    assert (failure.reason, failure.stage) == ("unreachable", "MOVE_TO_PLACE")


def limited(robot, joint: int, lower: float, upper: float):
    low, high = robot.lower.copy(), robot.upper.copy()
    low[joint], high[joint] = lower, upper
    return replace(robot, lower=low, upper=high)


def test_a_target_beyond_a_joint_limit_says_so(scene, robot):
    failure = failure_of(scene, Free(), cell=1, robot=limited(robot, 0, -0.1, 0.1))
    assert (failure.reason, failure.stage) == ("joint_limits", "MOVE_TO_PICK")


def test_a_place_beyond_a_joint_limit_says_so(scene, robot):
    failure = failure_of(scene, Free(), robot=limited(robot, 0, -0.9, 0.9))
    assert (failure.reason, failure.stage) == ("joint_limits", "MOVE_TO_PLACE")


# ---- a solver that plugs in -----------------------------------------------------------------


def exact(robot):
    """Return a solver by numbers, which answers like any other that plugs in."""
    return ik.numeric_solver(robot.geometry, robot.lower, robot.upper)


def test_a_plugged_in_solver_plans_the_whole_cycle(scene, robot):
    plan = plan_in(scene, Free(), solver=exact(robot))
    assert stages_of(plan) == STAGES
    T = ik.forward(robot.geometry, plan.solved.q)
    np.testing.assert_allclose(T, plan.solved.T_base_palm, atol=1e-6)


def raising(T, q_start):
    raise RuntimeError("my code\nis broken")


@pytest.mark.parametrize(
    ("solver", "word"),
    [
        pytest.param(raising, "RuntimeError", id="raises"),
        pytest.param(lambda T, q: None, "(N, 6)", id="None"),
        pytest.param(lambda T, q: np.zeros((len(T), 5)), "(N, 6)", id="five angles"),
        pytest.param(lambda T, q: np.zeros((len(T) + 1, 6)), "(N, 6)", id="too many rows"),
        pytest.param(lambda T, q: np.zeros(6), "(N, 6)", id="one row"),
        pytest.param(lambda T, q: np.full((len(T), 6), "x"), "(N, 6)", id="text"),
        pytest.param(lambda T, q: np.full((len(T), 6), 1j), "(N, 6)", id="complex"),
        pytest.param(lambda T, q: np.full((len(T), 6), np.inf), "infinite", id="infinite"),
        pytest.param(lambda T, q: [[0.0] * 6] + [[0.0]] * (len(T) - 1), "solver", id="ragged"),
    ],
)
def test_a_solver_that_does_not_answer_as_agreed_is_a_bad_ik(scene, solver, word):
    failure = failure_of(scene, Free(), solver=solver)
    assert failure.reason == "bad_ik"
    assert word in failure.detail
    assert "\n" not in failure.detail


def test_a_solver_without_an_answer_finds_nothing_reachable(scene):
    failure = failure_of(scene, Free(), solver=lambda T, q: np.full((len(T), 6), np.nan))
    assert failure.reason == "unreachable"


def test_a_solver_whose_answers_break_a_limit_says_so(scene):
    failure = failure_of(scene, Free(), solver=lambda T, q: np.full((len(T), 6), 50.0))
    assert failure.reason == "joint_limits"


def test_a_solver_whose_answers_jump_has_no_path(scene):
    def jumping(T, q_start):
        return np.where(np.arange(len(T))[:, None] % 2, 0.5, -0.5) * np.ones(6)

    assert failure_of(scene, Free(), solver=jumping).reason == "no_path"


def test_a_solver_that_writes_into_its_question_changes_nothing(scene, robot):
    honest = exact(robot)

    def vandal(T, q_start):
        answer = honest(T, q_start)
        T[:] = 0.0
        q_start[:] = 9.0
        return answer

    plan = plan_in(scene, Free(), solver=vandal)
    np.testing.assert_allclose(leg_of(plan, "MOVE_HOME").path.end, HOME, atol=1e-9)
    assert np.all(np.abs(plan.solved.T_base_palm[:, 3, 3] - 1.0) < 1e-12)
