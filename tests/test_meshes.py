"""The drawn meshes: small, of the robot's size, enclosed by its collision shapes, reproducible."""

from __future__ import annotations

import importlib.util
import sys
from pathlib import Path
from types import ModuleType

import mujoco
import numpy as np
import pytest
import trimesh

from kr210_sim.description import Description
from kr210_sim.resources import resource

MAX_BYTES = 2_000_000  # all mesh files together
MAX_TRIANGLES = 40_000
SAMPLES = 4000  # points on the surface of a mesh, beside its corners
COVERED = 0.010  # [m]: how far the visual may stick out of the collision shapes

# Outer size of the real links in their frames [m]: minimum, maximum.
BOXES = {
    "base_link": ((-0.69, -0.50, 0.0), (0.50, 0.50, 0.33)),
    "link_1": ((-0.54, -0.46, 0.0), (0.60, 0.46, 0.66)),
    "link_2": ((-0.25, -0.41, -0.22), (0.23, 0.08, 1.44)),
    "link_3": ((-0.41, -0.18, -0.32), (0.96, 0.29, 0.21)),
    "link_4": ((0.0, -0.17, -0.12), (0.65, 0.16, 0.12)),
    "link_5": ((-0.12, -0.12, -0.12), (0.19, 0.12, 0.12)),
    "link_6": ((0.0, -0.10, -0.10), (0.04, 0.10, 0.10)),
}
BOX_TOLERANCE = 0.02  # [m]
# Where ours is smaller by more than that; assets/kr210/README.md says why.
SMALLER = {
    ("link_1", "min", 1): 0.041, ("link_1", "max", 0): 0.03,
    ("link_2", "min", 0): 0.035, ("link_2", "max", 1): 0.275,
    ("link_3", "min", 2): 0.035, ("link_4", "max", 0): 0.035,
}  # fmt: skip
PALM = (0.15, 0.20, 0.10)
FINGER = (0.15, 0.025, 0.05)  # the V of the jaw adds 9 mm in y


@pytest.fixture(scope="module")
def visuals(description: Description) -> dict[str, list[trimesh.Trimesh]]:
    """The visual meshes of every link in its frame."""
    found: dict[str, list[trimesh.Trimesh]] = {}
    for link in description.model.robot.links:
        for visual in link.visuals:
            path = description.packages.resolve(visual.geometry.mesh.filename, where=link.name)
            mesh = trimesh.load(path, process=False, force="mesh", skip_materials=True)
            if visual.origin is not None:
                mesh.apply_transform(visual.origin)
            found.setdefault(link.name, []).append(mesh)
    return found


def bounds(meshes: list[trimesh.Trimesh]) -> np.ndarray:
    return np.array([
        np.min([mesh.bounds[0] for mesh in meshes], axis=0),
        np.max([mesh.bounds[1] for mesh in meshes], axis=0),
    ])  # fmt: skip


def outside(points: np.ndarray, collisions: list) -> np.ndarray:
    """Return the distance of points (n, 3) from the union of boxes and cylinders, 0 inside."""
    nearest = np.full(len(points), np.inf)
    for collision in collisions:
        T = np.eye(4) if collision.origin is None else collision.origin
        local = (points - T[:3, 3]) @ T[:3, :3]
        shape = collision.geometry
        if shape.box is not None:
            beyond = np.abs(local) - np.asarray(shape.box.size) / 2
        else:
            radial = np.hypot(local[:, 0], local[:, 1]) - shape.cylinder.radius
            beyond = np.column_stack([radial, np.abs(local[:, 2]) - shape.cylinder.length / 2])
        nearest = np.minimum(nearest, np.linalg.norm(np.maximum(beyond, 0), axis=1))
    return nearest


def test_all_meshes_together_are_small():
    files = [
        *resource("assets", "kr210", "meshes").glob("*"),
        *resource("assets", "gripper", "meshes").glob("*"),
    ]
    assert sum(file.stat().st_size for file in files) < MAX_BYTES


def test_every_mesh_file_is_used_once_a_link(description):
    used = [
        description.packages.resolve(visual.geometry.mesh.filename, where=link.name)
        for link in description.model.robot.links
        for visual in link.visuals
    ]
    there = {
        *resource("assets", "kr210", "meshes").glob("*"),
        *resource("assets", "gripper", "meshes").glob("*"),
    }
    assert set(used) == there
    assert len([path for path in used if "finger" not in path.name]) == len(there) - 3


def test_the_robot_is_drawn_with_few_triangles(robot_model):
    assert robot_model.nmeshface < MAX_TRIANGLES


def test_a_link_has_one_visual_a_material_and_at_most_five_collision_shapes(description):
    for link in description.model.robot.links:
        materials = [visual.material.name for visual in link.visuals]
        assert len(materials) == len(set(materials)), link.name
        assert all(shape.geometry.mesh is None for shape in link.collisions), link.name
        assert len(link.collisions) <= 5, link.name


def test_the_meshes_are_closed(visuals):
    for name, meshes in visuals.items():
        for mesh in meshes:
            merged = trimesh.Trimesh(mesh.vertices, mesh.faces, process=False)
            merged.merge_vertices(merge_norm=True, merge_tex=True)
            assert merged.volume > 0, name
            edges = np.sort(merged.edges, axis=1)
            _, uses = np.unique(edges, axis=0, return_counts=True)
            assert np.mean(uses % 2) < 0.002, name


@pytest.mark.parametrize("name", BOXES)
def test_a_link_has_the_size_of_the_real_one(visuals, name):
    found = bounds(visuals[name])
    for side, sign, wanted in zip(("min", "max"), (-1, 1), BOXES[name], strict=True):
        for axis in range(3):
            excess = sign * (found[int(side == "max"), axis] - wanted[axis])
            where = f"{name} {side} {'xyz'[axis]}: {excess:+.3f} m"
            assert excess <= BOX_TOLERANCE, where
            assert excess >= -SMALLER.get((name, side, axis), BOX_TOLERANCE), where


def test_the_gripper_has_the_size_of_the_course_s(visuals):
    palm, finger = (
        np.ptp(bounds(visuals[name]), axis=0)
        for name in ("gripper_link", "right_gripper_finger_link")
    )
    np.testing.assert_allclose(palm, PALM, atol=0.006)
    np.testing.assert_allclose(finger, FINGER, atol=0.010)


def test_the_left_finger_mirrors_the_right_one(visuals):
    right, left = (bounds(visuals[f"{side}_gripper_finger_link"]) for side in ("right", "left"))
    np.testing.assert_allclose(left[:, [0, 2]], right[:, [0, 2]], atol=1e-4)
    np.testing.assert_allclose(left[:, 1], -right[::-1, 1], atol=1e-4)


def test_the_collision_shapes_enclose_what_one_sees(description, visuals):
    for link in description.model.robot.links:
        for index, mesh in enumerate(visuals.get(link.name, [])):
            points, _ = trimesh.sample.sample_surface(mesh, SAMPLES, seed=index)
            points = np.concatenate([points, mesh.vertices])
            distance = outside(points, link.collisions)
            worst = points[distance.argmax()].round(3)
            assert distance.max() <= COVERED, f"{link.name}, mesh {index}: {worst}"


def test_no_links_touch_in_the_zero_configuration(robot_model, spec):
    data = mujoco.MjData(robot_model)
    mujoco.mj_forward(robot_model, data)
    assert data.ncon == 0
    assert len(spec.excludes) == 0


def test_flats_keep_their_edges_and_fillets_their_roundness(robot_model):
    """The normals of the files arrive: a corner has one for each face that meets there sharply."""
    adr, num = robot_model.mesh_vertadr, robot_model.mesh_vertnum
    index = robot_model.mesh("link_6_steel_visual").id
    points = robot_model.mesh_vert[adr[index] : adr[index] + num[index]]
    assert len(points) > 1.5 * len(np.unique(points.round(5), axis=0))


# ---- drawing them again ---------------------------------------------------------------------


def script(folder: str) -> ModuleType:
    """Import a make_meshes.py, which is no part of the package."""
    pytest.importorskip("manifold3d")
    path = resource("assets", folder, "make_meshes.py")
    description = importlib.util.spec_from_file_location(f"{folder}_make_meshes", path)
    assert description is not None
    assert description.loader is not None
    module = importlib.util.module_from_spec(description)
    sys.modules[module.__name__] = module
    description.loader.exec_module(module)
    return module


def bytes_of(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in sorted(folder.iterdir())}


@pytest.fixture(scope="module", params=["kr210", "gripper"])
def drawn(request, tmp_path_factory) -> tuple[str, Path]:
    """What a script is for, and the folder of what it draws."""
    out = tmp_path_factory.mktemp(request.param)
    script(request.param).main(out)
    return request.param, out


@pytest.mark.slow
def test_drawing_twice_gives_the_same_bytes(drawn, tmp_path):
    folder, first = drawn
    script(folder).main(tmp_path)
    assert bytes_of(tmp_path) == bytes_of(first)


@pytest.mark.slow
def test_the_files_are_those_that_the_script_draws(drawn):
    """Other versions of manifold3d may cut a flat into other triangles, so shapes are compared."""
    folder, out = drawn
    kept = resource("assets", folder, "meshes")
    assert {path.name for path in out.iterdir()} == {path.name for path in kept.iterdir()}
    for path in out.iterdir():
        new, old = (
            trimesh.load(x, process=False, force="mesh", skip_materials=True)
            for x in (path, kept / path.name)
        )
        np.testing.assert_allclose(new.bounds, old.bounds, atol=2e-4, err_msg=path.name)
        assert new.area == pytest.approx(old.area, rel=1e-3), path.name
        assert new.volume == pytest.approx(old.volume, rel=1e-3), path.name
