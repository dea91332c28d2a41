"""The arm and gripper are found in the tree, and a tree that lacks one is refused by name."""

from __future__ import annotations

import signal
import xml.etree.ElementTree as ET
from pathlib import Path

import numpy as np
import pytest

import ik
from kr210_sim.description import load_description
from kr210_sim.exceptions import BadInput
from kr210_sim.mjcf import build_robot, robot_spec
from kr210_sim.robot import find_robot


def test_the_bundled_robot_is_found_by_structure(robot):
    assert robot.root == "base_footprint"
    assert robot.arm_joints == tuple(f"joint_{i}" for i in range(1, 7))
    assert robot.palm == "gripper_link"
    assert robot.fingers == ("right_gripper_finger_link", "left_gripper_finger_link")
    assert {robot.finger_joint, robot.mimic_joint} == {
        "right_gripper_finger_joint", "left_gripper_finger_joint"
    }  # fmt: skip
    assert (robot.finger_open, robot.finger_closed) == (-0.01, 0.06)


def test_the_limits_are_those_of_the_description(robot, description):
    joints = {joint.name: joint for joint in description.model.robot.joints}
    for index, name in enumerate(robot.arm_joints):
        limit = joints[name].limit
        found = [x[index] for x in (robot.lower, robot.upper, robot.velocity, robot.effort)]
        assert found == [limit.lower, limit.upper, limit.velocity, limit.effort]


def test_the_effort_limits_hold_the_rated_load(robot):
    """210 kg at full reach needs this much on joints 2 to 6 [N m]."""
    assert np.all(robot.effort[1:] >= [8712, 4604, 1058, 1059, 206])


def test_the_arrays_of_a_robot_cannot_be_written(robot):
    for values in (robot.lower, robot.upper, robot.velocity, robot.effort):
        with pytest.raises(ValueError, match="read-only"):
            values[0] = 0.0


def test_the_geometry_is_that_of_the_bundled_solver(robot):
    q = np.random.default_rng(1).uniform(robot.lower, robot.upper, (50, 6))
    T = ik.forward(robot.geometry, q)
    np.testing.assert_allclose(T, ik.forward(ik.KR210, q), atol=1e-12)


def test_the_tcp_is_0_20_m_in_front_of_the_palm(robot):
    q = np.random.default_rng(2).uniform(robot.lower, robot.upper, (20, 6))
    T_palm, T_tcp = ik.forward(robot.geometry, q), robot.forward(q)
    np.testing.assert_allclose(T_tcp[:, :3, 3], T_palm[:, :3, 3] + 0.20 * T_palm[:, :3, 0])
    np.testing.assert_allclose(T_tcp[:, :3, :3], T_palm[:, :3, :3])


def test_tcp_and_palm_poses_are_inverse_to_each_other(robot):
    q = np.random.default_rng(3).uniform(robot.lower, robot.upper, (20, 6))
    np.testing.assert_allclose(
        robot.tcp_to_palm(robot.forward(q)), ik.forward(robot.geometry, q), atol=1e-12
    )


def test_the_payload_follows_from_the_grip_force(robot):
    assert robot.grip_force <= 500.0
    assert robot.max_payload == pytest.approx(robot.grip_force / 30.0)


# ---- what is refused ------------------------------------------------------------------------


@pytest.fixture
def tree(description) -> ET.Element:
    """The bundled robot as URDF elements, to be damaged; with little to look at, to be quick."""
    robot = ET.fromstring(description.urdf_text)
    for part in robot.findall("link"):
        for visual in part.findall("visual")[1:]:
            part.remove(visual)
    return robot


def build(path: Path) -> None:
    description = load_description(path)
    robot_spec(description, find_robot(description))


@pytest.fixture
def refusal(tmp_path):
    """Load a damaged tree as a run does; return the one line it is refused with."""

    def load(tree: ET.Element) -> str:
        path = tmp_path / "damaged.urdf"
        ET.ElementTree(tree).write(path)
        with pytest.raises(BadInput) as caught:
            build(path)
        message = str(caught.value)
        assert "\n" not in message
        assert "damaged.urdf" in message, message
        return message

    return load


def joint(tree: ET.Element, name: str) -> ET.Element:
    found = tree.find(f"joint[@name='{name}']")
    assert found is not None
    return found


def link(tree: ET.Element, name: str) -> ET.Element:
    found = tree.find(f"link[@name='{name}']")
    assert found is not None
    return found


def remove(tree: ET.Element, *, joints: tuple[str, ...] = (), links: tuple[str, ...] = ()) -> None:
    for name in joints:
        tree.remove(joint(tree, name))
    for name in links:
        tree.remove(link(tree, name))


def test_a_missing_finger_is_refused(tree, refusal):
    remove(tree, joints=("left_gripper_finger_joint",), links=("left_gripper_finger_link",))
    assert "finger" in refusal(tree)


def test_a_third_finger_is_refused(tree, refusal):
    tree.append(ET.fromstring('<link name="thumb"/>'))
    tree.append(
        ET.fromstring(
            '<joint name="thumb" type="prismatic"><parent link="gripper_link"/>'
            '<child link="thumb"/><axis xyz="1 0 0"/>'
            '<limit lower="0" upper="1" effort="1" velocity="1"/></joint>'
        )
    )
    assert "finger" in refusal(tree)


def test_uncoupled_fingers_are_refused(tree, refusal):
    for name in ("left_gripper_finger_joint", "right_gripper_finger_joint"):
        finger = joint(tree, name)
        for mimic in finger.findall("mimic"):
            finger.remove(mimic)
    assert "mimic" in refusal(tree)


def test_a_finger_that_mimics_something_else_is_refused(tree, refusal):
    joint(tree, "left_gripper_finger_joint").find("mimic").set("joint", "joint_6")
    assert "mimic" in refusal(tree)


def test_a_missing_tcp_is_taken_between_the_pads_and_said(tree, tmp_path):
    remove(tree, joints=("tcp_joint",), links=("tcp",))
    path = tmp_path / "no_tcp.urdf"
    ET.ElementTree(tree).write(path)
    robot = find_robot(load_description(path))
    assert "'tcp'" in robot.notes[0]
    np.testing.assert_allclose(robot.T_palm_tcp[:3, 3], [0.20, 0, 0], atol=5e-3)
    np.testing.assert_allclose(robot.T_palm_tcp[:3, :3], np.eye(3), atol=1e-12)


def test_a_tcp_on_another_link_is_refused(tree, refusal):
    joint(tree, "tcp_joint").find("parent").set("link", "link_5")
    assert "'tcp'" in refusal(tree)


def test_an_arm_of_five_joints_is_refused(tree, refusal):
    moving = joint(tree, "joint_4")
    moving.set("type", "fixed")
    message = refusal(tree)
    assert "six" in message
    assert "joint_3" in message


def test_an_arm_of_seven_joints_is_refused(tree, refusal):
    seventh = joint(tree, "gripper_joint")
    seventh.set("type", "revolute")
    seventh.append(ET.fromstring('<limit lower="-1" upper="1" effort="9" velocity="1"/>'))
    assert "six" in refusal(tree)


def test_a_continuous_arm_joint_is_refused_by_name(tree, refusal):
    joint(tree, "joint_6").set("type", "continuous")
    assert "joint_6" in refusal(tree)


def test_an_arm_without_a_spherical_wrist_is_refused(tree, refusal):
    joint(tree, "joint_6").find("origin").set("xyz", "0.193 0.1 0")
    assert "IK" in refusal(tree)


def test_an_axis_of_no_direction_is_refused(tree, refusal):
    joint(tree, "joint_3").find("axis").set("xyz", "0 0 0")
    assert "axis" in refusal(tree)


def test_fingers_without_pads_grip_with_all_they_have_and_say_so(tree, tmp_path):
    finger = link(tree, "right_gripper_finger_link")
    for element in finger.findall("collision"):
        if "_pad" in element.get("name"):
            finger.remove(element)
    path = tmp_path / "no_pads.urdf"
    ET.ElementTree(tree).write(path)
    description = load_description(path)
    _, notes = build_robot(description, find_robot(description))
    assert "'right_gripper_finger_link'" in notes[0]
    assert "_pad" in notes[0]


def test_a_moving_link_without_mass_is_refused_by_name(tree, refusal):
    part = link(tree, "link_3")
    part.remove(part.find("inertial"))
    assert "mass" in refusal(tree)


def test_a_missing_mesh_is_refused_by_the_name_of_its_shape(tree, refusal):
    shape = link(tree, "link_3").find("collision")
    shape.remove(shape.find("geometry"))
    shape.append(ET.fromstring('<geometry><mesh filename="arm.stl"/></geometry>'))
    assert shape.get("name") in refusal(tree)


def test_a_shape_of_no_size_is_refused(tree, refusal):
    box = link(tree, "link_2").find("collision/geometry/box")
    box.set("size", "0.1 0 0.1")
    assert "size" in refusal(tree)


@pytest.mark.parametrize("element", ["visual", "collision"])
def test_a_shape_without_geometry_is_refused(tree, refusal, element):
    shape = link(tree, "link_3").find(element)
    shape.remove(shape.find("geometry"))
    assert "geometry" in refusal(tree)


def test_a_joint_to_a_link_that_is_not_there_is_refused(tree, refusal):
    remove(tree, links=("link_4",))
    assert "link_4" in refusal(tree)


def test_two_joints_on_one_child_are_refused(tree, refusal):
    tree.append(
        ET.fromstring(
            '<joint name="again" type="fixed"><parent link="base_link"/><child link="link_4"/>'
            "</joint>"
        )
    )
    assert "link_4" in refusal(tree)


def test_a_loop_of_links_is_refused(tree, refusal):
    """In a moment: following it for ever would eat up the memory."""

    def give_up(*_: object) -> None:
        raise TimeoutError("still following the loop after 2 s")

    joint(tree, "fixed_base_joint").find("parent").set("link", "link_6")
    before = signal.signal(signal.SIGALRM, give_up)
    signal.alarm(2)
    try:
        assert "loop" in refusal(tree)
    finally:
        signal.alarm(0)
        signal.signal(signal.SIGALRM, before)


def test_a_second_root_is_refused(tree, refusal):
    tree.append(ET.fromstring('<link name="stray"/>'))
    assert "stray" in refusal(tree)


@pytest.mark.parametrize("what", ["link", "joint"])
def test_a_name_used_twice_is_refused(tree, refusal, what):
    copy = ET.fromstring(ET.tostring(tree.findall(what)[3]))
    tree.append(copy)
    assert copy.get("name") in refusal(tree)
