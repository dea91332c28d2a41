"""Plots of a whole run: offsets of every planned point, time by stage."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import FuncFormatter, LogLocator, NullLocator

from kr210_sim.plots.recorded import Recorded
from kr210_sim.plots.theme import (
    SMALL,
    Plot,
    drawing,
    ink,
    limit_line,
    new_figure,
    render,
    stage_ink,
    stage_label,
)  # fmt: skip
from kr210_sim.record import STAGES

_SUPERSCRIPTS = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")

_ROUNDING = 1e-13
"""Offsets [m, rad] below this are rounding of double precision and nothing else."""


def offset_plot(cycles: Sequence[Recorded], gate: float | None) -> Plot | None:
    """Draw the end-effector offset of every planned point, position and angle apart.

    Args:
        cycles: with records.
        gate: largest position offset that is allowed [m].

    Returns:
        None if no point was recorded.
    """
    offsets = {
        label: [np.asarray(cycle.record.get(name, ()), dtype=float) for cycle in cycles]
        for name, label in (("ik_offset_m", "position [m]"), ("ik_offset_rad", "angle [rad]"))
    }
    counts = [len(values) for values in offsets["position [m]"]]
    ends = np.cumsum([0, *counts])
    if not ends[-1]:
        return None
    with drawing():
        figure = new_figure(4.3, left=0.78, top=0.34)
        axes = figure.subplots(2, 1, sharex=True)
        for axis, (label, values) in zip(axes, offsets.items(), strict=True):
            _draw_offsets(axis, np.concatenate(values), gate if label.startswith("pos") else None)
            axis.set(ylabel=label, xlim=(0, ends[-1] + 1))
            for number in range(1, len(cycles), 2):
                axis.axvspan(
                    ends[number] + 0.5,
                    ends[number + 1] + 0.5,
                    color=ink("soft"),
                    alpha=0.12,
                    linewidth=0,
                )
        for cycle, start, count in zip(cycles, ends, counts, strict=False):
            if count:
                axes[0].text(
                    start + count / 2,
                    1.03,
                    str(cycle.cycle),
                    fontsize=SMALL,
                    ha="center",
                    transform=axes[0].get_xaxis_transform(),
                )
        axes[0].text(-0.01, 1.03, "cycle", fontsize=SMALL, ha="right", transform=axes[0].transAxes)
        axes[1].set_xlabel("planned point, in the order of the plan")
        svg = render(figure, "offsets")
    worst = {label: float(np.max(np.concatenate(values))) for label, values in offsets.items()}
    most = f"at most {worst['position [m]']:.1e} m and {worst['angle [rad]']:.1e} rad"
    rounding = max(worst.values()) < _ROUNDING
    return Plot(
        name="offsets",
        title="End-effector offset per planned point",
        alt=f"Offset of {ends[-1]} planned points of {len(cycles)} cycles, {most}.",
        caption=f"{ends[-1]} points, {most}: MuJoCo's own TCP pose at the angles the IK answered "
        "against the requested pose."
        + (" That is the rounding of double precision." if rounding else "")
        + " Triangles at the lower edge are exact zeros.",
        svg=svg,
    )


def _draw_offsets(axis: Axes, values: Any, gate: float | None) -> None:
    """Draw values on a logarithmic axis, zeros at its lower edge."""
    index = np.arange(1, len(values) + 1)
    zero = values <= 0
    axis.set_yscale("log")
    known = [*values[~zero], *([gate] if gate else [])]
    low, high = (min(known) / 2, max(known) * 2.5) if known else (1e-17, 1e-15)
    axis.set_ylim(low, high)
    axis.plot(index[~zero], values[~zero], ".", markersize=3.2, color=ink("line-1"))
    axis.plot(
        index[zero],
        np.full(zero.sum(), low),
        "^",
        markersize=3.6,
        color=ink("line-2"),
        clip_on=False,
    )
    if gate:
        limit_line(axis, gate, "gate", above=False)
    axis.yaxis.set_major_locator(LogLocator(10, numticks=6))
    axis.yaxis.set_minor_locator(NullLocator())
    axis.yaxis.set_major_formatter(FuncFormatter(lambda value, _: _power(value)))
    axis.grid(axis="y")


def _power(value: float) -> str:
    return "10" + str(round(np.log10(value))).translate(_SUPERSCRIPTS) if value > 0 else "0"


def stage_plot(cycles: Sequence[Recorded]) -> Plot:
    """Draw the time of each cycle by stage, as stacked bars, with the failures.

    Args:
        cycles: with records.
    """
    spans = [(row, span) for row, cycle in enumerate(cycles) for span in cycle.spans]
    used = [stage for stage in STAGES if any(stage == span.stage for _, span in spans)]
    with drawing():
        figure = new_figure(0.27 * len(cycles) + 1.95, left=0.5, right=1.15, top=0.3, bottom=1.5)
        axis = figure.subplots()
        for stage in used:
            of_stage = [(row, span) for row, span in spans if span.stage == stage]
            axis.barh(
                [row for row, _ in of_stage],
                [span.end - span.start for _, span in of_stage],
                left=[span.start for _, span in of_stage],
                color=stage_ink(stage),
                edgecolor=ink("paper"),
                linewidth=0.7,
                height=0.74,
                label=stage_label(stage),
            )
        for row, cycle in enumerate(cycles):
            _label_bar(axis, row, cycle)
        _frame_bars(axis, cycles)
        figure.legend(loc="lower center", ncols=3, columnspacing=1.2, handlelength=1.2)
        svg = render(figure, "stages")
    means = {stage: _mean_time(cycles, stage) for stage in used}
    longest = sorted(means, key=lambda stage: -means[stage])[:3]
    share = ", ".join(f"{stage_label(stage)} {means[stage]:.2f} s" for stage in longest)
    failed = [cycle.failed_text for cycle in cycles if cycle.failure is not None]
    return Plot(
        name="stages",
        title="Time by stage",
        alt=f"Stacked bars of the time that {len(cycles)} cycles spend in each stage; on average "
        f"{share}." + (f" Of them {'; '.join(failed)}." if failed else ""),
        caption=f"Longest on average: {share}. What comes after the return home (settle) is not "
        "part of the cycle time." + (" A cross ends the bar of a failed cycle." if failed else ""),
        svg=svg,
    )


def _frame_bars(axis: Axes, cycles: Sequence[Recorded]) -> None:
    longest = max(float(cycle.time[-1]) for cycle in cycles)
    axis.set(
        xlim=(0, 1.02 * longest),
        ylim=(len(cycles) - 0.4, -0.6),
        ylabel="cycle",
        xlabel="time since the start of the cycle [s]",
    )
    axis.set_yticks(range(len(cycles)), [str(cycle.cycle) for cycle in cycles])
    axis.tick_params(axis="y", length=0)
    beside = axis.get_yaxis_transform()
    axis.text(1.02, -0.95, "cycle time", fontsize=SMALL, color=ink("soft"), transform=beside)
    axis.grid(axis="x")
    axis.set_axisbelow(True)


def _label_bar(axis: Axes, row: int, cycle: Recorded) -> None:
    """Write the cycle time beside a bar, or the reason of the failure after a cross at its end."""
    beside = axis.get_yaxis_transform()
    if cycle.failure is None:
        text = f"{float(cycle.line['cycle_time_s']):.2f} s"
        axis.text(1.02, row, text, fontsize=SMALL, va="center", transform=beside)
        return
    axis.plot(float(cycle.time[-1]), row, "X", color=ink("bad"), mec=ink("paper"), markersize=8)
    reason = cycle.failure.reason
    axis.text(
        1.02,
        row,
        reason if len(reason) <= 12 else reason.replace("_", "_\n", 1),
        color=ink("bad"),
        weight="bold",
        fontsize=SMALL if len(reason) <= 12 else SMALL - 1.5,
        linespacing=1.0,
        va="center",
        transform=beside,
    )


def _mean_time(cycles: Sequence[Recorded], stage: str) -> float:
    """Return the mean time that the cycles with a stage spend in it [s]."""
    times = [
        sum(span.end - span.start for span in cycle.spans if span.stage == stage)
        for cycle in cycles
    ]
    return float(np.mean([time for time in times if time > 0]))
