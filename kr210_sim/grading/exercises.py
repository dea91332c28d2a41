"""The exercises of the course: the function that a learner writes in each, and how it does."""

from __future__ import annotations

import math
from collections.abc import Sequence
from contextlib import closing
from dataclasses import dataclass
from typing import Any

import numpy as np

import ik
from kr210_sim.arrays import Array
from kr210_sim.exceptions import BadInput
from kr210_sim.grading import exercise_cases as asked
from kr210_sim.grading import judges
from kr210_sim.grading.diagnosis import OF_THE_WAY, diagnose
from kr210_sim.grading.exercise_cases import Case, Cases
from kr210_sim.grading.findings import Finding, Refused
from kr210_sim.grading.process import SolverProcess
from kr210_sim.grading.rounding import rounding
from kr210_sim.grading.source import SolverLimits, SolverSource
from kr210_sim.robot import Robot

ALL = "all"
"""Instead of a step's name: every step, in the order of the course."""

_LONGEST_CALL = 400
_PRINTED_LINES = 10
_FREE = np.full(6, np.inf)
_UNWRITTEN = f"raised {NotImplementedError.__name__}"

_XYZ, _JOINTS = ("x", "y", "z"), tuple(f"joint_{joint}" for joint in range(1, 7))
_ROWS = tuple(f"row {row}" for row in range(1, 8))
_AXES = tuple(f"axis {name}" for name in _XYZ)


@dataclass(frozen=True, kw_only=True)
class Exercise:
    """One step of the course.

    Attributes:
        call: the function to write, with its parameters.
        answer: what it returns, with units and frames.
        page: of the course that teaches it.
        cases: that are asked.
        entries: names of an answer's rows and columns.
        any_shape: whether the judge looks at the shape of an answer; else it is the right one's.
        judge: of an answer.
        whole: makes a whole solver's answer of it, for a diagnosis; None where that tells nothing.
    """

    call: str
    answer: str
    page: str
    cases: Cases
    entries: tuple[tuple[str, ...], ...] = ()
    any_shape: bool = False
    judge: judges.Judge = judges.close
    whole: judges.Whole | None = None

    @property
    def name(self) -> str:
        """The function's name, which is the step's."""
        return self.call.partition("(")[0]

    @property
    def document(self) -> str:
        """Where the step is taught."""
        return f"docs/course/{self.page}"

    def entry(self, index: tuple[int, ...]) -> str:
        """Return what a reader calls an entry of an answer."""
        if len(self.entries) == len(index):
            return ", ".join(names[i] for names, i in zip(self.entries, index, strict=True))
        return ", ".join(f"{a} {i + 1}" for a, i in zip(("row", "column"), index, strict=False))


EXERCISES = (
    Exercise(
        call="joint_table()",
        answer="rows (x, y, z, axis x, axis y, axis z) of joint_1 to joint_6 and gripper_joint [m]",
        page="01-joint-table.md",
        cases=asked.joint_table,
        entries=((*_JOINTS, "gripper_joint"), (*_XYZ, *_AXES)),
        judge=judges.joint_rows,
    ),
    Exercise(
        call="dh_table()",
        answer="7 rows (alpha_(i-1), a_(i-1), d_i, theta_i at q = 0) [rad, m]",
        page="02-dh-frames.md",
        cases=asked.dh_table,
        entries=(_ROWS, ("alpha", "a", "d", "theta")),
        judge=judges.same_table,
    ),
    Exercise(
        call="transform(alpha, a, d, theta)",
        answer="T_(i-1)_i (4, 4) of one row",
        page="03-transforms.md",
        cases=asked.transform,
        judge=judges.row_transform,
    ),
    Exercise(
        call="total_transform(q)",
        answer="T_0_7 (4, 4) of joint angles (6,) [rad]",
        page="03-transforms.md",
        cases=asked.total,
    ),
    Exercise(
        call="rotation(quaternion_xyzw)",
        answer="the rotation matrix (3, 3) of a quaternion",
        page="04-gripper-frame.md",
        cases=asked.rotations,
        whole=judges.from_rotation,
    ),
    Exercise(
        call="dh_pose(T_0_gripper)",
        answer="T_0_7 (4, 4): the same pose with the axes of the DH table",
        page="04-gripper-frame.md",
        cases=asked.of_poses(lambda robot, T: ((T,), asked.T_0_7_of(robot, T))),
        whole=judges.from_dh_pose,
    ),
    Exercise(
        call="wrist_center(T_0_7)",
        answer="x, y, z in the base frame [m]",
        page="05-wrist-center.md",
        cases=asked.of_poses(
            lambda robot, T: ((asked.T_0_7_of(robot, T),), ik.wrist_center(robot.geometry, T))
        ),
        entries=(_XYZ,),
        judge=judges.back_along_z,
        whole=judges.from_center,
    ),
    Exercise(
        call="first_three(center)",
        answer="theta 1, 2, 3 [rad]",
        page="06-theta-1-to-3.md",
        cases=asked.of_poses(
            lambda robot, T: ((ik.wrist_center(robot.geometry, T),), asked.front(robot, T)[:3])
        ),
        entries=(("theta 1", "theta 2", "theta 3"),),
        judge=judges.reaches_center,
        whole=judges.from_first_three,
    ),
    Exercise(
        call="last_three(theta1, theta2, theta3, T_0_7)",
        answer="theta 4, 5, 6 [rad]",
        page="07-theta-4-to-6.md",
        cases=asked.wrists,
        entries=(("theta 4", "theta 5", "theta 6"),),
        judge=judges.reaches_rotation,
        whole=judges.from_last_three,
    ),
    Exercise(
        call="all_branches(T_0_7)",
        answer="(n, 6): every configuration that reaches the pose, turns aside [rad]",
        page="08-branches-and-turns.md",
        cases=asked.of_poses(
            lambda robot, T: ((asked.T_0_7_of(robot, T),), asked.branches(robot, T))
        ),
        any_shape=True,
        judge=judges.has_all,
    ),
    Exercise(
        call="nearest_turns(q, q_before, lower, upper)",
        answer="(6,): q plus whole turns, within limits, each angle next to q_before [rad]",
        page="08-branches-and-turns.md",
        cases=asked.turns,
        entries=(_JOINTS,),
        judge=judges.copies,
    ),
    Exercise(
        call="solve(T_0_gripper, q_start)",
        answer="(N, 6) for poses (N, 4, 4), the arm standing at q_start (6,) [rad]",
        page="08-branches-and-turns.md",
        cases=asked.legs,
        any_shape=True,
        judge=judges.follows,
        whole=lambda robot, case, answer: answer,
    ),
    Exercise(
        call="singularity(q)",
        answer="distance of the wrist center from axis 1 [m], |sin gamma|, |sin theta 5|",
        page="09-singularities.md",
        cases=asked.singularity,
        entries=(("shoulder", "elbow", "wrist"),),
    ),
    Exercise(
        call="motion_time(distance, velocity, acceleration, jerk)",
        answer="least time from rest to rest [s]",
        page="11-motion.md",
        cases=asked.times,
        entries=(("it",),),
    ),
    Exercise(
        call="proved_rate(cycles)",
        answer="lower end of the exact 95 % interval when all of them succeed [1]",
        page="12-ten-of-ten.md",
        cases=asked.proofs,
        entries=(("it",),),
    ),
)
"""In the order of the course."""


def find_exercises(name: str) -> tuple[Exercise, ...]:
    """Return the exercise of a name, or all.

    Raises:
        BadInput: naming the option and the remedy.
    """
    found = tuple(exercise for exercise in EXERCISES if name in (exercise.name, ALL))
    if not found:
        known = ", ".join(exercise.name for exercise in EXERCISES)
        raise BadInput(f"--step: no step '{name:.80}'; give {ALL} or one of {known}")
    return found


class FunctionProcess(SolverProcess):
    """A function of an exercise in a process of its own."""

    given_form = "exercise"

    def call(self, arguments: Sequence[Any]) -> Array:
        """Return what it answers to some arguments, as an array.

        Raises:
            Refused: if it does not answer numbers in time.
        """
        self._send({"arguments": [np.asarray(value).tolist() for value in arguments]})
        message = self._receive(self._limits.pose_timeout, "a case")
        self._drain_now()
        if message.get("event") == "finding":
            raise Refused(Finding.from_json(message))
        try:
            values = np.array(message["values"], dtype=float)
        except (KeyError, TypeError, ValueError, OverflowError) as error:
            raise self._lost("its answer is not of the agreed form") from error
        if not values.size or not np.isfinite(values).all():
            raise Refused(Finding(kind="shape", detail="answered no finite numbers"))
        return values


def check_step(
    exercise: Exercise, source: SolverSource, robot: Robot, *, seed: int, limits: SolverLimits
) -> dict[str, Any]:
    """Ask a learner's function for every case of an exercise, and judge the answers.

    Args:
        exercise: the step.
        source: the learner's file or module; its function is the step's.
        robot: the truth.
        seed: of the random cases.
        limits: what the code may use.

    Returns:
        What `--json` prints: passed, counts, the worst error, what is wrong, and diagnoses;
        `written` is False for a function that is still as in the template.
    """
    named = SolverSource(file=source.file, module=source.module, function=exercise.name)
    cases = exercise.cases(robot, seed)
    errors: list[float] = []
    answers: list[Array] = []
    finding, asked, printed, written = "", "", b"", True
    try:
        with closing(FunctionProcess(named, limits)) as process:
            try:
                for case in cases:
                    answer = process.call(case.arguments)
                    if not exercise.any_shape:
                        answer = _shaped(answer, case.wanted.shape)
                    error, text = exercise.judge(robot, case, answer, exercise.entry)
                    if not (finding or error <= judges.TOLERANCE):
                        finding, asked = f"{case.title}: {text}", _call_text(exercise, case)
                    errors.append(error)
                    answers.append(answer)
            finally:
                printed = process.output
    except Refused as refused:
        case = cases[len(errors)]
        finding = finding or f"{case.title}: {refused.finding.text(source.name)}"
        asked = asked or _call_text(exercise, case)
        written = not refused.finding.detail.startswith(_UNWRITTEN)
    diagnoses, left_out = _diagnoses(exercise, robot, cases, answers) if finding else ([], [])
    right = sum(error <= judges.TOLERANCE for error in errors)
    worst = max(errors, default=math.inf)
    return {
        "step": exercise.name,
        "passed": right == len(cases),
        "written": written,
        "cases": len(cases),
        "right": right,
        "worst_error": worst if math.isfinite(worst) else None,
        "finding": finding or None,
        "asked": asked or None,
        "diagnoses": diagnoses,
        "left_out": left_out if diagnoses else [],
        "printed": printed.decode("utf-8", "replace"),
        "page": exercise.document,
    }


def _call_text(exercise: Exercise, case: Case) -> str:
    """Return the call of a case as one may copy it, unless it is far too long."""
    values = [np.round(np.asarray(value), 6).tolist() for value in case.arguments]
    text = f"{exercise.name}({', '.join(map(str, values))})"
    return text if len(text) <= _LONGEST_CALL else f"{exercise.name}(...), {case.title}"


def _shaped(answer: Array, shape: tuple[int, ...]) -> Array:
    """Return an answer in the shape that is wanted, where it differs by rows of one alone.

    Raises:
        Refused: if it has another.
    """
    if np.squeeze(answer).shape == tuple(count for count in shape if count != 1):
        return answer.reshape(shape)
    detail = f"answered an array of shape {answer.shape}, wanted {shape}"
    raise Refused(Finding(kind="shape", detail=detail))


def _diagnoses(
    exercise: Exercise, robot: Robot, cases: Sequence[Case], answers: Sequence[Array]
) -> tuple[list[dict[str, str]], list[str]]:
    """Return the known mistakes that explain wrong answers, all other steps done right.

    Cases that this leaves out, since the arm does not reach what was answered, are told, too.
    """
    if exercise.judge is judges.has_all:  # rows of one pose
        rows = [
            (np.repeat(case.T, len(answer), axis=0), answer)
            for case, answer in zip(cases, answers, strict=False)
            if answer.ndim == 2 and answer.shape[1] == 6
        ]
        fitted = rounding(rows, robot.geometry, judges.TOLERANCE)
        return [fitted.as_json()] if fitted else [], []
    if exercise.whole is None:
        return [], []
    legs, names, left_out = [], [], []
    for case, answer in zip(cases, answers, strict=False):
        if exercise.any_shape and answer.shape != (len(case.T), 6):
            continue
        q = exercise.whole(robot, case, answer)
        if np.isfinite(q).all():
            # Single poses have no way between them.
            start = q[0] if exercise.any_shape else np.full(6, np.nan)
            legs.append((case.T, start, q))
            names.append(case.title)
        else:
            left_out.append(case.title)
    # A part of an answer may be right in a branch that is not within limits.
    lower, upper = (robot.lower, robot.upper) if exercise.any_shape else (-_FREE, _FREE)
    found = diagnose(legs, lower, upper, arm=robot.geometry, names=names)
    found = [item for item in found if item.key != "unexplained"]
    # It explains every answer far better than a mistake that is told apart at 1 mm.
    if fitted := rounding([(T, q) for T, _, q in legs], robot.geometry, judges.TOLERANCE):
        found = [fitted, *(item for item in found if item.key in OF_THE_WAY)]
    return [item.as_json() for item in found], left_out


def step_text(exercise: Exercise, found: dict[str, Any]) -> str:
    """Return the result of `check_step` as a few lines."""
    count, right = found["cases"], found["right"]
    printed = [_plain(line) for line in found["printed"].splitlines()]
    more = [f"  ... and {len(printed) - _PRINTED_LINES} lines more"]
    shown = [f"  it printed {line}" for line in printed[:_PRINTED_LINES]]
    shown += more if len(printed) > _PRINTED_LINES else []
    if found["passed"]:
        lines = [
            f"{exercise.name}: right in {right} of {count} cases, to {found['worst_error']:.1e}"
        ]
    elif not found["written"]:
        lines = [f"{exercise.name}: not written yet, see {found['page']}"]
    else:
        lines = [
            f"{exercise.name}: right in {right} of {count} cases",
            f"  finding    {found['finding']}",
            f"  asked      {found['asked']}",
            *(f"  diagnosis  {item['text']} ({item['page']})" for item in found["diagnoses"]),
            *_left_out(found["left_out"]),
            f"  to write   {exercise.call} -> {exercise.answer}",
            f"  read       {found['page']}",
        ]
    return "\n".join([*lines, *shown])


def _left_out(titles: Sequence[str]) -> list[str]:
    """Return the line about cases that a diagnosis leaves out, if there are any."""
    if not titles:
        return []
    return [f"  left out   {', '.join(titles)}: the arm does not reach what was answered there"]


def _plain(text: str) -> str:
    """Return a line of foreign text that a terminal takes for nothing but text."""
    return "".join(sign if sign.isprintable() else "?" for sign in text[:200])
