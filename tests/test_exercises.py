"""The exercises of the course: right functions pass, wrong ones are told where and why."""

from __future__ import annotations

import importlib.util
import inspect
import json
import re
from math import acos, atan2, hypot, pi
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

from kr210_sim.grading import exercises
from kr210_sim.grading.exercises import EXERCISES, check_step, find_exercises, step_text
from kr210_sim.grading.findings import Source
from kr210_sim.grading.forms import Caller
from kr210_sim.grading.source import SolverLimits, SolverSource

ROOT = Path(__file__).parents[1]
EXAMPLES = ROOT / "examples"
COURSE = EXAMPLES / "course"
NAMES = [exercise.name for exercise in EXERCISES]


def loaded(path: Path) -> ModuleType:
    spec = importlib.util.spec_from_file_location(path.stem, path)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


SOLVED, TEMPLATE = loaded(COURSE / "solution.py"), loaded(COURSE / "exercises.py")
REQUESTS = loaded(EXAMPLES / "student_ik.py")


@pytest.fixture
def asked(monkeypatch, robot):
    """Return check(name, function): the exercise without a process, but over the same JSON."""

    def check(name: str, function, seed: int = 0) -> dict:
        caller = Caller(function, "exercise", Source(Path("mine.py"), ""))

        class InProcess:
            output = b""

            def __init__(self, source, limits):
                assert source.function == name

            def call(self, arguments):
                sent = json.loads(json.dumps([np.asarray(value).tolist() for value in arguments]))
                return np.array(json.loads(json.dumps(caller.values(sent))))

            def close(self): ...

        monkeypatch.setattr(exercises, "FunctionProcess", InProcess)
        (exercise,) = find_exercises(name)
        source = SolverSource(file=Path("mine.py"))
        found = check_step(exercise, source, robot, seed=seed, limits=SolverLimits())
        json.dumps(found, allow_nan=False)
        return found | {"text": step_text(exercise, found)}

    return check


# ---- right ----------------------------------------------------------------------------------


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("seeds", [(1,), pytest.param(range(2, 8), marks=pytest.mark.slow)])
def test_the_solution_is_right_whatever_the_seed(name, seeds, asked):
    for seed in seeds:
        found = asked(name, getattr(SOLVED, name), seed)
        assert found["passed"], found["text"]
        assert found["worst_error"] < 1e-10
        assert found["finding"] is None


@pytest.mark.parametrize("exercise", EXERCISES, ids=NAMES)
def test_template_solution_and_list_agree_on_the_functions(exercise):
    for module in (SOLVED, TEMPLATE):
        signature = inspect.signature(getattr(module, exercise.name))
        assert exercise.call == f"{exercise.name}{signature}"
    page = int(exercise.page[:2])
    assert (getattr(TEMPLATE, exercise.name).__doc__).startswith(f"Page {page}.")
    assert (ROOT / exercise.document).is_file()


def test_the_template_of_requests_has_functions_of_the_course(asked):
    """What is written for one template fits the other, and `--step` checks it in both."""
    shared = [name for name in NAMES if hasattr(REQUESTS, name)]
    assert shared == ["rotation", "dh_pose", "wrist_center", "first_three", "last_three"]
    for name in shared:
        mine, theirs = getattr(REQUESTS, name), getattr(TEMPLATE, name)
        assert inspect.signature(mine) == inspect.signature(theirs)
        assert mine.__doc__.startswith(theirs.__doc__[:7])
    assert not asked("rotation", REQUESTS.rotation)["written"]


def test_the_template_is_not_written_yet(asked):
    for name in NAMES:
        found = asked(name, getattr(TEMPLATE, name))
        assert (found["passed"], found["written"]) == (False, False)
        assert "not written yet, see docs/course/" in found["text"]


def test_cases_of_every_kind_are_there(robot):
    for exercise in EXERCISES:
        cases = exercise.cases(robot, 0)
        named = 2 if exercise.name == "solve" else 1
        assert len(cases) >= (20 if exercise.name in NAMES[6:10] else named)
    branches = {len(case.wanted) for case in find_exercises("all_branches")[0].cases(robot, 0)}
    assert branches == {4, 8}


def test_any_branch_and_any_turn_will_do(asked):
    def elbow_down(center):
        return np.add(SOLVED.arm_angles(center, 1, -1), (2 * pi, 0, 0))

    def flipped(theta1, theta2, theta3, T_0_7):
        theta4, theta5, theta6 = SOLVED.last_three(theta1, theta2, theta3, T_0_7)
        return theta4 - pi, -theta5, theta6 + pi

    assert asked("first_three", elbow_down)["passed"]
    assert asked("last_three", flipped)["passed"]
    assert asked("all_branches", lambda T_0_7: SOLVED.all_branches(T_0_7)[::-1])["passed"]


def test_sympy_and_columns_are_numbers_too(asked):
    sympy = pytest.importorskip("sympy")
    found = asked("motion_time", lambda *given: sympy.Matrix([SOLVED.motion_time(*given)]))
    assert found["passed"], found["text"]


def test_the_solution_stands_at_a_singular_wrist():
    T = np.eye(4)
    T[:3, 3] = (2.153, 0.0, 1.946)
    q = np.array([0.0, 0.0, 0.0, 1.0, 0.0, -1.0])
    np.testing.assert_allclose(SOLVED.total_transform(q)[:3, 3], T[:3, 3], atol=1e-12)
    (answer,) = SOLVED.solve(T[None], np.zeros(6))
    np.testing.assert_allclose(answer, np.zeros(6), atol=1e-9)


# ---- wrong ----------------------------------------------------------------------------------


def otherwise_chosen():
    """A table of the same arm with x_4 the other way round."""
    table = np.array(SOLVED.dh_table())
    table[3, 3] += pi
    table[4] *= [-1, -1, 1, 1]
    table[4, 3] += pi
    return table


def no_sag(center):
    theta1, theta2, theta3 = SOLVED.first_three(center)
    return theta1, theta2, theta3 + SOLVED.SAG


def from_axis_1(center):
    theta1, theta2, theta3 = SOLVED.first_three(center)
    along, up = hypot(*center[:2]), center[2] - SOLVED.D1
    return theta1, theta2 + atan2(up, along - SOLVED.A1) - atan2(up, along), theta3


def wrong_sign(theta1, theta2, theta3, T_0_7):
    return SOLVED.last_three(theta1, theta2, theta3, T_0_7) * np.array([1, -1, 1])


def in_front(center):
    """As of atan(y / x)."""
    theta1, theta2, theta3 = SOLVED.first_three(center)
    return np.arctan(np.tan(theta1)), theta2, theta3


def no_special_case(theta1, theta2, theta3, T_0_7):
    R0_3 = np.eye(3)
    for (*row, theta), angle in zip(SOLVED.dh_table(), (theta1, theta2, theta3), strict=False):
        R0_3 = R0_3 @ SOLVED.transform(*row, theta + angle)[:3, :3]
    R = R0_3.T @ T_0_7[:3, :3]
    theta5 = atan2(hypot(R[0, 2], R[2, 2]), R[1, 2])
    return atan2(R[2, 2], -R[0, 2]), theta5, atan2(-R[1, 1], R[1, 0])


def test_at_a_singular_wrist_the_sum_is_wanted_and_any_pair_of_it_will_do(asked):
    def singular(pair, theta5=0.0):
        def last_three(theta1, theta2, theta3, T_0_7):
            right = SOLVED.last_three(theta1, theta2, theta3, T_0_7)
            return (pair[0], theta5, pair[1]) if abs(right[1]) < 1e-9 else right

        return asked("last_three", last_three)

    assert singular((0.7 + 2 * pi, 0.5))["passed"]
    wrong = singular((0.7, 0.6))["finding"]
    assert "theta 4 plus theta 6 is 1.3, wanted 1.2, which any pair of that sum gives" in wrong
    assert "theta 5 is 0.1, wanted 0, and the gripper" in singular((0.7, 0.5), 0.1)["finding"]


def not_of_unit_length(quaternion_xyzw):
    return SOLVED.rotation(quaternion_xyzw) * np.linalg.norm(quaternion_xyzw) ** 2


def classic(alpha, a, d, theta):
    turned = SOLVED.transform(0, 0, d, theta)
    return turned @ SOLVED.transform(alpha, a, 0, 0)


def a_row_too_early():
    table = np.array(SOLVED.dh_table())
    table[:, :2] = np.roll(table[:, :2], -1, axis=0)
    return table


def added_up():
    table = np.array(SOLVED.joint_table())
    table[:, :3] = np.cumsum(table[:, :3], axis=0)
    return table


def always_from_the_start(T_0_gripper, q_start):
    return np.concatenate([SOLVED.solve(T[None], q_start) for T in T_0_gripper])


def spinning(T_0_gripper, q_start):
    answer = SOLVED.solve(T_0_gripper, q_start)
    answer[5::2, 5] -= 2 * pi * np.sign(answer[5::2, 5])
    return answer


def far_away(T_0_gripper, q_start):
    answer = SOLVED.solve(T_0_gripper, q_start)
    answer[-1, 0] += 4 * pi
    return answer


WRONG = [
    ("joint_table", lambda: SOLVED.joint_table()[:6], "shape (6, 6), wanted (7, 6)", None),
    ("joint_table", lambda: np.array(SOLVED.joint_table()) * 2, "joint_1, z is 0.66,", None),
    ("dh_table", lambda: [[0, *row[1:]] for row in SOLVED.dh_table()], "row 2, alpha is 0,", None),
    ("joint_table", added_up, "joint_2, z is 0.75, wanted 0.42; yours are added up", None),
    ("dh_table", otherwise_chosen, "chosen otherwise", None),
    ("dh_table", a_row_too_early, "row 1, alpha is -1.5708, wanted 0; alpha and a stand", None),
    ("dh_table", lambda: SOLVED.dh_table() * np.array([180 / pi, 1, 1, 180 / pi]), "degrees", None),
    ("transform", classic, "row 1, column 2 is 0, wanted 1; yours is the classic", None),
    ("transform", lambda *row: SOLVED.transform(*row).T, "wanted", None),
    ("total_transform", lambda q: np.eye(4), "q = 0: row", None),
    ("rotation", lambda q: SOLVED.rotation(q).T, "golden pose 1", "gripper_correction"),
    pytest.param(
        "rotation",
        lambda q: SOLVED.rotation(np.roll(q, -1)),
        "row",
        "rpy_order",
        marks=pytest.mark.slow,
    ),
    ("rotation", lambda q: np.zeros((3, 3)), "row", None),
    ("rotation", not_of_unit_length, "a quaternion of two digits: row", None),
    ("dh_pose", lambda T: T, "before cell 5: row", "gripper_correction"),
    ("wrist_center", lambda T: T[:3, 3] - 0.193 * T[:3, 2], "x is 2.007, ", "tool_length"),
    pytest.param(
        "wrist_center",
        lambda T: T[:3, 3] + 0.303 * T[:3, 2],
        "forth along z_7",
        "gripper_correction",
        marks=pytest.mark.slow,
    ),
    pytest.param(
        "first_three",
        lambda center: np.degrees(SOLVED.first_three(center)),
        "right in degrees",
        None,
        marks=pytest.mark.slow,
    ),
    ("first_three", in_front, "golden pose 2: theta 1 is -0.788493, wanted 2.3531,", "front_only"),
    ("first_three", no_sag, "missed by 0.054 m", "sag"),
    ("first_three", from_axis_1, "theta 2 is", "shoulder_offset"),
    ("last_three", wrong_sign, "theta 5 is", "wrist_branch"),
    ("last_three", no_special_case, "theta 5 = 0: ", None),
    ("all_branches", lambda T: SOLVED.all_branches(T)[::2], "has 4 of 8 branches", None),
    ("all_branches", lambda T: SOLVED.all_branches(T) + 0.1, "8 of 8 rows miss the pose", None),
    ("all_branches", lambda T: [1.0, 2.0], "shape (2,), wanted (n, 6)", None),
    ("nearest_turns", lambda q, q_before, lower, upper: q, "joint_", None),
    ("nearest_turns", lambda q, q_before, lower, upper: q + 2 * pi, "is beyond its limit", None),
    ("solve", lambda T, q: SOLVED.solve(T, q)[:1], "shape (1, 6), wanted (60, 6)", None),
    pytest.param(
        "solve",
        lambda T, q: SOLVED.solve(T, q) + 0.01,
        "pose 0 is missed: theta 1 to 3 miss",
        None,
        marks=pytest.mark.slow,
    ),
    ("solve", spinning, "joint 6", "turn_jumps"),
    pytest.param(
        "solve",
        always_from_the_start,
        "a far turn of the tool: joint 6 moves",
        "turn_jumps",
        marks=pytest.mark.slow,
    ),
    ("solve", far_away, "joint 1 of pose 59 is beyond its limit", "beyond_limits"),
    ("singularity", lambda q: (1, 2), "shape (2,), wanted (3,)", None),
    ("motion_time", lambda *given: given[0] / given[1], "it is 2, wanted 2.3", None),
    ("proved_rate", lambda cycles: 1.0, "1 of 1: it is 1, wanted 0.025", None),
    ("proved_rate", lambda: 1.0, "does not take 1 argument", None),
    ("proved_rate", lambda cycles: None, "answered None", None),
    ("proved_rate", lambda cycles: "much", "is no number but a str", None),
    ("proved_rate", lambda cycles: 1j, "is complex", None),
    ("proved_rate", lambda cycles: float("nan"), "entry [0] of the answer is nan", None),
    ("proved_rate", lambda cycles: [[1], [1, 2]], "is no number but a list", None),
    ("wrist_center", lambda T: T[9], "raised IndexError", None),
]


@pytest.mark.parametrize(("name", "function", "text", "key"), WRONG)
def test_a_mistake_is_told_where_and_named_where_it_is_known(name, function, text, key, asked):
    found = asked(name, function)
    assert not found["passed"]
    assert text in found["finding"]
    keys = [item["page"].partition("#")[2] for item in found["diagnoses"]]
    assert key in keys if key else not keys
    assert found["page"] in found["text"]
    assert f"  asked      {name}(" in found["text"]


def triangle(*, side=SOLVED.FOREARM, sag=SOLVED.SAG, quarter=pi / 2):
    """Return the function of page 6 with numbers as a learner may have written them."""

    def first_three(center):
        x, y, z = center
        ahead, up = hypot(x, y) - 0.35, z - 0.75
        reach = hypot(ahead, up)
        A = acos((1.25**2 + reach**2 - side**2) / (2 * 1.25 * reach))
        B = acos((1.25**2 + side**2 - reach**2) / (2 * 1.25 * side))
        return atan2(y, x), quarter - A - atan2(up, ahead), quarter - (B + sag)

    return first_three


SIDE, SAG = (
    "side from axis 3 to the wrist center is 1.501 instead of 1.500972",
    "sag angle is 0.036 instead of 0.03598446",
)


@pytest.mark.parametrize(
    ("numbers", "named"),
    [
        ({"side": 1.501, "sag": 0.036}, f"The {SIDE} and the {SAG}: with that"),
        ({"sag": 0.036}, f"The {SAG}: with that"),
        ({"sag": 0.04}, "The sag angle is 0.04 instead of 0.03598446: with that"),
        ({"quarter": 1.57}, "Pi/2 is 1.57 instead of 1.570796: with that"),
        (
            {"side": hypot(1.5005, 0.054), "sag": atan2(0.054, 1.5005)},
            "The length d4 is 1.5005 instead of 1.5: with that",
        ),
    ],
)
def test_a_rounded_number_is_named_where_it_explains_every_case(numbers, named, asked):
    found = asked("first_three", triangle(**numbers))
    (diagnosis,) = found["diagnoses"]
    assert diagnosis["key"] == "rounding"
    assert diagnosis["text"].startswith(named)
    assert "in all of 24 answers" in diagnosis["text"]
    assert asked("first_three", triangle())["diagnoses"] == []


@pytest.mark.parametrize("name", ["first_three", "all_branches", "solve"])
def test_the_numbers_of_the_original_course_are_named_in_every_step(name, asked, monkeypatch):
    for number, value in (("FOREARM", 1.501), ("SAG", 0.036)):
        monkeypatch.setattr(SOLVED, number, value)
    (diagnosis,) = asked(name, getattr(SOLVED, name))["diagnoses"]
    assert diagnosis["text"].startswith(f"The {SIDE} and the {SAG}: with that")


def test_cases_that_a_diagnosis_leaves_out_are_named(asked):
    found = asked("wrist_center", lambda T: T[:3, 3] - 0.193 * T[:3, 2])
    counted = re.search(r"in (\d+) of (\d+) answers", found["diagnoses"][0]["text"]).groups()
    assert int(counted[1]) + len(found["left_out"]) == found["cases"] == 24
    assert 0 < len(found["left_out"]) == len(set(found["left_out"]))
    assert f"  left out   {', '.join(found['left_out'])}: the arm does not reach" in found["text"]
    assert asked("first_three", no_sag)["left_out"] == []


def test_no_number_is_named_where_rounding_is_not_all(asked):
    """Noise as large as that of rounded lengths, and one answer that rounding does not explain."""
    rng, rounded = np.random.default_rng(0), triangle(side=1.501, sag=0.036)
    noisy = asked("first_three", lambda c: triangle()(c) + rng.normal(0, 1e-5, 3))
    apart = asked("first_three", lambda c: np.add(rounded(c), (1e-4 * (c[0] > 1.8), 0, 0)))
    for found in (noisy, apart):
        assert not found["passed"]
        assert found["diagnoses"] == []


def test_rounding_and_whole_turns_are_both_told(asked):
    def solve(T_0_gripper, q_start):
        angles = np.array(spinning(T_0_gripper, q_start))
        centers = [SOLVED.wrist_center(SOLVED.dh_pose(T)) for T in T_0_gripper]
        right, off = (np.array([f(c) for c in centers]) for f in (triangle(), triangle(sag=0.036)))
        angles[:, :3] += off - right
        return angles

    keys = [item["key"] for item in asked("solve", solve)["diagnoses"]]
    assert keys[:2] == ["rounding", "turn_jumps"]  # some of them lead beyond limits


def test_numbers_beyond_all_bounds_are_wrong_and_do_no_harm(asked, robot):
    for exercise in EXERCISES:
        shape = exercise.cases(robot, 0)[0].wanted.shape
        with np.errstate(all="ignore"):
            found = asked(exercise.name, lambda *given, shape=shape: np.full(shape, 1e300))
        assert (found["passed"], found["right"]) == (False, 0)
        assert found["finding"]
