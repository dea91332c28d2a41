"""MjSpec -> a folder any MuJoCo loads: one XML with its numbers in full, mesh files beside it.

`MjSpec.to_xml` writes six significant digits and puts the vertices of a mesh into the XML. Here its
text is the frame: numbers that are the rounded ones of the spec or of the compiled model are
written again in full, and each mesh becomes a file.
"""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from kr210_sim.arrays import Array

ASSETS = "assets"
"""Folder of the mesh files, beside the XML."""

_AGREE = 5.1e-6
"""Relative difference up to which a written number is the rounded one of the model: 6 digits."""

_PLACED = {"pos": "pos", "quat": "quat", "size": "size"}
_JOINT = {
    name: name for name in ("pos", "axis", "range", "armature", "damping", "frictionloss")
} | {"actuatorfrcrange": "actfrcrange"}
_ACTUATOR = {name: name for name in ("gainprm", "biasprm", "ctrlrange", "forcerange")}
_FIELDS: dict[str, tuple[str, dict[str, str]]] = {
    "body": ("bodies", {"pos": "pos", "quat": "quat"}),
    "joint": ("joints", _JOINT),
    "geom": ("geoms", _PLACED),
    "site": ("sites", _PLACED),
    "general": ("actuators", _ACTUATOR),
    "numeric": ("numerics", {"data": "data"}),
    "key": ("keys", {"qpos": "qpos", "ctrl": "ctrl"}),
}
"""XML element -> list in the spec, and attribute -> field there."""


def save_model(spec: mujoco.MjSpec, path: Path) -> None:
    """Write a model so that `MjModel.from_xml_path` loads it from any folder.

    Args:
        spec: the model; copied, never changed.
        path: the XML file to write; mesh and texture files go to `assets/` beside it.

    Raises:
        OSError: if something cannot be written.
    """
    spec = spec.copy()
    spec.assets = {**spec.assets, **_put_meshes_into_files(spec)}
    model = spec.compile()
    root = ET.fromstring(spec.to_xml())
    _write_numbers(root, spec, model)
    path.parent.mkdir(parents=True, exist_ok=True)
    folder = path.parent / ASSETS
    written = False
    for element in root.iterfind("asset/*"):
        if element.get("file"):
            element.set("file", _copy_asset(spec, element, folder))
            element.attrib.pop("content_type", None)
            written = True
    compiler = root.find("compiler")
    if compiler is not None:
        for attribute in ("meshdir", "texturedir", "assetdir"):
            compiler.attrib.pop(attribute, None)
        if written:
            compiler.set("meshdir", ASSETS)
            compiler.set("texturedir", ASSETS)
    ET.indent(root)
    path.write_text(ET.tostring(root, encoding="unicode") + "\n", encoding="utf-8")


def _write_numbers(root: ET.Element, spec: mujoco.MjSpec, model: mujoco.MjModel) -> None:
    for tag, (listed, fields) in _FIELDS.items():
        items = {item.name: item for item in getattr(spec, listed) if item.name}
        for element in root.iter(tag):
            item = items.get(element.get("name", ""))
            if item is None:
                continue
            for attribute, field in fields.items():
                _write_number(element, attribute, getattr(item, field))
    bodies = {model.body(index).name: index for index in range(model.nbody)}
    for body in root.iter("body"):
        inertial, index = body.find("inertial"), bodies.get(body.get("name", ""))
        if inertial is not None and index is not None:
            _write_number(inertial, "pos", model.body_ipos[index])
            _write_number(inertial, "quat", model.body_iquat[index])
            _write_number(inertial, "mass", model.body_mass[index])
            _write_number(inertial, "diaginertia", model.body_inertia[index])


def _write_number(element: ET.Element, attribute: str, exact: Any) -> None:
    """Replace the numbers of an attribute by the exact ones, if they are rounded from those."""
    text = element.get(attribute)
    if text is None:
        return
    rounded = np.array(text.split(), dtype=float)
    for candidate in _candidates(exact, attribute, len(rounded)):
        if np.all(np.abs(candidate - rounded) <= _AGREE * np.abs(rounded) + 1e-15):
            element.set(attribute, " ".join(_text(value) for value in candidate))
            return


def _text(value: float) -> str:
    return str(int(value)) if value == int(value) and abs(value) < 1e9 else repr(float(value))


def _candidates(values: Any, attribute: str, count: int) -> Iterator[Array]:
    """Yield the leading numbers as they are and, for directions, as unit vectors of both signs."""
    array = np.atleast_1d(np.asarray(values, dtype=float)).ravel()[:count]
    if len(array) != count or not np.all(np.isfinite(array)):
        return
    yield array
    length = np.linalg.norm(array)
    if attribute in ("quat", "axis") and length > 0:
        yield array / length
        yield -array / length


def _put_meshes_into_files(spec: mujoco.MjSpec) -> dict[str, bytes]:
    """Let meshes that stand in the spec refer to OBJ files; return their content by name."""
    files: dict[str, bytes] = {}
    for mesh in spec.meshes:
        if len(mesh.uservert):
            name = mesh.name.rsplit("/", 1)[-1]
            content = spec.assets.get(f"{mesh.name}.obj") or _obj(mesh)
            mesh.file = next(
                file
                for file in (f"{name}.obj", *(f"{name}_{n}.obj" for n in range(1, len(files) + 1)))
                if files.setdefault(file, content) == content
            )
            mesh.uservert, mesh.userface, mesh.usernormal, mesh.userfacenormal = [], [], [], []
    return files


def _obj(mesh: Any) -> bytes:
    """Return a mesh as an OBJ file that holds its single-precision vertices exactly."""
    vertices, normals, faces = (
        np.reshape(numbers, (-1, 3)).tolist()
        for numbers in (mesh.uservert, mesh.usernormal, np.array(mesh.userface) + 1)
    )
    corner = "{0}//{0}" if normals else "{0}"
    corners = [corner.format(index) for index in range(len(vertices) + 1)]
    lines = [f"v {x:.9g} {y:.9g} {z:.9g}\n" for x, y, z in vertices]
    lines += [f"vn {x:.6g} {y:.6g} {z:.6g}\n" for x, y, z in normals]
    lines += [f"f {corners[a]} {corners[b]} {corners[c]}\n" for a, b, c in faces]
    return "".join(lines).encode()


def _write_asset(folder: Path, name: str, content: bytes) -> str:
    """Write a file under its name, or a numbered one if another content has that; return it."""
    folder.mkdir(parents=True, exist_ok=True)
    stem, dot, suffix = name.rpartition(".")
    number = 0
    while (folder / name).exists() and (folder / name).read_bytes() != content:
        number += 1
        name = f"{stem}_{number}{dot}{suffix}"
    (folder / name).write_bytes(content)
    return name


def _copy_asset(spec: mujoco.MjSpec, element: ET.Element, folder: Path) -> str:
    """Copy a file that a scene refers to; return its name in the folder."""
    file = element.get("file", "")
    if file in spec.assets:
        return _write_asset(folder, file, spec.assets[file])
    within = spec.compiler.texturedir if element.tag == "texture" else spec.compiler.meshdir
    source = Path(spec.modelfiledir or ".") / (within or "") / file
    return _write_asset(folder, source.name, source.read_bytes())
