"""URDF shapes -> geoms of an MjSpec: primitives, meshes, materials; visual and collision apart."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from kr210_sim.arrays import Array
from kr210_sim.exceptions import BadInput, MissingFile
from kr210_sim.meshes import MeshPart, convex_pieces, load_mesh
from kr210_sim.packages import Packages

VISUAL, COLLISION = "visual", "collision"
"""Default classes of the geoms: looked at, without contact, in group 2; touched, in group 3."""


def split_pose(T: Array | None) -> tuple[Array, Array]:
    """Split a (4, 4) transform, None for identity, into position (3,) and quat_wxyz (4,)."""
    if T is None:
        return np.zeros(3), np.array([1.0, 0.0, 0.0, 0.0])
    quat_wxyz = np.empty(4)
    mujoco.mju_mat2Quat(quat_wxyz, np.ascontiguousarray(T[:3, :3], dtype=float).ravel())
    return np.array(T[:3, 3], dtype=float), quat_wxyz


class ShapeBuilder:
    """Adds the shapes of a description's links to bodies, each mesh once per use and scale.

    Args:
        spec: receives the assets and default classes.
        urdf: `yourdfpy` robot, for its named colours.
        packages: resolves mesh file names.

    Attributes:
        notes: what was approximated, in order.
    """

    def __init__(self, spec: mujoco.MjSpec, urdf: Any, packages: Packages) -> None:
        self._spec, self._packages = spec, packages
        self.notes: list[str] = []
        self._assets: dict[tuple[Path, tuple[float, ...], str], list[tuple[str, str | None]]] = {}
        self._materials: set[str] = set()
        self._colors: dict[tuple[float, ...], str] = {}
        self._names: set[str] = set()
        self._classes = {name: spec.add_default(name, spec.default) for name in (VISUAL, COLLISION)}
        visual, collision = (self._classes[name].geom for name in (VISUAL, COLLISION))
        visual.contype, visual.conaffinity, visual.group = 0, 0, 2
        collision.group = 3
        visual.density = collision.density = 0.0
        self._add_named_materials(urdf)

    def add_link(self, body: Any, link: Any) -> None:
        """Add all shapes of a link; what is to be seen but missing is drawn by what is touched.

        Raises:
            BadInput: if a collision mesh is missing, or a shape cannot be read.
        """
        touched = [
            (item.name or f"{link.name}_collision_{index}", item)
            for index, item in enumerate(link.collisions)
        ]
        missing = bool(touched) and not link.visuals
        if missing:
            self.notes.append(f"link '{link.name}': no <visual>; it is drawn by its <collision>")
        for index, item in enumerate(link.visuals):
            try:
                self.add_visual(body, item.name or f"{link.name}_visual_{index}", item)
            except MissingFile as error:
                if not touched:
                    raise
                missing = True
                self.notes.append(f"{error}; link '{link.name}' is drawn by its <collision>")
        for name, item in touched if missing else ():
            self.add_visual(body, f"{name}_drawn", item)
        for name, item in touched:
            self.add_collision(body, name, item)

    def add_visual(self, body: Any, name: str, element: Any) -> None:
        """Add a <visual>; a mesh of several materials becomes several geoms."""
        material = getattr(element, "material", None)  # a <collision> has none
        named = None
        if material is not None and material.name in self._materials:
            named = material.name
        elif material is not None and material.color is not None:
            named = self._color(material.color.rgba)
        for geom, own in self._add(body, name, element, VISUAL):
            if named or own:
                geom.material = named or own

    def add_collision(self, body: Any, name: str, element: Any) -> None:
        """Add a <collision>; a concave mesh becomes several geoms."""
        self._add(body, name, element, COLLISION)

    def _add(self, body: Any, name: str, element: Any, kind: str) -> list[tuple[Any, str | None]]:
        shape = element.geometry
        types = mujoco.mjtGeom
        position, quat_wxyz = split_pose(element.origin)
        place = {"pos": position, "quat": quat_wxyz}
        if shape.mesh is not None:
            assets = self._mesh(name, shape.mesh, kind)
            names = [name] + [f"{name}_{index}" for index in range(1, len(assets))]
            options = [{"type": types.mjGEOM_MESH, "meshname": asset} for asset, _ in assets]
            materials = [own for _, own in assets]
        else:
            names, options, materials = [name], [_primitive(name, shape)], [None]
        geoms = [
            body.add_geom(self._classes[kind], name=self._free(part), **option, **place)
            for part, option in zip(names, options, strict=True)
        ]
        return list(zip(geoms, materials, strict=True))

    def _free(self, name: str) -> str:
        """Return the name, numbered if another geom has it already."""
        candidates = [name, *(f"{name}_{index}" for index in range(1, len(self._names) + 2))]
        free = next(candidate for candidate in candidates if candidate not in self._names)
        self._names.add(free)
        return free

    def _mesh(self, name: str, mesh: Any, kind: str) -> list[tuple[str, str | None]]:
        """Return the assets of a mesh file, with the material of each, adding them once."""
        where = f"geometry '{name}'"
        if not mesh.filename:
            raise BadInput(f"{where}: <mesh> has no filename; give one")
        path = self._packages.resolve(mesh.filename, where=where)
        scale = () if mesh.scale is None else tuple(np.atleast_1d(mesh.scale).tolist())
        key = (path, scale, kind)
        if key not in self._assets:
            parts = load_mesh(path, mesh.scale, where=where)
            if kind == COLLISION:
                parts, notes = convex_pieces(parts, where=where)
                self.notes += notes
            stem = re.sub(r"\W+", "_", path.stem)
            self._assets[key] = [
                (self._add_mesh(f"{stem}_{kind}", part), self._color(part.rgba)) for part in parts
            ]
            if kind != COLLISION and len(parts) == 1 and mesh.scale is None:
                self._keep_file(self._assets[key][0][0], path)
        return self._assets[key]

    def _keep_file(self, name: str, path: Path) -> None:
        """Keep an OBJ that is used as it is, so that it need not be written anew."""
        content = path.read_bytes() if path.suffix.lower() == ".obj" else b""
        if content and b"mtl" not in content:
            self._spec.assets = {**self._spec.assets, f"{name}.obj": content}

    def _add_mesh(self, name: str, part: MeshPart) -> str:
        taken = {mesh.name for mesh in self._spec.meshes}
        unique = next(
            candidate
            for candidate in [name, *(f"{name}_{index}" for index in range(1, len(taken) + 2))]
            if candidate not in taken
        )
        mesh = self._spec.add_mesh(
            name=unique,
            uservert=part.vertices.astype(np.float32).ravel(),
            userface=part.faces.astype(np.int32).ravel(),
            # A shell's frame exists for any triangles, closed and well wound or not; bodies have
            # their inertia from the description.
            inertia=mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL,
        )
        if part.normals is not None:
            mesh.usernormal = part.normals.astype(np.float32).ravel()
            mesh.userfacenormal = part.faces.astype(np.int32).ravel()
        return unique

    def _add_named_materials(self, urdf: Any) -> None:
        named = {item.name: item for item in urdf.materials if item.color is not None}
        for link in urdf.links:
            for visual in link.visuals:
                material = visual.material
                if material is not None and material.name and material.color is not None:
                    named.setdefault(material.name, material)
        for name, material in named.items():
            self._add_material(name, material.color.rgba)
        self._materials = set(named)

    def _add_material(self, name: str, rgba: Any) -> None:
        self._spec.add_material(name=name, rgba=rgba, specular=0.3, shininess=0.4)

    def _color(self, rgba: Any) -> str | None:
        """Return the material of a colour without a name, adding it once; None for no colour."""
        if rgba is None:
            return None
        key = tuple(round(float(value), 6) for value in rgba)
        if key not in self._colors:
            self._colors[key] = f"color_{len(self._colors)}"
            self._add_material(self._colors[key], key)
        return self._colors[key]


def _primitive(name: str, shape: Any) -> dict[str, Any]:
    types = mujoco.mjtGeom
    if shape.box is not None:
        return {"type": types.mjGEOM_BOX, "size": np.asarray(shape.box.size) / 2}
    if shape.cylinder is not None:
        size = [shape.cylinder.radius, shape.cylinder.length / 2, 0]
        return {"type": types.mjGEOM_CYLINDER, "size": size}
    if shape.sphere is not None:
        return {"type": types.mjGEOM_SPHERE, "size": [shape.sphere.radius, 0, 0]}
    raise BadInput(f"geometry '{name}': use box, cylinder, sphere or mesh")
