"""Compiled model -> the meshes that a viewer shows, in the frames of their bodies."""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np
import trimesh
from numpy.typing import NDArray

from kr210_sim.arrays import Array

VISIBLE_GROUPS = (0, 1, 2)
"""Visual geometry; collision shapes (3) and sites (4) stay hidden."""

_DEFAULT_RGBA = (0.5, 0.5, 0.5, 1.0)
"""Colour of a geom that names none: its material's counts then."""

_CREASE = np.radians(30.0)
"""Edges sharper than this stay sharp; the others are shaded smoothly [rad]."""

_SECTIONS = 48
"""Facets around a round primitive."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Part:
    """What one body has of one colour.

    Attributes:
        body: id in the model; 0 is the world, which never moves.
        vertices: (V, 3) in the body frame [m].
        faces: (F, 3) indices of vertices, counterclockwise from outside.
        rgba: (4,) 0 to 1, as MJCF has it.
        shininess: of the material, 0 to 1.
    """

    body: int
    vertices: Array
    faces: NDArray[np.int64]
    rgba: tuple[float, float, float, float]
    shininess: float


@dataclass(frozen=True, kw_only=True, eq=False)
class Floor:
    """A plane that is seen.

    Attributes:
        T_world_plane: (4, 4), its z axis up.
        rgba: (4,) 0 to 1.
    """

    T_world_plane: Array
    rgba: tuple[float, float, float, float]


def visible_parts(model: mujoco.MjModel) -> list[Part]:
    """Return the meshes of everything that is seen, planes apart, merged by body and colour."""
    merged: dict[tuple[int, tuple[float, ...], float], list[trimesh.Trimesh]] = {}
    for geom in _visible(model):
        mesh = _geom_mesh(model, geom)
        if mesh is None or len(mesh.faces) == 0:
            continue
        mesh.apply_transform(_transform(model.geom_pos[geom], model.geom_quat[geom]))
        key = (int(model.geom_bodyid[geom]), _rgba(model, geom), _shininess(model, geom))
        merged.setdefault(key, []).append(mesh)
    parts = []
    for (body, rgba, shininess), meshes in merged.items():
        whole = _creased(trimesh.util.concatenate(meshes))
        r, g, b, a = rgba
        parts.append(
            Part(
                body=body,
                vertices=np.asarray(whole.vertices, dtype=float),
                faces=np.asarray(whole.faces, dtype=np.int64),
                rgba=(r, g, b, a),
                shininess=shininess,
            )
        )
    return parts


def plain_bodies(parts: list[Part]) -> list[Part]:
    """Return the parts merged by body, their colours dropped."""
    bodies: dict[int, list[Part]] = {}
    for part in parts:
        bodies.setdefault(part.body, []).append(part)
    merged = []
    for body, found in bodies.items():
        starts = np.cumsum([0, *(len(part.vertices) for part in found)])
        merged.append(
            Part(
                body=body,
                vertices=np.concatenate([part.vertices for part in found]),
                faces=np.concatenate([p.faces + n for p, n in zip(found, starts, strict=False)]),
                rgba=_DEFAULT_RGBA,
                shininess=0.0,
            )
        )
    return merged


def visible_floors(model: mujoco.MjModel) -> list[Floor]:
    """Return the planes that are seen, those of the world only."""
    return [
        Floor(
            T_world_plane=_transform(model.geom_pos[geom], model.geom_quat[geom]),
            rgba=_rgba(model, geom),
        )
        for geom in _visible(model)
        if model.geom_type[geom] == mujoco.mjtGeom.mjGEOM_PLANE and model.geom_bodyid[geom] == 0
    ]


def _visible(model: mujoco.MjModel) -> list[int]:
    return [
        geom
        for geom in range(model.ngeom)
        if model.geom_group[geom] in VISIBLE_GROUPS and _rgba(model, geom)[3] > 0.0
    ]


def _rgba(model: mujoco.MjModel, geom: int) -> tuple[float, float, float, float]:
    own, material = model.geom_rgba[geom], int(model.geom_matid[geom])
    plain = np.allclose(own, _DEFAULT_RGBA)
    r, g, b, a = (model.mat_rgba[material] if material >= 0 and plain else own).tolist()
    if material >= 0 and model.mat_texid[material].max(initial=-1) >= 0:
        texture = int(model.mat_texid[material].max())
        r, g, b = _mean_color(model, texture) * np.array([r, g, b])
    return float(r), float(g), float(b), float(a)


def _mean_color(model: mujoco.MjModel, texture: int) -> Array:
    """Return the mean colour (3,) of a texture, 0 to 1."""
    channels = int(model.tex_nchannel[texture])
    first = int(model.tex_adr[texture])
    size = int(model.tex_width[texture]) * int(model.tex_height[texture]) * channels
    pixels = model.tex_data[first : first + size].reshape(-1, channels).mean(axis=0) / 255.0
    return np.resize(pixels[:3], 3) if channels >= 3 else np.full(3, pixels[0])


def _shininess(model: mujoco.MjModel, geom: int) -> float:
    material = int(model.geom_matid[geom])
    return float(model.mat_shininess[material]) if material >= 0 else 0.3


def _geom_mesh(model: mujoco.MjModel, geom: int) -> trimesh.Trimesh | None:
    """Return the surface of a geom in its own frame, None for a kind that is not drawn."""
    kinds, size = mujoco.mjtGeom, model.geom_size[geom]
    kind = kinds(int(model.geom_type[geom]))
    if kind == kinds.mjGEOM_MESH:
        return _stored_mesh(model, int(model.geom_dataid[geom]))
    if kind == kinds.mjGEOM_BOX:
        return trimesh.creation.box(extents=2 * size)
    if kind == kinds.mjGEOM_CYLINDER:
        return trimesh.creation.cylinder(radius=size[0], height=2 * size[1], sections=_SECTIONS)
    if kind == kinds.mjGEOM_CAPSULE:
        return trimesh.creation.capsule(
            radius=size[0], height=2 * size[1], count=[_SECTIONS // 2, _SECTIONS]
        )
    if kind in (kinds.mjGEOM_SPHERE, kinds.mjGEOM_ELLIPSOID):
        ball = trimesh.creation.icosphere(subdivisions=3)
        ball.apply_scale(size if kind == kinds.mjGEOM_ELLIPSOID else np.full(3, size[0]))
        return ball
    return None


def _stored_mesh(model: mujoco.MjModel, mesh: int) -> trimesh.Trimesh:
    first, count = int(model.mesh_vertadr[mesh]), int(model.mesh_vertnum[mesh])
    begin, faces = int(model.mesh_faceadr[mesh]), int(model.mesh_facenum[mesh])
    return trimesh.Trimesh(
        np.array(model.mesh_vert[first : first + count], dtype=float),
        np.array(model.mesh_face[begin : begin + faces], dtype=np.int64),
        process=False,
    )


def _creased(mesh: trimesh.Trimesh) -> trimesh.Trimesh:
    """Return a mesh whose vertices are shared across smooth edges only."""
    mesh.merge_vertices(merge_tex=True, merge_norm=True)
    mesh.update_faces(mesh.nondegenerate_faces())
    return trimesh.graph.smooth_shade(mesh, angle=_CREASE)


def _transform(position: Array, quat_wxyz: Array) -> Array:
    T = np.eye(4)
    rotation = np.empty(9)
    mujoco.mju_quat2Mat(rotation, np.asarray(quat_wxyz, dtype=float))
    T[:3, :3], T[:3, 3] = rotation.reshape(3, 3), position
    return T
