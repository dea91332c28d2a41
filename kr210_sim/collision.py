"""The clearance oracle that planning asks, answered by MuJoCo's own collision detection."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from kr210_sim import pairs
from kr210_sim.advance import Room, advance, advance_each
from kr210_sim.arrays import Array
from kr210_sim.criteria import CLEARANCE_CAP
from kr210_sim.legs import Hand, Question
from kr210_sim.looks import Eyes
from kr210_sim.pairs import TOLERANCE
from kr210_sim.scene import Scene, Target
from kr210_sim.simulation import Simulation

_GAUGE = 3e-3
"""Uncertainty of a clearance that is measured [m]."""


class MujocoOracle:
    """Clearance of the arm, gripper and held target to everything else in a simulated world.

    It answers for the state of the world at the moment it is made: targets that lie in the bin are
    obstacles where they lie.
    """

    def __init__(self, simulation: Simulation, scene: Scene, target: Target) -> None:
        self._eyes = Eyes(simulation, scene, target)

    @property
    def looks(self) -> int:
        """Number of configurations looked at so far."""
        return self._eyes.looks

    @property
    def batches(self) -> int:
        """Number of batches in which they were looked at."""
        return self._eyes.calls

    def blocked(self, q: Array, *, hand: Hand, clearance: float) -> str | None:
        """Return None if a path keeps a clearance everywhere, else what is near.

        Args:
            q: (N, 6) configurations; the path is the polyline through them [rad].
            hand: what the gripper and the target do.
            clearance: kept to everything else [m], at most CLEARANCE_CAP.
        """
        return self.blocked_each([Question(q=q, hand=hand, clearance=clearance)])[0]

    def blocked_each(self, questions: Sequence[Question]) -> list[str | None]:
        """Return what `blocked` would of each of some paths, in a fraction of the time."""
        answers = self.first_free([[question] for question in questions])
        return [answer if isinstance(answer, str) else None for answer in answers]

    def first_free(self, choices: Sequence[Sequence[Question]]) -> list[int | str]:
        """Return of each choice of paths the number of the first that is free.

        Where none is, what is near the last of them; nothing, if there is none.
        """
        questions = [question for choice in choices for question in choice]
        choice_of = np.repeat(np.arange(len(choices)), [len(choice) for choice in choices])
        hands = np.array([pairs.HANDS[question.hand] for question in questions])
        clearances = [question.clearance for question in questions]
        required = np.array([[-np.inf, pairs.SELF_CLEARANCE, kept] for kept in clearances])
        what = [""] * len(questions)

        def look(q: Array, which: NDArray[np.int64]) -> tuple[Room, NDArray[np.bool_]]:
            asked = required[which]
            seen = self._eyes.see(q, hands[which], asked)
            excess = seen.distance - asked[seen.row, seen.kind]
            near = np.zeros(len(q), dtype=bool)
            near[seen.row[excess < TOLERANCE]] = True
            for row in near.nonzero()[0]:
                here = np.flatnonzero(seen.row == row)
                nearest = here[np.argmin(excess[here])]
                names = (self._eyes.name(int(geom)) for geom in seen.geoms[nearest])
                distance = f" within {1000 * seen.distance[nearest]:.0f} mm of "
                what[which[row]] = what[which[row]] or distance.join(names)
            return pairs.room(seen, excess, asked[:, pairs.FREE]), near

        free = advance_each([question.q for question in questions], look, choice_of)
        found: list[int | str] = []
        passed, end = free.tolist(), 0
        for choice in choices:
            begin, end = end, end + len(choice)
            near = "".join(what[end - 1 : end])
            is_any = any(passed[begin:end])
            found.append(passed.index(True, begin) - begin if is_any else near)
        return found

    def least(self, q: Array, *, hand: Hand) -> float:
        """Return the least clearance along a path [m], CLEARANCE_CAP if it is more.

        It is a distance that was found; none on the path is less by more than 3 mm. Distances
        within the robot and what it holds do not count.

        Args:
            q: (N, 6) configurations; the path is the polyline through them [rad].
            hand: what the gripper and the target do.
        """
        best = CLEARANCE_CAP

        def look(q: Array) -> Room:
            nonlocal best
            hands = np.full(len(q), pairs.HANDS[hand])
            seen = self._eyes.see(q, hands, np.tile([-np.inf, -np.inf, best], (len(q), 1)))
            counts = seen.pair < pairs.WITHIN
            best = min(best, float(np.min(seen.distance, initial=best, where=counts)))
            required = np.full(len(q), best - _GAUGE)
            excess = seen.distance - required[0]
            return pairs.room(seen, excess, required, within=False)

        advance(q, look)
        return best
