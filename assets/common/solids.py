"""Solids for drawing machines.

SPDX-License-Identifier: MIT

A solid is a `manifold3d.Manifold`: union `+`, difference `-`, intersection `^`. Shapes are drawn
along one of the axes "x", "y", "z"; a flat outline lies in the plane of the two other axes, in
alphabetical order: (y, z), (x, z) or (x, y). Lengths in metres, angles in degrees.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from itertools import pairwise

import manifold3d
import numpy as np
from manifold3d import CrossSection, JoinType, Manifold, OpType

SIDES = 36
"""Sides of a circle, where nothing else is said."""

ARC = 26.0
"""Angle of one side of a rounded corner [deg], below the angle at which edges begin to show."""

SMALL = 0.0085
"""Rounded corners of a smaller radius become chamfers."""

SAGITTA = 8e-4
"""How far the sides of a free curve may stand off it."""

_ORDER = {"x": (1, 2, 0), "y": (0, 2, 1), "z": (0, 1, 2)}
"""Axis -> where the outline's two coordinates and the one along the axis go."""


# ---- flat outlines --------------------------------------------------------------------------


def circle(u: float, v: float, r: float, n: int = SIDES) -> CrossSection:
    """Return a disc of radius r about (u, v), with n sides."""
    return CrossSection.circle(r, n).translate((u, v))


def polygon(*corners: tuple[float, ...]) -> CrossSection:
    """Return the polygon with corners (u, v) or, rounded by an arc of radius r, (u, v, r)."""
    points: list[np.ndarray] = []
    for i, corner in enumerate(corners):
        here = np.array(corner[:2], dtype=float)
        radius = corner[2] if len(corner) > 2 else 0.0
        to = [np.array(corners[(i + j) % len(corners)][:2]) - here for j in (-1, 1)]
        a, b = (x / np.linalg.norm(x) for x in to)
        half = np.arccos(np.clip(a @ b, -1, 1)) / 2
        if radius == 0.0 or half > np.pi / 2 - 1e-6:
            points.append(here)
            continue
        centre = here + (a + b) / np.linalg.norm(a + b) * radius / np.sin(half)
        start, end = (here + x * radius / np.tan(half) - centre for x in (a, b))
        steps = 1 if radius < SMALL else max(1, round((np.pi - 2 * half) / np.radians(ARC)))
        for t in np.linspace(0, 1, steps + 1):
            chord = (1 - t) * start + t * end
            angle = np.pi - 2 * half
            arc = (np.sin((1 - t) * angle) * start + np.sin(t * angle) * end) / np.sin(angle)
            points.append(centre + (arc if np.sin(angle) > 1e-6 else chord))
    return CrossSection([np.array(points)], manifold3d.FillRule.NonZero)


def rectangle(u0: float, u1: float, v0: float, v1: float, r: float = 0.0) -> CrossSection:
    """Return a rectangle with corners rounded by r."""
    return polygon((u0, v0, r), (u1, v0, r), (u1, v1, r), (u0, v1, r))


def grown(flat: CrossSection, by: float, n: int = SIDES) -> CrossSection:
    """Return the outline moved outwards (by > 0) or inwards."""
    return flat.offset(by, JoinType.Round, 2.0, n).simplify(SAGITTA)


def blended(flat: CrossSection, inner: float = 0.0, outer: float = 0.0) -> CrossSection:
    """Round re-entrant corners with radius `inner` and salient ones with radius `outer`."""
    if inner:
        flat = grown(grown(flat, inner), -inner)
    if outer:
        flat = grown(grown(flat, -outer), outer)
    return flat


def strokes(lines: Iterable[Sequence[tuple[float, float]]], width: float) -> CrossSection:
    """Return polylines drawn with a round pen."""
    parts = [
        CrossSection.batch_hull([circle(*a, width / 2, 8), circle(*b, width / 2, 8)])
        for line in lines
        for a, b in pairwise(line)
    ]
    return CrossSection.batch_boolean(parts, OpType.Add).simplify(width / 30)


# ---- solids ---------------------------------------------------------------------------------


def placed(solid: Manifold, axis: str, at: Sequence[float] = (0.0, 0.0)) -> Manifold:
    """Turn a solid drawn along z into one along `axis` through `at` of the outline's plane."""
    matrix = np.zeros((3, 4))
    for column, row in enumerate(_ORDER[axis]):
        matrix[row, column] = 1.0
    matrix[list(_ORDER[axis][:2]), 3] = at
    return solid.transform(matrix)


def lathe(
    axis: str, *profile: tuple[float, ...], at: Sequence[float] = (0.0, 0.0), n: int = SIDES
) -> Manifold:
    """Turn a profile of (position along the axis, radius[, corner radius]) about `axis`."""
    ends = (0.0, profile[0][0]), (0.0, profile[-1][0])
    body = [(p[1], p[0], *p[2:]) for p in profile]
    return placed(polygon(ends[0], *body, ends[1]).simplify(1e-6).revolve(n), axis, at)


def disc(
    axis: str,
    s0: float,
    s1: float,
    r: float,
    *,
    at: Sequence[float] = (0.0, 0.0),
    edge: float | tuple[float, float] = 0.0,
    n: int = SIDES,
) -> Manifold:
    """Return a cylinder from s0 to s1; chamfer both edges by `edge`, or each by its own width."""
    low, high = edge if isinstance(edge, tuple) else (edge, edge)
    profile = [(s0, r - low), (s0 + low, r), (s1 - high, r), (s1, r - high)]
    return lathe(axis, *dict.fromkeys(profile), at=at, n=n)


def prism(
    axis: str,
    flat: CrossSection,
    s0: float,
    s1: float,
    fillet: float | tuple[float, float] = 0.0,
    steps: int = 3,
) -> Manifold:
    """Extrude an outline from s0 to s1; round the edges of both faces, or each by its own radius.

    The outline needs no salient corner sharper than the fillet. One step makes a chamfer.
    """
    low, high = fillet if isinstance(fillet, tuple) else (fillet, fillet)
    levels: list[tuple[float, float]] = []  # of (inset, position)
    turn = np.linspace(0, np.pi / 2, steps + 1)
    levels += [(low * (1 - np.sin(t)), s0 + low * (1 - np.cos(t))) for t in turn if low]
    levels += [] if low else [(0.0, s0)]
    levels += [(high * (1 - np.sin(t)), s1 - high * (1 - np.cos(t))) for t in turn[::-1] if high]
    levels += [] if high else [(0.0, s1)]
    return stepped(axis, flat, *levels)


def stepped(axis: str, flat: CrossSection, *levels: tuple[float, float]) -> Manifold:
    """Skin copies of an outline, each at (inset, position along the axis), in rising order."""
    return placed(_lofted([np.asarray(x) for x in flat.to_polygons()], levels), axis)


def _lofted(rings: list[np.ndarray], levels: Sequence[tuple[float, float]]) -> Manifold:
    """Skin rings (n, 2) at levels of (inset, height)."""
    count = sum(len(ring) for ring in rings)
    points = []
    for inset, height in levels:
        for ring in rings:
            edge = np.roll(ring, -1, axis=0) - ring
            out = np.column_stack([edge[:, 1], -edge[:, 0]])
            out /= np.linalg.norm(out, axis=1)[:, None]
            before = np.roll(out, 1, axis=0)
            mitre = (out + before) / (1 + np.sum(out * before, axis=1))[:, None]
            moved = ring - inset * mitre
            points.append(np.column_stack([moved, np.full(len(ring), height)]))
    cap = np.asarray(manifold3d.triangulate(rings))
    faces = [cap[:, ::-1], cap + (len(levels) - 1) * count]
    for level in range(len(levels) - 1):
        start = level * count
        for ring in rings:
            i = start + np.arange(len(ring))
            j = start + (np.arange(len(ring)) + 1) % len(ring)
            faces += [
                np.column_stack([i, j, j + count]),
                np.column_stack([i, j + count, i + count]),
            ]
            start += len(ring)
    return solid_of(np.concatenate(points), np.concatenate(faces))


def solid_of(vertices: np.ndarray, faces: np.ndarray) -> Manifold:
    """Return the solid enclosed by triangles."""
    mesh = manifold3d.Mesh64(vertices.astype(np.float64), faces.astype(np.uint64))
    solid = Manifold(mesh)
    if solid.status() != manifold3d.Error.NoError:
        raise ValueError(f"the triangles enclose no solid: {solid.status()}")
    return solid


def box(
    x: tuple[float, float],
    y: tuple[float, float],
    z: tuple[float, float],
    *,
    r: float = 0.0,
    fillet: float | tuple[float, float] = 0.0,
    axis: str = "z",
    steps: int = 2,
) -> Manifold:
    """Return a box: edges along `axis` rounded by r, those of its two end faces by `fillet`."""
    spans = {"x": (y, z, x), "y": (x, z, y), "z": (x, y, z)}[axis]
    if fillet and not r:
        r = max(fillet) if isinstance(fillet, tuple) else fillet
    return prism(axis, rectangle(*spans[0], *spans[1], r), *spans[2], fillet, steps)


def hull(*solids: Manifold) -> Manifold:
    """Return the convex hull of solids."""
    return Manifold.batch_hull(list(solids))


def union(*solids: Manifold) -> Manifold:
    """Return the union of solids."""
    return Manifold.batch_boolean(list(solids), OpType.Add)


def turned(
    solid: Manifold, axis: str, angle: float, at: Sequence[float] = (0.0, 0.0, 0.0)
) -> Manifold:
    """Turn a solid about an axis through the point `at`."""
    back = [-x for x in at]
    degrees = [angle if axis == name else 0.0 for name in "xyz"]
    return solid.translate(back).rotate(degrees).translate(list(at))


def around(
    solid: Manifold, axis: str, n: int, at: Sequence[float] = (0.0, 0.0), first: float = 0.0
) -> Manifold:
    """Repeat a solid n times about an axis through `at` of the plane across it."""
    point = np.zeros(3)
    point[list(_ORDER[axis][:2])] = at
    return union(*(turned(solid, axis, first + 360 * k / n, point) for k in range(n)))


def screws(
    axis: str,
    s0: float,
    s1: float,
    *,
    rc: float,
    n: int,
    r: float,
    at: Sequence[float] = (0.0, 0.0),
    first: float = 0.0,
) -> Manifold:
    """Return n hexagonal screw heads of radius r on a circle of radius rc."""
    head = prism(axis, circle(at[0] + rc, at[1], r, 6), s0, s1)
    return around(head, axis, n, at, first)


def hose(
    points: Sequence[tuple[float, float, float]], r: float, *, pitch: float = 0.0, n: int = 7
) -> Manifold:
    """Return a hose along a smooth curve through the points, corrugated if a pitch is given."""
    path = _smooth(np.array(points, dtype=float), pitch / 2 if pitch else 0.045)
    tangent = np.gradient(path, axis=0)
    tangent /= np.linalg.norm(tangent, axis=1)[:, None]
    side = np.cross(tangent[0], np.eye(3)[np.argmin(np.abs(tangent[0]))])
    angle = 2 * np.pi * np.arange(n) / n
    rings = []
    for i, (point, t) in enumerate(zip(path, tangent, strict=True)):
        side = side - (side @ t) * t
        side /= np.linalg.norm(side)
        radius = r * (0.86 if pitch and i % 2 else 1.0)
        ring = np.cos(angle)[:, None] * side + np.sin(angle)[:, None] * np.cross(t, side)
        rings.append(point + radius * ring)
    k = np.arange(n)
    fan = np.column_stack([np.zeros(n - 2), np.arange(1, n - 1), np.arange(2, n)]).astype(int)
    faces = [fan[:, ::-1], fan + (len(path) - 1) * n]
    for i in range(len(path) - 1):
        a, b = i * n + k, i * n + (k + 1) % n
        faces += [np.column_stack([a, b, b + n]), np.column_stack([a, b + n, a + n])]
    return solid_of(np.concatenate(rings), np.concatenate(faces))


def _smooth(points: np.ndarray, spacing: float) -> np.ndarray:
    """Return a Catmull-Rom curve through points (n, 3) with about equal spacing."""
    ends = 2 * points[0] - points[1], 2 * points[-1] - points[-2]
    p = np.concatenate([[ends[0]], points, [ends[1]]])
    curve = [points[:1]]
    t = np.linspace(0, 1, 41)[1:, None]
    for a, b, c, d in zip(p[:-3], p[1:-2], p[2:-1], p[3:], strict=True):
        curve.append(
            (
                2 * b
                + (c - a) * t
                + (2 * a - 5 * b + 4 * c - d) * t**2
                + (3 * b - a - 3 * c + d) * t**3
            )
            / 2
        )
    dense = np.concatenate(curve)
    length = np.concatenate([[0], np.cumsum(np.linalg.norm(np.diff(dense, axis=0), axis=1))])
    even = np.linspace(0, length[-1], max(3, round(length[-1] / spacing) + 1))
    return np.column_stack([np.interp(even, length, dense[:, i]) for i in range(3)])


def warped(solid: Manifold, move: Callable[[np.ndarray], np.ndarray]) -> Manifold:
    """Move all vertices (n, 3) of a solid."""
    return solid.warp_batch(lambda points: np.ascontiguousarray(move(np.array(points))))
