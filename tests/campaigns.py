"""What the tests of campaigns compare."""

from __future__ import annotations

import json
from pathlib import Path

from kr210_sim.results import read_lines


def bits_of(out: Path) -> list[dict]:
    """Return what must be the same in every run: all but the clock."""
    lines = list(read_lines(out))
    for line in lines:
        del line["wall_clock"]
    return lines


def summary_of(out: Path) -> dict:
    return json.loads((out / "summary.json").read_text())


def without_clock(summary: dict) -> dict:
    clock = {"wall_time_s", "realtime_factor", "ik_time_s", "plan_time_s", "lost_workers"}
    return {name: value for name, value in summary.items() if name not in clock}
