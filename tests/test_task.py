"""Grasp and place poses are pure geometry: straight lines, upright tools, drops that spread."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

from kr210_sim.task import (
    APPROACH_DISTANCE,
    LIFT_HEIGHT,
    WALL_MARGIN,
    WITHDRAW_DISTANCE,
    line,
    pick_options,
    place_options,
    polylines,
    release_point,
)

LENGTH = 0.25


def upright(yaw: float, position: list[float]) -> np.ndarray:
    T = np.eye(4)
    T[:2, :2] = [[np.cos(yaw), -np.sin(yaw)], [np.sin(yaw), np.cos(yaw)]]
    T[:3, 3] = position
    return T


@pytest.fixture(params=[(0.0, 0.0), (0.5, 0.0), (-2.0, 1.3)])
def picks(request):
    """Ways to take a target, for cells and targets turned about the vertical."""
    cell_yaw, target_yaw = request.param
    T_base_target = upright(target_yaw, [1.9, -0.4, 1.2])
    T_base_cell = upright(cell_yaw, [1.9, -0.4, 1.075])
    return T_base_target, T_base_cell, pick_options(T_base_target, T_base_cell)


def test_every_pose_is_a_right_handed_frame(picks):
    for option in picks[2]:
        for T in (option.pre_grasp, option.grasp, option.lift, option.withdraw):
            np.testing.assert_allclose(T[:3, :3] @ T[:3, :3].T, np.eye(3), atol=1e-12)
            assert np.linalg.det(T[:3, :3]) == pytest.approx(1.0)
            np.testing.assert_array_equal(T[3], [0, 0, 0, 1])


def test_the_grasp_is_at_the_centre_of_mass_with_the_jaws_across_the_axis(picks):
    T_base_target, _, options = picks
    for option in options:
        np.testing.assert_array_equal(option.grasp[:3, 3], T_base_target[:3, 3])
        np.testing.assert_allclose(option.grasp[:3, 2], T_base_target[:3, 2], atol=1e-12)


def test_the_first_way_goes_in_along_the_cell(picks):
    _, T_base_cell, options = picks
    np.testing.assert_allclose(options[0].grasp[:3, 0], T_base_cell[:3, 0], atol=1e-12)


def test_no_way_goes_in_from_behind(picks):
    _, T_base_cell, options = picks
    for option in options:
        assert option.grasp[:3, 0] @ T_base_cell[:3, 0] > 0.9


def test_approach_and_withdrawal_are_straight_along_the_tool_and_the_lift_is_up(picks):
    for option in picks[2]:
        x = option.grasp[:3, 0]
        for a, b, offset in (
            (option.pre_grasp, option.grasp, APPROACH_DISTANCE * x),
            (option.grasp, option.lift, LIFT_HEIGHT * np.array([0.0, 0.0, 1.0])),
            (option.lift, option.withdraw, -WITHDRAW_DISTANCE * x),
        ):
            np.testing.assert_allclose(b[:3, 3] - a[:3, 3], offset, atol=1e-12)
            np.testing.assert_array_equal(a[:3, :3], b[:3, :3])


def test_the_poses_do_not_share_memory_with_the_target(picks):
    T_base_target, T_base_cell, options = picks
    before = T_base_target.copy()
    options[0].grasp[:3, 3] += 1.0
    np.testing.assert_array_equal(T_base_target, before)
    again = pick_options(T_base_target, T_base_cell)
    np.testing.assert_array_equal(again[0].grasp[:3, 3], before[:3, 3])


# ---- the release ----------------------------------------------------------------------------


@pytest.mark.parametrize("kind", ["box", "cylinder"])
@pytest.mark.parametrize("yaw", [0.0, 0.7])
def test_ten_releases_lie_apart_at_the_top_of_the_volume_clear_of_its_sides(kind, yaw):
    T = upright(yaw, [0.3, 2.5, 0.5])
    half = np.array([0.45, 0.35, 0.2]) if kind == "box" else np.array([0.437, 0.437, 0.469])
    taken: list[np.ndarray] = []
    for _ in range(10):
        point = release_point(T, half, kind, LENGTH, taken)
        local = (point - T[:3, 3]) @ T[:3, :3]
        assert local[2] == pytest.approx(half[2])
        margin = half[:2] - LENGTH / 2 - WALL_MARGIN
        if kind == "box":
            assert np.all(np.abs(local[:2]) <= margin + 1e-9)
        else:
            assert np.hypot(*local[:2]) <= margin[0] + 1e-9
        for other in taken:
            assert np.linalg.norm(point[:2] - other[:2]) > 0.05
        taken.append(point - [0.0, 0.0, 0.3])


def test_the_first_release_is_over_the_middle():
    T = upright(0.3, [0.0, 2.5, 0.5])
    point = release_point(T, np.array([0.4, 0.4, 0.4]), "cylinder", LENGTH, [])
    np.testing.assert_allclose(point, [0.0, 2.5, 0.9], atol=1e-12)


def test_a_volume_hardly_wider_than_the_target_is_hit_in_the_middle():
    T = upright(0.0, [0.0, 2.5, 0.5])
    taken = [np.array([0.0, 2.5, 0.3])]
    point = release_point(T, np.array([0.15, 0.15, 0.4]), "box", LENGTH, taken)
    np.testing.assert_allclose(point, [0.0, 2.5, 0.9], atol=1e-12)


def test_the_release_goes_as_far_from_what_lies_there_as_the_volume_allows():
    T = upright(0.0, [0.0, 2.5, 0.5])
    half = np.array([0.437, 0.437, 0.469])
    lying = np.array([0.2, 2.5, 0.1])
    point = release_point(T, half, "cylinder", LENGTH, [lying])
    assert point[0] < 0.0
    assert np.linalg.norm(point[:2] - lying[:2]) > 0.4


@pytest.mark.parametrize("azimuth", [0.0, 1.5, -2.5])
def test_the_tool_points_down_and_lowers_the_target_straight(azimuth):
    release = np.array([2.4 * np.cos(azimuth), 2.4 * np.sin(azimuth), 0.9])
    heights = []
    for batch in place_options(release):
        for option in batch:
            for T in (option.pre_place, option.place):
                np.testing.assert_allclose(T[:3, 0], [0, 0, -1], atol=1e-12)
                np.testing.assert_allclose(T[:2, 3], release[:2], atol=1e-12)
                assert np.linalg.det(T[:3, :3]) == pytest.approx(1.0)
            assert option.pre_place[2, 3] > option.place[2, 3]
            assert option.pre_place[2, 3] > release[2]
            np.testing.assert_array_equal(option.pre_place[:3, :3], option.place[:3, :3])
        heights.append(batch[0].place[2, 3])
    assert heights == sorted(heights)  # lowest first
    assert heights[0] < release[2]


# ---- lines ----------------------------------------------------------------------------------


@pytest.mark.parametrize("distance", [0.0, 0.003, 0.2, 1.7])
def test_a_line_keeps_orientation_direction_and_spacing(distance):
    start = upright(0.4, [1.0, 2.0, 3.0])
    direction = np.array([2.0, -1.0, 2.0]) / 3.0
    end = start.copy()
    end[:3, 3] += distance * direction
    poses = line(start, end, 0.01)
    np.testing.assert_array_equal(poses[0], start)
    np.testing.assert_allclose(poses[-1], end, atol=1e-12)
    np.testing.assert_array_equal(poses[:, :3, :3], np.repeat(start[None, :3, :3], len(poses), 0))
    steps = np.diff(poses[:, :3, 3], axis=0)
    assert len(poses) >= 8
    assert np.all(np.linalg.norm(steps, axis=1) <= 0.01 + 1e-12)
    np.testing.assert_allclose(steps, np.repeat(steps[:1], len(steps), 0), atol=1e-12)


# ---- polylines ------------------------------------------------------------------------------


def test_polylines_have_the_poses_of_their_lines_and_are_aligned_at_a_corner():
    corners = np.tile(np.eye(4), (3, 3, 1, 1))
    corners[:, 1, 0, 3] = [0.1, 0.3, 0.2]  # in 5 steps, but 7 at least, 15 and 10
    corners[:, 2, :2, 3] = [[0.1, 0.3], [0.3, 0.1], [0.2, 0.4]]
    found = polylines(corners, 0.02)
    np.testing.assert_array_equal(np.diff(found.knots), [[7, 15], [15, 7], [10, 20]])
    index, row = found.aligned(1)
    assert (*index.shape, row) == (15 + 20 + 1, 3, 15)
    np.testing.assert_array_equal(index[row], found.knots[:, 1])
    assert set(index.ravel().tolist()) == set(range(len(found.poses)))
    for k, knots in enumerate(found.knots):
        lines = [line(a, b, 0.02) for a, b in pairwise(corners[k])]
        expected = np.concatenate([lines[0], lines[1][1:]])
        np.testing.assert_array_equal(found.poses[knots[0] : knots[-1] + 1], expected)
        steps = np.diff(index[:, k])
        assert set(steps.tolist()) <= {0, 1}
        repeated = np.flatnonzero(steps == 0)
        inside = (index[repeated, k] > knots[0]) & (index[repeated, k] < knots[-1])
        assert not np.any(inside)
