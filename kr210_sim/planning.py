"""Tool poses -> collision-free joint paths of a whole cycle."""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import dataclass, field
from enum import Enum
from itertools import pairwise
from typing import Protocol

import numpy as np

import ik
from kr210_sim.arrays import Array
from kr210_sim.exceptions import CycleFailure
from kr210_sim.path import Path
from kr210_sim.robot import Robot
from kr210_sim.task import PickPoses, PlacePoses, line

CLEARANCE_FREE = 0.02
"""Kept to everything while moving between cell and bin [m]."""

CLEARANCE_CELL = 0.004
"""Kept to cell and target on the straight lines in and out [m]."""

LINE_STEP = 0.01
"""Spacing of the poses solved along a straight line [m]; the spline between them is straight to
micrometres."""

CHECK_STEP = 0.012
"""Spacing of the configurations checked for clearance [rad]; below CLEARANCE_FREE at the TCP."""

BRANCH_JUMP = 0.35
"""A larger step of a joint between neighbours on a line [rad] is a change of branch."""

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
"""Bulges tried on a joint move, (towards axis 1, upwards) at mid-move [m], least first."""

MAX_TRIALS = 60
"""Combinations of pick and place checked before the cycle is given up."""


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
        """Return None if all configurations (N, 6) keep that clearance [m], else what is near."""
        ...


@dataclass(frozen=True, kw_only=True)
class Leg:
    """One motion: its stage, its path, and whether the TCP moves on a straight line."""

    stage: str
    path: Path
    straight: bool


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
    """The motions of one cycle by stage, and the poses that were solved for them."""

    legs: dict[str, Leg]
    solved: SolvedPoses
    p_base_release: Array
    ik_seconds: float
    ik_poses: int


@dataclass(kw_only=True)
class _Track:
    """One continuous branch along a polyline of straight lines."""

    T_base_palm: Array  # (N, 4, 4)
    q: Array  # (N, 6)
    knots: tuple[int, ...]  # index of each named pose within the N

    def part(self, number: int) -> Array:
        return self.q[self.knots[number] : self.knots[number + 1] + 1]


@dataclass
class _IkClock:
    seconds: float = 0.0
    poses: int = 0
    reachable: bool = False
    within_limits: bool = False


@dataclass(kw_only=True)
class CyclePlanner:
    """Plans whole cycles of one robot in one world.

    Attributes:
        robot: limits, geometry and tool.
        oracle: answers for clearance.
    """

    robot: Robot
    oracle: ClearanceOracle
    _clock: _IkClock = field(default_factory=_IkClock)

    def plan(
        self, *, q_home: Array, picks: list[PickPoses], places: Iterator[list[PlacePoses]]
    ) -> CyclePlan:
        """Plan a cycle from home to home.

        Branch, turns, approach direction and release are chosen together: all combinations are
        ordered by their joint time at the velocity limits, and the first that keeps its clearance
        everywhere is taken.

        Args:
            q_home: (6,) [rad], first and last configuration.
            picks: ways to take the target.
            places: ways to release it, in batches of falling preference.

        Raises:
            CycleFailure: unreachable, joint_limits or no_path.
        """
        self._clock = _IkClock()
        pick_tracks = self._tracks(
            [(pick.pre_grasp, pick.grasp, pick.lift, pick.withdraw) for pick in picks], anchor=1
        )
        if not pick_tracks:
            raise self._no_solution("MOVE_TO_PICK", "the target's cell")
        reason = self._no_solution("MOVE_TO_PLACE", "the place volume")
        blocked_by = ""
        for batch in places:
            self._clock.reachable = self._clock.within_limits = False
            place_tracks = self._tracks(
                [(place.pre_place, place.place) for place in batch], anchor=1
            )
            if not place_tracks:
                continue
            outcome = self._combine(q_home, pick_tracks, place_tracks)
            if isinstance(outcome, CyclePlan):
                return outcome
            blocked_by = outcome
        if blocked_by:
            raise CycleFailure("no_path", f"every way is blocked, the last by {blocked_by}")
        raise reason

    def _no_solution(self, stage: str, where: str) -> CycleFailure:
        if self._clock.reachable:
            return CycleFailure(
                "joint_limits", f"every IK branch at {where} is beyond a joint limit", stage=stage
            )
        return CycleFailure("unreachable", f"no IK branch reaches {where}", stage=stage)

    def _tracks(self, polylines: list[tuple[Array, ...]], anchor: int) -> list[_Track]:
        """Solve each polyline and follow every configuration of its anchor pose along it."""
        tracks = []
        for poses in polylines:
            parts = [line(a, b, LINE_STEP) for a, b in pairwise(poses)]
            joined = [parts[0]] + [part[1:] for part in parts[1:]]
            knots = (0, *np.cumsum([len(part) - 1 for part in parts]).tolist())
            T_base_palm = self.robot.tcp_to_palm(np.concatenate(joined))
            started = time.perf_counter()
            answer = ik.inverse(self.robot.geometry, T_base_palm)
            self._clock.seconds += time.perf_counter() - started
            self._clock.poses += len(T_base_palm)
            if np.any(np.all(~answer.valid, axis=1)):
                continue
            self._clock.reachable = True
            for q in self._follow(answer.q, knots[anchor]):
                tracks.append(_Track(T_base_palm=T_base_palm, q=q, knots=knots))
        return tracks

    def _follow(self, branches: Array, anchor: int) -> Iterator[Array]:
        """Yield every continuous in-limit sequence (N, 6) through branches (N, 8, 6).

        From each branch at the anchor the nearest solution is taken step by step to both ends, so
        that a passage through the wrist singularity, where the wrist branches swap, stays smooth.
        """
        sequences = np.empty((branches.shape[1], len(branches), 6))
        sequences[:, anchor] = branches[anchor]
        for order in (range(anchor + 1, len(branches)), range(anchor - 1, -1, -1)):
            previous = branches[anchor]
            for index in order:
                step = branches[index][None, :, :] - previous[:, None, :]
                step -= 2 * np.pi * np.round(step / (2 * np.pi))
                size = np.max(np.abs(step), axis=2)
                nearest = np.argmin(np.where(np.isnan(size), np.inf, size), axis=1)
                previous = previous + step[np.arange(len(previous)), nearest]
                sequences[:, index] = previous
        jump = np.max(np.abs(np.diff(sequences, axis=1)), axis=(1, 2))
        for sequence in sequences[jump <= BRANCH_JUMP]:  # NaN compares false
            yield from self._turned(sequence)

    def _turned(self, sequence: Array) -> Iterator[Array]:
        """Yield the copies of a sequence (N, 6), shifted by whole turns, that hold the limits."""
        low = np.min(sequence, axis=0)
        high = np.max(sequence, axis=0)
        first = np.ceil((self.robot.lower - low) / (2 * np.pi) - 1e-9)
        last = np.floor((self.robot.upper - high) / (2 * np.pi) + 1e-9)
        if np.any(last < first):
            return
        self._clock.within_limits = True
        axes = [np.arange(a, b + 1) for a, b in zip(first, last, strict=True)]
        for turns in np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 6):
            yield sequence + 2 * np.pi * turns

    def _joint_time(self, q_from: Array, q_to: Array) -> Array:
        """Return the least time of joint moves (..., 6) at the velocity limits [s]."""
        return np.asarray(np.max(np.abs(q_to - q_from) / self.robot.velocity, axis=-1))

    def _combine(self, q_home: Array, picks: list[_Track], places: list[_Track]) -> CyclePlan | str:
        """Return the quickest free combination, or what blocked the last one tried."""
        pick_first = np.array([track.q[0] for track in picks])
        pick_last = np.array([track.q[-1] for track in picks])
        place_first = np.array([track.q[0] for track in places])
        cost = (
            self._joint_time(q_home, pick_first)[:, None]
            + self._joint_time(pick_last[:, None], place_first[None])
            + self._joint_time(place_first, q_home)[None]
            + np.array([self._line_time(track) for track in picks])[:, None]
            + np.array([2 * self._line_time(track) for track in places])[None]
        )
        return self._first_free(q_home, picks, places, np.argsort(cost, axis=None, kind="stable"))

    def _line_time(self, track: _Track) -> float:
        return float(np.sum(self._joint_time(track.q[:-1], track.q[1:])))

    def _first_free(
        self, q_home: Array, picks: list[_Track], places: list[_Track], order: Array
    ) -> CyclePlan | str:
        pick_legs: dict[int, dict[str, Leg] | str] = {}
        place_legs: dict[int, dict[str, Leg] | str] = {}
        blocked_by = "nothing tried"
        for pair in order[:MAX_TRIALS]:
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
            return self._finish(pick | {transfer.stage: transfer} | place, picks[i], places[j])
        return blocked_by

    def _pick_legs(self, q_home: Array, track: _Track) -> dict[str, Leg] | str:
        lines = (
            ("APPROACH", 0, Hand.AROUND),
            ("LIFT", 1, Hand.LIFTING),
            ("WITHDRAW", 2, Hand.LIFTING),
        )
        legs = {}
        for stage, number, hand in lines:
            q = track.part(number)
            if what := self.oracle.blocked(q, hand=hand, clearance=CLEARANCE_CELL):
                return f"{what} in {stage}"
            legs[stage] = Leg(stage=stage, path=Path.through(q, self.robot.velocity), straight=True)
        move = self._move("MOVE_TO_PICK", q_home, track.q[0], Hand.EMPTY)
        return move if isinstance(move, str) else {move.stage: move} | legs

    def _place_legs(self, q_home: Array, track: _Track) -> dict[str, Leg] | str:
        if what := self.oracle.blocked(track.q, hand=Hand.HOLDING, clearance=CLEARANCE_FREE):
            return f"{what} in LOWER"
        move = self._move("MOVE_HOME", track.q[0], q_home, Hand.RELEASED)
        if isinstance(move, str):
            return move
        lower = Path.through(track.q, self.robot.velocity)
        retreat = Path.through(track.q[::-1], self.robot.velocity)
        return {
            "LOWER": Leg(stage="LOWER", path=lower, straight=True),
            "RETREAT": Leg(stage="RETREAT", path=retreat, straight=True),
            move.stage: move,
        }

    def _move(self, stage: str, q_from: Array, q_to: Array, hand: Hand) -> Leg | str:
        """Return a free joint move, straight if possible, else the least bulge that is free."""
        bulges = self._bulges(q_from, q_to)
        what: str | None = None
        for inward, upward in DETOURS:
            offset = inward * bulges[0] + upward * bulges[1]
            path = self._bulging(q_from, q_to, offset)
            q = path.samples(CHECK_STEP)
            if np.any(q < self.robot.lower) or np.any(q > self.robot.upper):
                continue
            what = self.oracle.blocked(q, hand=hand, clearance=CLEARANCE_FREE)
            if what is None:
                return Leg(stage=stage, path=path, straight=False)
        return f"{what} in {stage}"

    def _bulges(self, q_from: Array, q_to: Array) -> Array:
        """Return joint displacements (2, 6) that move the TCP 1 m towards axis 1, and 1 m up.

        Damped least squares on the Jacobian at mid-move, with the tool's orientation kept.
        """
        middle = (q_from + q_to) / 2
        jacobian = ik.jacobian(self.robot.geometry, middle)
        p = self.robot.forward(middle)[:3, 3]
        twists = np.zeros((2, 6))
        twists[0, :2] = -p[:2] / max(float(np.hypot(p[0], p[1])), 1e-6)
        twists[1, 2] = 1.0
        damped = jacobian @ jacobian.T + 1e-2 * np.eye(6)
        return np.asarray(np.linalg.solve(damped, twists.T).T @ jacobian)

    def _bulging(self, q_from: Array, q_to: Array, offset: Array) -> Path:
        if not np.any(offset):
            return Path.straight(q_from, q_to)
        u = np.linspace(0.0, 1.0, 41)[:, None]
        q = q_from + u * (q_to - q_from) + 4 * u * (1 - u) * offset
        return Path.through(q, self.robot.velocity)

    def _finish(self, legs: dict[str, Leg], pick: _Track, place: _Track) -> CyclePlan:
        solved = SolvedPoses(
            T_base_palm=np.concatenate([pick.T_base_palm, place.T_base_palm]),
            q=np.concatenate([pick.q, place.q]),
        )
        return CyclePlan(
            legs=legs,
            solved=solved,
            p_base_release=self.robot.forward(place.q[-1])[:3, 3],
            ik_seconds=self._clock.seconds,
            ik_poses=self._clock.poses,
        )
