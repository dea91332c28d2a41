"""The branches of the inverse kinematics as see-through arms: which meshes go where."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from kr210_sim.arrays import Array
from kr210_sim.viewers.arm_state import ArmState
from kr210_sim.viewers.puppet import Puppet

COLORS = (
    (0.12, 0.47, 0.71),
    (0.09, 0.75, 0.81),
    (0.17, 0.63, 0.17),
    (0.74, 0.74, 0.13),
    (0.58, 0.40, 0.74),
    (0.89, 0.47, 0.76),
    (0.55, 0.34, 0.29),
    (0.84, 0.15, 0.16),
)
"""One colour (3,) per branch, 0 to 1, in the fixed order of `ik.inverse`."""

WITHIN, BEYOND = 0.45, 0.18
"""Opacity of a ghost whose branch is within the joint limits, and of one that is not."""

_SAME_PLACE, _SAME_TURN = 1e-6, 1e-9
"""Bodies nearer than this [m], and with a quaternion product as near to 1, coincide."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Ghosts:
    """The ghosts of an arm that are seen, at most eight.

    Attributes:
        branches: (n,) indices of their branches.
        positions: (n, nbody, 3) of the bodies [m], world frame.
        quats_wxyz: (n, nbody, 4).
        seen: (n, nbody) whether a body is drawn: not where the arm's own or an earlier ghost's is.
        colors: (n, 3), 0 to 1.
        opacities: (n,).
    """

    branches: NDArray[np.int64]
    positions: Array
    quats_wxyz: Array
    seen: NDArray[np.bool_]
    colors: Array
    opacities: Array


def place_ghosts(puppet: Puppet, state: ArmState, *, beyond: bool = True) -> Ghosts:
    """Pose the ghosts of all branches but the one that the arm is in.

    Args:
        puppet: of the model; it is left in the last ghost's pose.
        state: the arm.
        beyond: show the branches beyond the limits, too.
    """
    found = [
        (index, branch.q)
        for index, branch in enumerate(state.branches)
        if branch.q is not None and not branch.current and (beyond or branch.within_limits)
    ]
    indices = [index for index, _ in found]
    placed = [puppet.place_robot(q) for q in (state.q, *(q for _, q in found))]
    positions, quats = np.array([p for p, _ in placed]), np.array([q for _, q in placed])
    return Ghosts(
        branches=np.array(indices, dtype=np.int64),
        positions=positions[1:],
        quats_wxyz=quats[1:],
        seen=~_repeated(positions, quats)[1:],
        colors=np.array(COLORS)[indices],
        opacities=np.where([state.branches[i].within_limits for i in indices], WITHIN, BEYOND),
    )


def _repeated(positions: Array, quats_wxyz: Array) -> NDArray[np.bool_]:
    """Return which bodies (n, nbody) are where those of an earlier pose are."""
    near = np.linalg.norm(positions[:, None] - positions[None], axis=-1) < _SAME_PLACE
    alike = np.abs(np.einsum("ibk,jbk->ijb", quats_wxyz, quats_wxyz)) > 1.0 - _SAME_TURN
    earlier = np.tri(len(positions), k=-1, dtype=bool)[:, :, None]
    return np.asarray((near & alike & earlier).any(axis=1))


def css(color: Sequence[float]) -> str:
    """Return a colour (3,), 0 to 1, as CSS has it."""
    return "#" + "".join(f"{round(255 * value):02x}" for value in color[:3])
