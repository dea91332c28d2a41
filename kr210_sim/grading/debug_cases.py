"""The course's debug script: golden poses, and the errors of the angles answered to them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

import ik
from kr210_sim.arrays import Array
from kr210_sim.grading.foreign import ForeignSolver
from kr210_sim.robot import Robot


class DebugCase(NamedTuple):
    """A pose of gripper_link in the base frame, and what is known of it.

    Attributes:
        position: (3,) [m].
        quaternion_xyzw: (4,), rounded; normalise it.
        wrist_center: (3,) [m].
        q: (6,) one of the configurations that reach it [rad].
    """

    position: tuple[float, ...]
    quaternion_xyzw: tuple[float, ...]
    wrist_center: tuple[float, ...]
    q: tuple[float, ...]

    @property
    def T_base_palm(self) -> Array:
        """The pose as a matrix (4, 4)."""
        T = np.eye(4)
        T[:3, :3] = Rotation.from_quat(self.quaternion_xyzw).as_matrix()
        T[:3, 3] = self.position
        return T


GOLDEN = (
    DebugCase(
        (2.16135, -1.42635, 1.55109),
        (0.708611, 0.186356, -0.157931, 0.661967),
        (1.89451, -1.44302, 1.69366),
        (-0.65, 0.45, -0.36, 0.95, 0.79, 0.49),
    ),
    DebugCase(
        (-0.56754, 0.93663, 3.0038),
        (0.62073, 0.48318, 0.38759, 0.480629),
        (-0.638, 0.64198, 2.9988),
        (-0.79, -0.11, -2.33, 1.94, 1.14, -3.68),
    ),
    DebugCase(
        (-1.3863, 0.02074, 0.90986),
        (0.01735, -0.2179, 0.9025, 0.371016),
        (-1.1669, -0.17989, 0.85137),
        (-2.99, -0.12, 0.94, 4.06, 1.29, -4.12),
    ),
)
"""The course's three."""

_NEAR = 1e-3  # [m]
_MOST_SHOWN = 10  # cases

_WARNING = """** Other branches and turns are as right as the angles compared with here: large theta
   errors alone prove nothing, the error of the end effector does. **"""


def random_cases(robot: Robot, count: int, seed: int) -> list[DebugCase]:
    """Return poses that the arm reaches within its limits, drawn at random."""
    if count == 0:
        return []  # SciPy below 1.15 takes no empty array of rotations
    rng = np.random.default_rng(seed)
    q = rng.uniform(robot.lower, robot.upper, (count, 6))
    poses = ik.forward(robot.geometry, q)
    quaternions = Rotation.from_matrix(poses[:, :3, :3]).as_quat(canonical=True)
    centers = ik.wrist_center(robot.geometry, poses)
    return [
        DebugCase(*map(tuple, (pose[:3, 3].tolist(), turn.tolist(), center.tolist(), row.tolist())))
        for pose, turn, center, row in zip(poses, quaternions, centers, q, strict=True)
    ]


def debug_report(
    solver: ForeignSolver, robot: Robot, cases: Sequence[DebugCase]
) -> tuple[str, bool]:
    """Ask a solver for some poses one by one.

    Returns:
        The errors as the course printed them, and whether every answer is within 1 mm.

    Raises:
        Refused: if it cannot be loaded.
    """
    solver.load()
    texts, offsets = [], []
    for number, case in enumerate(cases, start=1):
        text, offset = _case_text(solver, robot, case, f"case {number} of {len(cases)}")
        texts.append(text)
        offsets.append(offset)
    text = "\n\n".join([*_shown(texts, offsets), _overall(offsets)])
    return text, all(offset < _NEAR for offset in offsets)  # NaN is not


def _shown(texts: Sequence[str], offsets: Sequence[float]) -> list[str]:
    """Return all cases, or of many the golden ones and the worst of the others."""
    golden, others = texts[: len(GOLDEN)], offsets[len(GOLDEN) :]
    if len(texts) <= _MOST_SHOWN:
        return list(texts)
    worst = int(np.argmax(np.nan_to_num(others, nan=np.inf)))
    hidden = f"{len(others) - 1} random cases are not shown; the worst is"
    return [*golden, hidden, texts[len(GOLDEN) + worst]]


def _overall(offsets: Sequence[float]) -> str:
    """Return one line about all cases; an offset of NaN is no answer."""
    answered = [(offset, number) for number, offset in enumerate(offsets, 1) if offset == offset]
    text = f"{len(answered)} of {len(offsets)} cases answered"
    if not answered:
        return text
    near = sum(offset < _NEAR for offset, _ in answered)
    worst, number = max(answered)
    return (
        f"{text}, {near} of them within {1e3 * _NEAR:.0f} mm; "
        f"worst end effector offset {worst:.8f} units, in case {number}"
    )


def _case_text(
    solver: ForeignSolver, robot: Robot, case: DebugCase, title: str
) -> tuple[str, float]:
    """Return what is said of a case, and the end effector's offset [m]."""
    answer = solver.ask(case.T_base_palm[None], np.zeros(6))
    if answer.finding is not None or not np.all(np.isfinite(answer.q)):
        finding = answer.finding
        why = "no answer" if finding is None else finding.text(solver.source.name)
        return f"{title}\n{why}", np.nan
    reached = ik.forward(robot.geometry, answer.q[0])
    center = ik.wrist_center(robot.geometry, reached)
    seconds = f"{answer.seconds[0]:.4f}"
    thetas = np.abs(answer.q[0] - np.array(case.q))
    missed = reached[:3, 3] - np.array(case.position)
    text = "\n".join(
        [
            title,
            f"Total run time to calculate joint angles from pose is {seconds} seconds",
            "",
            *_errors("Wrist", center - np.array(case.wrist_center)),
            "",
            *(f"Theta {joint} error is: {error:.8f}" for joint, error in enumerate(thetas, 1)),
            "",
            _WARNING,
            "",
            *_errors("End effector", missed),
        ]
    )
    return text, float(np.linalg.norm(missed))


def _errors(what: str, error: Array) -> list[str]:
    lines = [
        f"{what} error for {axis} position is: {abs(value):.8f}"
        for axis, value in zip("xyz", error, strict=True)
    ]
    overall = float(np.linalg.norm(error))
    return [*lines, f"Overall {what.lower()} offset is: {overall:.8f} units"]
