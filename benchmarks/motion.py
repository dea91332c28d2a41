"""Planned motions against what is possible: `python benchmarks/motion.py` (extra `bench`)."""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from itertools import groupby, pairwise
from typing import Any

import numpy as np

if __name__ == "__main__":
    sys.path.pop(0)  # this folder has an ik.py of its own

import ik
from kr210_sim.clearance import least_clearance
from kr210_sim.collision import MujocoOracle
from kr210_sim.config import RunConfig
from kr210_sim.cycle import CycleSetup, TimedMotion, plan_cycle
from kr210_sim.episodes import TARGET_LENGTH, load_world, plan_episodes, run_episode
from kr210_sim.exceptions import CycleFailure
from kr210_sim.legs import Blocked, ClearanceOracle, LegFinder, Wanted
from kr210_sim.limits import MotionLimits
from kr210_sim.planning import CyclePlan, Motion
from kr210_sim.robot import Robot
from kr210_sim.scene import Scene, Target
from kr210_sim.simulation import Simulation
from kr210_sim.task import WALL_MARGIN
from kr210_sim.time_law import TimeLaw
from kr210_sim.trajectory import Trajectory

RATIO_LIMIT = 1.35
"""Planned over TOPP-RA's time above which a motion is listed."""

COURSE_SHARE = 0.2
"""Share of the joint limits that the original course used."""

COURSE_POSES = (15, 60)
"""Poses per leg in the original course, each a stop; one per COURSE_STEP within these bounds."""

COURSE_STEP = 0.05  # [m] of the TCP
SHIFT = (0.05, 0.15)
"""Largest shift of a random target from the middle of its cell, in depth and sideways [m]."""

KNOTS = 1000  # of the spline that TOPP-RA is given, and of its grid; 2000 change its times by 0.5 %
WRIST_SLACK = np.radians(0.1)  # of a travel measured on samples


@dataclass(frozen=True, kw_only=True)
class Row:
    """One planned cycle.

    Times per motion [s], least clearance between cell and bin [m], travel of the joints (6,) [rad],
    and what blocks the shortest-path choice, straight and on every detour.
    """

    name: str
    stages: tuple[str, ...]
    planned: tuple[float, ...]
    bound: tuple[float, ...]
    toppra: tuple[float, ...]
    course: tuple[float, ...]
    plan_time: float
    clearance: float
    travel: dict[str, Any]
    blocked: Blocked | None


def main() -> None:
    """Plan the default cycles and random pairs, and print Markdown tables."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--pairs", type=int, default=200, help="random pick/place pairs (200)")
    parser.add_argument("--cycles", type=int, default=10, help="cycles of the default run (10)")
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    scene = load_world(RunConfig())
    limits = MotionLimits.from_velocity(scene.robot.velocity)
    setup = CycleSetup(cycle=0, episode=0, seed=options.seed, limits=limits)
    failures: list[str] = []
    groups = {
        "default cycles": list(default_cycles(scene, setup, options.cycles)),
        "random pairs": list(random_pairs(scene, setup, options.pairs, failures)),
    }
    groups = {name: rows for name, rows in groups.items() if rows}
    print_tables(groups, failures)


def default_cycles(
    scene: Scene, setup: CycleSetup, count: int, of: Callable[..., Any] | None = None
) -> Iterator[Any]:
    """Yield `of` (by default `measure`) for the cycles of the default run.

    Each is planned in the world as it is when it begins.
    """
    if count < 1:
        return
    config = RunConfig(cycles=count, seed=setup.seed)
    look, rows = of or measure, list[Any]()

    def plan(simulation: Simulation, stage: str, now: float) -> None:
        if now == 0.0:
            target = list(simulation.targets.values())[-1]
            rows.append(look(f"cycle {len(rows)}", simulation, target, setup, None))

    for episode in plan_episodes(config, scene):
        for _ in run_episode(scene, episode, setup, mass=config.mass, probe=plan):
            pass
    yield from rows


def random_pairs(scene: Scene, setup: CycleSetup, count: int, failures: list[str]) -> Iterator[Row]:
    """Yield plans for targets anywhere in a cell, released anywhere over an empty bin."""
    rng = np.random.default_rng(setup.seed)
    place = scene.place
    reach = np.maximum(place.half_size[:2] - TARGET_LENGTH / 2 - WALL_MARGIN, 0.0)
    for index in range(count):
        cell = int(rng.integers(1, len(scene.cells) + 1))
        T_base_target = scene.stand_in_cell(cell, TARGET_LENGTH)
        T_base_target[:3, 3] += T_base_target[:3, :2] @ (rng.uniform(-1, 1, 2) * SHIFT)
        radius, angle = np.sqrt(rng.uniform()), rng.uniform(-np.pi, np.pi)
        local = [*(radius * np.array([np.cos(angle), np.sin(angle)]) * reach), place.half_size[2]]
        p_release = place.T_base_place[:3, :3] @ local + place.T_base_place[:3, 3]
        target = Target(number=0, cell=cell, mass=1.0, T_base_target=T_base_target)
        simulation = Simulation(scene)
        simulation.add(target)
        try:
            yield measure(f"pair {index}", simulation, target, setup, p_release)
        except CycleFailure as failure:
            failures.append(f"pair {index}, cell {cell}: {failure.reason}, {failure.detail}")


def measure(
    name: str,
    simulation: Simulation,
    target: Target,
    setup: CycleSetup,
    p_base_release: Any,
) -> Row:
    """Plan one cycle and everything it is compared with."""
    started = time.perf_counter()
    oracle = MujocoOracle(simulation, simulation.scene, target)
    plan, motions = plan_cycle(simulation, target, setup, oracle, p_base_release)
    plan_time = time.perf_counter() - started
    robot, limits = simulation.scene.robot, setup.limits
    return Row(
        name=name,
        stages=tuple(motion[-1].stage for motion in plan.motions),
        planned=tuple(motion.trajectory.duration for motion in motions),
        bound=tuple(velocity_bound(motion, robot) for motion in plan.motions),
        toppra=tuple(toppra_time(motion.trajectory, limits) for motion in motions),
        course=tuple(course_time(motion, robot, limits) for motion in plan.motions),
        plan_time=plan_time,
        clearance=min(
            value
            for legs, motion in zip(plan.motions, motions, strict=True)
            for value in least_clearance(legs, motion.trajectory, oracle).values()
        ),
        travel=travels(plan, motions, robot),
        blocked=blocked_choice(plan, robot, oracle),
    )


# ---- what a motion is compared with ---------------------------------------------------------


def velocity_bound(motion: Motion, robot: Robot) -> float:
    """Return the time of the slowest joint at its velocity limit, stage by stage [s]."""
    total = 0.0
    for _, legs in groupby(motion, key=lambda leg: leg.stage):
        ends = list(legs)
        total += float(ik.joint_time(ends[0].path.start, ends[-1].path.end, robot.velocity))
    return total


def toppra_time(trajectory: Trajectory, limits: MotionLimits) -> float:
    """Return TOPP-RA's time along the same curve, from rest to rest, without a jerk limit [s]."""
    try:
        import toppra
        from toppra import algorithm, constraint
    except ModuleNotFoundError as error:
        raise SystemExit(f"{error}; python -m pip install -e '.[bench]'") from error
    toppra.setup_logging("ERROR")
    t = np.linspace(0.0, trajectory.duration, 40 * KNOTS)
    q, qd, _ = trajectory(t)
    rate = np.linalg.norm(qd / limits.velocity, ord=8, axis=1)
    way = np.append(0.0, np.cumsum((rate[1:] + rate[:-1]) / 2 * np.diff(t)))
    # Knots about evenly along the way, each with its exact length of way: no interpolation.
    chosen = np.flatnonzero(np.diff(np.floor(KNOTS * way / way[-1]), prepend=-1.0) > 0)
    chosen[-1] = len(way) - 1
    grid, q = way[chosen], q[chosen]
    path = toppra.SplineInterpolator(grid, q)
    bounds = [
        constraint.JointVelocityConstraint(np.stack([-limits.velocity, limits.velocity], axis=1)),
        constraint.JointAccelerationConstraint(
            np.stack([-limits.acceleration, limits.acceleration], axis=1),
            discretization_scheme=constraint.DiscretizationType.Interpolation,
        ),
    ]
    solver = algorithm.TOPPRA(bounds, path, gridpoints=grid, solver_wrapper="seidel")
    _, speed, _ = solver.compute_parameterization(0.0, 0.0)
    return float(np.sum(2 * np.diff(grid) / (speed[1:] + speed[:-1])))


def course_time(
    motion: Motion, robot: Robot, limits: MotionLimits, share: float = COURSE_SHARE
) -> float:
    """Return the time of stopping at every pose, at a share of all limits [s]."""
    total = 0.0
    for leg in motion:
        p = robot.forward(leg.path(np.linspace(0.0, leg.path.length, 200)))[:, :3, 3]
        way = float(np.sum(np.linalg.norm(np.diff(p, axis=0), axis=1)))
        count = int(np.clip(np.ceil(way / COURSE_STEP), *COURSE_POSES))
        for q_from, q_to in pairwise(leg.path(np.linspace(0.0, leg.path.length, count + 1))):
            step = np.maximum(np.abs(q_to - q_from), 1e-12)
            shares = [
                float(np.min(share * limit / step))
                for limit in (limits.velocity, limits.acceleration, limits.jerk)
            ]
            total += TimeLaw(1.0, *shares).duration
    return total


def travels(plan: CyclePlan, motions: Sequence[TimedMotion], robot: Robot) -> dict[str, Any]:
    """Return how far each joint turns in the cycle, as planned and by other choices [rad].

    The choices see the planner's tool poses, from home and back to it, and no obstacles; what the
    planned motion turns more than the planned choice is detours round them.
    """
    q = [
        motion.trajectory(np.linspace(0.0, motion.trajectory.duration, 2000))[0]
        for motion in motions
    ]
    found = {"planned motion": sum(np.sum(np.abs(np.diff(x, axis=0)), axis=0) for x in q)}
    order, _ = tour(plan)
    T, rows = plan.solved.T_base_palm[order], plan.solved.q[order]
    home = np.zeros((1, 6))
    found["planned choice"] = np.sum(
        np.abs(np.diff(np.concatenate([home, rows, home]), axis=0)), axis=0
    )
    for name, choose in (
        ("shortest-path choice", ik.best_sequence),
        ("greedy choice", ik.greedy_sequence),
    ):
        path = choose(robot.geometry, T, robot.lower, robot.upper, robot.velocity, home[0])
        found[name] = path.travel + np.abs(path.q[-1])
    return found


def tour(plan: CyclePlan) -> tuple[Any, int]:
    """Return the order in which a cycle passes its solved poses, and the first pose of placing."""
    lower = next(leg for motion in plan.motions for leg in motion if leg.stage == "LOWER")
    first = int(np.argmin(np.max(np.abs(plan.solved.q - lower.path.start), axis=1)))
    there = np.arange(len(plan.solved.q))
    return np.concatenate([there, there[-2 : first - len(there) - 1 : -1]]), first


def blocked_choice(plan: CyclePlan, robot: Robot, oracle: ClearanceOracle) -> Blocked | None:
    """Return what blocks a move of the shortest-path choice, straight and on every detour."""
    order, first = tour(plan)
    home = np.zeros(6)
    q = ik.best_sequence(
        robot.geometry,
        plan.solved.T_base_palm[order],
        robot.lower,
        robot.upper,
        robot.velocity,
        home,
    ).q
    legs = {leg.stage: leg for motion in plan.motions for leg in motion}
    moves = [
        Wanted.move(stage, q_from, q_to, legs[stage].hand, legs[stage].clearance)
        for stage, q_from, q_to in (
            ("MOVE_TO_PICK", home, q[0]),
            ("MOVE_TO_PLACE", q[first - 1], q[first]),
            ("MOVE_HOME", q[-1], home),
        )
    ]
    answers = LegFinder(robot, oracle, seed=0).find_each(moves)
    return next((answer for answer in answers if isinstance(answer, Blocked)), None)


# ---- tables ---------------------------------------------------------------------------------


def print_tables(groups: dict[str, list[Row]], failures: Sequence[str]) -> None:
    """Print times, planning, clearance and travel, a column per group."""
    names = list(groups)
    print("| motion time of a cycle, mean [s] | " + " | ".join(names) + " |")
    print("|---|" + "---|" * len(names))
    times = {name: _times(rows) for name, rows in groups.items()}
    for label, key in (
        ("planned", "planned"),
        ("(a) velocity bound, no acceleration limit", "bound"),
        ("(b) TOPP-RA, same path, v and a, no jerk limit", "toppra"),
        ("(c) a stop at every pose, 0.2 of the limits", "course"),
    ):
        print(
            f"| {label} | " + " | ".join(f"{times[n][key].sum(1).mean():.2f}" for n in names) + " |"
        )
    for label, key in (("(a)", "bound"), ("(b)", "toppra"), ("(c)", "course")):
        cells = []
        for name in names:
            ratio = times[name]["planned"].sum(1) / times[name][key].sum(1)
            cells.append(f"{np.mean(ratio):.3f} ({np.min(ratio):.3f} to {np.max(ratio):.3f})")
        print(f"| planned / {label}, mean (range) of cycles | " + " | ".join(cells) + " |")
    cells = [f"{np.max(times[n]['planned'] / times[n]['toppra']):.3f}" for n in names]
    print("| planned / (b), worst single motion | " + " | ".join(cells) + " |")
    for label, quantile in (("p50", 0.5), ("p95", 0.95), ("max", 1.0)):
        cells = [
            f"{1e3 * np.quantile([row.plan_time for row in groups[n]], quantile):.0f}"
            for n in names
        ]
        print(f"| planning time, {label} [ms] | " + " | ".join(cells) + " |")
    cells = [f"{1e3 * min(row.clearance for row in groups[n]):.1f}" for n in names]
    print("| least clearance between cell and bin [mm] | " + " | ".join(cells) + " |")
    for name, rows in groups.items():
        _print_travel(name, rows)
    _print_slow(groups)
    print(f"\nNot planned: {len(failures)}")
    for line in failures:
        print(f"- {line}")


def _times(rows: Sequence[Row]) -> dict[str, Any]:
    """Return the times (cycles, motions) of each kind [s]."""
    return {
        key: np.array([getattr(row, key) for row in rows])
        for key in ("planned", "bound", "toppra", "course")
    }


def _print_travel(name: str, rows: Sequence[Row]) -> None:
    axes = " | ".join(f"axis {axis}" for axis in range(1, 7))
    print(f"\n| joint travel, mean [deg], {name} | {axes} | axes 4 + 6 |\n|---|" + "---|" * 7)
    for label in rows[0].travel:
        mean = np.degrees(np.mean([row.travel[label] for row in rows], axis=0))
        cells = " | ".join(f"{value:.0f}" for value in (*mean, mean[3] + mean[5]))
        print(f"| {label} | {cells} |")
    wrist = {
        label: np.array([row.travel[label][[3, 5]].sum() for row in rows])
        for label in rows[0].travel
    }
    more = wrist["planned motion"] > wrist["shortest-path choice"] + WRIST_SLACK
    print(
        f"\nAxes 4 and 6 turn further than the shortest-path choice in {more.sum()} of {len(rows)}."
    )
    for index in np.flatnonzero(more):
        planned, least = (
            np.degrees(wrist[label][index]) for label in ("planned motion", "shortest-path choice")
        )
        why = rows[index].blocked
        print(
            f"- {rows[index].name}: {planned:.1f} instead of {least:.1f} deg; that choice is "
            + (f"blocked, straight and on every detour: {why}" if why else "free")
        )


def _print_slow(groups: dict[str, list[Row]]) -> None:
    slow = [
        f"- {row.name}, to the end of {stage}: {planned:.2f} s, {planned / ideal:.3f} times TOPP-RA"
        for rows in groups.values()
        for row in rows
        for stage, planned, ideal in zip(row.stages, row.planned, row.toppra, strict=True)
        if planned > RATIO_LIMIT * ideal
    ]
    print(f"\nMotions slower than {RATIO_LIMIT} times TOPP-RA: {len(slow)}")
    print("\n".join(slow))


if __name__ == "__main__":
    main()
