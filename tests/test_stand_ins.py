"""The stand-ins for ROS behave as the originals did, and Python 2 means what it meant."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from kr210_sim.grading import python2
from kr210_sim.grading.findings import Refused
from kr210_sim.grading.stand_ins import angles, messages, rospy, services
from kr210_sim.grading.stand_ins import transformations as tf
from kr210_sim.grading.stand_ins.install import _Inert

FIXED = ["xyz", "xzy", "yxz", "yzx", "zxy", "zyx", "xyx", "xzx", "yxy", "yzy", "zxz", "zyz"]
AXES = [kind + axes for kind in "sr" for axes in FIXED]


@pytest.mark.parametrize("axes", AXES)
def test_euler_angles_are_scipys(axes):
    rng = np.random.default_rng(0)
    order = axes[1:].upper() if axes[0] == "r" else axes[1:]
    for a, b, c in rng.uniform(-3.0, 3.0, (20, 3)):
        R = tf.euler_matrix(a, b, c, axes)
        expected = Rotation.from_euler(order, [a, b, c]).as_matrix()
        np.testing.assert_allclose(R[:3, :3], expected, atol=1e-12)
        back = tf.euler_matrix(*tf.euler_from_matrix(R, axes), axes)
        np.testing.assert_allclose(back, R, atol=1e-12)
        q = tf.quaternion_from_euler(a, b, c, axes)
        np.testing.assert_allclose(tf.quaternion_matrix(q), R, atol=1e-12)


@pytest.mark.parametrize("axes", AXES)
def test_euler_angles_hold_where_two_axes_are_parallel(axes):
    flat = 0.0 if axes[1] == axes[3] else math.pi / 2
    for b in (flat, -flat, math.pi - flat):
        R = tf.euler_matrix(0.3, b, 0.4, axes)
        back = tf.euler_matrix(*tf.euler_from_matrix(R, axes), axes)
        np.testing.assert_allclose(back, R, atol=1e-7)


def test_quaternions_are_scipys():
    rng = np.random.default_rng(1)
    for q, p in rng.normal(size=(50, 2, 4)):
        q, p = q / np.linalg.norm(q), p / np.linalg.norm(p)
        R = Rotation.from_quat(q)
        np.testing.assert_allclose(tf.quaternion_matrix(3 * q)[:3, :3], R.as_matrix(), atol=1e-12)
        found = tf.quaternion_from_matrix(R.as_matrix())
        assert abs(abs(found @ q) - 1.0) < 1e-12
        product = (R * Rotation.from_quat(p)).as_matrix()
        multiplied = tf.quaternion_matrix(tf.quaternion_multiply(q, p))
        np.testing.assert_allclose(multiplied[:3, :3], product, atol=1e-12)
        identity = tf.quaternion_multiply(q, tf.quaternion_inverse(q))
        np.testing.assert_allclose(identity, [0, 0, 0, 1], atol=1e-12)


def test_rotations_and_translations_compose():
    T = tf.concatenate_matrices(
        tf.translation_matrix([1, 2, 3]), tf.rotation_matrix(math.pi / 2, [0, 0, 2])
    )
    np.testing.assert_allclose(T @ [1, 0, 0, 1], [1, 3, 3, 1], atol=1e-12)
    np.testing.assert_allclose(tf.inverse_matrix(T) @ T, tf.identity_matrix(), atol=1e-12)
    about = tf.rotation_matrix(1.0, [0, 1, 0], [1, 2, 3])
    np.testing.assert_allclose(about @ [1, 2, 3, 1], [1, 2, 3, 1], atol=1e-12)
    np.testing.assert_allclose(tf.translation_from_matrix(T), [1, 2, 3])


def test_angles_are_normalised():
    assert angles.normalize_angle(3 * math.pi / 2) == pytest.approx(-math.pi / 2)
    assert angles.normalize_angle_positive(-1.0) == pytest.approx(2 * math.pi - 1.0)
    assert angles.shortest_angular_distance(3.0, -3.0) == pytest.approx(2 * math.pi - 6.0)
    assert angles.two_pi_complement(1.0) == pytest.approx(1.0 - 2 * math.pi)
    assert angles.to_degrees(angles.from_degrees(7.0)) == pytest.approx(7.0)


def test_messages_have_their_fields_and_no_others():
    pose = messages.Pose()
    pose.position.x = 1.0
    assert messages.Pose().position.x == 0.0
    assert messages.Point(1.0, 2.0, 3.0) == messages.Point(x=1.0, y=2.0, z=3.0)
    with pytest.raises(AttributeError):
        messages.JointTrajectoryPoint().position = [0.0]
    with pytest.raises(AttributeError):
        messages.JointTrajectoryPoint(position=[0.0])
    with pytest.raises(TypeError):
        messages.Point(1.0)
    assert services.CalculateIKResponse([1]).points == [1]
    assert (
        messages.JointTrajectoryPoint().positions is not messages.JointTrajectoryPoint().positions
    )


def test_the_simulator_tells_joint_angles(monkeypatch):
    world = rospy.World()
    world.joints = {"joint_4": 0.5}
    monkeypatch.setattr(rospy, "world", world)
    ask = rospy.ServiceProxy("/gazebo/get_joint_properties", services.GetJointProperties)
    for answer in (
        ask("joint_4"),
        ask(joint_name="kuka::joint_4"),
        ask(services.GetJointPropertiesRequest("joint_4")),
    ):
        assert (answer.position, answer.success) == ([0.5], True)
    assert not ask("joint_9").success
    with pytest.raises(rospy.ServiceException):
        rospy.ServiceProxy("/gazebo/set_model_state", object)()


def test_a_service_is_captured_and_logs_are_kept(monkeypatch, capsys):
    world = rospy.World()
    served = []
    world.serve = lambda: served.append(True)
    monkeypatch.setattr(rospy, "world", world)
    rospy.init_node("IK_server")
    service = rospy.Service("calculate_ik", services.CalculateIK, len)
    assert world.services == [("calculate_ik", services.CalculateIK, len)]
    rospy.spin()
    service.spin()
    assert not rospy.is_shutdown()
    assert len(served) == 3
    rospy.loginfo("%d of %s", 3, "four")
    rospy.logwarn_once("once")
    rospy.logwarn_once("once")
    assert capsys.readouterr().out == "[INFO] 3 of four\n[WARN] once\n"
    assert rospy.get_name() == "/IK_server"
    assert rospy.get_param("~limit", 3) == 3
    assert (rospy.Time(3) - rospy.Time(1, 500_000_000)).to_sec() == 1.5


def test_instants_and_spans_are_reckoned_with():
    span = rospy.Duration(2, 250_000_000)
    assert (span.secs, span.nsecs) == (2, 250_000_000)
    assert (span.to_sec(), span.to_nsec(), repr(span)) == (2.25, 2_250_000_000, "2250000000")
    later = rospy.Time.from_sec(10.5) + span
    assert isinstance(later, rospy.Time)
    assert later.to_sec() == 12.75
    assert rospy.Time(10) < later > rospy.Time(12, 700_000_000)
    assert (rospy.Duration(1) - span).to_sec() == -1.25
    assert (rospy.Duration(-1.25).secs, rospy.Duration(-1.25).nsecs) == (-2, 750_000_000)


def test_a_node_waits_as_long_as_it_says(monkeypatch):
    waited = []
    monkeypatch.setattr(rospy._time, "sleep", waited.append)
    rospy.Rate(8.0).sleep()
    rospy.sleep(rospy.Duration(1, 500_000_000))
    rospy.sleep(0.75)
    assert waited == [0.125, 1.5, 0.75]


def test_a_node_has_parameters_and_a_command_line(monkeypatch):
    monkeypatch.setattr(rospy, "world", rospy.World())
    assert not rospy.has_param("~rate")
    with pytest.raises(KeyError, match="rate"):
        rospy.get_param("~rate")
    rospy.set_param("~rate", 5)
    assert rospy.has_param("~rate")
    assert rospy.get_param("~rate", 9) == 5
    assert rospy.get_name() == "/unnamed"
    assert rospy.myargv(["node.py", "__name:=ik", "fast"]) == ["node.py", "fast"]


def test_a_service_that_is_shut_down_is_offered_no_longer(monkeypatch):
    monkeypatch.setattr(rospy, "world", rospy.World())
    first = rospy.Service("a", services.CalculateIK, len)
    rospy.Service("b", services.CalculateIK, abs)
    first.shutdown("done")
    assert rospy.world.services == [("b", services.CalculateIK, abs)]


@pytest.mark.parametrize("axes", ["", "sxy", "qxyz", "sxxy", "sxyy", "sxyw", None])
def test_axes_that_name_no_order_are_refused(axes):
    with pytest.raises(KeyError):
        tf.euler_matrix(0.1, 0.2, 0.3, axes)


def test_vectors_are_measured_and_made_units_along_an_axis():
    rows = np.array([[3.0, 4.0], [0.0, 2.0]])
    np.testing.assert_allclose(tf.vector_norm(rows, axis=1), [5.0, 2.0])
    np.testing.assert_allclose(tf.unit_vector(rows, axis=1), [[0.6, 0.8], [0.0, 1.0]])
    out = np.zeros(2)
    assert tf.unit_vector([0.0, -2.0], out=out) is None
    assert out.tolist() == [0.0, -1.0]


def test_quaternions_of_an_axis_and_of_nothing():
    q = tf.quaternion_about_axis(0.4, [0.0, 0.0, 5.0])
    expected = Rotation.from_rotvec([0.0, 0.0, 0.4]).as_matrix()
    np.testing.assert_allclose(tf.quaternion_matrix(q)[:3, :3], expected, atol=1e-15)
    assert np.array_equal(tf.quaternion_matrix([0.0, 0.0, 0.0, 0.0]), np.eye(4))


def test_drawing_without_matplotlib_does_nothing():
    plt = _Inert("pyplot")
    figure, axes = plt.subplots(2)
    axes[0].plot([1, 2], label="error").set_color("red")
    figure.savefig("error.png")
    with pytest.raises(AttributeError):
        _ = plt.__all__


# ---- Python 2 -------------------------------------------------------------------------------

OLD = """
import sys
class Odd(Exception): pass
def f((a, b), c):
\tprint >>sys.stdout, 'x', a
        print 'y',
\ttry:
\t    raise Odd, 'no'
\texcept Odd, error:
\t    print `error.args`
\treturn a / b, a <> c, 0755, 10L
total = reduce(lambda x, y: x + y, xrange(4))
table = {1: 2}
kept = [table.has_key(1), map(str, [1]), table.keys()[0], 7 / 2, 7 / 2., -7 / 2, 8. / 3]
kept[3] /= 2
answer = f((7, 2), 3)
half = 1
half /= 2
odd = Odd()
odd.whole = 7
odd.whole /= 2
odd.parts = {"a": odd.whole}
"""


def run_python2(text: str) -> dict:
    pytest.importorskip("fissix")
    names = python2.builtins2()
    exec(python2.compile_python2(python2.to_python3(text), "old.py"), names)
    return names


def test_python2_means_what_it_meant(capsys):
    names = run_python2(OLD)
    assert names["answer"] == (3, True, 0o755, 10)
    assert names["total"] == 6
    assert names["kept"][:3] == [True, ["1"], 1]
    assert names["kept"][3:] == [1, 3.5, -4, 8 / 3]
    assert names["half"] == 0
    assert names["odd"].parts == {"a": 3}
    assert capsys.readouterr().out == "x 7\ny ('no',)\n"


def test_errors_are_reported_at_the_line_of_the_original():
    with pytest.raises(NameError) as caught:
        run_python2(OLD + "def g((a, b)): return a\nabsent\n")
    assert caught.traceback[-1].lineno + 1 == len(OLD.splitlines()) + 2


def test_division_may_be_that_of_python3():
    assert run_python2("from __future__ import division\nx = 7 / 2\n")["x"] == 3.5


@pytest.mark.parametrize(
    ("text", "old"),
    [
        ("print 'x'\n", True),
        ("import rospy\n", True),
        ("#!/usr/bin/env python3\nimport rospy\n", False),
        ("print('x')\n", False),
        ("def f(:\n", True),
    ],
)
def test_python2_is_recognised(text, old):
    assert python2.is_python2(text) is old


def test_what_is_no_python_at_all_is_a_finding_with_its_line():
    pytest.importorskip("fissix")
    for text in ("x = 1\ndef f(:\n    pass\n", "x = 1\nprint 'a\n", "if x:\n    y\n  z\n"):
        with pytest.raises(Refused) as caught:
            python2.to_python3(text)
        assert caught.value.finding.kind == "syntax"
        assert caught.value.finding.line is not None


@pytest.mark.parametrize(
    ("text", "line", "word"),
    [
        ("x = 1\ndef f(x)\n    return x\n", 2, "expected ':'"),
        ("print 'x'\ndef f(x)\n    return x\n", 2, "bad input"),
        ("print('x', end='')\nx = [1, 2\ny = 3\n", 2, "never closed"),
    ],
)
def test_what_is_no_python_at_all_is_told_in_the_language_it_is_meant_in(text, line, word):
    pytest.importorskip("fissix")
    with pytest.raises(Refused) as caught:
        python2.to_python3(text)
    finding = caught.value.finding
    assert (finding.line, word in finding.detail) == (line, True), finding.detail


def test_sources_of_any_encoding_are_read():
    assert python2.read_source("# é\r\nx\n".encode("latin-1")) == "# é\nx\n"
    assert python2.read_source("# é\n".encode()) == "# é\n"
    assert python2.read_source(b"# -*- coding: latin-1 -*-\n# \xfc\n").endswith("# ü\n")
    assert python2.read_source(b"\xef\xbb\xbfx\n") == "x\n"
