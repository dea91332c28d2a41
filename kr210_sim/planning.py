"""Tool poses -> collision-free joint paths of a whole cycle."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from enum import Enum
from itertools import pairwise
from typing import Protocol, TypeAlias, TypeVar

import numpy as np

import ik
from kr210_sim.arrays import Array
from kr210_sim.criteria import CLEARANCE_FREE
from kr210_sim.exceptions import CycleFailure
from kr210_sim.path import Path
from kr210_sim.robot import Robot
from kr210_sim.task import PickPoses, PlacePoses
from kr210_sim.tracks import Solver, Track, TrackFinder

CLEARANCE_CELL = 0.004
"""Kept to cell and target on the straight lines in and out [m]."""

CHECK_STEP = 0.012
"""Spacing of the configurations between which a curved path counts as straight [rad]."""

DETOURS = (
    (0.0, 0.0),
    (0.2, 0.0),
    (0.4, 0.0),
    (0.4, 0.2),
    (0.6, 0.0),
    (0.6, 0.3),
    (0.8, 0.2),
    (0.9, 0.0),
)
"""Detours tried on a joint move, (towards axis 1, upwards) at mid-move [m], least first."""

MAX_TRIALS = 60
"""Combinations of pick and place checked before the cycle is given up."""


STOPS = frozenset({"APPROACH", "LOWER"})
"""Stages at whose end the arm stops: to grasp and to release."""


class Hand(Enum):
    """What the gripper and the target do during a leg, for the clearance check."""

    EMPTY = "open, the target standing in its cell"
    AROUND = "open, the fingers passing the target"
    LIFTING = "closed on the target, which may touch its support"
    HOLDING = "closed on the target"
    RELEASED = "open, the target gone"


class ClearanceOracle(Protocol):
    """What planning asks of the world."""

    def blocked(self, q: Array, *, hand: Hand, clearance: float) -> str | None:
        """Return None if the path keeps that clearance [m] everywhere, else what is near.

        The path is the polyline through configurations (N, 6), the straight pieces included.
        """
        ...


@dataclass(frozen=True, kw_only=True)
class Leg:
    """A joint path, the stage it belongs to, and what it was checked for.

    Attributes:
        stage: one of `record.STAGES`; a detour makes two legs of one stage.
        path: the geometry.
        hand: what the gripper and the target do meanwhile.
        clearance: kept to everything else [m].
    """

    stage: str
    path: Path
    hand: Hand
    clearance: float


Option = TypeVar("Option", PickPoses, PlacePoses)
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


class CyclePlanner:
    """Plans one cycle of one robot in one world.

    Branch, turns, approach direction and release are chosen together: all combinations are ordered
    by their joint time at the velocity limits, and the first that keeps its clearance everywhere
    is taken. A solver that plugs in has one answer to a pose; the options are then tried in turn.

    Args:
        robot: limits, geometry and tool.
        oracle: answers for clearance.
        solver: an IK that takes the place of the analytic one.
        clearance: kept to everything outside the cells [m].
    """

    def __init__(
        self,
        robot: Robot,
        oracle: ClearanceOracle,
        solver: Solver | None = None,
        *,
        clearance: float = CLEARANCE_FREE,
    ) -> None:
        self._robot, self._oracle, self._clearance = robot, oracle, clearance
        self._finder = TrackFinder(robot, solver)

    def plan(
        self, *, q_home: Array, picks: list[PickPoses], places: Iterator[list[PlacePoses]]
    ) -> CyclePlan:
        """Plan a cycle from home to home.

        Args:
            q_home: (6,) [rad], first and last configuration.
            picks: ways to take the target, preferred first.
            places: ways to release it, in batches of falling preference.

        Raises:
            CycleFailure: unreachable, joint_limits, no_path or bad_ik.
        """
        pick_tracks: list[Track] = []
        for batch in self._batches([picks]):
            corners = [(pick.pre_grasp, pick.grasp, pick.lift, pick.withdraw) for pick in batch]
            pick_tracks += self._finder.find(corners, anchor=1, q_start=q_home)
            if pick_tracks:
                break
        if not pick_tracks:
            raise self._finder.failure("MOVE_TO_PICK", "the target's cell")
        self._finder.forget()
        blocked_by = ""
        for options in self._batches(places):
            place_tracks = self._finder.find(
                [(place.pre_place, place.place) for place in options],
                anchor=1,
                q_start=pick_tracks[0].q[-1],
            )
            if not place_tracks:
                continue
            outcome = self._combine(q_home, pick_tracks, place_tracks)
            if isinstance(outcome, CyclePlan):
                return outcome
            blocked_by = outcome
        if blocked_by:
            raise CycleFailure("no_path", f"every way is blocked, the last by {blocked_by}")
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

    def _combine(self, q_home: Array, picks: list[Track], places: list[Track]) -> CyclePlan | str:
        """Return the quickest free combination, or what blocked the last one tried."""
        pick_first = np.array([track.q[0] for track in picks])
        pick_last = np.array([track.q[-1] for track in picks])
        place_first = np.array([track.q[0] for track in places])
        pick_lines = [np.sum(self._time(track.q[:-1], track.q[1:])) for track in picks]
        place_lines = [np.sum(self._time(track.q[:-1], track.q[1:])) for track in places]
        cost = (
            (self._time(q_home, pick_first) + pick_lines)[:, None]
            + self._time(pick_last[:, None], place_first[None])
            + (self._time(place_first, q_home) + 2 * np.array(place_lines))[None]
        )
        order = np.argsort(cost, axis=None, kind="stable")[:MAX_TRIALS]
        return self._first_free(q_home, picks, places, order)

    def _first_free(
        self, q_home: Array, picks: list[Track], places: list[Track], order: Array
    ) -> CyclePlan | str:
        pick_legs: dict[int, list[Leg] | str] = {}
        place_legs: dict[int, list[Leg] | str] = {}
        blocked_by = "nothing"
        for pair in order:
            i, j = divmod(int(pair), len(places))
            if i not in pick_legs:
                pick_legs[i] = self._pick_legs(q_home, picks[i])
            if isinstance(pick := pick_legs[i], str):
                blocked_by = pick
                continue
            if j not in place_legs:
                place_legs[j] = self._place_legs(q_home, places[j])
            if isinstance(place := place_legs[j], str):
                blocked_by = place
                continue
            transfer = self._move("MOVE_TO_PLACE", picks[i].q[-1], places[j].q[0], Hand.HOLDING)
            if isinstance(transfer, str):
                blocked_by = transfer
                continue
            return self._finish([*pick, *transfer, *place], picks[i], places[j])
        return blocked_by

    def _pick_legs(self, q_home: Array, track: Track) -> list[Leg] | str:
        move = self._move("MOVE_TO_PICK", q_home, track.q[0], Hand.EMPTY)
        if isinstance(move, str):
            return move
        legs = list(move)
        for number, (stage, hand) in enumerate(
            (("APPROACH", Hand.AROUND), ("LIFT", Hand.LIFTING), ("WITHDRAW", Hand.HOLDING))
        ):
            line = self._line(stage, track.part(number), hand, CLEARANCE_CELL)
            if isinstance(line, str):
                return line
            legs.append(line)
        return legs

    def _place_legs(self, q_home: Array, track: Track) -> list[Leg] | str:
        lower = self._line("LOWER", track.q, Hand.HOLDING, self._clearance)
        if isinstance(lower, str):
            return lower
        retreat = self._line("RETREAT", track.q[::-1], Hand.RELEASED, self._clearance)
        if isinstance(retreat, str):
            return retreat
        move = self._move("MOVE_HOME", track.q[0], q_home, Hand.RELEASED)
        return move if isinstance(move, str) else [lower, retreat, *move]

    def _line(self, stage: str, q: Array, hand: Hand, clearance: float) -> Leg | str:
        """Return the leg along solved poses (N, 6), or what blocks it."""
        if what := self._oracle.blocked(q, hand=hand, clearance=clearance):
            return f"{what} in {stage}"
        path = Path.through(q, self._robot.velocity)
        return Leg(stage=stage, path=path, hand=hand, clearance=clearance)

    def _move(self, stage: str, q_from: Array, q_to: Array, hand: Hand) -> list[Leg] | str:
        """Return a free joint move, straight if possible, else by the least detour that is free."""
        bulges = self._bulges(q_from, q_to)
        what: str | None = "a joint limit"
        for inward, upward in DETOURS:
            via = (q_from + q_to) / 2 + inward * bulges[0] + upward * bulges[1]
            corners = [q_from, via, q_to] if inward or upward else [q_from, q_to]
            paths = [Path.straight(a, b, self._robot.velocity) for a, b in pairwise(corners)]
            if not np.all(ik.within_limits(via, self._robot.lower, self._robot.upper)):
                continue
            # The trajectory rounds the corner only as far as its inside is free, too.
            q = np.concatenate([path.samples(CHECK_STEP) for path in paths])
            what = self._oracle.blocked(q, hand=hand, clearance=self._clearance)
            if what is None:
                return [
                    Leg(stage=stage, path=path, hand=hand, clearance=self._clearance)
                    for path in paths
                ]
        return f"{what} in {stage}"

    def _bulges(self, q_from: Array, q_to: Array) -> Array:
        """Return joint displacements (2, 6) that move the TCP 1 m towards axis 1, and 1 m up.

        Damped least squares on the Jacobian at mid-move, with the tool's orientation kept.
        """
        middle = (q_from + q_to) / 2
        jacobian = ik.jacobian(self._robot.geometry, middle)
        p = self._robot.forward(middle)[:3, 3]
        twists = np.zeros((2, 6))
        twists[0, :2] = -p[:2] / max(float(np.hypot(p[0], p[1])), 1e-6)
        twists[1, 2] = 1.0
        damped = jacobian @ jacobian.T + 1e-2 * np.eye(6)
        return np.asarray(np.linalg.solve(damped, twists.T).T @ jacobian)

    def _finish(self, legs: list[Leg], pick: Track, place: Track) -> CyclePlan:
        solved = SolvedPoses(
            T_base_palm=np.concatenate([pick.T_base_palm, place.T_base_palm]),
            q=np.concatenate([pick.q, place.q]),
        )
        return CyclePlan(
            motions=_motions(legs),
            solved=solved,
            p_base_release=self._robot.forward(place.q[-1])[:3, 3],
            seconds_per_pose=self._finder.seconds / self._finder.poses,
        )


def _motions(legs: list[Leg]) -> tuple[Motion, ...]:
    """Group legs into motions that end where the arm must stop."""
    motions: list[list[Leg]] = [[]]
    for leg in legs:
        motions[-1].append(leg)
        if leg.stage in STOPS:
            motions.append([])
    return tuple(tuple(motion) for motion in motions)
