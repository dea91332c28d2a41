"""Distances between boxes, which MuJoCo's contact function for boxes gets wrong when apart."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TypeAlias

import mujoco
import numpy as np
from numpy.typing import NDArray

from kr210_sim.arrays import Array

_BOX = int(mujoco.mjtGeom.mjGEOM_BOX)
_ALONG = 1e-6  # largest cosine between axes that count as at right angles
_WORTHWHILE = 0.05
"""A lower bound this much above what is required is as good as the distance [m]."""
Bounds: TypeAlias = tuple[NDArray[np.int64], NDArray[np.int64], Array]
"""Rows of configurations (n,), pairs (n,) by their row in `geoms`, lower bounds (n,) [m]."""


class BoxPairs:
    """The pairs of boxes that can come near each other: a link's and a fixed one, or two links'.

    mj_collision does not report every pair of boxes within the margin, and its distances may be too
    large by centimetres; mj_geomDistance is right for them. It is asked for the few pairs that are
    near by a lower bound: the ball around the one, the exact shape of the other if that is fixed.

    Attributes:
        is_box: (ngeom,) whether a geom is among them, so that its contacts with others are not
            to be believed.
        geoms: (P, 2) the pairs.
    """

    def __init__(
        self, model: mujoco.MjModel, data: mujoco.MjData, group: NDArray[np.int64], far: float
    ) -> None:
        """Find the pairs.

        Args:
            model: the world.
            data: its state, from which the poses of what is fixed are taken.
            group: (ngeom,) 0 what is fixed, else the number of joints before it, plus 1.
            far: pairs further apart do not count [m].
        """
        self._model, self._far = model, far
        self.is_box = model.geom_type == _BOX
        solid = self.is_box & ((model.geom_contype != 0) | (model.geom_conaffinity != 0))
        self._moving, self._fixed = (
            np.flatnonzero(solid & (group > 0)),
            np.flatnonzero(solid & (group == 0)),
        )
        m, f = (x.ravel() for x in np.meshgrid(self._moving, self._fixed, indexing="ij"))
        with_fixed = np.stack([m, f], axis=1)
        one, other = np.triu_indices(len(self._moving), 1)
        links = np.stack([self._moving[one], self._moving[other]], axis=1)
        links = links[group[links[:, 0]] != group[links[:, 1]]]
        self._count = len(with_fixed)
        self._asked = np.concatenate([_may_collide(model, with_fixed), _may_collide(model, links)])
        self.geoms = np.concatenate([with_fixed, links])
        rotation = data.geom_xmat[self._fixed].reshape(-1, 3, 3)
        center = data.geom_xpos[self._fixed]
        reach = np.einsum("fij,fj->fi", np.abs(rotation), model.geom_size[self._fixed])
        self._center, self._reach = center.T, reach.T
        # Most bodies are far from most links, and so are then all their boxes.
        body = model.geom_bodyid[self._fixed]
        alike = [body == number for number in np.unique(body)]
        self._lower, self._upper = (
            np.array([choose((center + sign * reach)[b], axis=0) for b in alike]).reshape(-1, 3)
            for choose, sign in ((np.min, -1), (np.max, 1))
        )
        # Those that are not along the axes of the world are smaller than the boxes around them.
        self._turned = np.max(np.sort(np.abs(rotation), axis=2)[:, :, 1], axis=1) > _ALONG
        self._rotation, self._half = rotation, model.geom_size[self._fixed]
        self._radius = model.geom_rbound[self._moving]
        self._radii = np.sum(model.geom_rbound[self.geoms[self._count :]], axis=1)

    def bounds(self, position: Array) -> Bounds:
        """Return lower bounds of the distances of the pairs for which they are less than `far`.

        Args:
            position: (B, ngeom, 3) of the geoms [m].
        """
        row, pair, found = self._from_fixed(position[:, self._moving])
        one, other = self.geoms[self._count :].T
        links = _length(position[:, one] - position[:, other]) - self._radii
        at, link = np.nonzero((links < self._far) & self._asked[self._count :])
        return (
            np.concatenate([row, at]),
            np.concatenate([pair, self._count + link]),
            np.concatenate([found, links[at, link]]),
        )

    def _from_fixed(self, center: Array) -> Bounds:
        """Return the bounds for balls around the moving boxes (B, M, 3) and the fixed ones."""
        aside = np.maximum(self._lower - center[:, :, None], center[:, :, None] - self._upper)
        near = _length(np.maximum(aside, 0.0)) - self._radius[:, None] < self._far
        row, ball = np.nonzero(np.any(near, axis=2))
        squared = np.zeros((len(row), len(self._fixed)))
        for axis in range(3):
            aside = np.abs(center[row, ball, axis, None] - self._center[axis])
            aside -= self._reach[axis]
            np.maximum(aside, 0.0, out=aside)
            squared += np.multiply(aside, aside, out=aside)
        index, box = np.nonzero(squared < ((self._far + self._radius) ** 2)[ball, None])
        found = np.sqrt(squared[index, box])
        row, ball = row[index], ball[index]
        turned = np.flatnonzero(self._turned[box])
        aside = center[row[turned], ball[turned]] - self._center.T[box[turned]]
        local = np.abs(np.einsum("ni,nij->nj", aside, self._rotation[box[turned]]))
        found[turned] = _length(np.maximum(local - self._half[box[turned]], 0.0))
        pair, found = ball * len(self._fixed) + box, found - self._radius[ball]
        keep = self._asked[pair] & (found < self._far)
        return row[keep], pair[keep], found[keep]

    def sharpen(
        self, found: Bounds, required: Array, data: mujoco.MjData, poses: Sequence[Array]
    ) -> None:
        """Replace lower bounds that are not far above what is required by the distances, in place.

        Args:
            found: by `bounds`.
            required: (n,) of each of these pairs [m].
            data: which poses are written to.
            poses: position (B, ngeom, 3) [m] and rotation (B, ngeom, 9) of the geoms.
        """
        rows, pairs, bounds = found
        asked = np.flatnonzero(bounds < required + _WORTHWHILE)
        asked = asked[np.argsort(rows[asked], kind="stable")]
        geoms = self.geoms[pairs[asked]].tolist()
        posed = -1
        for index, row, (one, other) in zip(asked, rows[asked].tolist(), geoms, strict=True):
            if row != posed:
                data.geom_xpos[:], data.geom_xmat[:] = poses[0][row], poses[1][row]
                posed = row
            bounds[index] = mujoco.mj_geomDistance(self._model, data, one, other, 1.0, None)


def _length(x: Array) -> Array:
    """Return the lengths (...) of vectors (..., 3)."""
    x = x * x
    return np.asarray(np.sqrt(x[..., 0] + x[..., 1] + x[..., 2]))


def _may_collide(model: mujoco.MjModel, pairs: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Return which pairs of geoms (P, 2) MuJoCo does not filter out."""
    one, other = pairs.T
    meant = (model.geom_contype[one] & model.geom_conaffinity[other]) != 0
    meant |= (model.geom_contype[other] & model.geom_conaffinity[one]) != 0
    weld = model.body_weldid
    a, b = weld[model.geom_bodyid[one]], weld[model.geom_bodyid[other]]
    parent_a, parent_b = weld[model.body_parentid[a]], weld[model.body_parentid[b]]
    adjacent = ((parent_a == b) & (b != 0)) | ((parent_b == a) & (a != 0))
    first, second = model.geom_bodyid[one], model.geom_bodyid[other]
    signature = np.minimum(first, second) << 16 | np.maximum(first, second)
    counts = meant & (a != b) & ~adjacent & ~np.isin(signature, model.exclude_signature)
    return np.asarray(counts)
