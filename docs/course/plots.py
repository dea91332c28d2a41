"""The plots of the course."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import matplotlib
import numpy as np
from drawings import ARM, ARM_MODEL, BLUE, GREEN, INK, RED, SOFT, STYLE, canvas, robot
from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.figure import Figure

import ik
from kr210_sim.stats import success_interval
from kr210_sim.time_law import TimeLaw


def turns() -> Figure:
    """Plot joint 6 along a leg, as atan2 gives it and with the nearest turns."""
    figure, axes = canvas(5.8, 3.0)
    s = np.linspace(0.0, 1.0, 60)
    start, end = (
        np.array([0.0, 0.2, -0.3, 0.6, 0.9, 2.2]),
        np.array([1.5, -0.2, 0.1, 2.0, 0.7, 4.6]),
    )
    q = start + s[:, None] * (end - start)
    naive = (q[:, 5] + np.pi) % (2 * np.pi) - np.pi
    axes.plot(100 * s, naive, ".-", color=RED, label="as atan2 gives it")
    axes.plot(100 * s, q[:, 5], color=BLUE, lw=2, label="with the nearest turn")
    axes.axhline(np.pi, color=SOFT, lw=0.8, ls="--")
    axes.axhline(-np.pi, color=SOFT, lw=0.8, ls="--")
    axes.text(1, np.pi + 0.12, "π", color=SOFT)
    axes.text(1, -np.pi + 0.12, "-π", color=SOFT)
    axes.set_xlabel("way along the leg [%]")
    axes.set_ylabel("theta 6 [rad]")
    axes.legend(loc="lower left", bbox_to_anchor=(0.0, 0.12))
    return figure


def wrist_pass() -> Figure:
    """Plot joint 4 along straight lines that pass the wrist singularity at several distances."""
    figure, axes = canvas(5.8, 3.2)
    R = np.eye(4)
    middle = ik.forward(ARM_MODEL, np.array([0.0, 0.3, -0.3, 0.0, 0.0, 0.0]))[:3, 3]
    way = 0.4 * np.linspace(-1.0, 1.0, 801) ** 5  # closest where joint 4 is fastest
    for distance, colour in ((0.001, RED), (0.01, ARM), (0.05, BLUE)):
        poses = np.tile(R, (len(way), 1, 1))
        poses[:, :3, 3] = middle + np.array([0.0, 0.0, 1.0]) * way[:, None] + (0.0, distance, 0.0)
        q4 = np.unwrap(ik.inverse(ARM_MODEL, poses).q[:, 0, 3])
        steepest = np.max(np.abs(np.diff(q4) / np.diff(way)))
        label = f"{1e3 * distance:.0f} mm beside it: ≤ {steepest:.0f} rad per m"
        axes.plot(1e3 * way, np.degrees(q4 - q4[0]), color=colour, label=label)
    axes.set_xlabel("height above the singular pose [mm]")
    axes.set_ylabel("joint 4 turns [deg]")
    axes.legend(loc="lower right")
    return figure


def lu_inverse(M: Any) -> Any:
    """Invert by elimination without exchanging rows: what page 10 warns of."""
    n = len(M)
    rows = np.hstack([np.array(M, dtype=float), np.eye(n)])
    for i in range(n):
        rows[i] /= rows[i, i]
        for j in range(n):
            if j != i:
                rows[j] -= rows[j, i] * rows[i]
    return rows[:, n:]


def transpose() -> Figure:
    """Plot how far three inverses of R0_3 are from one, over a thousand configurations."""
    figure, axes = canvas(5.8, 3.2)
    arm = robot()
    table = ik.dh_from_chain(arm.chain.origins, arm.chain.axes, arm.chain.T_last_palm)
    inverses = {"elimination, rows as they come": lu_inverse, "numpy.linalg.inv": np.linalg.inv,
                "transpose": np.transpose}  # fmt: skip
    errors = {name: np.empty(1000) for name in inverses}
    drawn = np.random.default_rng(0).uniform(arm.lower, arm.upper, (1000, 6))
    with np.errstate(all="ignore"):
        for i, q in enumerate(drawn):
            one, two, three = table.transforms(q)[:3, :3, :3]
            R = one @ two @ three
            for name, inverse in inverses.items():
                errors[name][i] = np.max(np.abs(inverse(R) @ R - np.eye(3)))
    share = np.linspace(0.0, 100.0, 1000)
    for (name, values), colour in zip(errors.items(), (RED, ARM, BLUE), strict=True):
        ordered = np.sort(np.nan_to_num(values, nan=np.inf))
        axes.semilogy(share, np.maximum(ordered, 1e-17), color=colour, lw=2, label=name)
    axes.set_xlabel("random configurations, ordered by error [%]")
    axes.set_ylabel("largest entry of R⁻¹ R - 1")
    axes.legend(loc="center right")
    return figure


def motion() -> Figure:
    """Plot one motion from rest to rest: position, speed, acceleration and jerk."""
    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=(5.8, 4.8), layout="tight", facecolor="white")
        FigureCanvasSVG(figure)
        axes = figure.subplots(4, 1, sharex=True)
    law = TimeLaw(2.0, 2.0, 8.0, 160.0)
    t = np.linspace(0.0, law.duration, 2000)
    for panel, values, name, colour in zip(
        axes, law(t), ("way [rad]", "speed", "acceleration", "jerk"), (INK, BLUE, GREEN, RED),
        strict=True,
    ):  # fmt: skip
        panel.plot(t, values, color=colour, lw=2)
        panel.set_ylabel(name, fontsize=10)
        for change in law.changes:
            panel.axvline(change, color="#c4cad1", lw=0.8)
    axes[-1].set_xlabel("time [s]")
    figure.align_ylabels()
    return figure


def stops() -> Figure:
    """Plot the speed of one joint through twenty poses, with a stop at each and with none."""
    figure, axes = canvas(5.8, 3.0)
    v, a, j, way, poses = 2.0, 8.0, 160.0, 2.0, 20
    for share, count, colour, name in (
        (0.2, poses, RED, "stop at each of 20 poses, 0.2 of the limits"),
        (1.0, 1, BLUE, "through them all, at the limits"),
    ):
        law = TimeLaw(way / count, share * v, share * a, share * j)
        t = np.linspace(0.0, law.duration, 200)
        times = np.concatenate([t + i * law.duration for i in range(count)])
        label = f"{name}: {count * law.duration:.1f} s"
        axes.plot(times, np.tile(law(t)[1], count), color=colour, lw=1.5, label=label)
    axes.set_xlabel("time [s]")
    axes.set_ylabel("speed [rad/s]")
    axes.legend(loc="upper right")
    return figure


def proof() -> Figure:
    """Plot the success rate that so many successes in a row prove."""
    figure, axes = canvas(5.8, 3.0)
    cycles = np.arange(1, 201)
    rates = [100 * success_interval(int(n), int(n))[0] for n in cycles]
    axes.plot(cycles, rates, color=BLUE, lw=2)
    for n in (10, 72):
        axes.plot(n, rates[n - 1], "o", color=RED)
        axes.text(n + 3, rates[n - 1] - 1, f"{n} of {n}: {rates[n - 1]:.1f} %", color=INK, va="top")
    axes.set_xlabel("cycles, all of them successful")
    axes.set_ylabel("success rate above [%]")
    axes.set_ylim(0, 102)
    return figure


PLOTS: dict[str, Callable[[], Figure]] = {
    "turns.svg": turns,
    "wrist_pass.svg": wrist_pass,
    "transpose.svg": transpose,
    "motion.svg": motion,
    "stops.svg": stops,
    "proof.svg": proof,
}
