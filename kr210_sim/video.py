"""Films and stills of a run, drawn off screen from its saved records."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import closing, contextmanager, suppress
from itertools import groupby
from pathlib import Path
from tempfile import TemporaryFile
from typing import IO

import numpy as np
from numpy.typing import NDArray

from kr210_sim.exceptions import BadInput
from kr210_sim.film.drawing import draw
from kr210_sim.film.format import Format, Moment, check_cameras
from kr210_sim.film.take import read_duration
from kr210_sim.film.worker import Job
from kr210_sim.results import finished_cycles, read_lines, record_path, world_path

BACKENDS = ("egl", "osmesa")
"""Off-screen OpenGL, in the order they are tried."""

INSTALL_LINE = (
    "no off-screen OpenGL here; install EGL (Debian: apt-get install libegl1 libgl1-mesa-dri) or "
    "OSMesa (apt-get install libosmesa6)"
)
STILL_SIZE = (1280, 720)  # [pixels], width and height

_PROBE_SECONDS = 60.0
_PART = ".part.mp4"


def find_gl(asked: str = "--video") -> str:
    """Return the first backend that can make an off-screen context.

    Args:
        asked: the option or verb that needs it, for the message.

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
    raise BadInput(f"{asked}: {INSTALL_LINE}")


def scene_cameras(scene: Path) -> tuple[str, ...]:
    """Return the names of the cameras of a scene or a saved world.

    Raises:
        BadInput: if MuJoCo cannot read it.
    """
    import mujoco

    try:
        return tuple(camera.name for camera in mujoco.MjSpec.from_file(str(scene)).cameras)
    except (ValueError, mujoco.FatalError) as error:
        raise BadInput(f"{scene}: MuJoCo cannot read it: {' '.join(str(error).split())}") from error


def check_target(film: Path, option: str, *, in_run: bool = False) -> None:
    """Refuse a place where no film can be written, before anybody waits for it.

    Args:
        film: the file to write.
        option: that names it.
        in_run: whether it lies in the folder of the run, which is made if need be.

    Raises:
        BadInput: if it is none.
    """
    name = film.name
    if not in_run and (
        film.suffix != ".mp4" or not os.path.isdir(film.parent) or len(name.encode()) > 200
    ):
        raise BadInput(f"{option}: {_short(film)} must be a .mp4 in a folder that exists")
    if os.path.lexists(film):
        raise BadInput(f"{option}: {film} exists; delete it, or name another")


def _short(path: Path) -> str:
    text = str(path)
    return text if len(text) <= 120 else f"{text[:50]}...{text[-50:]}"


def moments_of(out: Path, form: Format, cycle: int | None = None) -> list[Moment]:
    """Return what a film of a run shows, frame by frame.

    Args:
        out: folder of the run.
        form: of the film.
        cycle: the only one to show; by default all whose record was kept.

    Raises:
        BadInput: if there is nothing to show.
    """
    cycles = [int(score["cycle"]) for score in finished_cycles(out, cycle)]
    kept = [number for number in cycles if record_path(out, number).exists()]
    chosen = kept if cycle is None else [number for number in kept if number == cycle]
    if not chosen:
        what = "any cycle" if cycle is None else f"cycle {cycle}"
        raise BadInput(f"{out} has no record of {what}; run it again with --record all")
    return [
        moment
        for number in chosen
        for moment in form.moments(number, read_duration(record_path(out, number)))
    ]


def film_run(
    out: Path,
    film: Path,
    form: Format,
    *,
    backend: str,
    moments: Sequence[Moment] | None = None,
    on_frame: Callable[[int, int], None] = lambda _index, _total: None,
) -> None:
    """Film a finished run.

    Args:
        out: folder of the run.
        film: the .mp4 to write; it appears when it is complete.
        form: size, speed and cameras.
        backend: from `find_gl`.
        moments: what to show; by default all cycles whose record was kept.
        on_frame: told the index of every frame that is written, and how many there are.

    Raises:
        BadInput: if there is nothing to show, or no such camera.
        OSError: if the film could not be written.
    """
    moments = moments_of(out, form) if moments is None else moments
    distinct = [moment for moment, _ in groupby(moments)]
    cameras = check_cameras(form.cameras, run_cameras(out), "--camera")
    job = Job(out=str(out), cameras=cameras, size=form.size, moments=distinct)
    part = film.with_name(film.stem + _PART)
    try:
        part.open("wb").close()  # says better than the encoder what is wrong with the path
        with _encoder(part, form) as stream, closing(draw(job, backend=backend)) as pictures:
            for done, moment in enumerate(moments):
                if done == 0 or moment != moments[done - 1]:  # what stands still is drawn once
                    picture = next(pictures).data.cast("B")
                stream.write(picture)
                on_frame(done, len(moments))
        part.replace(film)
    finally:
        part.unlink(missing_ok=True)


def draw_stills(
    out: Path,
    moments: Sequence[Moment],
    *,
    cameras: Sequence[str] = (),
    size: tuple[int, int] = STILL_SIZE,
    backend: str | None = None,
) -> list[NDArray[np.uint8]]:
    """Draw single pictures of a run, finer than those of a film.

    Args:
        out: folder of the run.
        moments: cycle and time since its start [s] of each.
        cameras: names; several share the picture, none stands for the best one of the scene.
        size: width and height [pixels].
        backend: from `find_gl`, which is asked by default.

    Returns:
        Pictures (height, width, 3).

    Raises:
        BadInput: if there is no OpenGL or no such camera.
        OSError: if a picture could not be drawn.
    """
    names = check_cameras(cameras, run_cameras(out), "cameras")
    job = Job(out=str(out), cameras=names, size=size, moments=list(moments), fine=True)
    return list(draw(job, backend=backend or find_gl("a picture"), processes=1))


def run_cameras(out: Path) -> tuple[str, ...]:
    """Return the cameras of the worlds of a run."""
    episode = next(read_lines(out))["episode"]
    return scene_cameras(world_path(out, episode))


@contextmanager
def _encoder(film: Path, form: Format) -> Iterator[IO[bytes]]:
    """Give a stream that takes raw pictures; the film is complete after the context."""
    import imageio_ffmpeg

    command = [
        imageio_ffmpeg.get_ffmpeg_exe(), "-y", "-loglevel", "error",
        "-f", "rawvideo", "-pix_fmt", "rgb24", "-s", "{}x{}".format(*form.size),
        "-framerate", f"{form.fps:g}", "-i", "-",
        "-c:v", "libx264", "-preset", "veryfast", "-crf", "20", "-pix_fmt", "yuv420p",
        "-movflags", "+faststart", "-f", "mp4", str(film),
    ]  # fmt: skip
    with TemporaryFile() as errors:
        process = subprocess.Popen(
            command, stdin=subprocess.PIPE, stderr=errors, start_new_session=True
        )
        assert process.stdin is not None
        try:
            with suppress(BrokenPipeError):
                yield process.stdin
                process.stdin.close()
            if process.wait() != 0:
                errors.seek(0)
                lines = errors.read().decode(errors="replace").strip().splitlines()
                raise OSError(f"{film}: the film could not be encoded: {' '.join(lines[-1:])}")
        finally:
            process.kill()
            process.wait()
            with suppress(BrokenPipeError):
                process.stdin.close()
