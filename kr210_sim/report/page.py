"""What a run's report says -> one HTML page, with everything in it."""

from __future__ import annotations

import shlex
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from kr210_sim.config import FREE, RunConfig
from kr210_sim.criteria import CONDITIONS
from kr210_sim.film.format import FILM
from kr210_sim.options import command_words, is_default
from kr210_sim.plots.theme import Plot
from kr210_sim.proof import UNDECIDED
from kr210_sim.report.reading import MOST_OF_A_REASON, RunData
from kr210_sim.report.templating import DASH, number, percent, render
from kr210_sim.stats import in_percent

_COLUMNS = ("mean", "p50", "p95", "p99", "max")

_FIGURES = (
    ("cycle_time_s", "cycle time of successes", "s", 1.0),
    ("motion_time_s", "motion time of successes", "s", 1.0),
    ("ik_offset_m", "IK offset, position", "m", 1.0),
    ("ik_offset_rad", "IK offset, angle", "rad", 1.0),
    ("tracking_offset_m", "tracking", "mm", 1e3),
    ("grasp_slip_m", "grasp slip", "mm", 1e3),
    ("grasp_slip_rad", "grasp turn", "mrad", 1e3),
    ("place_offset_m", "distance from release point", "mm", 1e3),
    ("ik_time_s", "IK, per pose (wall clock)", "µs", 1e6),
    ("plan_time_s", "planning of a cycle (wall clock)", "s", 1.0),
)
"""Key of the summary, label, unit and scale of each row of the table of figures."""

_NOT_AGAIN = FREE - {
    *("cycles", "min_success", "confidence", "stop_early", "indifference"),
    *("max_ik_offset", "max_cycle_time"),
}
"""Options that change nothing of what a run finds."""

_GATES = {
    "min_success": ("success rate, at least", "", "rate"),
    "max_ik_offset": ("IK offset, at most", "m", "value"),
    "max_cycle_time": ("cycle time, at most", "s", "value"),
}


def render_page(
    run: RunData, plots: Sequence[Plot], cycle_plots: Mapping[int, Sequence[Plot]]
) -> str:
    """Return the page.

    Args:
        run: what is in its folder.
        plots: of the whole run.
        cycle_plots: cycle -> plots of it.
    """
    return render(
        "report.html.j2",
        run=run,
        summary=run.summary,
        verdict=verdict(run.summary),
        proof=proof(run.summary),
        tested=tested(run.summary["gates"].get("min_success", {})),
        gates=[gate_row(name, gate) for name, gate in run.summary["gates"].items()],
        figures=list(figure_rows(run.summary)),
        columns=_COLUMNS,
        limits=list(zip(*run.summary["limits"].values(), strict=True)),
        conditions=CONDITIONS,
        options=option_rows(run.config["options"]),
        command=repeat_command(run.config["options"]),
        most_of_a_reason=MOST_OF_A_REASON,
        film=FILM if run.film else None,
        plots=plots,
        cycle_plots=cycle_plots,
    )


def verdict(summary: Mapping[str, Any]) -> tuple[str, str]:
    """Return the verdict on a run: its kind, for the colour, and its word."""
    if summary["passed"]:
        return "good", "passed"
    if not summary["complete"]:
        return "warn", "not complete"
    missed = [gate for gate in summary["gates"].values() if not gate["met"]]
    if missed and all(_undecided(gate) for gate in missed):
        return "warn", "undecided"
    return "bad", "failed"


def _undecided(gate: Mapping[str, Any]) -> bool:
    return bool(gate.get("proof", {}).get("verdict") == UNDECIDED)


def proof(summary: Mapping[str, Any]) -> str:
    """Return in one sentence what the number of successes proves."""
    cycles, succeeded = summary["cycles"], summary["succeeded"]
    if not cycles:
        return "No cycle was finished, so nothing is proved."
    low, high = in_percent(*summary["ci95"])
    if succeeded == cycles:
        reach = f"a success rate above {low} %"
    elif succeeded == 0:
        reach = f"a success rate below {high} %"
    else:
        reach = f"a success rate between {low} and {high} %"
    return f"{succeeded} of {cycles} proves {reach} with 95 % confidence, no more."


def tested(gate: Mapping[str, Any]) -> str:
    """Return how the success rate was tested, and what is still needed; empty without a test."""
    found = gate.get("proof")
    if found is None:
        return ""
    with_ = f", {percent(found['confidence'])} confidence" if "confidence" in found else ""
    text = f"Tested by {found['test']}{with_}: {found['verdict']}."
    if found.get("bounds"):
        low, high = found["bounds"]
        text += f" The rate is at least {percent(low)}, and at most {percent(high)}, each so sure."
    if found.get("decided_after"):
        text += f" Decided after {found['decided_after']} cycles."
    if found.get("cycles_if_all_succeed"):
        text += f" {found['cycles_if_all_succeed']} cycles decide it if all that follow succeed."
    return text


def gate_row(name: str, gate: Mapping[str, Any]) -> dict[str, str]:
    """Return label, limit, value and verdict of a gate."""
    label, unit, kind = _GATES.get(name, (name.replace("_", " "), "", "value"))

    def shown(value: float | None) -> str:
        if kind == "rate":
            return DASH if value is None else percent(value)
        return number(value, 1.0, unit)

    word = "met" if gate["met"] else "undecided" if _undecided(gate) else "missed"
    return {
        "label": label,
        "limit": shown(gate["limit"]),
        "value": shown(gate["value"]),
        "word": word,
        "kind": {"met": "good", "missed": "bad"}.get(word, "warn"),
    }


def figure_rows(summary: Mapping[str, Any]) -> Iterable[tuple[str, str, list[str]]]:
    """Yield label, unit and values under `_COLUMNS` of what is pooled over the cycles."""
    for key, label, unit, scale in _FIGURES:
        if key in summary:
            values = summary[key]
            yield label, unit, [number(values.get(column), scale) for column in _COLUMNS]


def option_rows(options: Mapping[str, Any]) -> list[tuple[str, str, bool]]:
    """Return name and value of each option, and whether it is another than the default."""
    known = RunConfig.metadata()
    rows = []
    for name, value in options.items():
        changed = name in known and not is_default(name, value)
        text = ", ".join(map(str, value)) if isinstance(value, list) else value
        rows.append(
            (f"--{name.replace('_', '-')}", DASH if text in (None, "") else str(text), changed)
        )
    return rows


def repeat_command(options: Mapping[str, Any]) -> str:
    """Return the command line that runs the same cycles again, into a new folder."""
    return shlex.join(command_words(options, _NOT_AGAIN))
