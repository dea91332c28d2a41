"""Plots of a whole run: offsets of every planned point, time by stage."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes

from kr210_sim.plots.offsets import draw_offsets
from kr210_sim.plots.recorded import Recorded
from kr210_sim.plots.theme import (
    SMALL,
    Plot,
    drawing,
    ink,
    new_figure,
    render,
    stage_ink,
)  # fmt: skip
from kr210_sim.record import STAGES, stage_label

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
    count = sum(map(len, offsets["position [m]"]))
    if not count:
        return None
    svg = draw_offsets(
        "offsets",
        offsets,
        [cycle.cycle for cycle in cycles],
        lines={"position [m]": (gate, "gate")} if gate else {},
        xlabel="planned point, in the order of the plan",
    )
    worst = {label: float(np.max(np.concatenate(values))) for label, values in offsets.items()}
    most = f"at most {worst['position [m]']:.1e} m and {worst['angle [rad]']:.1e} rad"
    rounding = max(worst.values()) < _ROUNDING
    return Plot(
        name="offsets",
        title="End-effector offset per planned point",
        alt=f"Offset of {count} planned points of {len(cycles)} cycles, {most}.",
        caption=f"{count} points, {most}: MuJoCo's own TCP pose at the angles the IK answered "
        "against the requested pose."
        + (" That is the rounding of double precision." if rounding else "")
        + " Triangles at the lower edge are exact zeros.",
        svg=svg,
    )


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
