"""Base, carousel and lower arm of the KR210.

SPDX-License-Identifier: MIT

Every solid is drawn in the frame of its link (see kr210.urdf.xacro). Lengths in metres, angles in
degrees.
"""

from __future__ import annotations

import numpy as np
from manifold3d import CrossSection, Manifold
from parts import Part, joined, servo
from solids import (
    around,
    blended,
    box,
    circle,
    disc,
    grown,
    hose,
    lathe,
    polygon,
    prism,
    rectangle,
    screws,
    strokes,
    union,
    warped,
)  # fmt: skip

# Base
FOOT_LONG, FOOT_SHORT, FOOT_THICK = 0.50, 0.34, 0.055  # half sizes of the cross-shaped foot plate
COLUMN_FOOT, COLUMN_WAIST, COLUMN_RING = 0.425, 0.385, 0.425  # radii, from below
COLUMN_TOP = 0.322
FOUNDATION_BOLTS = ((0.45, 0.28), (0.28, 0.45))  # in every quarter
BOLT_RADIUS = 0.024

# Carousel (link_1)
SHOULDER = (0.35, 0.42)  # x, z of joint 2
SHOULDER_RADIUS = 0.222
HOUSING_Y = (-0.165, 0.255)
DRAFT_FROM = 0.10  # x behind which the housing narrows
DRAFT = 0.42  # by this share of its width a metre
TURNTABLE_RADIUS = 0.42
BALANCER = (-0.055, 0.415)  # y, z of the counterbalance's axis
BALANCER_RADIUS = 0.09
MOTOR_1 = (-0.21, 0.13)  # x, y of its axis
CABLE = (  # the lower of two
    (-0.30, -0.128, 0.19), (-0.2, -0.150, 0.262), (-0.06, -0.152, 0.30), (0.08, -0.155, 0.315),
    (0.20, -0.140, 0.32),
)  # fmt: skip

# Lower arm (link_2)
UPPER_ARM_LENGTH = 1.25  # joint 2 to joint 3, along z
HUB_2, HUB_3 = 0.218, 0.19  # radii of the hubs
ARM_Y = (-0.385, -0.205)
POCKET_FLOOR = -0.338

HOSE_RADIUS = 0.021


def base() -> Part:
    """Return the base: foot plate, ribbed column, bearing ring, connection panel."""
    cross = rectangle(-FOOT_LONG, FOOT_LONG, -FOOT_SHORT, FOOT_SHORT, 0.06)
    cross += rectangle(-FOOT_SHORT, FOOT_SHORT, -FOOT_LONG, FOOT_LONG, 0.06)
    foot = prism("z", blended(cross + circle(0, 0, 0.46), inner=0.05), 0, FOOT_THICK, (0, 0.008), 1)
    column = lathe(
        "z", (0, 0.46), (0.05, 0.46, 0.01), (0.075, COLUMN_FOOT, 0.02), (0.19, COLUMN_WAIST, 0.03),
        (0.235, COLUMN_WAIST, 0.02), (0.26, COLUMN_RING, 0.008), (0.30, COLUMN_RING, 0.006),
        (0.30, 0.36), n=48,
    )  # fmt: skip
    rib = prism(
        "y",
        polygon((0.35, 0.04), (0.475, 0.04), (0.475, 0.075, 0.01), (0.42, 0.235), (0.35, 0.235)),
        -0.016,
        0.016,
        0.005,
        2,
    )
    bosses, bolts = [], []
    for x, y in FOUNDATION_BOLTS:
        for sx in (-1, 1):
            for sy in (-1, 1):
                at = sx * x, sy * y
                bosses.append(disc("z", 0.05, 0.062, 0.042, at=at, edge=(0, 0.003), n=12))
                bolts.append(disc("z", 0.06, 0.066, BOLT_RADIUS * 1.35, at=at, n=14))
                bolts.append(disc("z", 0.06, 0.088, BOLT_RADIUS, at=at, edge=(0, 0.003), n=6))
    stop = box((0.36, 0.434), (-0.035, 0.035), (0.215, 0.30), r=0.01, axis="x", fillet=(0, 0.008))
    ring = lathe("z", (0.295, 0.40), (COLUMN_TOP, 0.40, 0.004), (COLUMN_TOP, 0.30))
    own: Part = {
        "grey": [foot, column, around(rib, "z", 8, first=22.5), *bosses, stop],
        "steel": [*bolts, ring, screws("z", 0.298, 0.309, rc=0.412, n=16, r=0.007)],
    }
    return joined(own, connection_panel())


def connection_panel() -> Part:
    """Return the box at the back of the base where the cables arrive."""
    panel = box(
        (-0.66, -0.30),
        (-0.22, 0.22),
        (0.012, 0.228),
        r=0.03,
        fillet=(0.0, 0.018),
        axis="z",
        steps=3,
    )
    panel -= box((-0.70, -0.645), (-0.185, 0.185), (0.04, 0.20), r=0.015, axis="x")
    feet = [box((-0.64, -0.36), (y - 0.03, y + 0.03), (0, 0.03), r=0.008) for y in (-0.17, 0.17)]
    plate = box((-0.665, -0.64), (-0.185, 0.185), (0.04, 0.20), r=0.015, axis="x")
    sockets = [
        box(
            (-0.688, -0.66),
            (y - 0.052, y + 0.052),
            (0.12, 0.18),
            r=0.008,
            axis="x",
            fillet=(0.004, 0),
        )
        for y in (-0.105, 0.02)
    ]
    ports = [
        disc("x", -0.686, -0.66, 0.021, at=(y, 0.075), edge=(0.004, 0), n=14)
        for y in (-0.13, -0.06, 0.01, 0.08)
    ]
    label = box((-0.668, -0.66), (0.095, 0.165), (0.12, 0.175), r=0.004, axis="x")
    return {"grey": [panel, *feet], "black": [plate, *sockets], "steel": [*ports, label]}


def carousel() -> Part:
    """Return the carousel: turntable, housing with the shoulder, motors 1 and 2, counterbalance."""
    turntable = lathe(
        "z", (0.004, 0.36), (0.004, TURNTABLE_RADIUS, 0.004), (0.05, TURNTABLE_RADIUS, 0.006),
        (0.058, 0.408, 0.004), (0.12, 0.408, 0.008), (0.125, 0.40), (0.155, 0.385, 0.015),
        (0.188, 0.345, 0.01), (0.197, 0.30), n=48,
    )  # fmt: skip
    own: Part = {
        "orange": [turntable, housing()],
        "steel": [screws("z", 0.118, 0.132, rc=0.3925, n=18, r=0.0085)],
        "black": [hose([(x, y, z + d) for x, y, z in CABLE], 0.014) for d in (0.0, 0.034)],
    }
    return joined(own, shoulder(), motor_1(), counterbalance(), junction_box())


def housing() -> Manifold:
    """Return the casting between turntable and shoulder."""
    x, z = SHOULDER
    front = CrossSection.batch_hull(
        [
            circle(x, z, SHOULDER_RADIUS - 0.001),
            polygon((-0.12, 0.12), (0.23, 0.12), (-0.05, 0.40), (0.0, 0.43)),
        ]
    )
    rear = polygon((-0.37, 0.12), (-0.37, 0.30), (-0.30, 0.385), (0.10, 0.40), (0.20, 0.12))
    flank = blended(front + rear, inner=0.10, outer=0.045)
    casting = prism("y", flank, *HOUSING_Y, 0.03, 3)
    pocket = grown(flank, -0.042) - circle(x, z, 0.262, 36)
    for rib in ((-1, 1, 0, 0.205), (-1, 1, 0.40, 1), (-0.115, -0.085, 0, 1)):
        pocket -= rectangle(*rib)
    pocket = blended(pocket, outer=0.02)
    low, high = HOUSING_Y
    for y in ((low - 0.01, low + 0.022), (high - 0.022, high + 0.01)):
        casting -= prism("y", pocket, *y)
    middle = (low + high) / 2

    def drafted(p: np.ndarray) -> np.ndarray:
        """Narrow the casting towards its rear end."""
        p[:, 1] = middle + (p[:, 1] - middle) * (1 + DRAFT * (p[:, 0] - DRAFT_FROM))
        return p

    back, front_end = casting.split_by_plane((-1, 0, 0), -DRAFT_FROM)
    casting = union(warped(back, drafted), front_end)
    return casting - disc("x", -0.60, 0.10, BALANCER_RADIUS + 0.006, at=BALANCER, n=36)


def shoulder() -> Part:
    """Return the drum of joint 2 with its gear and motor."""
    r, at = SHOULDER_RADIUS, SHOULDER
    drum = lathe(
        "y", (-0.165, 0.15), (-0.165, r, 0.018), (0.262, r, 0.02), (0.275, 0.19, 0.004),
        (0.275, 0.1), at=at, n=48,
    )  # fmt: skip
    seal = disc("y", -0.178, -0.160, 0.20, at=at, edge=(0.004, 0))
    gear = lathe(
        "y", (0.27, 0.168), (0.295, 0.168, 0.006), (0.297, 0.125, 0.008), (0.318, 0.118, 0.004),
        (0.318, 0.05), at=at,
    )  # fmt: skip
    black, grey = servo("y", 0.317, 0.453, 0.104, at, 90)
    rings = [
        screws("y", 0.272, 0.284, rc=0.186, n=12, r=0.0085, at=at),
        screws("y", 0.29, 0.303, rc=0.147, n=8, r=0.008, at=at),
    ]
    return {"orange": [drum], "grey": [seal, gear, grey], "black": [black], "steel": rings}


def motor_1() -> Part:
    """Return the upright motor of joint 1 on its seat."""
    black, grey = servo("z", 0.392, 0.525, 0.092, MOTOR_1, 180)
    return {
        "orange": [disc("z", 0.30, 0.394, 0.112, at=MOTOR_1, edge=(0, 0.006), n=36)],
        "black": [black],
        "grey": [grey],
        "steel": [screws("z", 0.39, 0.403, rc=0.1, n=6, r=0.006, at=MOTOR_1, first=22.5)],
    }


def counterbalance() -> Part:
    """Return the gas cylinder that lies behind the shoulder."""
    r, at = BALANCER_RADIUS, BALANCER
    cylinder = lathe(
        "x", (-0.50, 0.03), (-0.50, 0.062, 0.006), (-0.478, r, 0.02), (0.08, r), at=at, n=36
    )
    pin = lathe(
        "x", (-0.53, 0.015), (-0.53, 0.034, 0.006), (-0.49, 0.034), (-0.49, 0.02), at=at, n=20
    )
    collars = [
        disc("x", x - 0.016, x + 0.016, r + 0.008, at=at, n=36) for x in (-0.44, -0.235, 0.0)
    ]
    return {"grey": [cylinder], "steel": [pin], "black": collars}


def junction_box() -> Part:
    """Return the box of the carousel's cables."""
    case = box(
        (-0.396, -0.33), (0.015, 0.225), (0.205, 0.325), r=0.014, axis="x", fillet=(0.006, 0)
    )
    plugs = [
        disc("x", -0.409, -0.38, 0.019, at=(y, 0.265), edge=(0.003, 0), n=12)
        for y in (0.055, 0.12, 0.185)
    ]
    return {"grey": [case], "black": plugs}


def lower_arm() -> Part:
    """Return the lower arm: a waisted casting with pockets, hubs with covers, hoses."""
    top = UPPER_ARM_LENGTH
    beam = polygon(
        (-0.186, 0.05), (0.186, 0.05), (0.146, 0.62), (0.158, 1.20), (-0.158, 1.20), (-0.146, 0.62)
    )
    flank = blended(
        circle(0, 0, HUB_2) + circle(0, top, HUB_3) + blended(beam, outer=0.03), inner=0.30
    )
    casting = prism("y", flank, *ARM_Y, 0.028, 3)
    window = (
        grown(flank, -0.042) - circle(0, 0, HUB_2 + 0.012, 36) - circle(0, top, HUB_3 + 0.012, 36)
    )
    outer = blended(window - rectangle(-1, 1, 0.665, 0.689), outer=0.025)
    casting -= prism("y", outer, ARM_Y[0] - 0.05, POCKET_FLOOR, (0, 0.010), 2)
    braces = strokes(
        [[(-0.16, 0.24), (0.14, 0.66), (-0.16, 1.05)], [(0.16, 0.24), (-0.14, 0.66), (0.16, 1.05)]],
        0.026,
    )
    inner = blended(window - braces, outer=0.014)
    casting -= prism("y", inner, -0.248, ARM_Y[1] + 0.05, (0.008, 0), 2)
    covers = (hub_cover(0.0, 0.165, -0.395), hub_cover(top, 0.14, -0.391))
    return joined({"orange": [casting]}, *covers, hoses())


def hub_cover(z: float, r: float, y: float) -> Part:
    """Return the cover of the hub at height z: radius r, outer face at y."""
    at = (0.0, z)
    return {
        "orange": [
            lathe("y", (y, r - 0.02), (y, r, 0.004), (-0.37, r + 0.012), (-0.37, 0.05), at=at)
        ],
        "grey": [
            disc("y", y - 0.010, -0.37, r - 0.028, at=at, edge=(0.004, 0)),
            disc("y", -0.22, -0.19, r + 0.033, at=at, edge=(0, 0.004)),
        ],
        "steel": [
            screws("y", y - 0.015, y, rc=r - 0.052, n=8, r=0.0095, at=at, first=22.5),
            screws("y", -0.393, -0.38, rc=r + 0.027, n=12, r=0.008, at=at, first=15),
            disc("y", y - 0.013, y, 0.03, at=at, edge=(0.003, 0), n=16),
        ],
    }


def hoses() -> Part:
    """Return the hoses in the pocket of the lower arm, and what holds them."""
    lines = []
    for x, sag in ((-0.030, 0.010), (0.030, -0.006)):
        line = [
            (x, -0.325, 0.165), (x + sag / 2, -0.352, 0.25), (x + sag, -0.358, 0.45),
            (x, -0.360, 0.677), (x + sag, -0.358, 0.88), (x, -0.352, 1.02), (x, -0.325, 1.10),
        ]  # fmt: skip
        lines.append(hose(line, HOSE_RADIUS, pitch=0.03))
    clamps = [
        box((-0.066, 0.066), (-0.387, -0.33), (z - 0.02, z + 0.02), r=0.012, fillet=0.004, steps=1)
        for z in (0.39, 0.677, 0.955)
    ]
    return {"black": lines, "grey": clamps}
