"""Take: one recorded cycle as its film shows it, at any time."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from kr210_sim.arrays import Array
from kr210_sim.record import STAGES, load_series
from kr210_sim.results import record_path

STILL = 1.0
"""A cycle in which nothing moved is shown for this long [s]."""

_GAP = 1e-9  # [s], below which two recorded times are the same


@dataclass(frozen=True, kw_only=True)
class Take:
    """One recorded cycle.

    Attributes:
        score: its line of `cycles.jsonl`.
        series: its record, name -> (n, ...); no `time` if nothing moved.
        cycles: how many cycles the run has.
        succeeded: how many of the cycles before this one succeeded.
    """

    score: dict[str, Any]
    series: dict[str, Any]
    cycles: int
    succeeded: int

    @property
    def cycle(self) -> int:
        """Index in the run."""
        return int(self.score["cycle"])

    @cached_property
    def time(self) -> Array:
        """When the record steps end (n,) [s]; without any, the end alone."""
        return np.asarray(self.series.get("time", [STILL]), dtype=float)

    @property
    def duration(self) -> float:
        """Length of the record [s]."""
        return float(self.time[-1])

    @property
    def joints(self) -> list[tuple[str, int]]:
        """Names of the recorded joints with the number of their values, in order."""
        names, widths = self.series["joint_names"], self.series["joint_widths"]
        return list(zip(names.tolist(), widths.tolist(), strict=True))

    def step_at(self, time: float) -> int:
        """Return the record step that a time [s] falls in."""
        return min(int(np.searchsorted(self.time, time)), len(self.time) - 1)

    def at(self, name: str, time: float) -> Array | None:
        """Return a series at a time [s], straight between record steps; None if it has none."""
        values = self.series.get(name)
        if values is None:
            return None
        right = max(self.step_at(time), min(1, len(self.time) - 1))
        left = max(right - 1, 0)
        gap = self.time[right] - self.time[left]
        share = np.clip((time - self.time[left]) / gap, 0, 1) if gap > _GAP else 1.0
        return np.asarray((1 - share) * values[left] + share * values[right], dtype=float)

    def stage(self, time: float) -> str:
        """Return the stage at a time [s]."""
        if "stage" not in self.series:
            return str(self.score["failed_stage"] or STAGES[0])
        return STAGES[int(self.series["stage"][self.step_at(time)])]

    @cached_property
    def stages(self) -> list[tuple[str, float, float]]:
        """Stages with begin and end [s], as they came."""
        if "stage" not in self.series:
            return [(self.stage(0.0), 0.0, self.duration)]
        stage = np.asarray(self.series["stage"], dtype=int)
        ends = np.append(np.flatnonzero(np.diff(stage)), len(stage) - 1)
        begins = np.concatenate([[0.0], self.time[ends[:-1]]])
        return [
            (STAGES[stage[end]], float(begin), float(self.time[end]))
            for begin, end in zip(begins, ends, strict=True)
        ]

    @cached_property
    def waypoints(self) -> Array:
        """Commanded poses (m, 7) at the ends of the stages, in the base frame [m, quat_wxyz]."""
        if "tcp_commanded" not in self.series:
            return np.empty((0, 7))
        steps = [self.step_at(end) for _, _, end in self.stages]
        poses = np.asarray(self.series["tcp_commanded"], dtype=float)[steps]
        apart = np.linalg.norm(np.diff(poses[:, :3], axis=0), axis=1) > 1e-3
        return np.asarray(poses[np.append(True, apart)])

    def path(self, name: str) -> tuple[Array, NDArray[np.int64]]:
        """Return a TCP path thinned out to points (m, 3) [m], and their record steps (m,).

        Points are at most 40 mm or 0.1 s apart, so that curves look smooth and a rest costs little.
        """
        if name not in self.series:
            return np.empty((0, 3)), np.empty(0, dtype=np.int64)
        points = np.asarray(self.series[name], dtype=float)[:, :3]
        walked = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])
        steps = np.unique(np.floor(walked / 0.04), return_index=True)[1]
        steps = np.unique(np.append(steps, len(points) - 1)).astype(np.int64)
        return points[steps], steps

    @property
    def verdict_time(self) -> float:
        """When the verdict is known [s]: at the failure, or at the end."""
        failed = self.score.get("failed_time_s")
        return self.duration if failed is None else min(float(failed), self.duration)


def read_take(out: Path, score: dict[str, Any], *, cycles: int, succeeded: int) -> Take:
    """Read the record of a cycle.

    Args:
        out: folder of the run.
        score: the cycle's line of `cycles.jsonl`.
        cycles: how many the run has.
        succeeded: how many of those before it succeeded.

    Raises:
        BadInput: if it is damaged.
    """
    series = load_series(record_path(out, int(score["cycle"])))
    return Take(score=score, series=series, cycles=cycles, succeeded=succeeded)


def read_duration(path: Path) -> float:
    """Return the length of a record [s].

    Raises:
        BadInput: if it is damaged.
    """
    time = load_series(path, "time").get("time", [STILL])
    return float(time[-1])
