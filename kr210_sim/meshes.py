"""Mesh files -> triangles in metres, and convex pieces for contact."""

from __future__ import annotations

import io
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components
from scipy.spatial import ConvexHull, QhullError

from kr210_sim.arrays import Array
from kr210_sim.dae import read_dae
from kr210_sim.exceptions import BadInput
from kr210_sim.safe_xml import check_xml

FORMATS = (".stl", ".obj", ".dae")

MAX_MESH_BYTES = 40_000_000
"""Largest mesh file that is read; the visual meshes of public arms have some megabytes each."""

CONCAVITY = 0.01
"""A body counts as convex if no corner or middle of a triangle lies deeper inside its hull than
this share of its diagonal, and, if it is closed, it fills the hull to HULL_FILLED."""

HULL_FILLED = 0.95

MAX_PIECES = 32
"""A mesh of more separate bodies than this is split as a whole."""

MAX_SPLIT_FACES = 100_000
"""A concave body of more triangles is not split: it would take minutes."""

SHEET = 0.001
"""Thickness that a flat collision mesh is given [m]."""

_SAMPLED_POINTS = 4000
_REMESH_ABOVE = 4000  # [faces]: the search time of coacd grows with them

# A coarse search: seconds a mesh instead of minutes, at a few pieces more.
_COACD: dict[str, Any] = {
    "threshold": 0.05,
    "max_convex_hull": 24,
    "preprocess_resolution": 20,
    "resolution": 500,
    "mcts_iterations": 20,
    "mcts_max_depth": 2,
    "mcts_nodes": 10,
    "seed": 0,
}


@dataclass(frozen=True, kw_only=True)
class MeshPart:
    """Triangles of one material, in the frame of the URDF geometry.

    Attributes:
        vertices: (n, 3) [m], the file's unit, up axis and scene graph and the URDF's scale applied.
        faces: (m, 3) indices of vertices, counter-clockwise seen from outside.
        normals: (n, 3) unit vectors if the file gives them.
        rgba: colour (4,) if the file gives one.
    """

    vertices: Array
    faces: Array
    normals: Array | None = None
    rgba: tuple[float, ...] | None = None


def load_mesh(path: Path, scale: Any, *, where: str) -> tuple[MeshPart, ...]:
    """Read a mesh file.

    Args:
        path: STL (ASCII or binary), OBJ or DAE.
        scale: factor (3,) or scalar of the URDF, None for 1.
        where: the element that names it, for messages.

    Raises:
        BadInput: if the file is too large, of an unknown kind, broken or empty.
    """
    if path.suffix.lower() not in FORMATS:
        known = ", ".join(FORMATS)
        raise BadInput(f"{where}: mesh '{path.name}' is of an unknown kind; use one of {known}")
    try:
        status = path.stat()
        if status.st_size > MAX_MESH_BYTES:
            raise BadInput(
                f"{where}: mesh '{path.name}' has {status.st_size / 1e6:.0f} MB; simplify it below "
                f"{MAX_MESH_BYTES / 1e6:.0f} MB"
            )
        parts = _read_file(path, status.st_mtime_ns)
    except OSError as error:
        raise BadInput(
            f"{where}: mesh '{path.name}' cannot be read ({error.strerror}); check the file"
        ) from error
    except _BadMesh as error:
        raise BadInput(f"{where}: mesh '{path.name}' {error}; export it again") from error
    return tuple(_scaled(part, _factor(scale, where)) for part in parts)


class _BadMesh(Exception):
    """What is wrong with the content of a mesh file."""


@lru_cache(maxsize=32)
def _read_file(path: Path, _changed: int) -> tuple[MeshPart, ...]:
    """Read a file once; `_changed` is its time stamp."""
    content = path.read_bytes()
    try:
        if path.suffix.lower() == ".dae":
            check_xml(content, "its text")
            parts = _read_collada(content)
        else:
            parts = _read_triangles(content, path.suffix.lower()[1:])
    except Exception as error:  # the readers let all kinds of errors out
        reason = " ".join(str(error).split())[:200] or type(error).__name__
        raise _BadMesh(f"cannot be read ({reason})") from error
    parts = [part for part in parts if len(part.faces)]
    if not parts:
        raise _BadMesh("holds no triangle")
    if not all(np.all(np.isfinite(part.vertices)) for part in parts):
        raise _BadMesh("holds numbers that are not finite")
    if any(part.faces.min() < 0 or part.faces.max() >= len(part.vertices) for part in parts):
        raise _BadMesh("names vertices that it does not have")
    return tuple(parts)


def _read_collada(content: bytes) -> list[MeshPart]:
    """Read a DAE file, pieces of the same colour joined."""
    by_color: dict[tuple[float, ...] | None, list[MeshPart]] = {}
    for vertices, faces, rgba in read_dae(content):
        part = MeshPart(vertices=vertices, faces=faces, rgba=rgba)
        by_color.setdefault(rgba, []).append(part)
    joined = []
    for rgba, parts in by_color.items():
        vertices, faces = merged(tuple(parts))
        joined.append(MeshPart(vertices=vertices, faces=faces, rgba=rgba))
    return joined


def _read_triangles(content: bytes, kind: str) -> list[MeshPart]:
    import trimesh

    loaded = trimesh.load(io.BytesIO(content), file_type=kind, process=False, force="scene")
    parts = []
    for mesh in loaded.geometry.values():
        if not hasattr(mesh, "faces"):
            continue
        given = kind == "obj" and "vertex_normals" in mesh._cache
        normals = np.array(mesh.vertex_normals) if given else None
        parts.append(
            MeshPart(
                vertices=np.array(mesh.vertices, dtype=float),
                faces=np.array(mesh.faces, dtype=np.int64),
                normals=normals,
            )
        )
    return parts


def _factor(scale: Any, where: str) -> Array:
    factor = np.ones(3) if scale is None else np.broadcast_to(np.asarray(scale, float), 3).copy()
    if not np.all(np.isfinite(factor)) or np.any(factor == 0):
        raise BadInput(f"{where}: mesh scale {scale} is impossible; give three numbers, none 0")
    return factor


def _scaled(part: MeshPart, factor: Array) -> MeshPart:
    return transformed(part, np.diag(factor), np.zeros(3))


def transformed(part: MeshPart, linear: Array, offset: Array) -> MeshPart:
    """Apply x -> linear x + offset, (3, 3) and (3,); a mirrored mesh keeps its outside."""
    if np.array_equal(linear, np.eye(3)) and not np.any(offset):
        return part
    normals = part.normals
    if normals is not None:
        normals = normals @ np.linalg.pinv(linear) * np.sign(np.linalg.det(linear))
        length = np.linalg.norm(normals, axis=1, keepdims=True)
        normals = normals / np.where(length > 0, length, 1.0)
    mirrored = np.linalg.det(linear) < 0
    return MeshPart(
        vertices=part.vertices @ linear.T + offset,
        faces=part.faces[:, ::-1] if mirrored else part.faces,
        normals=normals,
        rgba=part.rgba,
    )


def convex_pieces(
    parts: tuple[MeshPart, ...], *, where: str
) -> tuple[tuple[MeshPart, ...], tuple[str, ...]]:
    """Split a collision mesh into convex pieces.

    Separate bodies in the file are separate pieces. A body that is concave is split by coacd if
    that is installed; else its convex hull takes its place.

    Args:
        parts: the mesh.
        where: the element it belongs to, for notes.

    Returns:
        The pieces as closed convex hulls, and notes on what was approximated.
    """
    vertices, faces = merged(parts)
    bodies = _bodies(vertices, faces)
    if len(bodies) > MAX_PIECES:
        bodies = [(vertices, faces)]
    pieces: list[MeshPart] = []
    notes: list[str] = []
    for points, triangles in bodies:
        hull = _hull(points)
        if hull is None:
            pieces.append(_sheet(points))
            notes.append(f"{where}: a flat collision mesh is given {1000 * SHEET:g} mm thickness")
        elif _is_convex(points, triangles, hull):
            pieces.append(_as_part(hull))
        else:
            split, note = _split(points, triangles, hull)
            pieces += split
            notes.append(f"{where}: {note}")
    return tuple(pieces), tuple(dict.fromkeys(notes))


def is_convex(parts: tuple[MeshPart, ...]) -> bool:
    """Tell whether `convex_pieces` keeps a mesh as it is, apart from filling shallow dents."""
    bodies = _bodies(*merged(parts))
    if len(bodies) > MAX_PIECES:
        bodies = [merged(parts)]
    hulls = [_hull(points) for points, _ in bodies]
    return all(
        hull is not None and _is_convex(points, faces, hull)
        for (points, faces), hull in zip(bodies, hulls, strict=True)
    )


def merged(parts: tuple[MeshPart, ...]) -> tuple[Array, Array]:
    """Join parts into one mesh, equal vertices made one; return vertices (n, 3), faces (m, 3)."""
    counts = np.cumsum([0] + [len(part.vertices) for part in parts])
    vertices = np.concatenate([part.vertices for part in parts])
    faces = np.concatenate([part.faces + n for part, n in zip(parts, counts, strict=False)])
    unique, index = np.unique(vertices.astype(np.float32), axis=0, return_inverse=True)
    return unique.astype(float), index.reshape(-1)[faces]


def _bodies(vertices: Array, faces: Array) -> list[tuple[Array, Array]]:
    """Split a mesh into its connected bodies."""
    edges = np.concatenate([faces[:, :2], faces[:, 1:]])
    graph = coo_matrix((np.ones(len(edges), dtype=bool), edges.T), shape=(len(vertices),) * 2)
    _, label = connected_components(graph, directed=False)
    bodies = []
    for number in np.unique(label[faces[:, 0]]):
        chosen = faces[label[faces[:, 0]] == number]
        used, index = np.unique(chosen, return_inverse=True)
        bodies.append((vertices[used], index.reshape(-1, 3)))
    return bodies


def _hull(points: Array) -> ConvexHull | None:
    try:
        return ConvexHull(points)
    except (QhullError, ValueError):
        return None


def _is_convex(points: Array, faces: Array, hull: ConvexHull) -> bool:
    diagonal = float(np.linalg.norm(np.ptp(points, axis=0)))
    corners = points[faces]
    probes = np.concatenate([points, corners.mean(axis=1)])
    if _depth(probes, hull) > CONCAVITY * diagonal:
        return False
    edges = np.sort(np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]), axis=1)
    _, uses = np.unique(edges, axis=0, return_counts=True)
    if not np.all(uses == 2):
        return True
    volume = np.sum(np.cross(corners[:, 0], corners[:, 1]) * corners[:, 2]) / 6
    return bool(abs(volume) >= HULL_FILLED * hull.volume)


def _depth(points: Array, hull: ConvexHull) -> float:
    """Return how deep [m] the deepest point (of a sample) lies below the surface of the hull."""
    sample = points[:: max(1, len(points) // _SAMPLED_POINTS)]
    planes = np.unique(hull.equations.round(9), axis=0)
    chunks = np.array_split(sample, 1 + len(sample) // 500)
    return max(
        float(np.max(np.min(-(chunk @ planes[:, :3].T + planes[:, 3]), axis=1)))
        for chunk in chunks
        if len(chunk)
    )


def _as_part(hull: ConvexHull) -> MeshPart:
    """Return a hull as a mesh with its faces counter-clockwise from outside."""
    corners = hull.points[hull.simplices]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    inward = np.sum(normal * hull.equations[:, :3], axis=1) < 0
    simplices = np.where(inward[:, None], hull.simplices[:, ::-1], hull.simplices)
    used, index = np.unique(simplices, return_inverse=True)
    return MeshPart(vertices=hull.points[used], faces=index.reshape(-1, 3))


def _sheet(points: Array) -> MeshPart:
    """Give flat points a thickness and return their hull; a line or point becomes a small box."""
    centre = points.mean(axis=0)
    _, size, axes = np.linalg.svd(points - centre, full_matrices=True)
    size = np.concatenate([size, np.zeros(3 - len(size))])
    layers = [points]
    for axis, extent in zip(axes, size, strict=True):
        if extent <= 1e-6 * max(float(size[0]), SHEET):
            layers = [layer + sign * SHEET / 2 * axis for layer in layers for sign in (-1, 1)]
    hull = _hull(np.concatenate(layers))
    if hull is None:
        raise ValueError("points do not span a volume even when thickened")
    return _as_part(hull)


def _split(points: Array, faces: Array, hull: ConvexHull) -> tuple[list[MeshPart], str]:
    """Split a concave body; return pieces and what to say about it."""
    if len(faces) > MAX_SPLIT_FACES:
        return [_as_part(hull)], (
            f"a concave collision mesh of {len(faces)} triangles is replaced by its convex hull; "
            f"simplify it below {MAX_SPLIT_FACES} to have it split"
        )
    try:
        import coacd
    except ModuleNotFoundError:
        return [_as_part(hull)], (
            "a concave collision mesh is replaced by its convex hull; install coacd to have it "
            "split: pip install 'kr210-sim[convex]'"
        )
    coacd.set_log_level("error")
    remesh = {"preprocess_mode": "on" if len(faces) > _REMESH_ABOVE else "auto"}
    pieces = []
    for vertices, _ in coacd.run_coacd(coacd.Mesh(points, faces), **_COACD, **remesh):
        piece = _hull(np.asarray(vertices, dtype=float))
        pieces.append(_sheet(np.asarray(vertices)) if piece is None else _as_part(piece))
    return pieces, f"a concave collision mesh is split into {len(pieces)} convex pieces"
