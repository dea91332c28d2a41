"""Joint axes -> how the links move, for many configurations at once."""

from __future__ import annotations

import numpy as np

from kr210_sim.arrays import Array

_STILL = np.eye(4)


class Chain:
    """Revolute joints one after the other, by the product of exponentials.

    How link j has moved from where it is at q = 0 is exp(S_1 q_1) ... exp(S_j q_j), with the screws
    S of the joint axes there (Lynch and Park, Modern Robotics, 2017, section 4.1.2). With the
    axis a through o, K = [a], each is R = I + sin q K + (1 - cos q) K K with translation o - R o.

    Args:
        anchor: (n, 3) a point of each joint axis at q = 0 [m].
        axis: (n, 3) unit direction of each, same frame.
    """

    def __init__(self, anchor: Array, axis: Array) -> None:
        self._count = len(axis)
        self._axes = np.zeros((len(axis), 4, 2))  # anchor and axis, side by side
        self._axes[:, :3, 0], self._axes[:, 3, 0], self._axes[:, :3, 1] = anchor, 1.0, axis
        cross = np.zeros((len(axis), 3, 3))
        for (row, column), left in {(1, 0): 2, (0, 2): 1, (2, 1): 0}.items():
            cross[:, row, column], cross[:, column, row] = axis[:, left], -axis[:, left]
        self._sine, self._versine = (np.zeros((len(axis), 4, 4)) for _ in range(2))
        for term, factor in ((self._sine, cross), (self._versine, cross @ cross)):
            term[:, :3, :3], term[:, :3, 3:] = factor, -factor @ anchor[..., None]

    def moved(self, q: Array) -> Array:
        """Return how base and links have moved (B, n + 1, 4, 4) at configurations (B, n)."""
        sine, versine = np.sin(q)[..., None, None], 1.0 - np.cos(q)[..., None, None]
        turns = _STILL + sine * self._sine + versine * self._versine
        moved = np.empty((len(q), self._count + 1, 4, 4))
        moved[:, 0] = _STILL
        for joint in range(self._count):
            np.matmul(moved[:, joint], turns[:, joint], out=moved[:, joint + 1])
        return moved

    def axes(self, moved: Array) -> tuple[Array, Array]:
        """Return a point [m] and the direction of each axis, (B, n, 3) each, by `moved`."""
        axes = moved[:, :-1] @ self._axes
        return axes[:, :, :3, 0], axes[:, :, :3, 1]
