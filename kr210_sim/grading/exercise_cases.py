"""The questions that the exercises of the course ask, and their right answers."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

import ik
from kr210_sim.arrays import Array
from kr210_sim.grading.debug_cases import GOLDEN, random_cases
from kr210_sim.grading.steps import TURN
from kr210_sim.robot import Robot
from kr210_sim.stats import success_interval
from kr210_sim.time_law import TimeLaw

RANDOM = 20
"""Cases drawn at random, beside those that are always the same."""

HOME = np.zeros(6)
_BEFORE_CELL = (2.2, 0.0, 1.678)  # of gripper_link, 0.4 m before the middle of cell 5 [m]
_OVER_BIN = (-0.1, 2.5, 1.6)
_POSES = 60  # of a leg
_STRETCHED = ((0.0, (0.0, 0.0, 1.2)), (1e-4, (0.5, 1e-4, 0.7)))  # theta 5, theta 4 to 6 [rad]
_FAR_TURNED = (-0.6, 5.4)  # joint 6 at the ends of a leg: further than atan2 goes [rad]


@dataclass(frozen=True, kw_only=True)
class Case:
    """One question to a learner's function.

    Attributes:
        title: what a reader calls it.
        arguments: one per parameter, arrays or numbers.
        wanted: the right answer, or one of them.
        T: (N, 4, 4) poses of gripper_link that it is about, for a diagnosis.
    """

    title: str
    arguments: tuple[Any, ...]
    wanted: Array
    T: Array = field(default_factory=lambda: np.empty((0, 4, 4)))


Cases = Callable[[Robot, int], list[Case]]
"""From the robot and a seed to all cases of an exercise."""


# ---- cases ----------------------------------------------------------------------------------


def _poses(robot: Robot, seed: int) -> list[tuple[str, Array]]:
    """Return poses of gripper_link that a front branch reaches, by their names."""
    T = np.eye(4)
    T[:3, 3] = _BEFORE_CELL
    found = [("the pose before cell 5", T)]
    found += [(f"golden pose {i}", case.T_base_palm) for i, case in enumerate(GOLDEN, 1)]
    drawn = [case.T_base_palm for case in random_cases(robot, 4 * RANDOM, seed)]
    reached = [T for T in drawn if ik.inverse(robot.geometry, T).valid[0]]
    return found + [(f"random pose {i}", T) for i, T in enumerate(reached[:RANDOM], 1)]


def of_poses(
    question: Callable[[Robot, Array], tuple[tuple[Any, ...], Array]],
) -> Callable[[Robot, int], list[Case]]:
    """Return cases from what is asked about one pose: (robot, T) -> arguments, wanted."""

    def cases(robot: Robot, seed: int) -> list[Case]:
        found = []
        for title, T in _poses(robot, seed):
            arguments, wanted = question(robot, T)
            found.append(Case(title=title, arguments=arguments, wanted=wanted, T=T[None]))
        return found

    return cases


def rotations(robot: Robot, seed: int) -> list[Case]:
    """Ask for the matrices of quaternions, one of them rounded and so no longer of unit length."""

    def question(robot: Robot, T: Array) -> tuple[tuple[Any, ...], Array]:
        return (Rotation.from_matrix(T[:3, :3]).as_quat(),), T[:3, :3]

    cases = of_poses(question)(robot, seed)
    T = cases[1].T.copy()
    rounded = np.round(cases[1].arguments[0], 2)
    T[0, :3, :3] = Rotation.from_quat(rounded).as_matrix()
    title = "a quaternion of two digits"
    return [*cases, Case(title=title, arguments=(rounded,), wanted=T[0, :3, :3], T=T)]


def wrists(robot: Robot, seed: int) -> list[Case]:
    """Ask for theta 4 to 6, at and next to the singular wrist, too."""

    def question(robot: Robot, T: Array) -> tuple[tuple[Any, ...], Array]:
        q = front(robot, T)
        return (*q[:3].tolist(), T_0_7_of(robot, T)), q[3:]

    cases = of_poses(question)(robot, seed)
    for theta5, wanted in _STRETCHED:
        q = np.array([0.3, 0.2, -0.4, 0.5, theta5, 0.7])
        T = ik.forward(robot.geometry, q)
        arguments = (*q[:3].tolist(), T_0_7_of(robot, T))
        title = f"theta 5 = {theta5:g}"
        cases.append(Case(title=title, arguments=arguments, wanted=np.array(wanted), T=T[None]))
    return cases


def _derived(robot: Robot) -> ik.DH:
    chain = robot.chain
    return ik.dh_from_chain(chain.origins, chain.axes, chain.T_last_palm)


def _table(robot: Robot) -> Array:
    table = _derived(robot)
    return np.stack([table.alpha, table.a, table.d, table.theta], axis=1)


def dh_of(table: Array) -> ik.DH:
    """Return a table of rows alpha, a, d, theta (n, 4) as one that can be evaluated."""
    alpha, a, d, theta = table.T
    return ik.DH(alpha=alpha, a=a, d=d, theta=theta)


def T_0_7_of(robot: Robot, T: Array) -> Array:
    """Return the last DH frame's pose for one of gripper_link."""
    return np.asarray(T @ np.linalg.inv(_derived(robot).T_tool))


def front(robot: Robot, T: Array) -> Array:
    """Return the branch that faces the pose, elbow up, theta 5 not negative (6,)."""
    return np.asarray(ik.inverse(robot.geometry, T).q[0])


def branches(robot: Robot, T: Array) -> Array:
    """Return every configuration that reaches a pose, turns aside (n, 6)."""
    found = ik.inverse(robot.geometry, T)
    return np.asarray(found.q[found.valid])


def joint_table(robot: Robot, seed: int) -> list[Case]:
    """Ask for the joint table, from the description."""
    chain = robot.chain
    rows = np.concatenate([chain.origins[:, :3, 3], chain.axes], axis=1)
    last = np.append(chain.T_last_palm[:3, 3], np.zeros(3))
    return [Case(title="the table", arguments=(), wanted=np.vstack([rows, last]))]


def dh_table(robot: Robot, seed: int) -> list[Case]:
    """Ask for the DH table."""
    return [Case(title="the table", arguments=(), wanted=_table(robot))]


def transform(robot: Robot, seed: int) -> list[Case]:
    """Ask for single rows of a DH table."""
    rng = np.random.default_rng(seed)
    rows = [(f"row {i}, q = 0", row) for i, row in enumerate(_table(robot), 1)]
    rows += [(f"random row {i}", rng.uniform(-2.0, 2.0, 4)) for i in range(1, RANDOM + 1)]
    cases = []
    for title, row in rows:
        alpha, a, d, theta = np.atleast_2d(row).T
        table = ik.DH(alpha=alpha, a=a, d=d, theta=theta, signs=())
        wanted = table.transforms(np.empty(0))[0]
        cases.append(Case(title=title, arguments=tuple(row.tolist()), wanted=wanted))
    return cases


def _configurations(robot: Robot, seed: int) -> list[tuple[str, Array]]:
    named = [("q = 0", HOME)]
    for joint in range(6):
        named.append((f"q{joint + 1} = 0.5 alone", 0.5 * np.eye(6)[joint]))
    drawn = np.random.default_rng(seed).uniform(robot.lower, robot.upper, (RANDOM, 6))
    return named + [(f"random angles {i}", q) for i, q in enumerate(drawn, 1)]


def total(robot: Robot, seed: int) -> list[Case]:
    """Ask for the product of all rows."""
    table = dh_of(_table(robot))
    return [
        Case(title=title, arguments=(q,), wanted=table.forward(q))
        for title, q in _configurations(robot, seed)
    ]


def singularity(robot: Robot, seed: int) -> list[Case]:
    """Ask for distances from the singularities."""
    arm = robot.geometry
    scale = np.array([arm.constants.reach, 1.0, 1.0])
    return [
        Case(title=title, arguments=(q,), wanted=scale * ik.singularity_distances(arm, q))
        for title, q in _configurations(robot, seed)
    ]


def turns(robot: Robot, seed: int) -> list[Case]:
    """Ask for copies of angles next to others."""
    rng = np.random.default_rng(seed)
    cases = []
    for number in range(1, RANDOM + 1):
        right, before = rng.uniform(robot.lower, robot.upper, (2, 6))
        q = (right + np.pi) % TURN - np.pi
        copies = q + TURN * np.arange(-2, 3)[:, None]
        inside = (copies >= robot.lower) & (copies <= robot.upper)
        way = np.where(inside, np.abs(copies - before), np.inf)
        wanted = np.take_along_axis(copies, way.argmin(axis=0)[None], axis=0)[0]
        cases.append(
            Case(
                title=f"random angles {number}",
                arguments=(q, before, robot.lower, robot.upper),
                wanted=wanted,
            )
        )
    return cases


def legs(robot: Robot, seed: int) -> list[Case]:
    """Return legs like those of a cycle, one with a far turn, and single poses from home."""
    arm, limits = robot.geometry, (robot.lower, robot.upper)
    T_cell, T_bin = np.eye(4), np.eye(4)
    T_cell[:3, 3], T_bin[:3, 3] = _BEFORE_CELL, _OVER_BIN
    T_bin[:3, :3] = Rotation.from_euler("z", 90, degrees=True).as_matrix()
    q_cell = ik.nearest(ik.inverse(arm, T_cell).q, HOME, *limits)
    q_bin = ik.nearest(ik.inverse(arm, T_bin).q, q_cell, *limits)
    q_ahead = np.array([0.0, 0.1, 0.2, 0.4, 0.6, 0.0])
    q_near, q_far = q_ahead + np.outer(_FAR_TURNED, np.eye(6)[5])
    cases = []
    for title, start, end in (
        ("the way from home to a cell", HOME, q_cell),
        ("the way from a cell to the bin", q_cell, q_bin),
        ("a far turn of the tool", q_near, q_far),
    ):
        q = start + np.linspace(0.0, 1.0, _POSES + 1)[1:, None] * (end - start)
        T = ik.forward(arm, q)
        cases.append(Case(title=title, arguments=(T, start), wanted=q, T=T))
    for title, T in _poses(robot, seed):
        if np.isfinite(q := ik.nearest(ik.inverse(arm, T).q, HOME, *limits)).all():
            asked = T[None]
            cases.append(Case(title=title, arguments=(asked, HOME), wanted=q[None], T=asked))
    return cases


def times(robot: Robot, seed: int) -> list[Case]:
    """Ask for ways from rest to rest."""
    rng = np.random.default_rng(seed)
    named = [
        ("a long way", (2.0, 1.0, 4.0, 80.0)),
        ("too short for full speed", (0.2, 1.0, 4.0, 80.0)),
        ("too short for full acceleration", (0.002, 1.0, 4.0, 80.0)),
        ("full speed without full acceleration", (2.0, 1.0, 40.0, 20.0)),
    ]
    for number in range(1, RANDOM + 1):
        distance, velocity, acceleration, jerk = (10.0 ** rng.uniform(-1.0, 1.0, 4)).tolist()
        named.append((f"random way {number}", (distance, velocity, acceleration, jerk)))
    return [
        Case(title=title, arguments=values, wanted=np.array([TimeLaw(*values).duration]))
        for title, values in named
    ]


def proofs(robot: Robot, seed: int) -> list[Case]:
    """Ask for runs in which every cycle succeeds."""
    return [
        Case(
            title=f"{cycles} of {cycles}",
            arguments=(cycles,),
            wanted=np.array([success_interval(cycles, cycles)[0]]),
        )
        for cycles in (1, 10, 72, 1000)
    ]
