"""`convert` writes folders that any MuJoCo loads and that are the description to nine digits."""

from __future__ import annotations

import shutil
import subprocess
import sys
from pathlib import Path

import mujoco
import numpy as np
import pytest
from robot_files import heavy_arm, offset_arm, turned_arm

from kr210_sim.cli import main
from kr210_sim.convert import convert
from kr210_sim.loading import load_robot
from kr210_sim.parity import check_parity
from kr210_sim.robot import bundled_robot
from kr210_sim.source import RobotSource

pytestmark = pytest.mark.slow

MAKERS = {"heavy": heavy_arm, "offset": offset_arm, "turned": turned_arm}
EXACT = {"frames", "masses", "centres of mass", "inertias", "joint ranges", "effort limits"}


@pytest.fixture(scope="module", params=["bundled", *MAKERS])
def converted(request, tmp_path_factory):
    folder = tmp_path_factory.mktemp(request.param)
    make = MAKERS.get(request.param)
    source = RobotSource(path=bundled_robot() if make is None else make(folder / "source"))
    return convert(source, folder / "out", scene="shelf_and_bin", check=True)


def test_every_link_is_that_of_the_urdf_to_1e_9_in_memory_and_from_disk(converted):
    for findings in (converted.in_memory, converted.from_disk):
        found = {item.what: item for item in findings}
        assert set(found) >= EXACT | {"velocities", "visual bounds", "collision bounds"}
        for item in findings:
            assert item.passed, item
            assert item.count >= 6, item
        for what in EXACT:
            assert found[what].difference <= 1e-9, found[what]
        for what in ("visual bounds", "collision bounds"):
            assert found[what].difference <= 2e-6, found[what]


def test_the_folder_loads_from_anywhere_with_mujoco_alone(converted, tmp_path):
    moved = tmp_path / "moved"
    shutil.copytree(converted.out, moved)
    program = (
        "import sys, mujoco\n"
        "for path in sys.argv[1:]:\n"
        "    model = mujoco.MjModel.from_xml_path(path)\n"
        "    data = mujoco.MjData(model)\n"
        "    mujoco.mj_resetDataKeyframe(model, data, 0)\n"
        "    mujoco.mj_step(model, data, 20)\n"
        "    assert not any(warning.number for warning in data.warning)\n"
    )
    command = [sys.executable, "-I", "-c", program, *(str(moved / x) for x in converted.files)]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert sorted(path.name for path in tmp_path.iterdir()) == ["moved"]


def test_it_is_written_in_the_manner_of_menagerie(converted):
    text = (converted.out / converted.files[0]).read_text()
    for wanted in ('<default class="visual">', '<default class="collision">', '<key name="home"'):
        assert wanted in text
    order = [
        text.find(f"<{tag}") for tag in ("compiler", "option", "default", "asset", "worldbody")
    ]
    assert order == sorted(order)
    assert str(converted.out) not in text
    if "turned" in converted.files[0]:
        assert "file://" not in text
    readme = (converted.out / "README.md").read_text()
    for note in converted.notes:
        assert note in readme


def test_the_scene_holds_the_robot_and_its_cells(converted):
    model = mujoco.MjModel.from_xml_path(str(converted.out / "scene.xml"))
    assert model.site("robot/tcp").id >= 0
    assert model.site("cell_9").id >= 0
    assert model.opt.timestep == 0.0005
    assert model.key("robot/home").id >= 0


def test_parity_fails_when_a_link_is_moved_or_made_heavier():
    model = load_robot(RobotSource())
    for change, what in (
        (lambda link: setattr(link, "pos", [0, 0, 1e-8]), "frames"),
        (lambda link: setattr(link, "mass", 71.000001), "masses"),
        (lambda link: setattr(link, "ipos", [0.2, 0.2, 0]), "centres of mass"),
        (lambda link: setattr(link.geoms[0], "pos", [0.3, 0.3, 0.3]), "visual bounds"),
    ):
        spec = model.spec.copy()
        change(spec.body("link_3"))
        findings = check_parity(model.description, model.robot, spec.compile())
        assert what in {item.what for item in findings if not item.passed}


def test_two_conversions_are_the_same(tmp_path):
    path = heavy_arm(tmp_path)
    for name in ("a", "b"):
        convert(RobotSource(path=path), tmp_path / name)
    for file in sorted((tmp_path / "a").rglob("*.*")):
        assert file.read_bytes() == (tmp_path / "b" / file.relative_to(tmp_path / "a")).read_bytes()


def test_the_command_reports_what_was_changed(tmp_path, capsys):
    path = heavy_arm(tmp_path)
    out = tmp_path / "out"
    assert main(["convert", str(path), "-o", str(out), "--check"]) == 0
    shown = capsys.readouterr()
    assert shown.err == ""
    for wanted in ("heavy_arm.xml", "jaw_left", "effort", "in memory: holds", "from disk: holds"):
        assert wanted in shown.out


def test_the_bundled_robot_is_converted_without_surprise(tmp_path):
    assert convert(RobotSource(path=bundled_robot()), tmp_path / "out").notes == ()


# ---- the bundled robot under load -----------------------------------------------------------


def test_a_second_of_random_control_raises_no_warning(robot, robot_model):
    data = mujoco.MjData(robot_model)
    mujoco.mj_resetDataKeyframe(robot_model, data, 0)
    rng = np.random.default_rng(8)
    low, high = robot_model.actuator_ctrlrange.T
    for _ in range(20):
        data.ctrl[:] = rng.uniform(low, high)
        mujoco.mj_step(robot_model, data, 100)
    assert data.time == pytest.approx(1.0)
    assert not any(warning.number for warning in data.warning)
    assert np.all(np.isfinite(data.qpos))


@pytest.mark.parametrize("count", [60, pytest.param(1000, marks=pytest.mark.slow)])
def test_the_tcp_sags_less_than_half_a_millimetre_under_an_unmodelled_10_kg(robot, spec, count):
    loaded = spec.copy()
    weight = loaded.body(robot.palm).add_body(name="weight", pos=robot.T_palm_tcp[:3, 3])
    weight.explicitinertial = True
    weight.mass, weight.inertia = 10.0, [0.01] * 3  # gravcomp 0: the controller does not know it
    model = loaded.compile()
    data = mujoco.MjData(model)
    qpos = [model.joint(name).qposadr[0] for name in robot.arm_joints]
    servo = [model.actuator(name).id for name in robot.arm_joints]
    rng = np.random.default_rng(9)
    held, worst = 0, 0.0
    while held < count:
        q = rng.uniform(robot.lower, robot.upper)
        if robot.forward(q)[2, 3] < 0.3:
            continue
        mujoco.mj_resetDataKeyframe(model, data, 0)
        data.qpos[qpos], data.ctrl[servo] = q, q
        mujoco.mj_forward(model, data)
        if data.ncon:
            continue
        before = data.site("tcp").xpos.copy()
        mujoco.mj_step(model, data, 200)
        worst = max(worst, float(np.linalg.norm(data.site("tcp").xpos - before)))
        held += 1
    assert worst < 0.5e-3, f"{1000 * worst:.3f} mm"


def test_the_arm_tracks_within_a_millimetre_at_full_speed(default_run):
    assert default_run.summary["tracking_offset_m"]["max"] < 1e-3


def test_an_episode_of_a_run_loads_with_its_meshes(tmp_path):
    path = turned_arm(tmp_path / "robot")
    out = tmp_path / "run"
    options = ["--robot", str(path), "--cycles", "1", "--cell", "5", "--out", str(out)]
    assert main(["run", *options]) == 0
    episode: Path = out / "episodes" / "0000"
    shutil.rmtree(path.parent)
    model = mujoco.MjModel.from_xml_path(str(episode / "scene.xml"))
    assert model.nmesh >= 14
    assert (episode / "assets").is_dir()
