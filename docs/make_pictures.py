"""Regenerate the pictures of README.md and docs/: `python docs/make_pictures.py`.

With names as arguments only those are drawn: `python docs/make_pictures.py robot_iso.png`.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from kr210_sim.film.format import Format
from kr210_sim.film.take import read_duration
from kr210_sim.results import record_path
from kr210_sim.video import draw_stills, find_gl

IMAGES = Path(__file__).resolve().parent / "images"
PICTURES = {"grasp.png": (5, "gripper", 0.24)}
"""File -> cell of the target, camera, and share of the cycle at which to look."""

ANIMATION = "cycle.webp"
ANIMATED_CELL, ANIMATED_SIZE, ANIMATED_FPS = 5, (800, 450), 12.5
ANIMATED_QUALITY = 50  # of WebP, 0 to 100: 300 kB

ROBOT_POSE = (0.0, -0.38, 0.30, 0.0, 0.55, 0.0)  # [rad]
ROBOT_VIEWS = {
    "robot_front.png": (180.0, -9.0, 7.6),
    "robot_side.png": (90.0, -6.0, 7.0),
    "robot_back.png": (0.0, -9.0, 8.2),
    "robot_iso.png": (128.0, -17.0, 7.0),
}
"""File -> azimuth and elevation of the line of sight [deg], distance [m]."""

ROBOT_MIDDLE = (0.62, 0.0, 1.12)  # [m], where the camera looks
FLOOR = 2.2  # [m], half its side

GRIPPER_PICTURE = "gripper.png"
GRIPPER_VIEW = (146.0, -36.0)
BEHIND_THE_GRIPPER = ("base_link", "link_1", "link_2")
TARGET_RADIUS, TARGET_HALF_LENGTH, TARGET_LOWERED = 0.05, 0.125, 0.06  # [m]
TARGET_RGBA = (0.13, 0.42, 0.85, 1.0)

SIZE = (1200, 900)  # [pixels]
OVERSAMPLED = 2  # drawn that much larger, then reduced
FOVY = 22.0  # [deg]: a long lens, little perspective
VISUAL_GROUP, HIDDEN_GROUP = 2, 5
WHITE = (1.0, 1.0, 1.0)


def main(chosen: list[str]) -> None:
    """Draw the chosen pictures, or all."""
    if "MUJOCO_GL" not in os.environ:  # MuJoCo reads it when first imported
        environment = os.environ | {"MUJOCO_GL": find_gl()}
        sys.exit(subprocess.call([sys.executable, __file__, *chosen], env=environment))
    if not chosen or ANIMATION in chosen:
        draw_animation(IMAGES / ANIMATION)
    for name in [*PICTURES, *ROBOT_VIEWS, GRIPPER_PICTURE]:
        if chosen and name not in chosen:
            continue
        if name in PICTURES:
            drawn = draw_cycle(*PICTURES[name])
        elif name in ROBOT_VIEWS:
            drawn = draw_robot(*ROBOT_VIEWS[name])
        else:
            drawn = draw_gripper(*GRIPPER_VIEW)
        drawn.save(IMAGES / name, optimize=True)


@contextmanager
def one_cycle(cell: int) -> Iterator[tuple[Path, float]]:
    """Run one cycle; its run's folder, there within the context, and its duration [s]."""
    from kr210_sim.cli import main as kr210_sim

    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "run"
        kr210_sim(["run", "--cycles", "1", "--cell", str(cell), "--out", str(out)])
        yield out, read_duration(record_path(out, 0))


def draw_cycle(cell: int, camera: str, share: float) -> Image.Image:
    """Run one cycle and draw it from its record."""
    with one_cycle(cell) as (out, duration):
        (frame,) = draw_stills(out, [(0, share * duration)], cameras=[camera])
    return Image.fromarray(frame)


def draw_animation(path: Path) -> None:
    """Run one cycle and draw all of it, its verdict too, as a picture that moves."""
    form = Format(size=ANIMATED_SIZE, fps=ANIMATED_FPS)
    with one_cycle(ANIMATED_CELL) as (out, duration):
        frames = draw_stills(out, form.moments(0, duration), size=form.size)
    first, *others = map(Image.fromarray, frames)
    first.save(
        path, save_all=True, append_images=others, duration=round(1000 / form.fps), loop=0,
        quality=ANIMATED_QUALITY, method=6,
    )  # fmt: skip


def draw_robot(azimuth: float, elevation: float, distance: float) -> Image.Image:
    """Draw the robot alone on a white floor."""
    import mujoco

    spec, robot = bundled_robot()
    studio(spec)
    spec.worldbody.add_geom(
        type=mujoco.mjtGeom.mjGEOM_PLANE,
        size=[FLOOR, FLOOR, 0.1],
        rgba=[*WHITE, 1.0],
        group=VISUAL_GROUP,
    )
    model = spec.compile()
    data = mujoco.MjData(model)
    for name, value in zip(robot.arm_joints, ROBOT_POSE, strict=True):
        data.joint(name).qpos = value
    return picture(model, data, azimuth, elevation, ROBOT_MIDDLE, distance)


def draw_gripper(azimuth: float, elevation: float) -> Image.Image:
    """Draw the gripper closed on a target."""
    import mujoco

    spec, robot = bundled_robot()
    studio(spec)
    spec.body("tcp").add_geom(
        type=mujoco.mjtGeom.mjGEOM_CYLINDER,
        size=[TARGET_RADIUS, TARGET_HALF_LENGTH, 0],
        pos=[0, 0, -TARGET_LOWERED],
        rgba=TARGET_RGBA,
        group=VISUAL_GROUP,
    )
    for name in BEHIND_THE_GRIPPER:
        for geom in spec.body(name).geoms:
            geom.group = HIDDEN_GROUP
    model = spec.compile()
    data = mujoco.MjData(model)
    apex = 0.0725 - 0.005  # [m], see assets/gripper/README.md
    for name in (robot.finger_joint, robot.mimic_joint):
        data.joint(name).qpos = apex - TARGET_RADIUS / np.cos(np.radians(15.0))
    mujoco.mj_kinematics(model, data)
    look = data.body("tcp").xpos - (0.08, 0.0, 0.035)
    return picture(model, data, azimuth, elevation, look, 1.42)


def bundled_robot() -> tuple[Any, Any]:
    """Return the MJCF of the bundled robot, and what it is."""
    from kr210_sim.description import load_description
    from kr210_sim.mjcf import robot_spec
    from kr210_sim.resources import resource
    from kr210_sim.robot import find_robot

    description = load_description(resource("assets", "kr210", "kr210.urdf.xacro"))
    robot = find_robot(description)
    return robot_spec(description, robot), robot


def studio(spec: Any) -> None:
    """Add a white surrounding, a soft key light of several lamps, and a fill light."""
    import mujoco

    width, height = (OVERSAMPLED * value for value in SIZE)
    spec.visual.global_.offwidth, spec.visual.global_.offheight = width, height
    spec.visual.global_.fovy = FOVY
    spec.visual.quality.shadowsize, spec.visual.quality.offsamples = 8192, 4
    spec.visual.headlight.ambient = [0.34] * 3
    spec.visual.headlight.diffuse = [0.18] * 3
    spec.visual.headlight.specular = [0.05] * 3
    spec.add_texture(
        name="studio", type=mujoco.mjtTexture.mjTEXTURE_SKYBOX,
        builtin=mujoco.mjtBuiltin.mjBUILTIN_FLAT, rgb1=WHITE, rgb2=WHITE, width=64, height=64,
    )  # fmt: skip
    lamps = [(-0.36, 0.45), (-0.35, 0.46), (-0.37, 0.46), (-0.36, 0.47)]
    for x, y in lamps:
        _lamp(spec, (x, y, -1.0), 0.62 / len(lamps), shadow=True)
    _lamp(spec, (-0.8, -0.6, -0.35), 0.28, shadow=False)
    _lamp(spec, (0.9, 0.2, -0.5), 0.18, shadow=False)


def _lamp(spec: Any, direction: tuple[float, float, float], bright: float, *, shadow: bool) -> None:
    import mujoco

    spec.worldbody.add_light(
        type=mujoco.mjtLightType.mjLIGHT_DIRECTIONAL,
        pos=-4.0 * np.array(direction),
        dir=direction,
        diffuse=[bright] * 3,
        specular=[bright / 2] * 3,
        castshadow=shadow,
    )


def picture(
    model: Any,
    data: Any,
    azimuth: float,
    elevation: float,
    look: Any,
    distance: float,
    *,
    mark: Callable[[Any], None] = lambda scene: None,
) -> Image.Image:
    """Draw a model in its configuration.

    Args:
        model: in a studio.
        data: its configuration.
        azimuth: of the line of sight [deg].
        elevation: of the line of sight [deg].
        look: where the camera looks (3,) [m].
        distance: from there [m].
        mark: adds to the scene before it is drawn.
    """
    import mujoco

    mujoco.mj_forward(model, data)
    camera = mujoco.MjvCamera()
    camera.azimuth, camera.elevation, camera.distance = azimuth, elevation, distance
    camera.lookat[:] = look
    option = mujoco.MjvOption()
    option.geomgroup[:] = [group == VISUAL_GROUP for group in range(6)]
    width, height = (OVERSAMPLED * value for value in SIZE)
    with mujoco.Renderer(model, height, width) as renderer:
        renderer.update_scene(data, camera, option)
        mark(renderer.scene)
        frame = renderer.render()
    return Image.fromarray(frame).resize(SIZE, Image.Resampling.LANCZOS)


if __name__ == "__main__":
    main(sys.argv[1:])
