"""Grades as pages of HTML that need nothing else: no script, no network, every text escaped."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from html import escape
from typing import Any

from kr210_sim.grading.report import COLUMNS, class_row, grade_text

_STYLE = """
body { font: 15px/1.5 system-ui, sans-serif; margin: 2rem auto; max-width: 70rem; color: #222; }
table { border-collapse: collapse; } td, th { padding: .2rem .7rem; text-align: left; }
tr:nth-child(even) { background: #f3f3f3; } pre { background: #f3f3f3; padding: 1rem; }
pre { white-space: pre-wrap; } .passed { color: #167a32; } .failed { color: #b3261e; }
"""

_WIDTH, _HEIGHT, _LEFT = 900, 260, 70  # of the plot [px]
_LOWEST, _HIGHEST = -16, 1  # decades of the plot


def grade_page(content: Mapping[str, Any]) -> str:
    """Return the page of one solver."""
    cycles = [
        [
            line["cycle"],
            line["cell"],
            "success" if line["success"] else line["reason"],
            line["detail"] or "",
            "-" if line["cycle_time_s"] is None else f"{line['cycle_time_s']:.2f} s",
        ]
        for line in content["results"]
    ]
    parts = [
        f"<pre>{escape(grade_text(content))}</pre>",
        "<h2>End-effector offset</h2>",
        "<p>Distance of the gripper at the answered angles from the requested position, pose by "
        "pose [m].</p>",
        _plot(content["poses"]),
        "<h2>Cycles</h2>",
        _table(("cycle", "cell", "verdict", "why", "time"), cycles),
        "<h2>Isolation</h2>",
        _table(("what", "kept away by"), [list(item) for item in _isolation(content)]),
    ]
    if content["output"]:
        parts += ["<h2>Printed</h2>", f"<pre>{escape(content['output'])}</pre>"]
    return _page(str(content["name"]), bool(content["passed"]), parts)


def class_page(contents: Sequence[Mapping[str, Any]]) -> str:
    """Return the page of a class."""
    rows = [class_row(content) for content in contents]
    passed = sum(bool(row["passed"]) for row in rows)
    cells = [[_shown(row[name]) for name in COLUMNS] for row in rows]
    return _page(
        f"{passed} of {len(rows)} solvers passed", passed == len(rows), [_table(COLUMNS, cells)]
    )


def _isolation(content: Mapping[str, Any]) -> list[tuple[str, str]]:
    return sorted(content.get("isolation", {}).items())


def _shown(value: Any) -> str:
    if value is None:
        return "-"
    if isinstance(value, bool):
        return "yes" if value else "no"
    return f"{value:.3g}" if isinstance(value, float) else str(value)


def _page(title: str, passed: bool, parts: Sequence[str]) -> str:
    kind = "passed" if passed else "failed"
    return "\n".join(
        [
            "<!doctype html>",
            f'<html lang="en"><head><meta charset="utf-8"><title>{escape(title)}</title>',
            f"<style>{_STYLE}</style></head><body>",
            f'<h1 class="{kind}">{escape(title)}</h1>',
            *parts,
            "</body></html>\n",
        ]
    )


def _table(names: Sequence[str], rows: Sequence[Sequence[Any]]) -> str:
    head = "".join(f"<th>{escape(name)}</th>" for name in names)
    body = "\n".join(
        "<tr>" + "".join(f"<td>{escape(str(value))}</td>" for value in row) + "</tr>"
        for row in rows
    )
    return f"<table><tr>{head}</tr>\n{body}</table>"


def _plot(poses: Sequence[Mapping[str, Any]]) -> str:
    """Return the offsets over the poses as a drawing; a pose without an answer is a mark below."""
    decades = _HIGHEST - _LOWEST
    lines = [
        f'<svg viewBox="0 0 {_WIDTH} {_HEIGHT + 30}" width="100%" role="img">',
        f'<rect x="{_LEFT}" y="0" width="{_WIDTH - _LEFT}" height="{_HEIGHT}" fill="#f3f3f3"/>',
    ]
    for decade in range(_LOWEST, _HIGHEST + 1, 3):
        y = _HEIGHT * (_HIGHEST - decade) / decades
        lines.append(
            f'<path d="M{_LEFT} {y:.1f}H{_WIDTH}" stroke="#ccc"/>'
            f'<text x="4" y="{min(y + 5, _HEIGHT):.1f}" font-size="13">1e{decade} m</text>'
        )
    for index, pose in enumerate(poses):
        x = _LEFT + (index + 0.5) * (_WIDTH - _LEFT) / max(1, len(poses))
        if pose["q_rad"] is None:
            lines.append(f'<path d="M{x:.1f} {_HEIGHT + 4}v10" stroke="#b3261e"/>')
            continue
        offset = math.hypot(*pose["position_error_m"])
        height = max(_LOWEST, min(_HIGHEST, math.log10(offset) if offset > 0 else _LOWEST))
        y = _HEIGHT * (_HIGHEST - height) / decades
        colour = "#167a32" if offset < 1e-3 else "#b3261e"
        lines.append(f'<circle cx="{x:.1f}" cy="{y:.1f}" r="2" fill="{colour}"/>')
    lines.append(
        f'<text x="{_LEFT}" y="{_HEIGHT + 26}" font-size="13">{len(poses)} poses, in the order in '
        "which they were asked for</text></svg>"
    )
    return "\n".join(lines)
