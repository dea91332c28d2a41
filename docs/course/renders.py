"""The pictures of the course that show the arm itself."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import lru_cache
from typing import Any

import make_pictures as pictures
import numpy as np
from PIL import Image, ImageDraw, ImageFont

import ik

SIZE = (960, 720)  # [pixels]
RED, GREEN, BLUE = (0.84, 0.15, 0.16), (0.17, 0.58, 0.22), (0.12, 0.40, 0.78)
AXIS_COLOUR = (0.0, 0.35, 0.75)

Arrow = tuple[Any, Any, Any, str]
"""From (3,), to (3,) [m], colour, label at its head."""


@lru_cache(maxsize=2)
def _model(*, floor: bool) -> tuple[Any, Any]:
    import mujoco

    spec, robot = pictures.bundled_robot()
    pictures.studio(spec)
    if floor:
        spec.worldbody.add_geom(
            type=mujoco.mjtGeom.mjGEOM_PLANE,
            size=[pictures.FLOOR, pictures.FLOOR, 0.1],
            rgba=[*pictures.WHITE, 1.0],
            group=pictures.VISUAL_GROUP,
        )
    return spec.compile(), robot


def shown(
    q: Any,
    view: tuple[float, float],
    look: Any,
    distance: float,
    arrows: Sequence[Arrow] = (),
    *,
    floor: bool = True,
    size: tuple[int, int] = SIZE,
    letters: float = 0.036,
) -> Image.Image:
    """Draw the arm at q (6,) with arrows, their labels at the heads in letters of a share of it."""
    import mujoco

    model, robot = _model(floor=floor)
    data = mujoco.MjData(model)
    for name, value in zip(robot.arm_joints, q, strict=True):
        data.joint(name).qpos = value
    seen: list[Any] = []
    image = pictures.picture(
        model, data, *view, look, distance, mark=lambda scene: seen.append(_camera(scene))
    )
    # lines are drawn large and reduced, which smoothes them
    large = image.resize((2 * SIZE[0], 2 * SIZE[1]), Image.Resampling.LANCZOS)
    pen = ImageDraw.Draw(large)
    font = ImageFont.load_default(size=letters * large.height)
    for start, end, colour, label in arrows:
        a, b = (np.array(large.size) * seen[0](p) for p in (start, end))
        _arrow(pen, a, b, tuple(int(255 * value) for value in colour), label, font)
    return large.resize(size, Image.Resampling.LANCZOS)


def _arrow(pen: Any, a: Any, b: Any, ink: Any, label: str, font: Any) -> None:
    """Draw an arrow between points of a picture, its label beyond the head; or a label alone."""
    length = np.linalg.norm(b - a)
    way = (b - a) / max(length, 1e-9)
    if length > 0.0:
        side = np.array([-way[1], way[0]])
        neck = b - 34 * way
        for width, colour in ((15, "white"), (8, ink)):
            pen.line([tuple(a), tuple(neck)], fill=colour, width=width)
        head = [tuple(b), tuple(neck + 17 * side), tuple(neck - 17 * side)]
        pen.polygon(head, fill=ink, outline="white")
    pen.text(
        tuple(b + 34 * way), label, fill=tuple(int(0.75 * value) for value in ink), font=font,
        anchor="mm", stroke_width=5, stroke_fill="white",
    )  # fmt: skip


def _camera(scene: Any) -> Callable[[Any], Any]:
    """Return where a camera sees points: (3,) [m] -> from the upper left, each 0 to 1 (2,)."""
    eyes = scene.camera
    middle = (np.array(eyes[0].pos) + np.array(eyes[1].pos)) / 2
    forward, up = np.array(eyes[0].forward), np.array(eyes[0].up)
    right = np.cross(forward, up)

    def see(p: Any) -> Any:
        way = np.array(p) - middle
        height = 2 * (way @ forward) * np.tan(np.radians(pictures.FOVY) / 2)
        width = height * SIZE[0] / SIZE[1]
        return np.array([0.5 + way @ right / width, 0.5 - way @ up / height])

    return see


def _axes(q: Any) -> tuple[Any, Any]:
    """Return a point on each joint axis and its direction, (6, 3) each, base frame."""
    import mujoco

    model, robot = _model(floor=True)
    data = mujoco.MjData(model)
    for name, value in zip(robot.arm_joints, q, strict=True):
        data.joint(name).qpos = value
    mujoco.mj_kinematics(model, data)
    ids = [model.joint(name).id for name in robot.arm_joints]
    return data.xanchor[ids], data.xaxis[ids]


def joints() -> Image.Image:
    """Draw the six axes of the arm at q = 0."""
    points, directions = _axes(np.zeros(6))
    arrows = []
    for i, (p, z) in enumerate(zip(points, directions, strict=True)):
        before = {0: 0.45, 1: 0.75, 2: 0.75, 4: 0.75}.get(i, 0.25)
        behind = {0: 0.55, 1: -0.3, 2: -0.3, 4: -0.25}.get(i, 0.25)
        start, end = p - before * z, p + behind * z
        label = start - 0.2 * z if z[1] > 0.5 else end + (0.12 * z if z[2] > 0.5 else (0, 0, 0.2))
        arrows += [
            (start, end, AXIS_COLOUR, ""),
            (label, label, AXIS_COLOUR, f"joint {i + 1}"),
        ]
    return shown(np.zeros(6), (118.0, -14.0), (0.85, 0.0, 1.15), 7.4, arrows)


def _triad(T: Any, length: float, names: Sequence[str] = "xyz") -> list[Arrow]:
    return [
        (T[:3, 3], T[:3, 3] + length * T[:3, i], colour, name)
        for i, (name, colour) in enumerate(zip(names, (RED, GREEN, BLUE), strict=True))
    ]


def gripper_frames() -> Image.Image:
    """Draw the axes of gripper_link and those of DH frame 7, side by side."""
    T = ik.forward(ik.KR210, np.zeros(6))
    correction = np.eye(4)
    correction[:3, :3] = [[0, 0, 1], [0, -1, 0], [1, 0, 0]]
    images = [
        shown(
            np.zeros(6), (140.0, -24.0), T[:3, 3] + (0.02, 0.0, 0.0), 1.7, _triad(frame, 0.24),
            floor=False,
        ).crop((120, 0, 840, 720))
        for frame in (T, T @ correction)
    ]  # fmt: skip
    both = Image.new("RGB", (1440, 720), "white")
    for i, (image, title) in enumerate(
        zip(images, ("gripper_link (URDF)", "frame 7 (DH)"), strict=True)
    ):
        both.paste(image, (720 * i, 0))
        pen = ImageDraw.Draw(both)
        font = ImageFont.load_default(size=36)
        pen.text((720 * i + 360, 40), title, fill=(30, 30, 35), font=font, anchor="mm")
    return both.crop((0, 0, 1440, 560)).resize((960, 373), Image.Resampling.LANCZOS)


def wrist_axes() -> Image.Image:
    """Draw axes 4, 5 and 6 of a bent wrist, which meet in the wrist center."""
    q = np.array([0.0, -0.1, 0.1, 0.5, 0.9, 0.4])
    points, directions = _axes(q)
    W = points[4]
    arrows = [
        (W - 0.35 * z, W + 0.5 * z, colour, f"axis {i + 4}")
        for i, (z, colour) in enumerate(zip(directions[3:], (RED, GREEN, BLUE), strict=True))
    ]
    image = shown(q, (128.0, -20.0), W, 3.3, arrows, floor=False)
    return image.crop((0, 80, SIZE[0], 578))  # without the shoulder, which is cut


def branches() -> Image.Image:
    """Draw the eight branches of one pose."""
    T = np.eye(4)
    T[:3, 3] = (1.35, 0.35, 1.9)
    found = ik.inverse(ik.KR210, T)
    small = (480, 360)
    _, robot = _model(floor=True)
    inside = ik.within_limits(found.q, robot.lower, robot.upper)
    sheet = Image.new("RGB", (2 * small[0], 4 * small[1]), "white")
    for i, (q, legal) in enumerate(zip(found.q, inside, strict=True)):
        name = f"{('front', 'back')[i // 4]}, elbow {('up', 'down')[i // 2 % 2]}, " + (
            "theta 5 > 0" if i % 2 == 0 else "theta 5 < 0"
        )
        image = shown(
            q, (128.0, -14.0), (0.35, 0.0, 1.25), 9.2, _triad(T, 0.45, ("", "", "")), size=small
        )
        pen = ImageDraw.Draw(image)
        font = ImageFont.load_default(size=22)
        ink = (30, 30, 35) if legal else (185, 58, 0)
        text = name if legal else f"{name}: beyond limits"
        pen.text((12, 24), text, fill=ink, font=font, anchor="lm")
        sheet.paste(image, (small[0] * (i % 2), small[1] * (i // 2)))
    return sheet.resize((840, 1260), Image.Resampling.LANCZOS)


def singularities() -> Image.Image:
    """Draw the three singularities."""
    phi = ik.KR210.constants.phi
    T = ik.forward(ik.KR210, [0.0, 0.0, 0.0, 0.0, 0.6, 0.0])
    T[:3, 3] += np.array([0.0, 0.0, 2.6]) - ik.wrist_center(ik.KR210, T)
    poses = {
        "shoulder: W on axis 1": ik.inverse(ik.KR210, T).q[0],
        "elbow: stretched": np.array([0.0, 0.6, -np.pi / 2 - phi, 0.0, 0.9, 0.0]),
        "wrist: axes 4 and 6 in line": np.array([0.0, 0.1, 0.2, 0.0, 0.0, 0.0]),
    }
    sheet = Image.new("RGB", (3 * 600, 640), "white")
    for i, (name, q) in enumerate(poses.items()):
        points, directions = _axes(q)
        W = points[4]
        if i == 0:
            arrows = [(W - (0.0, 0.0, 2.6), np.add(W, (0.0, 0.0, 0.3)), AXIS_COLOUR, "axis 1")]
        elif i == 1:
            arrows = [(points[1], W, AXIS_COLOUR, "")]
        else:
            arrows = [(W - 0.9 * directions[3], W + 0.6 * directions[3], AXIS_COLOUR, "4, 6")]
        image = shown(q, (104.0, -8.0), (0.9, 0.0, 1.65), 11.4, arrows, letters=0.055).crop(
            (180, 50, 780, 690)
        )
        pen = ImageDraw.Draw(image)
        font = ImageFont.load_default(size=40)
        pen.text((300, 30), name, fill=(30, 30, 35), font=font, anchor="mm")
        sheet.paste(image, (600 * i, 0))
    return sheet.resize((1080, 384), Image.Resampling.LANCZOS)


RENDERS: dict[str, Callable[[], Image.Image]] = {
    "joints.png": joints,
    "gripper_frames.png": gripper_frames,
    "wrist_axes.png": wrist_axes,
    "branches.png": branches,
    "singularities.png": singularities,
}
