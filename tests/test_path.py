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


def weighted(dq: np.ndarray, velocity: np.ndarray) -> np.ndarray:
    """Return the velocity-weighted norm of joint displacements (N, 6)."""
    return np.linalg.norm(dq / velocity, ord=8, axis=-1)


def test_a_straight_path_joins_its_ends_in_a_straight_line(robot, ends):
    path = Path.straight(*ends, robot.velocity)
    share = np.linspace(0.0, 1.0, 200)
    s, chord = share * path.length, ends[1] - ends[0]
    np.testing.assert_allclose(path(s), ends[0] + share[:, None] * chord, atol=1e-12)
    np.testing.assert_allclose(path(s, 1), np.tile(chord / path.length, (200, 1)), atol=1e-9)
    np.testing.assert_allclose(path(s, 2), 0.0, atol=1e-7)


@pytest.mark.parametrize("make", ["straight", "through"])
def test_a_path_meets_both_ends_exactly(robot, ends, make):
    if make == "straight":
        path = Path.straight(*ends, robot.velocity)
    else:
        path = Path.through(bow(*ends), robot.velocity)
    np.testing.assert_allclose(path.start, ends[0], atol=1e-9)
    np.testing.assert_allclose(path.end, ends[1], atol=1e-9)


def test_a_path_passes_through_its_samples(robot, ends):
    samples = bow(*ends)
    path = Path.through(samples, robot.velocity)
    fine = path(np.linspace(0.0, path.length, 40001))
    for q in samples:
        assert np.min(np.max(np.abs(fine - q), axis=1)) < 2e-4


@pytest.mark.parametrize(("make", "slack"), [("straight", 1e-9), ("through", 0.015)])
def test_the_parameter_is_arc_length_in_the_velocity_weighted_norm(robot, ends, make, slack):
    """At ds/dt = 1 the path is run at the velocity limit, everywhere along it."""
    if make == "straight":
        path = Path.straight(*ends, robot.velocity)
    else:
        path = Path.through(bow(*ends), robot.velocity)
    s = np.linspace(0.0, path.length, 500)
    rate = weighted(path(s, 1), robot.velocity)
    np.testing.assert_allclose(rate, 1.0, atol=slack)
    fine = path(np.linspace(0.0, path.length, 20001))
    travelled = np.sum(weighted(np.diff(fine, axis=0), robot.velocity))
    assert path.length == pytest.approx(travelled, rel=1e-4)


def test_a_path_runs_evenly_in_the_velocity_weighted_norm(robot, ends):
    path = Path.through(bow(*ends), robot.velocity)
    rate = weighted(path(np.linspace(0.0, path.length, 500), 1), robot.velocity)
    assert np.ptp(rate) < 0.03 * np.mean(rate)


def test_the_length_is_the_time_of_the_slowest_joint_at_its_limit(robot):
    """Exactly, when one joint moves alone; an eighth root of six more when all take as long."""
    alone, together = np.zeros(6), 0.3 * robot.velocity
    alone[3] = 0.7 * robot.velocity[3]
    for q in (alone, -alone):
        assert Path.straight(np.zeros(6), q, robot.velocity).length == pytest.approx(0.7)
    length = Path.straight(np.zeros(6), together, robot.velocity).length
    assert length == pytest.approx(0.3 * 6 ** (1 / 8))


def test_the_derivatives_are_those_of_the_path(robot, ends):
    path = Path.through(bow(*ends), robot.velocity)
    h, s = 1e-4 * path.length, path.length * np.linspace(0.05, 0.95, 100)
    for order in (1, 2, 3):
        difference = (path(s + h, order - 1) - path(s - h, order - 1)) / (2 * h)
        scale = np.max(np.abs(difference))
        np.testing.assert_allclose(path(s, order), difference, atol=1e-5 * scale)


def test_samples_are_close_together_and_include_both_ends(robot, ends):
    """Also where the fastest joint changes on the way, and one turns back."""
    hook = bow(*ends)
    hook[:, 0] = ends[0, 0] + np.sin(np.linspace(0.0, 3.0, len(hook))) ** 3
    paths = [Path.through(samples, robot.velocity) for samples in (bow(*ends), hook)]
    for path in (Path.straight(*ends, robot.velocity), *paths):
        q = path.samples(0.012)
        assert np.max(np.abs(np.diff(q, axis=0))) <= 0.012
        np.testing.assert_array_equal(q[0], path.start)
        np.testing.assert_array_equal(q[-1], path.end)


def test_a_path_that_goes_nowhere_stays_there(robot):
    q = np.tile(np.linspace(-0.5, 0.5, 6), (10, 1))
    for path in (Path.straight(q[0], q[0], robot.velocity), Path.through(q, robot.velocity)):
        assert path.length == 0.0
        for s in (np.linspace(0.0, path.length, 50), np.linspace(0.0, 1.0, 50)):
            np.testing.assert_allclose(path(s), np.tile(q[0], (50, 1)), atol=1e-12)
        for order in (1, 2, 3):
            np.testing.assert_allclose(path(np.zeros(5), order), 0.0, atol=1e-9)
        np.testing.assert_allclose([path.start, path.end], q[:2], atol=1e-12)
        assert len(path.samples(0.01)) >= 2


def test_the_way_back_has_the_same_derivatives_with_the_signs_of_a_turned_parameter(robot, ends):
    for there in (Path.straight(*ends, robot.velocity), Path.through(bow(*ends), robot.velocity)):
        back, s = there.reversed(), there.length * np.linspace(0.0, 1.0, 20)
        assert back.there is there
        turned = there.derivatives(there.length - s) * np.array([1, -1, 1, -1])[:, None, None]
        np.testing.assert_allclose(back.derivatives(s), turned, rtol=1e-12, atol=1e-12)
        for order in range(4):
            np.testing.assert_allclose(back(s, order), back.derivatives(s)[order].T, atol=1e-13)
