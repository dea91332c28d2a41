"""The files of foreign descriptions: packages and paths are found, meshes read as they are."""

from __future__ import annotations

import sys
import xml.etree.ElementTree as ET
from pathlib import Path

import numpy as np
import pytest
import trimesh
from robot_files import (
    HEAVY,
    JAW_FINGER,
    box,
    offset_arm,
    turned_arm,
    write_dae,
)

from kr210_sim.exceptions import BadInput
from kr210_sim.loading import load_robot
from kr210_sim.meshes import convex_pieces, load_mesh
from kr210_sim.packages import Packages
from kr210_sim.source import RobotSource

pytestmark = pytest.mark.slow


# ---- paths ----------------------------------------------------------------------------------


def package(folder: Path, name: str) -> Path:
    folder.mkdir(parents=True)
    (folder / "package.xml").write_text(f"<package><name>{name}</name></package>")
    return folder


def test_packages_are_found_by_name_then_search_path_then_above_the_robot(tmp_path):
    robot = package(tmp_path / "ws" / "my_robot", "my_robot") / "urdf" / "arm.urdf"
    beside = package(tmp_path / "ws" / "shared", "shared")
    other = package(tmp_path / "elsewhere" / "shared", "shared")
    named = package(tmp_path / "named", "anything")
    assert Packages(robot, search=()).find("my_robot") == robot.parent.parent
    assert Packages(robot, search=()).find("shared") == beside
    assert Packages(robot, search=(tmp_path / "elsewhere",)).find("shared") == other
    everything = Packages(robot, {"shared": named}, search=(tmp_path / "elsewhere",))
    assert everything.find("shared") == named


def test_ros_package_path_is_read(tmp_path, monkeypatch):
    found = package(tmp_path / "share" / "parts", "parts")
    monkeypatch.setenv("ROS_PACKAGE_PATH", f"/nowhere:{tmp_path / 'share'}")
    assert Packages(tmp_path / "a" / "arm.urdf").find("parts") == found


@pytest.mark.parametrize("form", ["package://r/m/a.stl", "model://r/m/a.stl", "m/a.stl", "file://"])
def test_every_form_of_path_leads_to_the_same_file(tmp_path, form):
    folder = package(tmp_path / "r", "r")
    path = folder / "m" / "a.stl"
    path.parent.mkdir()
    path.touch()
    form = path.as_uri() if form == "file://" else form
    packages = Packages(folder / "arm.urdf", search=())
    assert packages.resolve(form, where="here") == path


# ---- meshes ---------------------------------------------------------------------------------


def bounds(parts) -> np.ndarray:
    points = np.concatenate([part.vertices for part in parts])
    return np.array([points.min(axis=0), points.max(axis=0)])


def test_a_dae_is_read_in_metres_z_up_with_its_transforms_and_colours(tmp_path):
    write_dae(tmp_path / "a.dae", HEAVY["link_1"])
    parts = load_mesh(tmp_path / "a.dae", None, where="here")
    np.testing.assert_allclose(bounds(parts), HEAVY["link_1"], atol=1e-6)
    assert {part.rgba for part in parts} == {(1.0, 0.4, 0.1, 1.0), (0.2, 0.2, 0.2, 1.0)}


@pytest.mark.parametrize("kind", ["stl", "stl_ascii", "obj"])
def test_stl_and_obj_keep_their_bounds_under_an_uneven_scale(tmp_path, kind):
    path = tmp_path / f"a.{kind[:3]}"
    box(JAW_FINGER).export(path, file_type=kind)
    parts = load_mesh(path, [2.0, -1.0, 0.5], where="here")
    expected = np.array(JAW_FINGER) * [2.0, -1.0, 0.5]
    np.testing.assert_allclose(bounds(parts), np.sort(expected, axis=0), atol=1e-7)
    mesh = trimesh.Trimesh(parts[0].vertices, parts[0].faces)
    assert mesh.volume == pytest.approx(0.06 * 0.02 * 0.18, rel=1e-5)  # still right side out


def test_separate_bodies_are_separate_pieces(tmp_path):
    pair = trimesh.util.concatenate([box(((0, 0, 0), (1, 1, 1))), box(((3, 0, 0), (4, 1, 1)))])
    pair.export(tmp_path / "pair.stl")
    pieces, notes = convex_pieces(load_mesh(tmp_path / "pair.stl", None, where="x"), where="x")
    assert [len(piece.vertices) for piece in pieces] == [8, 8]
    assert notes == ()


def ring(folder: Path) -> Path:
    path = folder / "ring.stl"
    trimesh.creation.annulus(0.1, 0.3, 0.4, sections=16).export(path)
    return path


def test_a_concave_mesh_is_split_so_that_its_hole_stays_open(tmp_path):
    pytest.importorskip("coacd")
    pieces, notes = convex_pieces(load_mesh(ring(tmp_path), None, where="x"), where="part x")
    assert len(pieces) > 1
    assert "part x" in notes[0]
    hulls = [trimesh.Trimesh(piece.vertices, piece.faces) for piece in pieces]
    assert not any(hull.contains([[0.0, 0.0, 0.0]])[0] for hull in hulls)


def test_without_coacd_the_hull_takes_its_place_and_it_is_said(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "coacd", None)
    pieces, notes = convex_pieces(load_mesh(ring(tmp_path), None, where="x"), where="part x")
    assert len(pieces) == 1
    assert "kr210-sim[convex]" in notes[0]


def test_a_flat_collision_mesh_becomes_a_sheet(tmp_path):
    flat = trimesh.Trimesh([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], [[0, 1, 2], [0, 2, 3]])
    flat.export(tmp_path / "flat.stl")
    pieces, notes = convex_pieces(load_mesh(tmp_path / "flat.stl", None, where="x"), where="x")
    assert np.ptp(pieces[0].vertices, axis=0)[2] == pytest.approx(0.001)
    assert "flat" in notes[0]


def test_a_missing_visual_mesh_is_drawn_by_the_collision_mesh(tmp_path):
    path = offset_arm(tmp_path)
    (tmp_path / "meshes" / "elbow.obj").unlink()
    model = load_robot(RobotSource(path=path))
    assert any("elbow.obj" in note and "'r1_elbow'" in note for note in model.notes)
    kinds = [geom.classname.name for geom in model.spec.body("r1_elbow").geoms]
    assert sorted(kinds) == ["collision", "visual"]


def test_a_moving_link_with_nothing_to_touch_is_refused(tmp_path):
    path = turned_arm(tmp_path)
    tree = ET.parse(path)
    link = tree.getroot().find("link[@name='arm/c']")
    link.remove(link.find("collision"))
    tree.write(path)
    with pytest.raises(BadInput, match=r"'arm/c'.*<collision>"):
        load_robot(RobotSource(path=path))
