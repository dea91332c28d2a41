"""Target and place volume -> tool poses of one pick and place: pure geometry in the base frame."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from kr210_sim.arrays import Array

APPROACH_DISTANCE = 0.20
"""From pre-grasp to grasp, straight along the tool [m]; as in the original course."""

LIFT_HEIGHT = 0.03
"""Straight up from the supporting surface before the tool withdraws [m]."""

WITHDRAW_DISTANCE = 0.25
"""Straight back out of the cell after the lift [m]."""

APPROACH_YAWS = np.radians([0.0, 10.0, -10.0, 20.0, -20.0])
"""Directions of the tool about the target's axis, from the cell's +x [rad]: the target is round."""

PLACE_YAWS = np.radians([0.0, 30.0, -30.0, 60.0, -60.0, 90.0, -90.0, 180.0])
"""Turns of the downward tool about the vertical, from the arm's own plane [rad]."""

PLACE_DEPTHS = (0.35, 0.25, 0.15, 0.05, -0.05, -0.20)
"""Release heights to try, as depth of the TCP below the top of the place volume [m]."""

LOWER_MARGIN = 0.12
"""The straight way down starts at least this far above the top of the place volume [m]."""

WALL_MARGIN = 0.05
"""Kept between a lying target and the side of the place volume [m]."""

_GOLDEN_ANGLE = np.pi * (3.0 - np.sqrt(5.0))
_SPREAD_POINTS = 24


@dataclass(frozen=True, kw_only=True)
class PickPoses:
    """TCP poses (4, 4) of one way to take a target, in the base frame."""

    pre_grasp: Array
    grasp: Array
    lift: Array
    withdraw: Array


@dataclass(frozen=True, kw_only=True)
class PlacePoses:
    """TCP poses (4, 4) of one way to release a target, in the base frame."""

    pre_place: Array
    place: Array


def standing(T_base_seen: Array, T_base_cell: Array, length: float) -> Array:
    """Return the pose (4, 4) of a target that was seen about there and stands in its cell.

    A camera errs in tilt and height as well; but the cell's surface is known, and what stands on it
    stands upright. Only the place on the surface and the turn about the vertical are as seen.

    Args:
        T_base_seen: (4, 4), origin in the middle of the target, z along its axis.
        T_base_cell: (4, 4), +z up, origin on the surface.
        length: of the target [m].
    """
    up, p_cell = T_base_cell[:3, 2], T_base_cell[:3, 3]
    x = T_base_seen[:3, 0] - up * (up @ T_base_seen[:3, 0])
    height = up @ (T_base_seen[:3, 3] - p_cell)
    p_base = T_base_seen[:3, 3] + up * (length / 2 - height)
    return _frame(x / np.linalg.norm(x), up, p_base)


def pick_options(T_base_target: Array, T_base_cell: Array) -> list[PickPoses]:
    """Return the ways to take a target, the cell's own direction first.

    The TCP goes to the middle of the target with the tool's z axis along the target's axis, so
    that the jaws close on it evenly.

    Args:
        T_base_target: (4, 4), origin in its middle, z along the axis.
        T_base_cell: (4, 4), +x the direction in which the tool goes in.
    """
    z = T_base_target[:3, 2]
    forward = T_base_cell[:3, 0] - z * (z @ T_base_cell[:3, 0])
    forward /= np.linalg.norm(forward)
    side = np.cross(z, forward)
    options = []
    for yaw in APPROACH_YAWS:
        x = np.cos(yaw) * forward + np.sin(yaw) * side
        grasp = _frame(x, z, T_base_target[:3, 3])
        lift = _moved(grasp, LIFT_HEIGHT * T_base_cell[:3, 2])
        options.append(
            PickPoses(
                pre_grasp=_moved(grasp, -APPROACH_DISTANCE * x),
                grasp=grasp,
                lift=lift,
                withdraw=_moved(lift, -WITHDRAW_DISTANCE * x),
            )
        )
    return options


def release_point(
    T_base_place: Array, half_size: Array, kind: str, length: float, taken: Sequence[Array]
) -> Array:
    """Choose where to drop: the point of a spread over the volume farthest from what lies there.

    Ten upright drops on one spot build a tower that falls out of the bin; spread drops do not.

    Args:
        T_base_place: (4, 4) pose of the place volume's centre.
        half_size: (3,) its half extents [m].
        kind: "box" or "cylinder".
        length: of the target [m], which will lie.
        taken: positions (3,) of targets in the volume, base frame.

    Returns:
        (3,) point at the top of the volume, base frame [m].
    """
    reach = np.maximum(half_size[:2] - length / 2 - WALL_MARGIN, 0.0)
    k = np.arange(_SPREAD_POINTS)
    radius, angle = np.sqrt(k / _SPREAD_POINTS), k * _GOLDEN_ANGLE
    disc = np.stack([radius * np.cos(angle), radius * np.sin(angle)], axis=1)
    if kind == "box":  # stretch the disc onto the square
        disc = disc * (np.hypot(*disc.T) / np.maximum(np.max(np.abs(disc), axis=1), 1e-9))[:, None]
    local = np.column_stack([disc * reach, np.full(_SPREAD_POINTS, half_size[2])])
    points = local @ T_base_place[:3, :3].T + T_base_place[:3, 3]
    if not taken:
        return np.array(points[0])
    gaps = np.linalg.norm(points[:, None, :2] - np.array(taken)[None, :, :2], axis=2)
    return np.array(points[np.argmax(np.min(gaps, axis=1).round(6))])


def place_options(p_base_release: Array) -> Iterator[list[PlacePoses]]:
    """Yield, lowest release first, the ways to release a target with the tool pointing down.

    Args:
        p_base_release: (3,) point at the top of the place volume, from `release_point`.
    """
    azimuth = np.arctan2(p_base_release[1], p_base_release[0])
    down = np.array([0.0, 0.0, -1.0])
    for depth in PLACE_DEPTHS:
        options = []
        for yaw in PLACE_YAWS:
            along = np.array([np.cos(azimuth + yaw), np.sin(azimuth + yaw), 0.0])
            place = _frame(down, along, p_base_release + depth * down)
            pre_place = place.copy()
            pre_place[2, 3] = p_base_release[2] + LOWER_MARGIN + max(0.0, -depth)
            options.append(PlacePoses(pre_place=pre_place, place=place))
        yield options


@dataclass(frozen=True, kw_only=True)
class Polylines:
    """Poses along K polylines of straight lines, each of one orientation.

    Attributes:
        poses: (P, 4, 4) of all of them, one polyline after the other.
        knots: (K, C) index of each corner within the P.
    """

    poses: Array
    knots: NDArray[np.int64]

    def aligned(self, anchor: int) -> tuple[NDArray[np.int64], int]:
        """Return indices (N, K) of the poses, side by side so that one of the corners is level.

        Ends are repeated where a polyline is shorter than others.

        Args:
            anchor: the corner.

        Returns:
            The indices, and in which of the N rows that corner is.
        """
        level = self.knots[:, anchor]
        before = int(np.max(level - self.knots[:, 0]))
        after = int(np.max(self.knots[:, -1] - level))
        rows = np.arange(-before, after + 1)[:, None] + level
        return np.clip(rows, self.knots[:, 0], self.knots[:, -1]), before


def polylines(corners: Array, step: float) -> Polylines:
    """Return poses along polylines.

    Args:
        corners: (K, C, 4, 4), those of a polyline of the same orientation.
        step: largest distance between neighbours [m]; a line has at least 8 poses.
    """
    p_start = corners[:, :-1, :3, 3]
    way = corners[:, 1:, :3, 3] - p_start
    distance = np.sqrt(np.vecdot(way, way))
    steps = np.maximum(7, np.ceil(distance / step).astype(np.int64))  # (K, C - 1) of each line
    apart = np.ones(corners.shape[:2], dtype=np.int64)  # from the corner before
    apart[0, 0], apart[:, 1:] = 0, steps
    knots = np.cumsum(apart).reshape(apart.shape)
    # A corner belongs to the line that ends there, only the first to the line that begins there.
    own = steps.copy()
    own[:, 0] += 1
    line_of = np.repeat(np.arange(steps.size), own.ravel())
    number = np.arange(len(line_of)) - knots[:, :-1].ravel()[line_of]
    size = steps.ravel()[line_of]
    share = np.where(number == size, 1.0, number * (1.0 / size))
    poses = np.repeat(corners[:, 0], np.sum(own, axis=1), axis=0)
    poses[:, :3, 3] = p_start.reshape(-1, 3)[line_of] + share[:, None] * way.reshape(-1, 3)[line_of]
    return Polylines(poses=poses, knots=knots)


def line(T_start: Array, T_end: Array, step: float) -> Array:
    """Return poses (N, 4, 4) along a straight line of constant orientation.

    Args:
        T_start: (4, 4) first pose.
        T_end: (4, 4) last pose, of the same orientation.
        step: largest distance between neighbours [m]; N is at least 8.
    """
    return polylines(np.array([[T_start, T_end]]), step).poses


def _frame(x: Array, z: Array, origin: Array) -> Array:
    """Return the pose with these x and z axes (unit, perpendicular)."""
    (a, b, c), (d, e, f) = z.tolist(), x.tolist()
    y = (b * f - c * e, c * d - a * f, a * e - b * d)  # z cross x, quicker than in NumPy
    T = np.eye(4)
    T[:3, 0], T[:3, 1], T[:3, 2], T[:3, 3] = x, y, z, origin
    return T


def _moved(T: Array, offset: Array) -> Array:
    moved = T.copy()
    moved[:3, 3] += offset
    return moved
