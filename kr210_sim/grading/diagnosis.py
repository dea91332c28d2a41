"""Which known mistakes explain the answers of a solver, each in one sentence with its evidence."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from itertools import combinations

import numpy as np

import ik
from kr210_sim.arrays import Array
from kr210_sim.grading.mistakes import (
    Made,
    Mistake,
    Sample,
    arm_error,
    arm_mistakes,
    undone,
    units,
    wrist_error,
    wrist_mistakes,
)
from kr210_sim.grading.source import FRAMES
from kr210_sim.grading.steps import Step, beyond_limits, needless_steps

DOCUMENT = "docs/diagnoses.md"
"""Has a section for every key."""

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

MOST = 160
"""More answers than this are thinned out evenly [1]."""

_FIRST = 8
"""Answers of each group on which a set of mistakes is tried first [1]."""

LegAnswers = tuple[Array, Array, Array]
"""T_base_palm (N, 4, 4), q_start (6,) and q (N, 6) of one leg; a row of NaN is no answer."""


@dataclass(frozen=True, kw_only=True)
class Diagnosis:
    """One mistake that was found.

    Attributes:
        key: stable name; the section of DOCUMENT.
        text: one sentence with the evidence.
    """

    key: str
    text: str

    @property
    def page(self) -> str:
        """Where to read on."""
        return f"{DOCUMENT}#{self.key}"

    def as_json(self) -> dict[str, str]:
        """Return it as plain JSON values."""
        return asdict(self) | {"page": self.page}


@dataclass(frozen=True, kw_only=True)
class _Explained:
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


def diagnose(
    legs: Sequence[LegAnswers],
    lower: Array,
    upper: Array,
    *,
    probes: tuple[Array, Array] | None = None,
    arm: ik.Arm = ik.KR210,
    frame: str = FRAMES[0],
) -> list[Diagnosis]:
    """Name the smallest set of known mistakes that explains the answers.

    Args:
        legs: requests and answers in the order of the motion.
        lower: (6,) joint limits [rad].
        upper: (6,) upper joint limits [rad].
        probes: T_base_palm (M, 4, 4) and answers (M, 6) of poses that were asked one by one.
        arm: the right geometry, its tool at gripper_link.
        frame: whose poses the solver was sent; T_base_palm is that of gripper_link all the same.

    Returns:
        No diagnosis where every answer is right, within limits, and none takes a needless step.
    """
    sample, poses, answered = _sample(legs, probes, arm, frame)
    if np.all(sample.q == sample.q[:1]) and len(sample.q) != 1:  # none, or a template
        return []
    explained = _explain(sample)
    largest = float(np.max(np.abs(sample.q)))
    scaled = replace(sample, q=explained.scale * sample.q)
    found = [_told(mistake, explained, scaled, largest) for mistake in explained.made]
    found += _behind(explained, poses, answered)
    angles = [(leg[1], undone(explained.scale * leg[2], explained.arm or ())) for leg in legs]
    found += _steps(arm, lower, upper, angles, {item.key for item in found})
    if not (explained.arm or explained.wrist):  # else it may follow from them
        found += _limits(lower, upper, [q for _, q in angles])
    found += _unexplained(explained, scaled)
    return found


def _sample(
    legs: Sequence[LegAnswers], probes: tuple[Array, Array] | None, arm: ik.Arm, frame: str
) -> tuple[Sample, Array, Array]:
    """Return answers to explain, thinned out; and all wrist centers and whether answered."""
    pairs = [(T, q) for T, _, q in legs]
    kept = [*pairs, *([probes] if probes else [])]
    T = np.concatenate([np.empty((0, 4, 4)), *(T for T, _ in kept)])
    q = np.concatenate([np.empty((0, 6)), *(q for _, q in kept)])
    known = np.all(np.isfinite(q), axis=1)
    rows = np.flatnonzero(known)
    in_legs = rows[rows < sum(len(answers) for _, answers in pairs)]
    if len(in_legs) > MOST:
        thin = in_legs[np.linspace(0, len(in_legs) - 1, MOST).astype(int)]
        rows = np.concatenate([thin, rows[len(in_legs) :]])
    tool = float(arm.T_tool[0, 3]) - (FLANGE if frame == "link_6" else 0.0)
    sent = T[:, :3, 3] - (float(arm.T_tool[0, 3]) - tool) * T[:, :3, 0]
    sample = Sample(p=sent[rows], R=T[rows, :3, :3], q=q[rows], tool=tool, arm=arm)
    return sample, ik.wrist_center(arm, T), known


def _explain(sample: Sample) -> _Explained:
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
            wrong = _wrong(back, partly)
            if wrong.mean() >= 0.5:
                return replace(partly, behind=(int(wrong.sum()), len(wrong)))
    return everywhere


def _explain_all(sample: Sample, front: Array) -> _Explained:
    """Return the smallest explanation that holds in front and behind; front is (N,) of bool."""
    found: list[_Explained] = []
    for unit in _units(sample.q):
        scale = float(np.prod([mistake.unit for mistake in unit]))
        search = _Search(replace(sample, q=scale * sample.q), front)
        arms = search.sets(arm_mistakes(sample.arm, sample.tool, FLANGE), arm_error, ARM_TOLERANCE)
        wrists = search.sets(wrist_mistakes(sample.arm), wrist_error, WRIST_TOLERANCE)
        both = [_Explained(unit=unit, arm=a, wrist=w) for a in arms for w in wrists]
        if both:
            return min(both, key=lambda item: item.rank)
        found.append(
            _Explained(unit=unit, arm=next(iter(arms), None), wrist=next(iter(wrists), None))
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
        groups = [np.flatnonzero(group) for group in (front, ~front)]
        self._groups = [group for group in groups if len(group) >= FEW] or [np.arange(len(front))]
        self._sample = sample
        # Most sets fail for a few answers already, which is faster to find out.
        first = [group[:: max(1, len(group) // _FIRST)] for group in self._groups]
        self._few = sample.of(np.concatenate(first))
        self._ends = np.cumsum([len(rows) for rows in first])[:-1]

    def sets(
        self,
        mistakes: Sequence[Mistake],
        error: Callable[[Sample, Made], Array],
        tolerance: float,
    ) -> list[Made]:
        """Return the sets that hold, the smaller ones first; nothing but () where that holds."""
        found = []
        for made in _sets(mistakes):
            tried = np.split(error(self._few, made), self._ends)
            if any(_share(errors, tolerance) < 0.5 for errors in tried):
                continue
            errors = error(self._sample, made)
            if all(_share(errors[group], tolerance) >= SHARE for group in self._groups):
                found.append(made)
                if not made:
                    break
        return found


def _share(errors: Array, tolerance: float) -> float:
    """Return the share within a tolerance of the answers that count, 0 if they are too few."""
    counting = np.isfinite(errors)
    if 2 * counting.sum() < len(errors):
        return 0.0
    return float(np.mean(errors[counting] <= tolerance))


def _wrong(sample: Sample, explained: _Explained) -> Array:
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


# ---- the sentences ---------------------------------------------------------------------------


def _told(mistake: Mistake, explained: _Explained, sample: Sample, largest: float) -> Diagnosis:
    """Return the sentence about a mistake; sample is in radians, largest is the answered number."""
    parts = []
    if mistake in explained.unit:
        right = int((~_wrong(sample, explained)).sum())
        parts.append(
            f"the largest number is {largest:.4g}, and taken so {right} of {len(sample.q)} answers "
            "are explained"
        )
    for made, error, tolerance, what, unit in (
        (explained.arm, arm_error, ARM_TOLERANCE, "wrist center", "m"),
        (explained.wrist, wrist_error, WRIST_TOLERANCE, "orientation", "rad"),
    ):
        others = tuple(other for other in made or () if other.key != mistake.key)
        if made and len(others) < len(made):
            before, after = error(sample, others), error(sample, made)
            parts.append(_evidence(what, before, after, tolerance, unit))
    return Diagnosis(key=mistake.key, text=f"{_upper(mistake.text)}: {'; '.join(parts)}.")


def _evidence(what: str, before: Array, after: Array, tolerance: float, unit: str) -> str:
    wrong, right = before[before > tolerance], after[after <= tolerance]
    return (
        f"otherwise the {what} is off by {np.median(wrong) if len(wrong) else 0.0:.3g} {unit} "
        f"(median) in {len(wrong)} of {len(before)} answers, with that it is right to "
        f"{max(np.median(right), 1e-15):.0e} {unit} in {len(right)}"
    )


def _upper(text: str) -> str:
    return text[:1].upper() + text[1:]


def _behind(explained: _Explained, centers: Array, answered: Array) -> list[Diagnosis]:
    """Return the diagnosis of a solver that works in front of the arm alone."""
    if any(mistake.key == "front_only" for mistake in explained.made):
        return []
    front = centers[:, 0] > 0.0
    if explained.behind is not None:
        wrong, count = explained.behind
        how = f"{wrong} of {count} answers are wrong where the wrist center has x < 0"
    elif min(front.sum(), (~front).sum()) >= FEW and (
        answered[front].mean() >= SHARE and answered[~front].mean() <= 0.5
    ):
        missing = int((~answered[~front]).sum())
        how = f"{missing} of {(~front).sum()} poses have no answer where the wrist center has x < 0"
    else:
        return []
    text = f"The solver is valid in front of the arm only: {how}, and hardly any in front."
    return [Diagnosis(key="front_only", text=text)]


_STEP_TEXTS = {
    "turn_jumps": "Joints make whole turns between neighbouring poses",
    "elbow_branch": "The answers change to the other elbow on the way",
    "wrist_branch": "The answers change to the other sign of theta 5 on the way",
    "shoulder_branch": "The answers change to the other shoulder on the way",
}


def _steps(
    arm: ik.Arm,
    lower: Array,
    upper: Array,
    legs: Sequence[tuple[Array, Array]],
    known: set[str],
) -> list[Diagnosis]:
    """Return diagnoses of needless steps, from q_start (6,) and angles (N, 6) of each leg."""
    steps: list[Step] = []
    for index, (q_start, q) in enumerate(legs):
        steps += needless_steps(arm, lower, upper, q_start, q, leg=index)
    found = []
    for kind, text in _STEP_TEXTS.items():
        of_kind = [step for step in steps if step.kind == kind]
        if of_kind and kind not in known:
            worst = max(of_kind, key=lambda step: step.moved - step.needed)
            evidence = (
                f"{len(of_kind)} of {sum(len(q) for _, q in legs)} steps; most at pose "
                f"{worst.pose} of leg {worst.leg}, where joint {worst.joint} moves "
                f"{worst.moved:.2f} rad and {worst.needed:.2f} rad would do"
            )
            found.append(Diagnosis(key=kind, text=f"{text}: {evidence}."))
    return found


def _limits(lower: Array, upper: Array, angles: Sequence[Array]) -> list[Diagnosis]:
    """Return the diagnosis of answers (N, 6) of each leg that are beyond limits."""
    q = np.concatenate([np.empty((0, 6)), *angles])
    over = beyond_limits(q, lower, upper)
    if not over.any():
        return []
    pose, joint = np.unravel_index(int(np.argmax(over)), over.shape)
    text = (
        f"{int(over.any(axis=1).sum())} of {len(q)} answers are beyond the joint limits, most "
        f"joint {joint + 1} at {q[pose, joint]:.3f} rad, allowed are {lower[joint]:.3f} to "
        f"{upper[joint]:.3f} rad."
    )
    return [Diagnosis(key="beyond_limits", text=text)]


def _unexplained(explained: _Explained, sample: Sample) -> list[Diagnosis]:
    """Return what can be said of answers that no set of known mistakes explains."""
    if explained.arm is not None and explained.wrist is not None:
        return []
    off = arm_error(sample, explained.arm or ())
    turned = wrist_error(sample, explained.wrist or ())
    wrong = _wrong(sample, explained)
    if explained.arm is not None and np.quantile(turned, 0.9) < 0.5:
        text = (
            f"The wrist center is right, but the orientation is off by {np.median(turned):.2g} rad "
            f"(median), differently from pose to pose, up to {turned.max():.2g} rad, as of a "
            "numeric inverse of R0_3 that is not orthogonal."
        )
        return [Diagnosis(key="inverse_not_orthogonal", text=text)]
    text = (
        f"{int(wrong.sum())} of {len(wrong)} answers are wrong and no known mistake explains them: "
        f"the wrist center is off by {np.nanmedian(off):.3g} m and the orientation by "
        f"{np.median(turned):.3g} rad (medians)."
    )
    return [Diagnosis(key="unexplained", text=text)]
