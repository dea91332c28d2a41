"""The candidates for each waypoint of a path: all branches, in all turns inside of the limits."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .arm import Arm
from .choice import slide_wrist
from .exceptions import IKError
from .kinematics import forward
from .limits import turns
from .solve import inverse
from .tolerances import CLOSE_POSE, SLIDE_TOLERANCE

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
    close: BoolArray
    """Whether each layer's pose is close to that of the layer before. Shape (m,)."""
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
    close = np.append(False, _distance(arm, passed) < CLOSE_POSE)[: len(size)]
    return Layers(padded, exists, waypoint, close, start is not None, len(poses))


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


def _distance(arm: Arm, T: FloatArray) -> FloatArray:
    """Distance of each pose from the one before: rotation plus translation over L2 + L3 [rad]."""
    step = T[1:, :3] - T[:-1, :3]
    # |R_a - R_b| = 2 sqrt(2) sin(angle / 2)
    chord = np.linalg.norm(step[:, :, :3], axis=(1, 2)) / np.sqrt(8.0)
    angle = 2.0 * np.arcsin(np.minimum(chord, 1.0))
    return np.asarray(angle + np.linalg.norm(step[:, :, 3], axis=1) / arm.constants.reach)
