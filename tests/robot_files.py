"""The test descriptions with meshes made on the spot: boxes whose bounds are known exactly."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import trimesh

ROBOTS = Path(__file__).parent / "robots"

# Bounds of every link's shape in its own frame [m], lower and upper corner.
HEAVY = {
    "base_link": ((-0.30, -0.30, 0.0), (0.30, 0.30, 0.28)),
    "link_1": ((-0.25, -0.12, 0.02), (0.40, 0.12, 0.50)),
    "link_2": ((-0.12, 0.13, -0.15), (0.12, 0.27, 1.42)),
    "link_3": ((-0.25, -0.12, -0.25), (0.38, 0.12, 0.12)),
    "link_4": ((0.02, -0.10, -0.10), (0.90, 0.10, 0.10)),
    "link_5": ((-0.09, -0.09, -0.09), (0.13, 0.09, 0.09)),
    "link_6": ((0.0, -0.07, -0.07), (0.03, 0.07, 0.07)),
}
JAW_BASE = ((-0.05, -0.10, 0.005), (0.05, 0.10, 0.115))
JAW_FINGER = ((-0.03, 0.0, 0.0), (0.03, 0.02, 0.18))
OFFSET = {
    "base_link": ((-0.30, -0.30, 0.0), (0.30, 0.30, 0.35)),
    "shoulder": ((-0.25, -0.10, 0.0), (0.38, 0.10, 0.50)),
    "upper_arm": ((-0.12, 0.02, -0.15), (0.12, 0.16, 1.32)),
    "elbow": ((-0.20, -0.10, -0.20), (0.48, 0.08, 0.12)),
    "forearm": ((0.02, -0.10, -0.10), (0.65, 0.10, 0.10)),
    "wrist": ((-0.09, -0.09, -0.09), (0.15, 0.09, 0.09)),
    "hand": ((0.0, -0.07, -0.07), (0.03, 0.07, 0.07)),
}
TURNED = {
    "pedestal": ((-0.30, -0.30, 0.0), (0.30, 0.30, 0.40)),
    "a": ((-0.25, -0.14, 0.0), (0.36, 0.14, 0.42)),
    "b": ((-0.12, -1.30, 0.17), (0.12, 0.15, 0.30)),
    "c": ((-0.15, -0.25, -0.13), (0.20, 0.45, 0.13)),
    "d": ((-0.10, -0.10, -0.82), (0.10, 0.10, -0.14)),
    "e": ((-0.09, -0.09, -0.09), (0.09, 0.14, 0.09)),
    "f": ((-0.07, -0.07, 0.0), (0.07, 0.07, 0.03)),
}

Bounds = tuple[tuple[float, float, float], tuple[float, float, float]]


def box(bounds: Bounds) -> trimesh.Trimesh:
    return trimesh.creation.box(bounds=np.array(bounds))


def write_dae(path: Path, bounds: Bounds) -> None:
    """A box in two colours, in inches with y up, below two nodes that scale unevenly and turn."""
    mesh = box(bounds)
    turned = trimesh.transformations.rotation_matrix(0.3, [0, 0, 1])
    stretched = np.diag([2.0, 0.5, 1.25, 1.0])
    stretched[:3, 3] = [4.0, -7.0, 1.5]
    y_up_to_z_up = np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])
    in_scene = mesh.vertices @ y_up_to_z_up / 0.0254  # its inverse, applied to rows
    local = trimesh.transform_points(in_scene, np.linalg.inv(turned @ stretched))
    triangles = "".join(
        f'<triangles material="m{i}" count="{len(faces)}"><input semantic="VERTEX" source="#v" '
        f'offset="0"/><p>{" ".join(map(str, faces.ravel()))}</p></triangles>'
        for i, faces in enumerate((mesh.faces[:6], mesh.faces[6:]))
    )
    colors = ("1 0.4 0.1 1", "0.2 0.2 0.2 1")
    effects = "".join(
        f'<effect id="e{i}"><profile_COMMON><technique sid="t"><lambert><diffuse><color>{color}'
        "</color></diffuse></lambert></technique></profile_COMMON></effect>"
        for i, color in enumerate(colors)
    )
    materials = "".join(
        f'<material id="mat{i}"><instance_effect url="#e{i}"/></material>' for i in range(2)
    )
    binds = "".join(f'<instance_material symbol="m{i}" target="#mat{i}"/>' for i in range(2))

    def matrix(T: np.ndarray) -> str:
        return f"<matrix>{' '.join(repr(float(x)) for x in T.ravel())}</matrix>"

    numbers = " ".join(repr(float(x)) for x in local.ravel())
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(
        '<?xml version="1.0"?><COLLADA xmlns="http://www.collada.org/2005/11/COLLADASchema" '
        'version="1.4.1"><asset><unit name="inch" meter="0.0254"/><up_axis>Y_UP</up_axis></asset>'
        f"<library_effects>{effects}</library_effects>"
        f"<library_materials>{materials}</library_materials>"
        '<library_geometries><geometry id="g"><mesh><source id="p"><float_array id="a" '
        f'count="{local.size}">{numbers}</float_array><technique_common><accessor source="#a" '
        f'count="{len(local)}" stride="3"><param name="X" type="float"/><param name="Y" '
        'type="float"/><param name="Z" type="float"/></accessor></technique_common></source>'
        '<vertices id="v"><input semantic="POSITION" source="#p"/></vertices>'
        f"{triangles}</mesh></geometry></library_geometries>"
        f'<library_visual_scenes><visual_scene id="s"><node>{matrix(turned)}<node>'
        f'{matrix(stretched)}<instance_geometry url="#g"><bind_material><technique_common>{binds}'
        "</technique_common></bind_material></instance_geometry></node></node></visual_scene>"
        '</library_visual_scenes><scene><instance_visual_scene url="#s"/></scene></COLLADA>'
    )


def write_mesh(path: Path, bounds: Bounds, scale: float = 1.0, *, ascii_stl: bool = False) -> None:
    mesh = box(bounds)
    mesh.apply_scale(scale)
    path.parent.mkdir(parents=True, exist_ok=True)
    mesh.export(path, file_type="stl_ascii" if ascii_stl else None)


def heavy_arm(folder: Path) -> Path:
    """Write the two packages; return the xacro."""
    support, jaw = folder / "heavy_arm_support", folder / "jaw_description"
    for package in (support, jaw):
        shutil.copytree(ROBOTS / package.name, package)
    for name, bounds in HEAVY.items():
        write_dae(support / "meshes" / "visual" / f"{name}.dae", bounds)
        write_mesh(
            support / "meshes" / "collision" / f"{name}.stl", bounds, ascii_stl=name == "link_3"
        )
    write_dae(jaw / "meshes" / "visual" / "jaw_base.dae", JAW_BASE)
    write_mesh(jaw / "meshes" / "finger.stl", JAW_FINGER)
    return support / "urdf" / "heavy_arm.urdf.xacro"


def offset_arm(folder: Path) -> Path:
    """Write the URDF and its meshes; return it."""
    for name, bounds in OFFSET.items():
        write_mesh(folder / "meshes" / f"{name}.obj", bounds, 1000.0)
        write_mesh(folder / "meshes" / f"{name}.stl", bounds)
    path = folder / "offset_arm.urdf"
    shutil.copy(ROBOTS / path.name, path)
    return path


def turned_arm(folder: Path) -> Path:
    """Write the URDF and its meshes, named by absolute file:// paths; return it."""
    for name, bounds in TURNED.items():
        write_mesh(folder / "meshes" / f"{name}.obj", bounds)
        write_mesh(folder / "meshes" / f"{name}.stl", bounds)
    path = folder / "turned_arm.urdf"
    text = (ROBOTS / path.name).read_text(encoding="utf-8")
    path.write_text(text.replace("file://MESHES", (folder / "meshes").as_uri()), encoding="utf-8")
    return path
