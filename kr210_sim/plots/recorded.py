"""A recorded cycle and the scene around it, as the plots need them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np

from kr210_sim.arrays import Array
from kr210_sim.record import stage_label

ARM_JOINTS = 6


class Span(NamedTuple):
    """A stage of a cycle and the time it takes [s]."""

    stage: str
    start: float
    end: float


class Failure(NamedTuple):
    """The first cause of a failed cycle; time since its start [s]."""

    time: float
    stage: str
    reason: str
    detail: str

    @property
    def short(self) -> str:
        """What stands beside its mark."""
        return f"{self.reason} at {self.time:.2f} s"


@dataclass(frozen=True, kw_only=True)
class Box:
    """A box of the scene.

    Attributes:
        T_base_box: (4, 4).
        half_size: (3,) [m].
    """

    T_base_box: Array
    half_size: Array


@dataclass(frozen=True, kw_only=True)
class Scenery:
    """What stands around the path of a cycle, in the base frame.

    Attributes:
        boxes: of all fixtures.
        arm: (n, 3) foot, joints and TCP of the arm at home [m].
        cells: number -> position (3,) [m].
        place: middle (3,) of the place volume [m].
        floor: height of the floor [m].
        joints: names of the arm's joints, without prefix.
        lower, upper: (6,) their position limits [rad].
    """

    boxes: tuple[Box, ...]
    arm: Array
    cells: Mapping[int, Array]
    place: Array
    floor: float
    joints: tuple[str, ...]
    lower: Array
    upper: Array


@dataclass(frozen=True, kw_only=True)
class Recorded:
    """A cycle as `cycles.jsonl` and its record have it.

    Attributes:
        line: of `cycles.jsonl`.
        record: what `record.load_series` reads; empty if the record was not kept.
    """

    line: Mapping[str, Any]
    record: Mapping[str, Any] = field(default_factory=dict)

    @property
    def cycle(self) -> int:
        """Index in the run."""
        return int(self.line["cycle"])

    @property
    def moved(self) -> bool:
        """Whether there is a record in which something happens."""
        return len(self.record.get("time", ())) > 2

    @property
    def failure(self) -> Failure | None:
        """The first cause, None on success."""
        line = self.line
        if line["reason"] is None:
            return None
        return Failure(
            float(line["failed_time_s"]), line["failed_stage"], line["reason"], line["detail"]
        )

    @property
    def failed_text(self) -> str:
        """What went wrong, when and where; empty on success."""
        found = self.failure
        if found is None:
            return ""
        stage = stage_label(found.stage)
        return f"cycle {self.cycle} failed at {found.time:.2f} s in {stage}: {found.reason}"

    @cached_property
    def time(self) -> Array:
        """End of each record step (n,) [s]."""
        return np.asarray(self.record["time"], dtype=float)

    @cached_property
    def spans(self) -> tuple[Span, ...]:
        """The stages in order, without gaps."""
        stage = np.asarray(self.record["stage"]).astype(int)
        names = self.record["stage_names"].tolist()
        last = np.flatnonzero(np.diff(stage, append=-1))
        ends = self.time[last].tolist()
        return tuple(
            Span(names[stage[index]], start, end)
            for index, start, end in zip(last, [0.0, *ends], ends, strict=False)
        )

    def joints(self, names: tuple[str, ...]) -> Array:
        """Return the recorded positions (n, 6) of joints by name, whatever their prefix [rad]."""
        ends = np.cumsum(self.record["joint_widths"])
        known = [name.rpartition("/")[2] for name in self.record["joint_names"].tolist()]
        columns = [int(ends[known.index(name)]) - 1 for name in names]
        return np.asarray(self.record["qpos"][:, columns], dtype=float)
