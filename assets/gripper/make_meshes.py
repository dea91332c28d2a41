"""Draw the meshes of the gripper: `python assets/gripper/make_meshes.py` writes meshes/*.obj.

SPDX-License-Identifier: MIT

The palm is drawn in gripper_link, the finger as the right one; the left one is the same mesh turned
by 180 deg about x, since a finger is symmetric in z. Lengths in metres, angles in degrees; names
and figures of the jaw are those of two_finger.urdf.xacro. Needs manifold3d.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
from manifold3d import Manifold

HERE = Path(__file__).resolve().parent
sys.dont_write_bytecode = True  # the folders are package data
sys.path[:0] = [str(HERE.parent / "common")]

from mesh_files import write_meshes  # noqa: E402 - found in the folder just added
from parts import Part  # noqa: E402
from solids import box, disc, lathe, polygon, prism, rectangle, turned  # noqa: E402

# Palm
PALM_BACK, PALM_FRONT = -0.0695, 0.078  # x
PALM_HALF_Y, PALM_HALF_Z = 0.100, 0.050
RAIL_Z = (0.026, 0.048)

# V-jaw
JAW_ALPHA = 15.0
JAW_APEX = 0.005  # y of the apex
JAW_X = 0.05
JAW_R_MIN, JAW_R_MAX = 0.040, 0.058
JAW_LAP = 0.0085
PAD_THICK, PAD_HEIGHT = 0.006, 0.050
PAD_GROOVES, GROOVE_WIDTH, GROOVE_DEPTH = 7, 0.0016, 0.0012

# Finger body
FINGER_X0, FINGER_X1, FINGER_ROOT_X1 = -0.065, 0.0745, -0.015
FINGER_Y0, FINGER_Y1, FINGER_ROOT_Y1 = -0.0215, -0.0035, 0.0035
FINGER_HALF_Z = 0.025


def palm() -> Part:
    """Return the palm: adapter plate, body, cover, guide rails and spindle."""
    y, z = PALM_HALF_Y, PALM_HALF_Z
    adapter = prism("x", rectangle(-0.070, 0.070, -z, z, 0.03), PALM_BACK, -0.054, 0.002, 1)
    body = prism("x", rectangle(-y, y, -z, z, 0.02), -0.056, 0.046, (0.008, 0.002), 2)
    for side in (-1, 1):
        body -= box(
            (-0.035, 0.028),
            sorted((side * (y - 0.004), side * (y + 1))),
            (-0.022, 0.022),
            r=0.008,
            axis="y",
        )
        body -= box(
            (-0.036, 0.030), (-0.062, 0.062), sorted((side * (z - 0.003), side * (z + 1))), r=0.006
        )
    covers = [
        box(
            (-0.034, 0.028),
            (-0.060, 0.060),
            sorted((s * (z - 0.006), s * (z - 0.0005))),
            r=0.005,
            fillet=0.001,
            steps=1,
        )
        for s in (-1, 1)
    ]
    screws = [
        disc("z", *sorted((s * (z - 0.002), s * (z + 0.0015))), 0.0035, at=(x, v), n=10)
        for s in (-1, 1) for x in (-0.027, 0.021) for v in (-0.053, 0.053)
    ]  # fmt: skip
    ports = [
        disc("y", *sorted((s * (y - 0.006), s * (y + 0.002))), 0.007, at=(-0.018 + d, 0), n=6)
        for s in (-1, 1)
        for d in (0.0, 0.028)
    ]
    face = prism("x", rectangle(-0.099, 0.099, -0.046, 0.046, 0.012), 0.044, 0.052, (0, 0.001), 1)
    rails = [rail(side) for side in (-1, 1)]
    rail_screws = [
        disc("x", PALM_FRONT - 0.002, PALM_FRONT + 0.0012, 0.0042, at=(v, s * 0.038), n=10)
        for s in (-1, 1) for v in np.linspace(-0.084, 0.084, 5)
    ]  # fmt: skip
    spindle = [(-0.098 + 0.007 * k, 0.009 if k % 2 else 0.0076) for k in range(29)]
    thread = lathe("y", *spindle, at=(0.066, 0), n=10)
    return {
        "grey": [body, *rails],
        "steel": [adapter, face, thread, *screws, *ports],
        "black": [*covers, *rail_screws],
    }


def rail(side: float) -> Manifold:
    """Return the guide rail above (side 1) or below (-1) the spindle, with a lip that holds."""
    low, high = side * RAIL_Z[0], side * RAIL_Z[1]
    lip = low + side * 0.004
    section = polygon(
        (0.050, high), (PALM_FRONT, high, 0.004), (PALM_FRONT, low, 0.002), (0.070, low, 0.001),
        (0.066, lip, 0.001), (0.050, lip),
    )  # fmt: skip
    return prism("y", section, -PALM_HALF_Y, PALM_HALF_Y, 0.0008, 1)


def pads() -> list[Manifold]:
    """Return the two pads of the V, grooved across the direction in which a target would slip."""
    tilt = np.radians(JAW_ALPHA)
    s0, s1 = (r * np.tan(tilt) + lap for r, lap in ((JAW_R_MIN, -JAW_LAP), (JAW_R_MAX, JAW_LAP)))
    s, half = (s0 + s1) / 2, (s1 - s0) / 2
    y = JAW_APEX + s * np.sin(tilt) - PAD_THICK / 2 * np.cos(tilt)
    found = []
    for side in (-1, 1):
        x = JAW_X + side * (s * np.cos(tilt) + PAD_THICK / 2 * np.sin(tilt))
        pad = box(
            (x - half, x + half),
            (y - PAD_THICK / 2, y + PAD_THICK / 2),
            (-PAD_HEIGHT / 2, PAD_HEIGHT / 2),
        )
        for z in (np.arange(PAD_GROOVES) + 0.5) / PAD_GROOVES * PAD_HEIGHT - PAD_HEIGHT / 2:
            top = y + PAD_THICK / 2
            pad -= box(
                (x - 1, x + 1),
                (top - GROOVE_DEPTH, top + 1),
                (z - GROOVE_WIDTH / 2, z + GROOVE_WIDTH / 2),
            )
        found.append(turned(pad, "z", side * JAW_ALPHA, (x, y, 0)))
    return found


def finger() -> Part:
    """Return the right finger: carriage, body with a recess outside, jaw block and pads."""
    y0, y1, root = FINGER_Y0, FINGER_Y1, FINGER_ROOT_Y1
    outline = polygon(
        (FINGER_X0, y0, 0.003), (-0.004, y0, 0.02), (0.012, y0 + 0.003, 0.02),
        (FINGER_X1, y0 + 0.003, 0.006), (FINGER_X1, y1, 0.002), (FINGER_ROOT_X1 + 0.004, y1, 0.006),
        (FINGER_ROOT_X1 - 0.003, root, 0.003), (FINGER_X0, root, 0.003),
    )  # fmt: skip
    body = prism("z", outline, -FINGER_HALF_Z, FINGER_HALF_Z, 0.0015, 1)
    body -= box((-0.004, 0.022), (y0 - 1, y0 + 0.0075), (-0.014, 0.014), r=0.006, axis="y")
    body -= box((0.030, 0.068), (y0 - 1, y0 + 0.0045), (-0.018, 0.018), r=0.006, axis="y")
    block = box(
        (JAW_X - 0.0245, JAW_X + 0.0243),
        (y1 - 0.001, JAW_APEX - 0.0015),
        (-0.024, 0.024),
        r=0.002,
        axis="y",
    )
    carriage = box(
        (-0.0755, -0.040),
        (y0 + 0.001, root + 0.0045),
        (-0.021, 0.021),
        r=0.003,
        axis="x",
        fillet=0.001,
        steps=1,
    )
    bolts = [
        disc("y", y0 - 0.0012, y0 + 0.004, 0.005, at=(x, z), n=12)
        for x in (-0.054, -0.026)
        for z in (-0.015, 0.015)
    ]
    bolts += [
        disc("y", y0 + 0.003, y0 + 0.0065, 0.0042, at=(x, z), n=12)
        for x in (0.038, 0.060)
        for z in (-0.011, 0.011)
    ]
    return {"steel": [body], "grey": [block, carriage, *bolts], "pad": pads()}


def main(folder: Path = HERE / "meshes") -> None:
    """Write all meshes of the gripper."""
    write_meshes(folder, {"palm": palm(), "finger": finger()})


if __name__ == "__main__":
    main()
