"""Limits, turns and the configuration nearest to a seed."""

from __future__ import annotations

from itertools import product

import numpy as np
import pytest
from ik_arms import DEG, KR210, parse_urdf, wrapped

import ik

LOWER, UPPER = parse_urdf(KR210).lower, parse_urdf(KR210).upper
TWO_PI = 2 * np.pi


def test_limits_apply_as_they_are_with_slack():
    q = np.array([UPPER, LOWER, UPPER + 5e-10, LOWER - 1e-8, np.full(6, np.nan)])
    assert ik.within_limits(q, LOWER, UPPER).tolist() == [True, True, True, False, False]
    assert ik.within_limits(q, LOWER, UPPER, slack=0.0).tolist() == [True, True] + [False] * 3
    assert ik.within_limits(q[0] + 10, [-np.inf] * 6, [np.inf] * 6)


def test_turns_are_all_copies_inside_and_no_others():
    rng = np.random.default_rng(0)
    rows = rng.uniform(-np.pi, np.pi, (40, 6))
    rows[7] = np.nan
    got = ik.turns(rows, LOWER, UPPER)
    want = [
        (i, row + TWO_PI * np.array(k))
        for i, row in enumerate(rows)
        for k in product((-1, 0, 1), repeat=6)
        if (row + TWO_PI * np.array(k) >= LOWER).all()
        and (row + TWO_PI * np.array(k) <= UPPER).all()
    ]
    assert got.row.tolist() == [i for i, _ in want]
    assert got.q == pytest.approx(np.array([q for _, q in want]))
    assert ik.within_limits(got.q, LOWER, UPPER).all()


def test_turns_of_angles_far_away_are_found():
    got = ik.turns(np.zeros(6) + 10 * TWO_PI, [-np.pi] * 6, [np.pi] * 6)
    assert got.q == pytest.approx(np.zeros((1, 6)), abs=1e-12)
    assert len(ik.turns(np.zeros((0, 6)), LOWER, UPPER).q) == 0


def test_turns_at_a_limit_are_inside():
    got = ik.turns([-np.pi, 0, 0, 0, 0, 0], [-np.pi] + [-1.0] * 5, [np.pi] + [1.0] * 5)
    assert got.q[:, 0].tolist() == pytest.approx([-np.pi, np.pi])


@pytest.mark.parametrize(
    ("lower", "upper", "words"),
    [
        (LOWER[:5], UPPER, "shape"),
        (UPPER, LOWER, "above"),
        ([np.nan] * 6, UPPER, "above"),
        ([-np.inf] * 6, UPPER, "finite"),
    ],
)
def test_bad_limits_are_refused(lower, upper, words):
    with pytest.raises(ik.IKError, match=words):
        ik.turns(np.zeros(6), lower, upper)


def test_the_nearest_is_the_best_of_all_branches_and_turns():
    rng = np.random.default_rng(1)
    velocity = parse_urdf(KR210).velocity
    seeds = rng.uniform(LOWER, UPPER, (60, 6))
    poses = ik.forward(ik.KR210, rng.uniform(LOWER, UPPER, (60, 6)))
    branches = ik.inverse(ik.KR210, poses).q
    got = ik.nearest(branches, seeds, LOWER, UPPER, velocity=velocity)
    for q, seed, rows in zip(got, seeds, branches, strict=True):
        every = ik.turns(rows, LOWER, UPPER).q
        times = ik.joint_time(seed, every, velocity)
        assert ik.joint_time(seed, q, velocity) == pytest.approx(times.min())
        assert ik.within_limits(q, LOWER, UPPER)
        assert np.abs(ik.forward(ik.KR210, q) - ik.forward(ik.KR210, every[0])).max() < 1e-14


def test_the_nearest_to_the_answer_is_the_answer():
    q = np.array([3.2, 0.4, -3.0, -4.0, 1.0, 5.0])  # joints 1, 4 and 6 beyond half a turn
    found = ik.inverse(ik.KR210, ik.forward(ik.KR210, q))
    assert ik.nearest(found.q, q, LOWER, UPPER) == pytest.approx(q, abs=1e-12)


def test_nothing_inside_of_the_limits_is_nan():
    rows = np.full((8, 6), np.nan)
    assert np.isnan(ik.nearest(rows, np.zeros(6), LOWER, UPPER)).all()
    rows[3] = [0, 100 * DEG, 0, 0, 0, 0]
    assert np.isnan(ik.nearest(rows, np.zeros(6), LOWER, UPPER)).all()


def test_limits_below_the_seed_are_reached_from_above():
    narrow = np.array([3.0, -1, -1, -1, -1, -1]), np.array([4.0, 1, 1, 1, 1, 1])
    q = ik.nearest(np.array([[-3.0, 0, 0, 0, 0, 0]]), np.zeros(6), *narrow)
    assert q[0] == pytest.approx(TWO_PI - 3.0)


def test_sliding_keeps_the_tool_where_it_is():
    for q5 in (0.0, np.pi, -np.pi):
        q = np.array([0.1, 0.2, 0.3, 0.4, q5, 0.6])
        slid = ik.slide_wrist(ik.KR210, q, np.array([-1.0, 2.0, 4.0]))
        assert slid[:, 3] == pytest.approx([-1.0, 2.0, 4.0])
        T = ik.forward(ik.KR210, q)
        assert np.abs(ik.forward(ik.KR210, slid) - T).max() < 2e-15
        assert np.abs(wrapped(slid[:, 5] - q[5])) == pytest.approx(np.abs(slid[:, 5] - q[5]))


def test_sliding_counts_the_signs_of_the_arm():
    arm = ik.Arm(a1=0.3, d1=0.5, L2=1, a3=0.1, d4=1, signs=(1, 1, 1, -1, 1, 1), offsets=(0.2,) * 6)
    q = np.array([0.1, 0.2, 0.3, 0.4, -0.2, 0.6])
    slid = ik.slide_wrist(arm, q, 1.5)
    assert slid[3] == pytest.approx(1.5)
    assert np.abs(ik.forward(arm, slid) - ik.forward(arm, q)).max() < 2e-15


@pytest.mark.parametrize("q", [np.zeros(5), 0.0])
def test_only_six_angles_slide(q):
    with pytest.raises(ik.IKError, match=r"\(\.\.\., 6\)"):
        ik.slide_wrist(ik.KR210, q, 1.0)


def test_off_the_singularity_nothing_slides():
    q = np.array([0.1, 0.2, 0.3, 0.4, 1e-6, 0.6])
    assert np.array_equal(ik.slide_wrist(ik.KR210, q, 1.0), q)
