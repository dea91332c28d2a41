"""Distances between geoms: lower bounds for all that are near, exact ones where they count."""

from __future__ import annotations

from typing import TypeAlias

import mujoco
import numpy as np
from numpy.typing import NDArray

from kr210_sim.arrays import Array

_DEEP = 1e6  # how far a plane reaches down and sideways [m]
Bounds: TypeAlias = tuple[NDArray[np.int64], NDArray[np.int64], Array, Array]
"""Rows of configurations (n,), pairs (n,) by their row in `geoms`, lower bounds (n,) [m], and
directions (n, 3) from the second to the first, along which they are that far apart."""


class GeomPairs:
    """The pairs of geoms that can come near each other, and how far apart they are at least.

    mj_collision reports what is within a margin, but leaves out some pairs of boxes, and its
    distances between boxes may be too large by centimetres; mj_geomDistance is right for all. It
    is asked for the few pairs that are near by a lower bound: the distance between boxes along the
    axes of the world, first around whole parts of what moves, then around single geoms.

    Attributes:
        geoms: (P, 2) the pairs.
        moving: (M,) the solid geoms that move, by their parts.
    """

    def __init__(
        self, model: mujoco.MjModel, data: mujoco.MjData, part: NDArray[np.int64], far: Array
    ) -> None:
        """Find the pairs.

        Args:
            model: the world.
            data: its state, from which all poses are taken; which poses are written to later.
            part: (ngeom,) 0 what is fixed, else the number of the moving part.
            far: (G, G) by two such numbers: pairs further apart do not count [m].
        """
        self._model, self._data = model, data
        solid = (model.geom_contype != 0) | (model.geom_conaffinity != 0)
        moving, fixed = np.flatnonzero(solid & (part > 0)), np.flatnonzero(solid & (part == 0))
        self.moving = self._moving = moving = moving[np.argsort(part[moving], kind="stable")]
        names = np.flatnonzero(np.bincount(part[moving]))
        own, parts = np.searchsorted(names, part[moving]), len(names)
        self._begin = np.searchsorted(own, np.arange(parts))
        middle, half = model.geom_aabb[:, :3].copy(), model.geom_aabb[:, 3:].copy()
        plane = model.geom_type == int(
            mujoco.mjtGeom.mjGEOM_PLANE
        )  # comparing with the enum is slow
        middle[plane], half[plane] = [0.0, 0.0, -_DEEP], _DEEP
        rotation = data.geom_xmat.reshape(-1, 3, 3)
        center = data.geom_xpos + (rotation @ middle[..., None])[..., 0]
        size = (np.abs(rotation) @ half[..., None])[..., 0]
        self._fixed = np.concatenate([center - size, -center - size], axis=1)[fixed].T[:, None]
        # Of each moving geom the axes, the middle of its box, and its position: (4, 5) each.
        frames = np.zeros((4, len(moving), 5))
        frames[:3, :, :3], frames[:3, :, 3] = rotation[moving].swapaxes(0, 1), center[moving].T
        frames[:3, :, 4], frames[3, :, 3:] = data.geom_xpos[moving].T, 1.0
        ends = [*self._begin[1:].tolist(), len(moving)]
        self._frames = [
            (number, frames[:, first:end].reshape(4, -1))
            for number, first, end in zip(
                (names - 1).tolist(), self._begin.tolist(), ends, strict=True
            )
        ]
        self._half = half[moving].T[:, None]
        self._index = np.zeros(model.ngeom, dtype=np.int64)
        self._index[moving] = np.arange(len(moving))
        # Pairs come in bundles: each part with each fixed geom, then the parts with one another.
        self._one, self._other = np.nonzero(np.arange(parts)[:, None] < np.arange(parts))
        number = np.zeros((parts, parts + len(fixed)), dtype=np.int64)
        number[self._one, self._other] = parts * len(fixed) + np.arange(len(self._one))
        number[:, parts:] = np.arange(parts * len(fixed)).reshape(parts, -1)
        geoms = np.append(moving, fixed)
        owner = np.append(own, parts + np.arange(len(fixed)))
        pairs = np.argwhere((own[:, None] < owner) & _may_collide(model, moving, geoms))
        bundle = number[*owner[pairs].T]
        order = np.argsort(bundle, kind="stable")
        self._pairs, bundle = pairs[order].T, bundle[order]
        self.geoms = geoms[self._pairs.T]
        self._far_squared, self._farthest = far[*part[self.geoms.T]] ** 2, float(np.max(far))
        self._far_fixed, self._far_parts = far[names, 0], far[names[self._one], names[self._other]]
        self._count = np.bincount(bundle, minlength=parts * len(fixed) + len(self._one))
        self._first = np.cumsum(self._count) - self._count
        self._with_fixed = self._count[: parts * len(fixed)].reshape(parts, -1) > 0
        self._with_part = self._count[parts * len(fixed) :] > 0

    def posed(self, moved: Array) -> Array:
        """Return where the moving geoms are (B, 3, M, 5): axes, middle of the box, position.

        Args:
            moved: (B, G, 4, 4) how each part has moved since the beginning, by its number less 1.
        """
        moved = moved[:, :, :3]
        geoms = [moved[:, number] @ frames for number, frames in self._frames]
        return np.concatenate(geoms, axis=2).reshape(len(moved), 3, -1, 5)

    def positions(self, posed: Array, row: NDArray[np.int64], geom: NDArray[np.int64]) -> Array:
        """Return positions (n, 3) of moving geoms (n,) in rows (n,) of `posed`."""
        return posed[row, :, self._index[geom], 4]

    def bounds(self, posed: Array) -> Bounds:
        """Return lower bounds of the distances of the pairs for which they are less than `far`.

        Args:
            posed: (B, 3, M, 5), by `posed`.
        """
        x, y, z, center, _ = posed.transpose(3, 1, 0, 2)
        size = np.abs(x) * self._half[0] + np.abs(y) * self._half[1] + np.abs(z) * self._half[2]
        moving = np.concatenate([center - size, -center - size])
        parts = np.minimum.reduceat(moving, self._begin, axis=2)
        wide = (parts - self._far_fixed)[..., None]
        row, part, box = (_meet(wide, self._fixed[:, :, None]) & self._with_fixed).nonzero()
        wide = parts[:, :, self._one] - self._far_parts
        at, both = (_meet(wide, parts[:, :, self._other]) & self._with_part).nonzero()
        bundle = np.concatenate([part * self._fixed.shape[2] + box, self._with_fixed.size + both])
        count = self._count[bundle]
        row = np.concatenate([row, at]).repeat(count)
        pair = (self._first[bundle] - count.cumsum() + count).repeat(count)
        pair += np.arange(len(pair))
        boxes = np.empty((6, len(posed), moving.shape[2] + self._fixed.shape[2]))
        boxes[:, :, : moving.shape[2]], boxes[:, :, moving.shape[2] :] = moving, self._fixed
        at_row, boxes = row * boxes.shape[2], boxes.reshape(6, -1)
        one, other = (boxes.take(geom.take(pair) + at_row, axis=1) for geom in self._pairs)
        above, below = one[:3] + other[3:], one[3:] + other[:3]  # along each axis of the world
        aside = np.maximum(np.maximum(above, below), 0.0)
        squared = (aside * aside).sum(axis=0)
        keep = (squared < self._far_squared.take(pair)).nonzero()[0]
        distance = np.sqrt(squared.take(keep))
        aside = np.copysign(aside, above - below).take(keep, axis=1)
        direction = (aside / np.maximum(distance, 1e-12)).T
        # Geoms in boxes that overlap may be deep in each other.
        bound = np.where(distance > 0.0, distance, -np.inf)
        return row.take(keep), pair.take(keep), bound, direction

    def sharpen(self, found: Bounds, limit: Array, posed: Array) -> None:
        """Replace lower bounds by distances where they are less than a limit, in place.

        Args:
            found: by `bounds`.
            limit: (n,) for each of these pairs [m].
            posed: (B, 3, M, 5), by `posed`.
        """
        rows, pairs, bounds, directions = found
        asked = (bounds < limit).nonzero()[0]
        asked = asked[rows[asked].argsort(kind="stable")]
        geoms = self.geoms[pairs[asked]].tolist()
        ends = np.zeros((len(asked), 6))
        model, data, distance, row = self._model, self._data, mujoco.mj_geomDistance, -1
        axes = posed[..., :3].transpose(0, 2, 1, 3).reshape(len(posed), -1, 9)
        positions = posed[..., 4].swapaxes(1, 2)
        exact = []
        for now, (one, other), points in zip(rows[asked].tolist(), geoms, ends, strict=True):
            if now != row:
                row = now
                data.geom_xpos[self._moving] = positions[now]
                data.geom_xmat[self._moving] = axes[now]
            exact.append(distance(model, data, one, other, self._farthest, points))
        bounds[asked] = apart = np.array(exact)
        apart = np.where(np.abs(apart) > 1e-12, apart, 1e-12)  # negative where they overlap
        directions[asked] = (ends[:, :3] - ends[:, 3:]) / apart[:, None]


def _meet(wide: Array, other: Array) -> NDArray[np.bool_]:
    """Return whether boxes (6, ...) of `_boxes`, one of them widened, overlap along each axis."""
    beyond = -other
    meets = wide[0] < beyond[3]
    for end in range(1, 6):
        meets &= wide[end] < beyond[(end + 3) % 6]
    return np.asarray(meets)


def _may_collide(
    model: mujoco.MjModel, one: NDArray[np.int64], other: NDArray[np.int64]
) -> NDArray[np.bool_]:
    """Return which pairs (n, m) of geoms (n,) and (m,) MuJoCo does not filter out."""
    # Of bodies first: those that are welded together, neighbours, and named exceptions.
    weld = model.body_weldid
    parent, moves = weld[model.body_parentid[weld]], weld != 0
    neighbours = (parent[:, None] == weld) & moves
    counts = (weld[:, None] != weld) & ~neighbours & ~neighbours.T
    first, second = np.divmod(model.exclude_signature, 1 << 16)
    counts[first, second] = counts[second, first] = False
    types, affinities, body = model.geom_contype, model.geom_conaffinity, model.geom_bodyid
    meant = (types[one, None] & affinities[other]) | (types[other] & affinities[one, None])
    return np.asarray(counts[body[one, None], body[other]] & (meant != 0))
