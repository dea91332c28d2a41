"""Steps between the answers of a leg that need not be: whole turns, changes of branch, limits."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

import ik
from kr210_sim.arrays import Array

TURN = 2.0 * np.pi

_JUMP = 1.0
"""Steps that move a joint less, turns apart, are no jumps [rad]."""

_SLACK = 1e-6
"""How far beyond its limits a joint counts as inside [rad]."""

_SINGULAR = 0.02
"""Where |sin theta5| is less, joints 4 and 6 may turn against each other [1]."""


@dataclass(frozen=True, kw_only=True)
class Step:
    """One step that need not be.

    Attributes:
        kind: "turn_jumps", "elbow_branch", "wrist_branch" or "shoulder_branch".
        leg, pose: where it leads to, counting from 0.
        joint: that moves most, counting from 1.
        moved, needed: largest motion of a joint, and with the better answer [rad].
    """

    kind: str
    leg: int
    pose: int
    joint: int
    moved: float
    needed: float


def needless_steps(
    arm: ik.Arm, lower: Array, upper: Array, q_start: Array, q: Array, *, leg: int = 0
) -> list[Step]:
    """Return the steps of a leg that an equally right answer would have made shorter.

    The branches are those of the pose which the answer reaches, right or not.

    Args:
        arm: the geometry.
        lower: (6,) joint limits [rad], and `upper`.
        upper: (6,) upper joint limits [rad].
        q_start: (6,) where the arm stands [rad].
        q: (N, 6) the answers; a row of NaN is passed over.
        leg: for the steps that are returned.
    """
    before, after, rows = _pairs(q_start, q)
    turns = needless_turns(lower, upper, q_start, q, leg=leg)
    return turns + _changes(arm, lower, upper, before, after, rows, leg)


def needless_turns(
    lower: Array, upper: Array, q_start: Array, q: Array, *, leg: int = 0
) -> list[Step]:
    """Return the whole turns of a leg that need not be, one for every joint that makes one.

    Arguments are those of `needless_steps`.
    """
    before, after, rows = _pairs(q_start, q)
    step = after - before
    turns = np.round(step / TURN)
    found = []
    nearer = after - TURN * turns
    # An answer beyond the limits is a finding of its own.
    inside = _inside(nearer, lower, upper) & _inside(after, lower, upper)
    for index, joint in np.argwhere((turns != 0) & inside):
        moved = abs(float(step[index, joint]))
        needed = abs(float(step[index, joint] - TURN * turns[index, joint]))
        if 2.0 * needed < moved:
            found.append(_step("turn_jumps", leg, rows[index], joint, moved, needed))
    return found


def _pairs(q_start: Array, q: Array) -> tuple[Array, Array, Array]:
    """Return the ends of each step, (n, 6) both, and to which row of q (N, 6) it leads (n,)."""
    rows = np.flatnonzero(np.all(np.isfinite(q), axis=1))
    path = np.concatenate([q_start[None], q[rows]])
    return path[:-1], path[1:], rows


def _changes(
    arm: ik.Arm,
    lower: Array,
    upper: Array,
    before: Array,
    after: Array,
    rows: Array,
    leg: int,
) -> list[Step]:
    """Return the steps from before to after (n, 6), to poses rows (n,), that change branch."""
    found: list[Step] = []
    step = after - before
    moved = np.abs(step - TURN * np.round(step / TURN))
    large = np.flatnonzero(moved.max(axis=1) > _JUMP)
    if not len(large):
        return found
    branches = ik.inverse(arm, ik.forward(arm, after[large])).q  # (n, 8, 6)
    way = branches - before[large, None]
    way -= TURN * np.round(way / TURN)
    other = before[large, None] + way
    sides = _elbow_and_shoulder(arm, np.stack([before[large], after[large]]))
    # Better is only what would have stayed on the side where the arm was.
    stays = np.all(_elbow_and_shoulder(arm, branches) == sides[0][:, None], axis=2)
    stays &= np.all(_inside(other, lower, upper), axis=2)
    needed = np.where(stays, np.abs(way).max(axis=2), np.inf)
    for row, index in enumerate(large):
        least = float(np.nanmin(needed[row], initial=np.inf))
        most = float(moved[index].max())
        kind = _kind(sides[:, row], np.stack([before[index], after[index]]))
        if kind and 2.0 * least < most:
            joint = int(np.argmax(moved[index]))
            found.append(_step(kind, leg, rows[index], joint, most, least))
    return found


def _inside(q: Array, lower: Array, upper: Array) -> Array:
    return np.asarray((q >= lower - _SLACK) & (q <= upper + _SLACK))


def _step(
    kind: str, leg: int, pose: np.intp, joint: np.intp | int, moved: float, needed: float
) -> Step:
    return Step(
        kind=kind, leg=leg, pose=int(pose), joint=int(joint) + 1, moved=moved, needed=needed
    )


def _elbow_and_shoulder(arm: ik.Arm, q: Array) -> Array:
    """Return whether the elbow is up and the shoulder in front, (..., 2) of bool for q (..., 6)."""
    up = np.cos(q[..., 2] + arm.constants.phi) > 0.0
    center = ik.wrist_center(arm, ik.forward(arm, q))
    front = np.cos(q[..., 0]) * center[..., 0] + np.sin(q[..., 0]) * center[..., 1] > 0.0
    return np.stack([up, front], axis=-1)


def _kind(sides: Array, pair: Array) -> str | None:
    """Return which branch differs between two configurations, None at a singular wrist.

    Args:
        sides: (2, 2) elbow and shoulder of both.
        pair: (2, 6) the configurations.
    """
    for kind, (one, other) in zip(("elbow_branch", "shoulder_branch"), sides.T, strict=True):
        if one != other:
            return kind
    if np.any(np.abs(np.sin(pair[:, 4])) < _SINGULAR):
        return None
    wrist = np.sin(pair[:, 4]) > 0.0
    return "wrist_branch" if wrist[0] != wrist[1] or _half_turned(pair) else None


def _half_turned(pair: Array) -> bool:
    """Tell whether joints 4 and 6 make half a turn: theta5 keeps its sign where it should not."""
    way = pair[1] - pair[0]
    way -= TURN * np.round(way / TURN)
    return bool(np.all(np.abs(way[[3, 5]]) > 0.5 * np.pi))


def beyond_limits(q: Array, lower: Array, upper: Array) -> Array:
    """Return by how much joints are beyond their limits, (N, 6) [rad]; NaN counts as inside."""
    return np.asarray(np.fmax(0.0, np.fmax(lower - q, q - upper) - _SLACK))
