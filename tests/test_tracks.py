"""Tracks go on to the nearest IK branch, through singularities and next to them."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

import ik
from kr210_sim import tracks
from kr210_sim.task import polylines
from kr210_sim.tracks import BRANCH_JUMP, LINE_STEP, TrackFinder

TURN = 2 * np.pi


def lines_through(robot, q: np.ndarray, rng: np.random.Generator) -> list[tuple[np.ndarray, ...]]:
    """Return polylines of two lines of the TCP whose middle corner is where q (K, 6) is."""
    found = []
    for middle in robot.forward(q):
        corners = np.stack([middle] * 3)
        corners[[0, 2], :3, 3] += rng.normal(size=(2, 3)) * 0.1
        found.append(tuple(corners))
    return found


def followed(branches: np.ndarray, anchor: int, first: int) -> np.ndarray:
    """Return the sequence (N, 6) from one branch at the anchor through branches (N, 8, 6)."""
    q = np.full(branches[:, 0].shape, np.nan)
    for order in (range(anchor, len(q)), range(anchor, -1, -1)):
        at, q[anchor] = branches[anchor, first], branches[anchor, first]
        for before, now in pairwise(order):
            turns = branches[now] - at
            turns -= TURN * np.round(turns / TURN)
            if np.all(np.isnan(turns)):
                break
            nearest = np.nanargmin(np.max(np.abs(turns), axis=1))
            q[now] = q[before] + turns[nearest]
            at = branches[now, nearest]
    return q


@pytest.mark.parametrize("seed", range(3))
def test_sequences_go_on_to_the_nearest_branch_also_at_singularities(robot, seed):
    rng = np.random.default_rng([91, seed])
    q = rng.uniform(robot.lower, robot.upper, size=(24, 6)) / 2
    q[:8, 4] = rng.normal(size=8) * 0.02  # the wrist straight
    q[8:16, 2] = -np.pi / 2 + rng.normal(size=8) * 0.1  # the arm all but stretched
    lines = polylines(np.array(lines_through(robot, q, rng)), LINE_STEP)
    index, row = lines.aligned(1)
    branches = ik.inverse(robot.geometry, robot.tcp_to_palm(lines.poses)).q[index]
    joints = np.ascontiguousarray(np.moveaxis(branches, 3, 0))
    found = tracks._continued(joints, row)
    plain = tracks._plain(joints, tracks._turn_off(joints[:, 1:] - joints[:, :-1]))
    assert 3 <= np.sum(plain) <= 21
    for k in range(len(q)):
        for branch in range(8):
            expected = followed(branches[:, k], row, branch)
            np.testing.assert_allclose(found[:, :, k, branch].T, expected, atol=1e-12)


def test_tracks_are_continuous_within_limits_complete_and_as_their_polylines_say(robot):
    rng = np.random.default_rng(92)
    q = rng.uniform(robot.lower, robot.upper, size=(12, 6)) / 2
    corners = lines_through(robot, q, rng)
    finder = TrackFinder(robot)
    together = finder.find(corners, anchor=1, q_start=np.zeros(6))
    assert len(together) > 24
    assert finder.poses == len(together.lines.poses)
    alone = [finder.find([each], anchor=1, q_start=np.zeros(6)) for each in corners]
    assert [len(each) for each in alone] == np.bincount(together.of, minlength=12).tolist()
    for track, polyline, other in zip(
        together, together.of, (track for each in alone for track in each), strict=True
    ):
        np.testing.assert_array_equal(track.q, other.q)
        assert track.knots == other.knots
        assert np.max(np.abs(np.diff(track.q, axis=0))) <= BRANCH_JUMP
        assert np.all(ik.within_limits(track.q, robot.lower, robot.upper))
        T_base_palm = ik.forward(robot.geometry, track.q)
        np.testing.assert_allclose(T_base_palm, track.T_base_palm, atol=1e-7)
        T_base_tcp = (T_base_palm @ robot.T_palm_tcp)[list(track.knots)]
        np.testing.assert_allclose(T_base_tcp, np.stack(corners[polyline]), atol=1e-7)
