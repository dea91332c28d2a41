"""The known mistakes of solvers as models: what each makes of a pose, and what of the angles."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from itertools import permutations
from typing import Any

import numpy as np

import ik
from kr210_sim.arrays import Array

Turned = Callable[[Array], Array]
"""From the requested rotations (N, 3, 3) to those that a mistaken solver works with."""

QUARTER = 0.5 * np.pi


def about(axis: int, angle: Array | float) -> Array:
    """Return rotations (..., 3, 3) about axis 0, 1 or 2 by angles (...) [rad]."""
    angles = np.asarray(angle, dtype=np.float64)
    i, j = (axis + 1) % 3, (axis + 2) % 3
    R = np.zeros((*angles.shape, 3, 3))
    R[..., axis, axis] = 1.0
    R[..., i, i] = R[..., j, j] = np.cos(angles)
    R[..., j, i] = np.sin(angles)
    R[..., i, j] = -R[..., j, i]
    return R


CORRECTION = about(2, np.pi) @ about(1, -QUARTER)
"""From the gripper of the URDF to that of the DH table; its own inverse."""


@dataclass(frozen=True, kw_only=True)
class Mistake:
    """One mistake; what is not set is done right.

    Attributes:
        key: stable name, with a section in docs/diagnoses.md.
        text: what the solver did, as a clause.
        unit: what brings its answers to radians.
        rotate: what it takes for the requested rotation.
        tool: what it takes for the distance from wrist center to the pose it is sent [m].
        q2, q3: answer minus right angle [rad].
        lean: what its R0_3 is turned too far about axis 2, when it solves the wrist [rad].
        shoulder: "a1 = 0" in the whole triangle, or "angle" in the angle of elevation alone.
        flat: takes axis 3 and axis 4 to intersect (a3 = 0).
        length: field of the arm, and what it is taken for [m].
        elbow: theta2 of one elbow with theta3 of the other.
        wrist: sign of theta5 without its theta4 and theta6.
        behind: theta1 half a turn off behind the axis, as from atan(y / x).
    """

    key: str
    text: str
    unit: float = 1.0
    rotate: Turned | None = None
    tool: float | None = None
    q2: float = 0.0
    q3: float = 0.0
    lean: float = 0.0
    shoulder: str = ""
    flat: bool = False
    length: tuple[str, float] | None = None
    elbow: bool = False
    wrist: bool = False
    behind: bool = False


Made = tuple[Mistake, ...]
"""A set of mistakes made together."""


def units() -> list[Mistake]:
    """Return mistakes of the unit."""
    return [
        Mistake(key="degrees", text="the answers are in degrees", unit=np.pi / 180),
        Mistake(
            key="degrees",
            text="the answers were turned from degrees to radians though they were radians",
            unit=180 / np.pi,
        ),
    ]


def _rotations() -> Iterator[Mistake]:
    """Yield mistakes about the requested orientation."""
    C = CORRECTION
    only_z, only_y = about(2, np.pi) @ C, about(1, -QUARTER) @ C
    sign = about(2, np.pi) @ about(1, QUARTER) @ C
    corrections: dict[str, Turned] = {
        "the gripper correction Rz(pi) Ry(-pi/2) is missing, or made twice": lambda R: R @ C,
        "the gripper correction has the wrong sign, Ry(+pi/2)": lambda R: R @ sign,
        "the gripper correction lacks its Ry(-pi/2)": lambda R: R @ only_z,
        "the gripper correction lacks its Rz(pi)": lambda R: R @ only_y,
        "the gripper correction is multiplied from the left": lambda R: C @ R @ C,
        "the rotation is transposed": lambda R: np.swapaxes(R, -1, -2),
        "the rotation is transposed after the gripper correction": (
            lambda R: C @ np.swapaxes(R, -1, -2) @ C
        ),
    }
    for text, turned in corrections.items():
        yield Mistake(key="gripper_correction", text=text, rotate=turned)
    names = "xyz"
    for order in permutations(range(3)):
        if order == (2, 1, 0):
            continue
        product = " ".join(f"R{names[axis]}" for axis in order)
        yield Mistake(
            key="rpy_order",
            text=f"roll, pitch and yaw are multiplied as {product} instead of Rz Ry Rx",
            rotate=lambda R, order=order: _product(_roll_pitch_yaw(R), order),  # type: ignore[misc]
        )
    yield Mistake(
        key="rpy_order",
        text="roll and yaw are exchanged",
        rotate=lambda R: _product(_roll_pitch_yaw(R)[::-1], (2, 1, 0)),
    )
    yield Mistake(
        key="rpy_order",
        text="the quaternion x, y, z, w is read as w, x, y, z",
        rotate=_read_shifted,
    )


def _roll_pitch_yaw(R: Array) -> list[Array]:
    """Return the angles (N,) of R = Rz(yaw) Ry(pitch) Rx(roll) [rad]."""
    pitch = np.arcsin(np.clip(-R[:, 2, 0], -1.0, 1.0))
    return [np.arctan2(R[:, 2, 1], R[:, 2, 2]), pitch, np.arctan2(R[:, 1, 0], R[:, 0, 0])]


def _product(angles: list[Array], order: tuple[int, ...]) -> Array:
    first, second, third = (about(axis, angles[axis]) for axis in order)
    return np.asarray(first @ second @ third)


def _read_shifted(R: Array) -> Array:
    """Return what x, y, z, w of the rotations is when read as w, x, y, z."""
    return rotations_of(np.roll(quaternions_of(R), -1, axis=-1))


def quaternions_of(R: Array) -> Array:
    """Return quaternions xyzw (N, 4) of rotations (N, 3, 3), of either sign."""
    x, y, z = R[:, :, 0], R[:, :, 1], R[:, :, 2]
    # The projector on the quaternion; its longest column is the best conditioned.
    K = np.empty((len(R), 4, 4))
    K[:, :3, :3] = R + np.swapaxes(R, 1, 2)
    trace = x[:, 0] + y[:, 1] + z[:, 2]
    K[:, range(3), range(3)] += 1.0 - trace[:, None]
    K[:, 3, 3] = 1.0 + trace
    K[:, 3, 0] = K[:, 0, 3] = y[:, 2] - z[:, 1]
    K[:, 3, 1] = K[:, 1, 3] = z[:, 0] - x[:, 2]
    K[:, 3, 2] = K[:, 2, 3] = x[:, 1] - y[:, 0]
    longest = np.argmax(K[:, range(4), range(4)], axis=1)
    column = K[np.arange(len(R)), :, longest]
    return np.asarray(column / np.linalg.norm(column, axis=1, keepdims=True))


def rotations_of(q: Array) -> Array:
    """Return rotations (N, 3, 3) of unit quaternions xyzw (N, 4)."""
    v, w = q[:, :3], q[:, 3]
    K = np.zeros((len(q), 3, 3))
    K[:, 2, 1] = v[:, 0]
    K[:, 0, 2] = v[:, 1]
    K[:, 1, 0] = v[:, 2]
    K -= np.swapaxes(K, 1, 2)
    return np.asarray(np.eye(3) + 2.0 * w[:, None, None] * K + 2.0 * K @ K)


def _tools(lengths: dict[str, float], right: float) -> Iterator[Mistake]:
    for what, length in lengths.items():
        if abs(length - right) > 1e-6:
            text = (
                f"the wrist center is taken {length:.3f} m behind the pose instead of "
                f"{right:.3f} m, a constant {abs(right - length):.3f} m along the tool ({what})"
            )
            yield Mistake(key="tool_length", text=text, tool=length)


def arm_mistakes(arm: ik.Arm, tool: float, flange: float) -> list[Mistake]:
    """Return mistakes that show in angles 1 to 3.

    Args:
        arm: the right geometry.
        tool: right distance from wrist center to the pose that is sent [m].
        flange: from link_6 to gripper_link [m].
    """
    sag = arm.constants.phi
    long = float(arm.T_tool[0, 3])
    lengths = {
        "link_6 taken for gripper_link": long - flange,
        "gripper_link taken for link_6": long,
        "the length of the gripper alone": flange,
        "the wrist center is the pose itself": 0.0,
        "the gripper counted twice": long + flange,
    }
    found = [*_tools(lengths, tool), *_rotations()]
    for sign, word in ((1, "larger"), (-1, "smaller")):
        for joint, name in ((2, "theta2_offset"), (3, "theta3_offset")):
            text = f"theta {joint} is {word} by pi/2"
            found.append(
                Mistake(key=name, text=text, q2=sign * QUARTER)
                if joint == 2
                else Mistake(key=name, text=text, q3=sign * QUARTER)
            )
    shown = f"{sag:.3f} rad"
    found += [
        Mistake(key="sag", text=f"the sag angle of {shown} is left out of theta 3", q3=sag),
        Mistake(key="sag", text=f"the sag angle of {shown} has the wrong sign", q3=2 * sag),
        Mistake(key="sag", text=f"the sag angle of {shown} is subtracted twice", q3=-sag),
        Mistake(key="sag", text=f"axis 4 is taken to meet axis 3 (no sag of {shown})", flat=True),
        Mistake(
            key="elbow_branch", text="theta 2 belongs to one elbow and theta 3 to the other",
            elbow=True,
        ),
        Mistake(
            key="shoulder_offset", text="the length a1 = 0.35 m is left out", shoulder="a1 = 0"
        ),
        Mistake(
            key="shoulder_offset", text="the elevation of the wrist center leaves a1 out",
            shoulder="angle",
        ),
        Mistake(
            key="front_only", text="theta 1 is half a turn off behind the axis, as of atan(y / x)",
            behind=True,
        ),
    ]  # fmt: skip
    return found


def wrist_mistakes(arm: ik.Arm) -> list[Mistake]:
    """Return mistakes that show in angles 4 to 6."""
    sag = arm.constants.phi
    found = list(_rotations())
    for name, joint in (("theta2_offset", 2), ("theta3_offset", 3)):
        for sign in (1, -1):
            text = f"R0_3 is evaluated with theta {joint} off by pi/2"
            found.append(Mistake(key=name, text=text, lean=sign * QUARTER))
    for times in (1, 2, -1, -2):
        text = f"R0_3 is evaluated with theta 3 off by {abs(times) * sag:.3f} rad"
        found.append(Mistake(key="sag", text=text, lean=times * sag))
    text = "the sign of theta 5 is that of one wrist branch, theta 4 and 6 are of the other"
    found.append(Mistake(key="wrist_branch", text=text, wrist=True))
    return found


@dataclass(frozen=True, kw_only=True)
class Sample:
    """Answered requests.

    Attributes:
        p: (N, 3) position that was sent, R (N, 3, 3) its rotation, base frame [m].
        R: rotation that was sent.
        q: (N, 6) answers in radians.
        tool: right distance from wrist center to p along R e_x [m].
        arm: the right geometry.
    """

    p: Array
    R: Array
    q: Array
    tool: float
    arm: ik.Arm

    @property
    def center(self) -> Array:
        """The right wrist center (N, 3) [m]."""
        return self.p - self.tool * self.R[:, :, 0]

    def of(self, chosen: Array) -> Sample:
        """Return some of the requests."""
        return replace(self, p=self.p[chosen], R=self.R[chosen], q=self.q[chosen])


_LENGTHS = {"a1": "a1", "a2": "L2", "a3": "a3", "d1": "d1", "d4": "d4"}
"""Lengths that a solver may have mistyped: name in the DH table -> field of the arm."""

_AGREEING = 1e-3
"""Guesses of a length that differ by less agree [m]."""


def length_mistakes(sample: Sample) -> list[Mistake]:
    """Return the mistake of each length of the arm that explains the answers best.

    The wrist center is linear in each of them.
    """
    arm, found = sample.arm, []

    def reached(geometry: ik.Arm) -> Array:
        return ik.wrist_center(geometry, ik.forward(geometry, sample.q))

    off = sample.center - reached(arm)
    for name, field in _LENGTHS.items():
        right = float(getattr(arm, field))
        along = reached(_with_length(arm, field, right + 1.0)) - reached(arm)
        guesses = right + np.sum(off * along, axis=1) / np.sum(along**2, axis=1)
        # What most answers agree on: of those out of reach each says something else.
        agreeing = np.abs(guesses[:, None] - guesses) < _AGREEING
        taken = float(guesses[np.argmax(agreeing.sum(axis=1))])
        if field == "L2" and taken <= 0.0:  # there is no such arm
            continue
        text = f"the length {name} is {taken:.3f} m instead of {right:.3f} m"
        if abs(taken) < _AGREEING:
            text = f"the length {name} = {right:.3f} m is left out"
        found.append(Mistake(key="length", text=text, length=(field, taken)))
    return found


def _with_length(arm: ik.Arm, field: str, value: float) -> ik.Arm:
    changed: dict[str, Any] = {field: value}
    return replace(arm, **changed)


def undone(q: Array, made: Made) -> Array:
    """Return answers without the constant offsets that mistakes gave them."""
    offset = np.zeros(6)
    for mistake in made:
        offset[1] += mistake.q2
        offset[2] += mistake.q3
    return q - offset


def arm_error(sample: Sample, made: Made) -> Array:
    """Return how far angles 1 to 3 are from what a solver with these mistakes answers, (N,) [m].

    NaN where such a solver has a wrist center that is out of reach: it may answer anything.
    """
    arm, R, tool = sample.arm, sample.R, sample.tool
    for mistake in made:
        R = mistake.rotate(R) if mistake.rotate else R
        tool = tool if mistake.tool is None else mistake.tool
        arm = replace(arm, a1=0.0) if mistake.shoulder == "a1 = 0" else arm
        arm = replace(arm, a3=0.0) if mistake.flat else arm
        arm = _with_length(arm, *mistake.length) if mistake.length else arm
    center = sample.p - tool * R[:, :, 0]
    variants = [undone(sample.q, made)]
    if any(mistake.behind for mistake in made):
        variants.append(variants[0] + np.pi * np.eye(6)[0] * (center[:, :1] < 0.0))
    if any(mistake.shoulder == "angle" for mistake in made):
        variants = [_raised(arm, center, q) for q in variants]
    if any(mistake.elbow for mistake in made):
        variants += [_reflected(arm, center, q) for q in variants]
    errors = [
        np.linalg.norm(ik.wrist_center(arm, ik.forward(arm, q)) - center, axis=1) for q in variants
    ]
    ahead = np.hypot(center[:, 0], center[:, 1]) - arm.a1
    distance = np.hypot(ahead, center[:, 2] - arm.d1)
    return np.where(distance < arm.constants.reach, np.min(errors, axis=0), np.nan)


def _seen_from_shoulder(arm: ik.Arm, center: Array, q: Array) -> tuple[Array, Array]:
    """Return the wrist center ahead of axis 2 and above it, each (N,) [m]."""
    ahead = np.cos(q[:, 0]) * center[:, 0] + np.sin(q[:, 0]) * center[:, 1]
    reach = np.copysign(np.hypot(center[:, 0], center[:, 1]), ahead)
    return reach - arm.a1, center[:, 2] - arm.d1


def _raised(arm: ik.Arm, center: Array, q: Array) -> Array:
    """Return angles with theta 2 put right whose elevation was seen from axis 1."""
    u, v = _seen_from_shoulder(arm, center, q)
    right = q.copy()
    right[:, 1] -= np.arctan2(v, u) - np.arctan2(v, u + arm.a1)
    return right


def _reflected(arm: ik.Arm, center: Array, q: Array) -> Array:
    """Return angles with theta 2 of the other elbow."""
    u, v = _seen_from_shoulder(arm, center, q)
    other = q.copy()
    other[:, 1] = np.pi - 2.0 * np.arctan2(v, u) - q[:, 1]
    return other


def wrist_error(sample: Sample, made: Made) -> Array:
    """Return the same for angles 4 to 6, given angles 1 to 3, (N,) [rad]."""
    R, lean = sample.R, 0.0
    for mistake in made:
        R = mistake.rotate(R) if mistake.rotate else R
        lean += mistake.lean
    leaning = sample.q + lean * np.eye(6)[2]
    variants = [leaning]
    if any(mistake.wrist for mistake in made):
        variants.append(leaning * [1, 1, 1, 1, -1, 1])
    errors = []
    for q in variants:
        reached = ik.forward(sample.arm, q)[:, :3, :3]
        chord = np.linalg.norm(reached - R, axis=(1, 2)) / np.sqrt(8.0)
        errors.append(2.0 * np.arcsin(np.minimum(1.0, chord)))
    return np.asarray(np.min(errors, axis=0))
