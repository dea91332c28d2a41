"""Success over two quantities: cycles binned by what was drawn for them, with exact intervals."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from kr210_sim.arrays import Array
from kr210_sim.exceptions import BadInput
from kr210_sim.stats import success_interval

Bins: TypeAlias = int | Sequence[float]
"""Number of bins, or their edges in ascending order."""

BINS = 5
LOG_RATIO = 10.0
"""Bins have equal ratios instead of equal widths where all values are above 0 and the largest is
over this multiple of the smallest, as those of a log-uniform quantity mostly are."""

MOST_BINS = 64


@dataclass(frozen=True, kw_only=True)
class Axis:
    """One quantity of a map.

    Attributes:
        name: of the quantity, its unit as ending.
        edges: (n + 1,) limits of the bins, lower ones included, and the last one too; None where
            every bin is one value, as of `cell`.
        values: (n,) the values of the bins then, else their middles.
    """

    name: str
    edges: Array | None
    values: Array

    @property
    def labels(self) -> list[str]:
        """What stands beside each bin: its value, or its limits."""
        if self.edges is None:
            return [f"{value:g}" for value in self.values]
        low, high = self.edges[:-1], self.edges[1:]
        return [f"{a:.3g}..{b:.3g}" for a, b in zip(low, high, strict=True)]

    def index(self, values: Array) -> NDArray[np.intp]:
        """Return the bin of each value; -1 outside of all."""
        if self.edges is None:
            found = np.searchsorted(self.values, values)
            inside = self.values[np.minimum(found, len(self.values) - 1)] == values
            return np.where(inside, found, -1)
        found = np.searchsorted(self.edges, values, side="right") - 1
        found = np.where(values == self.edges[-1], len(self.edges) - 2, found)
        return np.where(found < len(self.edges) - 1, found, -1)


@dataclass(frozen=True, kw_only=True)
class SuccessMap:
    """Cycles and successes over two quantities. Arrays are (bins of x, bins of y).

    Attributes:
        x, y: the quantities.
        cycles: number of cycles.
        succeeded: number of those that succeeded.
        rate: success rate, NaN where there is no cycle.
        low, high: its exact (Clopper-Pearson) interval at `confidence`, NaN likewise.
        confidence: of the intervals.
        left_out: cycles that lack a quantity or are outside of given edges.
    """

    x: Axis
    y: Axis
    cycles: NDArray[np.int64]
    succeeded: NDArray[np.int64]
    rate: Array
    low: Array
    high: Array
    confidence: float
    left_out: int

    def as_json(self) -> dict[str, Any]:
        """Return plain JSON values; what is NaN here is null."""
        return {
            "x": _axis_json(self.x),
            "y": _axis_json(self.y),
            "cycles": self.cycles.tolist(),
            "succeeded": self.succeeded.tolist(),
            **{name: _nullable(getattr(self, name)) for name in ("rate", "low", "high")},
            "confidence": self.confidence,
            "left_out": self.left_out,
        }


def quantities(line: Mapping[str, Any]) -> dict[str, float]:
    """Return everything drawn for a cycle that can be an axis, by name.

    That is `cell`, every number under `drawn`, and of a vector `NAME.1`, `NAME.2`, ... (components
    in its order: x, y, z or joints 1 to 6) and `NAME.norm`, its length.

    Args:
        line: a cycle as `cycles.jsonl` has it.
    """
    found = {"cell": line["cell"]}
    for name, value in (line.get("drawn") or {}).items():
        if isinstance(value, list):
            found |= {f"{name}.{index}": each for index, each in enumerate(value, start=1)}
            found[f"{name}.norm"] = math.hypot(*value)
        elif value is not None:
            found[name] = value
    return found


def success_map(
    lines: Iterable[Mapping[str, Any]],
    x: str,
    y: str,
    bins: Bins = BINS,
    *,
    bins_y: Bins | None = None,
    confidence: float = 0.95,
) -> SuccessMap:
    """Count cycles and successes over two of the quantities that `quantities` names.

    A number of bins is shared out over the range of the values: with equal widths, or with equal
    ratios where the values are positive and span more than a decade (`LOG_RATIO`). A quantity of
    whole numbers gets a bin per value instead, and so does one that is always the same.

    Args:
        lines: cycles as `cycles.jsonl` has them, read once and not kept.
        x: name of a quantity, such as `cell`, `target_mass_kg` or `perceived_shift_m.norm`.
        y: name of another one, or the same.
        bins: number or edges of the bins.
        bins_y: those of y, if they are others.
        confidence: of the exact interval of every bin.

    Raises:
        BadInput: if no cycle has such a quantity, naming those there are, or bins make no sense.
    """
    table, total = _read(lines, x, y)
    axis_x = _axis(x, table[:, 0], bins)
    axis_y = _axis(y, table[:, 1], bins if bins_y is None else bins_y)
    at_x, at_y = axis_x.index(table[:, 0]), axis_y.index(table[:, 1])
    inside = (at_x >= 0) & (at_y >= 0)
    shape = (len(axis_x.values), len(axis_y.values))
    cycles, succeeded = np.zeros(shape, np.int64), np.zeros(shape, np.int64)
    np.add.at(cycles, (at_x[inside], at_y[inside]), 1)
    np.add.at(succeeded, (at_x[inside], at_y[inside]), table[inside, 2].astype(np.int64))
    rate, low, high = (np.full(shape, np.nan) for _ in range(3))
    for at in zip(*np.nonzero(cycles), strict=True):
        rate[at] = succeeded[at] / cycles[at]
        low[at], high[at] = success_interval(int(succeeded[at]), int(cycles[at]), confidence)
    return SuccessMap(
        x=axis_x,
        y=axis_y,
        cycles=cycles,
        succeeded=succeeded,
        rate=rate,
        low=low,
        high=high,
        confidence=confidence,
        left_out=total - int(np.sum(inside)),
    )


def map_text(found: SuccessMap) -> str:
    """Return a map as a table, `succeeded/cycles` a bin, x down and y across."""
    across = found.y.labels
    cells = [
        [f"{good}/{count}" if count else "-" for good, count in zip(*row, strict=True)]
        for row in zip(found.succeeded.tolist(), found.cycles.tolist(), strict=True)
    ]
    first = max(map(len, (*found.x.labels, found.x.name)))
    width = max(map(len, (*across, *(cell for row in cells for cell in row))))
    lines = [f"{'':<{first}}  {found.y.name}"]
    lines.append(f"{found.x.name:<{first}}  {'  '.join(f'{text:>{width}}' for text in across)}")
    for label, row in zip(found.x.labels, cells, strict=True):
        lines.append(f"{label:<{first}}  {'  '.join(f'{text:>{width}}' for text in row)}")
    if found.left_out:
        lines.append(f"{found.left_out} cycles are left out")
    return "\n".join(lines)


def _read(lines: Iterable[Mapping[str, Any]], x: str, y: str) -> tuple[Array, int]:
    """Return x, y and success of the cycles that have both, (n, 3), and the number of all."""
    rows, known, total = list[tuple[float, float, bool]](), set[str](), 0
    for line in lines:
        values = quantities(line)
        known |= values.keys()
        total += 1
        if x in values and y in values:
            rows.append((values[x], values[y], line["success"]))
    for name in (x, y):
        if name not in known:
            names = ", ".join(sorted(known)) or "none, as it has no finished cycle"
            raise BadInput(f"--map: no quantity '{name}' in this run; there are: {names}")
    if not rows:
        raise BadInput(f"no cycle of this run has both '{x}' and '{y}'; choose another pair")
    return np.array(rows, dtype=float), total


def _axis(name: str, values: Array, bins: Bins) -> Axis:
    if not isinstance(bins, int):
        edges = np.asarray(bins, dtype=float)
        if edges.ndim != 1 or len(edges) < 2 or not np.all(np.diff(edges) > 0):
            raise BadInput(f"{name}: edges of bins must be two or more ascending numbers")
        return Axis(name=name, edges=edges, values=(edges[:-1] + edges[1:]) / 2)
    if not 1 <= bins <= MOST_BINS:
        raise BadInput(f"{name}: {bins} bins are out of range; give 1 to {MOST_BINS}")
    distinct = np.unique(values)
    if len(distinct) == 1 or (np.all(distinct % 1 == 0) and len(distinct) <= MOST_BINS):
        return Axis(name=name, edges=None, values=distinct)
    low, high = distinct[0], distinct[-1]
    if low > 0 and high > LOG_RATIO * low:
        edges = np.geomspace(low, high, bins + 1)
        return Axis(name=name, edges=edges, values=np.sqrt(edges[:-1] * edges[1:]))
    edges = np.linspace(low, high, bins + 1)
    return Axis(name=name, edges=edges, values=(edges[:-1] + edges[1:]) / 2)


def _axis_json(axis: Axis) -> dict[str, Any]:
    edges = None if axis.edges is None else axis.edges.tolist()
    return {"name": axis.name, "edges": edges, "values": axis.values.tolist()}


def _nullable(table: Array) -> list[list[float | None]]:
    return [[None if math.isnan(value) else value for value in row] for row in table.tolist()]
