"""Plans join end to end, keep to straight lines and limits, and fail with the right reason."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

import ik
from kr210_sim.exceptions import CycleFailure
from kr210_sim.planning import CLEARANCE_CELL, CLEARANCE_FREE, MAX_TRIALS, CyclePlanner, Hand
from kr210_sim.task import PLACE_DEPTHS, pick_options, place_options, release_point

STAGES = (
    "MOVE_TO_PICK", "APPROACH", "LIFT", "WITHDRAW",
    "MOVE_TO_PLACE", "LOWER", "RETREAT", "MOVE_HOME",
)  # fmt: skip
STRAIGHT = ("APPROACH", "LIFT", "WITHDRAW", "LOWER", "RETREAT")
FINE = np.linspace(0.0, 1.0, 801)
HOME = np.zeros(6)


class Free:
    """A world without obstacles that remembers what it was asked."""

    def __init__(self) -> None:
        self.asked: list[tuple[np.ndarray, Hand, float]] = []

    def blocked(self, q, *, hand, clearance):
        self.asked.append((np.array(q), hand, clearance))
        return self.answer(hand)

    def answer(self, hand: Hand) -> str | None:
        return None


class Wall(Free):
    """A world in which one kind of motion, or every one, always meets a wall."""

    def __init__(self, hand: Hand | None = None) -> None:
        super().__init__()
        self.hand = hand

    def answer(self, hand: Hand) -> str | None:
        return "a wall" if self.hand in (None, hand) else None


class Doorway(Free):
    """A world that lets a motion through only when it is tried for the n-th time."""

    def __init__(self, hand: Hand, tries: int) -> None:
        super().__init__()
        self.hand, self.left = hand, tries

    def answer(self, hand: Hand) -> str | None:
        self.left -= hand is self.hand
        return "a closed door" if hand is self.hand and self.left > 0 else None


def plan_in(scene, oracle, cell=5, *, robot=None, solver=None, lift_target=0.0, shift_place=0.0):
    T_base_target = scene.stand_in_cell(cell, 0.25)
    T_base_target[2, 3] += lift_target
    place = scene.place
    release = release_point(place.T_base_place, place.half_size, place.kind, 0.25, [])
    release[2] += shift_place
    return CyclePlanner(robot or scene.robot, oracle, solver).plan(
        q_home=HOME,
        picks=pick_options(T_base_target, scene.cell(cell).T_base_cell),
        places=place_options(release),
    )


@pytest.fixture(scope="module")
def plans(scene, turned_scene):
    """Plans for all cells of both scenes, in a free world."""
    return [
        plan_in(world, Free(), cell.number)
        for world in (scene, turned_scene)
        for cell in world.cells
    ]


def failure_of(scene, oracle, **options) -> CycleFailure:
    with pytest.raises(CycleFailure) as caught:
        plan_in(scene, oracle, **options)
    return caught.value


# ---- a plan ---------------------------------------------------------------------------------


def test_a_plan_has_a_leg_for_every_motion_in_order(plans):
    for plan in plans:
        assert tuple(plan.legs) == STAGES
        assert {leg.stage for leg in plan.legs.values() if leg.straight} == set(STRAIGHT)


def test_legs_join_end_to_end_from_home_to_home(plans):
    for plan in plans:
        legs = list(plan.legs.values())
        np.testing.assert_allclose(legs[0].path.start, HOME, atol=1e-9)
        np.testing.assert_allclose(legs[-1].path.end, HOME, atol=1e-9)
        for one, next_one in pairwise(legs):
            np.testing.assert_allclose(one.path.end, next_one.path.start, atol=1e-9)


def test_straight_legs_move_the_tcp_on_a_straight_line_without_turning_it(plans, robot):
    for plan in plans:
        for stage in STRAIGHT:
            T = robot.forward(plan.legs[stage].path(FINE))
            start, chord = T[0, :3, 3], T[-1, :3, 3] - T[0, :3, 3]
            along = (T[:, :3, 3] - start) @ chord / (chord @ chord)
            aside = T[:, :3, 3] - start - along[:, None] * chord
            assert np.max(np.linalg.norm(aside, axis=1)) < 1e-4, stage
            assert np.all(np.diff(along) > -1e-9), stage
            turn = np.linalg.norm(T[:, :3, :3] - T[0, :3, :3], axis=(1, 2)) / np.sqrt(2)
            assert np.max(turn) < 1e-4, stage


def test_no_leg_jumps_and_every_leg_keeps_the_joint_limits(plans, robot):
    for plan in plans:
        for leg in plan.legs.values():
            q = leg.path(FINE)
            assert np.all((q >= robot.lower - 1e-9) & (q <= robot.upper + 1e-9)), leg.stage
            travel = np.sum(np.abs(np.diff(q, axis=0)), axis=0)
            assert np.all(np.abs(np.diff(q, axis=0)) <= 4 * travel.max() / len(FINE)), leg.stage


def test_no_joint_swings_further_than_it_must(plans):
    """No needless turn: within a cycle every joint moves less than one and a half revolutions."""
    for plan in plans:
        q = np.concatenate([leg.path(FINE[::8]) for leg in plan.legs.values()])
        assert np.all(np.ptp(q, axis=0) < 3 * np.pi)


def test_the_tcp_is_where_the_task_wants_it_when_the_fingers_move(plans, scene, turned_scene):
    cells = [(world, cell) for world in (scene, turned_scene) for cell in world.cells]
    for plan, (world, cell) in zip(plans, cells, strict=True):
        T_base_target = world.stand_in_cell(cell.number, 0.25)
        grasp = world.robot.forward(plan.legs["APPROACH"].path.end)
        np.testing.assert_allclose(grasp[:3, 3], T_base_target[:3, 3], atol=1e-9)
        release = world.robot.forward(plan.legs["LOWER"].path.end)
        np.testing.assert_allclose(release[:3, 3], plan.p_base_release, atol=1e-9)


def test_every_pose_that_was_solved_is_reached(plans, robot):
    for plan in plans:
        T = ik.forward(robot.geometry, plan.solved.q)
        np.testing.assert_allclose(T, plan.solved.T_base_palm, atol=1e-12)
        assert len(plan.solved.q) > 50


def test_a_plan_depends_on_nothing_but_its_question(scene):
    first, second = plan_in(scene, Free()), plan_in(scene, Free())
    for stage in STAGES:
        np.testing.assert_array_equal(first.legs[stage].path(FINE), second.legs[stage].path(FINE))


# ---- asking for clearance -------------------------------------------------------------------


def test_every_leg_is_checked_as_it_will_be_run(scene):
    oracle = Free()
    plan = plan_in(scene, oracle)
    hands = {
        "MOVE_TO_PICK": Hand.EMPTY, "APPROACH": Hand.AROUND, "LIFT": Hand.LIFTING,
        "WITHDRAW": Hand.LIFTING, "MOVE_TO_PLACE": Hand.HOLDING, "LOWER": Hand.HOLDING,
        "MOVE_HOME": Hand.RELEASED,
    }  # fmt: skip
    for stage, expected in hands.items():
        path = plan.legs[stage].path
        matches = [
            (hand, clearance)
            for q, hand, clearance in oracle.asked
            if np.allclose(q[0], path.start) and np.allclose(q[-1], path.end)
        ]
        assert matches, stage
        assert any(hand is expected for hand, _ in matches), (stage, matches)
        near = stage in ("APPROACH", "LIFT", "WITHDRAW")
        assert all(c == (CLEARANCE_CELL if near else CLEARANCE_FREE) for _, c in matches), stage


def test_configurations_are_checked_at_most_12_mrad_apart_on_free_moves(scene):
    oracle = Free()
    plan_in(scene, oracle, cell=9)
    for q, hand, _ in oracle.asked:
        if hand in (Hand.EMPTY, Hand.RELEASED):
            assert np.max(np.abs(np.diff(q, axis=0))) <= 0.012


@pytest.mark.parametrize("hand", [Hand.EMPTY, Hand.AROUND, Hand.HOLDING, Hand.RELEASED])
def test_another_way_is_tried_when_the_first_is_blocked(scene, hand):
    oracle = Doorway(hand, tries=4)
    plan = plan_in(scene, oracle)
    assert oracle.left <= 0
    assert tuple(plan.legs) == STAGES


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
    assert tuple(plan.legs) == STAGES
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
    np.testing.assert_allclose(plan.legs["MOVE_HOME"].path.end, HOME, atol=1e-9)
    assert np.all(np.abs(plan.solved.T_base_palm[:, 3, 3] - 1.0) < 1e-12)
