"""Plots of one cycle over time: joints against their limits, tracking, grip force and slip."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import MaxNLocator

from kr210_sim.arrays import Array
from kr210_sim.criteria import SLIP_LIMIT
from kr210_sim.plots.recorded import Failure, Recorded, Scenery
from kr210_sim.plots.theme import (
    SMALL,
    WIDTH,
    Plot,
    drawing,
    ink,
    limit_line,
    new_figure,
    render,
    stage_ink,
)  # fmt: skip
from kr210_sim.record import stage_label

_LABEL_PITCH = 0.155
"""Least distance of the slanted stage names [inch]."""

_AXIS_WIDTH = WIDTH - 0.88
"""Of the time axis [inch]."""

_LAST_NAME = 0.6
"""From the start of the last of them to the end of the axis, at least [inch]."""

_NAMES_HEIGHT = 0.95
"""Room above the axes for the slanted stage names [inch]."""


def joints_plot(cycle: Recorded, scenery: Scenery, limits: Mapping[str, Any]) -> Plot:
    """Draw the arm's positions, velocities and accelerations as shares of their limits.

    Args:
        cycle: with a record.
        scenery: joint names and position limits.
        limits: `limits` of the summary.
    """
    q = cycle.joints(scenery.joints)
    time, step = cycle.time, float(np.median(np.diff(cycle.time)))
    middle, half = (scenery.upper + scenery.lower) / 2, (scenery.upper - scenery.lower) / 2
    velocity = np.gradient(q, step, axis=0) / np.array(limits["velocity_rad_s"])
    acceleration = np.zeros_like(q)
    acceleration[1:-1] = np.diff(q, 2, axis=0) / step**2 / np.array(limits["acceleration_rad_s2"])
    panels = {"position": (q - middle) / half, "velocity": velocity, "acceleration": acceleration}
    peaks = [_peak(name, share, time, scenery.joints) for name, share in panels.items()]
    with drawing():
        figure = new_figure(6.0, top=_NAMES_HEIGHT, bottom=1.0)
        axes = figure.subplots(3, 1, sharex=True)
        for axis, (name, share) in zip(axes, panels.items(), strict=True):
            for joint in range(q.shape[1]):
                axis.plot(
                    time,
                    100 * share[:, joint],
                    color=ink(f"line-{joint + 1}"),
                    linestyle="-" if joint < 3 else (0, (4, 1.2)),
                    label=scenery.joints[joint],
                )
            for limit in (-100, 100):
                limit_line(axis, limit)
            reach = max(110.0, 105 * float(np.max(np.abs(share))))
            axis.set(ylim=(-reach, reach), ylabel=f"{name} [%]")
            axis.yaxis.set_major_locator(MaxNLocator(5, steps=[1, 2, 5, 10]))
        figure.legend(*axes[0].get_legend_handles_labels(), loc="lower center", ncols=3)
        _frame(axes, cycle)
        svg = render(figure, name := f"cycle-{cycle.cycle}-joints")
    return Plot(
        name=name,
        title=f"Cycle {cycle.cycle}: joints against their limits",
        alt="Position, velocity and acceleration of the joints as shares of their limits; "
        + "; ".join(peaks)
        + _and(cycle),
        caption="Share of the limit of each joint, dotted at 100 %; measured every 10 ms, "
        f"differences between neighbours. Closest to a limit: {'; '.join(peaks)}.",
        svg=svg,
    )


def grip_plot(cycle: Recorded) -> Plot:
    """Draw the distance of the measured from the commanded TCP, grip force and slip."""
    time, record = cycle.time, cycle.record
    tracking, slip = 1e3 * record["tracking_max"], 1e3 * record["slip_m_max"]
    force = record["finger_force"]
    with drawing():
        figure = new_figure(5.4, top=_NAMES_HEIGHT)
        axes = figure.subplots(3, 1, sharex=True)
        axes[0].plot(time, tracking, color=ink("line-1"))
        axes[0].set(ylabel="tracking [mm]")
        for side, (name, style) in enumerate(
            (("right finger", "-"), ("left finger", (0, (4, 1.2))))
        ):
            axes[1].plot(
                time, force[:, side], color=ink(f"line-{side + 1}"), label=name, linestyle=style
            )
        axes[1].set(ylabel="grip force [N]")
        axes[1].legend(loc="upper right", ncols=2)
        axes[2].plot(time, slip, color=ink("line-3"))
        limit_line(axes[2], 1e3 * SLIP_LIMIT, "limit")
        axes[2].set(ylabel="slip [mm]")
        for axis, values, least in zip(
            axes, (tracking, force, slip), (0.1, 100.0, 5.0), strict=True
        ):
            axis.set_ylim(0, 1.28 * max(least, float(np.max(values))))
        _frame(axes, cycle)
        svg = render(figure, name := f"cycle-{cycle.cycle}-grip")
    most = (
        f"tracking at most {np.max(tracking):.2f} mm, grip force at most {np.max(force):.0f} N, "
        f"slip at most {np.max(slip):.2f} mm"
    )
    return Plot(
        name=name,
        title=f"Cycle {cycle.cycle}: tracking, grip force and slip",
        alt=f"Tracking error, force of both fingers and slip over time; {most}{_and(cycle)}",
        caption=f"{most[0].upper()}{most[1:]} (limit {1e3 * SLIP_LIMIT:g} mm). Slip is the shift "
        "of the target in the hand since lift-off, force the contact force of each finger on it.",
        svg=svg,
    )


def _peak(name: str, share: Array, time: Array, joints: Sequence[str]) -> str:
    step, joint = divmod(int(np.argmax(np.abs(share))), share.shape[1])
    return f"{name} {100 * abs(share[step, joint]):.0f} % ({joints[joint]}, {time[step]:.2f} s)"


def _and(cycle: Recorded) -> str:
    return cycle.failed_text and f"; {cycle.failed_text}"


def _frame(axes: Sequence[Axes], cycle: Recorded) -> None:
    """Shade the stages, name them above the first axis, mark a failure, and label the time."""
    end = float(cycle.time[-1])
    for axis in axes:
        for span in cycle.spans:
            axis.axvspan(span.start, span.end, color=stage_ink(span.stage), alpha=0.25, linewidth=0)
        axis.grid(axis="y")
        axis.set_xlim(0, end)
        axis.yaxis.set_label_coords(-0.125, 0.5)
    axes[-1].set_xlabel("time since the start of the cycle [s]")
    top = axes[0]
    centres = np.array([(span.start + span.end) / 2 for span in cycle.spans])
    inch = end / _AXIS_WIDTH
    places = _spread(centres, _LABEL_PITCH * inch, end - _LAST_NAME * inch)
    for span, centre, place in zip(cycle.spans, centres, places, strict=True):
        top.annotate(
            stage_label(span.stage),
            (centre, 1.0),
            (place, 1.09),
            xycoords=("data", "axes fraction"),
            textcoords=("data", "axes fraction"),
            rotation=55,
            rotation_mode="anchor",
            ha="left",
            va="center",
            fontsize=SMALL,
            arrowprops={
                "arrowstyle": "-",
                "color": ink("soft"),
                "linewidth": 0.6,
                "shrinkA": 0,
                "shrinkB": 0,
            },
        )
    if cycle.failure is not None:
        _mark(axes, cycle.failure, end)


def _mark(axes: Sequence[Axes], failure: Failure, end: float) -> None:
    for axis in axes:
        axis.axvline(failure.time, color=ink("bad"), linewidth=1.6)
    left = failure.time > end / 2
    axes[0].annotate(
        failure.short,
        (failure.time, 0.04),
        xycoords=("data", "axes fraction"),
        textcoords="offset points",
        xytext=(-4 if left else 4, 0),
        ha="right" if left else "left",
        va="bottom",
        color=ink("bad"),
        weight="bold",
        fontsize=SMALL,
        bbox={"facecolor": ink("paper"), "edgecolor": "none", "pad": 1.5},
    )


def _spread(places: Array, pitch: float, end: float) -> Array:
    """Return places moved apart to at least a pitch, within 0 and the end where they fit."""
    found = np.array(places)
    for index in range(1, len(found)):
        found[index] = max(found[index], found[index - 1] + pitch)
    found[-1] = min(found[-1], end)
    for index in range(len(found) - 2, -1, -1):
        found[index] = min(found[index], found[index + 1] - pitch)
    return found
