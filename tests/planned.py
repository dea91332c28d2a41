"""Plans in worlds made up of answers: free, walled, with a door, with a pillar."""

from __future__ import annotations

from itertools import groupby

import numpy as np
import pytest

from kr210_sim.exceptions import CycleFailure
from kr210_sim.planning import (
    ClearanceOracle,
    CyclePlan,
    CyclePlanner,
    Hand,
    Leg,
)
from kr210_sim.task import pick_options, place_options, release_point

FINE = np.linspace(0.0, 1.0, 801)
HOME = np.zeros(6)


def legs_of(plan: CyclePlan) -> list[Leg]:
    return [leg for motion in plan.motions for leg in motion]


def stages_of(plan: CyclePlan) -> tuple[str, ...]:
    """Return the stages in order, each once however many legs it has in a row."""
    return tuple(stage for stage, _ in groupby(leg.stage for leg in legs_of(plan)))


def leg_of(plan: CyclePlan, stage: str) -> Leg:
    """Return the only leg of a stage."""
    (found,) = (leg for leg in legs_of(plan) if leg.stage == stage)
    return found


def along(leg: Leg, share: np.ndarray = FINE) -> np.ndarray:
    """Return configurations (N, 6) at shares of a leg's length."""
    return leg.path(share * leg.path.length)


class Free(ClearanceOracle):
    """A world without obstacles that remembers what it was asked."""

    def __init__(self) -> None:
        self.asked: list[tuple[np.ndarray, Hand, float]] = []

    def blocked(self, q, *, hand, clearance):
        self.asked.append((np.array(q), hand, clearance))
        return self.answer(hand)

    def answer(self, hand: Hand) -> str | None:
        return None


class Wall(Free):
    """A world in which one kind of motion, or every one, always meets a wall."""

    def __init__(self, hand: Hand | None = None) -> None:
        super().__init__()
        self.hand = hand

    def answer(self, hand: Hand) -> str | None:
        return "a wall" if self.hand in (None, hand) else None


class Doorway(Free):
    """A world that lets a motion through only when it is tried for the n-th time."""

    def __init__(self, hand: Hand, tries: int) -> None:
        super().__init__()
        self.hand, self.left = hand, tries

    def answer(self, hand: Hand) -> str | None:
        self.left -= hand is self.hand
        return "a closed door" if hand is self.hand and self.left > 0 else None


class Detour(Free):
    """A world in which no joint move of one kind is free when it is straight."""

    def __init__(self, hand: Hand) -> None:
        super().__init__()
        self.hand, self.passed = hand, np.empty((0, 6))

    def blocked(self, q, *, hand, clearance):
        q = np.array(q)
        chord = q[-1] - q[0]
        aside = q - q[0] - np.outer((q - q[0]) @ chord / max(chord @ chord, 1e-12), chord)
        if hand is self.hand and len(q) > 1 and np.max(np.abs(aside)) < 1e-6:
            return "a pillar"
        self.passed = q if hand is self.hand else self.passed
        return None


def plan_in(scene, oracle, cell=5, *, lift_target=0.0, shift_place=0.0, robot=None, **options):
    T_base_target = scene.stand_in_cell(cell, 0.25)
    T_base_target[2, 3] += lift_target
    place = scene.place
    release = release_point(place.T_base_place, place.half_size, place.kind, 0.25, [])
    release[2] += shift_place
    return CyclePlanner(robot or scene.robot, oracle, **options).plan(
        q_home=HOME,
        picks=pick_options(T_base_target, scene.cell(cell).T_base_cell),
        places=place_options(release),
    )


def failure_of(scene, oracle, **options) -> CycleFailure:
    with pytest.raises(CycleFailure) as caught:
        plan_in(scene, oracle, **options)
    return caught.value
