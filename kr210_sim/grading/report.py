"""A grade as text on the terminal."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from kr210_sim.grading.advice import advice
from kr210_sim.grading.findings import Finding
from kr210_sim.stats import in_percent

_FINDINGS_SHOWN = 12

_FORMS = {"poses": "a list of poses", "pose": "one pose", "request": "one of the course's requests"}
_SCOPES = {"course": "for the two planned legs", "all": "for planned and straight legs"}

COLUMNS = (
    "name", "succeeded", "cycles", "passed", "answered", "asked", "offset_max_m", "angle_max_rad",
    "seconds_per_pose", "branch_jumps", "turns", "beyond_limits", "finding",
)  # fmt: skip
"""Of the list of a class."""


def verdict_text(content: Mapping[str, Any]) -> str:
    """Return the verdict in one line."""
    low, high = in_percent(*content["ci95"])
    verdict = "passed" if content["passed"] else "not passed"
    return (
        f"{content['name']}: {content['succeeded']} of {content['cycles']} cycles succeeded, "
        f"{verdict} ({cycles_asked_for(content)} asked for; 95 % interval {low} to {high} %)"
    )


def cycles_asked_for(content: Mapping[str, Any]) -> int:
    """Return the least number of successful cycles with which a solver passes."""
    least: float = content["pass_rate"] * content["cycles"]
    return math.ceil(least - 1e-9)


def asked_text(content: Mapping[str, Any]) -> str:
    """Return how a solver was asked and for what, or nothing if it could not be loaded."""
    if "form" not in content:
        return ""
    form, options = content["form"], content["options"]
    return (
        f"{_FORMS.get(form, '?')} at a time, poses of {options['frame']}, "
        f"{_SCOPES[options['scope']]}; {content['language']}"
    )


def grade_text(content: Mapping[str, Any]) -> str:
    """Return the report of a grade."""
    lines = [verdict_text(content)]
    if asked := asked_text(content):
        lines.append(f"asked          {asked}")
    lines += _findings(content)
    for diagnosis in content["diagnoses"]:
        lines.append(f"diagnosis      {diagnosis['text']}")
        told = advice(diagnosis["key"])
        lines.append(f"what to do     {told.do if told else ''} ({diagnosis['page']})")
    if content["unsolved"]:
        lines.append(
            "unsolved       every pose got the same answer: fill the template in, step by step; "
            "docs/course leads there, `--step NAME` checks a function, `--debug-cases` three poses"
        )
    if content["figures"]["answered"]:
        lines += _figures(content["figures"], content["probes"])
    failures: dict[str, int] = {}
    for line in content["results"]:
        if not line["success"]:
            what = f"{line['reason']} in {line['failed_stage']}"
            failures[what] = failures.get(what, 0) + 1
    if failures:
        shown = ", ".join(f"{what} ({count})" for what, count in failures.items())
        lines.append(f"cycles failed  {shown}")
    if content["output_bytes"]:
        lines.append(f"printed        {content['output_bytes']} bytes; the beginning is kept")
    return "\n".join(lines)


def _findings(content: Mapping[str, Any]) -> list[str]:
    found = [Finding.from_json(item) for item in content["findings"]]
    lines = [f"finding        {item.text(content['name'])}" for item in found[:_FINDINGS_SHOWN]]
    if len(found) > _FINDINGS_SHOWN:
        lines.append(f"               and {len(found) - _FINDINGS_SHOWN} more")
    return lines


def _figures(figures: Mapping[str, Any], probes: Mapping[str, Any]) -> list[str]:
    seconds = figures["seconds_per_pose"]
    travel, optimum = figures["wrist_travel_rad"], figures["wrist_travel_optimum_rad"]
    return [
        f"answers        {figures['answered']} of {figures['asked']} poses answered in time, "
        f"{_time(seconds['mean'])} per pose (slowest {_time(seconds['max'])})",
        f"end effector   {_spread(figures['position_error_m'], 'm')}, "
        f"{_spread(figures['angle_error_rad'], 'rad')}",
        f"wrist center   {_spread(figures['wrist_center_error_m'], 'm')}",
        f"joints         {figures['beyond_limits']} answers beyond limits, "
        f"{figures['branch_jumps']} branch jumps, {figures['turns']} needless whole turns",
        f"axes 4 to 6    travel {travel:.1f} rad, the least possible is {optimum:.1f}",
        f"all around     {probes['within_1_mm']} of {probes['asked']} random poses within 1 mm",
    ]


def _spread(values: Mapping[str, float | None], unit: str) -> str:
    if values["mean"] is None:
        return "-"
    return f"mean {values['mean']:.2g} {unit}, max {values['max']:.2g} {unit}"


def _time(seconds: float | None) -> str:
    if seconds is None:
        return "-"
    for factor, unit in ((1.0, "s"), (1e3, "ms"), (1e6, "us")):
        if seconds * factor >= 1.0:
            return f"{seconds * factor:.3g} {unit}"
    return "below 1 us"


def title_and_evidence(text: str) -> tuple[str, str]:
    """Return the two halves of the sentence of a diagnosis; some have no second one."""
    title, _, evidence = text.partition(": ")
    return title.rstrip("."), evidence[:1].upper() + evidence[1:]


def titles(content: Mapping[str, Any]) -> list[str]:
    """Return what is wrong with a solver, a clause each."""
    found = [Finding.from_json(item).text(content["name"]) for item in content["findings"]]
    found += ["Unsolved: every pose got the same answer"] if content.get("unsolved") else []
    return found + [title_and_evidence(item["text"])[0] for item in content["diagnoses"]]


# ---- a class ---------------------------------------------------------------------------------


def class_row(content: Mapping[str, Any]) -> dict[str, Any]:
    """Return the row of a solver in the list of the class, by COLUMNS."""
    figures = content["figures"] or {}
    return {
        "name": content["name"],
        "succeeded": content["succeeded"],
        "cycles": content["cycles"],
        "passed": content["passed"],
        "answered": figures.get("answered"),
        "asked": figures.get("asked"),
        "offset_max_m": (figures.get("position_error_m") or {}).get("max"),
        "angle_max_rad": (figures.get("angle_error_rad") or {}).get("max"),
        "seconds_per_pose": (figures.get("seconds_per_pose") or {}).get("mean"),
        "branch_jumps": figures.get("branch_jumps"),
        "turns": figures.get("turns"),
        "beyond_limits": figures.get("beyond_limits"),
        "finding": "; ".join(titles(content)) or None,
    }


def class_line(content: Mapping[str, Any]) -> str:
    """Return the line of a solver on the terminal, under `CLASS_HEADER`."""
    row = class_row(content)
    verdict = "passed" if row["passed"] else "not passed"
    cycles = f"{row['succeeded']} of {row['cycles']}"
    offset = "-" if row["offset_max_m"] is None else f"{row['offset_max_m']:.1e}"
    time = "-" if row["seconds_per_pose"] is None else f"{1e3 * row['seconds_per_pose']:.2f}"
    finding = row["finding"] or ""
    finding = finding if len(finding) <= 90 else finding[:87] + "..."
    return f"{row['name'][:30]:<30} {cycles:>8} {verdict:<10} {offset:>9} {time:>9}  {finding}"


CLASS_HEADER = (
    f"{'solver':<30} {'cycles':>8} {'verdict':<10} {'offset m':>9} {'ms/pose':>9}  finding"
)
