"""Tool poses -> collision-free joint paths of a whole cycle."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import TypeAlias, TypeVar

import numpy as np

import ik
from kr210_sim.arrays import Array
from kr210_sim.criteria import CLEARANCE_FREE
from kr210_sim.exceptions import CycleFailure
from kr210_sim.legs import (
    CLEARANCE_CELL,
    Blocked,
    ClearanceOracle,
    Hand,
    Leg,
    LegFinder,
    Wanted,
)
from kr210_sim.record import STAGES
from kr210_sim.robot import Robot
from kr210_sim.task import PickPoses, PlacePoses
from kr210_sim.tracks import Solver, Track, TrackFinder, Tracks

__all__ = [
    "CLEARANCE_CELL",
    "MAX_TRIALS",
    "STOPS",
    "ClearanceOracle",
    "CyclePlan",
    "CyclePlanner",
    "Hand",
    "Leg",
    "Motion",
    "SolvedPoses",
    "motions_of",
]

MAX_TRIALS = 60
"""Combinations of pick and place checked before the cycle is given up."""

STOPS = frozenset({"APPROACH", "LOWER"})
"""Stages at whose end the arm stops: to grasp and to release."""

_CHECKED = (
    "MOVE_TO_PICK",
    "APPROACH",
    "LIFT",
    "WITHDRAW",
    "LOWER",
    "RETREAT",
    "MOVE_HOME",
    "MOVE_TO_PLACE",
)
"""The legs of a combination in the order they are checked."""

Option = TypeVar("Option", PickPoses, PlacePoses)
Ends: TypeAlias = tuple[Array, Array]
"""First and last configuration (6,) of a cycle [rad]."""

Motion: TypeAlias = tuple[Leg, ...]
"""Legs from one stop to the next."""


@dataclass(frozen=True, kw_only=True)
class SolvedPoses:
    """What was asked of the IK and what it answered.

    Attributes:
        T_base_palm: (N, 4, 4) requested poses.
        q: (N, 6) the configurations chosen [rad].
    """

    T_base_palm: Array
    q: Array


@dataclass(frozen=True, kw_only=True)
class CyclePlan:
    """The motions of one cycle by stage, and the poses that were solved for them.

    Attributes:
        motions: in order, each from one stop to the next.
        solved: of the chosen tracks.
        p_base_release: (3,) TCP at the release.
        seconds_per_pose: spent in the IK, over all poses it was asked for [s].
    """

    motions: tuple[Motion, ...]
    solved: SolvedPoses
    p_base_release: Array
    seconds_per_pose: float

    @property
    def sampled_motions(self) -> tuple[str, ...]:
        """Stages whose path comes from the sampling planner, in order."""
        legs = [leg for motion in self.motions for leg in motion]
        return tuple(dict.fromkeys(leg.stage for leg in legs if leg.sampled))


class CyclePlanner:
    """Plans one cycle of one robot in one world.

    Branch, turns, approach direction and release are chosen together: all combinations are ordered
    by their joint time at the velocity limits, and the first that keeps its clearance everywhere
    is taken. Where none does, moves of the first are sampled until a budget is used up; lines and
    ends that are blocked stay so. Only then follow higher releases, whose moves are mostly the
    same. A solver that plugs in has one answer to a pose; the options are then tried in turn.

    Args:
        robot: limits, geometry and tool.
        oracle: answers for clearance.
        solver: an IK that takes the place of the analytic one.
        seed: of the sampling planner.
        clearance: kept to everything outside the cells [m].
    """

    def __init__(
        self,
        robot: Robot,
        oracle: ClearanceOracle,
        solver: Solver | None = None,
        *,
        seed: int = 0,
        clearance: float = CLEARANCE_FREE,
    ) -> None:
        self._robot, self._clearance = robot, clearance
        self._finder = TrackFinder(robot, solver)
        self._legs = LegFinder(robot, oracle, seed)

    def plan(
        self,
        *,
        q_home: Array,
        picks: list[PickPoses],
        places: Iterator[list[PlacePoses]],
        q_start: Array | None = None,
    ) -> CyclePlan:
        """Plan a cycle that ends at home.

        Args:
            q_home: (6,) [rad], last configuration.
            picks: ways to take the target, preferred first.
            places: ways to release it, in batches of falling preference.
            q_start: (6,) [rad], first configuration; None for home.

        Raises:
            CycleFailure: unreachable, joint_limits, no_path or bad_ik.
        """
        ends = (q_home if q_start is None else q_start, q_home)
        pick_tracks: Tracks | None = None
        for batch in self._batches([picks]):
            corners = [(pick.pre_grasp, pick.grasp, pick.lift, pick.withdraw) for pick in batch]
            pick_tracks = self._finder.find(corners, anchor=1, q_start=ends[0])
            if pick_tracks:
                break
        if not pick_tracks:
            raise self._finder.failure("MOVE_TO_PICK", "the target's cell")
        self._finder.forget()
        blocked: Blocked | None = None
        for options in self._batches(places):
            place_tracks = self._finder.find(
                [(place.pre_place, place.place) for place in options],
                anchor=1,
                q_start=pick_tracks[0].q[-1],
            )
            if not place_tracks:
                continue
            outcome = self._combine(ends, pick_tracks, place_tracks)
            if isinstance(outcome, CyclePlan):
                return outcome
            blocked = _further(blocked, outcome)
        if blocked is not None:
            raise CycleFailure(
                "no_path",
                f"every way is blocked, the one that gets furthest by {blocked}",
                stage=blocked.stage,
            )
        raise self._finder.failure("MOVE_TO_PLACE", "the place volume")

    def _batches(self, batches: Iterable[list[Option]]) -> Iterator[list[Option]]:
        """Yield batches of options; one by one for a solver, which has one answer to each."""
        for batch in batches:
            if self._finder.one_answer:
                yield from ([option] for option in batch)
            else:
                yield batch

    def _time(self, q_from: Array, q_to: Array) -> Array:
        return ik.joint_time(q_from, q_to, self._robot.velocity)

    def _line_times(self, tracks: Tracks) -> Array:
        """Return the joint time (M,) of the lines of each track [s]."""
        return np.asarray(np.sum(self._time(tracks.q[:, :-1], tracks.q[:, 1:]), axis=1))

    def _combine(self, ends: Ends, picks: Tracks, places: Tracks) -> CyclePlan | Blocked:
        """Return the quickest free combination, or what blocked the one that got furthest."""
        pick_first, pick_last, place_first = picks.q[:, 0], picks.q[:, -1], places.q[:, 0]
        pick_lines, place_lines = self._line_times(picks), self._line_times(places)
        cost = (
            (self._time(ends[0], pick_first) + pick_lines)[:, None]
            + self._time(pick_last[:, None], place_first[None])
            + (self._time(place_first, ends[1]) + 2 * place_lines)[None]
        )
        order = np.argsort(cost, axis=None, kind="stable")[:MAX_TRIALS]
        blocked: Blocked | None = None
        for sampling in (False, True):
            for pair in order:
                i, j = divmod(int(pair), len(places))
                # The first is mostly free; of the others, most are refused by their first legs.
                ahead = not sampling and pair == order[0]
                outcome = self._legs_of(ends, picks[i], places[j], sampling=sampling, ahead=ahead)
                if not isinstance(outcome, Blocked):
                    return self._finish(outcome, picks[i], places[j])
                blocked = _further(blocked, outcome)
        assert blocked is not None
        return blocked

    def _legs_of(
        self, ends: Ends, pick: Track, place: Track, *, sampling: bool, ahead: bool
    ) -> list[Leg] | Blocked:
        """Return all legs of a combination, or what blocks the first that is blocked.

        Args:
            ends: (6,) each, where it begins and where it ends [rad].
            pick: the way to take the target.
            place: the way to release it.
            sampling: whether blocked moves are sampled, once everything else is free.
            ahead: whether all legs are looked for at once, even if one is blocked.
        """
        legs: dict[str, list[Leg]] = {}
        waiting: list[Wanted] = []
        wishes = self._wishes(ends, pick, place)
        if ahead:
            self._legs.find_each(wishes)
        for wanted in wishes:
            answer = self._legs.find(wanted)
            if not isinstance(answer, Blocked):
                legs[wanted.stage] = answer
            elif answer.final or not sampling:
                return answer
            else:
                waiting.append(wanted)
        for wanted in waiting:
            answer = self._legs.sample(wanted)
            if isinstance(answer, Blocked):
                return answer
            legs[wanted.stage] = answer
        return [leg for stage in STAGES for leg in legs.get(stage, ())]

    def _wishes(self, ends: Ends, pick: Track, place: Track) -> tuple[Wanted, ...]:
        """Return the legs of a combination in the order of `_CHECKED`."""
        cell, free = CLEARANCE_CELL, self._clearance

        def line(stage: str, q: Array, hand: Hand, clearance: float) -> Wanted:
            return Wanted(stage=stage, q=q, hand=hand, clearance=clearance)

        return (
            Wanted.move("MOVE_TO_PICK", ends[0], pick.q[0], Hand.EMPTY, free),
            line("APPROACH", pick.part(0), Hand.AROUND, cell),
            line("LIFT", pick.part(1), Hand.LIFTING, cell),
            line("WITHDRAW", pick.part(2), Hand.HOLDING, cell),
            line("LOWER", place.q, Hand.HOLDING, free),
            line("RETREAT", place.q[::-1], Hand.RELEASED, free),
            Wanted.move("MOVE_HOME", place.q[0], ends[1], Hand.RELEASED, free),
            Wanted.move("MOVE_TO_PLACE", pick.q[-1], place.q[0], Hand.HOLDING, free),
        )

    def _finish(self, legs: list[Leg], pick: Track, place: Track) -> CyclePlan:
        solved = SolvedPoses(
            T_base_palm=np.concatenate([pick.T_base_palm, place.T_base_palm]),
            q=np.concatenate([pick.q, place.q]),
        )
        return CyclePlan(
            motions=motions_of(legs),
            solved=solved,
            p_base_release=self._robot.forward(place.q[-1])[:3, 3],
            seconds_per_pose=self._finder.seconds / self._finder.poses,
        )


def _further(one: Blocked | None, other: Blocked) -> Blocked:
    """Return the obstacle that is checked later, of equals the other one."""
    if one is None or _CHECKED.index(other.stage) >= _CHECKED.index(one.stage):
        return other
    return one


def motions_of(legs: list[Leg]) -> tuple[Motion, ...]:
    """Group legs into motions that end where the arm must stop."""
    motions: list[list[Leg]] = [[]]
    for leg in legs:
        if motions[-1] and motions[-1][-1].stage in STOPS - {leg.stage}:
            motions.append([])
        motions[-1].append(leg)
    return tuple(tuple(motion) for motion in motions)
