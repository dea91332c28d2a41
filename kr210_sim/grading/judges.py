"""Whether what a learner's function answers is right, where it is wrong, and what that makes."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy.spatial.transform import Rotation

import ik
from kr210_sim.arrays import Array
from kr210_sim.grading.exercise_cases import HOME, Case, T_0_7_of, dh_of
from kr210_sim.grading.steps import TURN, beyond_limits, needless_steps
from kr210_sim.robot import Robot

TOLERANCE = 1e-6
"""Largest error of a right answer [m, rad or 1]."""

_ALIKE = 1e-3
"""Branches that are nearer to each other than this are the same [rad]."""

_ROUNDING = 1e-12
"""Numbers below are shown as zero [1]."""

_DEGREES = " (right in degrees; answer in radians)"

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
    """Return the largest error and the first wrong entry: others may follow from that one."""
    first = tuple(int(i) for i in np.unravel_index(int(np.argmax(error > TOLERANCE)), error.shape))
    text = f"{entry(first)} is {_number(answer[first])}, wanted {_number(wanted[first])}"
    return float(error.max()), text


def _number(value: float) -> str:
    return "0" if abs(value) < _ROUNDING else f"{value:.6g}"


def _alike(one: Array, other: Array) -> bool:
    return bool(np.allclose(one, other, rtol=0.0, atol=TOLERANCE))


def _apart(a: Array, b: Array) -> Array:
    """Return how far angles are apart, whole turns aside [rad]."""
    return np.asarray(np.abs((a - b + np.pi) % TURN - np.pi))


def joint_rows(robot: Robot, case: Case, answer: Array, entry: Entry) -> tuple[float, str]:
    """Compare joint tables."""
    worst, text = close(robot, case, answer, entry)
    if worst > TOLERANCE and _alike(answer[:, :3], np.cumsum(case.wanted[:, :3], axis=0)):
        text += "; yours are added up from the base, wanted is each from the joint before"
    return worst, text


def row_transform(robot: Robot, case: Case, answer: Array, entry: Entry) -> tuple[float, str]:
    """Compare transforms of a row."""
    worst, text = close(robot, case, answer, entry)
    alpha, a, d, theta = case.arguments
    turned = Rotation.from_euler("ZX", (theta, alpha)).as_matrix()
    classic = np.column_stack([turned, (a * np.cos(theta), a * np.sin(theta), d)])
    if worst > TOLERANCE and _alike(answer[:3], classic):
        text += "; yours is the classic Rz Tz Tx Rx, the modified convention has Rx Tx Rz Tz"
    return worst, text


def same_table(robot: Robot, case: Case, answer: Array, entry: Entry) -> tuple[float, str]:
    """Compare DH tables, whole turns aside."""
    error = np.abs(answer - case.wanted)
    error[:, [0, 3]] = _apart(answer, case.wanted)[:, [0, 3]]
    worst, text = _compared(case.wanted, answer, error, entry)
    if worst > TOLERANCE and _moves_alike(answer, case.wanted):
        text += "; your frames describe this arm, too, but are chosen otherwise than on the page"
    elif worst > TOLERANCE and _alike(answer[:-1, :2], case.wanted[1:, :2]):
        text += "; alpha and a stand a row too early: row i has alpha_(i-1) and a_(i-1)"
    elif worst > TOLERANCE and _alike(np.radians(answer[:, [0, 3]]), case.wanted[:, [0, 3]]):
        text += _DEGREES
    return worst, text


def back_along_z(robot: Robot, case: Case, answer: Array, entry: Entry) -> tuple[float, str]:
    """Compare wrist centers."""
    worst, text = close(robot, case, answer, entry)
    (T,) = case.arguments
    way = float(np.linalg.norm(case.wanted - T[:3, 3]))
    taken = {
        "yours goes back along the first column": T[:3, 0],
        "yours goes back along the third row": T[2, :3],
        "yours goes forth along z_7": -T[:3, 2],
    }
    for what, direction in taken.items():
        if worst > TOLERANCE and _alike(answer, T[:3, 3] - way * direction):
            return worst, f"{text}; {what}, wanted is back along z_7, the third column"
    return worst, text


def copies(robot: Robot, case: Case, answer: Array, entry: Entry) -> tuple[float, str]:
    """Compare angles that are to be next to others, within limits."""
    worst, text = close(robot, case, answer, entry)
    *_, lower, upper = case.arguments
    beyond = np.flatnonzero(beyond_limits(answer, lower, upper))
    if worst > TOLERANCE and len(beyond):
        text += f"; {entry((int(beyond[0]),))} is beyond its limit"
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
    branches = ik.inverse(arm, case.T[0])
    text = _beside(branches.q[branches.valid, :3], answer, entry)
    return missed, f"{text}, and the wrist center is missed by {missed:.3g} m"


def _beside(branches: Array, answer: Array, entry: Entry) -> str:
    """Return where an answer (3,) differs from the branch of (n, 3) that was meant."""
    apart = _apart(branches, answer)
    # Of most right angles, then the nearest: a single wrong one is named.
    meant = np.lexsort((apart.max(axis=1), (apart > TOLERANCE).sum(axis=1)))[0]
    wanted = (branches[meant] + np.pi) % TURN - np.pi
    _, text = _compared(wanted, answer, apart[meant], entry)
    in_degrees = np.any(_apart(branches, np.radians(answer)).max(axis=1) < TOLERANCE)
    return text + (_DEGREES if in_degrees else "")


def reaches_rotation(robot: Robot, case: Case, answer: Array, entry: Entry) -> tuple[float, str]:
    """Accept theta 4 to 6 of either branch."""
    *arm_angles, _ = case.arguments
    reached = ik.forward(robot.geometry, np.append(arm_angles, answer))
    turned = _angle(reached, case.T[0])
    flipped = case.wanted * [1, -1, 1] + [np.pi, 0.0, np.pi]
    if abs(np.sin(case.wanted[1])) < TOLERANCE:
        text = _by_the_sum(case.wanted, answer, entry)
    else:
        text = _beside(np.stack([case.wanted, flipped]), answer, entry)
    return turned, f"{text}, and the gripper is turned by {turned:.3g} rad"


def _by_the_sum(wanted: Array, answer: Array, entry: Entry) -> str:
    """Return where an answer (3,) differs at theta 5 = 0: of theta 4 and 6 the sum is all."""
    if _apart(wanted, answer)[1] > TOLERANCE:
        return f"{entry((1,))} is {_number(answer[1])}, wanted {_number(wanted[1])}"
    sums = [
        _number((float(angles[0] + angles[2]) + np.pi) % TURN - np.pi)
        for angles in (answer, wanted)
    ]
    return (
        f"{entry((0,))} plus {entry((2,))} is {sums[0]}, wanted {sums[1]}, which any pair of that "
        "sum gives"
    )


def _angle(a: Array, b: Array) -> float:
    """Return the angle between the rotations of two poses (4, 4) [rad]."""
    chord = np.linalg.norm(a[:3, :3] - b[:3, :3]) / np.sqrt(8.0)
    return float(2.0 * np.arcsin(min(1.0, chord)))


def has_all(robot: Robot, case: Case, answer: Array, entry: Entry) -> tuple[float, str]:
    """Accept all branches in any order, each in any turn."""
    if answer.ndim != 2 or answer.shape[1] != 6 or not len(answer):
        return np.inf, f"answered an array of shape {answer.shape}, wanted (n, 6)"
    missed = [_missed(robot, q, case.T[0]) for q in answer]
    wrong = [row for row, (error, _) in enumerate(missed) if not error <= TOLERANCE]
    if wrong:
        rows = f"{len(wrong)} of {len(missed)} rows miss the pose, the first is row {wrong[0] + 1}"
        return max(missed)[0], f"{rows}: {missed[wrong[0]][1]}"
    worst = max(missed)[0]
    apart = _apart(case.wanted[:, None], answer[None]).max(axis=2).min(axis=1)
    absent = case.wanted[apart > _ALIKE]
    if len(absent):
        shown = ", ".join(f"{angle:.4f}" for angle in absent[0])
        count, most = len(case.wanted) - len(absent), len(case.wanted)
        return np.inf, f"has {count} of {most} branches, not for example ({shown})"
    return worst, "right"


def _missed(robot: Robot, q: Array, T: Array) -> tuple[float, str]:
    """Return the error of a configuration [m or rad], and a clause: which half of it is wrong."""
    reached = ik.forward(robot.geometry, q)
    centers = ik.wrist_center(robot.geometry, np.stack([reached, T]))
    off = float(np.linalg.norm(centers[0] - centers[1]))
    turned = _angle(reached, T)
    if off > TOLERANCE:
        clause = f"theta 1 to 3 miss the wrist center by {off:.3g} m"
    else:
        clause = f"theta 4 to 6 leave the gripper turned by {turned:.3g} rad"
    return max(float(np.linalg.norm(reached[:3, 3] - T[:3, 3])), turned), clause


def follows(robot: Robot, case: Case, answer: Array, entry: Entry) -> tuple[float, str]:
    """Accept answers that reach their poses, within limits and without a needless step."""
    if answer.shape != (len(case.T), 6):
        return np.inf, f"answered an array of shape {answer.shape}, wanted ({len(case.T)}, 6)"
    missed = [_missed(robot, q, T) for q, T in zip(answer, case.T, strict=True)]
    worst = max(missed)[0]
    for pose, (error, clause) in enumerate(missed):
        if error > TOLERANCE:
            return worst, f"pose {pose} is missed: {clause}"
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
    return worst, "right"


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
