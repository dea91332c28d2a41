"""Does the verdict depend on the settings of the physics? `python benchmarks/sensitivity.py`."""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
from concurrent.futures import ProcessPoolExecutor
from importlib.metadata import version
from multiprocessing import get_context
from pathlib import Path
from typing import Any
from unittest import mock

import mujoco
import numpy as np

if __name__ == "__main__":
    sys.path.pop(0)  # this folder has an ik.py of its own

from kr210_sim import physics
from kr210_sim.config import RunConfig
from kr210_sim.mjcf import TIMESTEP
from kr210_sim.runner import run

VARIATIONS: dict[str, dict[str, Any]] = {
    "as it is": {},
    "time step halved, pads as they are": {"timestep": TIMESTEP / 2},
    # MuJoCo advises against a higher impratio with pyramidal cones.
    "pyramidal cone, impratio 1": {"cone": mujoco.mjtCone.mjCONE_PYRAMIDAL, "impratio": 1.0},
    "impratio 1": {"impratio": 1.0},
    "impratio 3": {"impratio": 3.0},
    "impratio 30": {"impratio": 30.0},
    "20 solver iterations": {"iterations": 20},
    "500 solver iterations, tolerance 1e-12": {"iterations": 500, "tolerance": 1e-12},
    "10 noslip iterations": {"noslip_iterations": 10},
    "conjugate gradient solver": {"solver": mujoco.mjtSolver.mjSOL_CG},
}
"""Name -> options that replace ours."""


def cycles_with(changes: dict[str, Any], options: dict[str, Any]) -> list[dict[str, Any]]:
    """Return the lines of a run under other physics."""
    lines: list[dict[str, Any]] = []
    with tempfile.TemporaryDirectory() as folder, mock.patch.dict(physics.OPTIONS, changes):
        run(RunConfig(**options, record="none", out=Path(folder) / "run"), on_cycle=lines.append)
    return lines


def row(name: str, lines: list[dict[str, Any]], base: list[dict[str, Any]]) -> str:
    """Return the row of a table in Markdown."""
    pairs = list(zip(lines, base, strict=True))
    changed = [str(a["cycle"]) for a, b in pairs if a["success"] != b["success"]]
    slip = 1e3 * np.array([line["grasp_slip_m"] for line in lines if line["success"]])
    turn = np.rad2deg([line["grasp_slip_rad"] for line in lines if line["success"]])
    time = np.mean([line["cycle_time_s"] for line in lines if line["success"]])
    return (
        f"| {name} | {sum(line['success'] for line in lines)} of {len(lines)} | "
        f"{', '.join(changed) or 'none'} | {np.median(slip):.2f} | {slip.max():.2f} | "
        f"{turn.max():.2f} | {time:.2f} |"
    )


def main() -> None:
    """Run the same cycles under each variation and print a Markdown table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--cycles", type=int, default=100)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--mass", type=float, default=2.0, help="[kg]")
    parser.add_argument("--randomize", help="preset or file, instead of --mass")
    parser.add_argument("--jobs", type=int, default=2, help="variations at a time")
    parser.add_argument("--json", type=Path, help="also write all lines to this file")
    chosen = parser.parse_args()
    options: dict[str, Any] = {"cycles": chosen.cycles, "seed": chosen.seed}
    options |= {"randomize": chosen.randomize} if chosen.randomize else {"mass": chosen.mass}
    with ProcessPoolExecutor(chosen.jobs, mp_context=get_context("spawn")) as pool:
        asked = [pool.submit(cycles_with, one, options) for one in VARIATIONS.values()]
        lines = dict(zip(VARIATIONS, (one.result() for one in asked), strict=True))
    described = ", ".join(f"{name} {value}" for name, value in options.items())
    print(f"MuJoCo {version('mujoco')}; {described}\n")
    print("| physics | succeeded | verdict changed in cycle | slip, median [mm] | worst |", end="")
    print(" worst [deg] | mean cycle [s] |\n|---|---|---|---|---|---|---|")
    for name, found in lines.items():
        print(row(name, found, lines["as it is"]))
    if chosen.json:
        chosen.json.write_text(json.dumps(lines), encoding="utf-8")


if __name__ == "__main__":
    main()
