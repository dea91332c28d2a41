"""End-effector offset: MuJoCo's own TCP pose at the answered angles against the requested pose."""

from __future__ import annotations

import mujoco
import numpy as np

from kr210_sim.arrays import Array
from kr210_sim.planning import SolvedPoses
from kr210_sim.scene import ROBOT_PREFIX
from kr210_sim.simulation import Simulation


def ik_offsets(simulation: Simulation, solved: SolvedPoses) -> tuple[Array, Array]:
    """Return the position [m] and angle [rad] offset of every solved pose, each (N,).

    The kinematics is MuJoCo's, not that of `ik`: it judges the answer independently.
    """
    model, scene = simulation.model, simulation.scene
    data = mujoco.MjData(model)
    site = model.site(ROBOT_PREFIX + "tcp").id
    T_world_tcp = scene.T_world_base @ solved.T_base_palm @ scene.robot.T_palm_tcp
    position = np.empty(len(solved.q))
    angle = np.empty(len(solved.q))
    for index, (q, requested) in enumerate(zip(solved.q, T_world_tcp, strict=True)):
        data.qpos[simulation.addresses.arm] = q
        mujoco.mj_kinematics(model, data)
        reached = data.site_xmat[site].reshape(3, 3)
        position[index] = np.linalg.norm(data.site_xpos[site] - requested[:3, 3])
        # |R1 - R2|_F = 2 sqrt(2) sin(angle/2): exact down to rounding, unlike acos of the trace.
        chord = np.linalg.norm(reached - requested[:3, :3]) / np.sqrt(8.0)
        angle[index] = 2 * np.arcsin(min(1.0, float(chord)))
    return position, angle
