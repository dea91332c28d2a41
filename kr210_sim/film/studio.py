"""The saved world in the light of a studio: lamps, floor, background and finish, nothing else."""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np

SHADOW_MAP = 2048  # [pixels], twice that for a still
SAMPLES = 4
"""Antialiasing samples of a pixel: without, edges of boards crawl while nothing moves."""

HORIZON = (0.88, 0.895, 0.91)
ZENITH = (0.60, 0.66, 0.73)
FLOOR, FLOOR_LINES = (0.70, 0.71, 0.73), (0.655, 0.668, 0.69)
"""The floor fades into the horizon: a seamless backdrop."""

KEY, KEY_COLOR = (0.50, 0.42, -1.0), (0.72, 0.70, 0.67)
KEY_AWAY, KEY_CUTOFF, KEY_EXPONENT = 2.6, 50.0, 3.0
"""Direction and color of the lamp that casts shadows, its distance in extents of the world, and
its cone [deg], fading out; a parallel light would cover the floor with stripes."""

SHADOW_CONE = 24.0  # [deg], half of it: what is outside casts no shadow
NEAR = 0.004
"""Nearest distance drawn, in extents of the world. MuJoCo's shadow bias grows as it shrinks: with
0.01 dots of shadow speckle what faces the key lamp."""

FILLS = (((0.5, -0.9, -0.55), (0.17, 0.18, 0.21)), ((-0.9, 0.2, -0.5), (0.12, 0.12, 0.13)))
"""Direction and color of the lamps from the left and from behind."""

_VISIBLE_GROUPS = (0, 1, 2)  # visual geometry; collision shapes (3) and sites (4) stay hidden


def studio_model(scene: Path, size: tuple[int, int], *, fine: bool = False) -> mujoco.MjModel:
    """Load a saved world and light it; bodies, joints and shapes stay as they are.

    Args:
        scene: the `scene.xml` of an episode.
        size: largest width and height that will be drawn [pixels].
        fine: sharper shadows, for stills.
    """
    spec = mujoco.MjSpec.from_file(str(scene))
    spec.visual.global_.offwidth, spec.visual.global_.offheight = size
    spec.visual.quality.shadowsize = SHADOW_MAP * (2 if fine else 1)
    spec.visual.quality.offsamples = SAMPLES * (2 if fine else 1)
    _backdrop(spec)
    _lamps(spec)
    for material in spec.materials:
        if material.name != "studio/floor":
            material.specular, material.shininess = 0.45, 0.55
    return spec.compile()


def visible() -> mujoco.MjvOption:
    """Return what of a world is shown: what it looks like, not what it collides with."""
    option = mujoco.MjvOption()
    option.geomgroup[:] = [group in _VISIBLE_GROUPS for group in range(6)]
    return option


def _backdrop(spec: mujoco.MjSpec) -> None:
    """Give endless planes a plain floor, and put the sky behind it."""
    for texture in list(spec.textures):
        if texture.type == mujoco.mjtTexture.mjTEXTURE_SKYBOX:
            spec.delete(texture)
    spec.add_texture(
        name="studio/sky", type=mujoco.mjtTexture.mjTEXTURE_SKYBOX,
        builtin=mujoco.mjtBuiltin.mjBUILTIN_GRADIENT, rgb1=HORIZON, rgb2=ZENITH,
        width=128, height=768,
    )  # fmt: skip
    spec.add_texture(
        name="studio/floor", type=mujoco.mjtTexture.mjTEXTURE_2D,
        builtin=mujoco.mjtBuiltin.mjBUILTIN_FLAT, rgb1=FLOOR, rgb2=FLOOR,
        mark=mujoco.mjtMark.mjMARK_EDGE, markrgb=FLOOR_LINES, width=512, height=512,
    )  # fmt: skip
    floor = spec.add_material(name="studio/floor", texuniform=True, texrepeat=[1, 1])
    floor.textures[mujoco.mjtTextureRole.mjTEXROLE_RGB] = "studio/floor"
    floor.specular, floor.shininess = 0.0, 0.0
    for geom in spec.geoms:
        if geom.type == mujoco.mjtGeom.mjGEOM_PLANE:
            geom.material = "studio/floor"
            geom.rgba = [1.0, 1.0, 1.0, 1.0]
    spec.visual.rgba.haze = [*HORIZON, 1.0]
    spec.visual.map.haze = 0.55


def _lamps(spec: mujoco.MjSpec) -> None:
    """Replace the lamps of the world by a key that casts shadows, a fill and a rim light."""
    for lamp in list(spec.lights):
        spec.delete(lamp)
    headlight = spec.visual.headlight
    headlight.active = 1
    headlight.ambient, headlight.diffuse = [0.30, 0.305, 0.32], [0.16, 0.16, 0.16]
    headlight.specular = [0.04, 0.04, 0.04]
    spec.visual.map.znear = NEAR
    spec.visual.map.shadowscale = SHADOW_CONE / KEY_CUTOFF
    away = KEY_AWAY * float(spec.stat.extent) / np.linalg.norm(KEY)
    spec.worldbody.add_light(
        type=mujoco.mjtLightType.mjLIGHT_SPOT,
        pos=np.array(spec.stat.center) - away * np.array(KEY),
        dir=KEY, cutoff=KEY_CUTOFF, exponent=KEY_EXPONENT,
        diffuse=KEY_COLOR, specular=np.array(KEY_COLOR) / 2, castshadow=True,
    )  # fmt: skip
    for direction, color in FILLS:
        spec.worldbody.add_light(
            type=mujoco.mjtLightType.mjLIGHT_DIRECTIONAL,
            pos=-np.array(direction), dir=direction,
            diffuse=color, specular=np.array(color) / 2, castshadow=False,
        )  # fmt: skip
