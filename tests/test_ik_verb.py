"""The verbs `ik` and `dh`: a pose in every notation, all branches, and tables that multiply up."""

from __future__ import annotations

import json
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import ik
from kr210_sim.cli import main

POSITION = (1.9, 0.4, 1.6)
RPY = (0.3, -0.2, 0.5)
TURN = Rotation.from_euler("xyz", RPY)
POSE = np.eye(4)
POSE[:3, 3], POSE[:3, :3] = POSITION, TURN.as_matrix()
MATRIX = json.dumps(POSE.tolist())


def words(option: str, values: Any) -> list[str]:
    return [option, *map(repr, map(float, values))]


def reported(capsys, *arguments: str) -> dict[str, Any]:
    assert main(["ik", *arguments, "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert isinstance(found, dict)
    return found


def test_a_pose_is_the_same_in_every_notation(capsys, tmp_path):
    (tmp_path / "pose.json").write_text(MATRIX)
    at = words("--position", POSITION)
    for given in (
        [*at, *words("--rpy", RPY)],
        [*at, *words("--quaternion", -3.0 * TURN.as_quat())],
        ["--pose", MATRIX],
        ["--pose", str(tmp_path / "pose.json")],
    ):
        found = reported(capsys, *given)["T_base_palm"]
        np.testing.assert_allclose(found, POSE, atol=1e-15, err_msg=str(given))
    alone = reported(capsys, *at)["T_base_palm"]
    np.testing.assert_allclose(
        alone, [[*row, x] for row, x in zip(np.eye(4)[:, :3], [*POSITION, 1.0], strict=True)]
    )


def test_every_branch_reaches_the_pose_with_its_turns_counted(capsys, robot):
    report = reported(capsys, "--pose", MATRIX)
    wrist = np.array(POSITION) - robot.geometry.T_tool[0, 3] * POSE[:3, 0]
    np.testing.assert_allclose(report["wrist_center_m"], wrist, atol=1e-12)
    names = [(b["shoulder"], b["elbow"], b["wrist"]) for b in report["branches"]]
    assert len(set(names)) == 8
    there = [branch for branch in report["branches"] if branch["exists"]]
    assert len(there) >= 4
    for branch in there:
        q = np.array(branch["q_rad"])
        np.testing.assert_allclose(ik.forward(robot.geometry, q), POSE, atol=1e-9)
        assert branch["residual_m"] < 1e-9
        assert branch["residual_rad"] < 1e-7
        copies = len(ik.turns(q, robot.lower, robot.upper).q)
        assert branch["configurations_within_limits"] == copies
        assert branch["within_limits"] == (copies > 0)
    assert {branch["within_limits"] for branch in there} == {True, False}


def test_the_table_has_a_line_for_each_branch(capsys):
    report = reported(capsys, "--pose", MATRIX)
    assert main(["ik", "--pose", MATRIX]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[0].startswith(f"pose of {report['frame']}; wrist center ")
    for line, branch in zip(lines[2:10], report["branches"], strict=True):
        assert line.split()[:3] == [branch["shoulder"], branch["elbow"], branch["wrist"]]
        if branch["exists"]:
            shown = np.radians([float(word) for word in line.split()[3:9]])
            np.testing.assert_allclose(shown, branch["q_rad"], atol=1e-5)
            assert ("BEYOND" in line) is not branch["within_limits"]
        else:
            assert line.endswith("out of reach")


def test_branches_are_what_their_names_say(capsys, robot):
    """As `ik --help` and ik/README.md explain them."""
    arm = robot.geometry
    for branch in reported(capsys, "--pose", MATRIX)["branches"]:
        if not branch["exists"]:
            continue
        q = np.array(branch["q_rad"])
        x, y, z = ik.wrist_center(arm, POSE)
        towards = x * np.cos(q[0]) + y * np.sin(q[0])
        assert (branch["shoulder"] == "front") is bool(towards > 0.0)
        stretched = -0.5 * np.pi - np.arctan2(-arm.a3, arm.d4)
        above = (q[2] - stretched) % (2 * np.pi) < np.pi
        assert (branch["elbow"] == "up") is bool(above)
        assert (branch["wrist"] == "+") is bool(q[4] > 0.0)
        if branch["shoulder"] == "front":
            elbow = np.array([arm.a1 + arm.L2 * np.sin(q[1]), arm.d1 + arm.L2 * np.cos(q[1])])
            along = np.array([towards - arm.a1, z - arm.d1])
            offset = elbow - (arm.a1, arm.d1)
            over = along[0] * offset[1] - along[1] * offset[0]
            assert (branch["elbow"] == "up") is bool(over > 0.0)


def test_the_help_says_what_the_names_of_branches_mean(capsys):
    with pytest.raises(SystemExit):
        main(["ik", "--help"])
    text = " ".join(capsys.readouterr().out.split())
    for word in ("front: axis 1", "back: away", "up, down: theta 3", "sign of theta 5"):
        assert word in text


def test_a_pose_out_of_reach_has_no_branch(capsys):
    assert main(["ik", "--position", "9", "0", "1"]) == 0
    assert capsys.readouterr().out.count("out of reach") == 8


AHEAD = ["--position", "1", "0", "1"]
SCALED = json.dumps((2.0 * POSE).tolist())


@pytest.mark.parametrize(
    ("given", "option"),
    [
        ([], "--position"),
        (["--rpy", "0", "0", "0"], "--position"),
        (["--pose", MATRIX, "--position", "1", "0", "1"], "--pose"),
        ([*AHEAD, "--rpy", "0", "0", "0", "--quaternion", "0", "0", "0", "1"], "--rpy"),
        (["--position", "1", "nan", "1"], "--position"),
        ([*AHEAD, "--rpy", "0", "inf", "0"], "--rpy"),
        ([*AHEAD, "--quaternion", "0", "0", "0", "0"], "--quaternion"),
        ([*AHEAD, "--quaternion", "0", "0", "0", "1e9"], "--quaternion"),
        (["--pose", "nowhere.json"], "--pose"),
        (["--pose", "[[1, 0"], "--pose"),
        (["--pose", "[1, 2, 3]"], "--pose"),
        (["--pose", SCALED], "--pose"),
        (["--pose", json.dumps([POSE.tolist()])], "--pose"),
        (["--pose", MATRIX.replace("1.9", '"1.9"')], "--pose"),
        (["--pose", MATRIX.replace("1.9", "true")], "--pose"),
        (["--pose", MATRIX.replace("1.9", "1" + "0" * 400)], "--pose"),
        (["--pose", "[" * 100_000], "--pose"),
    ],
)  # fmt: skip
def test_what_is_no_pose_is_refused_in_one_line(capsys, tmp_path, monkeypatch, given, option):
    monkeypatch.chdir(tmp_path)
    assert main(["ik", *given]) == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert err.startswith(f"kr210-sim: {option}: ")
    assert err.count("\n") == 1
    assert len(err) < 600


# ---- dh -------------------------------------------------------------------------------------


def test_the_table_multiplies_up_to_the_pose_of_the_palm(capsys, robot):
    assert main(["dh", "--json"]) == 0
    report = json.loads(capsys.readouterr().out)
    T = np.linalg.multi_dot([report["T_base_0"], *report["transforms_at_zero"], report["T_7_palm"]])
    np.testing.assert_allclose(T, ik.forward(robot.geometry, np.zeros(6)), atol=1e-12)
    assert [row["joint"] for row in report["modified_dh"]] == [*robot.arm_joints, None]
    assert [joint["upper_rad"] for joint in report["joints"]] == robot.upper.tolist()


def test_angles_of_the_table_are_written_as_parts_of_a_turn(capsys):
    assert main(["dh", "--json"]) == 0
    rows = json.loads(capsys.readouterr().out)["modified_dh"]
    assert main(["dh"]) == 0
    lines = capsys.readouterr().out.splitlines()
    head = next(i for i, line in enumerate(lines) if line.split()[:2] == ["i", "alpha_i-1"])
    values = {"0": 0.0, "pi/2": np.pi / 2, "-pi/2": -np.pi / 2, "pi": np.pi, "-pi": -np.pi}
    for line, row in zip(lines[head + 1 :], rows, strict=False):
        number, alpha, a, d = line.split()[:4]
        assert (int(number), float(a), float(d)) == (row["i"], row["a_m"], row["d_m"])
        assert values[alpha] == pytest.approx(row["alpha_rad"])


def test_formulas_are_no_json(capsys):
    assert main(["dh", "--symbolic", "--json"]) == 2
    assert capsys.readouterr().err.startswith("kr210-sim: --json: ")


def test_formulas_name_every_transform(capsys):
    pytest.importorskip("sympy")
    assert main(["dh", "--symbolic"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert [line for line in lines if line.startswith("T_") and "from" not in line] == [
        "T_base_0", *(f"T_{i}_{i + 1}" for i in range(7)), "T_7_palm",
    ]  # fmt: skip
    assert any("cos(pitch)*cos(yaw)" in line for line in lines)
