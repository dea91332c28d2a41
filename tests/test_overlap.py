"""Motions in a chain flow into each other, within every limit, and only where the world is free."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

from kr210_sim.limits import MotionLimits
from kr210_sim.path import Path
from kr210_sim.trajectory import time_path, time_paths

SLACK = 1 + 1e-3  # as for single motions, between the points of the grid
FINE = 1e-4  # [s]


def random_chain(robot, seed: int, *, curved: bool = True, reach: float = 0.4) -> list[Path]:
    """Return four paths, each from where the one before ends, every other one bowed."""
    rng = np.random.default_rng(seed)
    middle, half = (robot.lower + robot.upper) / 2, (robot.upper - robot.lower) / 2
    corners = middle + reach * rng.uniform(-1, 1, (5, 6)) * half
    u = np.linspace(0.0, 1.0, 41)[:, None]
    paths = []
    for index in range(4):
        a, b = corners[index : index + 2]
        if curved and index % 2:
            bulge = 0.1 * rng.normal(size=6)
            samples = a + u * (b - a) + 4 * u * (1 - u) * bulge
            paths.append(Path.through(samples, robot.velocity))
        else:
            paths.append(Path.straight(a, b, robot.velocity))
    return paths


def crossing(robot) -> list[Path]:
    """Return three moves of different joints, which can be run at once."""
    corners = np.zeros((4, 6))
    corners[1:, 0] = 0.8
    corners[2:, 3] = 1.0
    corners[3:, 1] = 0.5
    return [Path.straight(a, b, robot.velocity) for a, b in pairwise(corners)]


def onwards(robot) -> list[Path]:
    """Return two moves of one joint in one direction, alike."""
    q = np.zeros((3, 6))
    q[:, 0] = [0.0, 0.9, 1.8]
    return [Path.straight(a, b, robot.velocity) for a, b in pairwise(q)]


def overlaps(trajectory) -> np.ndarray:
    """Return for how long each two neighbours run at once [s]."""
    return trajectory.ends[:-1] - trajectory.starts[1:]


CHAINS = {
    "random": lambda robot: random_chain(robot, 31),
    "wide": lambda robot: random_chain(robot, 32, reach=0.9),
    "near": lambda robot: random_chain(robot, 33, reach=0.04),
    "lines": lambda robot: random_chain(robot, 34, curved=False),
    "crossing": crossing,
    "onwards": onwards,
}


@pytest.fixture(scope="module", params=list(CHAINS))
def chain(request, robot):
    """Return paths in a chain, and their trajectory at full speed."""
    paths = CHAINS[request.param](robot)
    return paths, time_paths(paths, MotionLimits.from_velocity(robot.velocity))


def check_times(trajectory) -> np.ndarray:
    """Return times (N,) [s]: a 1 kHz grid, and random ones ten times denser."""
    count = int(np.ceil(trajectory.duration * 1000)) + 1
    rng = np.random.default_rng(35)
    return np.concatenate(
        [
            np.linspace(0.0, trajectory.duration, count),
            rng.uniform(0.0, trajectory.duration, 10 * count),
        ]
    )


# ---- the limits -----------------------------------------------------------------------------


def test_all_limits_hold_while_motions_overlap(chain, limits):
    _, trajectory = chain
    _, qd, qdd, qddd = trajectory.derivatives(check_times(trajectory))
    assert np.all(np.abs(qd) <= limits.velocity * SLACK)
    assert np.all(np.abs(qdd) <= limits.acceleration * SLACK)
    assert np.all(np.abs(qddd) <= limits.jerk * SLACK)


def test_all_limits_hold_for_the_positions_themselves(chain, limits):
    """By finite differences: nothing hides behind wrong derivatives, or between two grids."""
    _, trajectory = chain
    q, _, qdd = trajectory(np.arange(0.0, trajectory.duration, FINE))
    assert np.all(np.abs(np.diff(q, axis=0)) <= limits.velocity * FINE * SLACK)
    assert np.all(np.abs(np.diff(q, n=2, axis=0)) <= limits.acceleration * FINE**2 * SLACK)
    assert np.all(np.abs(np.diff(qdd, axis=0)) <= limits.jerk * FINE * 1.01)


def test_usage_sees_the_jerk_on_both_sides_of_every_jump(chain, limits):
    _, trajectory = chain
    found = trajectory.derivatives(check_times(trajectory))[1:]
    for used, x, bound in zip(
        trajectory.usage(limits),
        found,
        (limits.velocity, limits.acceleration, limits.jerk),
        strict=True,
    ):
        assert used == pytest.approx(np.max(np.abs(x) / bound), rel=2e-3)


# ---- the chain ------------------------------------------------------------------------------


def test_a_chain_rests_at_both_ends_and_stays_at_its_end(chain):
    paths, trajectory = chain
    t = np.array([0.0, trajectory.duration, trajectory.duration + 10.0])
    q, qd, qdd = trajectory(t)
    np.testing.assert_allclose(q, [paths[0].start, paths[-1].end, paths[-1].end], atol=1e-9)
    np.testing.assert_allclose(qd, 0.0, atol=1e-6)
    np.testing.assert_allclose(qdd, 0.0, atol=1e-4)
    np.testing.assert_allclose(trajectory.end, paths[-1].end, atol=1e-12)


def test_motions_begin_in_order_and_no_three_run_at_once(chain):
    _, trajectory = chain
    assert trajectory.starts[0] == 0.0
    assert np.all(overlaps(trajectory) >= -1e-9)
    assert np.all(np.diff(trajectory.starts) >= 0.0)
    assert np.all(trajectory.ends[:-2] <= trajectory.starts[2:] + 1e-9)


def test_each_motion_takes_the_time_it_takes_alone(chain, limits):
    paths, trajectory = chain
    alone = np.array([time_path(path, limits).duration for path in paths])
    np.testing.assert_allclose(trajectory.ends - trajectory.starts, alone)
    assert trajectory.duration == pytest.approx(alone.sum() - overlaps(trajectory).sum())


def test_outside_the_overlaps_the_paths_are_run_exactly(chain):
    """Where a motion is alone, the arm is on its path, to rounding."""
    paths, trajectory = chain
    ends, starts = trajectory.ends, trajectory.starts
    for index, (path, law) in enumerate(zip(paths, trajectory._laws, strict=True)):
        begin = ends[index - 1] if index else 0.0
        end = starts[index + 1] if index + 1 < len(paths) else trajectory.duration
        t = np.linspace(begin, max(begin, end), 100)
        s = law(t - starts[index])[0]
        np.testing.assert_allclose(trajectory(t)[0], path(s), atol=1e-9)


def test_the_arm_only_stops_at_a_corner_without_an_overlap(chain, limits):
    _, trajectory = chain
    t = np.linspace(0.0, trajectory.duration, 5001)[1:-1]
    speed = np.max(np.abs(trajectory(t)[1]) / limits.velocity, axis=1)
    stops = trajectory.starts[1:][overlaps(trajectory) < 1e-9]
    away = np.all(np.abs(t[:, None] - stops) > 1e-3, axis=1)
    away &= (t > 1e-3) & (t < trajectory.duration - 1e-3)
    assert np.all(speed[away] > 0.0)
    assert np.all(speed[away & (t > 0.05) & (t < trajectory.duration - 0.05)] > 1e-7)


def test_an_overlap_of_zero_was_forced_by_the_limits(chain, limits):
    """Where nothing overlaps, no overlap at all would do: each would break a limit."""
    paths, trajectory = chain
    for corner in np.flatnonzero(overlaps(trajectory) < 1e-9):
        before, after = (time_path(path, limits) for path in paths[corner : corner + 2])
        left = before.duration - (overlaps(trajectory)[corner - 1] if corner else 0.0)
        assert left > 0.24 * before.duration
        for taken in np.arange(0.002, min(left, 0.7 * after.duration), 0.013):
            t = np.linspace(0.0, taken, 400)
            one = before.derivatives(before.duration - taken + t)
            other = after.derivatives(t)
            worst = max(
                np.max(np.abs(a + b) / bound)
                for a, b, bound in zip(
                    one[1:],
                    other[1:],
                    (limits.velocity, limits.acceleration, limits.jerk),
                    strict=True,
                )
            )
            assert worst > 1.0 - 2e-4, (corner, taken)


def test_moves_of_different_joints_overlap_almost_wholly_but_never_three_at_once(robot, limits):
    trajectory = time_paths(crossing(robot), limits)
    durations = trajectory.ends - trajectory.starts
    first, second = overlaps(trajectory)
    assert first == pytest.approx(min(durations[0], 0.75 * durations[1]), abs=2e-3)
    assert second == pytest.approx(min(durations[1] - first, durations[2]), abs=2e-3)


def test_a_joint_that_goes_on_in_its_direction_does_not_brake(robot, limits):
    trajectory = time_paths(onwards(robot), limits)
    t = np.linspace(0.4, trajectory.duration - 0.4, 500)
    speed = trajectory(t)[1][:, 0] / limits.velocity[0]
    assert np.min(speed) > 0.8


# ---- stages ---------------------------------------------------------------------------------


def test_the_part_under_way_goes_from_the_first_to_the_last_and_never_back(chain):
    paths, trajectory = chain
    t = np.linspace(-0.1, trajectory.duration + 0.1, 20001)
    parts = [trajectory.part_at(time) for time in t]
    assert parts[0] == 0
    assert parts[-1] == len(paths) - 1
    assert set(np.diff(parts)) <= {0, 1}


def test_the_part_changes_in_the_middle_of_an_overlap(chain):
    paths, trajectory = chain
    middles = trajectory.starts[1:] + overlaps(trajectory) / 2
    for corner, middle in enumerate(middles):
        assert trajectory.part_at(middle - 1e-6) <= corner
        assert trajectory.part_at(middle + 1e-6) >= corner + 1
    alone = time_path(paths[0], MotionLimits.from_velocity(np.ones(6)))
    assert alone.part_at(0.0) == alone.part_at(100.0) == 0


# ---- the speed ------------------------------------------------------------------------------


@pytest.mark.parametrize("speed", [0.5, 0.37, 0.1])
def test_the_geometry_is_the_same_at_every_speed(chain, robot, speed):
    paths, quick = chain
    slow = time_paths(paths, MotionLimits.from_velocity(robot.velocity, speed))
    assert slow.duration * speed == pytest.approx(quick.duration, rel=1e-6)
    np.testing.assert_allclose(slow.starts * speed, quick.starts, atol=1e-6)
    t = np.linspace(0.0, quick.duration, 2000)
    np.testing.assert_allclose(slow(t / speed)[0], quick(t)[0], atol=1e-5)


def test_a_slowed_trajectory_is_that_of_lower_limits(chain, robot):
    paths, quick = chain
    slowed = quick.slowed(0.37)
    slow = time_paths(paths, MotionLimits.from_velocity(robot.velocity, 0.37))
    t = np.linspace(0.0, slow.duration, 500)
    for one, other in zip(slowed.derivatives(t)[:3], slow.derivatives(t)[:3], strict=True):
        np.testing.assert_allclose(one, other, atol=1e-4)
    assert slowed.duration == pytest.approx(quick.duration / 0.37)
    assert max(slowed.usage(MotionLimits.from_velocity(robot.velocity, 0.37))) <= 1.0


# ---- clearance ------------------------------------------------------------------------------


def test_a_world_in_the_way_of_every_corner_leaves_the_paths_as_they_are(robot, limits):
    paths = crossing(robot)
    trajectory = time_paths(paths, limits, lambda corner, q: False)
    np.testing.assert_allclose(overlaps(trajectory), 0.0, atol=1e-9)
    alone = sum(time_path(path, limits).duration for path in paths)
    assert trajectory.duration == pytest.approx(alone)


def test_a_corner_is_rounded_as_far_as_the_world_leaves_it_free(robot, limits):
    """A pillar inside the first corner, and none inside the second."""

    def free(corner: int, q: np.ndarray) -> bool:
        asked.append((corner, q))
        return corner > 0 or not np.any((q[:, 0] < 0.75) & (q[:, 3] > 0.05))

    asked: list[tuple[int, np.ndarray]] = []
    paths = crossing(robot)
    near, wide = time_paths(paths, limits, free), time_paths(paths, limits)
    assert 0.05 < overlaps(near)[0] < overlaps(wide)[0] - 0.05
    dense = near(np.linspace(0.0, near.duration, 20001))[0]
    assert not np.any((dense[:, 0] < 0.75 - 1e-3) & (dense[:, 3] > 0.05 + 1e-3))
    assert {corner for corner, _ in asked} == {0, 1}


def test_what_is_asked_about_a_corner_is_what_is_run_there_in_small_steps(robot, limits):
    asked: dict[int, np.ndarray] = {}

    def free(corner: int, q: np.ndarray) -> bool:
        asked[corner] = q
        return True

    paths = random_chain(robot, 36)
    trajectory = time_paths(paths, limits, free)
    assert asked
    for corner, q in asked.items():
        t = np.linspace(trajectory.starts[corner + 1], trajectory.ends[corner], len(q))
        np.testing.assert_allclose(trajectory(t)[0], q, atol=1e-9)
        assert np.max(np.abs(np.diff(q, axis=0))) < 0.012
