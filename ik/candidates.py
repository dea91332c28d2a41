"""The candidates for each waypoint of a path: all branches, in all turns inside of the limits."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .arm import Arm
from .choice import slide_wrist
from .exceptions import IKError
from .kinematics import Frame, forward
from .limits import turns
from .solve import inverse
from .tolerances import SLIDE_TOLERANCE

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]
IntArray = NDArray[np.intp]


@dataclass(frozen=True)
class Layers:
    """The waypoints that have candidates, in order, after the start if there is one."""

    q: FloatArray
    """Candidates of each layer [rad], as many as the largest layer has. Shape (6, m, k)."""
    exists: BoolArray
    """Which of them are candidates, and not there to fill up. Shape (m, k)."""
    waypoint: IntArray
    """Index of the waypoint of each layer, the start left out. Shape (m,) or (m - 1,)."""
    T: FloatArray
    """Pose of each layer. Shape (m, 4, 4)."""
    apart: FloatArray
    """Distance of each layer's pose from the one before, see `pose_distance`. Shape (m,)."""
    starts: bool
    """The first layer is the start."""
    count: int
    """Number of waypoints."""


def find_layers(
    arm: Arm,
    T: ArrayLike,
    lower: FloatArray,
    upper: FloatArray,
    q_start: ArrayLike | None,
    accept: Callable[[FloatArray], BoolArray] | None,
    slack: float,
) -> Layers:
    """Collect the candidates for a path; the arguments are those of `best_sequence`."""
    poses = np.asarray(T, dtype=np.float64)
    if poses.ndim != 3:
        raise IKError(f"waypoints must have shape (n, 4, 4), got {poses.shape}")
    start = None if q_start is None else np.asarray(q_start, dtype=np.float64)
    if start is not None and (start.shape != (6,) or not np.isfinite(start).all()):
        raise IKError(f"q_start must be six finite angles in rad, got {q_start!r}")
    branches = inverse(arm, poses).q
    rows = branches.reshape(-1, 6)
    owner = np.repeat(np.arange(len(poses)), 8)
    slid, slid_owner = _slid(arm, branches, start)
    rows, owner = np.concatenate([rows, slid]), np.concatenate([owner, slid_owner])
    found = turns(rows, lower, upper, slack)
    q, owner = found.q, owner[found.row]
    if accept is not None:
        mask = np.asarray(accept(q))
        if mask.shape != (len(q),) or mask.dtype != np.bool_:
            raise IKError(f"accept must return a mask ({len(q)},), got {mask.dtype} {mask.shape}")
        q, owner = q[mask], owner[mask]
    waypoint, layer, size = np.unique(owner, return_inverse=True, return_counts=True)
    passed = poses[waypoint]
    if start is not None:
        q, layer, size = np.vstack([start, q]), np.append(0, layer + 1), np.append(1, size)
        passed = np.concatenate([forward(arm, start)[None], passed])
    order = np.argsort(layer, kind="stable")
    q, layer = q[order], layer[order]
    place = np.arange(len(q)) - (np.cumsum(size) - size)[layer]
    padded = np.zeros((6, len(size), int(size.max(initial=0))))
    padded[:, layer, place] = q.T
    exists = np.zeros(padded.shape[1:], dtype=np.bool_)
    exists[layer, place] = True
    entries = passed[:, :3].transpose(1, 2, 0)
    tool = Frame(*entries[:, :, 1:].transpose(1, 0, 2))
    apart = np.append(np.inf, pose_distance(arm, tool, entries[:, :, :-1]))[: len(size)]
    return Layers(padded, exists, waypoint, passed, apart, start is not None, len(poses))


def _slid(arm: Arm, branches: FloatArray, start: FloatArray | None) -> tuple[FloatArray, IntArray]:
    """Offer the angles of joint 4 of the waypoints around to those at the wrist singularity.

    There joint 4 may have any angle, so that of a neighbour lets the path pass without a swing.
    """
    count = len(branches)
    with np.errstate(invalid="ignore"):
        sine = np.abs(np.sin(arm.signs[4] * branches[..., 4] + arm.offsets[4]))
        at = sine <= SLIDE_TOLERANCE
    regular = ~at.any(axis=1) & ~np.isnan(sine).all(axis=1)
    index = np.arange(count)
    before = np.maximum.accumulate(np.where(regular, index, -1))
    after = np.minimum.accumulate(np.where(regular, index, count)[::-1])[::-1]
    rows, owners = [np.empty((0, 6))], [np.empty(0, dtype=np.intp)]
    for i in np.flatnonzero(at.any(axis=1)):
        q4 = [branches[k, :, 3] for k in (before[i], after[i]) if 0 <= k < count]
        if start is not None:
            q4.append(start[3:4])
        donors = np.unique(np.concatenate(q4)) if q4 else np.empty(0)
        donors = donors[~np.isnan(donors)]
        slid = slide_wrist(arm, branches[i, at[i]][:, None, :], donors).reshape(-1, 6)
        rows.append(slid)
        owners.append(np.full(len(slid), i))
    return np.concatenate(rows), np.concatenate(owners)


def pose_distance(arm: Arm, tool: Frame, T: FloatArray) -> FloatArray:
    """Compute how far poses are apart: angle of rotation plus translation over L2 + L3 [rad].

    The angle is taken for |R_a - R_b| / sqrt(2), which is 2 sin(angle / 2).

    Args:
        arm: The arm.
        tool: Poses by entries, each of shape (...).
        T: Other poses by entries. Shape (3, 4, ...).

    Returns:
        Shape (...).
    """
    x, y, z, p = (
        (a[0] - b[0]) ** 2 + (a[1] - b[1]) ** 2 + (a[2] - b[2]) ** 2
        for a, b in zip(tool, np.moveaxis(T, 1, 0), strict=True)
    )
    return np.asarray(np.sqrt(0.5 * (x + y + z)) + np.sqrt(p) / arm.constants.reach)
