"""Answers pose by pose: errors of forward kinematics, limits, jumps, turns and travel; pure."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

import ik
from kr210_sim.arrays import Array
from kr210_sim.grading.foreign import Asked
from kr210_sim.grading.steps import TURN, beyond_limits, needless_turns
from kr210_sim.robot import Robot
from kr210_sim.stats import spread
from kr210_sim.tracks import BRANCH_JUMP

_SPREADS = ("mean", "p95", "max")


@dataclass(frozen=True, kw_only=True)
class Leg:
    """What a solver answered to the poses of one leg.

    Attributes:
        cycle: of the grading run, counting from 0.
        stage: one of `record.STAGES`.
        asked: request and answer.
    """

    cycle: int
    stage: str
    asked: Asked


@dataclass(frozen=True, kw_only=True)
class LegMarks:
    """What the answers to the first n of the N poses of a leg are worth; arrays begin with n.

    Attributes:
        leg: request and answer.
        position_error: (n, 3) reached minus requested position, base frame [m].
        angle_error: (n,) angle between reached and requested orientation [rad].
        wrist_error: (n, 3) reached minus requested wrist center, base frame [m].
        beyond_limits: (n, 6) whether a joint is beyond its limits.
        jumps: (n,) whether the step to this answer changes branch.
        turns: (n,) needless whole turns in the step to this answer, all joints together.
        wrist_travel: way of joints 4 to 6 [rad], and `wrist_optimum` the least there is.
        wrist_optimum: of the quickest joint path through the same poses [rad].
    """

    leg: Leg
    position_error: Array
    angle_error: Array
    wrist_error: Array
    beyond_limits: Array
    jumps: Array
    turns: Array
    wrist_travel: float
    wrist_optimum: float


def mark_leg(robot: Robot, leg: Leg) -> LegMarks:
    """Judge the answers to a leg by the robot's own geometry."""
    asked = leg.asked
    q = asked.q
    wanted = asked.T_base_palm[: len(q)]
    reached = ik.forward(robot.geometry, q)
    chord = np.linalg.norm(reached[:, :3, :3] - wanted[:, :3, :3], axis=(1, 2)) / np.sqrt(8.0)
    step = np.diff(q, axis=0, prepend=asked.q_start[None])
    needless = needless_turns(robot.lower, robot.upper, asked.q_start, q)
    optimum = _optimum(robot, asked)
    needed = np.abs(np.diff(optimum.q, axis=0, prepend=asked.q_start[None]))[: len(q)]
    # A step that is large apart from turns, and larger than the best way through these poses has.
    moved = np.max(np.abs(step - TURN * np.round(step / TURN)), axis=1, initial=0.0)
    jumps = (moved > BRANCH_JUMP) & ~(2 * np.max(needed, axis=1, initial=0.0) > moved)
    return LegMarks(
        leg=leg,
        position_error=reached[:, :3, 3] - wanted[:, :3, 3],
        angle_error=2 * np.arcsin(np.minimum(1.0, chord)),
        wrist_error=ik.wrist_center(robot.geometry, reached)
        - ik.wrist_center(robot.geometry, wanted),
        beyond_limits=beyond_limits(q, robot.lower, robot.upper) > 0.0,
        jumps=jumps,
        turns=np.array([sum(turn.pose == pose for turn in needless) for pose in range(len(q))]),
        wrist_travel=float(np.nansum(np.abs(step[:, 3:]))),
        wrist_optimum=float(np.nansum(np.abs(needed[:, 3:]))),
    )


def _optimum(robot: Robot, asked: Asked) -> ik.JointPath:
    return ik.best_sequence(
        robot.geometry,
        asked.T_base_palm,
        robot.lower,
        robot.upper,
        robot.velocity,
        asked.q_start,
    )


def summarize_marks(marks: Sequence[LegMarks]) -> dict[str, Any]:
    """Return the figures over all legs, as JSON."""
    position = [np.linalg.norm(mark.position_error, axis=1) for mark in marks]
    wrist = [np.linalg.norm(mark.wrist_error, axis=1) for mark in marks]
    jumps = [step for mark in marks for step in mark.jumps]
    travel = sum(mark.wrist_travel for mark in marks)
    optimum = sum(mark.wrist_optimum for mark in marks)
    return {
        "asked": sum(len(mark.leg.asked.T_base_palm) for mark in marks),
        "answered": sum(len(mark.leg.asked.q) for mark in marks),
        "position_error_m": _spread(position),
        "angle_error_rad": _spread([mark.angle_error for mark in marks]),
        "wrist_center_error_m": _spread(wrist),
        "beyond_limits": int(sum(mark.beyond_limits.any(axis=1).sum() for mark in marks)),
        "branch_jumps": int(sum(jumps)),
        "turns": int(sum(mark.turns.sum() for mark in marks)),
        "wrist_travel_rad": travel,
        "wrist_travel_optimum_rad": optimum,
        "seconds_per_pose": _spread([mark.leg.asked.seconds for mark in marks]),
    }


def _spread(parts: Sequence[Array]) -> dict[str, float | None]:
    values = np.concatenate([np.empty(0), *parts])
    return spread(values[np.isfinite(values)], *_SPREADS)


def rows_of(mark: LegMarks) -> list[dict[str, Any]]:
    """Return one object a pose, as JSON; a pose without an answer has no errors."""
    asked, rows = mark.leg.asked, []
    for index, T in enumerate(asked.T_base_palm):
        row: dict[str, Any] = {
            "cycle": mark.leg.cycle,
            "stage": mark.leg.stage,
            "pose": index,
            "position_m": T[:3, 3].tolist(),
            "q_rad": None,
        }
        if index < len(asked.q) and np.all(np.isfinite(asked.q[index])):
            row |= {
                "q_rad": asked.q[index].tolist(),
                "position_error_m": mark.position_error[index].tolist(),
                "angle_error_rad": float(mark.angle_error[index]),
                "wrist_center_error_m": mark.wrist_error[index].tolist(),
                "beyond_limits": [
                    joint for joint in range(1, 7) if mark.beyond_limits[index, joint - 1]
                ],
                "branch_jump": bool(mark.jumps[index]),
                "turns": int(mark.turns[index]),
                "seconds": float(asked.seconds[index]),
            }
        rows.append(row)
    return rows
