"""Film of a run, drawn off screen from its saved records in a process of its own."""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from kr210_sim.arrays import Array
from kr210_sim.exceptions import BadInput

BACKENDS = ("egl", "osmesa")
"""Off-screen OpenGL, in the order they are tried."""

INSTALL_LINE = (
    "no off-screen OpenGL here; install EGL (Debian: apt-get install libegl1 libgl1-mesa-dri) or "
    "OSMesa (apt-get install libosmesa6)"
)

CAMERA = "overview"
SIZE = (1280, 720)  # [pixels], width and height
FPS = 25.0  # [1/s]
STILL = 1.0
"""A cycle in which nothing moved is shown for this long [s]."""

_VISIBLE_GROUPS = (0, 1, 2)  # visual geometry; collision shapes (3) and sites (4) stay hidden
_PROBE_SECONDS = 60.0


def find_gl() -> str:
    """Return the first backend that can make an off-screen context.

    Raises:
        BadInput: if none can, with what to install.
    """
    program = "import mujoco; mujoco.GLContext(64, 64).make_current()"
    for backend in BACKENDS:
        try:
            probe = subprocess.run(
                [sys.executable, "-c", program],
                env=os.environ | {"MUJOCO_GL": backend},
                capture_output=True,
                timeout=_PROBE_SECONDS,
                check=False,
            )
        except subprocess.TimeoutExpired:
            continue
        if probe.returncode == 0:
            return backend
    raise BadInput(f"--video: {INSTALL_LINE}")


def film_run(out: Path, film: Path, *, backend: str) -> None:
    """Film a finished run.

    MuJoCo chooses its OpenGL when it is first imported, so the drawing happens in a new process.

    Args:
        out: folder of the run.
        film: the .mp4 to write.
        backend: from `find_gl`.

    Raises:
        OSError: if the film could not be written.
    """
    drawn = subprocess.run(
        [sys.executable, "-m", "kr210_sim.video", str(out), str(film)],
        env=os.environ | {"MUJOCO_GL": backend},
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
        check=False,
    )
    if drawn.returncode != 0:
        last = drawn.stderr.strip().splitlines()[-1:] or ["no message"]
        raise OSError(f"the film could not be drawn: {last[0]}")


def draw_film(out: Path, film: Path) -> None:
    """Draw all cycles of a run into one .mp4; needs `MUJOCO_GL` to be set."""
    import imageio_ffmpeg

    film.open("wb").close()  # says better than ffmpeg what is wrong with the path
    writer = imageio_ffmpeg.write_frames(str(film), SIZE, fps=FPS, codec="libx264", quality=7)
    writer.send(None)
    try:
        for cycle in sorted(int(path.stem) for path in (out / "cycles").glob("*.npz")):
            player = Player(out, cycle)
            for frame in player.frames(CAMERA, np.arange(0.0, player.duration, 1.0 / FPS)):
                writer.send(np.ascontiguousarray(frame))
    finally:
        writer.close()


class Player:
    """The record of one cycle as a sequence of pictures; needs `MUJOCO_GL` to be set.

    Args:
        out: folder of the run.
        cycle: index in the run.
        fine: antialiased with sharp shadows, at several times the cost in software OpenGL.
    """

    def __init__(self, out: Path, cycle: int, *, fine: bool = False) -> None:
        from kr210_sim.playback import load_world
        from kr210_sim.record import load_series

        self._series: dict[str, Any] = load_series(out / "cycles" / f"{cycle:04d}.npz")
        self._model = load_world(out, cycle)
        quality = self._model.vis.quality
        quality.shadowsize, quality.offsamples = (8192, 8) if fine else (2048, 0)
        self._start = np.array(self._model.key(f"cycle_{cycle:04d}").qpos)
        self._time = self._series.get("time", np.array([STILL]))  # absent if nothing moved

    @property
    def duration(self) -> float:
        """Length of the record [s]."""
        return float(self._time[-1])

    def frames(self, camera: str, times: Array) -> Iterator[Array]:
        """Yield the pictures (height, width, 3) uint8 at times (n,) [s]."""
        import mujoco

        from kr210_sim.playback import place_joints

        model, data = self._model, mujoco.MjData(self._model)
        option = mujoco.MjvOption()
        option.geomgroup[:] = [group in _VISIBLE_GROUPS for group in range(6)]
        known = any(model.camera(index).name == camera for index in range(model.ncam))
        names, widths = self._series["joint_names"], self._series["joint_widths"]
        joints = list(zip(names.tolist(), widths.tolist(), strict=True))
        with mujoco.Renderer(model, SIZE[1], SIZE[0]) as renderer:
            for values in self._interpolated(times):
                data.qpos[:] = self._start
                if len(values):
                    place_joints(model, data.qpos, joints, values)
                mujoco.mj_forward(model, data)
                renderer.update_scene(data, camera if known else -1, option)
                yield renderer.render()

    def _interpolated(self, times: Array) -> Array:
        """Return the recorded joints at times (n,); MuJoCo normalises the quaternions."""
        time, qpos = self._time, self._series.get("qpos")
        if qpos is None:
            return np.empty((len(times), 0))
        right = np.clip(np.searchsorted(time, times), 1, len(time) - 1)
        weight = np.clip((times - time[right - 1]) / (time[right] - time[right - 1]), 0, 1)[:, None]
        return np.asarray((1 - weight) * qpos[right - 1] + weight * qpos[right])


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description="Film a finished run.")
    parser.add_argument("run", type=Path)
    parser.add_argument("film", type=Path)
    arguments = parser.parse_args()
    draw_film(arguments.run, arguments.film)
