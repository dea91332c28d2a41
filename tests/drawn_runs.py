"""Small runs made of numbers alone, for the tests of plots and reports: nothing is simulated."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from kr210_sim.config import RunConfig
from kr210_sim.plots.recorded import Box, Recorded, Scenery
from kr210_sim.record import RECORD_STEP, SERIES, STAGES, CycleRecord, Event, save_record
from kr210_sim.results import record_path, write_json
from kr210_sim.score import score_cycle
from kr210_sim.summary import summarize
from kr210_sim.trajectory import MotionLimits

JOINTS = tuple(f"joint_{number}" for number in range(1, 7))
STEPS = 4 * len(STAGES)
"""Of a record: four for each stage."""

LIMITS = MotionLimits.from_velocity(np.full(6, 2.0))
SCENERY = Scenery(
    boxes=(Box(T_base_box=np.eye(4), half_size=np.array([0.3, 0.4, 0.5])),),
    arm=np.array([[0.0, 0.0, 0.0], [0.0, 0.0, 1.0], [1.0, 0.0, 1.5]]),
    cells={1: np.array([2.0, 0.5, 1.0]), 2: np.array([2.0, -0.5, 1.0])},
    place=np.array([0.0, 2.0, 0.5]),
    floor=0.0,
    joints=JOINTS,
    lower=np.full(6, -3.0),
    upper=np.full(6, 3.0),
)


def make_record(cycle: int, event: Event | None = None, **changes: Any) -> CycleRecord:
    """A cycle that moves as if; it succeeds unless an event cuts it short."""
    time = RECORD_STEP * np.arange(1, STEPS + 1)
    stage = np.repeat(np.arange(len(STAGES)), STEPS // len(STAGES)).astype(float)
    series = {name: np.zeros(STEPS) for name in SERIES}
    path = np.column_stack([2 * np.cos(time), 2 * np.sin(time), 1 + time, np.ones(STEPS)])
    pose = np.column_stack([path, np.zeros((STEPS, 3))])
    carrying = ("LIFT", "WITHDRAW", "MOVE_TO_PLACE", "LOWER")
    held = np.isin(stage, [STAGES.index(name) for name in carrying])
    series |= {
        "time": time,
        "stage": stage,
        "qpos": np.column_stack([np.sin(time * k) for k in range(1, 7)]),
        "tcp_measured": pose,
        "tcp_commanded": pose,
        "finger_force": np.column_stack([250.0 * held, 240.0 * held]),
        "grip_force": np.zeros((STEPS, 6)),
        "fingers_touch": np.column_stack([held, held]).astype(float),
        "clear_height_max": 0.02 * held,
        "slip_m_max": 1e-3 * held,
        "tracking_max": np.full(STEPS, 5e-4),
    }
    if event is not None:
        series = {name: values[time <= event.time + 1e-9] for name, values in series.items()}
    record = CycleRecord(
        cycle=cycle,
        episode=0,
        seed=1000 + cycle,
        cell=1 + cycle % 2,
        target={"mass_kg": 1.0, "radius_m": 0.05, "length_m": 0.25},
        series=series,
        events=[] if event is None else [event],
        ik_tcp=pose[:8],
        ik_offset_m=np.array([0.0, *np.geomspace(1e-16, 1e-15, 7)]),
        ik_offset_rad=np.geomspace(1e-16, 1e-15, 8),
        p_base_release=np.zeros(3),
        home_time=None if event else 0.4,
        slowed_to=1.0,
        clearance_m={"MOVE_TO_PICK": 0.05},
        wall_clock={"ik_time_s": 1e-5, "plan_time_s": 0.1},
        start={f"robot/{name}": np.zeros(1) for name in JOINTS},
        final={"fingers_open": 1.0, "finger_contacts": 0.0, "resting_for": 1.0, "supported": 1.0}
        | {"in_place_volume": 1.0, "home_distance": 0.0, "target_x": 0.01, "target_y": 0.0},
    )
    for name, value in changes.items():
        setattr(record, name, value)
    return record


DROPPED = Event(
    reason="dropped", stage="MOVE_TO_PLACE", time=0.22, detail="a finger lost <b>it</b>"
)


def make_run(
    out: Path, records: Sequence[CycleRecord], *, kept: bool = True, **options: Any
) -> list[dict[str, Any]]:
    """Write the folder of a run of these cycles; returns the lines of its `cycles.jsonl`."""
    config = RunConfig(**({"cycles": len(records), "out": out} | options))
    lines = [score_cycle(record, time_limit=60.0).as_json() for record in records]
    out.mkdir(parents=True)
    for record in records if kept else ():
        save_record(record, record_path(out, record.cycle))
    (out / "cycles.jsonl").write_text("".join(json.dumps(line) + "\n" for line in lines))
    versions = {"kr210-sim": "1.0", "mujoco": "3.17.0", "ompl": None}
    write_json(
        out / "config.json",
        {"schema_version": 1, "options": config.as_json(), "randomization": None}
        | {"world_sha256": "0" * 64, "versions": versions},
    )
    summary = summarize(
        lines, config=config, limits=LIMITS, notes=["a <note>"], wall_time_s=1.0, simulated_s=2.0
    )
    write_json(out / "summary.json", summary)
    return lines


def recorded(record: CycleRecord, folder: Path) -> Recorded:
    """A cycle as the plots get it."""
    from kr210_sim.record import load_series

    path = folder / f"{record.cycle}.npz"
    save_record(record, path)
    line = score_cycle(record, time_limit=60.0).as_json()
    return Recorded(line=line, record=load_series(path))
