"""A trajectory holds its limits at every instant, rests at both ends, and scales with the speed."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

import ik
from kr210_sim.exceptions import CycleFailure
from kr210_sim.limits import MotionLimits
from kr210_sim.path import Path
from kr210_sim.time_law import TimeLaw
from kr210_sim.tracks import TrackFinder, follow
from kr210_sim.trajectory import time_path, time_paths

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
            paths.append(Path.straight(*q, robot.velocity))
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
        t = np.linspace(0.0, trajectory.duration, 500)
        s, ds, _, _ = trajectory._laws[0](t)
        assert np.all(np.diff(s) >= -1e-12)
        assert np.all(ds >= -1e-9)
        assert s[-1] == pytest.approx(path.length)
        np.testing.assert_allclose(trajectory(t)[0], path(s), atol=1e-9)


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
    for path in (
        Path.straight(q, q, robot.velocity),
        Path.through(np.tile(q, (10, 1)), robot.velocity),
    ):
        trajectory = time_path(path, limits)
        assert trajectory.duration == 0.0
        np.testing.assert_allclose(trajectory(np.array([0.0, 1.0]))[0], [q, q])
        assert trajectory.usage(limits) == (0.0, 0.0, 0.0)


def test_a_time_law_of_no_distance_takes_no_time():
    assert TimeLaw(0.0, 1.0, 1.0, 1.0).duration == 0.0


@pytest.mark.parametrize("limits", [(0.0, 1.0, 1.0), (1.0, -1.0, 1.0), (1.0, 1.0, np.nan)])
def test_limits_that_allow_no_motion_have_no_time_law(limits):
    with pytest.raises(ValueError, match="no time law"):
        TimeLaw(1.0, *limits)


# ---- straight on along poses ----------------------------------------------------------------


def along_x(robot, q, *distances: float) -> np.ndarray:
    """Return poses of the palm at a configuration, moved along the base's x [m]."""
    T = np.tile(ik.forward(robot.geometry, q), (len(distances), 1, 1))
    T[:, 0, 3] += distances
    return T


BENT = np.array([0.1, 0.2, -0.3, 0.4, 0.6, 0.5])


def test_a_straight_line_is_followed_on_the_same_branch_and_turns(robot):
    begin = BENT - 2 * np.pi * np.eye(6)[3]
    poses = along_x(robot, BENT, *np.linspace(0.0, -0.1, 11))
    q = follow(robot, poses, begin)
    np.testing.assert_allclose(q[0], begin, atol=1e-9)
    assert np.max(np.abs(np.diff(q, axis=0))) < 0.1
    np.testing.assert_allclose(ik.forward(robot.geometry, q), poses, atol=1e-9)


def test_a_straight_line_that_cannot_be_followed_says_why(robot):
    with pytest.raises(CycleFailure, match="out of reach") as far:
        follow(robot, along_x(robot, BENT, 0.0, 5.0), BENT)
    assert far.value.reason == "unreachable"
    with pytest.raises(CycleFailure, match="continuous") as jump:
        follow(robot, along_x(robot, BENT, 0.0, -1.0), BENT)
    assert jump.value.reason == "no_path"
    low = replace(robot, upper=np.array([np.pi, BENT[1] - 0.1, *robot.upper[2:]]))
    with pytest.raises(CycleFailure, match="limit") as limit:
        follow(low, along_x(robot, BENT, 0.0, -0.01), BENT)
    assert limit.value.reason == "joint_limits"


# ---- chains of random waypoints under random limits -----------------------------------------


def random_limits(robot, rng) -> MotionLimits:
    """Return limits each drawn on its own, so that any joint and any order may be the tight one."""
    full = MotionLimits.from_velocity(robot.velocity)
    v, a, j = rng.uniform(0.4, 1.0, (3, 6))
    return MotionLimits(
        velocity=full.velocity * v, acceleration=full.acceleration * a, jerk=full.jerk * j
    )


@pytest.fixture(scope="module", params=range(3))
def chain(request, robot):
    """Return random waypoints, random limits, and the trajectory through straight joint lines."""
    rng = np.random.default_rng([71, request.param])
    waypoints = rng.uniform(robot.lower, robot.upper, (2 + min(request.param, 1), 6)) / 4
    limits = random_limits(robot, rng)
    paths = [Path.straight(a, b, limits.velocity) for a, b in pairwise(waypoints)]
    return waypoints, limits, time_paths(paths, limits)


def test_a_chain_begins_and_ends_at_rest_on_its_first_and_last_waypoint(chain):
    waypoints, _, trajectory = chain
    q, qd, qdd = trajectory(np.array([0.0, trajectory.duration]))
    np.testing.assert_allclose(q, waypoints[[0, -1]], rtol=0.0, atol=1e-9)
    np.testing.assert_allclose(qd, 0.0, atol=1e-6)
    np.testing.assert_allclose(qdd, 0.0, atol=1e-4)


def test_a_chain_holds_every_limit_at_every_millisecond(chain):
    _, limits, trajectory = chain
    t = np.append(np.arange(0.0, trajectory.duration, 1e-3), trajectory.duration)
    derivatives = trajectory.derivatives(t)[1:]
    for found, limit in zip(
        derivatives, (limits.velocity, limits.acceleration, limits.jerk), strict=True
    ):
        assert np.max(np.abs(found) / limit) <= 1 + 1e-6


@pytest.mark.parametrize("seed", range(2))
def test_a_random_line_of_the_tcp_is_straight_under_random_limits(robot, seed):
    rng = np.random.default_rng([72, seed])
    tracks = []
    while not tracks:
        middle = robot.forward(rng.uniform(robot.lower / 2, robot.upper / 2))
        direction = rng.normal(size=3)
        ends = np.stack([middle, middle])
        ends[:, :3, 3] += np.outer([-0.1, 0.1], direction / np.linalg.norm(direction))
        tracks = TrackFinder(robot).find([tuple(ends)], anchor=0, q_start=np.zeros(6))
    for track in list(tracks)[:2]:
        path = Path.through(track.q, robot.velocity)
        trajectory = time_path(path, random_limits(robot, rng))
        T = robot.forward(trajectory(np.linspace(0.0, trajectory.duration, 500))[0])
        chord = (ends[1] - ends[0])[:3, 3] / 0.2
        offset = T[:, :3, 3] - ends[0, :3, 3]
        aside = offset - np.outer(offset @ chord, chord)
        assert np.max(np.linalg.norm(aside, axis=1)) < 5e-4
        np.testing.assert_allclose(T[[0, -1], :3, 3], ends[:, :3, 3], rtol=0.0, atol=1e-8)
        assert np.max(np.abs(T[:, :3, :3] - middle[:3, :3])) < 1e-3
