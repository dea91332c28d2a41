"""CycleScores -> the summary of a run, as JSON and as the table on the terminal."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from kr210_sim.criteria import CLEARANCE_CAP
from kr210_sim.gates import Gates
from kr210_sim.score import CycleScore
from kr210_sim.stats import count_reasons, pooled, spread, success_interval
from kr210_sim.trajectory import MotionLimits

_TIMES = ("mean", "p50", "p95", "max")
_OFFSETS = ("mean", "p99", "max")
_SLIPS = ("mean", "p95", "max")


_ONCE = ("grasp_slip_m", "grasp_slip_rad", "place_offset_m")
"""Figures of which a cycle has one."""


def summarize(
    scores: Sequence[CycleScore],
    *,
    seed: int,
    gates: Gates,
    clearance: float,
    limits: MotionLimits,
    notes: Sequence[str],
    wall_time_s: float,
) -> dict[str, Any]:
    """Return `summary.json`.

    Args:
        scores: of the finished cycles, in order.
        seed: of the run.
        gates: what the run must reach.
        clearance: asked for outside the cells [m].
        limits: the joint limits of every motion.
        notes: what a reader should know about the model.
        wall_time_s: of the whole run [s].
    """
    succeeded = sum(score.success for score in scores)
    good = [score for score in scores if score.success]
    rate = succeeded / len(scores) if scores else None
    cycle_time = spread([score.cycle_time_s or 0.0 for score in good], *_TIMES)
    ik_offset = _spread_pooled(scores, "ik_offset_m")
    judged = gates.judge(rate, ik_offset["max"], cycle_time["max"])
    missed = [name for name, gate in judged.items() if not gate["met"]]
    return {
        "schema_version": 1,
        "cycles": len(scores),
        "succeeded": succeeded,
        "success_rate": rate,
        "ci95": list(success_interval(succeeded, len(scores))) if scores else None,
        "min_success": gates.min_success,
        "gates": judged,
        "gates_missed": missed,
        "passed": not missed,
        "seed": seed,
        "cycle_time_s": cycle_time,
        "motion_time_s": spread([score.motion_time_s or 0.0 for score in good], *_TIMES),
        "sampled_motions": sum(len(score.record.sampled_motions) for score in scores),
        "slowed": _slowed(scores),
        "ik_offset_m": ik_offset,
        **{name: _spread_pooled(scores, name) for name in ("ik_offset_rad", "tracking_offset_m")},
        **{name: _spread_known(scores, name) for name in _ONCE},
        "clearance_m": clearance,
        "min_clearance_m": _least([score.min_clearance_m for score in scores]),
        "ik_time_s": _spread_clock(scores, "ik_time_s"),
        "plan_time_s": _spread_clock(scores, "plan_time_s"),
        "wall_time_s": wall_time_s,
        "realtime_factor": _simulated(scores) / wall_time_s if wall_time_s > 0 else None,
        "failures": count_reasons(
            [score.cause.reason if score.cause else None for score in scores]
        ),
        "limits": _limits(limits),
        "notes": list(notes),
    }


def _simulated(scores: Sequence[CycleScore]) -> float:
    """Return the time simulated [s]."""
    series = (score.record.series for score in scores)
    return sum(float(values["time"][-1]) for values in series if values)


def _slowed(scores: Sequence[CycleScore]) -> dict[str, float | None]:
    """Return how many cycles a TCP limit slowed, and the least share of speed left."""
    shares = [score.record.slowed_to for score in scores]
    slowed = [share for share in shares if share is not None and share < 1.0]
    return {"cycles": len(slowed), "least": min(slowed, default=None)}


def _limits(limits: MotionLimits) -> dict[str, list[float]]:
    return {
        "velocity_rad_s": limits.velocity.tolist(),
        "acceleration_rad_s2": limits.acceleration.tolist(),
        "jerk_rad_s3": limits.jerk.tolist(),
    }


def _least(values: Sequence[float | None]) -> float | None:
    return min((value for value in values if value is not None), default=None)


def _spread_pooled(scores: Sequence[CycleScore], name: str) -> dict[str, float | None]:
    return spread(pooled([getattr(score, name) for score in scores]), *_OFFSETS)


def _spread_known(scores: Sequence[CycleScore], name: str) -> dict[str, float | None]:
    values = [getattr(score, name) for score in scores]
    return spread([value for value in values if value is not None], *_SLIPS)


def _spread_clock(scores: Sequence[CycleScore], name: str) -> dict[str, float | None]:
    values = [score.record.wall_clock.get(name) for score in scores]
    return spread([value for value in values if value is not None], *_TIMES)


HEADER = (
    f"{'cycle':>5} {'seed':>10} {'cell':>4}  {'verdict':<16} {'time s':>6} {'slip mm':>7} "
    f"{'place mm':>8} {'track mm':>8} {'IK offset m':>11}"
)


def cycle_line(score: CycleScore) -> str:
    """Return the row of one cycle in the table under `HEADER`."""
    record = score.record
    verdict = "success" if score.cause is None else score.cause.reason
    tracking = spread(score.tracking_offset_m, "max")["max"]
    offset = spread(score.ik_offset_m, "max")["max"]
    line = (
        f"{record.cycle:>5} {record.seed:>10} {record.cell:>4}  {verdict:<16} "
        f"{_number(score.cycle_time_s, 1, 2):>6} {_number(score.grasp_slip_m, 1e3, 2):>7} "
        f"{_number(score.place_offset_m, 1e3, 0):>8} {_number(tracking, 1e3, 2):>8} "
        f"{_exponent(offset):>11}"
    )
    if score.cause is not None:
        line += f"\n      {score.cause.stage} at {score.cause.time:.2f} s: {score.cause.detail}"
    return line


def _number(value: float | None, scale: float, digits: int) -> str:
    return "-" if value is None else f"{value * scale:.{digits}f}"


def _clearance(value: float | None) -> str:
    return f"over {1e3 * CLEARANCE_CAP:.0f}" if value == CLEARANCE_CAP else _number(value, 1e3, 1)


def _exponent(value: float | None) -> str:
    return "-" if value is None else f"{value:.1e}"


def summary_text(summary: dict[str, Any]) -> str:
    """Return the lines below the table."""
    cycles, succeeded = summary["cycles"], summary["succeeded"]
    if not cycles:
        return "no cycle was finished"
    low, high = summary["ci95"]
    gate = _verdict(summary["gates"]["min_success"])
    lines = [
        f"{succeeded} of {cycles} cycles succeeded ({100 * summary['success_rate']:.1f} %, 95 % "
        f"interval {100 * low:.1f} to {100 * high:.1f} %); gate {summary['min_success']:g}: {gate}",
        f"cycle time     mean {_number(summary['cycle_time_s']['mean'], 1, 2)} s, "
        f"p95 {_number(summary['cycle_time_s']['p95'], 1, 2)} s (simulated)",
        f"offsets, max   IK {_exponent(summary['ik_offset_m']['max'])} m, tracking "
        f"{_number(summary['tracking_offset_m']['max'], 1e3, 2)} mm, grasp slip "
        f"{_number(summary['grasp_slip_m']['max'], 1e3, 2)} mm",
        f"clearance      {_clearance(summary['min_clearance_m'])} mm at least between cell and bin "
        f"({_number(summary['clearance_m'], 1e3, 0)} asked for)",
        *_further_gates(summary["gates"]),
        f"limits         velocity {_degrees(summary['limits']['velocity_rad_s'])} deg/s",
        f"               acceleration {_degrees(summary['limits']['acceleration_rad_s2'])} deg/s^2",
        f"               jerk {_degrees(summary['limits']['jerk_rad_s3'])} deg/s^3",
        f"wall time      {summary['wall_time_s']:.1f} s, "
        f"{summary['realtime_factor']:.1f} times real time",
    ]
    if summary["sampled_motions"]:
        lines.append(f"sampled paths  {summary['sampled_motions']}")
    if summary["slowed"]["cycles"]:
        lines.append(
            f"slowed         {summary['slowed']['cycles']} cycles by TCP limits, down to "
            f"{summary['slowed']['least']:.2f} of the joints' speed"
        )
    if summary["failures"]:
        counted = ", ".join(f"{reason} {count}" for reason, count in summary["failures"].items())
        lines.append(f"failures       {counted}")
    return "\n".join(lines)


def _verdict(gate: dict[str, Any]) -> str:
    return "passed" if gate["met"] else "FAILED"


def _further_gates(gates: dict[str, Any]) -> list[str]:
    """Return the lines of the gates beside the success rate."""
    lines = []
    for name, label, unit in (
        ("max_ik_offset", "largest IK offset", "m"),
        ("max_cycle_time", "longest cycle", "s"),
    ):
        if name in gates:
            gate = gates[name]
            value = "none" if gate["value"] is None else f"{gate['value']:.4g} {unit}"
            limit = f"at most {gate['limit']:g} {unit}"
            lines.append(f"gate           {label} {value}, {limit}: {_verdict(gate)}")
    return lines


def _degrees(values: Sequence[float]) -> str:
    return " ".join(f"{value * 57.29577951308232:.0f}" for value in values)
