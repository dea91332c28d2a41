"""The best joint path through a sequence of poses: an exact shortest path over all candidates.

The candidates for a waypoint are all its branches, in all turns inside of the limits. Between
waypoints that follow each other every candidate leads to every other, and a step costs the time
it takes at the velocity limits. The waypoints are the layers of a graph without cycles, so one
pass finds the shortest of all paths (Bellman's recursion):
cost_i(b) = min over a of cost_{i-1}(a) + step(a, b).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .arm import Arm
from .candidates import Layers, find_layers
from .choice import joint_time
from .limits import TWO_PI, check_limits
from .tolerances import JUMP_ANGLE, LIMIT_SLACK, TIE_WEIGHT

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]
IntArray = NDArray[np.intp]

BLOCK = 16
"""Steps whose costs are computed at a time: some 4000 numbers, 32 KB, for an array."""


class JointPath(NamedTuple):
    """One configuration for each waypoint, and what the path costs."""

    q: FloatArray
    """Joint angles [rad]; NaN for a waypoint without a configuration. Shape (n, 6)."""
    time: float
    """Sum of the steps' times at the velocity limits, from `q_start` on if there is one [s]."""
    jumps: int
    """Steps between close waypoints that take as long as the slowest joint does for `JUMP_ANGLE`,
    or longer."""
    travel: FloatArray
    """Way of each joint, the sum of |dq| [rad]. Shape (6,)."""


def best_sequence(
    arm: Arm,
    T: ArrayLike,
    lower: ArrayLike,
    upper: ArrayLike,
    velocity: ArrayLike,
    q_start: ArrayLike | None = None,
    *,
    avoid_jumps: bool = True,
    accept: Callable[[FloatArray], BoolArray] | None = None,
    slack: float = LIMIT_SLACK,
) -> JointPath:
    """Choose branches and turns along a path so that the path takes the least time.

    Among paths of the same time the one with less travel is taken.

    Args:
        arm: The arm.
        T: Waypoints, T_base_tool in the order in which they are passed. Shape (n, 4, 4).
        lower: Lower limits [rad], finite. Shape (6,).
        upper: Upper limits [rad], finite. Shape (6,).
        velocity: Velocity limits [rad/s]. Shape (6,).
        q_start: Configuration before the first waypoint [rad]. Shape (6,); free by default.
        avoid_jumps: Take the fewest jumps, and the least time only then. A jump between close
            waypoints is a change of branch: on its way the tool leaves the path.
        accept: Tells which configurations (m, 6) may be used at all, as a mask (m,), for instance
            by a collision check. It is called once, with all candidates.
        slack: How far outside of the limits still counts as inside [rad].

    Returns:
        The path. A waypoint that is unreachable or has no configuration inside of the limits is
        a row of NaN, and the path goes on from the one before.

    Raises:
        InvalidPose: A waypoint is no rigid transform.
        IKError: Another argument has a wrong shape or value.
    """
    low, high, v = check_limits(lower, upper, velocity)
    layers = find_layers(arm, T, low, high, q_start, accept, slack)
    if not len(layers.exists):
        return _path(layers, v, [])
    # a jump costs more than the longest path without one can take
    longest = 2.0 * float(((high - low + TWO_PI) / v).max()) * (len(layers.exists) + 1)
    cost = np.where(layers.exists[0], 0.0, np.inf)
    parents: list[IntArray] = []
    for steps in _step_costs(layers, v, longest * avoid_jumps):
        k = steps.shape[1]
        cost = np.append(cost, np.full(max(0, k - len(cost)), np.inf))[:k]
        costs = np.empty((len(steps), k, 1))
        for here, step in zip(costs, steps, strict=True):
            here[:, 0] = cost
            cost = np.minimum.reduce(step + here, axis=0)
        steps += costs
        parents.extend(steps.argmin(axis=1))
    chosen = [int(cost.argmin())]
    for parent in reversed(parents):
        chosen.append(int(parent[chosen[-1]]))
    return _path(layers, v, chosen[::-1])


def greedy_sequence(
    arm: Arm,
    T: ArrayLike,
    lower: ArrayLike,
    upper: ArrayLike,
    velocity: ArrayLike,
    q_start: ArrayLike | None = None,
    *,
    accept: Callable[[FloatArray], BoolArray] | None = None,
    slack: float = LIMIT_SLACK,
) -> JointPath:
    """Take the candidate nearest in time to the one before, waypoint by waypoint.

    The usual choice, for comparison: it cannot see that a short step now costs a long one later.

    Args:
        arm: See `best_sequence`, as for all others.
        T: Waypoints. Shape (n, 4, 4).
        lower: Lower limits [rad], finite. Shape (6,).
        upper: Upper limits [rad], finite. Shape (6,).
        velocity: Velocity limits [rad/s]. Shape (6,).
        q_start: Configuration before the first waypoint [rad]. Shape (6,). By default the first
            waypoint takes its candidate nearest to zero.
        accept: Tells which configurations may be used.
        slack: How far outside of the limits still counts as inside [rad].

    Returns:
        The path, as `best_sequence` returns it.

    Raises:
        InvalidPose: A waypoint is no rigid transform.
        IKError: Another argument has a wrong shape or value.
    """
    low, high, v = check_limits(lower, upper, velocity)
    layers = find_layers(arm, T, low, high, q_start, accept, slack)
    if not len(layers.exists):
        return _path(layers, v, [])
    from_zero = joint_time(0.0, layers.q[:, 0].T, v)
    chosen = [int(np.where(layers.exists[0], from_zero, np.inf).argmin())]
    for steps in _step_costs(layers, v, 0.0):
        for step in steps:
            chosen.append(int(step[chosen[-1]].argmin()))
    return _path(layers, v, chosen)


def _step_costs(layers: Layers, velocity: FloatArray, jump_penalty: float) -> Iterator[FloatArray]:
    """Compute the cost of each step, from any candidate of a layer to any of the next.

    A step alone is too little work for a NumPy call, so this goes by blocks of steps.

    Args:
        layers: The candidates.
        velocity: Velocity limits [rad/s]. Shape (6,).
        jump_penalty: What a jump costs [s].

    Yields:
        Costs of the steps of a block [s], infinite where there is no candidate, k being the
        largest number of candidates in the block. Shape (n, k, k).
    """
    scaled = layers.q / velocity[:, None, None]
    jump_time = JUMP_ANGLE / velocity.min()
    sizes = layers.exists.sum(axis=1)
    for start in range(0, len(sizes) - 1, BLOCK):
        layer = slice(start + 1, min(start + 1 + BLOCK, len(sizes)))
        k = int(sizes[start : layer.stop].max())
        before = scaled[:, start : layer.stop - 1, :k, None]
        after = scaled[:, layer, None, :k]
        time = np.abs(before[0] - after[0])
        slowest, total = time.copy(), time.copy()
        for a, b in zip(before[1:], after[1:], strict=True):
            np.subtract(a, b, out=time)
            np.abs(time, out=time)
            np.maximum(slowest, time, out=slowest)
            total += time
        total *= TIE_WEIGHT
        total += slowest
        if jump_penalty:
            slowest *= layers.close[layer, None, None]
            total += jump_penalty * (slowest > jump_time)
        total += np.where(layers.exists[layer, None, :k], 0.0, np.inf)
        yield total


def _path(layers: Layers, velocity: FloatArray, chosen: list[int]) -> JointPath:
    """Assemble the chosen candidates and add up what they cost."""
    rows = layers.q[:, np.arange(len(chosen)), chosen].T
    q = np.full((layers.count, 6), np.nan)
    q[layers.waypoint] = rows[1:] if layers.starts else rows
    times = joint_time(rows[:-1], rows[1:], velocity)
    return JointPath(
        q=q,
        time=float(times.sum()),
        jumps=int(((times > JUMP_ANGLE / velocity.min()) & layers.close[1:]).sum()),
        travel=np.abs(np.diff(rows, axis=0)).sum(axis=0),
    )
