"""The best joint path through a sequence of poses: an exact shortest path over all candidates.

The candidates for a waypoint are all its branches, in all turns inside of the limits. Between
waypoints that follow each other every candidate leads to every other, and a step costs the time
it takes at the velocity limits. The waypoints are the layers of a graph without cycles, so one
pass finds the shortest of all paths (Bellman's recursion):
cost_i(b) = min over a of cost_{i-1}(a) + step(a, b).
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .arm import Arm
from .candidates import Layers, find_layers, pose_distance
from .choice import joint_time
from .kinematics import own_frames
from .limits import TWO_PI, check_limits
from .tolerances import CLOSE_POSE, LIMIT_SLACK, STRAY, TIE_WEIGHT

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
    """Steps between close waypoints on which the tool leaves the path between them."""
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
        avoid_jumps: Take the fewest jumps, and the least time only then. A jump is a step between
            close waypoints on which the tool leaves the path, as it does on a change of branch
            that is not made at a singularity.
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
    path = _path(arm, layers, v, _shortest(_step_costs(layers, v), layers))
    if path.jumps and avoid_jumps:
        # a jump costs more than the longest path without one can take
        longest = 2.0 * float(((high - low + TWO_PI) / v).max()) * (len(layers.exists) + 1)
        steps = _step_costs(layers, v, arm, longest)
        path = _path(arm, layers, v, _shortest(steps, layers))
    return path


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
        return _path(arm, layers, v, [])
    from_zero = joint_time(0.0, layers.q[:, 0].T, v)
    chosen = [int(np.where(layers.exists[0], from_zero, np.inf).argmin())]
    for steps in _step_costs(layers, v):
        for step in steps:
            chosen.append(int(step[chosen[-1]].argmin()))
    return _path(arm, layers, v, chosen)


def _shortest(blocks: Iterable[FloatArray], layers: Layers) -> list[int]:
    """Find the path of least cost; return which candidate it takes in each layer.

    Args:
        blocks: The costs of all steps, as `_step_costs` yields them.
        layers: The candidates.
    """
    if not len(layers.exists):
        return []
    cost = np.where(layers.exists[0], 0.0, np.inf)
    parents: list[IntArray] = []
    for steps in blocks:
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
    return chosen[::-1]


def _step_costs(
    layers: Layers, velocity: FloatArray, arm: Arm | None = None, jump_penalty: float = 0.0
) -> Iterator[FloatArray]:
    """Compute the cost of each step, from any candidate of a layer to any of the next.

    A step alone is too little work for a NumPy call, so this goes by blocks of steps.

    Args:
        layers: The candidates.
        velocity: Velocity limits [rad/s]. Shape (6,).
        arm: The arm, to find the jumps; not looked for by default.
        jump_penalty: What a jump costs [s].

    Yields:
        Costs of the steps of a block [s], infinite where there is no candidate, k being the
        largest number of candidates in the block. Shape (n, k, k).
    """
    scaled = layers.q / velocity[:, None, None]
    sizes = layers.exists.sum(axis=1)
    for start in range(0, len(sizes) - 1, BLOCK):
        layer = slice(start + 1, min(start + 1 + BLOCK, len(sizes)))
        before = slice(start, layer.stop - 1)
        k = int(sizes[start : layer.stop].max())
        a, b = scaled[:, before, :k, None], scaled[:, layer, None, :k]
        time = np.abs(a[0] - b[0])
        slowest, total = time.copy(), time.copy()
        for j in range(1, 6):
            np.subtract(a[j], b[j], out=time)
            np.abs(time, out=time)
            np.maximum(slowest, time, out=slowest)
            total += time
        total *= TIE_WEIGHT
        total += slowest
        if arm is not None:
            q_a, q_b = layers.q[:, before, :k, None], layers.q[:, layer, None, :k]
            total += jump_penalty * _jumps(arm, layers, before, layer, q_a, q_b)
        total += np.where(layers.exists[layer, None, :k], 0.0, np.inf)
        yield total


def _jumps(
    arm: Arm, layers: Layers, before: slice, after: slice, q_a: FloatArray, q_b: FloatArray
) -> BoolArray:
    """Tell which steps between close waypoints leave the path between them.

    Halfway between two configurations the tool is about halfway between its poses if they belong
    together, and somewhere else if joints jump from one to the other.

    Args:
        arm: The arm.
        layers: Has the poses.
        before: The n layers the steps come from.
        after: The n layers they go to.
        q_a: Configurations they come from [rad]. Shape (6, n, ...).
        q_b: Configurations they go to [rad]. Shape (6, n, ...).

    Returns:
        Whether the tool is halfway further away from either waypoint than these are apart.
        Shape (n, ...).
    """
    tool = own_frames(arm, np.moveaxis(0.5 * (q_a + q_b), 0, -1))[6]
    extra = (1,) * (tool.p[0].ndim - 1)
    far = np.zeros(tool.p[0].shape)
    for poses in (layers.T[before], layers.T[after]):
        T = poses[:, :3].transpose(1, 2, 0).reshape(3, 4, -1, *extra)
        np.maximum(far, pose_distance(arm, tool, T), out=far)
    apart = layers.apart[after].reshape(-1, *extra)
    return np.asarray((apart < CLOSE_POSE) & (far > apart + STRAY))


def _path(arm: Arm, layers: Layers, velocity: FloatArray, chosen: list[int]) -> JointPath:
    """Assemble the chosen candidates and add up what they cost."""
    rows = layers.q[:, np.arange(len(chosen)), chosen]
    q = np.full((layers.count, 6), np.nan)
    q[layers.waypoint] = rows.T[1:] if layers.starts else rows.T
    a, b = rows[:, :-1], rows[:, 1:]
    jumps = _jumps(arm, layers, slice(0, -1), slice(1, None), a, b) if len(chosen) > 1 else a[0]
    return JointPath(
        q=q,
        time=float(joint_time(a.T, b.T, velocity).sum()),
        jumps=int(np.count_nonzero(jumps)),
        travel=np.abs(b - a).sum(axis=1),
    )
