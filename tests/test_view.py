"""What the viewers draw and write: meshes, frames, ghosts and numbers; no window is opened."""

from __future__ import annotations

import re
import socket
import sys

import mujoco
import numpy as np
import pytest
from conftest import refused

import ik
from kr210_sim.exceptions import BadInput
from kr210_sim.scene import ROBOT_PREFIX
from kr210_sim.source import RobotSource
from kr210_sim.viewers.address import check_address, is_loopback
from kr210_sim.viewers.arm_state import arm_state, nearest_solution
from kr210_sim.viewers.ghosts import COLORS, css, place_ghosts
from kr210_sim.viewers.puppet import Puppet
from kr210_sim.viewers.tables import branches_html, state_html, status_html
from kr210_sim.viewers.visuals import Part, plain_bodies, visible_floors, visible_parts

Q = np.array([0.4, 0.3, -0.6, 0.9, 0.8, -0.5])

SHAPES = """
<mujoco>
  <asset>
    <material name="red" rgba="1 0 0 1" shininess="0.9"/>
    <texture name="checks" type="2d" builtin="flat" rgb1="0.2 0.4 0.6" width="8" height="8"/>
    <material name="checked" texture="checks"/>
  </asset>
  <worldbody>
    <geom type="plane" size="0 0 1" pos="0 0 -1" material="checked"/>
    <body pos="1 2 3">
      <geom type="box" size="0.1 0.2 0.3" pos="0.5 0 0" material="red"/>
      <geom type="cylinder" size="0.1 0.4" material="red"/>
      <geom type="sphere" size="0.2" rgba="0 1 0 0.5"/>
      <geom type="capsule" size="0.1 0.2" rgba="0 0 1 1"/>
      <geom type="ellipsoid" size="0.1 0.2 0.3" rgba="0 1 1 1"/>
      <geom type="box" size="9 9 9" group="3"/>
      <geom type="box" size="9 9 9" rgba="1 1 1 0"/>
    </body>
  </worldbody>
</mujoco>
"""


@pytest.fixture(scope="module")
def shapes() -> mujoco.MjModel:
    return mujoco.MjModel.from_xml_string(SHAPES)


@pytest.fixture(scope="module")
def parts(robot_model) -> list[Part]:
    return visible_parts(robot_model)


@pytest.fixture
def puppet(robot, robot_model) -> Puppet:
    return Puppet(robot_model, robot=robot)


def volume(part) -> float:
    """Volume that the outward faces of a part enclose [m^3]."""
    a, b, c = (part.vertices[part.faces[:, i]] for i in range(3))
    return float(np.einsum("ij,ij->", a, np.cross(b, c)) / 6)


# ---- meshes ---------------------------------------------------------------------------------


def test_every_visible_shape_is_drawn_at_its_size_and_in_its_color(shapes):
    volumes = {part.rgba: volume(part) for part in visible_parts(shapes)}
    wanted = {
        (1.0, 0.0, 0.0, 1.0): 8 * 0.1 * 0.2 * 0.3 + np.pi * 0.1**2 * 0.8,
        (0.0, 1.0, 0.0, 0.5): 4 / 3 * np.pi * 0.2**3,
        (0.0, 0.0, 1.0, 1.0): np.pi * 0.1**2 * 0.4 + 4 / 3 * np.pi * 0.1**3,
        (0.0, 1.0, 1.0, 1.0): 4 / 3 * np.pi * 0.1 * 0.2 * 0.3,
    }
    assert volumes.keys() == wanted.keys()  # neither collision shapes nor what is clear as air
    for color, expected in wanted.items():
        assert volumes[color] == pytest.approx(expected, rel=0.02)


def test_a_plane_is_a_floor_in_the_mean_color_of_its_texture(shapes):
    (floor,) = visible_floors(shapes)
    np.testing.assert_allclose(floor.T_world_plane[:3, 3], [0, 0, -1])
    np.testing.assert_allclose(floor.rgba, [0.2, 0.4, 0.6, 1.0], atol=0.005)


def test_meshes_of_the_robot_lie_where_mujoco_has_them(robot_model, parts):
    shape = robot_model.geom("link_4_visual_0")  # the only one of its colour on its body
    color = tuple(robot_model.mat_rgba[shape.matid[0]].tolist())
    (part,) = [p for p in parts if (p.body, p.rgba) == (shape.bodyid[0], color)]
    rotation = np.empty(9)
    mujoco.mju_quat2Mat(rotation, shape.quat)
    local = (part.vertices - shape.pos) @ rotation.reshape(3, 3)
    center, half = robot_model.geom_aabb[shape.id].reshape(2, 3)
    np.testing.assert_allclose(local.min(axis=0), center - half, atol=1e-6)
    np.testing.assert_allclose(local.max(axis=0), center + half, atol=1e-6)


def test_merged_bodies_have_every_face(parts):
    merged = plain_bodies(parts)
    assert sum(len(part.faces) for part in merged) == sum(len(part.faces) for part in parts)
    assert sum(map(volume, merged)) == pytest.approx(sum(map(volume, parts)))
    assert len({part.body for part in merged}) == len(merged)


# ---- poses ----------------------------------------------------------------------------------


def test_the_puppet_stands_where_forward_kinematics_says(robot, puppet):
    positions, _ = puppet.place_robot(Q)
    T_base_palm = ik.forward(robot.geometry, Q)
    np.testing.assert_allclose(positions[puppet.links()[robot.palm]], T_base_palm[:3, 3], atol=1e-9)
    np.testing.assert_allclose(puppet.site("tcp"), robot.forward(Q)[:3, 3], atol=1e-9)


def test_the_puppet_finds_robot_and_cameras_in_a_scene(scene):
    puppet = Puppet(scene.spec.copy().compile(), prefix=ROBOT_PREFIX, robot=scene.robot)
    puppet.place_robot(Q)
    np.testing.assert_allclose(puppet.site("tcp"), scene.robot.forward(Q)[:3, 3], atol=1e-9)
    assert scene.robot.palm in puppet.links()
    assert "shelf" not in puppet.links()
    views = puppet.views()
    assert tuple(views) == scene.cameras
    np.testing.assert_allclose(views["overview"].position, [-3.3, -4.0, 3.5])
    ahead = views["overview"].look_at - views["overview"].position
    np.testing.assert_allclose(  # z of xyaxes points back
        np.cross([0.727, -0.687, 0], [0.235, 0.248, 0.940]), -ahead / np.linalg.norm(ahead),
        atol=1e-3,
    )  # fmt: skip


def test_the_state_is_what_ik_forward_says(robot):
    state = arm_state(robot, Q)
    np.testing.assert_array_equal(state.T_base_palm, ik.forward(robot.geometry, Q))
    np.testing.assert_array_equal(state.T_base_tcp, robot.forward(Q))
    wrist = ik.wrist_center(robot.geometry, state.T_base_palm)
    np.testing.assert_allclose(state.p_base_wrist_center, wrist, atol=1e-12)


def test_the_last_dh_frame_leads_to_the_palm(robot):
    state = arm_state(robot, Q)
    table = ik.dh_from_chain(robot.chain.origins, robot.chain.axes, robot.chain.T_last_palm)
    np.testing.assert_allclose(state.T_base_dh[-1] @ table.T_tool, state.T_base_palm, atol=1e-12)
    assert len(state.T_base_dh) == 8


def test_every_branch_reaches_the_pose_and_one_is_the_arm_itself(robot):
    state = arm_state(robot, Q)
    found = [branch for branch in state.branches if branch.q is not None]
    assert len(state.branches) == 8
    assert len(found) >= 4
    for branch in found:
        reached = ik.forward(robot.geometry, branch.q)
        np.testing.assert_allclose(reached, state.T_base_palm, atol=1e-12)
        copies = ik.turns(branch.q, robot.lower, robot.upper).q
        assert branch.within_limits == (len(copies) > 0)
    assert [branch.name for branch in state.branches if branch.current] == ["front up +"]


def test_the_nearest_solution_is_that_of_the_same_branch(robot):
    T = ik.forward(robot.geometry, Q)
    np.testing.assert_allclose(nearest_solution(robot, T, Q + 0.05), Q, atol=1e-9)
    far = T.copy()
    far[0, 3] += 9.0
    assert nearest_solution(robot, far, Q) is None


# ---- ghosts ---------------------------------------------------------------------------------


def test_ghosts_are_arms_with_the_same_palm_in_other_branches(robot, puppet):
    state = arm_state(robot, Q)
    ghosts = place_ghosts(puppet, state)
    others = [i for i, b in enumerate(state.branches) if b.q is not None and not b.current]
    assert ghosts.branches.tolist() == others
    palm = puppet.links()[robot.palm]
    for positions in ghosts.positions:
        np.testing.assert_allclose(positions[palm], state.T_base_palm[:3, 3], atol=1e-9)
    assert not ghosts.seen[:, puppet.links()[robot.root]].any()  # the base is the arm's own
    assert not ghosts.seen[:, palm].any()
    elbow = puppet.links()["link_3"]
    twin = others.index(1)  # the flipped wrist of the arm's own branch
    assert not ghosts.seen[twin, elbow]
    assert ghosts.seen[twin, puppet.links()["link_4"]]
    assert ghosts.seen[others.index(2), elbow]


def test_ghosts_beyond_the_limits_can_be_left_out(robot, puppet):
    state = arm_state(robot, np.zeros(6))
    within = [i for i, b in enumerate(state.branches) if b.within_limits and not b.current]
    beyond = [i for i, b in enumerate(state.branches) if b.q is not None and not b.within_limits]
    assert beyond
    shown = place_ghosts(puppet, state, beyond=False)
    assert shown.branches.tolist() == within
    everything = place_ghosts(puppet, state)
    faint = everything.opacities[[everything.branches.tolist().index(i) for i in beyond]]
    assert faint.max() < shown.opacities.min()


@pytest.mark.slow
def test_the_gizmo_leads_the_arm_to_where_it_can_go():
    pytest.importorskip("viser", reason="the extra 'view' is not installed")
    from kr210_sim.viewers.arm_page import ArmPage
    from kr210_sim.viewers.page import Page
    from kr210_sim.viewers.subject import load_subject

    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    page = Page("127.0.0.1", port, "test")
    try:
        arm = ArmPage(page, load_subject(None, RobotSource()))
        T = ik.forward(arm.robot.geometry, Q)
        arm.reach(T)
        np.testing.assert_allclose(ik.forward(arm.robot.geometry, arm.q), T, atol=1e-9)
        T[0, 3] += 9.0
        before = arm.q
        assert not arm.reach(T)
        np.testing.assert_array_equal(arm.q, before)
    finally:
        page.close()


# ---- numbers --------------------------------------------------------------------------------


def test_the_tables_say_the_numbers_and_their_frames(robot):
    state = arm_state(robot, Q)
    text = state_html(state, base=robot.root, palm=robot.palm)
    assert f"{robot.palm} in the frame of {robot.root}" in text
    for name, values in (("T_base_tcp", state.T_base_tcp), ("T_base_palm", state.T_base_palm)):
        cells = re.search(rf'id="{name}">(.*?)</table>', text, re.S)[1]
        numbers = [float(cell) for cell in re.findall(r"<td>(.*?)</td>", cells)]
        np.testing.assert_allclose(np.reshape(numbers, (4, 4)), values, atol=5.1e-7)
    assert "-0.000000" not in state_html(arm_state(robot, np.zeros(6)), base="b", palm="p")


def test_the_table_of_branches_has_eight_rows(robot):
    state = arm_state(robot, Q)
    text = branches_html(state.branches, [css(color) for color in COLORS])
    assert text.count('class="dot"') == 8
    assert text.count("out of reach") == sum(branch.q is None for branch in state.branches)
    assert f"<td>{np.degrees(Q[0]):.1f}</td>" in text


def test_text_from_files_is_no_html():
    assert "<b>" not in status_html([("reason", "<b>x</b>")]).partition("</style>")[2]


# ---- the command line -----------------------------------------------------------------------


def test_a_port_in_use_is_refused_in_one_line(capfd):
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        port = taken.getsockname()[1]
        assert "--port" in refused(capfd, "--port", str(port))
        with pytest.raises(BadInput, match="in use"):
            check_address("127.0.0.1", port)


@pytest.mark.parametrize(
    ("words", "named"),
    [
        (("--port", "0"), "--port"),
        (("--port", "70000"), "--port"),
        (("--port", "x"), "--port"),
        (("--host", "203.0.113.1"), "--host"),
        (("--host", "no such"), "--host"),
    ],
)
def test_an_impossible_address_is_refused(capfd, words, named):
    assert named in refused(capfd, *words)


def test_without_the_extra_one_line_says_what_to_install(capfd, monkeypatch):
    monkeypatch.setitem(sys.modules, "viser", None)
    assert "pip install 'kr210-sim[view]'" in refused(capfd)


@pytest.mark.parametrize("name", ["nothing", "nothing.urdf"])
def test_what_is_neither_robot_scene_nor_run_is_refused(capfd, name):
    pytest.importorskip("viser")
    assert name in refused(capfd, name)


def test_only_this_machine_is_loopback():
    assert all(map(is_loopback, ("127.0.0.1", "::1", "localhost")))
    assert not any(map(is_loopback, ("0.0.0.0", "192.168.0.2", "::")))
