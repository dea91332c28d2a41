"""A run's folder -> what its report shows of it, in memory that hardly grows with the run."""

from __future__ import annotations

import json
import math
import shlex
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from kr210_sim.criteria import CONDITIONS
from kr210_sim.exceptions import BadInput
from kr210_sim.film.format import FILM
from kr210_sim.plots.recorded import Recorded
from kr210_sim.record import load_series
from kr210_sim.results import CONFIG, CYCLES, SUMMARY, record_path
from kr210_sim.separation import Separation, telling_pair
from kr210_sim.success_map import BINS, SuccessMap, success_map

MOST_ROWS = 200
"""A longer table of cycles is cut: failures first."""

MOST_DETAILED = 12
"""Cycles whose plots are shown; failures first, but at least one success if there is one."""

MOST_OF_A_REASON = 10
"""Failures listed for one reason."""


_IN_CONFIG = ("options", "versions", "randomization", "world_sha256")
_IN_SUMMARY = (
    *("passed", "complete", "requested_cycles", "cycles", "succeeded", "success_rate", "ci95"),
    *("min_success", "gates", "limits", "clearance_m", "min_clearance_m", "sampled_motions"),
    *("slowed", "wall_time_s", "realtime_factor", "lost_workers", "notes"),
)
_IN_LINE = (
    *("cycle", "seed", "cell", "success", "reason", "failed_stage", "failed_time_s", "detail"),
    *("drawn", "cycle_time_s", "grasp_slip_m", "place_offset_m", "tracking_offset_m"),
    *("ik_offset_m", "min_clearance_m", *CONDITIONS),
)
"""What the page needs of each file."""

_KINDS = {
    **dict.fromkeys(("cycle", "seed"), int),
    "success": bool,
    **dict.fromkeys(("cell", "reason", "failed_stage"), int | str | None),
    "drawn": dict,
    **dict.fromkeys(("ik_offset_m", "tracking_offset_m"), dict | None),
}

Line = Mapping[str, Any]


@dataclass(kw_only=True)
class RunData:
    """A run as its report shows it.

    Attributes:
        out: its folder.
        config: `config.json`.
        summary: `summary.json`.
        rows: cycles of the table, in order.
        failures: reason -> the first failures for it.
        counts: reason -> how many there are.
        cells: number -> succeeded and all cycles.
        separation: what was drawn for failed cycles against what was for others.
        grid: success over two quantities, None if there are none to show.
        grid_asked: whether these two were asked for.
        detailed: cycles with their records, in order; none if no records were kept.
        unreadable: cycles whose record is there and damaged.
        film: whether there is a film.
    """

    out: Path
    config: Mapping[str, Any]
    summary: Mapping[str, Any]
    rows: list[Line] = field(default_factory=list)
    failures: dict[str, list[Line]] = field(default_factory=dict)
    counts: Counter[str] = field(default_factory=Counter)
    cells: dict[int, tuple[int, int]] = field(default_factory=dict)
    separation: Separation = field(default_factory=Separation)
    grid: SuccessMap | None = None
    grid_asked: bool = False
    detailed: list[Recorded] = field(default_factory=list)
    unreadable: list[int] = field(default_factory=list)
    film: bool = False

    @property
    def cycles(self) -> int:
        """Number of finished cycles."""
        return int(self.summary["cycles"])


def read_run(out: Path, quantities: Sequence[str] = ()) -> RunData:
    """Read the folder of a run.

    Args:
        out: the folder.
        quantities: the two of the map of success; without them those that tell most.

    Raises:
        BadInput: if it is none, was not ended, or a file of it is damaged; if there is no such
            quantity.
    """
    if not out.is_dir() or not (out / CONFIG).is_file():
        raise BadInput(f"report: {out} is no run; give the folder that a run has written")
    if not (out / SUMMARY).is_file():
        words = ("run", "--config", str(out / CONFIG), "--out", str(out), "--resume")
        raise BadInput(
            f"report: {out} has no {SUMMARY}, the run broke off; go on with it by "
            f"`kr210-sim {shlex.join(words)}`"
        )
    run = RunData(
        out=out,
        config=_read_json(out / CONFIG, _IN_CONFIG),
        summary=_read_json(out / SUMMARY, _IN_SUMMARY),
    )
    chosen = _Choice(out)
    for line in _lines(out / CYCLES):
        good, all_ = run.cells.get(line["cell"], (0, 0))
        run.cells[line["cell"]] = (good + bool(line["success"]), all_ + 1)
        if not line["success"]:
            run.counts[line["reason"]] += 1
            listed = run.failures.setdefault(line["reason"], [])
            if len(listed) < MOST_OF_A_REASON:
                listed.append(line)
        run.separation.add(line)
        chosen.add(line)
    _make_grid(run, quantities)
    run.rows = chosen.rows()
    for line in chosen.detailed():
        try:
            record = load_series(record_path(out, line["cycle"]))
        except BadInput:
            run.unreadable.append(line["cycle"])
        else:
            run.detailed.append(Recorded(line=line, record=record))
    run.film = (out / FILM).is_file()
    return run


def _make_grid(run: RunData, asked: Sequence[str]) -> None:
    """Count success over two quantities, unless nothing tells which."""
    run.grid_asked = bool(asked)
    if not asked:
        pair = telling_pair(run.separation.differences())
        asked = [each.name for each in pair] if pair else ()
    if asked and run.cycles:
        x, y = asked
        bins = min(BINS, max(2, round(math.sqrt(run.cycles) / 2)))
        run.grid = success_map(_lines(run.out / CYCLES), x, y, bins)


class _Choice:
    """Which cycles are shown: all of a short run, of a long one failures first."""

    def __init__(self, out: Path) -> None:
        self._out = out
        self._first: list[Line] = []
        self._failed: list[Line] = []
        self._kept: dict[bool, list[Line]] = {True: [], False: []}

    def add(self, line: Line) -> None:
        if len(self._first) < MOST_ROWS:
            self._first.append(line)
        if not line["success"] and len(self._failed) < MOST_ROWS:
            self._failed.append(line)
        kept = self._kept[bool(line["success"])]
        if len(kept) < MOST_DETAILED and record_path(self._out, line["cycle"]).is_file():
            kept.append(line)

    def rows(self) -> list[Line]:
        return _in_order([*self._failed[: MOST_ROWS // 2], *self._first], MOST_ROWS)

    def detailed(self) -> list[Line]:
        good, failed = self._kept[True], self._kept[False]
        return _in_order([*failed[: MOST_DETAILED - bool(good)], *good], MOST_DETAILED)


def _in_order(lines: list[Line], most: int) -> list[Line]:
    """Return the first different ones, in the order of the run."""
    different = {line["cycle"]: line for line in reversed(lines)}
    kept = list(dict.fromkeys(line["cycle"] for line in lines))[:most]
    return [different[cycle] for cycle in sorted(kept)]


def _read_json(path: Path, needed: Sequence[str]) -> dict[str, Any]:
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise BadInput(f"report: {path} cannot be read: {error}") from error
    return _checked(content, needed, str(path))


def _lines(path: Path) -> Iterator[Line]:
    """Yield the cycles of a run one by one; a torn last line is left out."""
    if not path.exists():
        return
    with path.open("rb") as lines:
        for number, raw in enumerate(lines, start=1):
            if not raw.endswith(b"\n"):
                return
            where = f"{path}, line {number}"
            try:
                line = json.loads(raw)
            except ValueError as error:
                raise BadInput(f"report: {where} cannot be read: {error}") from error
            yield _counted(_checked(line, _IN_LINE, where), where)


def _counted(line: Line, where: str) -> Line:
    """Return a cycle if what it is found and grouped by is a number or a name in it."""
    for name, kind in _KINDS.items():
        if not isinstance(line[name], kind) or (name == "drawn" and not _numbers(line[name])):
            raise BadInput(f"report: {where}: '{name}' is not what a run writes there")
    return line


def _numbers(drawn: Mapping[str, Any]) -> bool:
    """Return whether all that was drawn is a number, a vector, or nothing."""
    values = (value for value in drawn.values() if value is not None)
    each = (one for value in values for one in (value if isinstance(value, list) else [value]))
    return all(isinstance(one, int | float) for one in each)


def _checked(content: Any, needed: Sequence[str], where: str) -> dict[str, Any]:
    missing = [name for name in needed if not isinstance(content, dict) or name not in content]
    if missing:
        raise BadInput(
            f"report: {where} has no '{missing[0]}'; use the version that wrote the run, or run "
            "it again with this one"
        )
    return dict(content)
