"""Foreign descriptions come in as they are: any arm, any gripper, repairs, whole cycles."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pytest
from robot_files import (
    HEAVY,
    OFFSET,
    TURNED,
    heavy_arm,
    offset_arm,
    turned_arm,
)

from kr210_sim.arm import isolate_arm
from kr210_sim.cli import main
from kr210_sim.config import RunConfig
from kr210_sim.description import load_description
from kr210_sim.dynamics import arm_load
from kr210_sim.effort import rate_efforts
from kr210_sim.exceptions import BadInput
from kr210_sim.inertials import is_inertia
from kr210_sim.loading import RobotModel, load_robot
from kr210_sim.robot import find_robot
from kr210_sim.runner import run
from kr210_sim.source import ArmChoice, RobotSource

pytestmark = pytest.mark.slow

MAKERS = {"heavy": heavy_arm, "offset": offset_arm, "turned": turned_arm}


@pytest.fixture(scope="module")
def paths(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    return {name: make(tmp_path_factory.mktemp(name)) for name, make in MAKERS.items()}


@pytest.fixture(scope="module")
def models(paths) -> dict[str, RobotModel]:
    return {name: load_robot(RobotSource(path=path)) for name, path in paths.items()}


def noted(model: RobotModel, *words: str) -> bool:
    return any(all(word in note for word in words) for note in model.notes)


# ---- what the arm is ------------------------------------------------------------------------


def test_arm_gripper_and_tcp_of_a_macro_robot_are_found(models):
    robot = models["heavy"].robot
    assert robot.root == "world_frame"
    assert robot.arm_joints == tuple(f"joint_a{i}" for i in range(1, 7))
    assert robot.fingers == ("jaw_right", "jaw_left")
    assert (robot.finger_open, robot.finger_closed) == (0.07, 0.0)
    assert robot.grip_force == 400.0
    # Midway between the fingers, three quarters along them, x out of the palm, y across.
    np.testing.assert_allclose(robot.T_palm_tcp[:3, 3], [0, 0, 0.12 + 0.135], atol=1e-9)
    np.testing.assert_allclose(robot.T_palm_tcp[:3, 0], [0, 0, 1], atol=1e-12)
    np.testing.assert_allclose(robot.T_palm_tcp[:3, 1], [0, 1, 0], atol=1e-12)
    assert noted(models["heavy"], "TCP", "jaw_base")


def test_a_prefix_comes_through_as_an_argument(paths):
    source = RobotSource(path=paths["heavy"], arguments={"prefix": "left/", "jaw_force": "350"})
    robot = load_robot(source).robot
    assert robot.arm_joints[0] == "left/joint_a1"
    assert robot.grip_force == 350.0


def test_a_bare_arm_gets_our_gripper_on_its_flange(models):
    model = models["offset"]
    assert model.robot.palm == "gripper_link"
    assert noted(model, "mounted on 'r1_tool0'")
    assert noted(model, "'r1_rail'", "fixed at 0")
    T = model.robot.chain.T_last_palm  # 0.03 to the flange, 0.07 to the palm's frame, x forward
    np.testing.assert_allclose(T[:3, 3], [0.10, 0, 0], atol=1e-12)
    np.testing.assert_allclose(T[:3, 0], [1, 0, 0], atol=1e-12)


def test_our_gripper_takes_the_place_of_another_if_asked(paths):
    source = RobotSource(path=paths["heavy"], choice=ArmChoice(gripper=True))
    model = load_robot(source)
    assert model.robot.fingers == ("right_gripper_finger_link", "left_gripper_finger_link")
    assert noted(model, "give way")


def test_a_tcp_with_other_axes_is_turned_to_the_approach(models):
    T = models["turned"].robot.T_palm_tcp
    np.testing.assert_allclose(T[:3, 3], [0, 0, 0.24], atol=1e-12)
    np.testing.assert_allclose(T[:3, 0], [0, 0, 1], atol=1e-12)
    np.testing.assert_allclose(np.abs(T[:3, 1]), [0, 1, 0], atol=1e-12)


def test_fingers_of_one_direction_close_by_a_negative_mimic(models):
    robot = models["turned"].robot
    assert (robot.finger_open, robot.finger_closed, robot.mimic_multiplier) == (0.0, 0.07, -1.0)
    np.testing.assert_allclose(robot.finger_positions(0.05), [0.05, -0.05])


def test_the_base_can_be_named_and_the_rest_is_left_out(paths):
    description = isolate_arm(load_description(paths["offset"]), ArmChoice(base="r1_base_link"))
    assert "r1_rail_foot" not in {link.name for link in description.model.robot.links}
    assert find_robot(description).root == "r1_base_link"


def test_arm_and_fingers_can_be_named(paths):
    joints = ("arm/j1", "arm/j2", "arm/j3", "arm/j4", "arm/j5", "arm/j6")
    choice = ArmChoice(joints=joints, fingers=("arm/low", "arm/high_joint"))
    assert find_robot(isolate_arm(load_description(paths["turned"]), choice)).arm_joints == joints


def test_fingers_that_nothing_couples_are_coupled_when_named(paths, tmp_path):
    path = heavy_arm(tmp_path)
    macro = tmp_path / "jaw_description" / "urdf" / "jaw_macro.xacro"
    text = macro.read_text()
    macro.write_text(text.replace('<mimic joint="${prefix}jaw_left_joint"/>', ""))
    with pytest.raises(BadInput, match="--fingers"):
        load_robot(RobotSource(path=path))
    choice = ArmChoice(fingers=("jaw_left", "jaw_right"))
    model = load_robot(RobotSource(path=path, choice=choice))
    assert model.robot.mimic_joint == "jaw_right_joint"
    assert noted(model, "'jaw_right_joint'", "mimic")


def test_the_bundled_robot_comes_in_without_a_note():
    assert load_robot(RobotSource()).notes == ()


# ---- repairs --------------------------------------------------------------------------------


def with_inertia(folder: Path, description, **values: str) -> Path:
    robot = ET.fromstring(description.urdf_text)
    inertia = robot.find("link[@name='link_3']/inertial/inertia")
    for name, value in values.items():
        inertia.set(name, value)
    path = folder / "arm.urdf"
    ET.ElementTree(robot).write(path)
    return path


@pytest.mark.parametrize(
    ("values", "rule"),
    [
        ({"ixx": "0", "iyy": "0", "izz": "0"}, "box"),
        ({"ixx": "-1"}, "box"),
        ({"ixy": "50"}, "box"),
        ({"izz": "100"}, "raised"),
    ],
)
def test_an_impossible_inertia_is_repaired_and_link_and_rule_are_named(
    description, tmp_path, values, rule
):
    again = load_description(with_inertia(tmp_path, description, **values))
    link = next(link for link in again.model.robot.links if link.name == "link_3")
    assert is_inertia(link.inertial.inertia)
    assert link.inertial.mass == 71
    assert len(again.notes) == 1
    assert "'link_3'" in again.notes[0]
    assert rule in again.notes[0]


def test_raised_moments_keep_the_largest_and_the_axes(models):
    link = next(x for x in models["heavy"].description.model.robot.links if x.name == "jaw_left")
    np.testing.assert_allclose(link.inertial.inertia, np.diag([0.002, 0.001, 0.001]), atol=1e-15)


def test_gravity_torque_and_inertia_are_those_of_mujoco(models):
    for model in models.values():
        robot, compiled = model.robot, model.spec.copy().compile()
        data = mujoco.MjData(compiled)
        q = np.random.default_rng(0).uniform(robot.lower, robot.upper, (20, 6))
        load = arm_load(model.description.model, robot, q)
        qpos = [compiled.joint(name).qposadr[0] for name in robot.arm_joints]
        dof = [compiled.joint(name).dofadr[0] for name in robot.arm_joints]
        dense = np.empty((compiled.nv, compiled.nv))
        for index, row in enumerate(q):
            data.qpos[qpos] = row
            mujoco.mj_forward(compiled, data)
            mujoco.mj_fullM(compiled, data, dense)
            inertia = np.diag(dense)[dof] - compiled.dof_armature[dof]
            np.testing.assert_allclose(load.gravity[index], data.qfrc_bias[dof], atol=1e-9)
            np.testing.assert_allclose(load.inertia[index], inertia, atol=1e-9)


@pytest.mark.parametrize("declared", [300.0, 0.0])
def test_efforts_that_cannot_hold_a_kr210_are_those_of_the_documented_model(
    description, robot, declared
):
    rated = rate_efforts(description, replace(robot, effort=np.full(6, declared)))
    np.testing.assert_array_equal(rated.effort, [9000, 10000, 5000, 1100, 1100, 210])
    assert len(rated.notes) == 1
    assert "gravity" in rated.notes[0]


def test_efforts_that_can_hold_the_arm_stay(description, robot):
    assert rate_efforts(description, robot) is robot


def test_efforts_that_hold_but_hardly_move_the_arm_call_for_a_lower_speed(description, robot):
    tight = replace(robot, effort=robot.effort * [1, 0.3, 1, 1, 1, 1])
    rated = rate_efforts(description, tight)
    np.testing.assert_array_equal(rated.effort, tight.effort)
    assert "joint_2" in rated.notes[0]
    assert "--speed 0." in rated.notes[0]


@pytest.mark.parametrize("name", ["heavy", "offset"])
def test_ruled_efforts_can_hold_and_move_any_arm(models, name):
    model = models[name]
    assert noted(model, "effort", "by rule")
    rng = np.random.default_rng(5)
    q = rng.uniform(model.robot.lower, model.robot.upper, (200, 6))
    load = arm_load(model.description.model, model.robot, q, load=10.0)
    needed = np.abs(load.gravity) + load.inertia * model.robot.velocity / 0.25
    assert np.all(needed < 0.8 * model.robot.effort)


# ---- the whole chain ------------------------------------------------------------------------

SHAPES = {
    "heavy": {name: name for name in HEAVY},
    "offset": {f"r1_{name}": name for name in OFFSET},
    "turned": {f"arm/{name}": name for name in TURNED},
}


@pytest.mark.parametrize("name", MAKERS)
def test_the_shapes_have_the_bounds_that_were_drawn(models, name):
    known = {"heavy": HEAVY, "offset": OFFSET, "turned": TURNED}[name]
    model = models[name].spec.copy().compile()
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    for link, part in SHAPES[name].items():
        body = data.body(link)
        for geom in np.flatnonzero(model.geom_bodyid == model.body(link).id):
            mesh = model.geom_dataid[geom]
            start = model.mesh_vertadr[mesh]
            points = model.mesh_vert[start : start + model.mesh_vertnum[mesh]]
            world = points @ data.geom_xmat[geom].reshape(3, 3).T + data.geom_xpos[geom]
            local = (world - body.xpos) @ body.xmat.reshape(3, 3)
            if model.geom_contype[geom]:
                np.testing.assert_allclose(local.min(axis=0), known[part][0], atol=2e-6)
                np.testing.assert_allclose(local.max(axis=0), known[part][1], atol=2e-6)


def test_meshes_of_one_name_stay_apart_as_visual_and_collision(models):
    model = models["heavy"].spec.copy().compile()
    for kind in ("visual", "collision"):
        assert mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_MESH, f"link_2_{kind}") >= 0
    classes = {geom.classname.name for geom in models["heavy"].spec.geoms}
    assert classes == {"visual", "collision"}


def one_run(out: Path, path: Path, cycles: int, cell: str) -> dict:
    _, summary = run(RunConfig(out=out, robot=path, cycles=cycles, cell=cell))
    return summary


@pytest.mark.slow
@pytest.mark.parametrize("name", MAKERS)
def test_an_imported_robot_runs_a_cycle_and_tracks_as_well_as_ours(tmp_path, paths, name):
    summary = one_run(tmp_path / "run", paths[name], 1, "5")
    assert summary["succeeded"] == 1, summary["failures"]
    assert summary["tracking_offset_m"]["max"] < 1e-3
    assert summary["ik_offset_m"]["max"] < 1e-9
    world = tmp_path / "run" / "episodes" / "0000" / "scene.xml"
    mujoco.MjModel.from_xml_path(str(world))
    if name != "turned":
        assert sum("effort" in note for note in summary["notes"]) == 1


def test_an_imported_robot_runs_ten_cycles(tmp_path, paths):
    summary = one_run(tmp_path / "run", paths["heavy"], 10, "random")
    assert summary["succeeded"] == 10, summary["failures"]


@pytest.mark.parametrize("verb", ["dh", "ik"])
def test_dh_and_ik_read_any_robot_and_say_what_they_guessed(paths, capsys, verb):
    robot = str(paths["offset"])
    arguments = ["dh", robot] if verb == "dh" else ["ik", "--robot", robot, "--position"]
    assert main([*arguments, *(["1.5", "0.1", "1.5"] if verb == "ik" else [])]) == 0
    shown = capsys.readouterr()
    assert "mounted on 'r1_tool0'" in shown.err
    assert shown.out


@pytest.mark.slow
def test_a_root_called_world_gets_another_name_and_it_is_said(tmp_path):
    path = turned_arm(tmp_path)
    path.write_text(path.read_text().replace('"arm/pedestal"', '"world"'))
    description = load_description(path)
    assert description.model.base_link == "world_link"
    assert any("'world'" in note for note in description.notes)
    out = tmp_path / "out"
    assert main(["convert", str(path), "--out", str(out), "--check"]) == 0
