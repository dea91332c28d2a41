"""A path is smooth geometry: it meets its samples, and runs evenly along them."""

from __future__ import annotations

import numpy as np
import pytest

from kr210_sim.path import Path


@pytest.fixture
def ends(robot):
    rng = np.random.default_rng(10)
    return rng.uniform(robot.lower, robot.upper, (2, 6))


def bow(q_start: np.ndarray, q_end: np.ndarray, count: int = 41) -> np.ndarray:
    """Return samples of a parabola between two configurations."""
    u = np.linspace(0.0, 1.0, count)[:, None]
    return q_start + u * (q_end - q_start) + 4 * u * (1 - u) * np.linspace(-0.4, 0.6, 6)


def test_a_straight_path_joins_its_ends_in_a_straight_line(ends):
    path = Path.straight(*ends)
    s = np.linspace(0.0, 1.0, 200)
    np.testing.assert_allclose(path(s), ends[0] + s[:, None] * (ends[1] - ends[0]), atol=1e-12)
    np.testing.assert_allclose(path(s, 1), np.tile(ends[1] - ends[0], (200, 1)), atol=1e-9)
    np.testing.assert_allclose(path(s, 2), 0.0, atol=1e-7)


@pytest.mark.parametrize("make", ["straight", "through"])
def test_a_path_meets_both_ends_exactly(robot, ends, make):
    if make == "straight":
        path = Path.straight(*ends)
    else:
        path = Path.through(bow(*ends), robot.velocity)
    np.testing.assert_allclose(path.start, ends[0], atol=1e-9)
    np.testing.assert_allclose(path.end, ends[1], atol=1e-9)


def test_a_path_passes_through_its_samples(robot, ends):
    samples = bow(*ends)
    fine = Path.through(samples, robot.velocity)(np.linspace(0.0, 1.0, 40001))
    for q in samples:
        assert np.min(np.max(np.abs(fine - q), axis=1)) < 2e-4


def test_a_path_runs_evenly_in_the_velocity_weighted_norm(robot, ends):
    path = Path.through(bow(*ends), robot.velocity)
    rate = np.linalg.norm(path(np.linspace(0.0, 1.0, 500), 1) / robot.velocity, ord=8, axis=1)
    assert np.ptp(rate) < 0.03 * np.mean(rate)


def test_the_derivatives_are_those_of_the_path(robot, ends):
    path = Path.through(bow(*ends), robot.velocity)
    h, s = 1e-5, np.linspace(0.05, 0.95, 100)
    for order in (1, 2, 3):
        difference = (path(s + h, order - 1) - path(s - h, order - 1)) / (2 * h)
        scale = np.max(np.abs(difference))
        np.testing.assert_allclose(path(s, order), difference, atol=1e-5 * scale)


def test_samples_are_close_together_and_include_both_ends(robot, ends):
    for path in (Path.straight(*ends), Path.through(bow(*ends), robot.velocity)):
        q = path.samples(0.012)
        assert np.max(np.abs(np.diff(q, axis=0))) <= 0.012
        np.testing.assert_array_equal(q[0], path.start)
        np.testing.assert_array_equal(q[-1], path.end)


def test_a_path_that_goes_nowhere_stays_there(robot):
    q = np.tile(np.linspace(-0.5, 0.5, 6), (10, 1))
    for path in (Path.straight(q[0], q[0]), Path.through(q, robot.velocity)):
        np.testing.assert_allclose(path(np.linspace(0, 1, 50)), np.tile(q[0], (50, 1)), atol=1e-12)
        assert len(path.samples(0.01)) >= 2
