"""Which known mistakes explain the answers of a solver, each in one sentence with its evidence."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace

import numpy as np

import ik
from kr210_sim.arrays import Array
from kr210_sim.grading.explain import (
    ARM_TOLERANCE,
    FEW,
    FLANGE,
    SHARE,
    WRIST_TOLERANCE,
    Explained,
    explain,
    wrong_answers,
)
from kr210_sim.grading.mistakes import Mistake, Sample, arm_error, undone, wrist_error
from kr210_sim.grading.source import FRAMES
from kr210_sim.grading.steps import Step, beyond_limits, needless_steps

DOCUMENT = "docs/diagnoses.md"
"""Has a section for every key."""

MOST = 160
"""More answers than this are thinned out evenly [1]."""

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


def diagnose(
    legs: Sequence[LegAnswers],
    lower: Array,
    upper: Array,
    *,
    probes: tuple[Array, Array] | None = None,
    arm: ik.Arm = ik.KR210,
    frame: str = FRAMES[0],
    names: Sequence[str] | None = None,
) -> list[Diagnosis]:
    """Name the smallest set of known mistakes that explains the answers.

    Args:
        legs: requests and answers in the order of the motion.
        lower: (6,) joint limits [rad].
        upper: (6,) upper joint limits [rad].
        probes: T_base_palm (M, 4, 4) and answers (M, 6) of poses that were asked one by one.
        arm: the right geometry, its tool at gripper_link.
        frame: whose poses the solver was sent; T_base_palm is that of gripper_link all the same.
        names: of the legs, for the reader.

    Returns:
        No diagnosis where every answer is right, within limits, and none takes a needless step.
    """
    sample, poses, answered = _sample(legs, probes, arm, frame)
    if np.all(sample.q == sample.q[:1]) and len(sample.q) != 1:  # none, or a template
        return []
    explained = explain(sample)
    largest = float(np.max(np.abs(sample.q)))
    scaled = replace(sample, q=explained.scale * sample.q)
    found = [_told(mistake, explained, scaled, largest) for mistake in explained.made]
    found += _behind(explained, poses, answered)
    angles = [(leg[1], undone(explained.scale * leg[2], explained.arm or ())) for leg in legs]
    steps = [
        step
        for index, (q_start, q) in enumerate(angles)
        for step in needless_steps(arm, lower, upper, q_start, q, leg=index)
    ]
    names = names or [f"leg {index}" for index in range(len(legs))]
    known = {item.key for item in found}
    found += [
        item
        for item in _steps(steps, sum(len(q) for _, q in angles), names)
        if item.key not in known
    ]
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


# ---- the sentences ---------------------------------------------------------------------------


def _told(mistake: Mistake, explained: Explained, sample: Sample, largest: float) -> Diagnosis:
    """Return the sentence about a mistake; sample is in radians, largest is the answered number."""
    parts = []
    if mistake in explained.unit:
        right = int((~wrong_answers(sample, explained)).sum())
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
    away = int(np.isnan(after).sum())
    return (
        f"with that the {what} is right to {max(np.median(right), 1e-15):.0e} {unit} in "
        f"{len(right)} of {len(before)} answers"
        + (f" and out of reach in {away}" if away else "")
        + f", without it is off by {np.median(wrong) if len(wrong) else 0.0:.3g} {unit} (median) "
        f"in {len(wrong)}"
    )


def _upper(text: str) -> str:
    return text[:1].upper() + text[1:]


def _behind(explained: Explained, centers: Array, answered: Array) -> list[Diagnosis]:
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

OF_THE_WAY = (*_STEP_TEXTS, "beyond_limits")
"""Keys of what is wrong with the way from answer to answer, however right each answer is."""


def _steps(steps: Sequence[Step], count: int, names: Sequence[str]) -> list[Diagnosis]:
    """Return diagnoses of needless steps, out of count, in legs of these names."""
    found = []
    for kind, text in _STEP_TEXTS.items():
        of_kind = [step for step in steps if step.kind == kind]
        if of_kind:
            worst = max(of_kind, key=lambda step: step.moved - step.needed)
            evidence = (
                f"{len(of_kind)} in {count} steps; most at pose {worst.pose} of "
                f"{names[worst.leg]}, where joint {worst.joint} moves {worst.moved:.2f} rad and "
                f"{worst.needed:.2f} rad would do"
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


def _unexplained(explained: Explained, sample: Sample) -> list[Diagnosis]:
    """Return what can be said of answers that no set of known mistakes explains."""
    if explained.arm is not None and explained.wrist is not None:
        return []
    off = arm_error(sample, explained.arm or ())
    turned = wrist_error(sample, explained.wrist or ())
    wrong = wrong_answers(sample, explained)
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
