"""Solvers are graded: right ones pass, wrong ones are told where, hostile ones do no harm."""

from __future__ import annotations

import json
import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from drawn_grades import BRIEF, graded

import ik
from kr210_sim.cli import main
from kr210_sim.grading import grade as grading
from kr210_sim.grading.debug_cases import GOLDEN, debug_report, random_cases
from kr210_sim.grading.foreign import Asked, ForeignSolver
from kr210_sim.grading.grade import GradeConfig
from kr210_sim.grading.poses import Leg, mark_leg, rows_of, summarize_marks
from kr210_sim.grading.process import Answer
from kr210_sim.grading.report import grade_text
from kr210_sim.grading.source import SolverSource

ROOT = Path(__file__).parents[1]
EXAMPLES = ROOT / "examples"
COURSE = sorted((Path(__file__).parent / "solvers" / "course").glob("*.py"))
GEOMETRIC = (EXAMPLES / "solutions" / "geometric_ik.py").read_text()
HOME = np.zeros(6)


@pytest.fixture(autouse=True)
def _one_scene(scene, monkeypatch):
    monkeypatch.setattr(grading, "_scene", lambda config: scene)


# ---- pose by pose ---------------------------------------------------------------------------


def leg_of(robot, q: np.ndarray, T: np.ndarray | None = None) -> Leg:
    poses = ik.forward(robot.geometry, q) if T is None else T
    asked = Asked(T_base_palm=poses, q_start=q[0], q=q, seconds=np.full(len(q), 1e-3), finding=None)
    return Leg(cycle=0, stage="MOVE_TO_PICK", asked=asked)


@pytest.fixture
def q() -> np.ndarray:
    return np.linspace(0, 1, 20)[:, None] * [0.5, 0.3, -0.3, 0.9, 0.8, -0.6] + 0.1


def test_right_answers_have_no_errors_and_no_detours(robot, q):
    mark = mark_leg(robot, leg_of(robot, q))
    figures = summarize_marks([mark])
    assert figures["position_error_m"]["max"] < 1e-12
    assert figures["angle_error_rad"]["max"] < 1e-12
    assert figures["wrist_center_error_m"]["max"] < 1e-12
    assert (figures["branch_jumps"], figures["turns"], figures["beyond_limits"]) == (0, 0, 0)
    assert figures["wrist_travel_rad"] == pytest.approx(figures["wrist_travel_optimum_rad"])
    assert json.loads(json.dumps(rows_of(mark), allow_nan=False))[0]["pose"] == 0


def test_an_error_of_the_tool_length_is_not_one_of_the_wrist(robot, q):
    poses = ik.forward(robot.geometry, q)
    poses[:, :3, 3] += 0.11 * poses[:, :3, 0]
    mark = mark_leg(robot, leg_of(robot, q, poses))
    np.testing.assert_allclose(np.linalg.norm(mark.position_error, axis=1), 0.11)
    np.testing.assert_allclose(mark.angle_error, 0.0, atol=1e-7)
    np.testing.assert_allclose(np.linalg.norm(mark.wrist_error, axis=1), 0.11)


def test_an_error_of_a_joint_is_an_angle(robot, q):
    mark = mark_leg(robot, leg_of(robot, q + 0.2 * np.eye(6)[5], ik.forward(robot.geometry, q)))
    np.testing.assert_allclose(mark.angle_error, 0.2)
    np.testing.assert_allclose(mark.wrist_error, 0.0, atol=1e-12)


def test_jumps_turns_and_limits_are_counted(robot, q):
    poses = ik.forward(robot.geometry, q)
    turned = q.copy()
    turned[10:, 5] += 2 * np.pi
    mark = mark_leg(robot, leg_of(robot, turned, poses))
    assert (mark.turns.sum(), mark.jumps.sum()) == (1, 0)
    beyond = q + 4 * np.pi * np.eye(6)[5]  # two turns at once, but there is no such angle
    figures = summarize_marks([mark_leg(robot, leg_of(robot, beyond, poses))])
    assert (figures["turns"], figures["beyond_limits"]) == (0, len(q))
    flipped = q.copy()
    flipped[10:] = q[10:] * [1, 1, 1, 1, -1, 1] + [0, 0, 0, np.pi, 0, np.pi]
    mark = mark_leg(robot, leg_of(robot, flipped, poses))
    assert list(np.flatnonzero(mark.jumps)) == [10]
    assert mark.wrist_travel > mark.wrist_optimum + 6.0
    far = q.copy()
    far[3, 1] = 2.0
    figures = summarize_marks([mark_leg(robot, leg_of(robot, far, poses))])
    assert figures["beyond_limits"] == 1


def test_poses_without_an_answer_have_no_errors(robot, q):
    leg = leg_of(robot, q)
    short = replace(leg, asked=replace(leg.asked, q=q[:5], seconds=np.ones(5)))
    figures = summarize_marks([mark_leg(robot, short)])
    assert (figures["answered"], figures["asked"]) == (5, 20)
    none = replace(leg, asked=replace(leg.asked, q=q[:0], seconds=np.empty(0)))
    rows = rows_of(mark_leg(robot, none))
    assert [row["q_rad"] for row in rows] == [None] * 20
    assert summarize_marks([])["position_error_m"]["max"] is None


def test_a_pose_without_an_answer_in_the_middle_leaves_the_others_theirs(robot, q):
    leg = leg_of(robot, q)
    holed = leg.asked.q.copy()
    holed[5] = np.nan
    mark = mark_leg(robot, replace(leg, asked=replace(leg.asked, q=holed)))
    rows = rows_of(mark)
    assert [row["pose"] for row in rows if row["q_rad"] is None] == [5]
    assert summarize_marks([mark])["turns"] == sum(row.get("turns", 0) for row in rows) == 0


# ---- whole grades ---------------------------------------------------------------------------

PER_POSE = (
    GEOMETRIC
    + """
from types import SimpleNamespace as S
def one(position, quaternion):
    p, q = S(**dict(zip("xyz", position))), S(**dict(zip("xyzw", quaternion)))
    return handle_calculate_IK(S(poses=[S(position=p, orientation=q)]))[0]
"""
)

HOSTILE = {
    "loops": ("timeout", "def solve(T, q_start):\n    while True:\n        pass\n"),
    "forks": ("raised", "import os\ndef solve(T, q_start):\n    while True:\n        os.fork()\n"),
    "ten_gigabytes": ("memory", "def solve(T, q_start):\n    return [0.0] * (10 * 2**30 // 8)\n"),
    "exits": ("exit", "import sys\ndef solve(T, q_start):\n    sys.exit(0)\n"),
    "changes_folder": (None, "import os\nos.chdir('/')\n" + GEOMETRIC),
    "floods": ("timeout", "def solve(T, q_start):\n    while True:\n        print('x' * 9999)\n"),
    "imports": ("import", "import rospy\nimport not_there\n"),
    "syntax_3": ("syntax", "#!/usr/bin/env python3\nx = 1\ndef solve(T q_start):\n    pass\n"),
    "syntax_2": ("syntax", "import rospy\nprint 'ready'\ndef solve(T q_start):\n    pass\n"),
    "sleeps": (
        "timeout",
        PER_POSE + "import time\ndef solve(position, quaternion):\n    time.sleep(1)\n"
        "    return one(position, quaternion)\n",
    ),
    "changes_its_mind": (
        "changed",
        GEOMETRIC + "right, calls = handle_calculate_IK, []\n"
        "def handle_calculate_IK(req):\n    calls.append(1)\n"
        "    return [[q + 1e-3 * len(calls) for q in row] for row in right(req)]\n",
    ),
    "raises_late": (
        "raised",
        PER_POSE + "asked = []\ndef solve(position, quaternion):\n    asked.append(1)\n"
        "    if len(asked) > 30:\n        raise RuntimeError('enough')\n"
        "    return one(position, quaternion)\n",
    ),
    "deletes_itself": (None, "import os\nos.remove(__file__)\n" + GEOMETRIC),
}


@pytest.mark.slow
@pytest.mark.parametrize("name", HOSTILE)
def test_a_hostile_file_is_graded_and_does_no_harm(name, tmp_path, monkeypatch):
    scratch = tmp_path / "scratch"
    scratch.mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(scratch))
    kind, text = HOSTILE[name]
    path = tmp_path / f"{name}.py"
    text = (
        text.replace("def handle_calculate_IK", "def ik_of") if "solve(position" in text else text
    )
    text = text.replace("return handle_calculate_IK(S", "return ik_of(S")
    path.write_text(text)
    folder = Path.cwd()
    content = graded(path)
    assert content["seconds"] < BRIEF.limits.time_limit + 10.0
    kinds = {finding["kind"] for finding in content["findings"]}
    assert kind in kinds if kind else not kinds
    assert content["succeeded"] == (1 if kind is None else 0) or name == "changes_its_mind"
    if kind not in (None, "changed"):
        assert content["findings"][0]["line"] is not None
    if name in ("sleeps", "raises_late"):
        figures = content["figures"]
        assert 0 < figures["answered"] < figures["asked"]
    assert path.read_text() == text
    assert Path.cwd() == folder
    assert list(scratch.iterdir()) == []
    assert "Traceback" not in grade_text(content)


@pytest.mark.slow
@pytest.mark.parametrize("path", COURSE, ids=lambda path: path.stem)
def test_a_file_of_the_course_runs_unmodified(path):
    before = path.read_bytes()
    content = graded(path, GradeConfig(cycles=1))
    assert (content["language"], content["form"]) == ("Python 2", "request")
    assert content["findings"] == []
    assert content["succeeded"] == 1
    assert content["figures"]["position_error_m"]["max"] < 1e-9
    assert content["probes"]["within_1_mm"] == content["probes"]["asked"]
    assert path.read_bytes() == before


@pytest.mark.slow
@pytest.mark.parametrize("name", ["geometric_ik", "sympy_ik", "numeric_ik"])
def test_our_solutions_grade_ten_of_ten(name):
    content = graded(EXAMPLES / "solutions" / f"{name}.py", GradeConfig())
    assert (content["succeeded"], content["passed"]) == (10, True)
    assert content["findings"] == []
    assert content["figures"]["position_error_m"]["max"] < 1e-9


@pytest.mark.slow
def test_the_template_grades_none_of_ten_with_a_friendly_report():
    content = graded(EXAMPLES / "student_ik.py", GradeConfig())
    assert (content["succeeded"], content["passed"]) == (0, False)
    assert content["findings"] == []
    assert "fill the template in" in grade_text(content)


@pytest.mark.slow
def test_poses_of_link_6_suit_a_solver_that_expects_them(tmp_path):
    path = tmp_path / "to_link_6.py"
    path.write_text(GEOMETRIC.replace("D7 = 0.303", "D7 = 0.193"))
    right = graded(path, GradeConfig(cycles=1, frame="link_6"))
    wrong = graded(path, GradeConfig(cycles=1))
    assert right["figures"]["position_error_m"]["max"] < 1e-9
    assert right["succeeded"] == 1
    assert wrong["figures"]["position_error_m"]["max"] == pytest.approx(0.11)
    assert wrong["succeeded"] == 0
    assert "poses of link_6" in grade_text(right)


def test_debug_cases_print_the_errors_of_golden_poses(robot):
    class Right:
        source = SolverSource(module="right")
        answers = iter([*GOLDEN, *random_cases(robot, 2, 0)])

        def load(self): ...

        def ask(self, T, q_start):
            return Answer(q=np.array([next(self.answers).q]), seconds=np.array([0.25]))

    text, passed = debug_report(Right(), robot, [*GOLDEN, *random_cases(robot, 2, 0)])
    assert not passed  # angles of two digits are off by centimetres
    offsets = [
        float(line.split()[-2]) for line in text.splitlines() if "Overall end effector" in line
    ]
    assert max(offsets[:3]) < 0.02
    assert max(offsets[3:]) < 1e-8
    assert "Theta 6 error is: 0.00000000" in text
    assert "0.2500 seconds" in text
    last = text.splitlines()[-1]
    assert last.startswith(
        "5 of 5 cases answered, 2 of them within 1 mm; worst end effector offset"
    )


def test_of_many_debug_cases_the_worst_is_shown(robot):
    """A thousand cases are a line, not a flood."""

    class OneOff:
        source = SolverSource(module="one_off")

        def load(self): ...

        def ask(self, T, q_start):
            q = ik.inverse(robot.geometry, T[0]).q[:1] + (0.01 if np.allclose(T[0], bad) else 0.0)
            return Answer(q=q, seconds=np.ones(1), finding=None)

    cases = [case for case in random_cases(robot, 40, 0)
             if ik.inverse(robot.geometry, case.T_base_palm).valid[0]]  # fmt: skip
    bad = cases[6].T_base_palm
    text, passed = debug_report(OneOff(), robot, [*GOLDEN, *cases])
    assert not passed
    assert debug_report(OneOff(), robot, [*GOLDEN, *cases[:6]])[1]
    lines = text.splitlines()
    shown = [line for line in lines if line.startswith("case ")]
    numbers = [int(line.split()[1]) for line in shown]
    assert numbers == [1, 2, 3, 10]
    assert f"{len(cases) - 1} random cases are not shown; the worst is" in lines
    assert lines[-1].endswith("in case 10")


def test_debug_cases_without_an_answer_are_counted(robot):
    class Silent:
        source = SolverSource(module="silent")

        def load(self): ...

        def ask(self, T, q_start):
            return Answer(q=np.full((1, 6), np.nan), seconds=np.ones(1), finding=None)

    text, passed = debug_report(Silent(), robot, GOLDEN)
    assert not passed
    assert text.splitlines()[-1] == "0 of 3 cases answered"


@pytest.mark.slow
def test_debug_cases_of_a_file(capsys):
    assert (
        main(["grade", str(EXAMPLES / "solutions" / "geometric_ik.py"), "--debug-cases", "2"]) == 0
    )
    text = capsys.readouterr().out
    assert text.count("Overall end effector offset is: 0.0000000") == 5
    assert main(["grade", str(EXAMPLES / "student_ik.py"), "--debug-cases"]) == 1
    assert "case 3 of 3" in capsys.readouterr().out


def test_debug_cases_of_a_file_that_does_not_load_are_not_passed(tmp_path, capsys):
    file = tmp_path / "broken.py"
    file.write_text("def f(:\n")
    assert main(["grade", str(file), "--debug-cases"]) == 1
    assert capsys.readouterr().out.startswith("broken.py, line 1: ")


def test_a_solver_that_is_lost_is_started_again_a_few_times(robot, monkeypatch):
    from kr210_sim.grading import foreign
    from kr210_sim.grading.findings import Finding

    class Dying:
        seconds_left, output, output_bytes, alive, close = 10.0, b"", 0, False, lambda self: None

        def __init__(self, *_, **__): ...

        def ask(self, T, q_start):
            finding = Finding(kind="died", detail="gone")
            return Answer(q=np.empty((0, 6)), seconds=np.empty(0), finding=finding)

    monkeypatch.setattr(foreign, "SolverProcess", Dying)
    solver = ForeignSolver(SolverSource(module="dying"), robot)
    kinds = [solver.ask(np.eye(4)[None], HOME).finding.kind for _ in range(5)]
    assert kinds == ["died"] * 3 + ["not_tried"] * 2


@pytest.mark.parametrize("more", [(), ("--debug-cases", "2")], ids=["grade", "debug cases"])
def test_a_mistyped_function_is_bad_input_and_no_failed_solver(tmp_path, capsys, more):
    path = tmp_path / "my_ik.py"
    path.write_text("def solve(T_base_palm, q_start):\n    raise ValueError\n")
    out = tmp_path / "out"
    assert main(["grade", f"{path}:slove", "--out", str(out), *more]) == 2
    error = capsys.readouterr().err
    assert "there is no function slove; it has solve" in error
    assert error.count("\n") == 1
    assert not out.exists()
