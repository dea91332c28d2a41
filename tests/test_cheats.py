"""Each way to fake a success, through the real sequencer in the simulator, fails with its reason.

A probe disturbs the world before every record step. It knows nothing of the scoring.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from probes import TARGET, Act, assert_failed, once, throughout

from kr210_sim.criteria import CONDITIONS
from kr210_sim.simulation import Simulation


def move_target(simulation: Simulation, p_base: np.ndarray) -> None:
    """Put the target, upright and at rest, somewhere else."""
    joint = simulation.data.joint(TARGET)
    T_world_base = simulation.scene.T_world_base
    joint.qpos[:3] = T_world_base[:3, :3] @ p_base + T_world_base[:3, 3]
    joint.qpos[3:] = [1.0, 0.0, 0.0, 0.0]
    joint.qvel[:] = 0.0


def into_the_bin(simulation: Simulation) -> None:
    T_base_place = simulation.scene.place.T_base_place
    move_target(simulation, T_base_place[:3, 3] + [0.0, 0.0, -0.2])


def shift_target(*offset: float) -> Act:
    def act(simulation: Simulation) -> None:
        simulation.data.joint(TARGET).qpos[:3] += offset

    return act


def move_shelf(simulation: Simulation, *, y: float = 0.0, z: float = 0.0) -> None:
    simulation.model.opt.enableflags = 0  # with sleep enabled static bodies stay where they were
    simulation.model.body("shelf").pos[1:] += [y, z]


def jam_fingers(position: str) -> Act:
    """Tie the finger command to the open or closed end of its range."""

    def act(simulation: Simulation) -> None:
        ctrlrange = simulation.model.actuator_ctrlrange[simulation.addresses.finger_ctrl]
        ctrlrange[:] = ctrlrange[0 if position == "open" else 1]

    return act


def creep(limit: float) -> Act:
    """Let the servo of joint 1 stray a little further from its command, up to a limit [rad]."""

    def act(simulation: Simulation) -> None:
        model, actuator = simulation.model, simulation.addresses.arm_ctrl[0]
        gain = model.actuator_gainprm[actuator, 0]
        stray = min(model.actuator_biasprm[actuator, 0] / gain + 5e-5, limit)
        model.actuator_biasprm[actuator, 0] = stray * gain

    return act


# ---- the grasp ------------------------------------------------------------------------------


def test_a_target_teleported_into_the_bin_before_the_grasp_is_a_missed_grasp(one_cycle, impatient):
    score = one_cycle(once("CLOSE_GRIPPER", into_the_bin))
    assert_failed(score, "missed_grasp", "lifted", "CLOSE_GRIPPER")


def test_a_target_teleported_into_the_bin_from_the_hand_is_dropped(one_cycle):
    score = one_cycle(once("MOVE_TO_PLACE", into_the_bin, after=0.1))
    assert_failed(score, "dropped", "held", "MOVE_TO_PLACE")


def test_fingers_that_close_beside_the_target_miss_the_grasp(one_cycle, impatient):
    score = one_cycle(once("CLOSE_GRIPPER", shift_target(0.0, 0.25, 0.0)))
    assert_failed(score, "missed_grasp", "lifted", "CLOSE_GRIPPER")


def test_fingers_that_never_close_miss_the_grasp(one_cycle, impatient):
    score = one_cycle(once("MOVE_TO_PICK", jam_fingers("open")))
    assert_failed(score, "missed_grasp", "lifted", "CLOSE_GRIPPER")


def test_a_target_dragged_along_its_board_is_not_lifted(one_cycle):
    def hold_down(simulation: Simulation) -> None:
        joint = simulation.data.joint(TARGET)
        joint.qpos[2] = min(joint.qpos[2], simulation.model.body(TARGET).pos[2] + 0.004)
        joint.qvel[2] = 0.0

    score = one_cycle(throughout("LIFT WITHDRAW", hold_down))
    assert not score.success
    assert not score.conditions["lifted"]
    assert score.cause.reason in ("missed_grasp", "collision")


# ---- the carry ------------------------------------------------------------------------------


@pytest.mark.slow
def test_a_target_that_shifts_in_the_fingers_is_dropped(one_cycle):
    def shift(simulation: Simulation) -> None:
        axis = simulation.data.body(TARGET).xmat.reshape(3, 3)[:, 2]
        simulation.data.joint(TARGET).qpos[:3] += 0.006 * axis

    score = one_cycle(once("MOVE_TO_PLACE", shift, after=0.2))
    assert_failed(score, "dropped", "held", "MOVE_TO_PLACE")
    assert "slipped" in score.cause.detail
    assert score.grasp_slip_m >= 0.005


@pytest.mark.slow
@pytest.mark.parametrize("stage", ["WITHDRAW", "MOVE_TO_PLACE", "LOWER"])
def test_fingers_that_open_on_the_way_drop_the_target(one_cycle, stage):
    assert_failed(one_cycle(once(stage, jam_fingers("open"))), "dropped", "held", stage)


# ---- contact --------------------------------------------------------------------------------


@pytest.mark.parametrize("y", [0.3, -0.3])
def test_a_robot_that_touches_the_shelf_has_collided(one_cycle, y):
    score = one_cycle(once("APPROACH", lambda simulation: move_shelf(simulation, y=y)))
    assert_failed(score, "collision", "clean", "APPROACH")
    assert "shelf" in score.cause.detail


def test_a_robot_that_touches_itself_has_collided(one_cycle):
    def push_wrist_into_forearm(simulation: Simulation) -> None:
        simulation.model.body_pos[simulation.body_id("link_5")] -= [0.5, 0.0, 0.0]

    score = one_cycle(once("MOVE_TO_PICK", push_wrist_into_forearm))
    assert_failed(score, "collision", "clean", "MOVE_TO_PICK")
    assert score.cause.detail.count("link_") == 2
    assert "finger" not in score.cause.detail


def test_a_held_target_that_touches_the_shelf_has_collided(one_cycle):
    def lower_the_board_above(simulation: Simulation) -> None:
        top = simulation.data.body(TARGET).xpos[2] + 0.125
        board = simulation.data.geom("shelf_board_3").xpos[2] - 0.05
        move_shelf(simulation, z=top - board - 0.002)

    score = one_cycle(once("WITHDRAW", lower_the_board_above))
    assert_failed(score, "collision", "clean", "WITHDRAW")
    assert "shelf" in score.cause.detail
    assert TARGET in score.cause.detail


@pytest.mark.slow
def test_a_target_thrown_over_the_rim_onto_the_floor_has_collided_with_it(one_cycle):
    def throw(simulation: Simulation) -> None:
        simulation.data.joint(TARGET).qvel[:3] = [-1.0, 0.0, 5.0]

    score = one_cycle(once("MOVE_HOME", throw, after=0.4))
    assert_failed(score, "collision", "placed", score.cause.stage)
    assert TARGET in score.cause.detail
    assert "world" in score.cause.detail


# ---- the limits -----------------------------------------------------------------------------


def test_a_joint_beyond_its_limit_is_noticed(one_cycle):
    def turn_wrist(simulation: Simulation) -> None:
        robot, address = simulation.scene.robot, simulation.addresses
        simulation.data.qpos[address.arm[5]] = robot.upper[5] + 0.002

    score = one_cycle(once("MOVE_TO_PICK", turn_wrist))
    assert_failed(score, "limits_exceeded", "within_limits", "MOVE_TO_PICK")
    assert "joint_6" in score.cause.detail
    assert "position" in score.cause.detail


def test_a_joint_faster_than_its_limit_is_noticed(one_cycle):
    def spin_wrist(simulation: Simulation) -> None:
        robot, address = simulation.scene.robot, simulation.addresses
        simulation.data.qvel[address.arm_dof[5]] = 1.05 * robot.velocity[5]

    score = one_cycle(once("MOVE_TO_PICK", spin_wrist))
    assert_failed(score, "limits_exceeded", "within_limits", "MOVE_TO_PICK")
    assert "joint_6" in score.cause.detail


def test_a_saturated_motor_is_noticed(one_cycle):
    def load_palm(simulation: Simulation) -> None:
        palm = simulation.body_id(simulation.scene.robot.palm)
        simulation.model.body_mass[palm] = 600.0

    score = one_cycle(once("MOVE_TO_PICK", load_palm))
    assert_failed(score, "limits_exceeded", "within_limits", "MOVE_TO_PICK")
    assert "motor saturated" in score.cause.detail


# ---- the release and the bin ----------------------------------------------------------------


@pytest.mark.slow
def test_a_gripper_that_never_opens_has_not_released(one_cycle, impatient):
    score = one_cycle(once("OPEN_GRIPPER", jam_fingers("closed")))
    assert_failed(score, "not_released", "released", "OPEN_GRIPPER")


@pytest.mark.slow
def test_a_gripper_that_closes_again_has_not_released(one_cycle):
    """Forced shut faster than the fingers may move, it is stopped for that first."""
    score = one_cycle(once("MOVE_HOME", jam_fingers("closed")))
    assert not score.success
    assert score.cause.reason in ("not_released", "limits_exceeded")


@pytest.mark.slow
def test_a_target_that_ends_on_the_rim_is_outside_the_bin(one_cycle):
    def onto_the_rim(simulation: Simulation) -> None:
        place = simulation.scene.place
        rim = [0.0, 0.4673, place.half_size[2] + 0.126]
        move_target(simulation, place.T_base_place[:3, 3] + rim)

    score = one_cycle(once("MOVE_HOME", onto_the_rim, after=0.3))
    assert_failed(score, "outside_bin", "placed", score.cause.stage)
    assert score.place_offset_m is None


@pytest.mark.slow
def test_a_target_that_keeps_spinning_in_the_bin_is_not_placed(one_cycle, impatient):
    def spin(simulation: Simulation) -> None:
        simulation.data.joint(TARGET).qvel[3:] = [0.0, 0.0, 0.5]

    score = one_cycle(throughout("MOVE_HOME SETTLE", spin))
    assert_failed(score, "outside_bin", "placed", "SETTLE")


@pytest.mark.slow
def test_a_target_that_hangs_in_the_air_of_the_bin_is_not_supported(one_cycle):
    def hang(simulation: Simulation) -> None:
        into_the_bin(simulation)
        body = simulation.model.body(TARGET)
        simulation.data.xfrc_applied[body.id, 2] = 9.81 * body.mass[0]

    score = one_cycle(once("MOVE_HOME", hang))
    assert_failed(score, "outside_bin", "placed", score.cause.stage)


def test_a_target_gone_astray_and_teleported_into_the_bin_is_no_success(one_cycle):
    astray = once("RETREAT", lambda simulation: move_target(simulation, np.array([0.0, -3.0, 8.0])))
    back = once("RETREAT", into_the_bin, after=0.2)
    score = one_cycle(lambda *now: (astray(*now), back(*now)))
    assert not score.success


# ---- the end --------------------------------------------------------------------------------


@pytest.mark.slow
def test_an_arm_that_leaves_home_again_is_not_home(one_cycle):
    """The target is kept spinning until the arm has strayed, so that the cycle does not end."""
    settling: list[float] = []

    def probe(simulation: Simulation, stage: str, time: float) -> None:
        if stage == "SETTLE":
            settling.append(time)
            creep(2e-3)(simulation)
        if stage in ("MOVE_HOME", "SETTLE") and len(settling) < 60:
            simulation.data.joint(TARGET).qvel[5] = 0.5

    score = one_cycle(probe)
    assert_failed(score, "not_home", "returned", "SETTLE")


def test_an_arm_that_stops_short_of_home_is_not_home(one_cycle, impatient):
    score = one_cycle(throughout("MOVE_HOME", creep(2e-3)))
    assert_failed(score, "not_home", "returned", "MOVE_HOME")


@pytest.mark.slow
def test_an_arm_half_a_milliradian_from_home_is_home(one_cycle, impatient):
    score = one_cycle(throughout("MOVE_HOME", creep(5e-4)))
    assert score.success, score.cause


def test_a_cycle_beyond_the_time_limit_is_too_late(one_cycle, scene):
    score = one_cycle(world=replace(scene, time_limit=1.0))
    assert_failed(score, "timeout", "in_time", score.cause.stage)
    assert 1.0 < score.cause.time < 1.03


def test_every_condition_is_faked_by_some_test_of_this_file():
    with open(__file__, encoding="utf-8") as file:
        text = file.read()
    for condition, reason in CONDITIONS.items():
        assert f'"{reason}", "{condition}"' in text, condition
