"""The plot of TCP paths in three dimensions, over the boxes of the scene."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection, PolyCollection

from kr210_sim.arrays import Array
from kr210_sim.plots.recorded import Box, Recorded, Scenery
from kr210_sim.plots.theme import (
    SMALL,
    WIDTH,
    Plot,
    drawing,
    ink,
    new_figure,
    render,
    stage_ink,
)  # fmt: skip
from kr210_sim.record import stage_label

_ASIDE = np.radians(-22.0)
"""The eye stands behind the robot, this far to the side of the middle between cells and
place [rad]."""

_ELEVATION = np.radians(24.0)

_TO_FIGURE, _TICK, _APART = 0.14, 0.06, 0.3
"""From the grid to its figures, length of the ticks of height, least distance of figures [m]."""

_FACES = (("side", 0), ("front", 1), ("top", 2))
"""Shade of the faces across each axis of a box."""


@dataclass(frozen=True, kw_only=True)
class _View:
    """A parallel projection.

    Attributes:
        right, up: (3,) unit vectors of the picture in the base frame.
        to_eye: (3,) towards the observer.
    """

    right: Array
    up: Array
    to_eye: Array

    def project(self, p_base: Array) -> Array:
        """Return the places (..., 2) of points (..., 3) in the picture [m]."""
        return np.stack([p_base @ self.right, p_base @ self.up], axis=-1)


def path_plot(cycles: Sequence[Recorded], scenery: Scenery) -> Plot:
    """Draw the measured TCP path of one cycle by stage, or of several cycles by verdict.

    Args:
        cycles: with records.
        scenery: what stands around.
    """
    paths = [np.asarray(cycle.record["tcp_measured"][:, :3], dtype=float) for cycle in cycles]
    everything = np.concatenate([*paths, scenery.arm, *map(_corners, scenery.boxes)])
    view = _view_of(scenery)
    single = len(cycles) == 1
    with drawing():
        extent = _extent(view, everything)
        room = 0.78 if single else 0.3  # for the legend
        height = WIDTH * (extent[3] - extent[2]) / (extent[1] - extent[0])
        figure = new_figure(height + room, left=0, right=0, top=0, bottom=room)
        axis = figure.subplots()
        axis.set_axis_off()
        axis.set(xlim=extent[:2], ylim=extent[2:])
        _draw_floor(axis, view, everything, scenery.floor)
        _draw_boxes(axis, view, scenery.boxes)
        arm = view.project(scenery.arm)
        axis.plot(*arm.T, color=ink("edge"), linewidth=5, alpha=0.55, solid_capstyle="round")
        for cycle, path in zip(cycles, paths, strict=True):
            _draw_path(axis, view, cycle, path, scenery.floor, by_stage=single)
        _draw_legend(axis, cycles)
        name = f"cycle-{cycles[0].cycle}-path" if single else "paths"
        svg = render(figure, name)
    failed = [cycle for cycle in cycles if cycle.failure is not None]
    what = f"cycle {cycles[0].cycle}" if single else f"{len(cycles)} cycles"
    crosses = " A cross marks where a cycle failed." if failed else ""
    mean = "" if single else " on average"
    length = float(
        np.mean([np.sum(np.linalg.norm(np.diff(path, axis=0), axis=1)) for path in paths])
    )
    return Plot(
        name=name,
        title=f"TCP path of {what}" + (" over the scene" if single else ""),
        alt=f"The measured path of the TCP of {what} among the fixtures of the scene, in three "
        f"dimensions; {length:.2f} m long{mean}."
        + "".join(f" {cycle.failed_text}." for cycle in failed),
        caption=f"Measured path, {length:.2f} m{mean}, its shadow on the "
        f"floor, and the arm at home in grey; fixtures as boxes, the grid is 1 m.{crosses}",
        svg=svg,
    )


def _view_of(scenery: Scenery) -> _View:
    ends = np.array([np.mean(list(scenery.cells.values()), axis=0), scenery.place])[:, :2]
    toward = np.sum(ends / np.linalg.norm(ends, axis=1, keepdims=True), axis=0)
    azimuth = np.arctan2(-toward[1], -toward[0]) + _ASIDE
    cos, sin = np.cos(_ELEVATION), np.sin(_ELEVATION)
    to_eye = np.array([cos * np.cos(azimuth), cos * np.sin(azimuth), sin])
    right = np.cross([0.0, 0.0, 1.0], to_eye)
    right /= np.linalg.norm(right)
    return _View(right=right, up=np.cross(to_eye, right), to_eye=to_eye)


def _extent(view: _View, points: Array) -> tuple[float, float, float, float]:
    """Return left, right, bottom and top of what must be seen, with a margin [m]."""
    low, high = _floor_range(points)
    floor = [[x, y, 0.0] for x in (low[0], high[0]) for y in (low[1], high[1])]
    ceiling = [[*corner[:2], points[:, 2].max()] for corner in floor]
    seen = view.project(np.concatenate([points, floor, ceiling]))
    (left, bottom), (right, top) = seen.min(axis=0), seen.max(axis=0)
    return left - 0.3, right + 0.3, bottom - 0.45, top + 0.3


def _floor_range(points: Array) -> tuple[Array, Array]:
    return np.floor(points[:, :2].min(axis=0)), np.ceil(points[:, :2].max(axis=0))


def _draw_floor(axis: Axes, view: _View, points: Array, floor: float) -> None:
    """Draw a grid of 1 m on the floor with its figures, and a scale of height."""
    low, high = _floor_range(points)
    lines: list[Array] = []
    written: list[Array] = []
    for fixed, name in ((0, "x [m]"), (1, "y [m]")):
        along = 1 - fixed
        # The figures stand along the edge that is nearer to the eye.
        near, far = (high, low) if view.to_eye[along] > 0 else (low, high)
        values = np.arange(low[fixed], high[fixed] + 0.5)
        for value in values:
            ends = np.full((2, 3), floor)
            ends[:, fixed], ends[:, along] = value, (far[along], near[along])
            lines.append(view.project(ends))
            outward = lines[-1][1] - lines[-1][0]
            outward /= np.linalg.norm(outward)
            place = lines[-1][1] + _TO_FIGURE * outward
            if all(np.linalg.norm(place - other) > _APART for other in written):
                _write(axis, place, _figure(value))
                written.append(place)
        middle = (lines[-1][1] + lines[-len(values)][1]) / 2
        _write(axis, middle + 3.6 * _TO_FIGURE * outward, name)
    corners = np.array([[x, y, floor] for x in (low[0], high[0]) for y in (low[1], high[1])])
    corner = corners[np.argmax(corners @ view.right)]
    across, upward = np.eye(2)
    highest = float(np.max(points[:, 2])) - floor
    foot, top = view.project(np.array([corner, corner + highest * np.eye(3)[2]]))
    lines.append(np.array([foot, top]))
    for height in np.arange(1.0, highest):
        place = foot + (top - foot) * height / highest
        lines.append(np.array([place - _TICK * across, place]))
        _write(axis, place + _TO_FIGURE * across, _figure(height))
    _write(axis, top + _TO_FIGURE * upward, "z [m]")
    axis.add_collection(LineCollection(lines, colors=ink("grid"), linewidths=0.8))


def _figure(value: float) -> str:
    return f"{value:g}".replace("-", "\N{MINUS SIGN}")


def _write(axis: Axes, place: Array, text: str) -> None:
    x, y = place.tolist()
    axis.text(x, y, text, ha="center", va="center", fontsize=SMALL, color=ink("soft"))


def _draw_boxes(axis: Axes, view: _View, boxes: Iterable[Box]) -> None:
    """Draw the visible faces of boxes, those far from the eye first."""
    faces, shades, depths = [], [], []
    for box in boxes:
        R, centre = box.T_base_box[:3, :3], box.T_base_box[:3, 3]
        for shade, k in _FACES:
            normal = R[:, k] * (1.0 if R[:, k] @ view.to_eye > 0 else -1.0)
            u, v = (
                R[:, (k + 1) % 3] * box.half_size[(k + 1) % 3],
                R[:, (k + 2) % 3] * box.half_size[(k + 2) % 3],
            )
            middle = centre + normal * box.half_size[k]
            corners = middle + np.array([u + v, u - v, -u - v, -u + v])
            faces.append(view.project(corners))
            shades.append(ink("top" if abs(normal[2]) > 0.7 else shade))
            depths.append(float(np.max(corners @ view.to_eye)))
    order = np.argsort(depths, kind="stable")
    axis.add_collection(
        PolyCollection(
            [faces[index] for index in order],
            facecolors=[shades[index] for index in order],
            edgecolors=ink("edge"),
            linewidths=0.5,
        )
    )


def _draw_path(
    axis: Axes, view: _View, cycle: Recorded, path: Array, floor: float, *, by_stage: bool
) -> None:
    shadow = path.copy()
    shadow[:, 2] = floor
    axis.plot(*view.project(shadow).T, color=ink("soft"), linewidth=1, alpha=0.35)
    places = view.project(path)
    if by_stage:
        for span in cycle.spans:
            part = (cycle.time >= span.start - 1e-6) & (cycle.time <= span.end + 1e-6)
            if part.sum() > 1:
                axis.plot(
                    *places[part].T,
                    color=stage_ink(span.stage),
                    linewidth=2.6,
                    solid_capstyle="round",
                )
    else:
        colour = "good" if cycle.failure is None else "bad"
        axis.plot(*places.T, color=ink(colour), linewidth=1.5, alpha=0.85)
    if cycle.failure is not None:
        index = int(np.clip(np.searchsorted(cycle.time, cycle.failure.time), 0, len(path) - 1))
        axis.plot(
            *places[index], "X", color=ink("bad"), markeredgecolor=ink("paper"), markersize=10
        )
        if by_stage:
            left = places[index, 0] > np.mean(axis.get_xlim())
            axis.annotate(
                cycle.failure.short,
                places[index],
                textcoords="offset points",
                xytext=(-9 if left else 9, 9),
                ha="right" if left else "left",
                color=ink("bad"),
                weight="bold",
                fontsize=SMALL,
                bbox={"facecolor": ink("paper"), "edgecolor": "none", "pad": 1.5, "alpha": 0.8},
            )


def _draw_legend(axis: Axes, cycles: Sequence[Recorded]) -> None:
    if len(cycles) == 1:
        marks = [
            axis.plot(
                [], [], color=stage_ink(span.stage), linewidth=3, label=stage_label(span.stage)
            )
            for span in cycles[0].spans
        ]
    else:
        verdicts = {cycle.failure is None for cycle in cycles}
        marks = [
            axis.plot([], [], color=ink(colour), label=label)
            for good, colour, label in ((True, "good", "succeeded"), (False, "bad", "failed"))
            if good in verdicts
        ]
    axis.figure.legend(
        handles=[mark[0] for mark in marks],
        loc="lower center",
        ncols=3,
        columnspacing=1.2,
        handlelength=1.4,
    )


def _corners(box: Box) -> Array:
    signs = np.array(np.meshgrid([-1, 1], [-1, 1], [-1, 1])).reshape(3, 8).T
    corners: Array = box.T_base_box[:3, 3] + (signs * box.half_size) @ box.T_base_box[:3, :3].T
    return corners
