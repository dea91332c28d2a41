"""The numeric solver: right where it answers, repeatable, and independent of the analytic one."""

from __future__ import annotations

import ast
from pathlib import Path

import numpy as np
import pytest
from ik_arms import KR210, OTHERS, parse_urdf

import ik
import ik.numeric

LOWER, UPPER = parse_urdf(KR210).lower, parse_urdf(KR210).upper


def test_it_finds_poses_from_anywhere():
    q = np.random.default_rng(0).uniform(LOWER, UPPER, (60, 6))
    T = ik.forward(ik.KR210, q)
    got = ik.inverse_numeric(ik.KR210, T, np.zeros(6), LOWER, UPPER)
    assert not np.isnan(got).any()
    assert np.abs(ik.forward(ik.KR210, got) - T).max() < 1e-9
    assert ik.within_limits(got, LOWER, UPPER).all()


def test_along_a_path_it_stays_on_its_branch():
    q = np.linspace([0.1, 0.2, -0.3, 0.4, 0.5, -0.6], [0.9, -0.2, 0.3, 1.4, 0.9, 0.6], 40)
    solve = ik.numeric_solver(ik.KR210, LOWER, UPPER)
    got = solve(ik.forward(ik.KR210, q), q[0])
    assert np.abs(got - q).max() < 1e-8


def test_other_arms_are_solved_as_well():
    for text in OTHERS.values():
        chain = parse_urdf(text)
        arm = ik.from_chain(chain.origins, chain.axes)
        q = np.random.default_rng(1).uniform(chain.lower, chain.upper, (4, 6))
        T = ik.forward(arm, q)
        got = ik.inverse_numeric(arm, T, np.zeros(6), chain.lower, chain.upper)
        found = ~np.isnan(got[:, 0])
        assert found.sum() >= 3
        assert np.abs(ik.forward(arm, got[found]) - T[found]).max() < 1e-9


def test_half_a_turn_off_is_no_dead_end():
    T = ik.forward(ik.KR210, np.array([0.0, 0.0, 0.0, 0.0, 0.5, np.pi]))
    got = ik.inverse_numeric(ik.KR210, T[None], [0, 0, 0, 0, 0.5, 0], LOWER, UPPER)
    assert np.abs(ik.forward(ik.KR210, got[0]) - T).max() < 1e-9


def test_unreachable_poses_are_rows_of_nan():
    T = np.tile(np.eye(4), (2, 1, 1))
    T[0, 0, 3] = 9.0
    T[1] = ik.forward(ik.KR210, np.array([0.1, 0.2, 0.3, 0.4, 0.5, 0.6]))
    options = ik.NumericOptions(restarts=2, iterations=30)
    got = ik.inverse_numeric(ik.KR210, T, np.zeros(6), LOWER, UPPER, options=options)
    assert np.isnan(got[0]).all()
    assert not np.isnan(got[1]).any()


def test_the_same_seed_gives_the_same_answers():
    q = np.random.default_rng(2).uniform(LOWER, UPPER, (10, 6))
    T = ik.forward(ik.KR210, q)
    solve = ik.numeric_solver(ik.KR210, LOWER, UPPER, seed=7)
    first = solve(T, np.zeros(6))
    assert np.array_equal(first, solve(T, np.zeros(6)))
    generator = np.random.default_rng(7)
    assert np.array_equal(
        first, ik.inverse_numeric(ik.KR210, T, np.zeros(6), LOWER, UPPER, rng=generator)
    )


def test_it_does_not_use_the_analytic_solver():
    tree = ast.parse(Path(ik.numeric.__file__).read_text())
    imported = {a.name for n in ast.walk(tree) if isinstance(n, ast.ImportFrom) for a in n.names}
    assert "inverse" not in imported


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"T": np.eye(4)}, "T must have shape"),
        ({"T": np.ones((1, 4, 4))}, "bottom row"),
        ({"q_start": np.full(6, np.nan)}, "q_start"),
        ({"upper": np.full(6, np.inf)}, "finite limits"),
    ],
)
def test_bad_arguments_are_refused(change, words):
    good = {"T": np.eye(4)[None], "q_start": np.zeros(6), "lower": LOWER, "upper": UPPER}
    with pytest.raises(ik.IKError, match=words):
        ik.inverse_numeric(ik.KR210, **(good | change))
