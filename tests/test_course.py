"""A solver is asked as in the course, and the arm does what it answered, right or wrong."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from planned import Free, Wall, plan_in

import ik
from kr210_sim.course import LEAST_POSES, MOST_POSES, CourseDriver
from kr210_sim.exceptions import CycleFailure
from kr210_sim.grading.source import SCOPES
from kr210_sim.legs import Hand
from kr210_sim.planning import STOPS


class Solver:
    """The right answers, changed by a function; it remembers what it was asked."""

    def __init__(self, robot, change=lambda q: q):
        self.robot, self.change = robot, change
        self.asked: list[tuple[np.ndarray, np.ndarray]] = []

    def __call__(self, T_base_palm, q_start):
        self.asked.append((T_base_palm, q_start))
        path = ik.best_sequence(
            self.robot.geometry, T_base_palm, self.robot.lower, self.robot.upper,
            self.robot.velocity, q_start,
        )  # fmt: skip
        return self.change(path.q)


@pytest.fixture(scope="module")
def planned(scene):
    return plan_in(scene, Free(), cell=4)


def drive(scene, planned, solver, scope="course", oracle=None):
    return CourseDriver(scene.robot, oracle or Free(), solver, scope=scope, seed=0).drive(planned)


def failure_of(scene, planned, change) -> CycleFailure:
    with pytest.raises(CycleFailure) as caught:
        drive(scene, planned, Solver(scene.robot, change))
    return caught.value


def palm(scene, path_point):
    return ik.forward(scene.robot.geometry, path_point)


def test_two_legs_are_asked_for_and_the_arm_goes_through_the_answers(scene, planned):
    solver = Solver(scene.robot)
    driven = drive(scene, planned, solver)
    assert len(solver.asked) == 2
    for (poses, _), stage in zip(solver.asked, ("MOVE_TO_PICK", "MOVE_TO_PLACE"), strict=True):
        assert LEAST_POSES <= len(poses) <= MOST_POSES
        legs = [leg for motion in driven.motions for leg in motion if leg.stage == stage]
        reached = np.array([palm(scene, leg.path.end) for leg in legs])
        np.testing.assert_allclose(reached, poses, atol=1e-9)
    np.testing.assert_array_equal(solver.asked[0][1], np.zeros(6))
    assert len(driven.solved.q) == sum(len(poses) for poses, _ in solver.asked)


def test_all_legs_are_asked_for_if_wanted(scene, planned):
    solver = Solver(scene.robot)
    driven = drive(scene, planned, solver, "all")
    assert len(solver.asked) == 6
    assert len(driven.solved.q) == sum(len(poses) for poses, _ in solver.asked)


@pytest.mark.parametrize("scope", SCOPES)
def test_a_driven_plan_is_one_way_from_home_to_home(scene, planned, scope):
    driven = drive(scene, planned, Solver(scene.robot), scope)
    legs = [leg for motion in driven.motions for leg in motion]
    for before, after in pairwise(legs):
        np.testing.assert_allclose(before.path.end, after.path.start, atol=1e-9)
    np.testing.assert_allclose(legs[0].path.start, 0.0, atol=1e-12)
    np.testing.assert_allclose(legs[-1].path.end, 0.0, atol=1e-12)
    assert [motion[-1].stage for motion in driven.motions] == ["APPROACH", "LOWER", "MOVE_HOME"]
    for motion in driven.motions:
        assert not {leg.stage for leg in motion[:-1]} & STOPS - {motion[-1].stage}


def test_an_error_of_the_answers_stays_in_the_motion(scene, planned):
    """The straight lines are driven from where the tool is: nothing mends a wrong answer."""
    shift = np.array([0.02, 0.0, 0.0, 0.0, 0.0, 0.0])
    driven = drive(scene, planned, Solver(scene.robot, lambda q: q + shift))
    grasp = next(leg for motion in driven.motions for leg in motion if leg.stage == "APPROACH")
    wanted = next(leg for motion in planned.motions for leg in motion if leg.stage == "APPROACH")
    meant, reached = palm(scene, wanted.path.end), palm(scene, grasp.path.end)
    np.testing.assert_allclose(
        np.linalg.norm(reached[:2, 3] - meant[:2, 3]),
        2 * np.sin(0.01) * np.linalg.norm(meant[:2, 3]),
        rtol=1e-6,
    )


def test_a_change_of_branch_is_moved_as_it_is_answered(scene, planned):
    def flipped(q):
        late = (np.arange(len(q)) >= len(q) // 2)[:, None]
        other = q.copy()
        other[:, [3, 5]] -= np.copysign(np.pi, q[:, [3, 5]])
        other[:, 4] *= -1.0
        return np.where(late, other, q)

    driven = drive(scene, planned, Solver(scene.robot, flipped))
    legs = [leg for motion in driven.motions for leg in motion if "MOVE_TO" in leg.stage]
    assert max(np.max(np.abs(leg.path.end - leg.path.start)) for leg in legs) > 3.0


def test_answers_that_are_none_fail_with_the_stage(scene, planned):
    def missing(q):
        q = q.copy()
        q[3] = np.nan
        return q

    failure = failure_of(scene, planned, missing)
    assert (failure.reason, failure.stage) == ("unreachable", "MOVE_TO_PICK")
    assert "pose 3" in failure.detail
    failure = failure_of(scene, planned, lambda q: q + np.array([0, 0, 7.0, 0, 0, 0]))
    assert failure.reason == "joint_limits"
    assert "joint_3" in failure.detail
    assert failure_of(scene, planned, lambda q: q[:-1]).reason == "bad_ik"


def test_a_way_home_that_is_blocked_fails(scene, planned):
    with pytest.raises(CycleFailure) as caught:
        drive(scene, planned, Solver(scene.robot), oracle=Wall(Hand.RELEASED))
    assert (caught.value.reason, caught.value.stage) == ("no_path", "MOVE_HOME")
