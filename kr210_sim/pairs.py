"""Who may be how near to whom, and how far the joints may travel until they are."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.typing import NDArray

from kr210_sim.advance import Room, Stretches
from kr210_sim.arrays import Array
from kr210_sim.criteria import CLEARANCE_CAP
from kr210_sim.legs import Hand

TOLERANCE = 1e-3
"""What is looked at keeps this much more than the clearance [m], so that steps have a least length;
a path that keeps it everywhere is never refused."""

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
TOGETHER = len(_PAIRS)  # stands for pairs that do not move against each other, or may touch
_HAND = HAND - 2  # the row of the hand and what is fixed
_LEAST = 1e-6  # [m]
_FURTHER = _PAIRS[:, 1] - 2  # the moving group further down the arm, by its row in `reach`
_ONE, _OTHER = _PAIRS[WITHIN:].T - 1  # groups by their rows in `Seen.centers`
_BETWEEN = (_JOINTS >= _PAIRS[:, :1] - 1) & (_JOINTS < _PAIRS[:, 1:] - 1)
_BETWEEN = np.where(np.arange(TOGETHER)[:, None] == _HAND, 0.0, _BETWEEN)  # see `_HandRoom`


@dataclass(frozen=True, kw_only=True)
class Seen:
    """What is near what at B configurations.

    Attributes:
        row: (n,) index of the configuration at which two geoms are near each other.
        geoms: (n, 2) these two.
        kind: (n,) one of IGNORED, SELF, FREE.
        pair: (n,) row of `_PAIRS`, or `TOGETHER`.
        distance: (n,) between them [m].
        direction: (n, 3) along which they are that far apart, to the one that the hand carries
            or is.
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
    rows = np.full((GROUPS, GROUPS), TOGETHER, dtype=np.int8)
    one, other = _PAIRS.T
    rows[one, other] = rows[other, one] = np.arange(TOGETHER)
    return kind, np.where(kind == IGNORED, TOGETHER, rows[group[:, None], group])


@dataclass(frozen=True, kw_only=True)
class _HandRoom:
    """Room between the hand and what is fixed, by direction.

    Attributes:
        least: (B,) distance above what is required to the nearest thing [m].
        far: (B,) what is not near is farther than that above what is required [m].
        reach: (6, B) of the hand from the axes [m].
        screws: (B, 6, 6) of each joint in a column the direction of its axis and the velocity of
            the origin per radian.
        row: (n,) index of the configuration of each of the pairs that are near, ascending.
        begin: of each run of equal rows.
        excess: (n,) distance above what is required [m].
        wrench: (6, n) moment about the origin of the direction from what is fixed to the hand, at
            the middle of the hand's part, and the direction.
        size: (n,) of the hand's part around its middle [m].
    """

    least: Array
    far: Array
    reach: Array
    screws: Array
    row: NDArray[np.int64]
    begin: NDArray[np.int64]
    excess: Array
    wrench: Array
    size: Array

    def __call__(self, stretches: Stretches) -> Array:
        """Return the share (E, B) of stretches on which nothing fixed comes too near the hand.

        Two convex shapes that are d apart along n stay so until a point of the hand has moved by
        d against n. Let joint j travel t_j in all, r_j be the distance of the hand from axis j at
        most, and s = sum_j t_j r_j / (1 - sum_j t_j): no point of the hand moves by more than
        s, for until one has, each is no farther than r_j + s from axis j, and
        sum_j t_j (r_j + s) = s. Point p moves along n by the integral of sum_j g_j dq_j with
        g_j = n . (a_j x (p - o_j)). While joint j has travelled x_j, g_j has changed from what
        it was in the beginning by at most sum_(k >= j) x_k (r_k + s) by the motion of p in the
        frame of the axis, and by (r_j + s) sum_(k < j) x_k by the motion of the axis. Integrated
        by parts that is at most Q = sum_j t_j (t_j (r_j + s) / 2 + sum_(k > j) t_k (r_k + s)).
        What g_j was makes sum_j g_j dq_j, at most max(0, its value at the end) along a straight
        line, and no more than sum_j b_j r_j beside it on a line that leaves the straight one by
        b_j. For all points p of a ball with middle c and radius e it is at least its value at c
        less e |n x sum_j a_j dq_j|.
        """
        travel, reach = stretches.travel, self.reach[:, None]
        total, moved = travel.sum(axis=0), (travel * reach).sum(axis=0)
        nothing_near = self.far / np.maximum(moved + self.far * total, _LEAST)
        any_direction = self.least / np.maximum(moved + self.least * total, _LEAST)
        if len(self.row):
            most = np.minimum(moved / np.maximum(1.0 - total, _LEAST), self.far)
            parts = travel * (reach + most)
            beyond = parts.sum(axis=0) - parts.cumsum(axis=0) + parts / 2.0
            second = (travel * beyond + stretches.bend * reach).sum(axis=0)
            twist = (self.screws @ stretches.change.transpose(2, 0, 1)).transpose(1, 2, 0)
            turn = (twist[:3] * twist[:3]).sum(axis=0)
            twist = twist.take(self.row, axis=2)  # (6, E, n)
            away = (twist * self.wrench[:, None]).sum(axis=0)
            along = (twist[:3] * self.wrench[3:, None]).sum(axis=0)
            across = np.maximum(turn.take(self.row, axis=1) - along * along, 0.0)
            first = np.maximum(self.size * np.sqrt(across) - away, 0.0)
            second = second.take(self.row, axis=1)
            root = first + np.sqrt(first * first + 4.0 * self.excess * second)
            shares = 2.0 * self.excess / np.maximum(root, _LEAST * _LEAST)
            rows = self.row[self.begin]
            least = np.minimum.reduceat(shares, self.begin, axis=1)
            nothing_near[:, rows] = np.minimum(nothing_near[:, rows], least)
        return np.asarray(np.maximum(nothing_near, any_direction))


def room(seen: Seen, excess: Array, clearance: Array, *, within: bool = True) -> Room:
    """Return the room around configurations, for `advance`.

    While the joints j between two groups travel t_j, a point of the one further down the arm
    moves by at most sum_j t_j (r_j + room) relative to the other: r_j is its distance from
    axis j at the beginning, and until the room is used up it has come no farther.

    Args:
        seen: at B configurations.
        excess: (n,) distance above what is required of each pair that is near [m].
        clearance: (B,) required of those that are not near each other [m].
        within: whether distances within the robot count.
    """
    arms = seen.centers[:, 1:, None] - seen.anchor[:, None]  # (B, 6 groups, 6 joints, 3)
    along = np.einsum("bgjx,bjx->bgj", arms, seen.axis)
    squared = np.einsum("bgjx,bgjx->bgj", arms, arms)
    from_axis = np.sqrt(np.maximum(squared - along * along, 0.0))
    reach = from_axis + seen.radii[:, 1:, None]
    # What is not reported is farther than the margins; links are farther than their balls, too.
    least = np.empty((len(reach), TOGETHER + 1))
    least[:] = (NEAR - clearance)[:, None]
    between = seen.centers.take(_ONE, axis=1) - seen.centers.take(_OTHER, axis=1)
    gaps = np.sqrt(np.einsum("bpx,bpx->bp", between, between))
    gaps -= seen.radii.take(_ONE, axis=1) + seen.radii.take(_OTHER, axis=1)
    gaps -= np.maximum(clearance, SELF_CLEARANCE)[:, None]
    least[:, WITHIN:TOGETHER] = np.maximum(NEAR_SELF - SELF_CLEARANCE, gaps)
    np.minimum.at(least, (seen.row, seen.pair), excess)
    rows = (reach.take(_FURTHER, axis=1) / least[:, :-1, None] + 1.0) * _BETWEEN
    if not within:
        rows = rows[:, :WITHIN]
    hand = _hand(seen, excess, least[:, _HAND], reach[:, HAND - 2], NEAR - clearance)

    def share(stretches: Stretches) -> Array:
        used = rows @ stretches.travel.transpose(2, 0, 1)
        most = np.ascontiguousarray(used.transpose(1, 2, 0)).max(axis=0)
        return np.asarray(np.minimum(1.0 / np.maximum(most, _LEAST), hand(stretches)))

    return share


def _hand(seen: Seen, excess: Array, least: Array, reach: Array, far: Array) -> _HandRoom:
    """Return the room between the hand and what is fixed; excess as for `room`."""
    near = (seen.pair == _HAND).nonzero()[0]
    near = near[seen.row[near].argsort(kind="stable")]
    row = seen.row[near]
    begins = np.ones(len(row), dtype=bool)
    np.not_equal(row[1:], row[:-1], out=begins[1:])
    direction = seen.direction[near].T
    anchor, axis = (x.transpose(2, 0, 1) for x in (seen.anchor, seen.axis))
    return _HandRoom(
        least=least,
        far=far,
        reach=np.ascontiguousarray(reach.T),
        screws=np.concatenate([axis, _cross(anchor, axis)]).transpose(1, 0, 2),
        row=row,
        begin=begins.nonzero()[0],
        excess=np.maximum(excess[near], _LEAST),  # what is too near does not count
        wrench=np.concatenate([_cross(seen.spot[near].T, direction), direction]),
        size=seen.size[near],
    )


def _cross(one: Array, other: Array) -> Array:
    """Return the cross products (3, ...) of vectors (3, ...)."""
    x, y, z = one
    a, b, c = other
    return np.array([y * c - z * b, z * a - x * c, x * b - y * a])
