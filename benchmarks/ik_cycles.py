"""Whole cycles with the analytic and the numeric IK: `python benchmarks/ik_cycles.py`."""

from __future__ import annotations

import argparse
import sys
import tempfile
from pathlib import Path
from typing import Any

if __name__ == "__main__":
    sys.path.pop(0)  # this folder has an ik.py of its own

from kr210_sim.config import SOLVERS, RunConfig
from kr210_sim.runner import run


def main() -> None:
    """Run the same seed with each solver and print a Markdown table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--cycles", type=int, default=10)
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    print_table(summaries_of(options.cycles, options.seed))


def summaries_of(cycles: int, seed: int) -> dict[str, dict[str, Any]]:
    """Return the summary of a run with each solver."""
    summaries: dict[str, dict[str, Any]] = {}
    for name in SOLVERS:
        with tempfile.TemporaryDirectory() as folder:
            config = RunConfig(cycles=cycles, seed=seed, ik=name, out=Path(folder) / "run")
            summaries[name] = run(config)[1]
    return summaries


def print_table(summaries: dict[str, dict[str, Any]]) -> None:
    """Print a column for each solver."""
    print("| | " + " | ".join(SOLVERS) + " |\n|---|" + "---|" * len(SOLVERS))
    for label, read in (
        ("cycles succeeded", lambda s: f"{s['succeeded']} of {s['cycles']}"),
        ("failures", lambda s: ", ".join(f"{k} {v}" for k, v in s["failures"].items()) or "none"),
        ("end-effector offset, mean [m]", lambda s: f"{s['ik_offset_m']['mean']:.1e}"),
        ("end-effector offset, max [m]", lambda s: f"{s['ik_offset_m']['max']:.1e}"),
        ("end-effector offset, max [rad]", lambda s: f"{s['ik_offset_rad']['max']:.1e}"),
        ("time per pose, median [us]", lambda s: f"{1e6 * s['ik_time_s']['p50']:.1f}"),
        ("time per pose over analytic", lambda s: _ratio(s, summaries["analytic"])),
        ("cycle time, mean [s]", lambda s: f"{s['cycle_time_s']['mean']:.2f}"),
    ):
        print(f"| {label} | " + " | ".join(read(summaries[name]) for name in SOLVERS) + " |")


def _ratio(summary: dict[str, Any], base: dict[str, Any]) -> str:
    return f"{summary['ik_time_s']['p50'] / base['ik_time_s']['p50']:.1f}"


if __name__ == "__main__":
    main()
