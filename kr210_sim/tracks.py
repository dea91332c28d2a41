"""Poses along straight lines -> the continuous joint sequences that pass through them, by IK."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import pairwise
from typing import TypeAlias

import numpy as np

import ik
from kr210_sim.arrays import Array
from kr210_sim.exceptions import CycleFailure
from kr210_sim.robot import Robot
from kr210_sim.task import line

Solver: TypeAlias = Callable[[Array, Array], Array]
"""An IK that plugs in: f(T_base_palm (N, 4, 4), q_start (6,)) -> q (N, 6) [rad], NaN rows for no
answer."""

LINE_STEP = 0.01
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

    def find(self, polyline: tuple[Array, ...], anchor: int, q_start: Array) -> list[Track]:
        """Return the tracks along a polyline.

        Args:
            polyline: TCP poses (4, 4) of its corners, all of one orientation.
            anchor: the corner at which the analytic branches are counted.
            q_start: configuration (6,) from which a solver starts.

        Raises:
            CycleFailure: bad_ik, if a solver does not answer as agreed.
        """
        parts = [line(a, b, LINE_STEP) for a, b in pairwise(polyline)]
        joined = [parts[0]] + [part[1:] for part in parts[1:]]
        knots = (0, *np.cumsum([len(part) - 1 for part in parts]).tolist())
        T_base_palm = self._robot.tcp_to_palm(np.concatenate(joined))
        self.poses += len(T_base_palm)
        started = time.perf_counter()
        if self._solver is None:
            branches = ik.inverse(self._robot.geometry, T_base_palm).q
            self.seconds += time.perf_counter() - started
            found = self._follow(branches, knots[anchor])
        else:
            q = _answer(self._solver, T_base_palm, q_start)
            self.seconds += time.perf_counter() - started
            found = self._accept(q)
        return [Track(T_base_palm=T_base_palm, q=q, knots=knots) for q in found]

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

    def _follow(self, branches: Array, anchor: int) -> Iterator[Array]:
        """Yield every continuous in-limit sequence (N, 6) through branches (N, 8, 6).

        From each branch at the anchor the nearest solution is taken step by step to both ends, so
        that a passage through the wrist singularity, where the wrist branches swap, stays smooth.
        """
        if np.any(np.all(np.isnan(branches[:, :, 0]), axis=1)):
            return
        sequences = np.empty((branches.shape[1], len(branches), 6))
        sequences[:, anchor] = branches[anchor]
        for order in (range(anchor + 1, len(branches)), range(anchor - 1, -1, -1)):
            previous = branches[anchor]
            for index in order:
                step = branches[index][None, :, :] - previous[:, None, :]
                step -= _TURN * np.round(step / _TURN)
                size = np.max(np.abs(step), axis=2)
                nearest = np.argmin(np.where(np.isnan(size), np.inf, size), axis=1)
                previous = previous + step[np.arange(len(previous)), nearest]
                sequences[:, index] = previous
        jump = np.max(np.abs(np.diff(sequences, axis=1)), axis=(1, 2))
        if not np.any(jump <= BRANCH_JUMP):
            self._problems.add("branch")
        for sequence in sequences[jump <= BRANCH_JUMP]:  # NaN compares false
            yield from self._turned(sequence)

    def _turned(self, sequence: Array) -> Iterator[Array]:
        """Yield the copies of a sequence (N, 6), shifted by whole turns, that hold the limits."""
        low, high = np.min(sequence, axis=0), np.max(sequence, axis=0)
        first = np.ceil((self._robot.lower - low) / _TURN - 1e-9)
        last = np.floor((self._robot.upper - high) / _TURN + 1e-9)
        if np.any(last < first):
            self._problems.add("limits")
            return
        axes = [np.arange(a, b + 1) for a, b in zip(first, last, strict=True)]
        for turns in np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 6):
            yield sequence + _TURN * turns

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


def _answer(solver: Solver, T_base_palm: Array, q_start: Array) -> Array:
    """Ask a solver, and hold it to the agreed form of the answer.

    Raises:
        CycleFailure: bad_ik, with what is wrong.
    """
    try:
        answer = np.asarray(solver(T_base_palm.copy(), q_start.copy()))
    except Exception as error:  # whatever foreign code raises is a finding, not our crash
        detail = f"the solver raised {type(error).__name__}: {' '.join(str(error).split())}"
        raise CycleFailure("bad_ik", detail) from error
    if answer.shape != (len(T_base_palm), 6) or answer.dtype.kind not in "fiu":
        detail = f"the solver answered {answer.dtype} {answer.shape}, not floats (N, 6)"
        raise CycleFailure("bad_ik", detail)
    if np.any(np.isinf(answer)):
        raise CycleFailure("bad_ik", "the solver answered an infinite angle")
    return answer.astype(float)
