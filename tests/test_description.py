"""The bundled description says what the facts say; a broken one is refused in one clear line."""

from __future__ import annotations

import math
import xml.etree.ElementTree as ET
from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from kr210_sim.description import Description, load_description
from kr210_sim.exceptions import BadInput
from kr210_sim.resources import resource

# The joint table of the original course's model: type, parent, child, origin, axis, limits, speed.
# Angles in degrees, lengths in metres; rpy is 0 everywhere.
JOINTS = {
    "fixed_base_joint": ("fixed", "base_footprint", "base_link", (0, 0, 0)),
    "joint_1": ("revolute", "base_link", "link_1", (0, 0, 0.33), (0, 0, 1), -185, 185, 123),
    "joint_2": ("revolute", "link_1", "link_2", (0.35, 0, 0.42), (0, 1, 0), -45, 85, 115),
    "joint_3": ("revolute", "link_2", "link_3", (0, 0, 1.25), (0, 1, 0), -210, 65, 112),
    "joint_4": ("revolute", "link_3", "link_4", (0.96, 0, -0.054), (1, 0, 0), -350, 350, 179),
    "joint_5": ("revolute", "link_4", "link_5", (0.54, 0, 0), (0, 1, 0), -125, 125, 172),
    "joint_6": ("revolute", "link_5", "link_6", (0.193, 0, 0), (1, 0, 0), -350, 350, 219),
    "gripper_joint": ("fixed", "link_6", "gripper_link", (0.11, 0, 0)),
}
FINGERS = {
    "right_gripper_finger_joint": ("right_gripper_finger_link", (0.15, -0.0725, 0), (0, 1, 0)),
    "left_gripper_finger_joint": ("left_gripper_finger_link", (0.15, 0.0725, 0), (0, -1, 0)),
}
MASSES = {
    "base_link": 150, "link_1": 138, "link_2": 95, "link_3": 71, "link_4": 17, "link_5": 7,
    "link_6": 0.5, "gripper_link": 0.3,
    "right_gripper_finger_link": 0.1, "left_gripper_finger_link": 0.1,
}  # fmt: skip
# Centre of mass and principal moments in the link frame.
INERTIALS = {
    "base_link": ((0, 0, 0), (60, 70, 100)),
    "link_1": ((0, 0, 0.4), (30, 50, 50)),
    "link_2": ((0, 0, 0.44751), (40, 40, 10)),
    "link_3": ((0.18842, 0.18344, -0.042799), (1, 10, 10)),
    "link_4": ((0.27146, -0.007326, 0), (0.18, 0.55, 0.64)),
    "link_5": ((0, 0, 0), (0.04, 0.068, 0.068)),
    "link_6": ((0, 0, 0), (0.004, 0.003, 0.003)),
}


def joints_of(description: Description) -> dict:
    return {joint.name: joint for joint in description.model.robot.joints}


def origin_of(joint) -> np.ndarray:
    return np.eye(4) if joint.origin is None else joint.origin


@pytest.mark.parametrize("name", JOINTS)
def test_the_arm_has_the_joints_of_the_table(description, name):
    kind, parent, child, origin, *moving = JOINTS[name]
    joint = joints_of(description)[name]
    assert (joint.type, joint.parent, joint.child) == (kind, parent, child)
    np.testing.assert_array_equal(origin_of(joint)[:3, 3], origin)
    np.testing.assert_array_equal(origin_of(joint)[:3, :3], np.eye(3))
    if moving:
        axis, lower, upper, speed = moving
        np.testing.assert_array_equal(joint.axis, axis)
        found = (joint.limit.lower, joint.limit.upper, joint.limit.velocity)
        assert found == pytest.approx([math.radians(x) for x in (lower, upper, speed)], abs=1e-15)


@pytest.mark.parametrize("name", FINGERS)
def test_the_gripper_has_the_finger_joints_of_the_table(description, name):
    child, origin, axis = FINGERS[name]
    joint = joints_of(description)[name]
    assert (joint.type, joint.parent, joint.child) == ("prismatic", "gripper_link", child)
    np.testing.assert_array_equal(origin_of(joint)[:3, 3], origin)
    np.testing.assert_array_equal(joint.axis, axis)
    assert (joint.limit.lower, joint.limit.upper) == (-0.01, 0.06)


def test_no_joint_is_there_beside_the_table_but_the_tcp(description):
    assert set(joints_of(description)) == {*JOINTS, *FINGERS, "tcp_joint"}
    tcp = joints_of(description)["tcp_joint"]
    assert (tcp.type, tcp.parent, tcp.child) == ("fixed", "gripper_link", "tcp")
    np.testing.assert_array_equal(tcp.origin[:3, 3], [0.20, 0, 0])


def test_the_masses_are_those_of_the_table_478_5_kg_without_the_gripper(description):
    found = {
        link.name: link.inertial.mass
        for link in description.model.robot.links
        if link.inertial is not None
    }
    assert found == MASSES
    arm = [mass for name, mass in found.items() if "gripper" not in name]
    assert sum(arm) == pytest.approx(478.5, abs=1e-9)
    assert sum(found.values()) == pytest.approx(479.0, abs=1e-9)


@pytest.mark.parametrize("name", INERTIALS)
def test_the_inertials_are_those_of_the_table(description, name):
    inertial = next(x.inertial for x in description.model.robot.links if x.name == name)
    centre, moments = INERTIALS[name]
    origin = np.eye(4) if inertial.origin is None else inertial.origin
    np.testing.assert_array_equal(origin[:3, 3], centre)
    np.testing.assert_array_equal(inertial.inertia, np.diag(moments))


def test_every_moving_link_can_be_seen_and_touched(description):
    for link in description.model.robot.links:
        if link.name not in ("base_footprint", "tcp"):
            assert link.visuals, link.name
            assert link.collisions, link.name


def test_a_urdf_is_read_like_the_xacro_it_was_expanded_from(description, tmp_path):
    path = tmp_path / "arm.urdf"
    path.write_text(description.urdf_text)
    again = load_description(path)
    assert again.path == path
    assert [x.name for x in again.model.robot.joints] == [
        x.name for x in description.model.robot.joints
    ]


def test_expanding_twice_gives_the_same_text(description):
    again = load_description(resource("assets", "kr210", "kr210.urdf.xacro"))
    assert again.urdf_text == description.urdf_text


# ---- what is refused ------------------------------------------------------------------------


def assert_refused(path: Path, *words: str) -> None:
    """Loading raises BadInput, one line long, that names the file and these words."""
    with pytest.raises(BadInput) as refusal:
        load_description(path)
    message = str(refusal.value)
    assert "\n" not in message
    for word in (path.name, *words):
        assert word in message, message


def test_a_missing_file_is_refused_by_name(tmp_path):
    assert_refused(tmp_path / "nothing.xacro", "no file", ".urdf")


def test_a_folder_is_no_description(tmp_path):
    folder = tmp_path / "arm.urdf"
    folder.mkdir()
    assert_refused(folder, "no file")


@pytest.mark.parametrize("suffix", [".urdf", ".xacro"])
@pytest.mark.parametrize("text", ["", "not XML at all", "<robot><link></robot>", "<robot name='x'"])
def test_broken_xml_is_refused(tmp_path, suffix, text):
    path = tmp_path / f"arm{suffix}"
    path.write_text(text)
    assert_refused(path)


def test_bytes_that_are_no_text_are_refused(tmp_path):
    path = tmp_path / "arm.urdf"
    path.write_bytes(b"\xff\xfe\x00robot")
    assert_refused(path, "cannot be read")


@pytest.mark.parametrize("suffix", [".urdf", ".xacro"])
def test_a_root_that_is_no_robot_is_refused(tmp_path, suffix):
    path = tmp_path / f"arm{suffix}"
    path.write_text("<mujoco/>")
    assert_refused(path, "<mujoco>", "<robot>")


XACRO = '<robot name="x" xmlns:xacro="http://www.ros.org/wiki/xacro">{}</robot>'


@pytest.mark.parametrize(
    "body",
    [
        pytest.param('<link name="${nowhere}"/>', id="undefined property"),
        pytest.param('<link name="${1/0}"/>', id="division by zero"),
        pytest.param('<link name="${[1][2]}"/>', id="index"),
        pytest.param("<link name=\"${'a' + 1}\"/>", id="type"),
        pytest.param('<link name="${1 +}"/>', id="syntax"),
        pytest.param('<link name="${1"/>', id="brace"),
        pytest.param("<xacro:nothing/>", id="undefined macro"),
        pytest.param('<xacro:include filename="gone.xacro"/>', id="missing include"),
        pytest.param('<xacro:include filename="$(find nowhere)/a.xacro"/>', id="unknown package"),
        pytest.param('<link name="$(arg nothing)"/>', id="undefined argument"),
        pytest.param('<link name="$(optenv)"/>', id="empty substitution"),
        pytest.param(
            '<xacro:macro name="a" params="n"><link name="${n}"/></xacro:macro><xacro:a/>',
            id="missing parameter",
        ),
        pytest.param(
            '<xacro:macro name="a"><xacro:a/></xacro:macro><xacro:a/>', id="endless recursion"
        ),
    ],
)
def test_a_xacro_that_does_not_expand_is_refused(tmp_path, body, capfd):
    path = tmp_path / "arm.xacro"
    path.write_text(XACRO.format(body))
    assert_refused(path)
    assert capfd.readouterr() == ("", "")  # the one line is the caller's to print


def test_a_refused_xacro_does_not_spoil_the_next(tmp_path, description):
    path = tmp_path / "arm.xacro"
    path.write_text(XACRO.format('<link name="${nowhere}"/>'))
    with pytest.raises(BadInput):
        load_description(path)
    again = load_description(resource("assets", "kr210", "kr210.urdf.xacro"))
    assert again.urdf_text == description.urdf_text


def set_on(path: str, **values: str) -> Callable[[ET.Element], None]:
    return lambda robot: robot.find(path).attrib.update(values)


set_limit = partial(set_on, "joint[@name='joint_3']/limit")
set_origin = partial(set_on, "joint[@name='joint_3']/origin")
set_axis = partial(set_on, "joint[@name='joint_3']/axis")
set_inertia = partial(set_on, "link[@name='link_3']/inertial/inertia")


def set_mass(value: str) -> Callable[[ET.Element], None]:
    return lambda robot: robot.find("link[@name='link_3']/inertial/mass").set("value", value)


def drop(joint: str, element: str) -> Callable[[ET.Element], None]:
    def change(robot: ET.Element) -> None:
        parent = robot.find(f"joint[@name='{joint}']")
        parent.remove(parent.find(element))

    return change


def set_joint(attribute: str, value: str) -> Callable[[ET.Element], None]:
    return lambda robot: robot.find("joint[@name='joint_3']").set(attribute, value)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        pytest.param(drop("joint_3", "limit"), ("joint_3", "limit"), id="no limit"),
        pytest.param(set_limit(lower="2", upper="1"), ("joint_3", "lower"), id="lower > upper"),
        pytest.param(set_limit(lower="1", upper="1"), ("joint_3", "lower"), id="lower = upper"),
        pytest.param(set_limit(lower="nan"), ("joint_3", "limit"), id="lower nan"),
        pytest.param(set_limit(upper="inf"), ("joint_3", "limit"), id="upper inf"),
        pytest.param(set_limit(upper="wide"), (), id="upper no number"),
        pytest.param(set_limit(velocity="0"), ("joint_3", "velocity"), id="velocity 0"),
        pytest.param(set_limit(velocity="-1"), ("joint_3", "velocity"), id="velocity < 0"),
        pytest.param(set_limit(velocity="1e308"), ("joint_3", "velocity"), id="velocity too large"),
        pytest.param(set_limit(effort="nan"), ("joint_3", "effort"), id="effort nan"),
        pytest.param(set_origin(xyz="0 nan 0"), ("joint_3", "origin"), id="origin nan"),
        pytest.param(set_origin(xyz="0 1e308 0"), ("joint_3", "origin"), id="origin too far"),
        pytest.param(set_axis(xyz="0 0 0"), ("joint_3", "axis"), id="axis 0"),
        pytest.param(set_axis(xyz="0 inf 0"), ("joint_3", "axis"), id="axis inf"),
        pytest.param(set_axis(xyz="0 nan 0"), ("joint_3", "axis"), id="axis nan"),
        pytest.param(set_mass("0"), ("link_3", "mass"), id="mass 0"),
        pytest.param(set_mass("-71"), ("link_3", "mass"), id="mass < 0"),
        pytest.param(set_mass("nan"), ("link_3", "mass"), id="mass nan"),
        pytest.param(set_mass("1e60"), ("link_3", "mass"), id="mass too large"),
        pytest.param(set_mass("heavy"), (), id="mass no number"),
        pytest.param(set_inertia(ixx="nan"), ("link_3", "inertia"), id="inertia nan"),
        pytest.param(set_joint("type", "floating"), ("joint_3", "floating"), id="joint type"),
        pytest.param(set_joint("type", "hinge"), (), id="unknown joint type"),
        pytest.param(drop("joint_3", "parent"), (), id="joint without parent"),
    ],
)
def test_an_impossible_value_is_refused_by_link_or_joint_and_field(
    description, tmp_path, change, words
):
    robot = ET.fromstring(description.urdf_text)
    for link in robot.findall("link"):
        for visual in link.findall("visual"):  # quicker to read without
            link.remove(visual)
    change(robot)
    path = tmp_path / "arm.urdf"
    ET.ElementTree(robot).write(path)
    assert_refused(path, *words)
