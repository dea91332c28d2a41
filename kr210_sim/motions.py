"""Target as it is believed to be -> the timed motions of a pick and place."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from kr210_sim.arrays import Array
from kr210_sim.collision import MujocoOracle
from kr210_sim.course import CourseDriver
from kr210_sim.criteria import CLEARANCE_FREE
from kr210_sim.exceptions import CycleFailure
from kr210_sim.legs import ClearanceOracle, Hand, Question
from kr210_sim.limits import MotionLimits
from kr210_sim.planning import CyclePlan, CyclePlanner, Motion
from kr210_sim.robot import Robot
from kr210_sim.scene import Target
from kr210_sim.simulation import Simulation
from kr210_sim.task import pick_options, place_options, release_point
from kr210_sim.tcp_limits import TcpLimits
from kr210_sim.tracks import Solver
from kr210_sim.trajectory import Trajectory, time_chains
from kr210_sim.variation import Variation


@dataclass(frozen=True, kw_only=True)
class CycleSetup:
    """What identifies a cycle and how fast it may be.

    Attributes:
        cycle, episode: for the record.
        seed: of everything that is left to chance, and for the record.
        limits: joint limits of every motion.
        tcp_limits: Cartesian limits of every motion.
        solver: an IK that takes the place of the analytic one.
        scope: where the solver is asked: one of `source.SCOPES`, or None for all lines that the
            planner tries.
        clearance: kept to everything outside the cells [m].
        variation: what the planner and the controller do not know.
        retries: how many further tries at the grasp are allowed.
    """

    cycle: int
    episode: int
    seed: int
    limits: MotionLimits
    tcp_limits: TcpLimits = field(default_factory=TcpLimits)
    solver: Solver | None = None
    scope: str | None = None
    clearance: float = CLEARANCE_FREE
    variation: Variation = field(default_factory=Variation)
    retries: int = 0


@dataclass(frozen=True, kw_only=True)
class TimedMotion:
    """A motion from stop to stop.

    Attributes:
        stages: of each of its legs.
        trajectory: in time.
        slowed_to: share of the speed the joints allow that the TCP limits leave, at most 1.
    """

    stages: tuple[str, ...]
    trajectory: Trajectory
    slowed_to: float = 1.0


def plan_cycle(
    simulation: Simulation,
    target: Target,
    setup: CycleSetup,
    oracle: MujocoOracle,
    p_base_release: Array | None = None,
    q_start: Array | None = None,
) -> tuple[CyclePlan, list[TimedMotion]]:
    """Plan a pick and place that ends at home, paths and their timing; nothing moves.

    Args:
        simulation: the world as it is now.
        target: what to pick, as it is believed to be; it stands in a cell.
        setup: limits and solver.
        oracle: answers for clearance in this world.
        p_base_release: (3,) where to release at the top of the place volume; by default where
            the most room is.
        q_start: (6,) where the arm is [rad]; by default where the cycle starts.

    Raises:
        CycleFailure: unreachable, joint_limits, no_path or bad_ik.
    """
    scene = simulation.scene
    if p_base_release is None:
        place = scene.place
        p_base_release = release_point(
            place.T_base_place, place.half_size, place.kind, target.length, simulation.placed()
        )
    in_planner = setup.solver if setup.scope is None else None
    planner = CyclePlanner(
        scene.robot, oracle, in_planner, seed=setup.seed, clearance=setup.clearance
    )
    plan = planner.plan(
        q_home=np.zeros(6),
        q_start=setup.variation.q_start if q_start is None else q_start,
        picks=pick_options(target.T_base_target, scene.cell(target.cell).T_base_cell),
        places=place_options(p_base_release),
    )
    if setup.solver is not None and setup.scope is not None:
        driver = CourseDriver(scene.robot, oracle, setup.solver, scope=setup.scope, seed=setup.seed)
        plan = driver.drive(plan)
    timed = timed_motions(plan.motions, oracle, setup.limits)
    return plan, [
        _within_tcp_limits(legs, motion, setup, scene.robot, target.mass)
        for legs, motion in zip(plan.motions, timed, strict=True)
    ]


def _within_tcp_limits(
    legs: Motion, motion: TimedMotion, setup: CycleSetup, robot: Robot, mass: float
) -> TimedMotion:
    """Slow a motion that would break a TCP limit until it does not."""
    held = mass if any(leg.hand in (Hand.LIFTING, Hand.HOLDING) for leg in legs) else None
    try:
        share = setup.tcp_limits.share(
            robot, motion.trajectory, held, friction=setup.variation.grip_friction
        )
    except ValueError as error:
        raise CycleFailure("no_path", str(error), stage=legs[0].stage) from error
    if share == 1.0:
        return motion
    return replace(motion, trajectory=motion.trajectory.slowed(share), slowed_to=share)


def timed_motions(
    motions: Sequence[Motion], oracle: ClearanceOracle, limits: MotionLimits
) -> list[TimedMotion]:
    """Give motions their time laws, rounding the corners as far as they stay clear."""

    def free(corners: Sequence[tuple[int, int, Array]]) -> list[bool]:
        questions = []
        for motion, corner, q in corners:
            before, after = motions[motion][corner : corner + 2]
            clearance = min(before.clearance, after.clearance)
            questions.append(Question(q=q, hand=after.hand, clearance=clearance))
        return [what is None for what in oracle.blocked_each(questions)]

    try:
        found = time_chains([[leg.path for leg in motion] for motion in motions], limits, free)
    except ValueError as error:
        raise CycleFailure("no_path", str(error), stage=motions[0][0].stage) from error
    return [
        TimedMotion(stages=tuple(leg.stage for leg in motion), trajectory=trajectory)
        for motion, trajectory in zip(motions, found, strict=True)
    ]
