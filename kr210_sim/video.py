"""Film of a run, drawn off screen from its saved records in a process of its own."""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

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


def draw(out: Path, film: Path) -> int:
    """Draw all cycles of a run into one .mp4; returns the number of frames."""
    import imageio_ffmpeg

    writer = imageio_ffmpeg.write_frames(
        str(film), SIZE, fps=FPS, codec="libx264", quality=7, macro_block_size=2
    )
    writer.send(None)
    frames = 0
    try:
        for cycle in sorted((out / "cycles").glob("*.npz")):
            for frame in _frames(out, cycle):
                writer.send(np.ascontiguousarray(frame))
                frames += 1
    finally:
        writer.close()
    return frames


def _frames(out: Path, cycle: Path) -> Any:
    """Yield the pictures (height, width, 3) uint8 of one recorded cycle."""
    import mujoco

    from kr210_sim.playback import load_world, place_joints
    from kr210_sim.record import load_series

    series = load_series(cycle)
    if "qpos" not in series:  # it failed before anything moved
        return
    model = load_world(out, int(cycle.stem))
    # Software OpenGL pays dearly for antialiasing; at this size its absence is hardly seen.
    model.vis.quality.shadowsize, model.vis.quality.offsamples = 1024, 0
    data = mujoco.MjData(model)
    names = list(zip(series["joint_names"].tolist(), series["joint_widths"].tolist(), strict=True))
    option = mujoco.MjvOption()
    option.geomgroup[:] = [group in _VISIBLE_GROUPS for group in range(6)]
    start = np.array(model.key(f"cycle_{int(cycle.stem):04d}").qpos)
    with mujoco.Renderer(model, SIZE[1], SIZE[0]) as renderer:
        for values in _sampled(series["time"], series["qpos"]):
            data.qpos[:] = start
            place_joints(model, data.qpos, names, values)
            mujoco.mj_forward(model, data)
            renderer.update_scene(data, CAMERA if _has_camera(model) else -1, option)
            yield renderer.render()


def _has_camera(model: Any) -> bool:
    return any(model.camera(index).name == CAMERA for index in range(model.ncam))


def _sampled(time: NDArray[Any], qpos: NDArray[Any]) -> NDArray[Any]:
    """Interpolate recorded rows (n, nq) to the frame times; MuJoCo normalises quaternions."""
    frames = np.arange(time[0], time[-1], 1.0 / FPS)
    right = np.clip(np.searchsorted(time, frames), 1, len(time) - 1)
    weight = ((frames - time[right - 1]) / (time[right] - time[right - 1]))[:, None]
    return np.asarray((1 - weight) * qpos[right - 1] + weight * qpos[right])


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description="Film a finished run.")
    parser.add_argument("run", type=Path)
    parser.add_argument("film", type=Path)
    arguments = parser.parse_args()
    draw(arguments.run, arguments.film)
