"""COLLADA -> triangles in metres with z up: unit, up axis and the transforms of the scene baked."""

from __future__ import annotations

import io
import math
import xml.etree.ElementTree as ET
from collections.abc import Iterator
from typing import Any

import numpy as np

from kr210_sim.arrays import Array

MAX_FACES = 2_000_000
"""Most triangles of one file, instances counted."""

MAX_NODES = 100_000
"""Most nodes of a scene, instances counted: a few lines can ask for billions."""

_TO_Z_UP = {
    "Z_UP": np.eye(3),
    "Y_UP": np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]]),
    "X_UP": np.array([[0.0, -1, 0], [0, 0, -1], [1, 0, 0]]),
}
"""Rotation (3, 3) from the axes of a file to right, away from the viewer, up."""


def read_dae(content: bytes) -> Iterator[tuple[Array, Array, tuple[float, ...] | None]]:
    """Yield vertices (n, 3) [m], faces (m, 3) and colour (4,) or None of each piece.

    Raises:
        ValueError: if the unit is impossible or there are too many triangles or nodes. The reader
            itself lets errors of many kinds out.
    """
    import collada

    _check_nodes(ET.fromstring(content))
    document = collada.Collada(
        io.BytesIO(content),
        ignore=[collada.common.DaeUnsupportedError, collada.common.DaeBrokenRefError],
        aux_file_loader=_no_file,
    )
    unit = document.assetInfo.unitmeter
    unit = 1.0 if unit is None else float(unit)
    if not (math.isfinite(unit) and unit > 0):
        raise ValueError(f"its unit is {unit} m")
    to_metres = unit * _TO_Z_UP[document.assetInfo.upaxis or "Y_UP"]
    count = 0
    for primitive in _primitives(document):
        triangles = primitive.triangleset() if hasattr(primitive, "triangleset") else primitive
        faces = getattr(triangles, "vertex_index", None)
        if faces is None or np.ndim(faces) != 2 or np.shape(faces)[1] != 3:
            continue  # lines
        count += len(faces)
        if count > MAX_FACES:
            raise ValueError(f"it has more than {MAX_FACES} triangles")
        vertices = np.asarray(triangles.vertex, dtype=float) @ to_metres.T
        yield vertices, np.asarray(faces, dtype=np.int64), _color(triangles)


def _check_nodes(root: ET.Element) -> None:
    """Refuse a scene whose nodes, instances of nodes counted, are too many or endless."""
    nodes = [element for element in root.iter() if element.tag.endswith("}node")]
    by_id = {f"#{node.get('id')}": node for node in nodes}
    sizes: dict[int, float] = {}

    def size(node: ET.Element) -> float:
        key = id(node)
        if key not in sizes:
            sizes[key] = math.inf  # what leads back to itself has no end
            inner = [child for child in node if child.tag.endswith("}node")]
            used = [child for child in node if child.tag.endswith("}instance_node")]
            inner += [by_id[child.get("url", "")] for child in used if child.get("url") in by_id]
            sizes[key] = 1 + sum(size(child) for child in inner)
        return sizes[key]

    if sum(size(node) for node in nodes) > MAX_NODES:
        raise ValueError(f"its scene has more than {MAX_NODES} nodes")


def _primitives(document: Any) -> Iterator[Any]:
    if document.scene is None:
        for geometry in document.geometries:
            yield from geometry.primitives
        return
    for bound in document.scene.objects("geometry"):
        mirrored = np.linalg.det(np.asarray(bound.matrix)[:3, :3]) < 0
        for primitive in bound.primitives():
            yield _Mirrored(primitive) if mirrored else primitive


class _Mirrored:
    """Triangles under a transform that mirrors: corners reversed, so that outside stays outside."""

    def __init__(self, primitive: Any) -> None:
        triangles = primitive.triangleset() if hasattr(primitive, "triangleset") else primitive
        self.vertex = triangles.vertex
        index = getattr(triangles, "vertex_index", None)
        self.vertex_index = None if index is None else np.asarray(index)[..., ::-1]
        self.material = getattr(triangles, "material", None)


def _color(primitive: Any) -> tuple[float, ...] | None:
    effect = getattr(getattr(primitive, "material", None), "effect", None)
    diffuse = getattr(effect, "diffuse", None)
    if not isinstance(diffuse, tuple) or len(diffuse) < 3:
        return None  # none, or a texture
    return tuple(float(value) for value in (*diffuse[:3], *diffuse[3:4], 1.0)[:4])


def _no_file(name: str) -> bytes:
    raise ValueError(f"it needs the file '{name}'")
