"""Maps of success: by cell, and over any two quantities that were drawn at random."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.patches import FancyBboxPatch

from kr210_sim.plots.recorded import Scenery
from kr210_sim.plots.theme import SMALL, Plot, drawing, ink, new_figure, render
from kr210_sim.success_map import Axis as MapAxis
from kr210_sim.success_map import SuccessMap

_MOST_COLUMNS, _MOST_ROWS = 9, 12
"""With more the tiles are too small for figures."""

_IN_ONE_LINE = 6
"""Columns that are wide enough for figures in one line."""

_LEAST_HEIGHT = 2.2
"""Of a map [inch]: names of quantities stand beside it."""


def map_plot(cells: Mapping[int, tuple[int, int]], scenery: Scenery | None) -> Plot:
    """Draw the success rate of each cell, arranged as the robot sees them.

    Args:
        cells: number -> succeeded and all cycles.
        scenery: where the cells are; without it they stand in the order of their numbers.
    """
    rows = _arranged(sorted(cells), scenery)
    columns = max(map(len, rows))
    height = 0.72 * len(rows)
    with drawing():
        figure = new_figure(height + 0.1, left=0.05, right=0.05, top=0.05, bottom=0.05)
        axis = figure.subplots()
        axis.set_axis_off()
        axis.set(xlim=(0, columns), ylim=(len(rows), 0))
        for row, numbers in enumerate(rows):
            for column, number in enumerate(numbers):
                at = column + (columns - len(numbers)) / 2
                good, all_ = cells.get(number, (0, 0))
                _draw_tile(axis, at, row, good, all_, f"{good} of {all_}" if all_ else "none")
                axis.text(at + 0.1, row + 0.27, str(number), fontsize=SMALL, va="center")
        svg = render(figure, "cells")
    text = ", ".join(
        f"cell {number}: {good} of {all_}" for number, (good, all_) in sorted(cells.items())
    )
    return Plot(
        name="cells",
        title="Success by cell",
        alt=f"Successful cycles of each cell; {text}.",
        caption="Successful cycles of all that started in a cell"
        + (", arranged as seen from the robot." if scenery else ".")
        + " Dashed cells had no cycle.",
        svg=svg,
    )


def grid_plot(found: SuccessMap, why: str) -> Plot:
    """Draw the success rate over two quantities.

    Args:
        found: the map.
        why: a sentence that says why these two are shown, or nothing.
    """
    columns, rows = len(found.x.values), len(found.y.values)
    with drawing():
        height = max(_LEAST_HEIGHT, 0.62 * min(rows, _MOST_ROWS))
        figure = new_figure(height + 0.85, left=0.95, bottom=0.75)
        axis = figure.subplots()
        axis.set(xlim=(0, columns), ylim=(0, rows), xlabel=found.x.name, ylabel=found.y.name)
        between = "/" if columns <= _IN_ONE_LINE else "\n/"
        written = columns <= _MOST_COLUMNS and rows <= _MOST_ROWS
        for (x, y), all_ in np.ndenumerate(found.cycles):
            good = int(found.succeeded[x, y])
            text = f"{good}{between}{all_}" if all_ and written else ""
            _draw_tile(axis, x, y, good, int(all_), text)
        for side, of_side in ((axis.xaxis, found.x), (axis.yaxis, found.y)):
            places, labels = _ticks(of_side)
            side.set_ticks(places, labels)
        axis.tick_params(length=0, pad=6)
        axis.spines[:].set_visible(False)
        svg = render(figure, "map")
    worst = np.unravel_index(np.nanargmin(found.rate), found.rate.shape)
    fewest = (
        f"{found.succeeded[worst]} of {found.cycles[worst]} at {found.x.name} "
        f"{found.x.labels[worst[0]]} and {found.y.name} {found.y.labels[worst[1]]} "
        f"({100 * found.confidence:g} % interval {100 * found.low[worst]:.0f} to "
        f"{100 * found.high[worst]:.0f} %)"
    )
    left_out = f" {found.left_out} cycles have no such values." if found.left_out else ""
    return Plot(
        name="map",
        title="Success over two random quantities",
        alt=f"Successful of all cycles, in bins of {found.x.name} and {found.y.name}; the lowest "
        f"rate is {fewest}.",
        caption=f"Successful of all cycles in each bin; the lowest rate is {fewest}.{left_out} "
        f"{why}".rstrip(),
        svg=svg,
    )


def _ticks(axis: MapAxis) -> tuple[list[float], list[str]]:
    """Return where figures stand beside the bins, and the figures: values, or edges of bins."""
    if axis.edges is None:
        step = math.ceil(len(axis.values) / _MOST_COLUMNS)
        return [index + 0.5 for index in range(0, len(axis.values), step)], axis.labels[::step]
    step = math.ceil(len(axis.edges) / (_MOST_COLUMNS + 1))
    edges = axis.edges[::step].tolist()
    labels = [f"{edge:.2g}".replace("-", "\N{MINUS SIGN}") for edge in edges]
    return [float(index) for index in range(0, len(axis.edges), step)], labels


def _draw_tile(axis: Axes, column: float, row: float, good: int, all_: int, text: str) -> None:
    """Draw one tile in the colour of its success rate; dashed and empty without a cycle."""
    rate = good / all_ if all_ else 0.0
    for colour, alpha in (("bad", 0.5 * (1 - rate)), ("good", 0.45 * rate)) if all_ else ():
        axis.add_patch(_tile(column, row, facecolor=ink(colour), alpha=alpha, edgecolor="none"))
    line = {"edgecolor": ink("edge"), "facecolor": "none", "linestyle": "-" if all_ else "--"}
    axis.add_patch(_tile(column, row, **line))
    weight = "bold" if all_ else "normal"
    axis.text(
        column + 0.5, row + 0.5, text, ha="center", va="center", weight=weight, linespacing=1.0
    )


def _tile(column: float, row: float, **look: Any) -> FancyBboxPatch:
    return FancyBboxPatch(
        (column + 0.06, row + 0.09),
        0.88,
        0.82,
        boxstyle="round,pad=0,rounding_size=0.06",
        linewidth=0.9,
        **look,
    )


def _arranged(numbers: Sequence[int], scenery: Scenery | None) -> list[list[int]]:
    """Return rows of cells, the highest first, each from left to right as the robot sees it."""
    if scenery is None:
        return [list(numbers[start : start + 5]) for start in range(0, len(numbers), 5)]
    rows: dict[float, list[int]] = {}
    for number, place in scenery.cells.items():
        rows.setdefault(round(float(place[2]), 2), []).append(number)
    middle = np.mean([place[:2] for place in scenery.cells.values()], axis=0)
    left = np.array([-middle[1], middle[0]])
    return [
        sorted(row, key=lambda number: -float(scenery.cells[number][:2] @ left))
        for _, row in sorted(rows.items(), reverse=True)
    ]
