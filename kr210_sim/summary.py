"""Scored cycles -> the summary of a run, as JSON and as the table on the terminal."""

from __future__ import annotations

from array import array
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from kr210_sim.config import RunConfig
from kr210_sim.criteria import CLEARANCE_CAP
from kr210_sim.failures import FirstCauses, causes_text
from kr210_sim.gates import Gates
from kr210_sim.limits import MotionLimits
from kr210_sim.proof import UNDECIDED, Watch
from kr210_sim.schemas import SCHEMA_VERSION
from kr210_sim.stats import Pool, in_percent, spread, success_interval

_TIMES = ("mean", "p50", "p95", "max")
_OFFSETS = ("mean", "p99", "max")
_SLIPS = ("mean", "p95", "max")


def summarize(
    lines: Iterable[Mapping[str, Any]],
    *,
    config: RunConfig,
    limits: MotionLimits,
    notes: Sequence[str],
    wall_time_s: float,
    simulated_s: float,
    lost_workers: Sequence[Mapping[str, Any]] = (),
    stopped_early: bool = False,
    requested: int | None = None,
) -> dict[str, Any]:
    """Return `summary.json`.

    Args:
        lines: finished cycles as `cycles.jsonl` has them, read once and not kept.
        config: the options of the run.
        limits: the joint limits of every motion.
        notes: what a reader should know about the model.
        wall_time_s: of this session [s].
        simulated_s: of this session [s].
        lost_workers: episode, attempt and cause of every worker that was lost.
        stopped_early: whether no more cycles are needed.
        requested: cycles that were asked for; None for those of the options.
    """
    gates, requested = Gates.of(config), requested or config.cycles
    tally = _Tally(lines, gates.watch(), FirstCauses(config))
    cycles, succeeded, spreads = tally.cycles, tally.succeeded, tally.spreads()
    complete = stopped_early or cycles == requested
    judged = gates.judge(succeeded, cycles, tally.watch, spreads)
    missed = [name for name, gate in judged.items() if not gate["met"]]
    return {
        "schema_version": SCHEMA_VERSION,
        "complete": complete,
        "stopped_early": stopped_early and cycles < requested,
        "requested_cycles": requested,
        "cycles": cycles,
        "succeeded": succeeded,
        "success_rate": judged["min_success"]["value"],
        "ci95": list(success_interval(succeeded, cycles)) if cycles else None,
        "first_try": tally.first_try(),
        "retries": tally.retries(config.retries),
        "min_success": config.min_success,
        "gates": judged,
        "gates_missed": missed,
        "passed": complete and not missed,
        "seed": config.seed,
        **spreads,
        "sampled_motions": tally.sampled_motions,
        "slowed": {"cycles": tally.slowed, "least": tally.least["slowed_to"]},
        "clearance_m": config.clearance,
        "min_clearance_m": tally.least["min_clearance_m"],
        "wall_time_s": wall_time_s,
        "realtime_factor": simulated_s / wall_time_s if wall_time_s > 0 else None,
        "failures": _counted(tally.reasons),
        "first_causes": tally.causes.as_json(),
        "lost_workers": [dict(loss) for loss in lost_workers],
        "limits": _limits(limits),
        "notes": list(notes),
    }


def _counted(reasons: Counter[str]) -> dict[str, int]:
    """Return counts by reason, the most frequent first."""
    return dict(sorted(reasons.items(), key=lambda item: (-item[1], item[0])))


def _limits(limits: MotionLimits) -> dict[str, list[float]]:
    return {
        "velocity_rad_s": limits.velocity.tolist(),
        "acceleration_rad_s2": limits.acceleration.tolist(),
        "jerk_rad_s3": limits.jerk.tolist(),
    }


_OF_SUCCESSES = {"cycle_time_s": _TIMES, "motion_time_s": _TIMES}
_OF_POINTS = {"ik_offset_m": _OFFSETS, "ik_offset_rad": _OFFSETS, "tracking_offset_m": _OFFSETS}
_OF_CYCLES = {"grasp_slip_m": _SLIPS, "grasp_slip_rad": _SLIPS, "place_offset_m": _SLIPS}
_OF_CLOCK = {"ik_time_s": _TIMES, "plan_time_s": _TIMES}


class _Tally:
    """What a summary needs of all cycles: counts, pooled points, and a few numbers a cycle."""

    def __init__(
        self, lines: Iterable[Mapping[str, Any]], watch: Watch | None, causes: FirstCauses
    ) -> None:
        self.watch, self.causes = watch, causes
        self.cycles = self.succeeded = self.succeeded_at_first = 0
        self.retried: Counter[str] = Counter()
        self.sampled_motions = 0
        self.slowed = 0
        self.least: dict[str, float | None] = dict.fromkeys(("min_clearance_m", "slowed_to"))
        self.reasons: Counter[str] = Counter()
        self._pools = {name: Pool() for name in _OF_POINTS}
        self._values = {name: array("d") for name in _OF_SUCCESSES | _OF_CYCLES | _OF_CLOCK}
        for line in lines:
            self._add(line)

    def _add(self, line: Mapping[str, Any]) -> None:
        self.cycles += 1
        self.succeeded += line["success"]
        self.causes.add(line)
        self.succeeded_at_first += line["first_try"]
        self.retried.update(attempt["reason"] for attempt in line["retried"])
        if self.watch is not None:
            self.watch.see(line["success"])
        self.sampled_motions += len(line["sampled_motions"])
        if line["reason"] is not None:
            self.reasons[line["reason"]] += 1
        self._note_least("min_clearance_m", line["min_clearance_m"])
        if line["slowed_to"] is not None and line["slowed_to"] < 1.0:
            self.slowed += 1
            self._note_least("slowed_to", line["slowed_to"])
        for name, pool in self._pools.items():
            pool.add(line[name], line["histograms"][name])
        known = {name: line[name] for name in _OF_CYCLES} | dict(line["wall_clock"])
        if line["success"]:
            known |= {name: line[name] for name in _OF_SUCCESSES}
        for name, values in self._values.items():
            if known.get(name) is not None:
                values.append(known[name])

    def first_try(self) -> dict[str, Any]:
        """Return how many cycles succeeded without another try at the grasp."""
        known = self.cycles > 0
        return {
            "succeeded": self.succeeded_at_first,
            "rate": self.succeeded_at_first / self.cycles if known else None,
            "ci95": list(success_interval(self.succeeded_at_first, self.cycles)) if known else None,
        }

    def retries(self, allowed: int) -> dict[str, Any]:
        """Return how often a grasp was tried again, for what, and how many cycles that saved."""
        return {
            "allowed": allowed,
            "made": self.retried.total(),
            "reasons": _counted(self.retried),
            "recovered": self.succeeded - self.succeeded_at_first,
        }

    def _note_least(self, name: str, value: float | None) -> None:
        known = [least for least in (self.least[name], value) if least is not None]
        self.least[name] = min(known, default=None)

    def spreads(self) -> dict[str, dict[str, float | None]]:
        return {name: self._pools[name].spread(*names) for name, names in _OF_POINTS.items()} | {
            name: spread(self._values[name], *names)
            for name, names in (_OF_SUCCESSES | _OF_CYCLES | _OF_CLOCK).items()
        }


HEADER = (
    f"{'cycle':>5} {'seed':>10} {'cell':>4}  {'verdict':<16} {'time s':>6} {'slip mm':>7} "
    f"{'place mm':>8} {'track mm':>8} {'IK offset m':>11}"
)


def cycle_line(line: Mapping[str, Any]) -> str:
    """Return the row of one cycle, as `cycles.jsonl` has it, in the table under `HEADER`."""
    verdict = line["reason"] or "success"
    if line["success"] and line["retries"]:
        verdict += f", try {line['retries'] + 1}"
    row = (
        f"{line['cycle']:>5} {line['seed']:>10} {line['cell']:>4}  {verdict:<16} "
        f"{_number(line['cycle_time_s'], 1, 2):>6} {_number(line['grasp_slip_m'], 1e3, 2):>7} "
        f"{_number(line['place_offset_m'], 1e3, 0):>8} "
        f"{_number(line['tracking_offset_m']['max'], 1e3, 2):>8} "
        f"{_exponent(line['ik_offset_m']['max']):>11}"
    )
    for number, attempt in enumerate(line["retried"], start=1):
        row += (
            f"\n      try {number}: {attempt['reason']}, {attempt['stage']} at "
            f"{attempt['time_s']:.2f} s: {attempt['detail']}"
        )
    if line["reason"] is not None:
        row += f"\n      {line['failed_stage']} at {line['failed_time_s']:.2f} s: {line['detail']}"
    return row


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
    low, high = in_percent(*summary["ci95"])
    gate = _verdict(summary["gates"]["min_success"])
    if not summary["complete"]:
        gate += f", {cycles} of {summary['requested_cycles']} cycles are finished"
    reach = f"above {low} %"
    if succeeded < cycles:
        reach = f"between {low} and {high} %"
    lines = [
        f"{succeeded} of {cycles} cycles succeeded ({100 * summary['success_rate']:.1f} %, 95 % "
        f"interval {low} to {high} %); gate {summary['min_success']:g}: {gate}",
        *_tries(summary),
        f"proves         a success rate {reach} with 95 % confidence (exact), and no more",
        *_tested(summary["gates"]["min_success"]),
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
        lines += [f"failures       {counted}", *causes_text(summary["first_causes"])]
    for loss in summary["lost_workers"]:
        lines.append(
            f"lost worker    episode {loss['episode']}, attempt {loss['attempt']}: {loss['cause']}"
        )
    lines += [f"note           {note}" for note in summary["notes"]]
    return "\n".join(lines)


def _tries(summary: dict[str, Any]) -> list[str]:
    """Return what the first try did and what further ones added, if any were allowed."""
    first, retries = summary["first_try"], summary["retries"]
    if not retries["allowed"]:
        return []
    low, high = in_percent(*first["ci95"])
    counted = ", ".join(f"{reason} {count}" for reason, count in retries["reasons"].items())
    return [
        f"first try      {first['succeeded']} of {summary['cycles']} succeeded "
        f"({100 * first['rate']:.1f} %, 95 % interval {low} to {high} %)",
        f"after retries  {retries['recovered']} more succeeded; {retries['made']} retries, at most "
        f"{retries['allowed']} a cycle" + (f", for {counted}" if counted else ""),
    ]


def exit_text(summary: dict[str, Any]) -> str:
    """Return the exit status of a run with its reason."""
    if summary["passed"]:
        return "exit status 0: all gates met"
    why = [] if summary["complete"] else ["the run is not complete"]
    for name in summary["gates_missed"]:
        verdict = _verdict(summary["gates"][name]).lower()
        why.append(f"--{name.replace('_', '-')} {'missed' if verdict == 'failed' else verdict}")
    return f"exit status 1: {', '.join(why)}"


def _verdict(gate: dict[str, Any]) -> str:
    undecided = gate.get("proof", {}).get("verdict") == UNDECIDED
    return "passed" if gate["met"] else "UNDECIDED" if undecided else "FAILED"


def _tested(gate: dict[str, Any]) -> list[str]:
    """Return what was tested to prove the success rate, and how far that is if it is undecided."""
    if (proof := gate.get("proof")) is None:
        return []
    if "bounds" in proof:
        low, high = proof["bounds"]
        bound = f"at most {100 * high:.2f}" if high < gate["limit"] else f"at least {100 * low:.2f}"
        tested = (
            f"rate {bound} %, {100 * proof['confidence']:g} % confidence (exact, one-sided), to "
            f"prove {gate['limit']:g}"
        )
    else:
        decided = proof["decided_after"]
        tested = (
            f"Wald's sequential test of {proof['hypotheses'][0]:g} against "
            f"{proof['hypotheses'][1]:g}, error rates up to {proof['alpha']:.3g} and "
            f"{proof['beta']:.3g}" + (f": decided after {decided} cycles" if decided else "")
        )
    lines = [f"tested         {tested}"]
    if proof["verdict"] == UNDECIDED:
        ways = (
            ("cycles_if_all_succeed", "{} if all that follow succeed"),
            ("cycles_at_this_rate", "about {} at the rate so far"),
        )
        counts = [text.format(proof[name]) for name, text in ways if proof[name] is not None]
        lines.append(f"cycles needed  {', '.join(counts) or 'more than anybody can run'}")
    return lines


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
