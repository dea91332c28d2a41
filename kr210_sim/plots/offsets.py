"""Offsets point by point on logarithmic axes, cycle after cycle: the course's standout plot."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import FuncFormatter, LogLocator, NullLocator

from kr210_sim.arrays import Array
from kr210_sim.plots.theme import SMALL, drawing, ink, limit_line, new_figure, render

_SUPERSCRIPTS = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")

_PANEL = 1.7
"""Height of a panel [inch]."""


def draw_offsets(
    name: str,
    panels: Mapping[str, Sequence[Array]],
    cycles: Sequence[int],
    *,
    lines: Mapping[str, tuple[float, str]],
    xlabel: str,
) -> str:
    """Draw panels of offsets over the same points, as an element of a page.

    Args:
        name: of the plot.
        panels: label -> the offsets of each cycle, (n,) each, at least one in all; NaN where there
            is none.
        cycles: their numbers.
        lines: label -> an offset to compare with, and what it is.
        xlabel: what the points are.
    """
    ends = np.cumsum([0, *map(len, next(iter(panels.values())))])
    with drawing():
        figure = new_figure(_PANEL * len(panels) + 0.9, left=0.78, top=0.34)
        axes = figure.subplots(len(panels), 1, sharex=True, squeeze=False)[:, 0]
        for axis, (label, values) in zip(axes, panels.items(), strict=True):
            _draw_panel(axis, np.concatenate(values), lines.get(label))
            axis.set(ylabel=label, xlim=(0, ends[-1] + 1))
            for start, end in zip(ends[1:-1:2], ends[2::2], strict=True):
                axis.axvspan(start + 0.5, end + 0.5, color=ink("soft"), alpha=0.12, linewidth=0)
        above = axes[0].get_xaxis_transform()
        for cycle, start, end in zip(cycles, ends[:-1], ends[1:], strict=True):
            if start < end:
                middle = (start + end) / 2
                axes[0].text(middle, 1.03, str(cycle), fontsize=SMALL, ha="center", transform=above)
        axes[0].text(-0.01, 1.03, "cycle", fontsize=SMALL, ha="right", transform=axes[0].transAxes)
        axes[-1].set_xlabel(xlabel)
        return render(figure, name)


def _draw_panel(axis: Axes, values: Array, line: tuple[float, str] | None) -> None:
    """Draw values (N,): zeros at the lower edge, what is missing at the upper one."""
    index = np.arange(1, len(values) + 1)
    zero, missing = values <= 0, np.isnan(values)
    seen = ~(zero | missing)
    axis.set_yscale("log")
    known = [*values[seen], *([line[0]] if line else [])]
    low, high = (min(known) / 2, max(known) * 2.5) if known else (1e-17, 1e-15)
    axis.set_ylim(low, high)
    axis.plot(index[seen], values[seen], ".", markersize=3.2, color=ink("line-1"))
    for chosen, height, marker, colour in (
        (zero, low, "^", "line-2"),
        (missing, high, "x", "bad"),
    ):
        axis.plot(
            index[chosen],
            np.full(chosen.sum(), height),
            marker,
            markersize=3.6,
            color=ink(colour),
            clip_on=False,
        )
    if line:
        limit_line(axis, *line, above=False)
    axis.yaxis.set_major_locator(LogLocator(10, numticks=6))
    axis.yaxis.set_minor_locator(NullLocator())
    axis.yaxis.set_major_formatter(FuncFormatter(lambda value, _: _power(value)))
    axis.grid(axis="y")


def _power(value: float) -> str:
    return "10" + str(round(np.log10(value))).translate(_SUPERSCRIPTS) if value > 0 else "0"
