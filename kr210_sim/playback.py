"""Record -> model state: the saved world of an episode and how recorded joints map into it."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path

import mujoco
import numpy as np

from kr210_sim.arrays import Array
from kr210_sim.record import CycleRecord
from kr210_sim.results import world_path
from kr210_sim.scene import ROBOT_PREFIX, Scene, Target, add_target

_PARKING_PITCH = 0.3  # [m], between parked targets


def episode_world(
    scene: Scene, targets: Sequence[Target], records: Sequence[CycleRecord]
) -> mujoco.MjSpec:
    """Return an episode's world with all its targets.

    The keyframe `cycle_NNNN` is the state in which that cycle began. A target that was not in the
    world yet, or no longer, is parked upright on the floor behind the robot.
    """
    spec = scene.spec.copy()
    for target in targets:
        add_target(spec, scene, target)
    model = spec.compile()
    start = parked(model, scene, targets)
    ctrl = np.array(model.key(f"{ROBOT_PREFIX}home").ctrl)
    for record in records:
        qpos = start.copy()
        widths = [len(values) for values in record.start.values()]
        names = list(zip(record.start, widths, strict=True))
        place_joints(model, qpos, names, np.concatenate(list(record.start.values())))
        spec.add_key(name=f"cycle_{record.cycle:04d}", qpos=qpos, ctrl=ctrl)
    return spec


def parked(model: mujoco.MjModel, scene: Scene, targets: Sequence[Target]) -> Array:
    """Return qpos (nq,) of a model with every target parked upright behind the robot."""
    qpos = np.array(model.qpos0)
    for target in targets:
        address = int(model.joint(target.name).qposadr[0])
        behind = scene.T_world_base @ [-2.0, _PARKING_PITCH * target.number - 1.5, 0.0, 1.0]
        qpos[address : address + 7] = [*behind[:2], target.length / 2, 1.0, 0.0, 0.0, 0.0]
    return qpos


def place_joints(
    model: mujoco.MjModel, qpos: Array, joint_names: Sequence[tuple[str, int]], values: Array
) -> None:
    """Write recorded joint values into `qpos` of a model that has at least these joints."""
    start = 0
    for name, width in joint_names:
        address = int(model.joint(name).qposadr[0])
        qpos[address : address + width] = values[start : start + width]
        start += width


def load_world(out: Path, cycle: int) -> mujoco.MjModel:
    """Load the saved world in which a cycle of a run took place.

    Args:
        out: folder of the run.
        cycle: index in the run.

    Raises:
        FileNotFoundError: if the run has no such cycle.
    """
    with (out / "cycles.jsonl").open(encoding="utf-8") as lines:
        for line in lines:
            score = json.loads(line)
            if score["cycle"] == cycle:
                return mujoco.MjModel.from_xml_path(str(world_path(out, score["episode"])))
    raise FileNotFoundError(f"{out}: no cycle {cycle} in cycles.jsonl")
