"""Plots of a grade: offsets of every answer, and its joints against their limits."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import groupby
from typing import Any

import numpy as np
from matplotlib.ticker import MaxNLocator

from kr210_sim.arrays import Array
from kr210_sim.plots.offsets import draw_offsets
from kr210_sim.plots.theme import Plot, drawing, ink, limit_line, new_figure, render

Pose = Mapping[str, Any]

_RIGHT = 1e-3
"""Offsets are compared with this in the plot [m]."""

_PANELS = {
    "gripper [m]": "position_error_m",
    "wrist center [m]": "wrist_center_error_m",
    "angle [rad]": "angle_error_rad",
}


def standout_plot(poses: Sequence[Pose]) -> Plot:
    """Draw the offsets of gripper, wrist center and orientation at the answered angles.

    Args:
        poses: of `grade.json`, in order; at least one with an answer.
    """
    cycles = {cycle: list(rows) for cycle, rows in groupby(poses, lambda pose: pose["cycle"])}
    panels = {
        label: [np.array([_size(pose.get(key)) for pose in rows]) for rows in cycles.values()]
        for label, key in _PANELS.items()
    }
    beside = (_RIGHT, "1 mm")
    svg = draw_offsets(
        "standout",
        panels,
        list(cycles),
        lines={"gripper [m]": beside, "wrist center [m]": beside},
        xlabel="pose, in the order in which they were asked for",
    )
    gripper, center, angle = (np.concatenate(values) for values in panels.values())
    missing = int(np.isnan(gripper).sum())
    far = int((gripper > _RIGHT).sum())
    text = f"{far} of {len(poses)} poses are missed by more than 1 mm"
    if missing:
        text += f", {missing} have no answer"
    text += (
        f"; at most {np.nanmax(gripper):.1e} m at the gripper, {np.nanmax(center):.1e} m at the "
        f"wrist center and {np.nanmax(angle):.1e} rad"
    )
    return Plot(
        name="standout",
        title="End-effector offset per pose",
        alt=f"Offsets of gripper, wrist center and orientation, pose by pose: {text}.",
        caption=f"{text}. Forward kinematics of the answered angles against the pose that was "
        "sent. Where the wrist center is right and the gripper is not, angles 4 to 6 are wrong; "
        "triangles are exact zeros, crosses poses without an answer.",
        svg=svg,
    )


def answers_plot(poses: Sequence[Pose], lower: Sequence[float], upper: Sequence[float]) -> Plot:
    """Draw the answered angles as shares of the joints' ranges, a gap between requests.

    Args:
        poses: of `grade.json`, in order; at least one with an answer.
        lower: joint limits [rad].
        upper: joint limits [rad].
    """
    q = np.array([pose["q_rad"] or [np.nan] * len(lower) for pose in poses])
    middle, half = (np.array(upper) + lower) / 2, (np.array(upper) - lower) / 2
    share = 100 * (q - middle) / half
    index = np.arange(1.0, len(poses) + 1)
    starts = [row for row, pose in enumerate(poses) if pose["pose"] == 0 and row]
    beyond = sum(bool(pose.get("beyond_limits")) for pose in poses)
    jumps = [row for row, pose in enumerate(poses) if pose.get("branch_jump") or pose.get("turns")]
    with drawing():
        figure = new_figure(3.6, left=0.78, bottom=1.05)
        axis = figure.subplots()
        for joint in range(q.shape[1]):
            axis.plot(
                _cut(index, starts),
                _cut(share[:, joint], starts),
                marker=".",
                markersize=2.2,
                linewidth=0.9,
                color=ink(f"line-{joint + 1}"),
                linestyle="-" if joint < 3 else (0, (4, 1.2)),
                label=f"theta {joint + 1}",
            )
        for limit in (-100, 100):
            limit_line(axis, limit)
        reach = max(115.0, 105 * float(np.nanmax(np.abs(share))) / 100)
        axis.plot(
            index[jumps], np.full(len(jumps), -reach), "^", color=ink("bad"), clip_on=False,
            markersize=5,
        )  # fmt: skip
        axis.set(ylim=(-reach, reach), xlim=(0, len(poses) + 1), ylabel="share of the limit [%]")
        axis.set_xlabel("pose, in the order in which they were asked for")
        axis.yaxis.set_major_locator(MaxNLocator(5, steps=[1, 2, 5, 10]))
        figure.legend(*axis.get_legend_handles_labels(), loc="lower center", ncols=3)
        svg = render(figure, "answers")
    changes = sum(bool(pose.get("branch_jump")) for pose in poses)
    turns = sum(pose.get("turns", 0) for pose in poses)
    text = (
        f"{beyond} answers lie beyond limits, {changes} steps change branch, and {turns} whole "
        "turns are made that need not be"
    )
    return Plot(
        name="answers",
        title="Answered angles against the joint limits",
        alt=f"The six angles of every answer as shares of their limits; {text}.",
        caption=f"{text} (triangles below). A line is one request; a good solver draws it without "
        "jumps. Dotted: the limits.",
        svg=svg,
    )


def _size(value: Any) -> float:
    """Return the length of a vector or the value itself, NaN for none."""
    return np.nan if value is None else float(np.linalg.norm(value))


def _cut(values: Array, starts: Sequence[int]) -> Array:
    """Return values with a gap before each start of a request."""
    return np.insert(values, starts, np.nan)
