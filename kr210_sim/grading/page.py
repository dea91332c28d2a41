"""Grades as pages of HTML in the look of a run's report: one of a solver, one of a class."""

from __future__ import annotations

import math
import shlex
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from itertools import groupby
from typing import Any
from urllib.parse import quote

from kr210_sim.grading.advice import advice
from kr210_sim.grading.findings import Finding
from kr210_sim.grading.grade import GradeConfig
from kr210_sim.grading.report import (
    asked_text,
    class_row,
    cycles_asked_for,
    title_and_evidence,
    titles,
)
from kr210_sim.plots.grade_plots import Pose, answers_plot, standout_plot
from kr210_sim.plots.theme import Plot
from kr210_sim.report.page import proof
from kr210_sim.report.templating import number, render

MOST_CYCLES = 12
"""Cycles whose poses are shown one by one; failures first."""

_SPREADS = (
    ("position_error_m", "end-effector offset, position", "m", 1.0),
    ("angle_error_rad", "end-effector offset, angle", "rad", 1.0),
    ("wrist_center_error_m", "wrist-center offset", "m", 1.0),
    ("seconds_per_pose", "time per pose (wall clock)", "ms", 1e3),
)
"""Key of the figures, label, unit and scale."""

_COLUMNS = ("mean", "p95", "max")

_OPTIONS = {"cycles": "--cycles", "seed": "--seed", "scope": "--ik-scope", "frame": "--frame"}
_LIMITS = {"pose_timeout": "--pose-timeout", "time_limit": "--time-limit"}


def grade_page(content: Mapping[str, Any]) -> str:
    """Return the page of one solver, from its `grade.json`."""
    poses = _shown_poses(content)
    figures = content["figures"]
    return render(
        "grade.html.j2",
        grade=content,
        kind="good" if content["passed"] else "bad",
        proof=proof(content) if content["results"] else "",
        asked_for=cycles_asked_for(content),
        asked=asked_text(content),
        notes=list(_notes(content)),
        plots=_plots(poses, content["limits_rad"]),
        columns=_COLUMNS,
        spreads=[
            (label, unit, [number(figures[key][column], scale) for column in _COLUMNS])
            for key, label, unit, scale in _SPREADS
        ],
        counts=list(_counts(content)) if figures["answered"] else [],
        legs=_legs(poses),
        offset=lambda vector: math.hypot(*vector),
        left_out=len(content["poses"]) - len(poses),
        command=grade_command([content["solver"]], content["options"]),
        options=option_rows(content["options"]),
        isolation=[(*item, False) for item in sorted(content.get("isolation", {}).items())],
    )


def class_page(contents: Sequence[Mapping[str, Any]], *, total: int, command: str) -> str:
    """Return the page of a class.

    Args:
        contents: the grades that there are, in order.
        total: how many solvers the class has.
        command: that goes on with it, or repeats it.
    """
    passed = sum(bool(content["passed"]) for content in contents)
    mistakes, findings = (
        Counter(name for content in contents for name in {item[key] for item in content[part]})
        for part, key in (("diagnoses", "key"), ("findings", "kind"))
    )
    return render(
        "class.html.j2",
        rows=[(class_row(content), _link(content), titles(content)) for content in contents],
        passed=passed,
        total=total,
        kind="good" if passed == total else "warn" if passed or len(contents) < total else "bad",
        mistakes=[(key, count, advice(key)) for key, count in mistakes.most_common()],
        findings=findings.most_common(),
        command=command,
    )


def grade_command(solvers: Sequence[str], options: Mapping[str, Any]) -> str:
    """Return the command line that grades solvers with the options of a `grade.json`."""
    words = ["kr210-sim", "grade", *solvers]
    for name, value, changed in option_rows(options):
        if changed:
            words += [name, value]
    return shlex.join(words)


def option_rows(options: Mapping[str, Any]) -> list[tuple[str, str, bool]]:
    """Return name and value of the options, and whether each is another than the default."""
    values = {_OPTIONS[key]: options[key] for key in _OPTIONS}
    values |= {_LIMITS[key]: options["limits"][key] for key in _LIMITS}
    default = GradeConfig()
    usual = {_OPTIONS[key]: getattr(default, key) for key in _OPTIONS}
    usual |= {_LIMITS[key]: getattr(default.limits, key) for key in _LIMITS}
    return [(name, str(value), value != usual[name]) for name, value in values.items()]


# ---- of one solver ---------------------------------------------------------------------------


def _notes(content: Mapping[str, Any]) -> Iterable[dict[str, Any]]:
    """Yield what is wrong and what to do: findings, then diagnoses."""
    for item in content["findings"]:
        finding = Finding.from_json(item)
        where = f"Line {finding.line} of {content['name']}: " if finding.line else ""
        yield {
            "kind": "bad",
            "title": f"{where}{finding.detail}",
            "text": "" if finding.pose is None else f"At pose {finding.pose} of the request.",
            "code": (finding.source or "").strip(),
            "advice": None,
        }
    for diagnosis in content["diagnoses"]:
        title, evidence = title_and_evidence(diagnosis["text"])
        yield {
            "kind": "warn" if content["passed"] else "bad",
            "title": title,
            "text": evidence,
            "code": "",
            "advice": advice(diagnosis["key"]),
        }


def _plots(poses: Sequence[Pose], limits: Mapping[str, Any]) -> list[Plot]:
    if not any(pose["q_rad"] for pose in poses):
        return []
    return [standout_plot(poses), answers_plot(poses, limits["lower"], limits["upper"])]


def _counts(content: Mapping[str, Any]) -> Iterable[tuple[str, str, str]]:
    """Yield label, what was found and the best there is."""
    figures, probes = content["figures"], content["probes"]
    yield "poses answered in time", str(figures["answered"]), str(figures["asked"])
    yield "random poses within 1 mm", str(probes["within_1_mm"]), str(probes["asked"])
    yield "answers beyond joint limits", str(figures["beyond_limits"]), "0"
    yield "branch jumps that the best path does not make", str(figures["branch_jumps"]), "0"
    yield "whole turns that need not be", str(figures["turns"]), "0"
    way, least = figures["wrist_travel_rad"], figures["wrist_travel_optimum_rad"]
    yield "way of axes 4 to 6 [rad]", number(way), number(least)


def _shown_poses(content: Mapping[str, Any]) -> list[Pose]:
    """Return the poses of the cycles that are shown one by one, in order."""
    order = sorted(content["results"], key=lambda line: (line["success"], line["cycle"]))
    chosen = {line["cycle"] for line in order[:MOST_CYCLES]}
    return [pose for pose in content["poses"] if pose["cycle"] in chosen]


def _legs(poses: Sequence[Pose]) -> list[tuple[tuple[int, str], list[Pose]]]:
    """Return cycle, stage and poses of each request that was answered at all."""
    legs = [
        (key, list(rows))
        for key, rows in groupby(poses, lambda pose: (pose["cycle"], pose["stage"]))
    ]
    return [(key, rows) for key, rows in legs if any(row["q_rad"] for row in rows)]


# ---- of a class ------------------------------------------------------------------------------


def folder_of(name: str) -> str:
    """Return the name of the folder that a solver of a class has beside the class's page."""
    return name.replace("/", "__")


def _link(content: Mapping[str, Any]) -> str:
    """Return where the page of a solver is, beside that of the class."""
    return quote(f"{folder_of(content['name'])}/grade.html", errors="surrogateescape")
