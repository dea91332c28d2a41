"""What many machines have: servo motors, lettering.

SPDX-License-Identifier: MIT
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from manifold3d import CrossSection, Manifold, OpType
from solids import box, disc, placed, prism, rectangle, stepped, strokes, turned, union

Part = dict[str, list[Manifold]]
"""Solids by material."""


def joined(*parts: Part) -> Part:
    """Return all solids of several parts."""
    materials = dict.fromkeys(name for part in parts for name in part)
    return {name: [x for part in parts for x in part.get(name, [])] for name in materials}


def servo(
    axis: str, s0: float, s1: float, r: float, at: Sequence[float], plug: float
) -> tuple[Manifold, Manifold]:
    """Return a servo motor from s0 (its flange) to s1: what is black and what is grey on it.

    Args:
        axis: direction of the shaft.
        s0: position of the flange face.
        s1: position of the far end.
        r: radius of the circle around it.
        at: where the shaft passes, in the plane across it.
        plug: direction in which the connectors point.
    """
    length, flip = abs(s1 - s0), 1.0 if s1 > s0 else -1.0

    def put(solid: Manifold) -> Manifold:
        return placed(solid.scale((1, 1, flip)).translate((0, 0, s0)), axis, at)

    side = 0.84 * r
    flange = prism("z", rectangle(-side, side, -side, side, 0.25 * r), 0, 0.018, (0, 0.004), 1)
    levels = [(0.0, 0.012)]
    for z in (0.27, 0.42, 0.57):
        levels += [(0.0, z * length - 0.005), (0.007, z * length), (0.0, z * length + 0.005)]
    levels += [(0.0, 0.76 * length), (0.008, 0.78 * length)]
    body = stepped("z", rectangle(-side, side, -side, side, 0.5 * r), *levels)
    encoder = disc("z", 0.7 * length, length, 0.80 * r, edge=(0, 0.008), n=16)
    cover = disc("z", length - 0.003, length + 0.002, 0.55 * r, n=18)
    plugs = [
        turned(disc("x", 0, 0.92 * r, 0.017, at=(w, 0.84 * length), n=10), "z", plug)
        for w in (-0.023, 0.023)
    ]
    seat = box(
        (0, 0.85 * r), (-0.045, 0.045), (0.84 * length - 0.02, 0.84 * length + 0.02), r=0.005
    )
    return put(union(body, encoder, *plugs)), put(union(flange, cover, turned(seat, "z", plug)))


def lettering(text: str, height: float) -> CrossSection:
    """Return block letters, the first one's lower left corner at (0, 0)."""
    bow = [
        (0.28 + 0.28 * np.sin(np.radians(t)), 0.72 + 0.28 * np.cos(np.radians(t)))
        for t in range(-80, 121, 40)
    ]
    ring = [
        (0.28 + 0.26 * np.sin(np.radians(t)), 0.5 + 0.5 * np.cos(np.radians(t)))
        for t in range(0, 361, 36)
    ]
    half = [
        (0.28 + 0.26 * np.sin(np.radians(t)), 0.74 + 0.26 * np.cos(np.radians(t)))
        for t in range(0, 181, 45)
    ]
    glyphs = {
        "K": [[(0, 0), (0, 1)], [(0.54, 1), (0, 0.38)], [(0.2, 0.62), (0.58, 0)]],
        "R": [[(0, 0), (0, 1), *half, (0, 0.48)], [(0.28, 0.48), (0.56, 0)]],
        "2": [[*bow, (0.0, 0.0), (0.56, 0.0)]],
        "1": [[(0.1, 0.82), (0.3, 1), (0.3, 0)]],
        "0": [ring],
    }
    flats, u = [], 0.0
    for letter in text:
        if letter != " ":
            lines = [[(x + u, y) for x, y in line] for line in glyphs[letter]]
            flats.append(strokes(lines, 0.17))
            u += 0.3 if letter == "1" else 0.45
        u += 0.4
    return CrossSection.batch_boolean(flats, OpType.Add).scale((height, height))
