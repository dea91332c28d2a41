"""The legs of a cycle: lines through solved poses; joint moves straight, detoured or sampled."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from enum import Enum
from itertools import pairwise
from typing import Protocol

import numpy as np

import ik
from kr210_sim import sampling
from kr210_sim.arrays import Array
from kr210_sim.path import Path
from kr210_sim.robot import Robot

CLEARANCE_CELL = 0.004
"""Kept to cell and target on the straight lines in and out [m]."""

DETOURS = np.array(
    [(0.2, 0.0), (0.4, 0.0), (0.4, 0.2), (0.6, 0.0), (0.6, 0.3), (0.8, 0.2), (0.9, 0.0)]
)
"""Detours tried on a joint move, (towards axis 1, upwards) at mid-move [m], least first."""

SAMPLED_CONFIGURATIONS = 12_000
"""Configurations one sampled move may check before it is given up."""

CYCLE_CONFIGURATIONS = 36_000
"""Configurations all sampled moves of a cycle may check."""


class Hand(Enum):
    """What the gripper and the target do during a leg, for the clearance check."""

    EMPTY = "open, the target standing in its cell"
    AROUND = "open, the fingers passing the target"
    LIFTING = "closed on the target, which may touch its support"
    HOLDING = "closed on the target"
    RELEASED = "open, the target gone"


@dataclass(frozen=True, kw_only=True)
class Question:
    """Whether a path keeps a clearance.

    Attributes:
        q: (N, 6) configurations; the path is the polyline through them [rad].
        hand: what the gripper and the target do meanwhile.
        clearance: to keep to everything else [m].
    """

    q: Array
    hand: Hand
    clearance: float


class ClearanceOracle(Protocol):
    """What planning asks of the world."""

    def blocked(self, q: Array, *, hand: Hand, clearance: float) -> str | None:
        """Return None if the path keeps that clearance [m] everywhere, else what is near.

        The path is the polyline through configurations (N, 6), the straight pieces included.
        """
        ...

    def blocked_each(self, questions: Sequence[Question]) -> list[str | None]:
        """Return what `blocked` does, of each of some paths."""
        return [self.blocked(one.q, hand=one.hand, clearance=one.clearance) for one in questions]

    def first_free(self, choices: Sequence[Sequence[Question]]) -> list[int | str]:
        """Return of each choice of paths the number of the first that is free.

        Where none is, what is near the last of them; nothing, if there is none.
        """
        found: list[int | str] = []
        for choice in choices:
            found.append("")
            for number, one in enumerate(choice):
                near = self.blocked(one.q, hand=one.hand, clearance=one.clearance)
                found[-1] = number if near is None else near
                if near is None:
                    break
        return found


@dataclass(frozen=True, kw_only=True)
class Leg:
    """A joint path, the stage it belongs to, and what it was checked for.

    Attributes:
        stage: one of `record.STAGES`; a detour makes several legs of one stage.
        path: the geometry.
        hand: what the gripper and the target do meanwhile.
        clearance: kept to everything else [m].
        sampled: whether it comes from the sampling planner.
    """

    stage: str
    path: Path
    hand: Hand
    clearance: float
    sampled: bool = False


@dataclass(frozen=True, kw_only=True)
class Blocked:
    """Why there is no leg.

    Attributes:
        stage: of the leg.
        what: is in the way, one clause.
        final: whether another path between the same configurations is out of the question.
    """

    stage: str
    what: str
    final: bool = True

    def __str__(self) -> str:
        return f"{self.what} in {self.stage}"


@dataclass(frozen=True, kw_only=True)
class Wanted:
    """A leg that is wanted.

    Attributes:
        stage: it belongs to.
        q: (N, 6) [rad]: poses solved along a line of the TCP, or the two ends of a joint move.
        hand: what the gripper and the target do meanwhile.
        clearance: to keep to everything else [m].
        is_move: whether the path between the ends is free to choose.
    """

    stage: str
    q: Array
    hand: Hand
    clearance: float
    is_move: bool = False

    @property
    def key(self) -> tuple[str, bytes]:
        """What tells it from other wishes of one cycle."""
        return self.stage, self.q.tobytes()

    def asks(self, q: Array) -> Question:
        """Return whether a path (N, 6) does as a path for this wish."""
        return Question(q=q, hand=self.hand, clearance=self.clearance)

    @classmethod
    def move(cls, stage: str, q_from: Array, q_to: Array, hand: Hand, clearance: float) -> Wanted:
        """Return the wish for a joint move between two configurations (6,)."""
        q = np.array([q_from, q_to])
        return cls(stage=stage, q=q, hand=hand, clearance=clearance, is_move=True)


class LegFinder:
    """Finds the legs of one cycle, each once: many combinations of pick and place share them.

    Args:
        robot: limits and geometry.
        oracle: answers for clearance.
        seed: of everything that is left to chance.
    """

    def __init__(self, robot: Robot, oracle: ClearanceOracle, seed: int) -> None:
        self._robot, self._oracle = robot, oracle
        self._seeds = np.random.SeedSequence(seed)
        self._budget = CYCLE_CONFIGURATIONS
        self._found: dict[tuple[str, bytes], list[Leg] | Blocked] = {}
        self._lines: dict[bytes, Path] = {}

    def find(self, wanted: Wanted) -> list[Leg] | Blocked:
        """Return the legs that fulfil a wish, or what blocks it; nothing is sampled yet."""
        return self.find_each([wanted])[0]

    def find_each(self, wishes: Sequence[Wanted]) -> list[list[Leg] | Blocked]:
        """Return what `find` does of each wish, up to the first that is known to be blocked.

        All that is not known yet is asked together, which takes a fraction of the time.
        """
        worth_asking: list[Wanted] = []
        for wanted in wishes:
            worth_asking.append(wanted)
            known = self._found.get(wanted.key)
            if isinstance(known, Blocked) and known.final:
                break
        if unknown := [wanted for wanted in worth_asking if wanted.key not in self._found]:
            self._search(unknown)
        return [self._found[wanted.key] for wanted in worth_asking]

    def sample(self, wanted: Wanted) -> list[Leg] | Blocked:
        """Return the legs of a move by sampling if `find` has no answer that is final."""
        known = self.find(wanted)
        if not isinstance(known, Blocked) or known.final:
            return known
        answer = self._sampled(wanted, known)
        self._found[wanted.key] = answer
        return answer

    def _search(self, wishes: Sequence[Wanted]) -> None:
        """Find lines, and of each move the straight one if it is free, else the least detour."""
        detours = iter(self._detours([wanted.q for wanted in wishes if wanted.is_move]))
        ways = [[wanted.q, *(next(detours) if wanted.is_move else ())] for wanted in wishes]
        answers = self._oracle.first_free(
            [
                [wanted.asks(way) for way in of_one]
                for wanted, of_one in zip(wishes, ways, strict=True)
            ]
        )
        for wanted, of_one, answer in zip(wishes, ways, answers, strict=True):
            if isinstance(answer, str):
                self._found[wanted.key] = self._blocked(wanted, answer)
            else:
                self._found[wanted.key] = self._legs(of_one[answer], wanted)

    def _blocked(self, wanted: Wanted, what: str) -> Blocked:
        """Return what blocks a wish: final if it is no move, or a move that an end blocks."""
        if not wanted.is_move:
            return Blocked(stage=wanted.stage, what=what)
        ends = self._oracle.blocked_each([wanted.asks(q[None]) for q in wanted.q])
        for name, near in zip(("start", "end"), ends, strict=True):
            if near is not None:
                return Blocked(stage=wanted.stage, what=f"{near} already at the {name}")
        return Blocked(stage=wanted.stage, what=what, final=False)

    def _detours(self, moves: Sequence[Array]) -> list[list[Array]]:
        """Return of each move (2, 6) the ways (3, 6) around what blocks it, the least first."""
        if not moves:
            return []
        middle = np.mean(moves, axis=1)
        vias = middle[:, None] + DETOURS @ self._bulges(middle)
        within = ik.within_limits(vias, self._robot.lower, self._robot.upper)
        # The trajectory rounds a corner only as far as its inside is free, too.
        return [
            [np.array([q_from, via, q_to]) for via in of_move[counts]]
            for (q_from, q_to), of_move, counts in zip(moves, vias, within, strict=True)
        ]

    def _legs(self, q: Array, wanted: Wanted) -> list[Leg]:
        """Return the legs along a path (N, 6) that is free."""
        if wanted.is_move:
            return self._straight(q, wanted)
        there = self._lines.get(q[::-1].tobytes())
        path = Path.through(q, self._robot.velocity) if there is None else there.reversed()
        self._lines[q.tobytes()] = path
        return [_leg(wanted, path)]

    def _sampled(self, wanted: Wanted, blocked: Blocked) -> list[Leg] | Blocked:
        """Return a move that goes around what blocked the cheap ones."""
        if not sampling.available():
            return replace(blocked, what=f"{blocked.what} ({sampling.REMEDY})", final=True)
        query = sampling.Query(
            q_from=wanted.q[0],
            q_to=wanted.q[1],
            lower=self._robot.lower,
            upper=self._robot.upper,
            velocity=self._robot.velocity,
            free=lambda q: self._near(q, wanted) is None,
        )
        budget = sampling.Budget(min(SAMPLED_CONFIGURATIONS, self._budget))
        self._budget -= budget.left
        rng = np.random.default_rng(self._seeds.spawn(1)[0])
        corners = sampling.sample_path(query, rng, budget)
        self._budget += max(0, budget.left)
        if corners is None:
            what = f"{blocked.what}, and sampling found no way around it"
            return Blocked(stage=wanted.stage, what=what)
        return self._straight(corners, wanted, sampled=True)

    def _near(self, q: Array, wanted: Wanted) -> str | None:
        return self._oracle.blocked(q, hand=wanted.hand, clearance=wanted.clearance)

    def _straight(self, corners: Array, wanted: Wanted, *, sampled: bool = False) -> list[Leg]:
        """Return the straight legs between corners (N, 6)."""
        return [
            _leg(wanted, Path.straight(a, b, self._robot.velocity), sampled=sampled)
            for a, b in pairwise(corners)
        ]

    def _bulges(self, q: Array) -> Array:
        """Return joint displacements (N, 2, 6) that move the TCP 1 m towards axis 1, and 1 m up.

        Damped least squares on the Jacobian at configurations (N, 6), with the tool's orientation
        kept.
        """
        jacobian = ik.jacobian(self._robot.geometry, q)
        p = self._robot.forward(q)[:, :2, 3]
        twists = np.zeros((len(q), 6, 2))
        twists[:, :2, 0] = -p / np.maximum(np.hypot(*p.T), 1e-6)[:, None]
        twists[:, 2, 1] = 1.0
        damped = jacobian @ jacobian.swapaxes(1, 2) + 1e-2 * np.eye(6)
        return np.asarray(np.linalg.solve(damped, twists).swapaxes(1, 2) @ jacobian)


def _leg(wanted: Wanted, path: Path, *, sampled: bool = False) -> Leg:
    return Leg(
        stage=wanted.stage,
        path=path,
        hand=wanted.hand,
        clearance=wanted.clearance,
        sampled=sampled,
    )
