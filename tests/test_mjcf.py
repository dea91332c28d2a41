"""The converted model is the description: kinematics, inertia, limits, shapes, contacts, servos."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

from kr210_sim.mjcf import SERVO_BANDWIDTH, TIMESTEP


def pose_of(model: mujoco.MjModel, data: mujoco.MjData, body: str) -> np.ndarray:
    T = np.eye(4)
    T[:3, :3] = data.body(body).xmat.reshape(3, 3)
    T[:3, 3] = data.body(body).xpos
    return T


def random_qpos(model: mujoco.MjModel, robot, count: int, seed: int) -> np.ndarray:
    rng = np.random.default_rng(seed)
    qpos = np.zeros((count, model.nq))
    for name, low, high in zip(robot.arm_joints, robot.lower, robot.upper, strict=True):
        qpos[:, model.joint(name).qposadr[0]] = rng.uniform(low, high, count)
    finger = rng.uniform(robot.finger_open, robot.finger_closed, count)
    for name in (robot.finger_joint, robot.mimic_joint):
        qpos[:, model.joint(name).qposadr[0]] = finger
    return qpos


def collision_geoms(model: mujoco.MjModel) -> list[int]:
    return [geom for geom in range(model.ngeom) if model.geom_contype[geom]]


# ---- kinematics and inertia -----------------------------------------------------------------


def test_every_link_is_where_yourdfpy_puts_it(description, robot, robot_model):
    data, urdf = mujoco.MjData(robot_model), description.model
    names = (*robot.arm_joints, robot.finger_joint, robot.mimic_joint)
    for qpos in random_qpos(robot_model, robot, 20, seed=4):
        data.qpos[:] = qpos
        mujoco.mj_kinematics(robot_model, data)
        urdf.update_cfg({name: qpos[robot_model.joint(name).qposadr[0]] for name in names})
        for link in urdf.robot.links:
            np.testing.assert_allclose(
                pose_of(robot_model, data, link.name),
                urdf.get_transform(link.name, robot.root),
                atol=1e-9,
                err_msg=link.name,
            )


def test_the_tcp_site_is_where_the_robot_says(robot, robot_model):
    data = mujoco.MjData(robot_model)
    address = [robot_model.joint(name).qposadr[0] for name in robot.arm_joints]
    for qpos in random_qpos(robot_model, robot, 20, seed=5):
        data.qpos[:] = qpos
        mujoco.mj_kinematics(robot_model, data)
        T_base_tcp = robot.forward(qpos[address])
        np.testing.assert_allclose(data.site("tcp").xpos, T_base_tcp[:3, 3], atol=1e-12)
        np.testing.assert_allclose(
            data.site("tcp").xmat.reshape(3, 3), T_base_tcp[:3, :3], atol=1e-12
        )


def test_every_link_keeps_its_inertial(description, robot_model):
    for link in description.model.robot.links:
        body = robot_model.body(link.name)
        if link.inertial is None:
            assert body.mass[0] == 0.0, link.name
            continue
        origin = np.eye(4) if link.inertial.origin is None else link.inertial.origin
        rotation = np.empty(9)
        mujoco.mju_quat2Mat(rotation, body.iquat)
        axes = rotation.reshape(3, 3)
        found = axes @ np.diag(body.inertia) @ axes.T
        expected = origin[:3, :3] @ link.inertial.inertia @ origin[:3, :3].T
        assert body.mass[0] == link.inertial.mass
        np.testing.assert_allclose(body.ipos, origin[:3, 3], atol=1e-12)
        np.testing.assert_allclose(found, expected, atol=1e-9 * expected.max(), err_msg=link.name)


def test_nothing_is_fused_and_the_mass_is_whole(description, robot_model):
    names = {robot_model.body(i).name for i in range(1, robot_model.nbody)}
    assert names == {link.name for link in description.model.robot.links}
    assert robot_model.body_mass.sum() == pytest.approx(479.0)


# ---- limits and servos ----------------------------------------------------------------------


def test_position_effort_and_velocity_limits_are_carried_over(robot, robot_model):
    for index, name in enumerate(robot.arm_joints):
        joint = robot_model.joint(name)
        assert robot_model.jnt_limited[joint.id]
        assert robot_model.jnt_actfrclimited[joint.id]
        np.testing.assert_array_equal(joint.range, [robot.lower[index], robot.upper[index]])
        effort = robot.effort[index]
        np.testing.assert_array_equal(robot_model.jnt_actfrcrange[joint.id], [-effort, effort])
    np.testing.assert_array_equal(robot_model.numeric("joint_velocity_limit").data, robot.velocity)


def test_the_force_of_a_servo_is_kp_times_error_minus_kv_times_speed(robot, robot_model):
    data = mujoco.MjData(robot_model)
    rng = np.random.default_rng(6)
    dof = [robot_model.joint(name).dofadr[0] for name in robot.arm_joints]
    servo = [robot_model.actuator(name).id for name in robot.arm_joints]
    data.qvel[dof] = rng.uniform(-1e-3, 1e-3, 6)
    data.ctrl[servo] = rng.uniform(-1e-3, 1e-3, 6)
    mujoco.mj_forward(robot_model, data)
    kp, kv = robot_model.actuator_gainprm[servo, 0], -robot_model.actuator_biasprm[servo, 2]
    np.testing.assert_allclose(
        data.actuator_force[servo], kp * data.ctrl[servo] - kv * data.qvel[dof], rtol=1e-9
    )
    np.testing.assert_allclose(kv / kp, 2 / SERVO_BANDWIDTH)


def test_no_servo_is_underdamped_in_any_configuration(robot, robot_model):
    """Damping ratio kv / (2 sqrt(kp M)) of at least 1, to 1 %, with M of that configuration."""
    data = mujoco.MjData(robot_model)
    dof = [robot_model.joint(name).dofadr[0] for name in robot.arm_joints]
    servo = [robot_model.actuator(name).id for name in robot.arm_joints]
    kp, kv = robot_model.actuator_gainprm[servo, 0], -robot_model.actuator_biasprm[servo, 2]
    dense = np.empty((robot_model.nv, robot_model.nv))
    for qpos in random_qpos(robot_model, robot, 200, seed=7):
        data.qpos[:] = qpos
        mujoco.mj_fwdPosition(robot_model, data)
        mujoco.mj_fullM(robot_model, data, dense)
        assert np.all(kv / (2 * np.sqrt(kp * np.diag(dense)[dof])) > 0.99)


def test_gravity_compensation_counts_against_the_motors(robot, robot_model):
    """At home and at rest the motors carry the arm; without it joint 2 needs hundreds of N m."""
    data = mujoco.MjData(robot_model)
    mujoco.mj_forward(robot_model, data)
    dof = [robot_model.joint(name).dofadr[0] for name in robot.arm_joints]
    np.testing.assert_allclose(data.qfrc_actuator[dof], data.qfrc_bias[dof], atol=1e-6)
    assert abs(data.qfrc_actuator[dof[1]]) > 300.0
    np.testing.assert_array_equal(data.qfrc_passive[dof], 0.0)


def test_home_is_the_zero_configuration_with_the_gripper_open(robot, robot_model):
    home = robot_model.key("home")
    for name in robot.arm_joints:
        assert home.qpos[robot_model.joint(name).qposadr[0]] == 0.0
        assert home.ctrl[robot_model.actuator(name).id] == 0.0
    for name in (robot.finger_joint, robot.mimic_joint):
        assert home.qpos[robot_model.joint(name).qposadr[0]] == robot.finger_open
    assert home.ctrl[robot_model.actuator(robot.finger_joint).id] == robot.finger_open


def test_the_arm_stays_at_home_by_itself(robot_model):
    data = mujoco.MjData(robot_model)
    mujoco.mj_resetDataKeyframe(robot_model, data, robot_model.key("home").id)
    start = data.qpos.copy()
    mujoco.mj_step(robot_model, data, round(0.3 / TIMESTEP))
    np.testing.assert_allclose(data.qpos, start, atol=1e-6)


def test_the_fingers_close_together_and_not_beyond_the_grip_force(robot, robot_model):
    data = mujoco.MjData(robot_model)
    mujoco.mj_resetDataKeyframe(robot_model, data, robot_model.key("home").id)
    servo = robot_model.actuator(robot.finger_joint).id
    data.ctrl[servo] = robot.finger_closed
    address = [
        robot_model.joint(name).qposadr[0] for name in (robot.finger_joint, robot.mimic_joint)
    ]
    for _ in range(200):
        mujoco.mj_step(robot_model, data, 2)
        assert abs(data.qpos[address[0]] - data.qpos[address[1]]) < 1e-4
        assert abs(data.actuator_force[servo]) <= robot.grip_force
    assert data.qpos[address[0]] > robot.finger_open + 0.01


def test_a_second_of_pseudo_random_control_gives_no_warning(robot_model):
    data = mujoco.MjData(robot_model)
    mujoco.mj_resetDataKeyframe(robot_model, data, robot_model.key("home").id)
    rng = np.random.default_rng(8)
    low, high = robot_model.actuator_ctrlrange.T
    for _ in range(20):
        data.ctrl[:] = rng.uniform(low, high)
        mujoco.mj_step(robot_model, data, round(0.05 / TIMESTEP))
    assert np.all(np.isfinite(data.qpos))
    assert not any(warning.number for warning in data.warning)


# ---- shapes and contacts --------------------------------------------------------------------


def test_visual_shapes_are_seen_and_collision_shapes_touch(description, robot_model):
    links = description.model.robot.links
    visible = [g for g in range(robot_model.ngeom) if robot_model.geom_group[g] == 2]
    solid = [g for g in range(robot_model.ngeom) if robot_model.geom_group[g] == 3]
    assert len(visible) == sum(len(link.visuals) for link in links)
    assert len(solid) == sum(len(link.collisions) for link in links)
    assert len(visible) + len(solid) == robot_model.ngeom
    assert not np.any(robot_model.geom_contype[visible] | robot_model.geom_conaffinity[visible])
    assert np.all(robot_model.geom_contype[solid] & robot_model.geom_conaffinity[solid])


def test_every_collision_shape_hits_something_when_it_should(spec, robot_model):
    """A small free ball is put into the middle of each shape in turn."""
    world = spec.copy()
    ball = world.worldbody.add_body(name="ball")
    ball.add_freejoint(name="ball")
    ball.add_geom(type=mujoco.mjtGeom.mjGEOM_SPHERE, size=[0.004, 0, 0])
    world.delete(world.key("home"))
    model = world.compile()
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    address, ball_geom = model.joint("ball").qposadr[0], model.body("ball").geomadr[0]
    for geom in collision_geoms(robot_model):
        name = robot_model.geom(geom).name
        data.qpos[address : address + 3] = data.geom(name).xpos
        mujoco.mj_kinematics(model, data)
        mujoco.mj_collision(model, data)
        pairs = {tuple(sorted(pair)) for pair in data.contact.geom.tolist()}
        assert tuple(sorted((ball_geom, model.geom(name).id))) in pairs, name


def test_only_pairs_that_touch_in_the_zero_configuration_are_excluded(robot_model):
    data = mujoco.MjData(robot_model)
    mujoco.mj_kinematics(robot_model, data)
    bodies = robot_model.geom_bodyid
    for signature in robot_model.exclude_signature:
        first, second = int(signature) >> 16, int(signature) & 0xFFFF
        gaps = [
            mujoco.mj_geomDistance(robot_model, data, a, b, 0.01, None)
            for a in collision_geoms(robot_model)
            for b in collision_geoms(robot_model)
            if bodies[a] == first and bodies[b] == second
        ]
        assert min(gaps) <= 1e-3, (first, second)


def test_nothing_touches_in_the_home_configuration(robot_model):
    data = mujoco.MjData(robot_model)
    mujoco.mj_resetDataKeyframe(robot_model, data, robot_model.key("home").id)
    mujoco.mj_forward(robot_model, data)
    assert data.ncon == 0


@pytest.mark.parametrize(
    ("q", "first", "second"),
    [
        ([0.2, 1.1, 1.1, -1.8, -1.4, -1.3], "base_link", "link_4"),
        ([2.2, 1.2, 1.1, -4.0, -2.0, 0.6], "gripper_link", "link_1"),
    ],
)
def test_an_arm_folded_into_itself_touches_itself(robot, robot_model, q, first, second):
    data = mujoco.MjData(robot_model)
    data.qpos[[robot_model.joint(name).qposadr[0] for name in robot.arm_joints]] = q
    mujoco.mj_kinematics(robot_model, data)
    mujoco.mj_collision(robot_model, data)
    touching = {
        tuple(sorted(robot_model.body(int(robot_model.geom_bodyid[g])).name for g in pair))
        for pair in data.contact.geom
    }
    assert tuple(sorted((first, second))) in touching, touching


def test_the_pads_grip_with_honest_friction(robot, robot_model):
    pads = [g for g in range(robot_model.ngeom) if "_pad" in robot_model.geom(g).name]
    assert {robot_model.body(int(robot_model.geom_bodyid[g])).name for g in pads} == set(
        robot.fingers
    )
    assert np.all(robot_model.geom_friction[pads, 0] <= 1.0)
    assert np.all(robot_model.geom_friction[pads, 1] <= 0.01)


def test_a_pressed_pad_comes_to_rest_within_a_few_physics_steps(robot_model):
    """The contact as MuJoCo steps it, semi-implicit Euler, neither rings nor creeps back."""
    pads = [g for g in range(robot_model.ngeom) if "_pad" in robot_model.geom(g).name]
    for solref, solimp in zip(
        robot_model.geom_solref[pads], robot_model.geom_solimp[pads], strict=True
    ):
        largest = solimp[1]
        stiffness, damping = -solref[0] / largest**2, -solref[1] / largest
        for share in solimp[:2]:  # impedance at first touch and when pressed
            k, b = share * stiffness * TIMESTEP**2, share * damping * TIMESTEP
            assert abs(1 - b) < 0.8  # sliding
            pressed = np.array([[1 - k, 1 - b], [-k, 1 - b]])  # of depth and speed times dt
            assert np.max(np.abs(np.linalg.eigvals(pressed))) < 0.9
