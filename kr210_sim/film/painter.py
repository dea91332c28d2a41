"""Painter: draws recorded cycles off screen; needs `MUJOCO_GL` to be set before MuJoCo's import."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import mujoco
import numpy as np
from numpy.typing import NDArray

from kr210_sim.film.marks import Marks
from kr210_sim.film.overlay import Overlay
from kr210_sim.film.studio import studio_model, visible
from kr210_sim.film.take import Take, read_take
from kr210_sim.film.views import Aim, aim
from kr210_sim.playback import place_joints
from kr210_sim.results import read_lines, world_path

Picture = NDArray[np.uint8]

_MAX_GEOMS = 4000
_HIDDEN_GROUP = 5
_LIFT = 0.05
"""Share of its height by which the picture is moved up, clear of the overlay's lower part."""

_ASPECT, _WIDEST = 16 / 9, 1.35
"""Narrower pictures take in more height, up to that factor, so that less is cut off beside."""


def tiles(count: int, size: tuple[int, int]) -> list[tuple[int, int, int, int]]:
    """Return (left, top, width, height) [pixels] of the pictures of several cameras.

    Rows are about as many as columns; each fills the width.

    Args:
        count: of cameras.
        size: width and height of the whole [pixels].
    """
    rows = round(count**0.5)
    ends = np.linspace(0, count, rows + 1).round().astype(int)
    lines = np.linspace(0, size[1], rows + 1).round().astype(int)
    found = []
    for row in range(rows):
        columns = ends[row + 1] - ends[row]
        edges = np.linspace(0, size[0], columns + 1).round().astype(int)
        for left, right in pairwise(edges):
            height = lines[row + 1] - lines[row]
            found.append((int(left), int(lines[row]), int(right - left), int(height)))
    return found


class Painter:
    """Draws the cycles of a run.

    Args:
        out: folder of the run.
        cameras: names; several share the picture.
        size: width and height [pixels].
        fine: more antialiasing and sharper shadows, for stills.
        plain: without marks and overlay.
    """

    def __init__(
        self,
        out: Path,
        *,
        cameras: Sequence[str],
        size: tuple[int, int],
        fine: bool = False,
        plain: bool = False,
    ) -> None:
        self._out, self._cameras, self._size = out, tuple(cameras), size
        self._fine, self._plain = fine, plain
        self._scores = {int(score["cycle"]): score for score in read_lines(out)}
        self._tiles = tiles(len(self._cameras), size)
        self._overlay = Overlay(size, dict(zip(self._cameras, self._tiles, strict=True)))
        self._gl = mujoco.GLContext(*size)
        self._gl.make_current()
        self._option = visible()
        self._episode: int | None = None
        self._take: Take | None = None
        self._context: mujoco.MjrContext | None = None

    def __enter__(self) -> Self:
        """Return itself."""
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Give the graphics memory back."""
        if self._context is not None:
            self._context.free()
        self._gl.free()

    def picture(self, cycle: int, time: float) -> Picture:
        """Return a cycle at a time [s] since its start, (height, width, 3)."""
        take = self._turn_to(cycle)
        self.pose(take, time)
        width, height = self._size
        picture = np.empty((height, width, 3), dtype=np.uint8)
        assert self._context is not None
        for tile, look in zip(self._tiles, self._aims, strict=True):
            mujoco.mjv_updateScene(
                self._model, self._data, self._option, None, look(time),
                mujoco.mjtCatBit.mjCAT_ALL, self._scene,
            )  # fmt: skip
            fit(self._scene, tile[2] / tile[3])
            if not self._plain:
                self._marks.draw(self._scene, time)
            left, top, wide, high = tile
            rect = mujoco.MjrRect(left, height - top - high, wide, high)
            mujoco.mjr_render(rect, self._scene, self._context)
        mujoco.mjr_readPixels(picture, None, mujoco.MjrRect(0, 0, width, height), self._context)
        picture = np.ascontiguousarray(picture[::-1])
        if not self._plain:
            self._overlay.paint(picture, take, time)
        return picture

    def pose(self, take: Take, time: float) -> None:
        """Put the world into the recorded state at a time [s]."""
        self._data.qpos[:] = self._start
        values = take.at("qpos", time)
        if values is not None:
            place_joints(self._model, self._data.qpos, take.joints, values)
        mujoco.mj_forward(self._model, self._data)  # normalises the quaternions

    def _turn_to(self, cycle: int) -> Take:
        """Load a cycle, and the world of its episode, unless they are loaded."""
        if self._take is not None and self._take.cycle == cycle:
            return self._take
        score = self._scores[cycle]
        if score["episode"] != self._episode:
            self._load_world(int(score["episode"]))
        before = [line["success"] for number, line in self._scores.items() if number < cycle]
        self._take = take = read_take(
            self._out, score, cycles=len(self._scores), succeeded=sum(before)
        )
        model, data = self._model, self._data
        self._start = np.array(model.key(f"cycle_{cycle:04d}").qpos)
        hide_parked(model, self._groups, {name for name, _ in take.joints})
        data.qpos[:] = self._start
        mujoco.mj_forward(model, data)
        base = data.site("robot_base")
        T_world_base = np.eye(4)
        T_world_base[:3, :3], T_world_base[:3, 3] = base.xmat.reshape(3, 3), base.xpos
        self._aims: list[Aim] = [aim(name, model, take, T_world_base) for name in self._cameras]
        self._marks = Marks(take, T_world_base, height=min(tile[3] for tile in self._tiles))
        return take

    def _load_world(self, episode: int) -> None:
        path = world_path(self._out, episode)
        self._model = studio_model(path, self._size, fine=self._fine)
        self._data = mujoco.MjData(self._model)
        self._groups = np.array(self._model.geom_group)
        self._scene = mujoco.MjvScene(self._model, _MAX_GEOMS)
        if self._context is not None:
            self._context.free()
        self._context = mujoco.MjrContext(self._model, mujoco.mjtFontScale.mjFONTSCALE_100)
        mujoco.mjr_setBuffer(mujoco.mjtFramebuffer.mjFB_OFFSCREEN, self._context)
        self._episode = episode


def hide_parked(model: Any, groups: NDArray[np.int32], present: set[str]) -> None:
    """Hide the targets that are not in the world during a cycle.

    Args:
        model: of the episode.
        groups: (ngeom,) groups in which its geoms are seen.
        present: names of the joints that the cycle's record has.
    """
    model.geom_group[:] = groups
    for joint in range(model.njnt):
        free = model.jnt_type[joint] == mujoco.mjtJoint.mjJNT_FREE
        if free and model.joint(joint).name not in present:
            model.geom_group[model.geom_bodyid == model.jnt_bodyid[joint]] = _HIDDEN_GROUP


def fit(scene: mujoco.MjvScene, aspect: float) -> None:
    """Frame a picture for its place: widened if narrow, moved up as by a shift lens.

    Args:
        scene: whose camera is set.
        aspect: width over height of the picture.
    """
    widen = min(max(1.0, _ASPECT / aspect), _WIDEST)
    for camera in scene.camera:
        shift = _LIFT * (camera.frustum_top - camera.frustum_bottom)
        camera.frustum_top = widen * (camera.frustum_top - shift)
        camera.frustum_bottom = widen * (camera.frustum_bottom - shift)
