"""What is drawn into the scene: path and trail of the TCP, waypoints, grip forces, the verdict."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import mujoco
import numpy as np
from scipy.spatial.transform import Rotation

from kr210_sim.arrays import Array
from kr210_sim.film.take import Take

PLANNED, TRAIL = (0.16, 0.22, 0.34, 1.0), (0.0, 0.45, 0.75, 1.0)
AXES = ((0.86, 0.18, 0.16, 1.0), (0.16, 0.66, 0.24, 1.0), (0.14, 0.36, 0.90, 1.0))
FORCE = (0.98, 0.80, 0.10, 1.0)
GOOD, BAD = (0.10, 0.72, 0.32, 1.0), (0.90, 0.12, 0.14, 1.0)

PLANNED_WIDTH, TRAIL_WIDTH = 1.6, 4.0  # [pixels] of a picture 720 high
AXIS_LENGTH, AXIS_RADIUS = 0.12, 0.006  # [m]
FORCE_LENGTH, FORCE_RADIUS = 0.15, 0.012  # [m]; the length is that of the cycle's largest force
SIGN_SIZE, SIGN_RADIUS, SIGN_HEIGHT = 0.19, 0.032, 0.36  # [m], above the TCP
SIGN_NEARER = 0.15
"""The verdict is drawn at this share of its distance, and that much smaller: nothing hides it."""

TICK = ((-0.9, 0.0), (-0.25, -0.7), (1.0, 0.85))
CROSS = (((-0.8, -0.8), (0.8, 0.8)), ((-0.8, 0.8), (0.8, -0.8)))
LEAST_FORCE = 1.0  # [N]


class Marks:
    """The marks of one take.

    Args:
        take: the cycle.
        T_world_base: (4, 4) where the robot stands; the record is in its frame.
        height: of the picture [pixels]; lines are as wide as it is large.
    """

    def __init__(self, take: Take, T_world_base: Array, *, height: int) -> None:
        self._take, self._T = take, T_world_base
        self._scale = max(height / 720, 0.5)
        self._planned = self._world(take.path("tcp_commanded")[0])
        trail, self._trail_steps = take.path("tcp_measured")
        self._trail = self._world(trail)
        self._sign = self._world(self._sign_place())
        forces = take.series.get("grip_force")
        self._largest = max(LEAST_FORCE, 0.0 if forces is None else float(np.max(np.abs(forces))))

    def _world(self, points: Array) -> Array:
        return np.asarray(points @ self._T[:3, :3].T + self._T[:3, 3])

    def draw(self, scene: mujoco.MjvScene, time: float) -> None:
        """Append the marks at a time [s] to a scene that has just been updated."""
        take = self._take
        for begin, end in zip(self._planned[:-1:2], self._planned[1::2], strict=False):
            self._line(scene, begin, end, PLANNED, PLANNED_WIDTH)
        for pose in take.waypoints:
            self._frame(scene, pose)
        tcp = take.at("tcp_measured", time)
        if tcp is None:
            return
        p_tcp = self._world(tcp[:3])
        walked = self._trail[self._trail_steps < take.step_at(time)]
        points = np.concatenate([walked, p_tcp[None]])
        for begin, end in pairwise(points):
            self._line(scene, begin, end, TRAIL, TRAIL_WIDTH)
        self._forces(scene, time, p_tcp)
        self._verdict(scene, time)

    def _sign_place(self) -> Array:
        """Return where the verdict is shown (3,), in the base frame [m]."""
        take = self._take
        ends = [end for stage, _, end in take.stages if stage == "OPEN_GRIPPER"]
        time = ends[-1] if ends and take.score["success"] else take.verdict_time
        tcp = take.at("tcp_measured", time)
        return np.zeros(3) if tcp is None else tcp[:3] + np.array([0.0, 0.0, SIGN_HEIGHT])

    def _frame(self, scene: mujoco.MjvScene, pose: Array) -> None:
        """Draw the axes of a pose (7,) of the base frame."""
        p = self._world(pose[:3])
        R = self._T[:3, :3] @ Rotation.from_quat(pose[[4, 5, 6, 3]]).as_matrix()
        for axis, rgba in zip(R.T, AXES, strict=True):
            _connect(scene, p, p + AXIS_LENGTH * axis, AXIS_RADIUS, rgba)

    def _forces(self, scene: mujoco.MjvScene, time: float, p_tcp: Array) -> None:
        """Draw the force of each finger as an arrow that ends at the target's axis."""
        forces = self._take.at("grip_force", time)
        if forces is None:
            return
        radius = float(self._take.score["target"]["radius_m"])
        for force in forces.reshape(2, 3):
            size = float(np.linalg.norm(force))
            if size < LEAST_FORCE:
                continue
            towards = force / size
            tip = p_tcp - radius * towards
            tail = tip - FORCE_LENGTH * size / self._largest * towards
            arrow = mujoco.mjtGeom.mjGEOM_ARROW
            _connect(scene, tail, tip, FORCE_RADIUS, FORCE, arrow)

    def _verdict(self, scene: mujoco.MjvScene, time: float) -> None:
        """Draw, once it is known, a tick where the target was let go or a cross where it failed."""
        if time < self._take.verdict_time:
            return
        good = bool(self._take.score["success"])
        strokes = list(pairwise(TICK)) if good else CROSS
        eye = np.mean([camera.pos for camera in scene.camera], axis=0)  # between left and right
        up = np.array(scene.camera[0].up, dtype=float)
        right = np.cross(np.array(scene.camera[0].forward, dtype=float), up)
        middle = eye + SIGN_NEARER * (self._sign - eye)
        size, radius = SIGN_NEARER * SIGN_SIZE, SIGN_NEARER * SIGN_RADIUS
        for stroke in strokes:
            begin, end = (middle + size * (x * right + y * up) for x, y in stroke)
            _connect(scene, begin, end, radius, GOOD if good else BAD)

    def _line(
        self, scene: mujoco.MjvScene, begin: Array, end: Array, rgba: Sequence[float], width: float
    ) -> None:
        _connect(scene, begin, end, width * self._scale, rgba, mujoco.mjtGeom.mjGEOM_LINE)


def _connect(
    scene: mujoco.MjvScene,
    begin: Array,
    end: Array,
    width: float,
    rgba: Sequence[float],
    kind: int = mujoco.mjtGeom.mjGEOM_CAPSULE,
) -> None:
    """Append a shape from one point (3,) to another of the world; nothing if the scene is full."""
    if scene.ngeom >= scene.maxgeom:
        return
    geom = scene.geoms[scene.ngeom]
    mujoco.mjv_initGeom(
        geom, kind, np.zeros(3), np.zeros(3), np.eye(3).ravel(), np.array(rgba, dtype=np.float32)
    )
    mujoco.mjv_connector(geom, kind, width, begin, end)
    geom.category = mujoco.mjtCatBit.mjCAT_DECOR  # casts no shadow
    geom.emission = 0.0 if kind == mujoco.mjtGeom.mjGEOM_LINE else 0.35
    scene.ngeom += 1
