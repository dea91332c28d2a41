"""Poses along straight lines -> the continuous joint sequences that pass through them, by IK."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

import ik
from kr210_sim.arrays import Array
from kr210_sim.exceptions import CycleFailure
from kr210_sim.robot import Robot
from kr210_sim.task import Polylines, polylines

Solver: TypeAlias = Callable[[Array, Array], Array]
"""An IK that plugs in: f(T_base_palm (N, 4, 4), q_start (6,)) -> q (N, 6) [rad], NaN rows for no
answer."""

LINE_STEP = 0.02
"""Spacing of the poses solved along a straight line [m]; the spline between them is straight to
micrometres."""

BRANCH_JUMP = 0.35
"""A larger step of a joint between neighbours on a line [rad] is a change of branch."""

_TURN = 2 * np.pi


@dataclass(frozen=True, kw_only=True)
class Track:
    """One continuous joint sequence along a polyline of straight lines.

    Attributes:
        T_base_palm: (N, 4, 4) the poses.
        q: (N, 6) the configurations [rad].
        knots: index of each corner of the polyline within the N.
    """

    T_base_palm: Array
    q: Array
    knots: tuple[int, ...]

    def part(self, number: int) -> Array:
        """Return the configurations (n, 6) along one of the lines."""
        return self.q[self.knots[number] : self.knots[number + 1] + 1]


@dataclass(frozen=True, kw_only=True)
class Tracks:
    """Tracks along polylines of one number of corners.

    Attributes:
        lines: the K polylines, as poses T_base_palm.
        index: (N, K) of their poses, side by side; ends are repeated.
        of: (M,) which polyline each track is along.
        q: (M, N, 6) the configurations at those poses [rad].
    """

    lines: Polylines
    index: NDArray[np.int64]
    of: NDArray[np.int64]
    q: Array

    def __len__(self) -> int:
        """Return the number of tracks."""
        return len(self.of)

    def __getitem__(self, number: int) -> Track:
        """Return one of the tracks."""
        polyline = self.of[number]
        knots = self.lines.knots[polyline]
        first, last = int(knots[0]), int(knots[-1])
        begin = int(np.searchsorted(self.index[:, polyline], first, side="right")) - 1
        return Track(
            T_base_palm=self.lines.poses[first : last + 1],
            q=np.ascontiguousarray(self.q[number, begin : begin + last - first + 1]),
            knots=tuple((knots - first).tolist()),
        )

    def __iter__(self) -> Iterator[Track]:
        """Yield the tracks in order."""
        return (self[number] for number in range(len(self)))


class TrackFinder:
    """Finds tracks with the analytic IK, or with a solver that plugs in.

    The analytic IK offers every branch and turn; a solver has one answer to a pose.

    Attributes:
        seconds, poses: time spent in the IK [s], and how many poses it was asked for.
    """

    def __init__(self, robot: Robot, solver: Solver | None = None) -> None:
        self._robot, self._solver = robot, solver
        self.seconds, self.poses = 0.0, 0
        self._problems: set[str] = set()

    @property
    def one_answer(self) -> bool:
        """Whether a solver is plugged in, so that options are better tried one by one."""
        return self._solver is not None

    def find(self, corners: Sequence[tuple[Array, ...]], anchor: int, q_start: Array) -> Tracks:
        """Return the tracks along each of some polylines.

        Args:
            corners: TCP poses (4, 4) of each polyline, all of one number, each of one orientation.
            anchor: the corner at which the analytic branches are counted.
            q_start: configuration (6,) from which a solver starts.

        Raises:
            CycleFailure: bad_ik, if a solver does not answer as agreed.
        """
        flat = np.concatenate([T_base_tcp for polyline in corners for T_base_tcp in polyline])
        lines = polylines(flat.reshape(len(corners), -1, 4, 4), LINE_STEP)
        lines = replace(lines, poses=self._robot.tcp_to_palm(lines.poses))
        index, row = lines.aligned(anchor)
        self.poses += len(lines.poses)
        if self._solver is not None:
            answers = self._asked(self._solver, lines, q_start)
            of = np.array([k for k, q in enumerate(answers) if self._accepts(q)], dtype=np.int64)
            q = np.concatenate(answers)[index[:, of]].swapaxes(0, 1)
        else:
            started = time.perf_counter()
            branches = ik.inverse(self._robot.geometry, lines.poses).q
            self.seconds += time.perf_counter() - started
            joints = np.ascontiguousarray(branches.transpose(2, 0, 1))
            of, q = self._follow(joints[:, index], row)
        return Tracks(lines=lines, index=index, of=of, q=q)

    def _asked(self, solver: Solver, lines: Polylines, q_start: Array) -> list[Array]:
        """Return a solver's answers (n, 6) to each polyline [rad]."""
        started = time.perf_counter()
        parts = np.split(lines.poses, lines.knots[1:, 0])
        answers = [ask(solver, T_base_palm, q_start) for T_base_palm in parts]
        self.seconds += time.perf_counter() - started
        return answers

    def forget(self) -> None:
        """Forget what the polylines tried so far failed for."""
        self._problems.clear()

    def failure(self, stage: str, where: str) -> CycleFailure:
        """Return why no track was found, for all polylines tried since `forget`."""
        if "branch" in self._problems:
            detail = f"no IK branch stays continuous along the straight lines at {where}"
            return CycleFailure("no_path", detail, stage=stage)
        if "limits" in self._problems:
            detail = f"every IK answer at {where} is beyond a joint limit"
            return CycleFailure("joint_limits", detail, stage=stage)
        return CycleFailure("unreachable", f"no IK answer reaches {where}", stage=stage)

    def _follow(self, branches: Array, anchor: int) -> tuple[NDArray[np.int64], Array]:
        """Return every continuous in-limit sequence through branches (6, N, K, 8).

        From each branch at the anchor the nearest solution is taken step by step to both ends, so
        that a passage through the wrist singularity, where the wrist branches swap, stays smooth.

        Returns:
            (M,) in which of the K each is, and the sequences (M, N, 6), in order.
        """
        reached = np.flatnonzero(np.all(np.any(~np.isnan(branches[0]), axis=2), axis=0))
        sequences = _continued(branches[:, :, reached], anchor)
        jump = np.max(np.abs(np.diff(sequences, axis=1)), axis=(0, 1), initial=0.0)
        smooth = jump <= BRANCH_JUMP  # NaN compares false
        if not np.all(np.any(smooth, axis=1)):
            self._problems.add("branch")
        polyline, branch = np.nonzero(smooth)
        index, q = self._turned(sequences[:, :, polyline, branch])
        return reached[polyline[index]], q

    def _turned(self, sequences: Array) -> tuple[NDArray[np.int64], Array]:
        """Return all copies of sequences (6, N, S) by whole turns that are within the limits.

        Returns:
            (M,) which sequence each is a copy of, and the copies (M, N, 6), in order.
        """
        low, high = np.min(sequences, axis=1), np.max(sequences, axis=1)  # (6, S)
        first = np.ceil((self._robot.lower[:, None] - low) / _TURN - 1e-9).astype(int)
        last = np.floor((self._robot.upper[:, None] - high) / _TURN + 1e-9).astype(int)
        if np.any(last < first):
            self._problems.add("limits")
        choices = np.maximum(last - first + 1, 0)
        copies = np.prod(choices, axis=0)
        index = np.repeat(np.arange(len(copies)), copies)
        number = np.arange(len(index)) - np.repeat(np.cumsum(copies) - copies, copies)
        turns = first[:, index]
        several = np.flatnonzero(np.max(choices, axis=1, initial=1) > 1)
        for joint in several[::-1]:  # that of the last joint changes from copy to copy
            number, more = np.divmod(number, choices[joint, index])
            turns[joint] += more
        return index, (sequences[:, :, index] + _TURN * turns[:, None]).T

    def _accepts(self, q: Array) -> bool:
        """Return whether a solver's answer (N, 6) is complete, continuous and within limits."""
        if np.any(np.isnan(q)):
            return False
        if np.any(~ik.within_limits(q, self._robot.lower, self._robot.upper)):
            self._problems.add("limits")
            return False
        if np.max(np.abs(np.diff(q, axis=0))) > BRANCH_JUMP:
            self._problems.add("branch")
            return False
        return True


def follow(robot: Robot, T_base_palm: Array, q_start: Array) -> Array:
    """Return the configurations (N, 6) that go on from one along poses, branch and turns kept.

    Args:
        robot: limits and geometry.
        T_base_palm: (N, 4, 4) the poses, close together; the first is where `q_start` is.
        q_start: (6,) [rad].

    Raises:
        CycleFailure: unreachable, no_path or joint_limits.
    """
    branches = ik.inverse(robot.geometry, T_base_palm).q
    if np.any(np.all(np.isnan(branches[..., 0]), axis=1)):
        raise CycleFailure("unreachable", "the straight line leads out of reach")
    sequences = _continued(branches.transpose(2, 0, 1)[:, :, None], 0)[:, :, 0].transpose(1, 2, 0)
    turn = sequences[0] - q_start
    turns = _TURN * np.round(turn / _TURN)
    q = sequences - turns
    apart = np.max(np.abs(turn - turns), axis=1)
    best = int(np.nanargmin(apart))
    q = q[:, best]
    steps = np.abs(np.diff(q, axis=0, prepend=q_start[None]))
    if not np.max(steps) <= BRANCH_JUMP:
        raise CycleFailure("no_path", "the branch does not stay continuous along the straight line")
    if not np.all(ik.within_limits(q, robot.lower, robot.upper)):
        raise CycleFailure("joint_limits", "the straight line leads beyond a joint limit")
    return np.asarray(q)


def _continued(branches: Array, anchor: int) -> Array:
    """Return the sequences that go on from each branch to the nearest one, both ways.

    Args:
        branches: (6, N, K, 8) along K lines, NaN where there is none.
        anchor: at which of the N they begin.

    Returns:
        (6, N, K, 8), in the order of the branches at the anchor.
    """
    steps = branches.copy()  # but for the anchor, from its side
    turn = _turn_off(branches[:, 1:] - branches[:, :-1])
    steps[:, anchor + 1 :], steps[:, :anchor] = turn[:, anchor:], -turn[:, :anchor]
    swap = np.flatnonzero(~_plain(branches, turn))
    if len(swap):
        steps[:, anchor + 1 :, swap] = _nearest(branches[:, anchor:, swap])
        steps[:, :anchor, swap] = _nearest(branches[:, anchor::-1, swap])[:, ::-1]
    for way in (steps[:, anchor:], steps[:, anchor::-1]):
        np.cumsum(way, axis=1, out=way)
    return steps


def _turn_off(difference: Array) -> Array:
    """Return angles [rad] less whole turns, in place."""
    difference -= _TURN * np.round(difference / _TURN)
    return difference


def _plain(branches: Array, turn: Array) -> NDArray[np.bool_]:
    """Return along which of K lines each branch is surely nearest to itself.

    It is where a step is less than half of what the branches are apart. Those with the wrist
    flipped are half a turn of joint 4 apart, and the four arms at least as far as joints 1 to 3.

    Args:
        branches: (6, N, K, 8), NaN where there is none.
        turn: (6, N - 1, K, 8) their steps.
    """
    arms = [branches[:3, ..., branch] for branch in (0, 2, 4, 6)]
    apart = _turn_off(np.array([one - other for one, other in combinations(arms, 2)]))
    least = np.fmin.reduce(np.max(np.abs(apart), axis=1), axis=(0, 1), initial=np.pi)
    most = np.fmax.reduce(np.abs(turn), axis=(0, 1, 3), initial=0.0)
    missing = np.isnan(branches[0])
    return np.asarray((most < least / 2 - 1e-9) & np.all(missing == missing[0], axis=(0, 2)))


def _nearest(branches: Array) -> Array:
    """Return the steps (6, N - 1, K, 8) from each branch to the nearest one, and on from there.

    Args:
        branches: (6, N, K, 8), NaN where there is none.
    """
    turn = _turn_off(branches[:, 1:, :, None, :] - branches[:, :-1, :, :, None])
    size = np.max(np.abs(turn), axis=0)
    nearest = np.argmin(np.where(np.isnan(size), np.inf, size), axis=3)  # (N - 1, K, 8)
    line, branch = np.ogrid[: branches.shape[2], :8]
    steps = np.empty(turn.shape[:4])
    for row, chosen in enumerate(nearest):
        after = chosen[line, branch]
        steps[:, row] = turn[:, row, line, branch, after]
        branch = after
    return steps


def ask(solver: Solver, T_base_palm: Array, q_start: Array) -> Array:
    """Ask a solver, and hold it to the agreed form of the answer.

    Raises:
        CycleFailure: bad_ik, with what is wrong.
    """
    try:
        answer = np.asarray(solver(T_base_palm.copy(), q_start.copy()))
    except CycleFailure:
        raise
    except Exception as error:  # whatever foreign code raises is a finding, not our crash
        detail = f"the solver raised {type(error).__name__}: {' '.join(str(error).split())}"
        raise CycleFailure("bad_ik", detail) from error
    if answer.shape != (len(T_base_palm), 6) or answer.dtype.kind not in "fiu":
        detail = f"the solver answered {answer.dtype} {answer.shape}, not floats (N, 6)"
        raise CycleFailure("bad_ik", detail)
    if np.any(np.isinf(answer)):
        raise CycleFailure("bad_ik", "the solver answered an infinite angle")
    missing = np.isnan(answer)
    if np.any(missing.any(axis=1) & ~missing.all(axis=1)):
        raise CycleFailure("bad_ik", "the solver answered NaN for some angles of a pose, not all")
    return answer.astype(float)
