"""The TCP keeps its top speed, and no motion asks more of a grasp than friction gives."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest
from conftest import standing_target

from kr210_sim.collision import MujocoOracle
from kr210_sim.cycle import CycleSetup, plan_cycle, run_cycle
from kr210_sim.exceptions import CycleFailure
from kr210_sim.gripper import JAW_TILT, PAD_FRICTION, PAD_MARK
from kr210_sim.path import Path
from kr210_sim.randomize import read_randomization
from kr210_sim.score import score_cycle
from kr210_sim.simulation import Simulation
from kr210_sim.tcp_limits import GRIP_SAFETY, TCP_SPEED, TcpLimits, grip_load
from kr210_sim.trajectory import time_path
from kr210_sim.variation import vary

CARRY = 1
"""Index of the motion that carries the target, among the three of a cycle."""


def planned(scene, limits, *, mass=1.0, cell=7, tcp_limits=None):
    simulation = Simulation(scene)
    target = standing_target(scene, cell, mass=mass)
    simulation.add(target)
    setup = CycleSetup(
        cycle=0, episode=0, seed=0, limits=limits, tcp_limits=tcp_limits or TcpLimits()
    )
    return plan_cycle(
        simulation, target, setup, MujocoOracle(simulation, simulation.scene, target)
    )[1]


def tcp_motion(robot, trajectory):
    """Return the tool's orientation (n, 3, 3) and the TCP's velocity and acceleration (n, 3)."""
    t, step = np.linspace(0.0, trajectory.duration, 4000, retstep=True)
    T = robot.forward(trajectory(t)[0])
    velocity = np.gradient(T[:, :3, 3], step, axis=0)
    return T[:, :3, :3], velocity, np.gradient(velocity, step, axis=0)


# ---- the load on a grasp --------------------------------------------------------------------


@pytest.mark.parametrize(
    ("acceleration", "load"),
    [
        ((0.0, 0.0, -9.81), 0.0),  # falling freely
        ((0.0, 0.0, 0.0), 9.81),  # at rest, the weight along the pads
        ((3.0, 0.0, 4.0 - 9.81), 5.0),  # along the pads, any direction
        ((0.0, 7.0, -9.81), 7.0),  # across them
        ((0.0, -7.0, -9.81), 7.0),
        ((3.0, 7.0, 4.0 - 9.81), 12.0),
    ],
)
def test_the_load_is_what_the_pads_must_press_and_rub(acceleration, load):
    found = grip_load(np.eye(3)[None], np.array([acceleration]), 2.0)
    np.testing.assert_allclose(found, 2.0 * load, atol=1e-12)


def test_the_load_follows_the_tool_as_it_turns():
    """With the closing direction upright, the weight is borne by one finger alone."""
    upright = np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])
    tilted = np.array([[1.0, 0, 0], [0, 0.6, -0.8], [0, 0.8, 0.6]])
    rest = np.zeros((2, 3))
    found = grip_load(np.stack([upright, tilted]), rest, 1.0)
    np.testing.assert_allclose(found, [9.81, 9.81 * 1.4], atol=1e-12)


# ---- motions --------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def light(scene, limits):
    return planned(scene, limits)


def test_no_limit_touches_a_cycle_with_the_default_target(light, robot):
    assert [motion.slowed_to for motion in light] == [1.0, 1.0, 1.0]
    for motion in light:
        _, velocity, _ = tcp_motion(robot, motion.trajectory)
        assert np.max(np.linalg.norm(velocity, axis=1)) < TCP_SPEED


def test_a_heavy_target_slows_the_motion_that_carries_it_and_no_other(scene, limits, robot, light):
    heavy = planned(scene, limits, mass=16.6)
    for index, (one, other) in enumerate(zip(light, heavy, strict=True)):
        quick, slow = one.trajectory.duration, other.trajectory.duration
        assert slow * other.slowed_to == pytest.approx(quick, rel=1e-5)
        assert (other.slowed_to < 1.0) == (index == CARRY)
    R, _, acceleration = tcp_motion(robot, heavy[CARRY].trajectory)
    load = np.max(grip_load(R[2:-2], acceleration[2:-2], 16.6))
    assert load == pytest.approx(robot.grip_force / GRIP_SAFETY, rel=0.01)


def test_a_top_speed_holds_for_every_motion_on_the_same_way(scene, limits, robot, light):
    for quick, slow in zip(
        light, planned(scene, limits, tcp_limits=TcpLimits(speed=2.0)), strict=True
    ):
        _, velocity, _ = tcp_motion(robot, slow.trajectory)
        assert np.max(np.linalg.norm(velocity, axis=1)) == pytest.approx(2.0, rel=1e-3)
        t = np.linspace(0.0, quick.trajectory.duration, 500)
        np.testing.assert_allclose(
            slow.trajectory(t / slow.slowed_to)[0], quick.trajectory(t)[0], atol=1e-5
        )


def test_a_motion_to_nowhere_is_not_slowed(robot, limits):
    q = np.linspace(-0.5, 0.5, 6)
    trajectory = time_path(Path.straight(q, q, robot.velocity), limits)
    assert TcpLimits().share(robot, trajectory, 1.0) == 1.0


def test_a_grip_that_cannot_hold_the_weight_has_no_plan(scene, limits):
    with pytest.raises(CycleFailure, match="does not hold 10 kg") as caught:
        planned(scene, limits, mass=10.0, tcp_limits=TcpLimits(grip_safety=20.0))
    assert caught.value.reason == "no_path"


@pytest.mark.slow
@pytest.mark.parametrize("mass", [10.0, 16.6])
def test_the_heaviest_targets_arrive_from_every_cell(scene, limits, mass):
    for cell in range(1, len(scene.cells) + 1):
        simulation = Simulation(scene)
        target = standing_target(scene, cell, mass=mass)
        simulation.add(target)
        setup = CycleSetup(cycle=0, episode=0, seed=0, limits=limits)
        score = score_cycle(run_cycle(simulation, target, setup), time_limit=60.0)
        assert score.success, (cell, score.cause)


@pytest.mark.slow
def test_without_the_limit_the_heaviest_target_is_lost(scene, limits):
    """The limit is what holds it: the same cycle at full speed drops it."""
    simulation = Simulation(scene)
    target = standing_target(scene, 7, mass=16.6)
    simulation.add(target)
    careless = TcpLimits(grip_safety=0.1)
    setup = CycleSetup(cycle=0, episode=0, seed=0, limits=limits, tcp_limits=careless)
    score = score_cycle(run_cycle(simulation, target, setup), time_limit=60.0)
    assert score.cause is not None
    assert score.cause.reason == "dropped"


# ---- what randomised cycles count on --------------------------------------------------------


def variation(scene, preset):
    target = standing_target(scene, 5)
    return vary(scene, [target], [1], read_randomization(preset))[0][1]


def test_motions_count_on_the_least_friction_of_pads_that_hold_a_target_off_their_middle(scene):
    assert variation(scene, "course").grip_friction == PAD_FRICTION
    nominal = variation(scene, "nominal").grip_friction
    assert nominal == pytest.approx(np.tan(np.arctan(0.6) - JAW_TILT))
    assert 0.0 < variation(scene, "hard").grip_friction < nominal


def test_the_tilt_is_that_of_the_pads(robot_model):
    model = robot_model
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    pads = [g for g in range(model.ngeom) if PAD_MARK in model.geom(g).name]
    assert len(pads) == 4
    closing = data.xmat[model.body("gripper_link").id].reshape(3, 3)[:, 1]
    for pad in pads:
        faces = np.abs(data.geom_xmat[pad].reshape(3, 3).T @ closing)
        assert np.max(faces) == pytest.approx(np.cos(JAW_TILT))


def test_less_friction_to_count_on_makes_a_motion_slower(scene, limits):
    carry = planned(scene, limits)[CARRY].trajectory
    shares = [
        TcpLimits().share(scene.robot, carry, 5.0, friction=friction)
        for friction in (1.0, 0.6, 0.4, 0.3, 0.1, 0.0)
    ]
    assert shares[0] > shares[-1] > 0.5
    assert shares == sorted(shares, reverse=True)
    assert shares[-1] == shares[-2]  # what is too little for twice the weight is not planned for
