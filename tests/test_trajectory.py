"""A trajectory holds its limits at every instant, rests at both ends, and scales with the speed."""

from __future__ import annotations

import numpy as np
import pytest

from kr210_sim.path import Path
from kr210_sim.trajectory import MotionLimits, TimeLaw, time_path

FINE = 1e-4  # [s], ten times finer than the grid on which the code checks itself
SLACK = 1 + 1e-3  # between the points of that grid


def random_paths(robot, count: int, seed: int) -> list[Path]:
    """Return straight and bowed moves of all sizes within the limits."""
    rng = np.random.default_rng(seed)
    paths = []
    for index in range(count):
        q = rng.uniform(robot.lower, robot.upper, (2, 6))
        q[1] = q[0] + (q[1] - q[0]) * rng.choice([0.003, 0.05, 0.4, 1.0])
        if index % 2:
            u = np.linspace(0.0, 1.0, 41)[:, None]
            bulge = rng.normal(size=6) * 0.3 * np.linalg.norm(q[1] - q[0]) / np.sqrt(6)
            samples = q[0] + u * (q[1] - q[0]) + 4 * u * (1 - u) * bulge
            paths.append(Path.through(samples, robot.velocity))
        else:
            paths.append(Path.straight(*q))
    return paths


@pytest.fixture(scope="module", params=[1.0, 0.5])
def timed(request, robot):
    """Return limits at a speed, and random paths with their time laws."""
    limits = MotionLimits.from_velocity(robot.velocity, request.param)
    return limits, [(p, time_path(p, limits)) for p in random_paths(robot, 6, seed=11)]


@pytest.fixture(scope="module")
def sampled(timed):
    """Return limits, and for every path q, qd, qdd on the fine grid and its times."""
    limits, pairs = timed
    rows = []
    for _, trajectory in pairs:
        t = np.arange(0.0, trajectory.duration, FINE)
        rows.append((t, *trajectory(t)))
    return limits, rows


def test_speed_and_acceleration_hold_their_limits_between_the_checked_points_too(sampled):
    limits, rows = sampled
    for _, _, qd, qdd in rows:
        assert np.all(np.abs(qd) <= limits.velocity * SLACK)
        assert np.all(np.abs(qdd) <= limits.acceleration * SLACK)


def test_speed_and_acceleration_of_the_positions_themselves_hold_the_limits(sampled):
    """By finite differences of q alone: nothing hides behind wrong derivatives."""
    limits, rows = sampled
    for _, q, _, _ in rows:
        velocity = np.diff(q, axis=0) / FINE
        assert np.all(np.abs(velocity) <= limits.velocity * SLACK)
        acceleration = np.diff(q, n=2, axis=0) / FINE**2
        assert np.all(np.abs(acceleration) <= limits.acceleration * SLACK)


def test_the_jerk_of_the_accelerations_holds_its_limit(sampled):
    limits, rows = sampled
    for _, _, _, qdd in rows:
        jerk = np.diff(qdd, axis=0) / FINE
        assert np.all(np.abs(jerk) <= limits.jerk * 1.01)


def test_velocity_and_acceleration_are_the_derivatives_of_the_position(sampled):
    limits, rows = sampled
    for _, q, qd, qdd in rows:
        middle = (q[2:] - q[:-2]) / (2 * FINE)
        assert np.max(np.abs(qd[1:-1] - middle) / limits.velocity) < 1e-5
        middle = (qd[2:] - qd[:-2]) / (2 * FINE)
        assert np.max(np.abs(qdd[1:-1] - middle) / limits.acceleration) < 2e-3


def test_every_motion_begins_and_ends_at_rest_on_the_ends_of_its_path(timed):
    for path, trajectory in timed[1]:
        q, qd, qdd = trajectory(np.array([0.0, trajectory.duration]))
        np.testing.assert_allclose(q, [path.start, path.end], atol=1e-9)
        np.testing.assert_allclose(qd, 0.0, atol=1e-6)
        np.testing.assert_allclose(qdd, 0.0, atol=1e-4)


def test_a_trajectory_stays_where_it_ends(timed):
    for path, trajectory in timed[1]:
        q, qd, _ = trajectory(trajectory.duration + np.array([0.001, 1.0, 100.0]))
        np.testing.assert_allclose(q, np.tile(path.end, (3, 1)), atol=1e-9)
        np.testing.assert_allclose(qd, 0.0, atol=1e-6)


def test_the_path_is_run_through_once_and_never_back(timed):
    for path, trajectory in timed[1]:
        s, ds, _ = trajectory._law(np.linspace(0.0, trajectory.duration, 500))
        assert np.all(np.diff(s) >= -1e-12)
        assert np.all(ds >= -1e-9)
        np.testing.assert_allclose(trajectory(np.array([0.3]))[0], path(s_at(trajectory, 0.3)))


def s_at(trajectory, time: float) -> np.ndarray:
    return trajectory._law(np.array([time]))[0]


def test_no_time_is_wasted_some_limit_is_touched(timed):
    limits, pairs = timed
    for _, trajectory in pairs:
        assert 0.97 < max(trajectory.usage(limits)) <= 1.0


def test_usage_says_what_the_samples_say(sampled, timed):
    limits, rows = sampled
    for (_, _, qd, qdd), (_, trajectory) in zip(rows, timed[1], strict=True):
        v, a, _ = trajectory.usage(limits)
        assert v == pytest.approx(np.max(np.abs(qd) / limits.velocity), rel=2e-3)
        assert a == pytest.approx(np.max(np.abs(qdd) / limits.acceleration), rel=2e-3)


def test_limits_scale_with_speed_by_its_powers(robot):
    full, part = (MotionLimits.from_velocity(robot.velocity, f) for f in (1.0, 0.4))
    np.testing.assert_array_equal(full.velocity, robot.velocity)
    np.testing.assert_allclose(part.velocity, full.velocity * 0.4)
    np.testing.assert_allclose(part.acceleration, full.acceleration * 0.4**2)
    np.testing.assert_allclose(part.jerk, full.jerk * 0.4**3)


@pytest.mark.parametrize("speed", [0.5, 0.2])
def test_the_duration_is_inversely_proportional_to_the_speed(robot, speed):
    full, part = (MotionLimits.from_velocity(robot.velocity, f) for f in (1.0, speed))
    for path in random_paths(robot, 2, seed=12):
        quick, slow = time_path(path, full), time_path(path, part)
        assert slow.duration * speed == pytest.approx(quick.duration, rel=2e-3)


def test_a_path_that_goes_nowhere_takes_no_time(robot, limits):
    q = np.linspace(-0.5, 0.5, 6)
    trajectory = time_path(Path.straight(q, q), limits)
    assert trajectory.duration == 0.0
    np.testing.assert_allclose(trajectory(np.array([0.0, 1.0]))[0], [q, q])


def test_a_time_law_of_no_distance_takes_no_time():
    assert TimeLaw(0.0, 1.0, 1.0, 1.0).duration == 0.0
