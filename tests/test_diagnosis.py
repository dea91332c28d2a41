"""Diagnosis: every known mistake is named, alone and in pairs, and right solvers get none."""

from __future__ import annotations

import re
from functools import lru_cache
from pathlib import Path

import mistaken_solvers as solvers
import numpy as np
import pytest

import ik
from kr210_sim.grading.advice import advice
from kr210_sim.grading.diagnosis import diagnose
from kr210_sim.grading.mistakes import (
    arm_mistakes,
    quaternions_of,
    rotations_of,
    units,
    wrist_mistakes,
)
from kr210_sim.grading.steps import needless_steps

LOWER, UPPER = solvers.LOWER, solvers.UPPER
POSES, PROBES = 24, 24
PAGE = Path(__file__).parents[1] / "docs" / "diagnoses.md"

ALONE = {
    "link_6_for_gripper_link": {"tool_length"},
    "no_wrist_offset": {"tool_length"},
    "correction_missing": {"gripper_correction"},
    "correction_wrong_sign": {"gripper_correction"},
    "correction_without_z": {"gripper_correction"},
    "rotation_transposed": {"gripper_correction"},
    "rpy_as_xyz": {"rpy_order"},
    "roll_and_yaw_swapped": {"rpy_order"},
    "quaternion_w_first": {"rpy_order"},
    "theta2_without_quarter": {"theta2_offset"},
    "theta2_missing_in_dh": {"theta2_offset"},
    "theta3_without_quarter": {"theta3_offset"},
    "sag_omitted": {"sag"},
    "sag_of_wrong_sign": {"sag"},
    "elbows_mixed": {"elbow_branch"},
    "elbow_down": {"elbow_branch", "beyond_limits"},
    "elbow_changes": {"elbow_branch", "beyond_limits"},
    "theta5_sign_alone": {"wrist_branch"},
    "wrist_changes": {"wrist_branch"},
    "a1_ignored": {"shoulder_offset"},
    "height_mistyped": {"length"},
    "upper_arm_mistyped": {"length"},
    "orthogonality_lost": {"inverse_not_orthogonal"},
    "degrees": {"degrees"},
    "radians_twice": {"degrees"},
    "turns_jump": {"turn_jumps"},
    "over_the_limits": {"beyond_limits"},
    "by_atan": {"front_only"},
    "silent_behind": {"front_only"},
    "garbage_behind": {"front_only"},
}
PAIRS = {
    "frame_and_turns": {"tool_length", "turn_jumps"},
    "sag_and_branch": {"sag", "wrist_branch"},
    "sag_and_mixed_elbows": {"sag", "elbow_branch"},
    "sag_and_theta5_sign": {"sag", "wrist_branch"},
    "frame_and_sag": {"tool_length", "sag"},
    "frame_and_correction": {"tool_length", "gripper_correction"},
    "frame_and_rpy": {"tool_length", "rpy_order"},
    "frame_and_degrees": {"tool_length", "degrees"},
    "correction_and_sag": {"gripper_correction", "sag"},
    "theta2_and_sag": {"theta2_offset", "sag"},
    "sag_and_atan": {"sag", "front_only"},
}


REQUIRED = ("frame_and_turns", "sag_and_branch", "sag_and_mixed_elbows")
"""Pairs that are tried every time."""

SEEDS = [
    pytest.param(range(4), id="4"),
    pytest.param(range(4, 100), id="100", marks=pytest.mark.slow),
]


def path_from(rng: np.random.Generator, start: np.ndarray) -> np.ndarray:
    """Return a smooth way (POSES, 6) in front of the shoulder, with the elbow up."""
    while True:
        goal = rng.uniform(LOWER, UPPER) * [0.9, 0.9, 0.4, 0.5, 0.8, 0.5]
        q = start + np.linspace(0, 1, POSES + 1)[1:, None] * (goal - start)
        if is_usual(q).all():
            return q


def is_usual(q: np.ndarray) -> np.ndarray:
    T = ik.forward(ik.KR210, q)
    w = ik.wrist_center(ik.KR210, T)
    ahead = np.cos(q[:, 0]) * w[:, 0] + np.sin(q[:, 0]) * w[:, 1]
    return (ahead > 0.4) & (np.cos(q[:, 2] + solvers.SAG) > 0.1)


@lru_cache
def requests(seed: int) -> tuple[list[np.ndarray], np.ndarray]:
    """Return the ways of two legs, and configurations for probes."""
    rng = np.random.default_rng(seed)
    there = path_from(rng, np.zeros(6))
    back = path_from(rng, there[-1])
    q = rng.uniform(LOWER, UPPER, (8 * PROBES, 6))
    return [there, back], q[is_usual(q)][:PROBES]


def asked(seed: int, solver, shift: np.ndarray | None = None):
    """Return legs and probes as the diagnosis takes them; poses go to the solver shifted."""
    ways, q = requests(seed)
    shift = np.eye(4) if shift is None else shift
    legs, q_start = [], np.zeros(6)
    for way in ways:
        T = ik.forward(ik.KR210, way)
        legs.append((T, q_start, solver(T @ shift, q_start)))
        q_start = solvers.right(T, q_start)[-1]
    P = ik.forward(ik.KR210, q)
    return legs, (P, np.concatenate([solver(T[None] @ shift, np.zeros(6)) for T in P]))


def keys_of(legs, probes=None, **options) -> set[str]:
    return {item.key for item in diagnose(legs, LOWER, UPPER, probes=probes, **options)}


@pytest.mark.parametrize("name", ALONE)
def test_a_mistake_is_named(name):
    legs, probes = asked(3, getattr(solvers, name))
    assert keys_of(legs, probes) == ALONE[name]


@pytest.mark.parametrize(
    "name",
    [name if name in REQUIRED else pytest.param(name, marks=pytest.mark.slow) for name in PAIRS],
)
def test_both_mistakes_of_a_pair_are_named(name):
    legs, probes = asked(3, getattr(solvers, name))
    assert keys_of(legs, probes) == PAIRS[name]


@pytest.mark.slow
def test_every_mistake_is_named_exactly_on_other_ways_too():
    """Each on two of the seeds 10 to 29; on all of them all are."""
    apart = {}
    for index, (name, wanted) in enumerate((ALONE | PAIRS).items()):
        for seed in (10 + index % 20, 10 + (index + 7) % 20):
            found = keys_of(*asked(seed, getattr(solvers, name)))
            if found != wanted:
                apart[name, seed] = found ^ wanted
    assert apart == {}


def test_answers_whose_mistaken_wrist_center_is_out_of_reach_say_nothing():
    legs, probes = asked(16, solvers.no_wrist_offset)
    (found,) = diagnose(legs, LOWER, UPPER, probes=probes)
    assert found.key == "tool_length"
    right, away = re.search(
        r"in (\d+) of 72 answers and out of reach in (\d+)", found.text
    ).groups()
    assert int(right) < int(away) == 72 - int(right)


@pytest.mark.parametrize("seeds", SEEDS)
def test_a_right_solver_gets_no_diagnosis_over_100_seeds(seeds):
    for seed in seeds:
        legs, probes = asked(seed, solvers.right)
        assert keys_of(legs, probes) == set(), seed


@pytest.mark.parametrize("seeds", SEEDS)
def test_right_answers_on_any_branch_get_no_diagnosis_over_100_seeds(seeds):
    count = 0
    for seed in seeds:
        ways, _ = requests(seed)
        for way in ways:
            T = ik.forward(ik.KR210, way)
            for q in np.unwrap(np.moveaxis(ik.inverse(ik.KR210, T).q, 1, 0), axis=1):
                smooth = np.abs(np.diff(q, axis=0)).max() < 0.5  # NaN compares false
                if smooth and np.all((q >= LOWER) & (q <= UPPER)):
                    count += 1
                    assert keys_of([(T, q[0], q)]) == set(), seed
    assert count > 3 * len(seeds)


@pytest.mark.parametrize("seeds", SEEDS)
def test_a_sloppy_solver_is_right_over_100_seeds(seeds):
    for seed in seeds:
        rng = np.random.default_rng(seed)
        legs = [
            (ik.forward(ik.KR210, way), way[0], way + rng.normal(0, 1e-5, way.shape))
            for way in requests(seed)[0]
        ]
        assert keys_of(legs) == set(), seed
    rounded = solvers.with_(sag=0.036, tool=0.303)
    assert keys_of(*asked(3, rounded)) == set()


def test_the_evidence_is_in_the_sentence():
    legs, probes = asked(3, solvers.link_6_for_gripper_link)
    (found,) = diagnose(legs, LOWER, UPPER, probes=probes)
    assert "0.193 m behind the pose instead of 0.303 m" in found.text
    assert "a constant 0.110 m along the tool" in found.text
    assert found.text.count(". ") == 0
    assert found.as_json()["page"].endswith("#tool_length")


def test_a_mistyped_length_is_found_by_its_value():
    legs, probes = asked(3, solvers.upper_arm_mistyped)
    (found,) = diagnose(legs, LOWER, UPPER, probes=probes)
    assert found.text.startswith(
        "The length a2 is 1.200 m instead of 1.250 m: with that the wrist center"
    )


def test_a_solver_that_is_sent_link_6_has_another_right_length():
    shift = np.eye(4)
    shift[0, 3] = -0.11
    for solver, wanted in (
        (solvers.link_6_for_gripper_link, set()),
        (solvers.right, {"tool_length"}),
    ):
        legs, probes = asked(3, solver, shift)
        assert keys_of(legs, probes, frame="link_6") == wanted


def test_no_answers_and_one_answer_for_all_are_no_mistakes_of_geometry():
    T = ik.forward(ik.KR210, requests(0)[0][0])
    assert keys_of([]) == set()
    assert keys_of([(T, np.zeros(6), np.full((POSES, 6), np.nan))]) == set()
    assert keys_of([(T, np.zeros(6), np.zeros((POSES, 6)))]) == set()


def test_wrong_answers_that_nothing_explains_are_said_to_be_so():
    T = ik.forward(ik.KR210, requests(0)[0][0])
    q = np.random.default_rng(0).uniform(LOWER, UPPER, (POSES, 6))
    assert "unexplained" in keys_of([(T, np.zeros(6), q)])


def test_a_step_has_its_place_and_the_motion_that_would_do():
    q = path_from(np.random.default_rng(1), np.zeros(6))
    q[10:, 5] -= 2 * np.pi * np.sign(q[10, 5])
    (step,) = needless_steps(ik.KR210, LOWER, UPPER, np.zeros(6), q, leg=4)
    assert (step.kind, step.leg, step.pose, step.joint) == ("turn_jumps", 4, 10, 6)
    assert step.needed < 0.3 < 6 < step.moved
    gap = q.copy()
    gap[9:11] = np.nan
    (step,) = needless_steps(ik.KR210, LOWER, UPPER, np.zeros(6), gap)
    assert step.pose == 11


def test_a_step_is_needless_only_if_the_arm_could_have_stayed_on_its_side():
    """The other wrist branch is past joint 4's limit here, so that only the elbow could change."""
    before = np.array([1.401, 0.408, -1.054, 5.719, 1.477, -0.718])
    after = np.array([1.367, 0.431, -1.216, 2.980, -1.669, 2.401])
    assert needless_steps(ik.KR210, LOWER, UPPER, before, after[None]) == []
    wider = UPPER + 0.1
    (step,) = needless_steps(ik.KR210, LOWER, wider, before, after[None])
    assert (step.kind, step.joint) == ("wrist_branch", 5)
    assert step.needed < 0.41


def test_quaternions_and_rotations_are_each_other_back():
    R = ik.forward(ik.KR210, np.random.default_rng(0).uniform(-3, 3, (50, 6)))[:, :3, :3]
    R = np.concatenate([R, np.eye(3)[None], np.diag([-1.0, -1.0, 1.0])[None]])
    np.testing.assert_allclose(rotations_of(quaternions_of(R)), R, atol=1e-14)


def test_every_key_has_a_section():
    mistakes = [*arm_mistakes(ik.KR210, 0.303, 0.11), *wrist_mistakes(ik.KR210), *units()]
    keys = {mistake.key for mistake in mistakes}
    keys |= set().union(*ALONE.values(), *PAIRS.values())
    keys |= {"shoulder_branch", "unexplained", "rounding"}
    assert set(re.findall(r"^## (\w+)$", PAGE.read_text(), re.MULTILINE)) == keys
    for key in keys:
        found = advice(key)
        assert found is not None, key
        assert all(text.endswith(".") and "*" not in text for text in (found.see, found.do)), key
    assert advice("no_such_mistake") is None
