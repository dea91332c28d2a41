"""A planned cycle driven through the answers of a solver, as the course drove it."""

from __future__ import annotations

import time
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

import ik
from kr210_sim.arrays import Array
from kr210_sim.exceptions import CycleFailure
from kr210_sim.grading.source import SCOPES
from kr210_sim.legs import Blocked, ClearanceOracle, Leg, LegFinder, Wanted
from kr210_sim.path import Path
from kr210_sim.planning import CyclePlan, SolvedPoses, motions_of
from kr210_sim.robot import Robot
from kr210_sim.task import line
from kr210_sim.tracks import LINE_STEP, Solver, ask, follow

PLANNED = frozenset({"MOVE_TO_PICK", "MOVE_TO_PLACE"})
"""The two legs for which the course asked the solver."""

STRAIGHT = ("APPROACH", "LIFT", "WITHDRAW", "LOWER")
"""The straight legs; RETREAT goes back the way of LOWER."""

_ASKED = dict(zip(SCOPES, (PLANNED, PLANNED | frozenset(STRAIGHT)), strict=True))

LEAST_POSES, MOST_POSES = 15, 60
_SPACING = 0.06
"""Between the poses of a planned leg, in the joint that moves most [rad]."""


@dataclass(frozen=True, kw_only=True)
class _Stage:
    """The legs of a stage as they were planned, and the palm poses (N, 4, 4) along them."""

    name: str
    legs: tuple[Leg, ...]
    T_base_palm: Array


class CourseDriver:
    """Replaces the paths of a plan by joint motion through what a solver answers.

    The planned tool path is sampled densely, the solver is asked for the poses, and the joints go
    straight from answer to answer, just as they come: a turn too many is moved, an error stays.
    The straight lines between are driven from where the answers left the tool, relative to it.
    Whether that is in the right place, or in the way of something, the simulation finds out.

    Args:
        robot: limits and geometry.
        oracle: answers for clearance, of the way home only.
        solver: f(T_base_palm (N, 4, 4), q_start (6,)) -> (N, 6).
        scope: name of one of SCOPES.
        seed: of the sampling planner, for the way home.
    """

    def __init__(
        self, robot: Robot, oracle: ClearanceOracle, solver: Solver, *, scope: str, seed: int
    ) -> None:
        self._robot, self._solver, self._asked = robot, solver, _ASKED[scope]
        self._legs = LegFinder(robot, oracle, seed)
        self._solved: list[SolvedPoses] = []
        self._lowered: Array = np.empty((0, 6))
        self._seconds = 0.0

    def drive(self, plan: CyclePlan) -> CyclePlan:
        """Return a plan through the same poses with the solver's answers.

        Raises:
            CycleFailure: bad_ik, unreachable, joint_limits or no_path.
        """
        stages = self._stages(plan)
        q = stages[0].legs[0].path.start
        found: list[Leg] = []
        for stage in stages:
            try:
                legs = self._legs_of(stage, q)
            except CycleFailure as failure:
                stage_name = failure.stage or stage.name
                raise CycleFailure(failure.reason, failure.detail, stage=stage_name) from failure
            found += legs
            q = found[-1].path.end
        solved = SolvedPoses(
            T_base_palm=np.concatenate([asked.T_base_palm for asked in self._solved]),
            q=np.concatenate([asked.q for asked in self._solved]),
        )
        return replace(
            plan,
            motions=motions_of(found),
            solved=solved,
            seconds_per_pose=self._seconds / len(solved.q),
        )

    def _stages(self, plan: CyclePlan) -> list[_Stage]:
        groups: dict[str, list[Leg]] = {}
        for leg in (leg for motion in plan.motions for leg in motion):
            groups.setdefault(leg.stage, []).append(leg)
        return [
            _Stage(name=name, legs=tuple(legs), T_base_palm=self._poses(name, legs))
            for name, legs in groups.items()
        ]

    def _poses(self, stage: str, legs: list[Leg]) -> Array:
        """Return the palm poses along a stage, its two ends included."""
        geometry = self._robot.geometry
        if stage in STRAIGHT:
            ends = ik.forward(geometry, np.array([legs[0].path.start, legs[-1].path.end]))
            return line(ends[0], ends[1], LINE_STEP)
        travel = sum(float(np.max(np.abs(leg.path.end - leg.path.start))) for leg in legs)
        count = int(np.clip(np.ceil(travel / _SPACING), LEAST_POSES, MOST_POSES))
        lengths = np.cumsum([0.0, *(leg.path.length for leg in legs)])
        rows = []
        for s in np.linspace(0.0, lengths[-1], count + 1):
            index = min(int(np.searchsorted(lengths, s, side="right")) - 1, len(legs) - 1)
            rows.append(legs[index].path(np.array([s - lengths[index]]))[0])
        return ik.forward(geometry, np.array(rows))

    def _legs_of(self, stage: _Stage, q: Array) -> list[Leg]:
        planned = stage.legs[0]
        if stage.name == "MOVE_HOME":
            return self._way_home(planned, q, stage.legs[-1].path.end)
        if stage.name == "RETREAT":
            rows, polyline = self._lowered[::-1], "LOWER" in self._asked
        elif polyline := stage.name in self._asked:
            rows = np.concatenate([q[None], self._answers(stage, q)])
        else:
            T_start = ik.forward(self._robot.geometry, q)
            moved = T_start @ np.linalg.inv(stage.T_base_palm[0])
            rows = follow(self._robot, moved @ stage.T_base_palm, q)
        if stage.name == "LOWER":
            self._lowered = rows
        velocity = self._robot.velocity
        paths = (
            [Path.straight(a, b, velocity) for a, b in pairwise(rows)]
            if polyline
            else [Path.through(rows, velocity)]
        )
        return [replace(planned, path=path, sampled=False) for path in paths]

    def _answers(self, stage: _Stage, q_start: Array) -> Array:
        """Return what the solver answers to all poses of a stage but the one it stands at."""
        poses = stage.T_base_palm[1:]
        started = time.perf_counter()
        q = ask(self._solver, poses, q_start)
        self._seconds += time.perf_counter() - started
        missing = np.any(np.isnan(q), axis=1)
        if np.any(missing):
            first = int(np.argmax(missing))
            detail = f"no IK answer to {missing.sum()} of {len(q)} poses, the first is pose {first}"
            raise CycleFailure("unreachable", detail)
        robot = self._robot
        beyond = ~ik.within_limits(q, robot.lower, robot.upper)
        if np.any(beyond):
            first = q[int(np.argmax(beyond))]
            joint = int(np.argmax(np.maximum(robot.lower - first, first - robot.upper)))
            detail = (
                f"the IK answers to {beyond.sum()} of {len(q)} poses are beyond a joint limit, "
                f"first {robot.arm_joints[joint]} at {np.degrees(first[joint]):.1f} deg"
            )
            raise CycleFailure("joint_limits", detail)
        self._solved.append(SolvedPoses(T_base_palm=poses, q=q))
        return q

    def _way_home(self, planned: Leg, q: Array, q_home: Array) -> list[Leg]:
        wanted = Wanted.move(planned.stage, q, q_home, planned.hand, planned.clearance)
        legs = self._legs.sample(wanted)
        if isinstance(legs, Blocked):
            raise CycleFailure("no_path", f"the way home is blocked by {legs}")
        return legs
