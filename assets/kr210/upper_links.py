"""Forearm, wrist and flange of the KR210.

SPDX-License-Identifier: MIT

Every solid is drawn in the frame of its link (see kr210.urdf.xacro). Lengths in metres, angles in
degrees.
"""

from __future__ import annotations

from manifold3d import CrossSection
from parts import Part, joined, lettering, servo
from solids import (
    around,
    blended,
    box,
    circle,
    disc,
    hose,
    hull,
    lathe,
    polygon,
    prism,
    rectangle,
    screws,
    union,
)  # fmt: skip

# Forearm (link_3)
TUBE_Z = -0.054  # axis of joint 4
TUBE_ROOT, TUBE_TIP = 0.163, 0.132  # radii
TUBE_X = (0.30, 0.90)  # where the taper begins, where the front flange does
WRIST_MOTORS = ((-0.082, 0.024), (0.082, 0.024), (0.0, -0.205))  # y, z of the motors 4, 5, 6
WRIST_PLUGS = (90.0, 90.0, 270.0)  # where their connectors point
WRIST_MOTOR_RADIUS = 0.07
LETTER_HEIGHT, LETTER_THICK = 0.088, 0.0015
HOSE_RADIUS, HOSE_Y = 0.023, 0.045

# Wrist (link_4, link_5, link_6)
WRIST_CENTER = 0.54  # x of joint 5 in link_4
FORK_Y = (0.124, 0.163)
FORK_RADIUS = 0.10
FORK_ROOT = 0.335  # x of the ground of its slot
HEAD_RADIUS, NOSE_RADIUS = 0.115, 0.095
FLANGE_RADIUS = 0.10
FLANGE_HOLES, FLANGE_HOLE_CIRCLE, FLANGE_HOLE_RADIUS = 11, 0.088, 0.006


def forearm() -> Part:
    """Return the forearm: elbow, flanged tube, rear end with the motors of the wrist."""
    elbow = lathe(
        "y", (-0.165, 0.12), (-0.165, 0.195, 0.018), (0.158, 0.195, 0.02), (0.172, 0.165, 0.004),
        (0.172, 0.1), n=48,
    )  # fmt: skip
    gear = lathe(
        "y", (0.165, 0.135), (0.182, 0.135, 0.004), (0.187, 0.10, 0.006), (0.198, 0.096),
        (0.198, 0.05),
    )  # fmt: skip
    black, grey = servo("y", 0.190, 0.283, 0.088, (0.0, 0.0), 0)
    own: Part = {
        "orange": [elbow],
        "grey": [gear, grey, disc("y", -0.178, -0.16, 0.17, edge=(0.004, 0))],
        "black": [black],
        "steel": [screws("y", 0.17, 0.181, rc=0.150, n=10, r=0.0075)],
    }
    return joined(own, rear_end(), tube(), cable_package())


def rear_end() -> Part:
    """Return the rear of the forearm with the motors of joints 4, 5 and 6."""
    r = WRIST_MOTOR_RADIUS
    face = blended(CrossSection.batch_hull([circle(*at, r + 0.012, 40) for at in WRIST_MOTORS]))
    section = CrossSection.batch_hull(
        [rectangle(-0.148, 0.148, -0.20, 0.11, 0.06), circle(0.0, -0.19, 0.075, 32)]
    )
    block = hull(
        prism("x", face, -0.20, -0.19, (0.008, 0), 2),
        prism("x", section, -0.12, 0.02),
        disc("x", 0.10, 0.17, TUBE_ROOT + 0.004, at=(0, TUBE_Z)),
    )
    motors = [
        servo("x", -0.219, -0.40, r, at, plug)
        for at, plug in zip(WRIST_MOTORS, WRIST_PLUGS, strict=True)
    ]
    return {
        "orange": [block],
        "grey": [prism("x", face, -0.222, -0.19, (0.008, 0.0), 2), *(grey for _, grey in motors)],
        "black": [black for black, _ in motors],
    }


def tube() -> Part:
    """Return the tapering tube with its bolted flange, and the type designation on it."""
    root, tip, at, (x0, x1) = TUBE_ROOT, TUBE_TIP, (0, TUBE_Z), TUBE_X
    casting = lathe(
        "x", (0.05, 0.15), (0.05, root + 0.004), (0.20, root + 0.004, 0.01), (0.222, 0.177, 0.01),
        (0.242, 0.177, 0.003), (0.245, 0.174), (0.248, 0.177, 0.003), (0.268, 0.177, 0.01),
        (x0, root, 0.03), (x1 - 0.045, tip, 0.04), (x1, 0.148, 0.01), (0.952, 0.148, 0.006),
        (0.956, 0.12), (0.956, 0.05), at=at, n=48,
    )  # fmt: skip
    skin = lathe(
        "x", (x0, 0.05), (x0, root + LETTER_THICK), (x1 - 0.045, tip + LETTER_THICK),
        (x1 - 0.045, 0.05), at=at,
    )  # fmt: skip
    text = lettering("KR 210", LETTER_HEIGHT)
    right = text.translate((0.385, TUBE_Z - LETTER_HEIGHT / 2))
    left = text.mirror((1, 0)).translate((0.785, TUBE_Z - LETTER_HEIGHT / 2))
    return {
        "orange": [casting],
        "black": [skin ^ prism("y", right, -0.25, -0.11), skin ^ prism("y", left, 0.11, 0.25)],
        "steel": [
            screws("x", *x, rc=0.1685, n=12, r=0.007, at=at)
            for x in ((0.216, 0.224), (0.266, 0.275))
        ],
    }


def cable_package() -> Part:
    """Return the hose along the top of the tube with its clamps."""
    y = HOSE_Y
    line = [
        (0.10, y, 0.10), (0.155, y, 0.135), (0.22, y, 0.147), (0.32, y, 0.140), (0.55, y, 0.126),
        (0.76, y, 0.116), (0.86, y, 0.118), (0.935, y, 0.085),
    ]  # fmt: skip
    clamps = [
        box(
            (x - 0.018, x + 0.018), (y - 0.034, y + 0.034), (z - 0.07, z + 0.031),
            r=0.01, axis="x", fillet=0.004, steps=1,
        )
        for x, z in ((0.36, 0.138), (0.72, 0.118))
    ]  # fmt: skip
    return {"black": [hose(line, HOSE_RADIUS, pitch=0.03)], "grey": clamps}


def fork() -> Part:
    """Return the wrist fork, which turns about the axis of joint 4."""
    neck = lathe("x", (0.045, 0.06), (0.045, 0.118, 0.004), (0.20, 0.118, 0.004), (0.20, 0.06))
    collar = lathe(
        "x",
        (0.005, 0.06),
        (0.005, 0.133, 0.004),
        (0.03, 0.133, 0.004),
        (0.034, 0.124, 0.004),
        (0.05, 0.122),
        (0.05, 0.06),
    )
    barrel = disc("x", 0.196, 0.30, 0.1195, edge=0.003)
    cheek = CrossSection.batch_hull(
        [circle(WRIST_CENTER, 0, FORK_RADIUS), rectangle(0.25, 0.40, -0.082, 0.082, 0.02)]
    )
    root = polygon(
        (0.18, -0.118),
        (0.18, 0.118),
        (0.25, 0.163, 0.03),
        (0.60, 0.163),
        (0.60, FORK_Y[0]),
        (FORK_ROOT, FORK_Y[0], 0.028),
        (FORK_ROOT, -FORK_Y[0], 0.028),
        (0.60, -FORK_Y[0]),
        (0.60, -0.163),
        (0.25, -0.163, 0.03),
    )
    body = prism("z", root, -0.10, 0.10) ^ prism(
        "y", CrossSection.batch_hull([cheek, rectangle(0.17, 0.3, -0.082, 0.082, 0.012)]), -0.2, 0.2
    )
    arms = [prism("y", cheek, *sorted((s * FORK_Y[0], s * FORK_Y[1])), 0.009, 3) for s in (-1, 1)]
    slot = box((0.26, 0.42), (-0.2, 0.2), (-0.045, 0.045), r=0.02, axis="y")
    recess = [slot ^ box((0, 1), sorted((s * 0.154, s * 0.2)), (-1, 1)) for s in (-1, 1)]
    body = (
        body ^ union(*arms, box((0.17, 0.45), (-0.1625, 0.1625), (-0.2, 0.2), r=0.02, axis="z"))
    ) - union(*recess)
    at = (WRIST_CENTER, 0)
    covers = [
        disc("y", *sorted((s * 0.160, s * 0.1665)), 0.078, at=at, edge=0.002, n=32) for s in (-1, 1)
    ]
    bolts = [
        screws("y", *sorted((s * 0.165, s * 0.1705)), rc=0.064, n=8, r=0.006, at=at)
        for s in (-1, 1)
    ]
    caps = [
        disc("y", *sorted((s * 0.160, s * 0.169)), 0.04, at=at, edge=0.002, n=24) for s in (-1, 1)
    ]
    return {
        "orange": [neck],
        "grey": [collar, barrel, body, *caps],
        "black": covers,
        "steel": [*bolts, screws("x", 0.028, 0.038, rc=0.127, n=12, r=0.0055)],
    }


def head() -> Part:
    """Return the wrist head between the arms of the fork."""
    drum = lathe(
        "y",
        (-0.116, 0.08),
        (-0.116, 0.098),
        (-0.100, HEAD_RADIUS, 0.01),
        (0.100, HEAD_RADIUS, 0.01),
        (0.116, 0.098),
        (0.116, 0.08),
    )
    throat = hull(disc("y", -0.075, 0.075, 0.10), disc("x", 0.09, 0.13, NOSE_RADIUS, edge=0.004))
    nose = lathe(
        "x",
        (0.0, NOSE_RADIUS),
        (0.152, NOSE_RADIUS, 0.006),
        (0.158, 0.088, 0.004),
        (0.174, 0.088, 0.004),
        (0.174, 0.04),
    )
    seal = disc("x", 0.17, 0.188, 0.080, edge=(0, 0.003))
    return {"grey": [drum, throat, nose], "black": [seal]}


def flange() -> Part:
    """Return the mounting flange with its ring of holes."""
    plate = lathe(
        "x",
        (0.016, 0.05),
        (0.016, FLANGE_RADIUS, 0.003),
        (0.033, FLANGE_RADIUS, 0.003),
        (0.034, 0.0795),
        (0.04, 0.0785),
        (0.04, 0.05),
        n=4 * FLANGE_HOLES,
    )
    holes = around(
        disc("x", 0.022, 0.05, FLANGE_HOLE_RADIUS, at=(FLANGE_HOLE_CIRCLE, 0), n=8),
        "x",
        FLANGE_HOLES,
        first=180 / FLANGE_HOLES,
    )
    return {"grey": [disc("x", 0.002, 0.02, 0.086, edge=(0.003, 0))], "steel": [plate - holes]}
