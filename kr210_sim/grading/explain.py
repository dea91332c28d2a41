"""The smallest set of known mistakes that explains the answers of a solver."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np

from kr210_sim.arrays import Array
from kr210_sim.grading.mistakes import (
    Made,
    Mistake,
    Sample,
    arm_error,
    arm_mistakes,
    length_mistakes,
    units,
    wrist_error,
    wrist_mistakes,
)

FLANGE = 0.110
"""From link_6 to gripper_link along x [m]."""

ARM_TOLERANCE = 1e-3
"""Wrist centers that agree within this are explained [m]."""

WRIST_TOLERANCE = 1e-3
"""Orientations that agree within this are explained [rad]."""

SHARE = 0.9
"""An explanation holds for at least this share of the answers, in front of the arm and behind."""

FEW = 3
"""Fewer answers than this tell nothing by themselves [1]."""

LEAST = 0.1
"""Share of the answers that an explanation must say something about: a mistaken wrist center that
is out of reach says nothing [1]."""

_FIRST = 8
"""Answers of each group on which a set of mistakes is tried first [1]."""


@dataclass(frozen=True, kw_only=True)
class Explained:
    """What explains the answers: of angles 1 to 3, and of angles 4 to 6; None where nothing does.

    Attributes:
        unit: mistakes of the unit.
        arm: mistakes that show in angles 1 to 3.
        wrist: mistakes that show in angles 4 to 6.
        behind: wrong answers and all answers behind the arm where it holds in front alone.
    """

    unit: Made
    arm: Made | None
    wrist: Made | None
    behind: tuple[int, int] | None = None

    @property
    def made(self) -> list[Mistake]:
        """All mistakes, each once per key; those of the arm tell more."""
        by_key: dict[str, Mistake] = {}
        for mistake in (*self.unit, *(self.arm or ()), *(self.wrist or ())):
            by_key.setdefault(mistake.key, mistake)
        return list(by_key.values())

    @property
    def rank(self) -> tuple[int, int]:
        """The fewer keys the better, then the fewer different models."""
        texts = {mistake.text for mistake in (*(self.arm or ()), *(self.wrist or ()))}
        return len(self.made), len(texts)

    @property
    def scale(self) -> float:
        """What brings the answers to radians."""
        return float(np.prod([mistake.unit for mistake in self.unit]))


def explain(sample: Sample) -> Explained:
    """Return the smallest explanation; one of half the angles if there is none of all."""
    front = sample.center[:, 0] > 0.0
    everywhere = _explain_all(sample, front)
    if everywhere.arm is not None and everywhere.wrist is not None:
        return everywhere
    if min(front.sum(), (~front).sum()) >= FEW:
        ahead, back = sample.of(front), sample.of(~front)
        partly = _explain_all(ahead, np.ones(len(ahead.q), dtype=bool))
        if partly.arm is not None and partly.wrist is not None:
            back = replace(back, q=partly.scale * back.q)
            wrong = wrong_answers(back, partly)
            if wrong.mean() >= 0.5:
                return replace(partly, behind=(int(wrong.sum()), len(wrong)))
    return everywhere


def _explain_all(sample: Sample, front: Array) -> Explained:
    """Return the smallest explanation that holds in front and behind; front is (N,) of bool."""
    found: list[Explained] = []
    for unit in _units(sample.q):
        scale = float(np.prod([mistake.unit for mistake in unit]))
        search = _Search(replace(sample, q=scale * sample.q), front)
        arms = search.sets(arm_mistakes(sample.arm, sample.tool, FLANGE), arm_error, ARM_TOLERANCE)
        arms = arms or search.sets(search.lengths(), arm_error, ARM_TOLERANCE)
        wrists = search.sets(wrist_mistakes(sample.arm), wrist_error, WRIST_TOLERANCE)
        both = [Explained(unit=unit, arm=a, wrist=w) for a in arms for w in wrists]
        if both:
            return min(both, key=lambda item: item.rank)
        found.append(
            Explained(unit=unit, arm=next(iter(arms), None), wrist=next(iter(wrists), None))
        )
    return found[0]


def _units(q: Array) -> list[Made]:
    """Return what the unit may be: radians, and another where the angles are of its size."""
    largest = np.max(np.abs(q))
    return [(), *((mistake,) for mistake in units() if 0.5 < mistake.unit * largest < 4 * np.pi)]


class _Search:
    """Looks for sets of at most two mistakes that explain one half of the angles.

    Args:
        sample: the answers, in radians.
        front: (N,) whether the wrist center is in front of the arm.
    """

    def __init__(self, sample: Sample, front: Array) -> None:
        self._sample, self._front = sample, front
        # Most sets fail for a few answers already, which is faster to find out.
        groups = [rows for rows in map(np.flatnonzero, (front, ~front)) if len(rows)]
        self._few = sample.of(
            np.concatenate([rows[:: max(1, len(rows) // _FIRST)] for rows in groups])
        )

    def lengths(self) -> list[Mistake]:
        """Return the lengths that may be wrong."""
        return length_mistakes(self._sample)

    def sets(
        self,
        mistakes: Sequence[Mistake],
        error: Callable[[Sample, Made], Array],
        tolerance: float,
    ) -> list[Made]:
        """Return the sets that hold, the smaller ones first; nothing but () where that holds."""
        found = []
        for made in _sets(mistakes):
            if _share(error(self._few, made), tolerance) < 0.5:
                continue
            if _holds(error(self._sample, made), self._front, tolerance):
                found.append(made)
                if not made:
                    break
        return found


def _holds(errors: Array, front: Array, tolerance: float) -> bool:
    """Tell whether an explanation holds in front and behind, from its errors (N,)."""
    counting = np.isfinite(errors)
    if counting.sum() < LEAST * len(errors):
        return False
    groups = [group for group in (counting & front, counting & ~front) if group.sum() >= FEW]
    return all(_share(errors[group], tolerance) >= SHARE for group in groups or [counting])


def _share(errors: Array, tolerance: float) -> float:
    """Return the share within a tolerance of the answers that count, 1 if none does."""
    counting = errors[np.isfinite(errors)]
    return float(np.mean(counting <= tolerance)) if len(counting) else 1.0


def wrong_answers(sample: Sample, explained: Explained) -> Array:
    """Return which answers are not explained, (N,)."""
    off = arm_error(sample, explained.arm or ())
    turned = wrist_error(sample, explained.wrist or ())
    return np.asarray((off > ARM_TOLERANCE) | (turned > WRIST_TOLERANCE))


def _sets(mistakes: Sequence[Mistake]) -> Iterator[Made]:
    yield ()
    yield from ((mistake,) for mistake in mistakes)
    for one, other in combinations(mistakes, 2):
        if one.key != other.key:
            yield one, other
