"""Poses along straight lines -> the continuous joint sequences that pass through them, by IK."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise, product
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

import ik
from kr210_sim.arrays import Array
from kr210_sim.exceptions import CycleFailure
from kr210_sim.robot import Robot
from kr210_sim.task import line

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

    def find(
        self, polylines: Sequence[tuple[Array, ...]], anchor: int, q_start: Array
    ) -> list[Track]:
        """Return the tracks along each of some polylines.

        Args:
            polylines: TCP poses (4, 4) of their corners, each of one orientation.
            anchor: the corner at which the analytic branches are counted.
            q_start: configuration (6,) from which a solver starts.

        Raises:
            CycleFailure: bad_ik, if a solver does not answer as agreed.
        """
        alike: dict[tuple[int, ...], list[Array]] = {}  # those of one shape are solved together
        for polyline in polylines:
            parts = [line(a, b, LINE_STEP) for a, b in pairwise(polyline)]
            joined = [parts[0]] + [part[1:] for part in parts[1:]]
            knots = (0, *np.cumsum([len(part) - 1 for part in parts]).tolist())
            alike.setdefault(knots, []).append(np.concatenate(joined))
        groups = [self._robot.tcp_to_palm(np.stack(group)) for group in alike.values()]
        tracks = []
        for knots, T_base_palm, answers in zip(
            alike, groups, self._solve(groups, q_start), strict=True
        ):
            if self._solver is None:
                found = self._follow(answers, knots[anchor])
            else:
                found = ((k, q) for k, answer in enumerate(answers) for q in self._accept(answer))
            tracks += [Track(T_base_palm=T_base_palm[k], q=q, knots=knots) for k, q in found]
        return tracks

    def _solve(self, groups: Sequence[Array], q_start: Array) -> list[Array]:
        """Return what the IK answers to groups of polylines (K, N, 4, 4).

        Of the analytic IK all branches (K, N, 8, 6), asked for all poses at once; of a solver one
        configuration to each (K, N, 6).
        """
        counts = [len(group) * group.shape[1] for group in groups]
        self.poses += sum(counts)
        started = time.perf_counter()
        if self._solver is None:
            poses = np.concatenate([group.reshape(-1, 4, 4) for group in groups])
            branches = np.split(ik.inverse(self._robot.geometry, poses).q, np.cumsum(counts)[:-1])
            found = [
                q.reshape(*group.shape[:2], 8, 6) for q, group in zip(branches, groups, strict=True)
            ]
        else:
            found = [np.stack([ask(self._solver, T, q_start) for T in group]) for group in groups]
        self.seconds += time.perf_counter() - started
        return found

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

    def _follow(self, branches: Array, anchor: int) -> Iterator[tuple[int, Array]]:
        """Yield every continuous in-limit sequence (N, 6) through branches (K, N, 8, 6).

        From each branch at the anchor the nearest solution is taken step by step to both ends, so
        that a passage through the wrist singularity, where the wrist branches swap, stays smooth.
        """
        reached = ~np.any(np.all(np.isnan(branches[..., 0]), axis=2), axis=1)
        steps = np.moveaxis(branches[reached], 1, 0)  # (N, K, 8, 6)
        back, there = _nearest(steps[anchor::-1]), _nearest(steps[anchor:])
        sequences = np.concatenate([back[:0:-1], there])
        if not sequences.size:
            return
        jump = np.max(np.abs(np.diff(sequences, axis=0)), axis=(0, 3))
        smooth = jump <= BRANCH_JUMP  # NaN compares false
        if not np.all(np.any(smooth, axis=1)):
            self._problems.add("branch")
        polyline = np.flatnonzero(reached)
        where = np.nonzero(smooth)
        index, q = self._turned(sequences[:, where[0], where[1]])
        yield from zip(polyline[where[0][index]].tolist(), q, strict=True)

    def _turned(self, sequences: Array) -> tuple[NDArray[np.int64], Array]:
        """Return all copies of sequences (N, S, 6) by whole turns that are within the limits.

        Returns:
            (M,) which sequence each is a copy of, and the copies (M, N, 6), in order.
        """
        low, high = np.min(sequences, axis=0), np.max(sequences, axis=0)
        first = np.ceil((self._robot.lower - low) / _TURN - 1e-9).astype(int)
        last = np.floor((self._robot.upper - high) / _TURN + 1e-9).astype(int)
        if np.any(last < first):
            self._problems.add("limits")
        found = [
            (index, turns)
            for index, (a, b) in enumerate(zip(first.tolist(), last.tolist(), strict=True))
            for turns in product(*map(range, a, (end + 1 for end in b)))
        ]
        index = np.array([index for index, _ in found], dtype=np.int64)
        turns = np.array([turns for _, turns in found], dtype=float).reshape(-1, 6)
        return index, np.moveaxis(sequences, 0, 1)[index] + _TURN * turns[:, None]

    def _accept(self, q: Array) -> Iterator[Array]:
        """Yield a solver's answer (N, 6) if it is complete, continuous and within limits."""
        if np.any(np.isnan(q)):
            return
        if np.any(~ik.within_limits(q, self._robot.lower, self._robot.upper)):
            self._problems.add("limits")
        elif np.max(np.abs(np.diff(q, axis=0))) > BRANCH_JUMP:
            self._problems.add("branch")
        else:
            yield q


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
    sequences = _nearest(branches[:, None])[:, 0]  # (N, 8, 6)
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


def _nearest(steps: Array) -> Array:
    """Return the sequences (N, K, 8, 6) that go on from each branch to the nearest one.

    Args:
        steps: (N, K, 8, 6) the branches, NaN where there is none.
    """
    joints = np.ascontiguousarray(np.moveaxis(steps, 3, 0))  # (6, N, K, 8)
    turn = joints[:, 1:, :, None, :] - joints[:, :-1, :, :, None]
    turn -= _TURN * np.round(turn / _TURN)
    size = np.max(np.abs(turn), axis=0)
    missing = np.isnan(size)
    nearest = np.argmin(np.where(missing, np.inf, size), axis=3)  # (N - 1, K, 8)
    turn = np.moveaxis(turn, 0, 4)
    same = np.arange(steps.shape[2])
    if np.all((nearest == same) | np.all(missing, axis=3)):  # mostly, away from singularities
        return np.cumsum(np.concatenate([steps[:1], turn[:, :, same, same]]), axis=0)
    polyline, branch = np.ogrid[: steps.shape[1], : steps.shape[2]]
    found = [steps[0]]
    for of_all, chosen in zip(turn, nearest, strict=True):
        after = chosen[polyline, branch]
        found.append(found[-1] + of_all[polyline, branch, after])
        branch = after
    return np.array(found)


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
