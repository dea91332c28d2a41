"""The comparisons of docs/course/comparisons.md: `python benchmarks/course_comparisons.py all`.

`numeric`, `turns` or `planner` instead of `all` makes one of them. Each prints Markdown tables and
draws a plot in docs/course/figures.
"""

from __future__ import annotations

import argparse
import sys
import time
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

HERE = Path(__file__).resolve().parent
COURSE = HERE.parent / "docs" / "course"
if __name__ == "__main__":
    sys.path.pop(0)  # this folder has an ik.py of its own

import ik

sys.path += [str(HERE), str(COURSE)]

import course_solvers
import ik_cycles
import motion
from drawings import ARM, BLUE, GREEN, RED, canvas, save
from scipy.spatial.transform import Rotation, Slerp

from kr210_sim.collision import MujocoOracle
from kr210_sim.config import RunConfig
from kr210_sim.cycle import CycleSetup, plan_cycle
from kr210_sim.episodes import load_world
from kr210_sim.grading.grade import GradeConfig, grade
from kr210_sim.grading.source import SolverSource
from kr210_sim.limits import MotionLimits

LOWER, UPPER, VELOCITY = course_solvers.LOWER, course_solvers.UPPER, course_solvers.VELOCITY
FIGURES = COURSE / "figures"
POSES, ROUNDS = 200, 5
LINES, WAYPOINTS = 200, 60
SOLVERS = ("naive", "greedy", "exact")
COURSE_WAITS = 2 * 1.5 + 5.0 + 3.0
"""Of the original course in a cycle: two gripper moves, after closing, after opening [s]."""


def main() -> None:
    """Make the comparisons asked for."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    parser.add_argument("which", choices=["numeric", "turns", "planner", "all"])
    parser.add_argument("--cycles", type=int, default=10)
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    for name, compare in (("numeric", numeric), ("turns", turns), ("planner", planner)):
        if options.which in (name, "all"):
            print(f"\n## {name}\n")
            compare(options.cycles, options.seed)


# ---- numeric against geometric IK -----------------------------------------------------------


def numeric(cycles: int, seed: int) -> None:
    """Compare whole cycles, and random poses from one start and from many."""
    ik_cycles.print_table(ik_cycles.summaries_of(cycles, seed))
    q = np.random.default_rng(seed).uniform(LOWER, UPPER, (POSES, 6))
    T = ik.forward(ik.KR210, q)
    one = ik.NumericOptions(restarts=0)

    def analytic(pose: Any) -> Any:
        return ik.nearest(ik.inverse(ik.KR210, pose).q, np.zeros(6), LOWER, UPPER)

    def iterated(options: ik.NumericOptions | None) -> Any:
        return lambda pose: ik.inverse_numeric(
            ik.KR210, pose[None], np.zeros(6), LOWER, UPPER, options=options
        )[0]

    solvers = {
        "geometric": analytic,
        "numeric, one start": iterated(one),
        "numeric, restarts": iterated(None),
    }
    seconds = dict.fromkeys(solvers, np.inf)
    missed = {}
    for _ in range(ROUNDS):  # in turn, so that a slow moment of the machine meets them all
        for name, solve in solvers.items():
            started = time.perf_counter()
            answers = np.array([solve(pose) for pose in T])
            seconds[name] = min(seconds[name], time.perf_counter() - started)
            apart = ik.forward(ik.KR210, answers)[:, :3, 3] - T[:, :3, 3]
            missed[name] = np.linalg.norm(apart, axis=1)
    found = {name: (missed[name], seconds[name]) for name in solvers}
    base = found["geometric"][1]
    print(f"\n| {POSES} random poses, from zero | " + " | ".join(found) + " |")
    print("|---|" + "---|" * len(found))
    rows = {
        "solved": [f"{np.isfinite(missed).mean():.1%}" for missed, _ in found.values()],
        "offset, median [m]": [f"{np.nanmedian(missed):.1e}" for missed, _ in found.values()],
        "offset, max [m]": [f"{np.nanmax(missed):.1e}" for missed, _ in found.values()],
        "time over geometric": [f"{seconds / base:.0f}" for _, seconds in found.values()],
    }
    for label, cells in rows.items():
        print(f"| {label} | " + " | ".join(cells) + " |")
    figure, axes = canvas(5.8, 3.4)
    share = np.linspace(0.0, 100.0, POSES)
    for (name, (missed, _)), colour in zip(found.items(), (BLUE, RED, ARM), strict=True):
        axes.semilogy(share, np.maximum(np.sort(missed), 1e-16), color=colour, lw=2, label=name)
    axes.set_xlabel(
        "random poses, ordered by offset [%]\n(a line that ends early failed at the rest)"
    )
    axes.set_ylabel("end-effector offset [m]")
    axes.legend()
    save(figure, FIGURES / "comparison_numeric.svg")


# ---- greedy against exact choice of turns ---------------------------------------------------


def turns(cycles: int, seed: int) -> None:
    """Compare three choices in graded cycles, and along random straight lines."""
    names = {"naive": "one branch, atan2", "greedy": "greedy", "exact": "exact"}
    print("| graded cycles | " + " | ".join(names.values()) + " |\n|---|---|---|---|")
    graded = {}
    for name in SOLVERS:
        source = SolverSource.from_file(HERE / "course_solvers.py", name)
        graded[name] = grade(source, GradeConfig(cycles=cycles, seed=seed)).content
    times = {
        name: np.array([line["cycle_time_s"] or np.nan for line in content["results"]], dtype=float)
        for name, content in graded.items()
    }
    common = np.all([np.isfinite(values) for values in times.values()], axis=0)
    rows = {
        "cycles succeeded": [f"{c['succeeded']} of {c['cycles']}" for c in graded.values()],
        "axes 4 to 6, travel [rad]": [
            f"{c['figures']['wrist_travel_rad']:.1f}" for c in graded.values()
        ],
        "needless whole turns": [str(c["figures"]["turns"]) for c in graded.values()],
        f"cycle time, mean of {common.sum()} [s]": [
            f"{values[common].mean():.2f}" for values in times.values()
        ],
    }
    for label, cells in rows.items():
        print(f"| {label} | " + " | ".join(cells) + " |")
    travel, seconds = _along_lines(seed)
    print(f"\n| {LINES} random lines | " + " | ".join(names.values()) + " |\n|---|---|---|---|")
    for label, values in (("axes 4 to 6, mean travel [rad]", travel), ("mean time [s]", seconds)):
        print(f"| {label} | " + " | ".join(f"{values[n].mean():.3f}" for n in SOLVERS) + " |")
    shorter = seconds["greedy"] > seconds["exact"] + 1e-9
    saved = 1 - seconds["exact"][shorter] / seconds["greedy"][shorter]
    print(
        f"\nExact is faster than greedy on {shorter.sum()} of {LINES} lines, by "
        f"{100 * np.median(saved):.0f} % (median of these), at most {100 * saved.max():.0f} %; "
        f"slower on {np.sum(seconds['exact'] > seconds['greedy'] + 1e-9)}."
    )
    figure, axes = canvas(5.8, 3.9)
    for name, colour in (("naive", RED), ("greedy", BLUE)):
        axes.loglog(seconds["exact"], seconds[name], ".", color=colour, label=names[name])
    ends = [seconds["exact"].min(), seconds["naive"].max()]
    axes.loglog(ends, ends, color=GREEN, lw=1, label="as fast as the exact choice")
    axes.set_xlabel("time of the exact choice at the velocity limits [s]")
    axes.set_ylabel("time of another choice [s]")
    axes.legend()
    save(figure, FIGURES / "comparison_turns.svg")


def _along_lines(seed: int) -> tuple[dict[str, Any], dict[str, Any]]:
    """Return travel of axes 4 to 6 and time along random lines that all three choices can go."""
    rng = np.random.default_rng(seed)
    travel: dict[str, list[float]] = {name: [] for name in SOLVERS}
    seconds: dict[str, list[float]] = {name: [] for name in SOLVERS}
    while len(travel["exact"]) < LINES:
        q = rng.uniform(LOWER, UPPER, (2, 6))
        ends = ik.forward(ik.KR210, q)
        s = np.linspace(0.0, 1.0, WAYPOINTS)
        T = np.tile(np.eye(4), (WAYPOINTS, 1, 1))
        T[:, :3, 3] = ends[0, :3, 3] + s[:, None] * (ends[1, :3, 3] - ends[0, :3, 3])
        T[:, :3, :3] = Slerp([0.0, 1.0], Rotation.from_matrix(ends[:, :3, :3]))(s).as_matrix()
        if not ik.inverse(ik.KR210, T, (LOWER, UPPER)).in_limits[:, 0].all():
            continue  # the naive choice would leave the limits
        for name in SOLVERS:
            start = ik.inverse(ik.KR210, T[0]).q[0]
            rows = [start, *getattr(course_solvers, name)(T[1:], start)]
            steps = np.array([np.abs(b - a) for a, b in pairwise(rows)])
            travel[name].append(float(steps[:, 3:].sum()))
            seconds[name].append(float(np.max(steps / VELOCITY, axis=1).sum()))
    return tuple({n: np.array(v) for n, v in kept.items()} for kept in (travel, seconds))  # type: ignore[return-value]


# ---- the course's planner and timing against ours -------------------------------------------


def planner(cycles: int, seed: int) -> None:
    """Compare motion times with and without stops, at 0.2 of the limits and at all of them."""
    scene = load_world(RunConfig())
    limits = MotionLimits.from_velocity(scene.robot.velocity)
    setup = CycleSetup(cycle=0, episode=0, seed=seed, limits=limits)
    share = motion.COURSE_SHARE
    low = MotionLimits(
        velocity=share * limits.velocity,
        acceleration=share * limits.acceleration,
        jerk=share * limits.jerk,
    )

    def times(name: str, simulation: Any, target: Any, setup: CycleSetup, release: Any) -> Any:
        oracle = MujocoOracle(simulation, simulation.scene, target)
        plan, fast = plan_cycle(simulation, target, setup, oracle, release)
        _, slow = plan_cycle(simulation, target, replace(setup, limits=low), oracle, release)
        robot = simulation.scene.robot
        return [
            sum(timed.trajectory.duration for timed in fast),
            sum(motion.course_time(legs, robot, limits, 1.0) for legs in plan.motions),
            sum(timed.trajectory.duration for timed in slow),
            sum(motion.course_time(legs, robot, limits) for legs in plan.motions),
        ]

    rows = np.array(list(motion.default_cycles(scene, setup, cycles, times)))
    ours, stopping, slow, course = rows.mean(axis=0)
    print("| motion time of a cycle, mean | at the limits | at 0.2 of them |\n|---|---|---|")
    print(f"| through all poses | {ours:.2f} s | {slow:.2f} s, {slow / ours:.1f} times |")
    print(
        f"| a stop at every pose | {stopping:.2f} s, {stopping / ours:.1f} times | "
        f"{course:.2f} s, {course / ours:.1f} times |"
    )
    print(
        f"\nWith the waits of the course, {COURSE_WAITS:.0f} s a cycle, the last one takes "
        f"{course + COURSE_WAITS:.0f} s."
    )
    figure, axes = canvas(5.8, 3.4)
    at = np.arange(len(rows))
    columns = (("ours", BLUE), ("stops, at the limits", GREEN), ("no stops, 0.2 of them", ARM),
               ("stops, 0.2 of them: the course", RED))  # fmt: skip
    for i, (name, colour) in enumerate(columns):
        axes.bar(at + 0.2 * (i - 1.5), rows[:, i], width=0.19, color=colour, label=name)
    axes.set_xlabel("cycle")
    axes.set_ylabel("motion time [s]")
    axes.set_xticks(at)
    axes.set_ylim(0, 1.35 * rows.max())
    axes.legend(ncols=2, loc="upper left", fontsize=9.5, columnspacing=1.0)
    save(figure, FIGURES / "comparison_planner.svg")


if __name__ == "__main__":
    main()
