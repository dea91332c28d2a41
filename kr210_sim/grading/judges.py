"""Whether what a learner's function answers is right, where it is wrong, and what that makes."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

import ik
from kr210_sim.arrays import Array
from kr210_sim.grading.exercise_cases import HOME, Case, T_0_7_of, dh_of
from kr210_sim.grading.steps import TURN, beyond_limits, needless_steps
from kr210_sim.robot import Robot

TOLERANCE = 1e-6
"""Largest error of a right answer [m, rad or 1]."""

_ALIKE = 1e-3
"""Branches that are nearer to each other than this are the same [rad]."""

Entry = Callable[[tuple[int, ...]], str]
"""From the index in an answer to what a reader calls it."""

Judge = Callable[[Robot, Case, Array, Entry], tuple[float, str]]
"""-> largest error of an answer, and a clause: where it is, what was answered, what was wanted."""

Whole = Callable[[Robot, Case, Array], Array]
"""-> angles (N, 6) [rad] that reach what an answer says, everything else done right."""


# ---- judges ---------------------------------------------------------------------------------


def close(robot: Robot, case: Case, answer: Array, entry: Entry) -> tuple[float, str]:
    """Compare with the only right answer, number by number."""
    return _compared(case.wanted, answer, np.abs(answer - case.wanted), entry)


def _compared(wanted: Array, answer: Array, error: Array, entry: Entry) -> tuple[float, str]:
    worst = tuple(int(i) for i in np.unravel_index(int(np.argmax(error)), error.shape))
    text = f"{entry(worst)} is {answer[worst]:.6g}, wanted {wanted[worst]:.6g}"
    return float(error[worst]), text


def _apart(a: Array, b: Array) -> Array:
    """Return how far angles are apart, whole turns aside [rad]."""
    return np.asarray(np.abs((a - b + np.pi) % TURN - np.pi))


def same_table(robot: Robot, case: Case, answer: Array, entry: Entry) -> tuple[float, str]:
    """Compare DH tables, whole turns aside."""
    error = np.abs(answer - case.wanted)
    error[:, [0, 3]] = _apart(answer, case.wanted)[:, [0, 3]]
    worst, text = _compared(case.wanted, answer, error, entry)
    if worst > TOLERANCE and _moves_alike(answer, case.wanted):
        text += "; your frames describe this arm, too, but are chosen otherwise than on the page"
    return worst, text


def _moves_alike(one: Array, other: Array) -> bool:
    """Tell whether two tables turn the tool about the same axes, their last frames apart."""
    q = np.random.default_rng(0).uniform(-1.0, 1.0, (5, 6))
    motions = []
    for table in (one, other):
        T = dh_of(table).forward(np.concatenate([[HOME], q]))
        motions.append(T[1:] @ np.linalg.inv(T[0]))
    return bool(np.max(np.abs(motions[0] - motions[1])) < TOLERANCE)


def reaches_center(robot: Robot, case: Case, answer: Array, entry: Entry) -> tuple[float, str]:
    """Accept theta 1 to 3 of any branch."""
    arm = robot.geometry
    (center,) = case.arguments
    reached = ik.wrist_center(arm, ik.forward(arm, np.append(answer, [0.0, 0.0, 0.0])))
    missed = float(np.linalg.norm(reached - center))
    branches = ik.inverse(arm, case.T[0]).q[:, :3]
    apart = np.where(np.isnan(branches), np.inf, _apart(branches, answer))
    nearest = int(np.argmin(apart.max(axis=1)))
    _, text = _compared(branches[nearest], answer, apart[nearest], entry)
    return missed, f"{text}, and the wrist center is missed by {missed:.3g} m"


def reaches_rotation(robot: Robot, case: Case, answer: Array, entry: Entry) -> tuple[float, str]:
    """Accept theta 4 to 6 of either branch."""
    *arm_angles, _ = case.arguments
    reached = ik.forward(robot.geometry, np.append(arm_angles, answer))
    turned = _angle(reached, case.T[0])
    flipped = case.wanted * [1, -1, 1] + [np.pi, 0.0, np.pi]
    pair = np.stack([case.wanted, flipped])
    apart = _apart(pair, answer)
    nearest = int(np.argmin(apart.max(axis=1)))
    wanted = answer + (pair[nearest] - answer + np.pi) % TURN - np.pi
    _, text = _compared(wanted, answer, apart[nearest], entry)
    return turned, f"{text}, and the gripper is turned by {turned:.3g} rad"


def _angle(a: Array, b: Array) -> float:
    """Return the angle between the rotations of two poses (4, 4) [rad]."""
    chord = np.linalg.norm(a[:3, :3] - b[:3, :3]) / np.sqrt(8.0)
    return float(2.0 * np.arcsin(min(1.0, chord)))


def has_all(robot: Robot, case: Case, answer: Array, entry: Entry) -> tuple[float, str]:
    """Accept all branches in any order, each in any turn."""
    if answer.ndim != 2 or answer.shape[1] != 6 or not len(answer):
        return np.inf, f"answered an array of shape {answer.shape}, wanted (n, 6)"
    worst, row = max((_missed(robot, q, case.T[0]), i) for i, q in enumerate(answer))
    if worst > TOLERANCE:
        return worst, f"row {row + 1} misses the pose by {worst:.3g} (m or rad)"
    apart = _apart(case.wanted[:, None], answer[None]).max(axis=2).min(axis=1)
    absent = case.wanted[apart > _ALIKE]
    if len(absent):
        shown = ", ".join(f"{angle:.4f}" for angle in absent[0])
        count, most = len(case.wanted) - len(absent), len(case.wanted)
        return np.inf, f"has {count} of {most} branches, not for example ({shown})"
    return worst, "right"


def _missed(robot: Robot, q: Array, T: Array) -> float:
    reached = ik.forward(robot.geometry, q)
    return max(float(np.linalg.norm(reached[:3, 3] - T[:3, 3])), _angle(reached, T))


def follows(robot: Robot, case: Case, answer: Array, entry: Entry) -> tuple[float, str]:
    """Accept answers that reach their poses, within limits and without a needless step."""
    if answer.shape != (len(case.T), 6):
        return np.inf, f"answered an array of shape {answer.shape}, wanted ({len(case.T)}, 6)"
    missed = [_missed(robot, q, T) for q, T in zip(answer, case.T, strict=True)]
    pose = int(np.argmax(missed))
    if missed[pose] > TOLERANCE:
        return missed[pose], f"pose {pose} is missed by {missed[pose]:.3g} (m or rad)"
    over = beyond_limits(answer, robot.lower, robot.upper)
    if over.any():
        pose, joint = (int(i) for i in np.unravel_index(int(np.argmax(over)), over.shape))
        return (
            np.inf,
            f"joint {joint + 1} of pose {pose} is beyond its limit: {answer[pose, joint]:.4f}",
        )
    start = case.arguments[1]
    for step in needless_steps(robot.geometry, robot.lower, robot.upper, start, answer):
        what = step.kind.replace("_", " ")
        return np.inf, (
            f"joint {step.joint} moves {step.moved:.2f} rad to pose {step.pose} where "
            f"{step.needed:.2f} rad would do ({what})"
        )
    return missed[pose], "right"


# ---- the whole answer, for a diagnosis ------------------------------------------------------


def _reaching(robot: Robot, T: Array) -> Array:
    try:
        return np.asarray(ik.inverse(robot.geometry, T).q[:1])
    except ik.InvalidPose:
        return np.full((1, 6), np.nan)


def from_rotation(robot: Robot, case: Case, answer: Array) -> Array:
    """Complete a rotation (3, 3)."""
    T = case.T[0].copy()
    T[:3, :3] = answer
    return _reaching(robot, T)


def from_dh_pose(robot: Robot, case: Case, answer: Array) -> Array:
    """Complete a pose T_0_7 (4, 4)."""
    return _reaching(robot, answer @ np.linalg.inv(T_0_7_of(robot, np.eye(4))))


def from_center(robot: Robot, case: Case, answer: Array) -> Array:
    """Complete a wrist center (3,)."""
    T = case.T[0].copy()
    T[:3, 3] = answer + robot.geometry.T_tool[0, 3] * T[:3, 0]
    return _reaching(robot, T)


def from_first_three(robot: Robot, case: Case, answer: Array) -> Array:
    """Complete theta 1 to 3."""
    arm = robot.geometry
    T = case.T[0].copy()
    center = ik.wrist_center(arm, ik.forward(arm, np.append(answer, [0.0, 0.0, 0.0])))
    T[:3, 3] = center + arm.T_tool[0, 3] * T[:3, 0]
    branches = ik.inverse(arm, T).q
    apart = _apart(branches[:, :3], answer).max(axis=1)
    if np.isnan(apart).all():
        return np.full((1, 6), np.nan)
    return np.append(answer, branches[int(np.nanargmin(apart)), 3:])[None]


def from_last_three(robot: Robot, case: Case, answer: Array) -> Array:
    """Complete theta 4 to 6."""
    return np.append(case.arguments[:3], answer)[None]
