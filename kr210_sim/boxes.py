"""Distances between boxes, which MuJoCo's contact function for boxes gets wrong when apart."""

from __future__ import annotations

import mujoco
import numpy as np
from numpy.typing import NDArray

from kr210_sim.arrays import Array

_BOX = int(mujoco.mjtGeom.mjGEOM_BOX)
_WORTHWHILE = 0.05
"""A lower bound this much above what is required is as good as the distance [m]."""


FAR = 0.2
"""Bounds larger than this need not be tight [m]."""


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
        self, model: mujoco.MjModel, data: mujoco.MjData, group: NDArray[np.int64]
    ) -> None:
        """Find the pairs.

        Args:
            model: the world.
            data: its state, from which the poses of what is fixed are taken.
            group: (ngeom,) 0 what is fixed, else the number of joints before it, plus 1.
        """
        self._model, self._data = model, data
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
        self._rotation = np.moveaxis(rotation, 1, 0)
        self._offset = np.einsum("fi,fij->fj", data.geom_xpos[self._fixed], rotation)
        self._half = model.geom_size[self._fixed]
        self._radius = model.geom_rbound[self._moving][:, None]
        # Fixed boxes by body: most bodies are far away, and so are then all their boxes.
        body = model.geom_bodyid[self._fixed]
        self._bodies = [np.flatnonzero(body == number) for number in np.unique(body)]
        reach = np.einsum("fij,fj->fi", np.abs(rotation), self._half)
        lower, upper = (data.geom_xpos[self._fixed] + sign * reach for sign in (-1, 1))
        self._lower = np.array([np.min(lower[boxes], axis=0) for boxes in self._bodies])
        self._upper = np.array([np.max(upper[boxes], axis=0) for boxes in self._bodies])

    def bounds(self, position: Array) -> Array:
        """Return lower bounds (B, P) of the distances [m], inf for pairs that do not count.

        Args:
            position: (B, ngeom, 3) of the geoms [m].
        """
        center = position[:, self._moving]
        fixed = np.empty((*center.shape[:2], len(self._fixed)))
        for boxes, lower, upper in zip(self._bodies, self._lower, self._upper, strict=True):
            found = _length(np.maximum(np.maximum(lower - center, center - upper), 0.0))
            fixed[:, :, boxes] = (found - self._radius[:, 0])[:, :, None]
            if np.min(fixed[:, :, boxes[0]]) < FAR:
                local = center @ self._rotation[:, boxes].reshape(3, -1)
                local = local.reshape(*center.shape[:2], -1, 3)
                outside = np.abs(local - self._offset[boxes]) - self._half[boxes]
                fixed[:, :, boxes] = _length(np.maximum(outside, 0.0)) - self._radius
        one, other = self.geoms[self._count :].T
        radii = self._model.geom_rbound[one] + self._model.geom_rbound[other]
        links = _length(position[:, one] - position[:, other]) - radii
        found = np.concatenate([fixed.reshape(len(position), -1), links], axis=1)
        return np.where(self._asked, found, np.inf)

    def sharpen(self, bounds: Array, required: Array) -> None:
        """Replace lower bounds (P,) that are not far above what is required by the distances.

        Args:
            bounds: of the configuration that `data` is in; changed in place [m].
            required: (P,) of each pair [m].
        """
        model, data = self._model, self._data
        for pair in np.flatnonzero(bounds < required + _WORTHWHILE):
            one, other = self.geoms[pair].tolist()
            bounds[pair] = mujoco.mj_geomDistance(model, data, one, other, 1.0, None)


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
