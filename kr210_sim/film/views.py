"""Cameras: those of the scene by name, and one that follows the gripper in any scene."""

from __future__ import annotations

from collections.abc import Callable

import mujoco
import numpy as np
from scipy.spatial.transform import Rotation

from kr210_sim.arrays import Array
from kr210_sim.film.format import GRIPPER
from kr210_sim.film.take import Take

Aim = Callable[[float], mujoco.MjvCamera]
"""Camera at a time of a take [s]."""

_DISTANCE, _SIDE = 1.75, 48.0  # [m], [deg]: behind and beside the gripper
_ELEVATION, _STEEPER = -20.0, -28.0
"""Elevation of the look at a level tool, and what a tool that points down adds to it [deg]."""

_INERTIA = 0.25  # [s]: how softly the camera follows
_TICK = 0.02  # [s]


def aim(name: str, model: mujoco.MjModel, take: Take, T_world_base: Array) -> Aim:
    """Return how a camera looks at a take.

    Args:
        name: of a camera of the scene, or a built-in one.
        model: of the world; its own cameras take precedence.
        take: the cycle.
        T_world_base: (4, 4) where the robot stands.
    """
    camera = mujoco.MjvCamera()
    mujoco.mjv_defaultFreeCamera(model, camera)
    index = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_CAMERA, name)
    if index >= 0:
        camera.type, camera.fixedcamid = mujoco.mjtCamera.mjCAMERA_FIXED, index
    elif name == GRIPPER and "tcp_measured" in take.series:
        return _following(camera, take, T_world_base)
    return lambda _time: camera


def _following(camera: mujoco.MjvCamera, take: Take, T_world_base: Array) -> Aim:
    """Look at the TCP from behind and beside, turning with the arm, softly."""
    ticks = np.arange(0.0, take.duration + _TICK, _TICK)
    pose = np.array([take.at("tcp_measured", tick) for tick in ticks])
    tool = Rotation.from_quat(pose[:, [4, 5, 6, 3]]).apply([1.0, 0.0, 0.0])
    elevation = _ELEVATION + _STEEPER * _smooth(np.maximum(0.0, -tool[:, 2:]))[:, 0]
    p_base = _smooth(pose[:, :3])
    towards = np.unwrap(np.arctan2(p_base[:, 1], p_base[:, 0]))
    heading = np.degrees(np.arctan2(T_world_base[1, 0], T_world_base[0, 0]))
    azimuth = heading + np.degrees(_smooth(towards[:, None])[:, 0]) + _SIDE
    p_world = p_base @ T_world_base[:3, :3].T + T_world_base[:3, 3]
    camera.distance = _DISTANCE

    def at(time: float) -> mujoco.MjvCamera:
        camera.lookat[:] = [np.interp(time, ticks, axis) for axis in p_world.T]
        camera.azimuth = float(np.interp(time, ticks, azimuth))
        camera.elevation = float(np.interp(time, ticks, elevation))
        return camera

    return at


def _smooth(values: Array) -> Array:
    """Return values (n, m), one a tick, averaged over the time around them."""
    reach = round(3 * _INERTIA / _TICK)
    weights = np.exp(-0.5 * (np.arange(-reach, reach + 1) * _TICK / _INERTIA) ** 2)
    padded = np.pad(values, ((reach, reach), (0, 0)), mode="edge")
    columns = [np.convolve(column, weights / weights.sum(), "valid") for column in padded.T]
    return np.stack(columns, axis=1)
