"""Commands follow one law, step by step, and the arm follows the commands."""

from __future__ import annotations

import numpy as np
import pytest

from kr210_sim.control import Controller
from kr210_sim.mjcf import TIMESTEP
from kr210_sim.path import Path
from kr210_sim.scene import ROBOT_PREFIX
from kr210_sim.simulation import Simulation
from kr210_sim.trajectory import time_path

SWING = np.array([0.9, -0.3, 0.4, 1.5, 0.8, -2.0])  # in free air, from home


@pytest.fixture
def simulation(scene):
    return Simulation(scene)


@pytest.fixture(scope="module")
def trajectory(limits):
    return time_path(Path.straight(np.zeros(6), SWING), limits)


def all_of(controller: Controller, count: int, chunk: int) -> tuple[np.ndarray, np.ndarray]:
    """Return ctrl and q of the next steps, asked for in chunks."""
    parts = [controller.next(chunk) for _ in range(count // chunk)]
    return np.concatenate([x.ctrl for x in parts]), np.concatenate([x.q for x in parts])


def test_the_command_is_the_desired_angle_plus_kv_over_kp_times_its_speed(simulation, trajectory):
    controller, model = Controller(simulation), simulation.model
    controller.follow(trajectory)
    commands = controller.next(400)
    q, qd, _ = trajectory(np.arange(400) * TIMESTEP)
    servo = simulation.addresses.arm_ctrl
    lead = -model.actuator_biasprm[servo, 2] / model.actuator_gainprm[servo, 0]
    np.testing.assert_allclose(commands.ctrl[:, servo], q + lead * qd, atol=1e-12)
    np.testing.assert_allclose(commands.q, q, atol=1e-12)
    np.testing.assert_allclose(commands.T_base_tcp, simulation.scene.robot.forward(q), atol=1e-12)


def test_commands_do_not_depend_on_how_many_are_asked_for_at_once(scene, trajectory):
    answers = []
    for chunk in (1, 20, 400):
        controller = Controller(Simulation(scene))
        controller.follow(trajectory)
        controller.drive_fingers(scene.robot.finger_closed)
        answers.append(all_of(controller, 400, chunk))
    for ctrl, q in answers[1:]:
        np.testing.assert_array_equal(ctrl, answers[0][0])
        np.testing.assert_array_equal(q, answers[0][1])


def test_a_finished_motion_holds_its_end(simulation, trajectory):
    controller = Controller(simulation)
    controller.follow(trajectory)
    steps = 0
    while controller.moving:
        controller.next(20)
        steps += 20
    assert abs(steps * TIMESTEP - trajectory.duration) <= 21 * TIMESTEP
    held = controller.next(50)
    np.testing.assert_allclose(held.q, np.tile(SWING, (50, 1)), atol=1e-9)
    np.testing.assert_allclose(held.ctrl[:, simulation.addresses.arm_ctrl], held.q, atol=1e-6)


def test_a_controller_starts_where_the_servos_are(simulation):
    commands = Controller(simulation).next(5)
    np.testing.assert_array_equal(commands.ctrl, np.tile(simulation.data.ctrl, (5, 1)))


def test_fingers_are_driven_smoothly_one_way_and_within_their_speed(simulation):
    robot, controller = simulation.scene.robot, Controller(simulation)
    controller.drive_fingers(robot.finger_closed)
    finger = controller.next(2000).ctrl[:, simulation.addresses.finger_ctrl]
    assert finger[0] == pytest.approx(robot.finger_open)
    assert finger[-1] == pytest.approx(robot.finger_closed)
    speed = np.diff(finger) / TIMESTEP
    assert np.all(speed >= -1e-9)
    assert np.max(speed) <= robot.finger_velocity * (1 + 1e-6)


def test_fingers_turned_back_on_their_way_start_where_they_are(simulation):
    robot, controller = simulation.scene.robot, Controller(simulation)
    controller.drive_fingers(robot.finger_closed)
    last = controller.next(100).ctrl[-1, simulation.addresses.finger_ctrl]
    assert robot.finger_open < last < robot.finger_closed
    controller.drive_fingers(robot.finger_open)
    finger = controller.next(2000).ctrl[:, simulation.addresses.finger_ctrl]
    assert abs(finger[0] - last) <= robot.finger_velocity * TIMESTEP
    assert finger[-1] == pytest.approx(robot.finger_open)


def test_fingers_and_arm_do_not_disturb_each_other(simulation, trajectory):
    controller = Controller(simulation)
    controller.follow(trajectory)
    before = controller.next(100)
    controller.drive_fingers(simulation.scene.robot.finger_closed)
    after = controller.next(100)
    q, _, _ = trajectory(np.arange(200) * TIMESTEP)
    np.testing.assert_allclose(np.concatenate([before.q, after.q]), q, atol=1e-12)


def test_the_tcp_follows_a_swing_at_full_speed_within_two_millimetres(simulation, trajectory):
    """Over the whole swing, without saturating a motor."""
    robot, data = simulation.scene.robot, simulation.data
    controller = Controller(simulation)
    controller.follow(trajectory)
    worst, effort = 0.0, np.zeros(6)
    site = data.site(ROBOT_PREFIX + "tcp")
    while controller.moving:
        commands = controller.next(10)
        simulation.step(commands.ctrl[:9])
        simulation.step(commands.ctrl[9:])  # data now holds the state before the last step
        T = simulation.scene.T_world_base @ commands.T_base_tcp[-1]
        worst = max(worst, float(np.linalg.norm(site.xpos - T[:3, 3])))
        force = data.qfrc_actuator[simulation.addresses.arm_dof]
        effort = np.maximum(effort, np.abs(force) / robot.effort)
    assert worst < 2e-3
    assert np.all(effort < 0.99)
    np.testing.assert_allclose(data.qpos[simulation.addresses.arm], SWING, atol=1e-3)
