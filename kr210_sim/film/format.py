"""The form of a film: size, frames a second, speed, cameras; and which moments it shows."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from kr210_sim.exceptions import BadInput

FILM = "film.mp4"
"""Name of the film in the folder of its run."""

SIZE = "1280x720"
FPS, MAX_FPS = 30.0, 240.0  # [1/s]
MIN_SPEED, MAX_SPEED = 0.01, 100.0
MIN_SIDE, MAX_SIDE = 64, 4096  # [pixels]
VERDICT = 1.2
"""How long the verdict of a cycle stays on the screen [s]."""

GRIPPER = "gripper"
OVERVIEW = "overview"
FREE = "free"
BUILT_IN = (GRIPPER, FREE)
"""Cameras of every scene: following the gripper, and the whole scene as MuJoCo frames it."""

MAX_CAMERAS = 16

Moment = tuple[int, float]
"""A cycle of the run, and the time since its start [s]."""


@dataclass(frozen=True, kw_only=True)
class Format:
    """The form of a film.

    Attributes:
        cameras: names; none stands for the best one of the scene.
        size: width and height [pixels].
        fps: frames a second.
        speed: simulated over shown time.
    """

    cameras: tuple[str, ...] = ()
    size: tuple[int, int] = (1280, 720)
    fps: float = FPS
    speed: float = 1.0

    def moments(self, cycle: int, duration: float) -> list[Moment]:
        """Return the frames of a cycle of some duration [s]; the last ones show the verdict."""
        moving = math.floor(duration * self.fps / self.speed) + 1
        still = math.ceil(VERDICT * self.fps)
        times = [min(index * self.speed / self.fps, duration) for index in range(moving)]
        return [(cycle, time) for time in (*times, *[duration] * still)]


def make_format(
    *, cameras: Iterable[str], size: str = SIZE, fps: float = FPS, speed: float = 1.0
) -> Format:
    """Return the form that some options ask for.

    Raises:
        BadInput: if one of them is impossible.
    """
    if not (math.isfinite(fps) and 1 <= fps <= MAX_FPS):
        raise BadInput(f"--fps: {fps} is out of range; give 1 to {MAX_FPS:g} frames a second")
    if not MIN_SPEED <= speed <= MAX_SPEED:
        raise BadInput(f"--speed: {speed} is out of range; give {MIN_SPEED:g} to {MAX_SPEED:g}")
    return Format(cameras=tuple(cameras), size=_size(size), fps=fps, speed=speed)


def _size(text: str) -> tuple[int, int]:
    match = re.fullmatch(r"([0-9]{1,6})x([0-9]{1,6})", text)
    if match is None:
        raise BadInput(f"--size: '{text:.40}' is no size; give WIDTHxHEIGHT, e.g. {SIZE}")
    width, height = int(match[1]), int(match[2])
    for side in (width, height):
        if not MIN_SIDE <= side <= MAX_SIDE:
            raise BadInput(
                f"--size: {text} is out of range; give sides of {MIN_SIDE} to {MAX_SIDE}"
            )
        if side % 2:
            raise BadInput(f"--size: {text} has an odd side; films need even ones")
    return width, height


def check_cameras(chosen: Sequence[str], of_scene: Sequence[str], option: str) -> tuple[str, ...]:
    """Return the cameras to draw: those chosen, else the scene's overview, first or free one.

    Raises:
        BadInput: if there is no such camera, naming those there are.
    """
    known = [name for name in of_scene if name] + [n for n in BUILT_IN if n not in of_scene]
    if len(chosen) > MAX_CAMERAS:
        raise BadInput(f"{option}: {len(chosen)} cameras are too many; give at most {MAX_CAMERAS}")
    for name in chosen:
        if name not in known:
            raise BadInput(f"{option}: no camera '{name}'; there are {', '.join(known)}")
    return tuple(chosen) or ((OVERVIEW,) if OVERVIEW in known else (known[0],))
