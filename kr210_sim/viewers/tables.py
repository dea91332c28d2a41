"""The numbers of a viewer's page as HTML."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from html import escape
from typing import Any

import numpy as np

from kr210_sim.arrays import Array
from kr210_sim.viewers.arm_state import ArmState, Branch

STYLE = """<style>
.kr { font: 12px/1.5 ui-monospace, SFMono-Regular, Menlo, Consolas, 'DejaVu Sans Mono', monospace;
      padding: 2px 14px 8px; }
.kr h4 { font: 600 12px/1.4 system-ui, sans-serif; margin: 8px 0 2px; opacity: .75; }
.kr p { font: 12px/1.4 system-ui, sans-serif; margin: 2px 0; opacity: .75; }
.kr table { border-collapse: collapse; width: 100%; font-variant-numeric: tabular-nums; }
.kr td, .kr th { padding: 0 2px; text-align: right; white-space: nowrap; font-weight: 400; }
.kr th { opacity: .6; }
.kr td:first-child, .kr th:first-child { text-align: left; }
.kr .now { font-weight: 700; }
.kr .out { color: #c2410c; }
.kr .none { opacity: .45; }
.kr b.dot { display: inline-block; width: 9px; height: 9px; border-radius: 50%; margin-right: 4px; }
</style>"""


def state_html(state: ArmState, *, base: str, palm: str) -> str:
    """Return the tool poses and the wrist center of an arm.

    Args:
        state: the arm; its frames are in the base frame.
        base: link whose frame the base frame is.
        palm: link that the inverse kinematics solves for.
    """
    return (
        f'{STYLE}<div class="kr" id="kr-poses">'
        f"<h4>T_base_tcp: the TCP in the frame of {escape(base)}, m</h4>"
        f"{_rows('T_base_tcp', state.T_base_tcp)}"
        f"<h4>T_base_{escape(palm)}: {escape(palm)} in the frame of {escape(base)}, m</h4>"
        f"{_rows('T_base_palm', state.T_base_palm)}"
        f"<h4>wrist center in the frame of {escape(base)}, m</h4>"
        f"{_rows('p_base_wrist_center', [state.p_base_wrist_center])}</div>"
    )


def branches_html(branches: Sequence[Branch], colors: Sequence[str]) -> str:
    """Return the table of branches; `colors` are those of their ghosts, as CSS has them."""
    head = "".join(f"<th>q{joint}</th>" for joint in range(1, 7))
    rows = "".join(_branch(branch, color) for branch, color in zip(branches, colors, strict=True))
    return (
        f'{STYLE}<div class="kr" id="kr-branches"><table><tr><th>branch</th>{head}<th></th></tr>'
        f"{rows}</table><p>degrees; shoulder, elbow, wrist; bold: the arm itself; limits: whether "
        "a turn of the branch is within the joint limits</p></div>"
    )


def status_html(rows: Sequence[tuple[str, str]]) -> str:
    """Return names and values, a line each."""
    lines = "".join(
        f'<tr><th>{escape(name)}</th><td id="kr-{escape(name).replace(" ", "-")}">'
        f"{escape(value)}</td></tr>"
        for name, value in rows
    )
    return f'{STYLE}<div class="kr" id="kr-status"><table>{lines}</table></div>'


def cycles_html(lines: Sequence[Mapping[str, Any]]) -> str:
    """Return the finished cycles, as `cycles.jsonl` has them, the last one first."""
    succeeded = sum(bool(line["success"]) for line in lines)
    rows = "".join(
        f"<tr><td>{line['cycle']}</td><td>{line['cell']}</td><td>{escape(_verdict(line))}</td></tr>"
        for line in reversed(lines)
    )
    return (
        f'{STYLE}<div class="kr" id="kr-cycles"><p>{succeeded} of {len(lines)} cycles succeeded</p>'
        f"<table><tr><th>cycle</th><th>cell</th><th></th></tr>{rows}</table></div>"
    )


def _verdict(line: Mapping[str, Any]) -> str:
    if line["success"]:
        return "success"
    return f"{line['reason']} in {line['failed_stage']}"


def _branch(branch: Branch, color: str) -> str:
    dot = f'<b class="dot" style="background:{color}"></b>{escape(branch.name)}'
    if branch.q is None:
        return f'<tr class="none"><td>{dot}</td><td colspan="6">out of reach</td><td></td></tr>'
    angles = "".join(f"<td>{_plain(angle, 1)}</td>" for angle in np.degrees(branch.q))
    kind = ("now " if branch.current else "") + ("" if branch.within_limits else "out")
    verdict = "in" if branch.within_limits else "beyond"
    return f'<tr class="{kind}"><td>{dot}</td>{angles}<td>{verdict}</td></tr>'


def _rows(name: str, rows: Sequence[Array] | Array) -> str:
    lines = "".join(
        "<tr>" + "".join(f"<td>{_plain(value, 6)}</td>" for value in row) + "</tr>" for row in rows
    )
    return f'<table id="{name}">{lines}</table>'


def _plain(value: float, digits: int) -> str:
    """Write a number without a sign before zero."""
    return f"{round(float(value), digits) + 0.0:.{digits}f}"
