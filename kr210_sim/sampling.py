"""A free joint path around obstacles: RRT-Connect by OMPL, then shortcuts and better corners.

All chance comes from the generator that is handed in, and every bound is a number of configurations
or trials, so the answer depends on the question and the seed alone.
"""

from __future__ import annotations

import importlib.util
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from kr210_sim.arrays import Array

REMEDY = "install the sampling planner: python -m pip install ompl"
"""What helps where a sampled path is needed and OMPL is missing."""

TREE_STEP = 0.03
"""Spacing of the configurations checked while the trees grow [rad]; the path is checked finer."""

_MARGINS = (1.2, np.inf)
"""How far beyond the two ends of a move samples are drawn [rad]: first near, then anywhere."""

_RANGE = 0.5  # longest branch of a tree [s at the velocity limits]
_SHORTCUTS = 40  # random pairs of points on the path that are tried
_IMPROVEMENTS = 150  # random replacements of corners that are tried
_SPREAD = 0.15  # of the points that replace corners [s at the velocity limits]
_CORNER = 0.2  # what a corner costs [s]: the arm brakes on one line and speeds up on the next
_LESS = 1e-3  # least travel that is worth another path [rad]
_WRIST = ((3, 5), (3,), (5,))  # axes 4 and 6, which wander: they are too quick to cost time


@dataclass
class Budget:
    """How many configurations the trees of several queries may still ask for."""

    left: int


@dataclass(frozen=True, kw_only=True)
class Query:
    """Where from, where to, and what is free on the way.

    Attributes:
        q_from, q_to: (6,) [rad], both free.
        lower, upper: (6,) joint limits [rad].
        velocity: (6,) velocity limits [rad/s]; distances are times at these.
        free: tells whether the polyline through configurations (N, 6) is free.
    """

    q_from: Array
    q_to: Array
    lower: Array
    upper: Array
    velocity: Array
    free: Callable[[Array], bool]

    def seconds(self, corners: Array) -> Array:
        """Return the time of each line between corners (N, 6) at the velocity limits (N - 1,)."""
        return np.asarray(np.max(np.abs(np.diff(corners, axis=0)) / self.velocity, axis=1))


def available() -> bool:
    """Tell whether OMPL is installed, without importing it."""
    return importlib.util.find_spec("ompl") is not None


def sample_path(query: Query, rng: np.random.Generator, budget: Budget) -> Array | None:
    """Return the corners (N, 6) of a free path of straight joint lines, or None if none was found.

    Args:
        query: the question.
        rng: source of all chance.
        budget: configurations the trees may check; what was used is taken off.
    """
    for number, margin in enumerate(_MARGINS):
        share = Budget(budget.left // (len(_MARGINS) - number))
        budget.left -= share.left
        while share.left > 0:
            corners = _connect(query, margin, int(rng.integers(1, 2**31)), share)
            if corners is not None and query.free(corners):  # else it slipped between steps
                budget.left += share.left
                corners = _improved(query, _shortcut(query, corners, rng), rng)
                return _unwound(query, corners)
    return None


def _connect(query: Query, margin: float, seed: int, budget: Budget) -> Array | None:
    """Return corners of a path found by OMPL's RRT-Connect, or None when the budget is used up.

    OMPL seeds its samplers from a generator of the whole process; it is set anew before each
    query, so that what was planned before has no influence. States are q over the velocity limits,
    so that OMPL's Euclidean distance weighs joints by the time they need.
    """
    from ompl import base, geometric, util

    util.noOutputHandler()
    space = base.RealVectorStateSpace(6)
    bounds = base.RealVectorBounds(6)
    lower = np.maximum(query.lower, np.minimum(query.q_from, query.q_to) - margin)
    upper = np.minimum(query.upper, np.maximum(query.q_from, query.q_to) + margin)
    for axis in range(6):
        bounds.setLow(axis, float(lower[axis] / query.velocity[axis]))
        bounds.setHigh(axis, float(upper[axis] / query.velocity[axis]))
    space.setBounds(bounds)
    space.setLongestValidSegmentFraction(
        TREE_STEP / float(np.max(query.velocity)) / space.getMaximumExtent()
    )

    def valid(state: Array) -> bool:
        budget.left -= 1
        return query.free(np.array([[state[axis] for axis in range(6)]]) * query.velocity)

    information = base.SpaceInformation(space)
    information.setStateValidityChecker(valid)
    util.RNG.setSeed(seed)
    information.setup()
    problem = base.ProblemDefinition(information)
    ends = [space.allocState(), space.allocState()]
    for state, q in zip(ends, (query.q_from, query.q_to), strict=True):
        for axis in range(6):
            state[axis] = float(q[axis] / query.velocity[axis])
    problem.setStartAndGoalStates(*ends)
    planner = geometric.RRTConnect(information)
    planner.setRange(_RANGE)
    planner.setProblemDefinition(problem)
    planner.setup()
    planner.solve(base.PlannerTerminationCondition(lambda: budget.left <= 0))
    if not problem.hasExactSolution():
        return None
    states = problem.getSolutionPath().getStates()
    corners = np.array([[state[axis] for axis in range(6)] for state in states]) * query.velocity
    corners[0], corners[-1] = query.q_from, query.q_to
    return corners


def _shortcut(query: Query, corners: Array, rng: np.random.Generator) -> Array:
    """Replace what lies between two random points of the path by a line, where that is free."""
    for _ in range(_SHORTCUTS):
        if len(corners) == 2:
            break
        times = np.concatenate([[0.0], np.cumsum(query.seconds(corners))])
        first, last = np.sort(rng.uniform(0.0, times[-1], 2))
        before = int(np.searchsorted(times, first, side="right"))
        after = int(np.searchsorted(times, last, side="left"))
        if before >= after:  # both on one line
            continue
        ends = np.array(
            [[np.interp(t, times, corners[:, axis]) for axis in range(6)] for t in (first, last)]
        )
        if query.free(ends):
            corners = np.concatenate([corners[:before], ends, corners[after:]])
    return corners


def _improved(query: Query, corners: Array, rng: np.random.Generator) -> Array:
    """Replace up to three corners in a row by one random point near them, or none, where quicker.

    The cost is the time at the velocity limits, plus a fixed one for every corner.
    """
    for _ in range(_IMPROVEMENTS):
        inner = len(corners) - 2
        if inner == 0:
            break
        first = 1 + int(rng.integers(inner))
        last = min(inner, first + int(rng.integers(3)))  # inclusive
        ends = corners[[first - 1, last + 1]]
        place = np.mean(corners[first : last + 1], axis=0)
        place += rng.uniform() * (np.mean(ends, axis=0) - place)
        place += rng.normal(0.0, _SPREAD * rng.uniform(), 6) * query.velocity
        place = np.clip(place, query.lower, query.upper)
        before = _cost(query, corners[first - 1 : last + 2])
        for new in (ends, np.array([ends[0], place, ends[1]])):
            if _cost(query, new) < before and query.free(new):
                corners = np.concatenate([corners[:first], new[1:-1], corners[last + 1 :]])
                break
    return corners


def _unwound(query: Query, corners: Array) -> Array:
    """Turn axes 4 and 6 evenly from end to end, together or else one, where that is free.

    What is not less travel, or costs time, is left as it is.
    """
    for axes in _WRIST:
        way = np.concatenate([[0.0], np.cumsum(query.seconds(corners))])
        even = corners.copy()
        for axis in axes:
            even[:, axis] = np.interp(way, way[[0, -1]], corners[[0, -1], axis])
        saved = np.sum(np.abs(np.diff(corners, axis=0)) - np.abs(np.diff(even, axis=0)))
        if saved > _LESS and _cost(query, even) <= _cost(query, corners) and query.free(even):
            corners = even
    return corners


def _cost(query: Query, corners: Array) -> float:
    return float(np.sum(query.seconds(corners))) + _CORNER * (len(corners) - 2)
