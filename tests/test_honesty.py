"""Physics honesty: friction alone holds a target, on the compiled model and on the saved one."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest
from conftest import standing_target

from kr210_sim.mjcf import TIMESTEP
from kr210_sim.scene import ROBOT_PREFIX
from kr210_sim.simulation import Simulation


@pytest.fixture(scope="module")
def saved(default_run) -> mujoco.MjModel:
    """The world of the default run, loaded by MuJoCo alone."""
    return mujoco.MjModel.from_xml_path(str(default_run.out / "episodes" / "0000" / "scene.xml"))


@pytest.fixture(scope="module")
def compiled(scene) -> mujoco.MjModel:
    """A world in which a target is watched, as the sequencer compiles it."""
    simulation = Simulation(scene)
    target = standing_target(scene, 1)
    simulation.add(target)
    simulation.watch(target)
    return simulation.model


@pytest.fixture(params=["compiled", "saved"])
def model(request) -> mujoco.MjModel:
    return request.getfixturevalue(request.param)


def targets_of(model: mujoco.MjModel) -> list[int]:
    found = [b for b in range(model.nbody) if model.body(b).name.startswith("target_")]
    assert found
    return found


def target_geoms(model: mujoco.MjModel) -> list[int]:
    targets = targets_of(model)
    return [g for g in range(model.ngeom) if model.geom_bodyid[g] in targets]


def test_the_only_equality_couples_the_two_fingers(model, robot):
    assert model.neq == 1
    assert model.eq_type[0] == mujoco.mjtEq.mjEQ_JOINT
    joints = {model.joint(int(model.eq_obj1id[0])).name, model.joint(int(model.eq_obj2id[0])).name}
    assert joints == {ROBOT_PREFIX + robot.finger_joint, ROBOT_PREFIX + robot.mimic_joint}


def test_nothing_is_a_mocap_body_a_tendon_a_plugin_or_a_flex(model):
    assert (model.nmocap, model.ntendon, model.nplugin, model.nflex) == (0, 0, 0, 0)


def test_every_actuator_moves_one_joint_of_the_robot(model, robot):
    """No adhesion, nothing that acts on a body or a site."""
    assert np.all(model.actuator_trntype == mujoco.mjtTrn.mjTRN_JOINT)
    driven = {model.joint(int(joint)).name for joint in model.actuator_trnid[:, 0]}
    assert driven == {ROBOT_PREFIX + name for name in (*robot.arm_joints, robot.finger_joint)}


def test_gravity_pulls_at_everything_that_can_fall(model):
    np.testing.assert_array_equal(model.opt.gravity, [0, 0, -9.81])
    assert not model.opt.disableflags & mujoco.mjtDisableBit.mjDSBL_GRAVITY
    for body in targets_of(model):
        assert model.body_gravcomp[body] == 0.0
    data = mujoco.MjData(model)
    for body in targets_of(model):
        data.qpos[model.jnt_qposadr[model.body_jntadr[body]] + 2] += 20.0  # in free air
    mujoco.mj_forward(model, data)
    for body in targets_of(model):
        dof = model.body_dofadr[body]
        np.testing.assert_allclose(data.qacc[dof : dof + 3], [0, 0, -9.81], atol=1e-9)


def test_targets_are_free_and_hardly_damped(model):
    for body in targets_of(model):
        joint, dof = model.body_jntadr[body], model.body_dofadr[body]
        assert model.body_jntnum[body] == 1
        assert model.jnt_type[joint] == mujoco.mjtJoint.mjJNT_FREE
        assert np.all(model.dof_damping[dof : dof + 6] <= 0.02)
        assert np.all(model.dof_frictionloss[dof : dof + 6] == 0.0)
        assert model.jnt_stiffness[joint] == 0.0
    assert (model.opt.density, model.opt.viscosity) == (0.0, 0.0)


def test_friction_is_that_of_real_rubber(model):
    """Of pads and targets: mu at most 1, torsional at most 1 cm, rolling less than that."""
    pads = [g for g in range(model.ngeom) if "_pad" in model.geom(g).name]
    assert len(pads) == 4
    for geom in pads + target_geoms(model):
        sliding, torsional, rolling = model.geom_friction[geom]
        assert sliding <= 1.0
        assert torsional <= 0.01
        assert rolling <= 0.01
        assert model.geom_margin[geom] == 0.0
        assert model.geom_gap[geom] == 0.0


def test_no_contact_pair_is_given_a_friction_of_its_own(model):
    assert model.npair == 0
    assert not model.opt.enableflags & mujoco.mjtEnableBit.mjENBL_OVERRIDE
    assert model.opt.noslip_iterations == 0


def test_the_grip_force_is_at_most_500_newton(model, robot):
    servo = model.actuator(ROBOT_PREFIX + robot.finger_joint).id
    assert model.actuator_forcelimited[servo]
    assert np.max(np.abs(model.actuator_forcerange[servo])) <= 500.0
    joint = model.joint(ROBOT_PREFIX + robot.finger_joint).id
    assert np.max(np.abs(model.jnt_actfrcrange[joint])) <= 500.0


def test_every_arm_motor_is_limited_to_its_effort(model, robot):
    for name, effort in zip(robot.arm_joints, robot.effort, strict=True):
        joint = model.joint(ROBOT_PREFIX + name).id
        assert model.jnt_actfrclimited[joint]
        np.testing.assert_allclose(model.jnt_actfrcrange[joint], [-effort, effort], rtol=1e-5)


def test_only_pairs_that_touch_at_zero_are_excluded_from_contact(model):
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    solid = [g for g in range(model.ngeom) if model.geom_contype[g]]
    for signature in model.exclude_signature:
        first, second = int(signature) >> 16, int(signature) & 0xFFFF
        assert model.body(first).name.startswith(ROBOT_PREFIX)
        assert model.body(second).name.startswith(ROBOT_PREFIX)
        gaps = [
            mujoco.mj_geomDistance(model, data, a, b, 0.01, None)
            for a in solid
            for b in solid
            if (model.geom_bodyid[a], model.geom_bodyid[b]) == (first, second)
        ]
        assert min(gaps) <= 1e-3


def test_whatever_is_solid_can_touch_whatever_else_is_solid(model):
    solid = np.flatnonzero(model.geom_contype | model.geom_conaffinity)
    contype, conaffinity = model.geom_contype[solid], model.geom_conaffinity[solid]
    assert np.all((contype[:, None] & conaffinity[None]) | (contype[None] & conaffinity[:, None]))
    names = {model.geom(int(g)).name for g in solid}
    assert {model.body(b).name for b in targets_of(model)} <= names


# ---- the saved world ------------------------------------------------------------------------


def _vertices(model, mesh):
    first = model.mesh_vertadr[mesh]
    return model.mesh_vert[first : first + model.mesh_vertnum[mesh]]


def test_the_saved_world_is_the_one_that_was_simulated(default_run, scene, saved):
    simulation = Simulation(scene)
    for score in default_run.scores:
        number = score.record.cycle
        simulation.add(standing_target(scene, score.record.cell, number=number))
    lived = simulation.model
    for sizes in ("nbody", "njnt", "ngeom", "nsite", "nu", "neq", "nv", "nq", "nmesh", "nexclude"):
        assert getattr(saved, sizes) == getattr(lived, sizes), sizes
    assert [saved.body(i).name for i in range(saved.nbody)] == [
        lived.body(i).name for i in range(lived.nbody)
    ]
    for field in (
        "body_mass", "body_inertia", "body_ipos", "body_gravcomp",
        "jnt_type", "jnt_axis", "jnt_range", "jnt_actfrcrange", "jnt_actgravcomp",
        "dof_armature", "dof_damping", "dof_frictionloss",
        "geom_type", "geom_size", "geom_contype", "geom_conaffinity", "geom_friction",
        "geom_solref", "geom_solimp", "geom_condim", "geom_priority",
        "actuator_gainprm", "actuator_biasprm", "actuator_ctrlrange", "actuator_forcerange",
        "eq_solref",
    ):  # fmt: skip
        np.testing.assert_allclose(
            getattr(saved, field), getattr(lived, field), rtol=1e-5, atol=2e-6, err_msg=field
        )
    for index in range(saved.nmesh):
        ours, theirs = _vertices(saved, index), _vertices(lived, index)
        if len(ours) != len(theirs):  # a file that is drawn shares vertices between its faces
            assert saved.mesh(index).name.endswith("_visual")
            ours, theirs = (np.stack([v.min(axis=0), v.max(axis=0)]) for v in (ours, theirs))
        np.testing.assert_allclose(ours, theirs, atol=2e-6, err_msg=saved.mesh(index).name)
    np.testing.assert_allclose(saved.eq_data[:, :5], lived.eq_data[:, :5])
    for field in ("timestep", "integrator", "solver", "cone", "jacobian", "impratio"):
        assert getattr(saved.opt, field) == getattr(lived.opt, field), field
    assert saved.opt.enableflags == lived.opt.enableflags
    assert saved.opt.disableflags == lived.opt.disableflags


def test_the_saved_world_has_the_start_of_every_cycle_as_a_keyframe(default_run, saved):
    for score in default_run.scores:
        key = saved.key(f"cycle_{score.record.cycle:04d}")
        for name, values in score.record.start.items():
            first = int(saved.joint(name).qposadr[0])
            np.testing.assert_allclose(
                key.qpos[first : first + len(values)], values, atol=2e-5, err_msg=name
            )


def test_a_cycle_can_be_begun_in_the_saved_world(default_run, saved):
    """The arm holds, and the target of that cycle stands in its cell."""
    data = mujoco.MjData(saved)
    mujoco.mj_resetDataKeyframe(saved, data, saved.key("cycle_0003").id)
    start = data.qpos.copy()
    mujoco.mj_step(saved, data, round(0.1 / TIMESTEP))
    joint = saved.joint("target_3")
    moved = data.qpos[joint.qposadr[0] :][:3] - start[joint.qposadr[0] :][:3]
    assert np.linalg.norm(moved) < 5e-4
    arm = [saved.joint(ROBOT_PREFIX + f"joint_{i}").qposadr[0] for i in range(1, 7)]
    np.testing.assert_allclose(data.qpos[arm], 0.0, atol=1e-5)
    assert not any(warning.number for warning in data.warning)
