"""The drawings of the course, from the model of the arm, and what its plots have in common."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.figure import Figure

import ik
from kr210_sim.robot import Robot, bundled_robot, find_robot

STYLE = {
    "font.size": 11.0,
    "svg.fonttype": "none",
    "svg.hashsalt": "course",
    "font.family": ["DejaVu Sans", "sans-serif"],
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "grid.color": "#d5dbe1",
    "legend.frameon": False,
}
INK, SOFT, ARM, PALE = "#1f2328", "#57606a", "#e07b28", "#f3d9c0"
RED, GREEN, BLUE = "#c8242a", "#2a8f3a", "#1f66c8"
ARM_MODEL = ik.KR210
BEFORE_CELL, FAR = (2.2, 0.0, 1.678), (2.5, 0.0, 1.25)  # of gripper_link, pages 5 and 6 [m]


def save(figure: Figure, path: Path) -> None:
    """Write a figure as SVG, the same bits every time."""
    with matplotlib.rc_context(STYLE):
        figure.savefig(path, metadata={"Date": None, "Creator": None})


def canvas(width: float, height: float, *, equal: bool = False) -> tuple[Figure, Any]:
    """Return an empty figure [inch] and its axes."""
    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=(width, height), layout="constrained", facecolor="white")
        FigureCanvasSVG(figure)
        axes = figure.add_subplot()
    if equal:
        axes.set_aspect("equal")
        axes.set_axis_off()
    return figure, axes


def robot() -> Robot:
    """Return the bundled robot."""
    from kr210_sim.description import load_description

    return find_robot(load_description(bundled_robot()))


def _arrow(
    axes: Any, a: Any, b: Any, colour: str, *, style: str = "-|>", width: float = 1.8
) -> None:
    axes.annotate(
        "", xy=tuple(b), xytext=tuple(a),
        arrowprops={"arrowstyle": style, "color": colour, "lw": width, "shrinkA": 0, "shrinkB": 0},
    )  # fmt: skip


def _size(axes: Any, a: Any, b: Any, text: str, beside: tuple[float, float]) -> None:
    """Draw a dimension from a to b, its text beside the middle."""
    _arrow(axes, a, b, SOFT, style="<|-|>", width=1.0)
    middle = (np.add(a, b)) / 2 + beside
    axes.text(*middle, text, color=SOFT, ha="center", va="center", fontsize=10)


def _side(p: Any) -> Any:
    """Return the side view (x, z) of points (..., 3)."""
    return np.asarray(p)[..., [0, 2]]


def _lines(q: Any) -> Any:
    """Return axis 1 at the base, axis 2, axis 3, wrist center, and gripper_link: (5, 3) [m]."""
    chain = robot().chain
    T = np.eye(4)
    points = [np.zeros(3)]
    for i, (origin, axis) in enumerate(zip(chain.origins, chain.axes, strict=True)):
        T = T @ origin
        if i in (1, 2):
            points.append(T[:3, 3].copy())
        T = T @ _turned(axis, q[i])
    palm = ik.forward(ARM_MODEL, q)
    return np.array([*points, ik.wrist_center(ARM_MODEL, palm), palm[:3, 3]])


def _turned(axis: Any, angle: float) -> Any:
    x, y, z = axis
    K = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    T = np.eye(4)
    T[:3, :3] += np.sin(angle) * K + (1 - np.cos(angle)) * K @ K
    return T


def _draw_arm(axes: Any, q: Any, *, colour: str = ARM) -> Any:
    """Draw the arm from the side; return base, axis 2, axis 3, wrist center, gripper (5, 2)."""
    base, two, three, W, G = points = _side(_lines(q))
    a3 = ARM_MODEL.a3
    pitch = q[1] + q[2]
    corner = three + a3 * np.array([np.sin(pitch), np.cos(pitch)])  # foot of axis 4 below axis 3
    for line in (
        [base, (0.0, two[1]), two],
        [two, three],
        [three, corner, W],
        [W, G],
    ):
        axes.plot(*np.array(line).T, color=colour, lw=6, solid_capstyle="round",
                  solid_joinstyle="round", alpha=0.45, zorder=1)  # fmt: skip
    return points


def dh_frames() -> Figure:
    """Draw the DH frames at q = 0, seen from -y."""
    figure, axes = canvas(5.8, 4.7, equal=True)
    _, two, three, W, G = _draw_arm(axes, np.zeros(6))
    chain = robot().chain
    table = ik.dh_from_chain(chain.origins, chain.axes, chain.T_last_palm)
    frames = [table.T_base]
    for step in table.transforms(np.zeros(6)):
        frames.append(frames[-1] @ step)
    shift = {0: (0, 0), 1: (0, 0), 2: (0, 0), 3: (0, 0), 7: (0, 0)}
    # frames 4, 5 and 6 share their origin: drawn below it, one after the other
    shift |= {4: (-0.55, -0.72), 5: (0.0, -0.72), 6: (0.42, -0.72)}
    beside = {
        "z2": (0.28, -0.02),
        "z3": (0.28, -0.02),
        "x1": (-0.1, -0.09),
        "z0": (-0.17, -0.1),
    }  # else in the way
    for i, T in enumerate(frames):
        at = _side(T[:3, 3]) + shift[i]
        if i in (4, 5, 6):
            axes.plot(*np.array([W, at]).T, color=SOFT, lw=0.8, ls=":")
        for axis, name, colour in ((0, "x", RED), (2, "z", BLUE)):
            way = T[:3, axis]
            if abs(way[1]) > 0.5:
                axes.plot(*at, "o", ms=13, mfc="white", mec=colour, zorder=4)
                axes.plot(*at, "." if way[1] < 0 else "x", ms=8, color=colour, zorder=5)
                label = at - 0.09 + beside.get(f"{name}{i}", (0.0, 0.0))
                axes.text(*label, f"{name}{i}", color=colour, ha="right", va="top", fontsize=11)
            else:
                end = at + 0.26 * _side(way)
                _arrow(axes, at, end, colour)
                label = end + 0.08 * _side(way) + beside.get(f"{name}{i}", (0.0, 0.0))
                axes.text(*label, f"{name}{i}", color=colour, ha="center", va="center", fontsize=11)
    _size(axes, (-0.3, 0), (-0.3, two[1]), "d1 = 0.75", (-0.02, 0))
    axes.texts[-1].set_ha("right")
    _size(axes, (0, 0.5), (two[0], 0.5), "a1 = 0.35", (0.13, -0.09))
    _size(axes, two - (0.2, 0), three - (0.2, 0), "a2 = 1.25", (-0.03, 0))
    axes.texts[-1].set_ha("right")
    _size(axes, (three[0], 2.42), (W[0], 2.42), "d4 = 1.5", (0, 0.08))
    _size(axes, (1.2, three[1]), (1.2, W[1]), "", (0, 0))
    axes.text(
        1.2, three[1] + 0.03, "a3 = -0.054", color=SOFT, ha="center", va="bottom", fontsize=10
    )
    axes.plot([three[0] + 0.35, 1.3], [three[1]] * 2, color=SOFT, lw=0.8, ls="--")
    _size(axes, (W[0], 2.42), (G[0], 2.42), "d7 = 0.303", (0, 0.08))
    axes.text(W[0], 0.78, "frames 4, 5, 6 share their origin,\nthe wrist center", color=SOFT,
              ha="center", va="top", fontsize=10)  # fmt: skip
    axes.set_xlim(-0.75, 2.75)
    axes.set_ylim(-0.1, 2.6)
    key = "base frame: x to the right, z up\n⊗ into the page (+y), ⊙ out of it"
    axes.text(1.0, 0.3, key, color=SOFT, ha="left", va="top", fontsize=10)
    return figure


def four_moves() -> Figure:
    """Draw the four moves of row 2: from frame 1 to frame 2."""
    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=(5.6, 3.5), layout="constrained", facecolor="white")
        FigureCanvasSVG(figure)
    one = np.eye(4)
    one[2, 3] = 0.75
    q2 = 0.4
    moves = [
        ("frame 1", np.eye(4)),
        ("Rx(α₁ = -π/2)", _turned((1, 0, 0), -np.pi / 2)),
        ("Tx(a₁ = 0.35)", _moved(0, 0.35)),
        ("Rz(θ₂ = q₂ - π/2)", _turned((0, 0, 1), q2 - np.pi / 2)),
        ("Tz(d₂ = 0): frame 2", np.eye(4)),
    ]
    T = one
    for i, (title, move) in enumerate(moves):
        axes = figure.add_subplot(2, 3, i + 1)
        axes.set_aspect("equal")
        axes.set_axis_off()
        T = T @ move
        _triad(axes, one, "#c4cad1", ("", "", ""))
        _triad(axes, T, None, ("x", "y", "z"))
        axes.set_title(title, fontsize=10.5)
        axes.set_xlim(-0.45, 0.85)
        axes.set_ylim(0.15, 1.35)
    return figure


def _moved(axis: int, length: float) -> Any:
    T = np.eye(4)
    T[axis, 3] = length
    return T


def _oblique(p: Any) -> Any:
    """Return where a point is drawn, y going back at an angle."""
    x, y, z = p
    return np.array([x + 0.45 * y, z + 0.3 * y])


def _triad(axes: Any, T: Any, colour: str | None, names: Sequence[str]) -> None:
    for i, (name, ink) in enumerate(zip(names, (RED, GREEN, BLUE), strict=True)):
        start, end = _oblique(T[:3, 3]), _oblique(T[:3, 3] + 0.4 * T[:3, i])
        _arrow(axes, start, end, colour or ink)
        axes.text(*(end + 0.16 * (end - start)), name, color=ink, ha="center", va="center")


def _reaching(p: Any) -> Any:
    T = np.eye(4)
    T[:3, 3] = p
    return ik.inverse(ARM_MODEL, T).q[0]


def wrist_center() -> Figure:
    """Draw the way back from the gripper to the wrist center, before a cell."""
    figure, axes = canvas(5.6, 2.7, equal=True)
    *_, W, G = _draw_arm(axes, _reaching(BEFORE_CELL))
    _arrow(axes, G, np.add(G, (0.32, 0)), BLUE)
    axes.text(G[0] + 0.36, G[1], "z₇ (x of gripper_link)", color=BLUE, va="center")
    _arrow(axes, G, W, RED, width=2.4)
    link6 = G - (0.11, 0)
    for p, text, up in ((W, "W, wrist center", 0.14), (G, "p, gripper_link", -0.13)):
        axes.plot(*p, "o", color=INK, ms=6, zorder=5)
        axes.text(p[0], p[1] + up, text, ha="center", va="center", color=INK)
    axes.plot(*link6, "s", color=SOFT, ms=5, zorder=5)
    _size(axes, np.add(W, (0, 0.27)), np.add(G, (0, 0.27)), "0.303", (0, 0.07))
    _size(axes, link6 - (0, 0.27), G - (0, 0.27), "0.11", (0, -0.07))
    axes.text(link6[0] - 0.08, G[1] - 0.27, "link_6", color=SOFT, ha="right", va="center")
    axes.set_xlim(1.25, 3.25)
    axes.set_ylim(1.3, 2.1)
    return figure


def triangle() -> Figure:
    """Draw the triangle of theta 2 and theta 3, and the sag of the forearm."""
    figure, axes = canvas(5.8, 4.1, equal=True)
    q = _reaching(FAR)
    _, two, three, W, _ = _draw_arm(axes, q)
    for a, b, text, beside in (
        (two, three, "a2 = 1.25", (-0.44, -0.2)),
        (three, W, "L = 1.501", (0.0, 0.13)),
        (two, W, "D", (0.35, 0.0)),
    ):
        axes.plot(*np.array([a, b]).T, color=BLUE, lw=2)
        axes.text(*((a + b) / 2 + beside), text, color=BLUE, ha="center", va="center")
    axes.plot(*np.array([two, (W[0], two[1]), W]).T, color=SOFT, lw=1, ls="--")
    axes.text((two[0] + W[0]) / 2, two[1] - 0.09, "u = r - a1", color=SOFT, ha="center")
    axes.text(W[0] + 0.05, (two[1] + W[1]) / 2, "v = z - d1", color=SOFT, ha="left")
    elevation = np.degrees(np.arctan2(W[1] - two[1], W[0] - two[0]))
    upper = np.degrees(np.arctan2(three[1] - two[1], three[0] - two[0]))
    back = np.degrees(np.arctan2(two[1] - three[1], two[0] - three[0])) % 360
    forth = np.degrees(np.arctan2(W[1] - three[1], W[0] - three[0])) % 360
    for center, a, b, radius, text, colour in (
        (two, elevation, upper, 0.3, "A", RED),
        (three, back, forth, 0.24, "B", RED),
        (two, 0.0, elevation, 0.75, "elevation", GREEN),
        (two, upper, 90.0, 0.62, "θ₂", INK),
    ):
        _arc(axes, center, a, b, radius, text, colour)
    axes.plot(*np.array([two, np.add(two, (0, 0.8))]).T, color=SOFT, lw=1, ls=":")
    for p, text, beside in ((two, "axis 2", (-0.14, -0.1)), (three, "axis 3", (-0.02, 0.12)),
                            (W, "W", (0.1, 0.0))):  # fmt: skip
        axes.plot(*p, "o", color=INK, ms=6, zorder=5)
        axes.text(*(p + beside), text, ha="center", va="center", color=INK)
    _sag(figure)
    return figure


def _arc(axes: Any, center: Any, a: float, b: float, radius: float, text: str, colour: str) -> None:
    angles = np.radians(np.linspace(a, b, 60))
    line = np.asarray(center) + radius * np.stack([np.cos(angles), np.sin(angles)], axis=1)
    axes.plot(*line.T, color=colour, lw=1.8)
    middle = np.radians((a + b) / 2)
    at = np.asarray(center) + (radius + 0.06 + 0.03 * len(text)) * np.array(
        [np.cos(middle), np.sin(middle)]
    )
    axes.text(*at, text, color=colour, ha="center", va="center", fontsize=12)


def _sag(figure: Figure) -> None:
    """Draw the forearm at theta 3 = 0, stretched four times upwards."""
    d4, a3, times = ARM_MODEL.d4, ARM_MODEL.a3, 4.0
    axes = figure.add_axes((0.56, 0.02, 0.43, 0.3))
    axes.set_axis_off()
    low = times * a3
    axes.plot([0, 0, d4], [0, low, low], color=ARM, lw=6, alpha=0.45, solid_joinstyle="round")
    axes.plot([0, d4], [0, low], color=BLUE, lw=2)
    axes.plot([0, d4], [0, 0], color=SOFT, lw=1, ls="--")
    axes.text(
        d4 / 2,
        0.05,
        "θ₃ = 0, heights four times",
        color=SOFT,
        ha="center",
        va="bottom",
        fontsize=10,
    )
    axes.text(1.08, -0.065, "sag 0.036 rad", color=RED, ha="center", va="center", fontsize=10)
    axes.text(-0.04, low / 2, "0.054", color=SOFT, ha="right", va="center", fontsize=10)
    axes.text(d4 / 2, low - 0.04, "d4 = 1.5", color=SOFT, ha="center", va="top", fontsize=10)
    axes.text(d4 + 0.05, low, "W", va="center", fontsize=11)
    axes.set_xlim(-0.25, 1.65)
    axes.set_ylim(-0.42, 0.22)


DRAWINGS: dict[str, Callable[[], Figure]] = {
    "dh_frames.svg": dh_frames,
    "four_moves.svg": four_moves,
    "wrist_center.svg": wrist_center,
    "triangle.svg": triangle,
}
