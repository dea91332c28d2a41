"""What stands around a recorded cycle, read from the saved world of its episode."""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np

from kr210_sim.arrays import Array
from kr210_sim.playback import load_world
from kr210_sim.plots.recorded import ARM_JOINTS, Box, Scenery
from kr210_sim.scene import ROBOT_PREFIX


def read_scenery(out: Path, cycle: int) -> Scenery:
    """Return fixtures, cells, joint limits and the arm at home, in the base frame.

    Args:
        out: folder of the run.
        cycle: one whose record was kept.

    Raises:
        FileNotFoundError: if the run has no such cycle.
        ValueError: if MuJoCo cannot load its world.
    """
    model = load_world(out, cycle)
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, model.key(f"{ROBOT_PREFIX}home").id)
    mujoco.mj_kinematics(model, data)
    base = data.site("robot_base")
    T_base_world = np.linalg.inv(_pose(base.xpos, base.xmat))

    def in_base(positions: Array) -> Array:
        return np.asarray(positions) @ T_base_world[:3, :3].T + T_base_world[:3, 3]

    # The actuators of the arm come first, in the order of its joints.
    joints = [model.joint(model.actuator_trnid[index, 0]) for index in range(ARM_JOINTS)]
    skeleton = [base.xpos, *(data.xanchor[joint.id] for joint in joints)]
    skeleton.append(data.site(f"{ROBOT_PREFIX}tcp").xpos)
    sites = [model.site(index).name for index in range(model.nsite)]
    numbers = [int(name[5:]) for name in sites if name.startswith("cell_") and name[5:].isdigit()]
    return Scenery(
        boxes=tuple(_boxes(model, data, T_base_world)),
        arm=in_base(np.array(skeleton)),
        cells={number: in_base(data.site(f"cell_{number}").xpos) for number in sorted(numbers)},
        place=in_base(data.site("place").xpos),
        floor=float(T_base_world[2, 3]),
        joints=tuple(joint.name.removeprefix(ROBOT_PREFIX) for joint in joints),
        lower=np.array([joint.range[0] for joint in joints]),
        upper=np.array([joint.range[1] for joint in joints]),
    )


def _boxes(model: mujoco.MjModel, data: mujoco.MjData, T_base_world: Array) -> list[Box]:
    """Return the boxes around every fixture that can be touched."""
    found = []
    for index in range(model.ngeom):
        geom = model.geom(index)
        body = model.body(geom.bodyid[0])
        touched = geom.contype[0] or geom.conaffinity[0]
        plane = geom.type[0] == mujoco.mjtGeom.mjGEOM_PLANE
        if not touched or plane or body.weldid[0] != 0 or body.name.startswith(ROBOT_PREFIX):
            continue
        T_world_geom = _pose(data.geom_xpos[index], data.geom_xmat[index])
        centre, half = model.geom_aabb[index].reshape(2, 3)
        T_geom_box = np.eye(4)
        T_geom_box[:3, 3] = centre
        found.append(Box(T_base_box=T_base_world @ T_world_geom @ T_geom_box, half_size=half))
    return found


def _pose(position: Array, matrix: Array) -> Array:
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = matrix.reshape(3, 3), position
    return T
