"""Who may be how near to whom, and how far the joints may travel until they are."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.typing import NDArray

from kr210_sim.advance import Weights
from kr210_sim.arrays import Array
from kr210_sim.criteria import CLEARANCE_CAP
from kr210_sim.legs import Hand

SELF_CLEARANCE = 0.002
"""Kept between links of the robot itself [m]; neighbours of neighbours are always close."""

NEAR_SELF = 0.1
"""Distance up to which links see each other [m]."""

NEAR = CLEARANCE_CAP + 0.1
"""Distance up to which what moves and what is fixed see each other [m]. The wider, the longer the
steps and the dearer each of them; 0.2 m is about the optimum."""

FIXTURE, ROBOT, FINGER, TARGET, SUPPORT = range(5)  # roles of geoms
IGNORED, SELF, FREE = range(3)  # kinds of pairs
HANDS = {hand: index for index, hand in enumerate(Hand)}
HELD = np.array([hand in (Hand.LIFTING, Hand.HOLDING) for hand in Hand])

_JOINTS = np.arange(6)
FIXED, BASE, HAND, GROUPS = (
    0,
    1,
    7,
    8,
)  # groups: what hangs on arm joint j, up to the next, is BASE + j
_PAIRS = np.array(
    [(FIXED, b) for b in range(2, HAND + 1)]
    + [(a, b) for b in range(3, HAND + 1) for a in range(1, b - 1)]
)
"""Groups that can come near each other, the one further down the arm second. Neighbours on a joint
are always near; that of base and link 1 is seen at each configuration looked at, and only there."""

WITHIN = HAND - 1  # first of the pairs within the robot
_TOGETHER = len(_PAIRS)  # stands for pairs that do not move against each other, or may touch
_HAND = HAND - 2  # the row of the hand and what is fixed
_STRIDE = 3.0
"""How far the hand may move, in distances from what is nearest: more than 1 along a wall."""
_LEAST = 1e-6  # [m]
_BETWEEN = (_JOINTS >= _PAIRS[:, :1] - 1) & (_JOINTS < _PAIRS[:, 1:] - 1)


@dataclass(frozen=True, kw_only=True)
class Seen:
    """What is near what at B configurations.

    Attributes:
        row: (n,) index of the configuration at which two geoms are near each other.
        geoms: (n, 2) these two.
        kind: (n,) one of IGNORED, SELF, FREE.
        pair: (n,) row of `_PAIRS`, or `_TOGETHER`.
        distance: (n,) between them [m].
        direction: (n, 3) along which they are that far apart, of either sign.
        spot, size: (n, 3), (n,) a ball around the one that the hand carries or is [m].
        centers, radii: (B, 7, 3), (B, 7) of balls around all groups but the fixed [m].
        anchor, axis: (B, 6, 3) a point [m] and the direction of each joint axis.
    """

    row: NDArray[np.int64]
    geoms: NDArray[np.int32]
    kind: NDArray[np.int8]
    pair: NDArray[np.int8]
    distance: Array
    direction: Array
    spot: Array
    size: Array
    centers: Array
    radii: Array
    anchor: Array
    axis: Array


@cache
def tables() -> tuple[NDArray[np.int8], NDArray[np.int8]]:
    """Return kind and row of `_PAIRS` by hand and the sorts of two geoms, each (H, S, S).

    A sort is role * GROUPS + group; hands are numbered by `HANDS`.
    """
    kinds, rows = zip(*(_tables(hand) for hand in Hand), strict=True)
    return np.array(kinds), np.array(rows)


def _tables(hand: Hand) -> tuple[NDArray[np.int8], NDArray[np.int8]]:
    held = bool(HELD[HANDS[hand]])
    role, group = np.divmod(np.arange(GROUPS * (SUPPORT + 1)), GROUPS)
    low, high = np.minimum(role[:, None], role), np.maximum(role[:, None], role)
    on_target = (low == TARGET) | (high == TARGET)
    group = np.where(role == TARGET, HAND if held else FIXED, group)
    kind = np.full(low.shape, FREE, dtype=np.int8)
    robot = (role == ROBOT) | (role == FINGER)
    kind[robot[:, None] & robot] = SELF
    kind[(group[:, None] == HAND) & (group == HAND)] = SELF
    kind[(group[:, None] == FIXED) & (group == FIXED)] = IGNORED
    if hand is Hand.RELEASED:
        kind[on_target] = IGNORED
    if held:
        kind[(low == FINGER) & (high == TARGET)] = IGNORED
    if hand is Hand.LIFTING:
        kind[(low == TARGET) & (high == SUPPORT)] = IGNORED
    rows = np.full((GROUPS, GROUPS), _TOGETHER, dtype=np.int8)
    one, other = _PAIRS.T
    rows[one, other] = rows[other, one] = np.arange(_TOGETHER)
    return kind, np.where(kind == IGNORED, _TOGETHER, rows[group[:, None], group])


def weights(seen: Seen, excess: Array, clearance: Array) -> Weights:
    """Return how travel of the joints uses up the room, for `advance`.

    While the joints j between two groups travel |dq_j|, a point of the one further down the arm
    moves by at most sum_j |dq_j| (r_j + room) relative to the other: r_j is its distance from
    axis j at the beginning, and until the room is used up it has come no farther.

    Args:
        seen: at B configurations.
        excess: (n,) distance above what is required of each pair that is near [m].
        clearance: (B,) required of those that are not near each other [m].
    """
    arms = seen.centers[:, 1:, None] - seen.anchor[:, None]  # (B, 6 groups, 6 joints, 3)
    along = np.einsum("bgjx,bjx->bgj", arms, seen.axis)
    squared = np.einsum("bgjx,bgjx->bgj", arms, arms)
    from_axis = np.sqrt(np.maximum(squared - along * along, 0.0))
    reach = from_axis + seen.radii[:, 1:, None]
    # What is not reported is farther than the margins; links are farther than their balls, too.
    room = np.empty((len(reach), _TOGETHER + 1))
    room[:] = (NEAR - clearance)[:, None]
    one, other = _PAIRS[WITHIN:].T - 1
    between = seen.centers[:, one] - seen.centers[:, other]
    gaps = np.sqrt(np.einsum("bpx,bpx->bp", between, between))
    gaps -= seen.radii[:, one] + seen.radii[:, other]
    gaps -= np.maximum(clearance, SELF_CLEARANCE)[:, None]
    room[:, WITHIN:_TOGETHER] = np.maximum(NEAR_SELF - SELF_CLEARANCE, gaps)
    np.minimum.at(room, (seen.row, seen.pair), excess)
    rows = np.where(_BETWEEN, reach[:, _PAIRS[:, 1] - 2] / room[:, :-1, None] + 1.0, 0.0)
    either = _hand(seen, excess, room[:, _HAND], reach[:, HAND - 2], NEAR - clearance)
    either[:, 0, 0] = rows[:, _HAND]
    rows[:, _HAND] = 0.0
    return rows, either


def _hand(seen: Seen, excess: Array, least: Array, reach: Array, far: Array) -> Array:
    """Return how travel uses up the room between the hand and what is fixed, by direction.

    Two convex shapes that are d apart along n are so until one has moved by d along n. While no
    point of the hand has moved by more than s, which takes sum_j |dq_j| (r_j + s) <= s, the rate
    along n of a point p, n . (a_j x (p - o_j)) per radian of joint j, changes by at most s by the
    motion of p in the frame of the axis, and by r_j + s times the angles of the joints before j by
    the motion of the axis: the latter sums to less than s sum_j |dq_j|. So along n it moves by at
    most sum_j |dq_j| (|(n x a_j) . (p - o_j)| + 2 s).

    Args:
        seen: at B configurations.
        excess: (n,) distance above what is required of each pair that is near [m].
        least: (B,) excess of the hand against what is fixed [m].
        reach: (B, 6) of the hand from the axes [m].
        far: (B,) what is not near is farther than that above what is required [m].

    Returns:
        (B, 2, 2, 6): either set of two rows must hold; the first set is left at zero.
    """
    sets = np.zeros((len(reach), 2, 2, 6))
    step = np.clip(_STRIDE * least, _LEAST, far)[:, None]  # what is too near does not count
    sets[:, 1, 0] = reach / step + 1.0
    near = np.flatnonzero(seen.pair == _HAND)
    row = seen.row[near]
    (ax, ay, az), (nx, ny, nz) = seen.axis[row].T, seen.direction[near].T  # (6 joints, n), (n,)
    x, y, z = (seen.spot[near][:, None] - seen.anchor[row]).T
    along = ax * nx + ay * ny + az * nz
    rate = np.abs(nx * (ay * z - az * y) + ny * (az * x - ax * z) + nz * (ax * y - ay * x))
    rate += np.sqrt(np.maximum(1.0 - along * along, 0.0)) * seen.size[near]
    rate += 2.0 * step[row, 0]
    np.maximum.at(sets[:, 1, 1], row, (rate / np.maximum(excess[near], _LEAST)).T)
    return sets
