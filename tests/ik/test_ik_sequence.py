"""The best path through waypoints: never longer than any other, and free of needless jumps."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from ik_arms import KR210, KR210_VELOCITY, parse_urdf, turn_about

import ik
from ik.chain import rotation_about

LOWER, UPPER = parse_urdf(KR210).lower, parse_urdf(KR210).upper
LIMITS = (LOWER, UPPER, KR210_VELOCITY)


def line(A: np.ndarray, B: np.ndarray, n: int) -> np.ndarray:
    """n poses evenly from A to B, position on a line and rotation about one axis."""
    t = np.linspace(0.0, 1.0, n)
    R = A[:3, :3].T @ B[:3, :3]
    axis = np.array([R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]])
    sine = np.linalg.norm(axis)
    angle = np.arctan2(sine, np.trace(R) - 1.0)
    T = A @ rotation_about(axis / (sine or 1.0), angle * t)
    T[:, :3, 3] = A[:3, 3] + t[:, None] * (B[:3, 3] - A[:3, 3])
    return T


def pick_and_place(n: int, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """A home configuration, and n poses in reach from a shelf in front to a bin at the side."""
    A = turn_about(2, rng.uniform(-0.5, 0.5)) @ turn_about(1, rng.uniform(-0.4, 0.4))
    B = turn_about(2, rng.uniform(1.0, 2.2)) @ turn_about(1, rng.uniform(-0.5, 1.2))
    A = A @ turn_about(0, rng.uniform(-0.5, 0.5))
    A[:3, 3] = rng.uniform((1.9, -0.9, 0.8), (2.3, 0.9, 2.3))
    B[:3, 3] = rng.uniform((-0.3, 1.9, 1.2), (0.3, 2.3, 1.9))
    T = line(A, B, n)
    if not ik.inverse(ik.KR210, T, (LOWER, UPPER)).in_limits.any(axis=1).all():
        return pick_and_place(n, rng)
    return np.array([0.0, 0.0, 0.0, 0.0, 0.3, 0.0]), T


def shortest_by_trying_all(T, q_start, cost):
    """Least cost over every choice, by exhaustion."""
    layers = [ik.turns(q, LOWER, UPPER).q for q in ik.inverse(ik.KR210, T).q]
    paths = [(0.0, q_start)]
    for layer in layers:
        paths = [(c + cost(q, p), p) for c, q in paths for p in layer]
    return min(c for c, _ in paths)


def time(q, p):
    return np.max(np.abs(p - q) / KR210_VELOCITY)


def test_it_is_as_short_as_the_best_of_all_choices():
    rng = np.random.default_rng(3)
    for _ in range(4):
        q_start = rng.uniform(LOWER, UPPER)
        T = ik.forward(ik.KR210, rng.uniform(LOWER, UPPER, (3, 6)))
        got = ik.best_sequence(ik.KR210, T, *LIMITS, q_start, avoid_jumps=False)
        assert got.time == pytest.approx(shortest_by_trying_all(T, q_start, time), rel=1e-8)


def test_what_it_reports_is_what_it_chose():
    q_start, T = pick_and_place(40, np.random.default_rng(4))
    got = ik.best_sequence(ik.KR210, T, *LIMITS, q_start)
    assert np.abs(ik.forward(ik.KR210, got.q) - T).max() < 5e-15
    assert ik.within_limits(got.q, LOWER, UPPER).all()
    path = np.vstack([q_start, got.q])
    assert got.time == pytest.approx(sum(time(a, b) for a, b in pairwise(path)))
    assert got.travel == pytest.approx(np.abs(np.diff(path, axis=0)).sum(axis=0))


@pytest.mark.slow
def test_it_is_never_longer_than_the_greedy_choice():
    rng = np.random.default_rng(5)
    best_wrist, greedy_wrist = 0.0, 0.0
    for _ in range(200):
        q_start, T = pick_and_place(30, rng)
        best = ik.best_sequence(ik.KR210, T, *LIMITS, q_start)
        greedy = ik.greedy_sequence(ik.KR210, T, *LIMITS, q_start)
        assert not np.isnan(best.q).any()
        assert best.time <= greedy.time + 1e-9
        assert best.jumps <= greedy.jumps
        best_wrist += best.travel[[3, 5]].sum()
        greedy_wrist += greedy.travel[[3, 5]].sum()
    assert best_wrist <= greedy_wrist


def test_it_foresees_the_end_of_a_long_turn():
    # the path turns joint 4 by more than it has left from zero: greedy must swing back midway
    q = np.array([0.5, 0.4, -0.6, 0.0, 0.9, 0.0]) + np.zeros((150, 6))
    q[:, 3] = np.linspace(0.0, 7.5, 150)
    T = ik.forward(ik.KR210, q)
    best = ik.best_sequence(ik.KR210, T, *LIMITS)
    greedy = ik.greedy_sequence(ik.KR210, T, *LIMITS)
    assert best.jumps == 0
    assert greedy.jumps == 1
    assert best.time < 0.8 * greedy.time
    assert best.travel[3] < greedy.travel[3]


def test_close_waypoints_keep_their_branch_even_if_a_jump_is_shorter():
    # a line on which a change of branch midway would take less than half of the time
    ends = np.random.default_rng(163).uniform(LOWER, UPPER, (2, 6))
    T = line(*ik.forward(ik.KR210, ends), 60)
    careful = ik.best_sequence(ik.KR210, T, *LIMITS, ends[0])
    quick = ik.best_sequence(ik.KR210, T, *LIMITS, ends[0], avoid_jumps=False)
    assert (careful.jumps, quick.jumps) == (0, 1)
    assert quick.time < 0.5 * careful.time
    halfway = 0.5 * (careful.q[1:] + careful.q[:-1])
    way = ik.forward(ik.KR210, halfway)[:, :3, 3] - 0.5 * (T[1:, :3, 3] + T[:-1, :3, 3])
    assert np.linalg.norm(way, axis=1).max() < 0.03  # the tool stays on the line


def test_waypoints_far_apart_have_no_jumps():
    q = np.random.default_rng(6).uniform(LOWER, UPPER, (10, 6))
    assert ik.best_sequence(ik.KR210, ik.forward(ik.KR210, q), *LIMITS).jumps == 0


def test_straight_through_the_wrist_singularity_without_a_swing():
    # the wrist straight at one waypoint of many, joint 4 turned by 1.3 rad before and after
    q = np.array([0.2, 0.1, 0.3, 1.3, 0.0, -0.4]) + np.zeros((41, 6))
    q[:, 4] = np.linspace(-0.4, 0.4, 41)
    T = ik.forward(ik.KR210, q)
    got = ik.best_sequence(ik.KR210, T, *LIMITS, q[0])
    assert ik.singular(ik.KR210, got.q[20])[2]
    assert np.abs(got.q - q).max() < 1e-9
    assert got.jumps == 0


@pytest.mark.parametrize("straight", [0, 20, 40])
def test_without_a_start_the_neighbours_carry_it_through_the_singularity(straight):
    q = np.array([0.2, 0.1, 0.3, 1.3, 0.0, -0.4]) + np.zeros((41, 6))
    q[:, 4] = 0.02 * (np.arange(41) - straight)
    got = ik.best_sequence(ik.KR210, ik.forward(ik.KR210, q), *LIMITS)
    assert ik.singular(ik.KR210, got.q[straight])[2]
    assert np.abs(np.diff(got.q, axis=0)).max() < 0.02 + 1e-9
    assert got.jumps == 0


def test_waypoints_all_at_the_wrist_singularity_keep_the_start():
    q = np.array([0.2, 0.1, 0.3, 1.3, 0.0, -0.4]) + np.zeros((9, 6))
    q[:, 0] = np.linspace(0.0, 0.8, 9)
    got = ik.best_sequence(ik.KR210, ik.forward(ik.KR210, q), *LIMITS, q[0])
    assert np.abs(got.q - q).max() < 1e-9


def test_waypoints_without_a_configuration_are_left_out():
    q_start, T = pick_and_place(12, np.random.default_rng(8))
    whole = ik.best_sequence(ik.KR210, T, *LIMITS, q_start)
    T[[0, 5]] = np.eye(4)
    T[[0, 5], 0, 3] = 9.0
    got = ik.best_sequence(ik.KR210, T, *LIMITS, q_start)
    assert np.flatnonzero(np.isnan(got.q[:, 0])).tolist() == [0, 5]
    kept = [i for i in range(12) if i not in (0, 5)]
    assert got.q[kept] == pytest.approx(whole.q[kept])
    greedy = ik.greedy_sequence(ik.KR210, T, *LIMITS, q_start)
    assert np.isnan(greedy.q[[0, 5]]).all()
    nothing = ik.best_sequence(ik.KR210, T[[0, 5]], *LIMITS)
    assert np.isnan(nothing.q).all()
    assert (nothing.time, nothing.jumps) == (0.0, 0)
    assert ik.best_sequence(ik.KR210, T[:0], *LIMITS, q_start).q.shape == (0, 6)
    assert ik.greedy_sequence(ik.KR210, T[:0], *LIMITS).q.shape == (0, 6)


def test_configurations_can_be_ruled_out():
    q_start, T = pick_and_place(12, np.random.default_rng(9))
    asked = []

    def elbow_bent_down(q):
        asked.append(len(q))
        return q[:, 2] > -np.pi / 2

    got = ik.best_sequence(ik.KR210, T, *LIMITS, q_start, accept=elbow_bent_down)
    assert (got.q[:, 2] > -np.pi / 2).all()
    assert len(asked) == 1
    with pytest.raises(ik.IKError, match="accept must return a mask"):
        ik.best_sequence(ik.KR210, T, *LIMITS, accept=lambda q: q)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"T": np.eye(4)}, "waypoints"),
        ({"T": np.zeros((2, 4, 4))}, "bottom row"),
        ({"velocity": np.zeros(6)}, "velocity"),
        ({"upper": np.full(6, np.inf)}, "finite"),
        ({"q_start": np.zeros(5)}, "q_start"),
        ({"q_start": np.full(6, np.nan)}, "q_start"),
    ],
)
def test_bad_arguments_are_refused(change, words):
    good = {"T": np.eye(4)[None], "lower": LOWER, "upper": UPPER, "velocity": KR210_VELOCITY}
    with pytest.raises(ik.IKError, match=words):
        ik.best_sequence(ik.KR210, **(good | change))
