"""Writes solids as mesh files that are shaded as they are meant.

SPDX-License-Identifier: MIT
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from manifold3d import Manifold
from solids import union

CREASE = 38.0
"""Faces that meet at a smaller angle [deg] are shaded as one smooth surface."""

TOLERANCE = 1e-4
"""How far a surface may move when needless triangles are taken out of it."""

DIGITS = 4
"""Decimals of a coordinate in a mesh file: 0.1 mm."""


def write_meshes(folder: Path, links: dict[str, dict[str, list[Manifold]]]) -> None:
    """Write `<link>_<material>.obj` for every link and material, and remove what else is there."""
    folder.mkdir(exist_ok=True)
    for old in folder.glob("*.obj"):
        old.unlink()
    for link, materials in links.items():
        for material, solids in materials.items():
            solid = union(*solids).as_original().simplify(TOLERANCE)
            (folder / f"{link}_{material}.obj").write_text(
                obj(solid), encoding="ascii", newline="\n"
            )


def obj(solid: Manifold) -> str:
    """Return a solid as Wavefront OBJ with a normal at every corner of every triangle."""
    mesh = solid.to_mesh64()
    rounded = np.round(np.asarray(mesh.vert_properties)[:, :3], DIGITS) + 0.0
    vertices, index = np.unique(rounded, axis=0, return_inverse=True)
    faces = index.ravel()[np.asarray(mesh.tri_verts).astype(int)]
    area = _cross(vertices, faces)
    faces = faces[np.linalg.norm(area, axis=1) > 1e-10]
    corner, normals = _corner_normals(vertices, faces)
    lines = ["# written by make_meshes.py"]
    lines += ["v " + " ".join(_number(x, DIGITS) for x in v) for v in vertices]
    lines += ["vn " + " ".join(_number(x, 3) for x in v) for v in normals]
    for face, at in zip(faces + 1, corner + 1, strict=True):
        lines.append("f " + " ".join(f"{v}//{n}" for v, n in zip(face, at, strict=True)))
    return "\n".join(lines) + "\n"


def _number(value: float, digits: int) -> str:
    text = f"{value:.{digits}f}".rstrip("0").rstrip(".")
    return "0" if text in ("-0", "") else text


def _cross(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    a, b, c = (vertices[faces[:, i]] for i in range(3))
    return np.cross(b - a, c - a)


def _corner_normals(vertices: np.ndarray, faces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the normal index of each face corner (m, 3) and the normals (k, 3).

    The normal at a corner is the mean over the faces around it that meet this one below the crease
    angle, weighted by the area of the plane patch they belong to: large flats stay flat, fillets
    between them are smooth.
    """
    cross = _cross(vertices, faces)
    normal = cross / np.linalg.norm(cross, axis=1)[:, None]
    weight = _patch_area(faces, normal, np.linalg.norm(cross, axis=1) / 2)
    around_vertex: list[list[int]] = [[] for _ in vertices]
    for f, face in enumerate(faces):
        for v in face:
            around_vertex[v].append(f)
    found: dict[tuple[float, ...], int] = {}
    corner = np.empty_like(faces)
    limit = np.cos(np.radians(CREASE))
    for f, face in enumerate(faces):
        for i, v in enumerate(face):
            near = np.array(around_vertex[v])
            near = near[normal[near] @ normal[f] > limit]
            mean = weight[near] @ normal[near]
            mean = np.round(mean / np.linalg.norm(mean), 3) + 0.0
            corner[f, i] = found.setdefault(tuple(mean.tolist()), len(found))
    return corner, np.array(list(found))


def _patch_area(faces: np.ndarray, normal: np.ndarray, area: np.ndarray) -> np.ndarray:
    """Return for each face the area of the connected plane patch it lies in."""
    root = list(range(len(faces)))

    def find(i: int) -> int:
        while root[i] != i:
            root[i] = root[root[i]]
            i = root[i]
        return i

    edges: dict[tuple[int, int], int] = {}
    for f, face in enumerate(faces.tolist()):
        for a, b in zip(face, face[1:] + face[:1], strict=True):
            other = edges.setdefault((min(a, b), max(a, b)), f)
            if other != f and normal[other] @ normal[f] > 1 - 1e-5:
                root[find(f)] = find(other)
    patch = np.array([find(f) for f in range(len(faces))])
    return np.bincount(patch, area, len(faces))[patch]
