"""The links move as MuJoCo moves them, and as the forward kinematics says."""

from __future__ import annotations

import mujoco
import numpy as np

from kr210_sim.chain import Chain
from kr210_sim.scene import ROBOT_PREFIX
from kr210_sim.simulation import Simulation


def pose(data: mujoco.MjData, body: int) -> np.ndarray:
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = data.xmat[body].reshape(3, 3), data.xpos[body]
    return T


def test_links_and_axes_move_as_in_mujoco(scene):
    simulation = Simulation(scene)
    model, data = simulation.model, mujoco.MjData(simulation.model)
    joints = np.array([model.joint(ROBOT_PREFIX + name).id for name in scene.robot.arm_joints])
    mujoco.mj_kinematics(model, data)
    before = [pose(data, body) for body in model.jnt_bodyid[joints]]
    chain = Chain(data.xanchor[joints], data.xaxis[joints])
    q = np.random.default_rng(3).uniform(-np.pi, np.pi, (50, 6))
    moved = chain.moved(q)
    anchor, axis = chain.axes(moved)
    assert moved.shape == (50, 7, 4, 4)
    np.testing.assert_array_equal(moved[:, 0], np.broadcast_to(np.eye(4), (50, 4, 4)))
    for row in range(len(q)):
        data.qpos[simulation.addresses.arm] = q[row]
        mujoco.mj_kinematics(model, data)
        for link, body in enumerate(model.jnt_bodyid[joints]):
            np.testing.assert_allclose(
                moved[row, link + 1] @ before[link], pose(data, body), rtol=0, atol=1e-12
            )
        np.testing.assert_allclose(axis[row], data.xaxis[joints], rtol=0, atol=1e-12)
        apart = np.cross(data.xanchor[joints] - anchor[row], axis[row])
        np.testing.assert_allclose(apart, 0.0, atol=1e-12)


def test_it_moves_the_tool_as_the_forward_kinematics_does(scene):
    simulation, robot = Simulation(scene), scene.robot
    model, data = simulation.model, mujoco.MjData(simulation.model)
    joints = np.array([model.joint(ROBOT_PREFIX + name).id for name in robot.arm_joints])
    mujoco.mj_kinematics(model, data)
    chain = Chain(data.xanchor[joints], data.xaxis[joints])
    q = np.random.default_rng(4).uniform(-np.pi, np.pi, (200, 6))
    at_zero = scene.T_world_base @ robot.forward(np.zeros(6))
    expected = scene.T_world_base @ robot.forward(q)
    np.testing.assert_allclose(chain.moved(q)[:, -1] @ at_zero, expected, rtol=0, atol=1e-9)
