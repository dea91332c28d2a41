"""Whatever breaks in a cycle yields its reason, stage and time: none a success, none a crash."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest
from probes import TARGET, Act, assert_failed, once, set_pad_friction

import ik
from kr210_sim.control import Controller
from kr210_sim.cycle import Probe
from kr210_sim.scene import ROBOT_PREFIX, build_scene, find_scene
from kr210_sim.score import CycleScore
from kr210_sim.simulation import Simulation


def lose_torque(joint: int, left: float = 0.0) -> Act:
    """Leave the motor of an arm joint (1 to 6) some torque [N m]."""

    def act(simulation: Simulation) -> None:
        name = ROBOT_PREFIX + simulation.scene.robot.arm_joints[joint - 1]
        simulation.model.jnt_actfrcrange[simulation.model.joint(name).id] = [-left, left]

    return act


def seize_fingers(simulation: Simulation) -> None:
    """Let both fingers, which are coupled, stick where they are."""
    _seize(simulation, simulation.scene.robot.finger_joint, simulation.scene.robot.mimic_joint)


def seize_uncoupled_finger(simulation: Simulation) -> None:
    """Break the coupling and let the finger that is not driven stick where it is."""
    simulation.data.eq_active[:] = 0
    _seize(simulation, simulation.scene.robot.mimic_joint)


def _seize(simulation: Simulation, *joints: str) -> None:
    for name in joints:
        dof = simulation.model.joint(ROBOT_PREFIX + name).dofadr[0]
        simulation.model.dof_damping[dof] = 1e7


def grease_pads(simulation: Simulation) -> None:
    set_pad_friction(simulation, 1e-6)


def push_target(stage: str, *force: float) -> Probe:
    """Push at the target's centre [N, world frame] for 50 ms, from 0.1 s into a stage."""

    def push(on: bool) -> Act:
        def act(simulation: Simulation) -> None:
            body = simulation.model.body(TARGET).id
            simulation.data.xfrc_applied[body, :3] = force if on else 0.0

        return act

    begin, end = once(stage, push(True), after=0.1), once(stage, push(False), after=0.15)
    return lambda *now: (begin(*now), end(*now))[0]


def assert_not_planned(score: CycleScore, reason: str, stage: str) -> None:
    """The cycle ended before anything moved."""
    assert not score.success
    assert (score.cause.reason, score.cause.stage, score.cause.time) == (reason, stage, 0.0)
    assert score.cause.detail
    assert set(score.conditions.values()) == {None}


# ---- motors ---------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("stage", "joint", "found_in"),
    [
        ("MOVE_TO_PICK", 3, "MOVE_TO_PICK"),
        ("MOVE_TO_PICK", 5, "MOVE_TO_PICK"),
        ("LIFT", 2, "LIFT"),
        ("MOVE_TO_PLACE", 1, "MOVE_TO_PLACE"),
        pytest.param("LIFT", 4, "MOVE_TO_PLACE", marks=pytest.mark.slow),
        pytest.param("MOVE_TO_PLACE", 6, "LOWER", marks=pytest.mark.slow),
        pytest.param("MOVE_HOME", 2, "MOVE_HOME", marks=pytest.mark.slow),
    ],
)
def test_a_joint_without_torque_stops_the_cycle(one_cycle, impatient, stage, joint, found_in):
    """The stage is that in which the arm is noticed to be elsewhere than commanded."""
    score = one_cycle(once(stage, lose_torque(joint)))
    assert_failed(score, "tracking", "returned", found_in)


def test_a_joint_that_is_left_a_little_torque_stops_the_cycle(one_cycle):
    score = one_cycle(once("MOVE_TO_PICK", lose_torque(2, left=50.0)), cell=1)
    assert_failed(score, "tracking", "returned", "MOVE_TO_PICK")
    assert "joint_2" in score.cause.detail


@pytest.mark.slow
def test_a_last_joint_without_torque_does_not_come_home(one_cycle, impatient):
    score = one_cycle(once("LOWER", lose_torque(6)))
    assert_failed(score, "not_home", "returned", "MOVE_HOME")


# ---- fingers --------------------------------------------------------------------------------


@pytest.mark.parametrize("seize", [seize_fingers, seize_uncoupled_finger])
def test_a_finger_that_sticks_open_misses_the_grasp(one_cycle, impatient, seize):
    score = one_cycle(once("MOVE_TO_PICK", seize))
    assert_failed(score, "missed_grasp", "lifted", "CLOSE_GRIPPER")


@pytest.mark.parametrize(
    ("seize", "stage"),
    [
        (seize_fingers, "LIFT"),
        pytest.param(seize_uncoupled_finger, "OPEN_GRIPPER", marks=pytest.mark.slow),
        pytest.param(seize_uncoupled_finger, "LIFT", marks=pytest.mark.slow),
        pytest.param(seize_fingers, "OPEN_GRIPPER", marks=pytest.mark.slow),
    ],
)
def test_a_finger_that_sticks_closed_does_not_release(one_cycle, impatient, seize, stage):
    score = one_cycle(once(stage, seize))
    assert_failed(score, "not_released", "released", "OPEN_GRIPPER")


# ---- friction -------------------------------------------------------------------------------


@pytest.mark.parametrize("stage", ["WITHDRAW", "MOVE_TO_PLACE"])
def test_a_target_that_slides_out_of_the_fingers_is_dropped(one_cycle, stage):
    assert_failed(one_cycle(once(stage, grease_pads)), "dropped", "held", stage)


@pytest.mark.parametrize("stage", [pytest.param("APPROACH", marks=pytest.mark.slow), "LIFT"])
def test_a_target_that_stays_on_its_board_is_not_lifted(one_cycle, stage):
    assert_failed(one_cycle(once(stage, grease_pads)), "missed_grasp", "lifted", "LIFT")


# ---- the target -----------------------------------------------------------------------------


@pytest.mark.parametrize(
    "force",
    [(0.0, 0.0, -600.0), pytest.param((0.0, 1000.0, 0.0), marks=pytest.mark.slow)],
)
def test_a_target_pushed_out_of_the_hand_on_the_way_is_dropped(one_cycle, force):
    score = one_cycle(push_target("MOVE_TO_PLACE", *force))
    assert_failed(score, "dropped", "held", "MOVE_TO_PLACE")
    assert "finger_link lost the target" in score.cause.detail


@pytest.mark.slow
def test_a_target_pushed_less_than_the_grip_holds_is_delivered(one_cycle):
    """The push of the test above is no failure by itself: its effect is."""
    score = one_cycle(push_target("MOVE_TO_PLACE", 0.0, 100.0, 0.0))
    assert score.success, score.cause


# ---- inverse kinematics ---------------------------------------------------------------------


def branch(number: int):
    """Return a solver that always answers one branch of the analytic IK."""
    return lambda T, q_start: ik.inverse(ik.KR210, T).q[:, number]


def swapping(T, q_start):
    """Answer another branch from the middle of a line on."""
    q = ik.inverse(ik.KR210, T).q
    n = np.arange(len(T))
    return q[n, np.where(2 * n > len(T), 1, 0)]


def bending_the_wrist_the_other_way(T, q_start):
    """Take q5 from the other wrist branch, q4 and q6 from this one: a classic slip."""
    return branch(0)(T, q_start) * np.array([1, 1, 1, 1, -1, 1])


def turning_the_base(T, q_start):
    return branch(0)(T, q_start) + np.array([0.02, 0, 0, 0, 0, 0])


def silent(T, q_start):
    return np.full((len(T), 6), np.nan)


def half_answered(T, q_start):
    q = branch(0)(T, q_start)
    q[len(q) // 2, 3] = np.nan
    return q


@pytest.mark.parametrize(
    ("solver", "reason", "stage"),
    [
        (silent, "unreachable", "MOVE_TO_PICK"),
        (half_answered, "bad_ik", "MOVE_TO_PICK"),
        (branch(4), "joint_limits", "MOVE_TO_PICK"),
        (swapping, "no_path", "MOVE_TO_PICK"),
        (bending_the_wrist_the_other_way, "no_path", "APPROACH"),
        (turning_the_base, "no_path", "APPROACH"),
    ],
)
def test_a_solver_with_a_wrong_answer_ends_the_cycle_before_it_begins(
    one_cycle, solver, reason, stage
):
    assert_not_planned(one_cycle(solver=solver), reason, stage)


def test_a_wrong_answer_that_keeps_clear_of_everything_misses_the_grasp(one_cycle, impatient):
    """The tool goes in 0.15 m too high; but for that the motion is as it should be."""

    def above(T, q_start):
        T[:, 2, 3] += 0.15
        return branch(0)(T, q_start)

    score = one_cycle(solver=above)
    assert_failed(score, "missed_grasp", "lifted", "CLOSE_GRIPPER")
    assert np.min(score.ik_offset_m) > 0.149


# ---- the planner ----------------------------------------------------------------------------


def test_a_planner_that_gives_up_finds_no_path(one_cycle, robot, spec, monkeypatch):
    """In `column` every cheap move is blocked, and a handful of samples finds no other."""
    monkeypatch.setattr("kr210_sim.task.PLACE_DEPTHS", (0.35,))
    monkeypatch.setattr("kr210_sim.planning.MAX_TRIALS", 2)
    monkeypatch.setattr("kr210_sim.legs.CYCLE_CONFIGURATIONS", 5)
    score = one_cycle(world=build_scene(find_scene("column"), robot, spec))
    assert_not_planned(score, "no_path", "MOVE_HOME")
    assert "column" in score.cause.detail


# ---- the simulation -------------------------------------------------------------------------


@pytest.mark.parametrize(
    "stage", ["MOVE_TO_PICK", pytest.param("MOVE_TO_PLACE", marks=pytest.mark.slow)]
)
@pytest.mark.parametrize("value", [np.nan, np.inf, 1e12])
@pytest.mark.parametrize("whose", ["arm", "target"])
def test_a_diverging_simulation_is_noticed(one_cycle, whose, value, stage):
    def blow_up(simulation: Simulation) -> None:
        if whose == "arm":
            simulation.data.qvel[simulation.addresses.arm_dof[0]] = value
        else:
            simulation.data.joint(TARGET).qvel[0] = value

    score = one_cycle(once(stage, blow_up, after=0.1))
    assert_failed(score, "simulation_diverged", "returned", stage)


def test_a_fatal_error_of_mujoco_is_a_diverged_simulation(one_cycle, monkeypatch):
    def die(self: Controller, _count: int) -> None:
        raise mujoco.FatalError("engine error: stack overflow")

    monkeypatch.setattr(Controller, "next", die)
    score = one_cycle()
    assert not score.success
    assert score.cause.reason == "simulation_diverged"
    assert "stack overflow" in score.cause.detail
