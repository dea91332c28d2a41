"""A scene is plain MJCF by a convention: it is read, or refused by what breaks the convention."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest
from conftest import standing_target

from kr210_sim.exceptions import BadInput
from kr210_sim.mjcf import TIMESTEP
from kr210_sim.physics import OPTIONS
from kr210_sim.scene import (
    DEFAULT_TIME_LIMIT,
    ROBOT_PREFIX,
    PlaceVolume,
    build_scene,
    find_scene,
    list_scenes,
)
from kr210_sim.simulation import Simulation

WORLD = """
<mujoco model="tiny">
  <compiler angle="degree"/>
  <worldbody>
    <geom name="floor" type="plane" size="0 0 0.05"/>
    <site name="robot_base" pos="0 0 0"/>
    <body name="shelf" pos="2.4 0 0">
      <geom name="board" type="box" size="0.3 0.8 0.05" pos="0 0 0.75"/>
    </body>
    <site name="cell_1" pos="2.3 0.3 0.8"/>
    <site name="cell_2" pos="2.3 -0.3 0.8" euler="0 0 20"/>
    <body name="bin" pos="0 2.2 0"><geom type="box" size="0.4 0.4 0.05" pos="0 0 0.05"/></body>
    <site name="place" type="box" size="0.4 0.4 0.3" pos="0 2.2 0.4"/>
    <camera name="side" pos="0 -4 2"/>
  </worldbody>
</mujoco>
"""


@pytest.fixture
def build(robot, spec, tmp_path):
    """Build a scene from the text of a world."""

    def make(text: str, name: str = "tiny.xml"):
        path = tmp_path / name
        path.write_text(text)
        return build_scene(path, robot, spec)

    return make


@pytest.fixture
def refusal(build):
    """Build a damaged world; return the one line it is refused with."""

    def make(text: str) -> str:
        with pytest.raises(BadInput) as caught:
            build(text)
        message = str(caught.value)
        assert "\n" not in message
        assert "tiny.xml" in message, message
        return message

    return make


# ---- what is read ---------------------------------------------------------------------------


def test_cells_are_read_in_order_of_their_numbers(build):
    scene = build(WORLD)
    assert [cell.number for cell in scene.cells] == [1, 2]
    np.testing.assert_allclose(scene.cell(1).T_base_cell[:3, 3], [2.3, 0.3, 0.8])
    np.testing.assert_allclose(scene.cell(2).T_base_cell[:3, 3], [2.3, -0.3, 0.8])
    yaw = np.radians(20)
    np.testing.assert_allclose(scene.cell(2).T_base_cell[:2, 0], [np.cos(yaw), np.sin(yaw)])


def test_the_support_of_a_cell_is_the_geom_under_it(build):
    assert build(WORLD).cell(1).support == "board"


def test_a_support_without_a_name_gets_one(build):
    scene = build(WORLD.replace('<geom name="board"', "<geom"))
    support = {cell.support for cell in scene.cells}
    assert len(support) == 1
    assert scene.spec.geom(support.pop()) is not None


def test_poses_are_told_in_the_frame_of_the_robot_base(build):
    moved = WORLD.replace(
        '"robot_base" pos="0 0 0"', '"robot_base" pos="0.5 -1 0.2" euler="0 0 90"'
    )
    here, there = build(WORLD), build(moved)
    for cell in there.cells:
        T_world_cell = there.T_world_base @ cell.T_base_cell
        np.testing.assert_allclose(T_world_cell, here.cell(cell.number).T_base_cell, atol=1e-12)
    np.testing.assert_allclose(
        there.T_world_base @ there.place.T_base_place, here.place.T_base_place, atol=1e-12
    )
    root = mujoco.MjData(model := there.spec.copy().compile())
    mujoco.mj_kinematics(model, root)
    body = root.body(ROBOT_PREFIX + there.robot.root)
    np.testing.assert_allclose(body.xpos, there.T_world_base[:3, 3], atol=1e-12)
    np.testing.assert_allclose(body.xmat.reshape(3, 3), there.T_world_base[:3, :3], atol=1e-12)


def test_a_target_in_a_cell_stands_on_its_board(build):
    T = build(WORLD).stand_in_cell(2, 0.25)
    np.testing.assert_allclose(T[:3, 3], [2.3, -0.3, 0.925])
    np.testing.assert_allclose(T[:3, 2], [0, 0, 1])


def test_a_target_in_a_cell_does_not_change_the_cell(build):
    scene = build(WORLD)
    scene.stand_in_cell(1, 0.25)[:] = 0.0
    np.testing.assert_allclose(scene.cell(1).T_base_cell[:3, 3], [2.3, 0.3, 0.8])


@pytest.mark.parametrize(
    ("site", "inside", "outside"),
    [
        ('type="box" size="0.4 0.2 0.3"', [0.39, 0.19, 0.29], [0.39, 0.21, 0.0]),
        ('type="box" size="0.4 0.2 0.3" euler="0 0 90"', [0.19, 0.39, 0.0], [0.39, 0.19, 0.0]),
        ('type="cylinder" size="0.4 0.3"', [0.28, 0.28, 0.29], [0.29, 0.29, 0.0]),
        ('type="cylinder" size="0.4 0.3"', [0.0, 0.0, -0.29], [0.0, 0.0, 0.31]),
    ],
)
def test_the_place_volume_has_the_shape_and_size_of_its_site(build, site, inside, outside):
    place = build(WORLD.replace('type="box" size="0.4 0.4 0.3"', site)).place
    centre = np.array([0.0, 2.2, 0.4])
    assert place.contains(centre)
    assert place.contains(centre + inside)
    assert not place.contains(centre + outside)


def test_a_place_that_is_no_number_contains_nothing():
    place = PlaceVolume(kind="box", T_base_place=np.eye(4), half_size=np.ones(3))
    assert not place.contains(np.full(3, np.nan))


def test_the_time_limit_is_sixty_seconds_unless_the_scene_says_otherwise(build):
    assert build(WORLD).time_limit == DEFAULT_TIME_LIMIT == 60.0
    custom = '<custom><numeric name="time_limit" data="12.5"/></custom><worldbody>'
    assert build(WORLD.replace("<worldbody>", custom)).time_limit == 12.5


def test_cameras_are_named_in_file_order(build, scene):
    assert build(WORLD).cameras == ("side",)
    assert {"overview", "shelf", "bin"} <= set(scene.cameras)


def test_the_scene_file_is_not_changed_by_building_it(build, tmp_path):
    build(WORLD)
    assert (tmp_path / "tiny.xml").read_text() == WORLD


def test_two_scenes_share_nothing(build, spec):
    bodies = len(spec.bodies)
    first, second = build(WORLD, "a.xml"), build(WORLD, "b.xml")
    first.spec.worldbody.add_body(name="extra")
    assert second.spec.body("extra") is None
    assert len(spec.bodies) == bodies


# ---- the physics ----------------------------------------------------------------------------


def test_the_physics_options_are_ours_in_every_scene(build, scene, turned_scene):
    for world in (build(WORLD), scene, turned_scene):
        option = world.spec.copy().compile().opt
        for field, value in OPTIONS.items():
            np.testing.assert_array_equal(getattr(option, field), value, err_msg=field)
    assert OPTIONS["timestep"] == TIMESTEP


def test_a_scene_without_options_has_nothing_to_note(build, scene, turned_scene):
    assert (build(WORLD).notes, scene.notes, turned_scene.notes) == ((), (), ())


@pytest.mark.parametrize(
    ("option", "word"),
    [
        ('<option timestep="0.01"/>', "timestep"),
        ('<option integrator="RK4"/>', "integrator"),
        ('<option gravity="0 0 -1.62"/>', "gravity"),
        ('<option cone="elliptic" solver="CG"/>', "solver"),
        ('<option><flag contact="disable"/></option>', "flag"),
        ('<option density="1000"/>', "density"),
        ('<option viscosity="5"/>', "viscosity"),
        ('<option wind="10 0 0"/>', "wind"),
        ('<option noslip_iterations="20"/>', "noslip"),
        ('<option iterations="2"/>', "iterations"),
        ('<option magnetic="1 0 0"/>', "magnetic"),
        ('<option o_margin="0.1"><flag override="enable"/></option>', "flag"),
        ('<option o_friction="9 9 9 9 9"><flag override="enable"/></option>', "flag"),
    ],
)
def test_an_option_of_the_scene_that_differs_is_replaced_and_noted(build, scene, option, word):
    world = build(WORLD.replace("<worldbody>", f"{option}<worldbody>"))
    assert any(word in note for note in world.notes), world.notes
    theirs, ours = (x.spec.copy().compile().opt for x in (world, scene))
    for field in ("density", "viscosity", "wind", "noslip_iterations", "iterations", *OPTIONS):
        np.testing.assert_array_equal(getattr(theirs, field), getattr(ours, field), field)


def test_compiler_settings_and_defaults_of_a_scene_change_neither_robot_nor_target(build):
    settings = """<compiler boundmass="50" boundinertia="3" inertiafromgeom="true"/>
    <default><geom friction="0.1 0.1 0.1" solref="0.1 1" solimp="0.5 0.6 0.1" margin="0.05"
      gap="0.01" priority="3" condim="1" solmix="5" contype="2" conaffinity="4"/>
    <joint damping="9" armature="3"/><mesh scale="2 2 2"/></default>"""
    plain, changed = build(WORLD), build(WORLD.replace("<worldbody>", settings + "<worldbody>"))
    assert len(changed.notes) == 3, changed.notes
    models = []
    for world in (plain, changed):
        simulation = Simulation(world)
        simulation.add(standing_target(world, 1))
        models.append(simulation.model)
    fields = "size friction solref solimp solmix margin gap priority condim contype conaffinity"
    for field in fields.split():
        mine, other = (_solid(model, getattr(model, f"geom_{field}")) for model in models)
        np.testing.assert_equal(mine, other, err_msg=field)
    for field in ("body_mass", "body_inertia", "body_ipos", "dof_damping", "dof_armature"):
        mine, other = (getattr(model, field) for model in models)
        np.testing.assert_array_equal(mine, other, err_msg=field)


def _solid(model, values):
    """Values of the geoms of robot and target that take part in contacts, by name."""
    names = [model.geom(index).name for index in range(model.ngeom)]
    return {
        name: value
        for name, value in zip(names, values, strict=True)
        if name.startswith(("robot/", "target")) and not name.endswith("_visual")
    }


@pytest.mark.parametrize("which", ["scene", "turned_scene"])
def test_targets_stand_still_on_their_boards(request, which):
    scene = request.getfixturevalue(which)
    simulation = Simulation(scene)
    for index, cell in enumerate(scene.cells):
        simulation.add(standing_target(scene, cell.number, number=index))
    start = simulation.positions()
    simulation.step(np.tile(simulation.data.ctrl, (round(0.5 / TIMESTEP), 1)))
    for name, position in simulation.positions().items():
        if name in simulation.targets:
            moved = np.linalg.norm(position[:3] - start[name][:3])
            assert moved < 5e-4, (name, moved)


def test_a_target_has_the_inertia_of_a_solid_cylinder(scene):
    simulation = Simulation(scene)
    simulation.add(standing_target(scene, 5, mass=2.0))
    body = simulation.model.body("target_0")
    across = 2.0 * (3 * 0.05**2 + 0.25**2) / 12
    assert body.mass[0] == 2.0
    np.testing.assert_allclose(sorted(body.inertia), sorted([across, across, 0.0025]))
    np.testing.assert_array_equal(body.ipos, 0.0)


# ---- what is refused ------------------------------------------------------------------------


def test_bundled_scenes_are_found_by_name_and_others_by_path(tmp_path):
    assert "shelf_and_bin" in list_scenes()
    for name in list_scenes():
        assert find_scene(name).stem == name
    path = tmp_path / "mine.xml"
    path.write_text(WORLD)
    assert find_scene(str(path)) == path


def test_an_unknown_scene_is_refused_with_the_names_that_exist():
    with pytest.raises(BadInput, match=r"nosuch.*shelf_and_bin"):
        find_scene("nosuch")


@pytest.mark.parametrize("site", ["robot_base", "place"])
def test_a_missing_site_is_refused_by_name(refusal, site):
    assert f"'{site}'" in refusal(WORLD.replace(f'name="{site}"', 'name="other"'))


@pytest.mark.parametrize("body", ["shelf", "bin"])
def test_a_missing_body_is_refused_by_name(refusal, body):
    assert f"'{body}'" in refusal(WORLD.replace(f'<body name="{body}"', '<body name="other"'))


@pytest.mark.parametrize("name", ["cell_3", "cell_0", "cell", "cell_x", "cell_02"])
def test_cells_must_be_numbered_without_a_gap(refusal, name):
    world = WORLD.replace('name="cell_2"', f'name="{name}"').replace("cell_1", "cell_4")
    assert "cell" in refusal(world)


def test_a_scene_without_cells_is_refused(refusal):
    world = WORLD.replace('name="cell_1"', 'name="a"').replace('name="cell_2"', 'name="b"')
    assert "cell_1" in refusal(world)


def test_a_tilted_cell_is_refused_by_name(refusal):
    message = refusal(WORLD.replace('euler="0 0 20"', 'euler="0 5 20"'))
    assert "'cell_2'" in message
    assert "tilted" in message


def test_a_tilted_place_is_refused(refusal):
    assert "tilted" in refusal(
        WORLD.replace('pos="0 2.2 0.4"/>', 'pos="0 2.2 0.4" euler="9 0 0"/>')
    )


def test_a_tilted_robot_base_is_refused(refusal):
    assert "robot_base" in refusal(
        WORLD.replace('"robot_base" pos="0 0 0"', '"robot_base" pos="0 0 0" euler="0 8 0"')
    )


@pytest.mark.parametrize("height", ["0.803", "0.79", "1.2", "-0.1"])
def test_a_cell_that_is_not_on_a_surface_is_refused_by_name(refusal, height):
    message = refusal(WORLD.replace("2.3 0.3 0.8", f"2.3 0.3 {height}"))
    assert "'cell_1'" in message


def test_a_picture_of_a_board_supports_nothing(refusal):
    world = WORLD.replace('<geom name="board"', '<geom name="board" contype="0" conaffinity="0"')
    assert "'cell_1'" in refusal(world)


def test_a_place_of_another_shape_is_refused(refusal):
    assert "box or cylinder" in refusal(WORLD.replace('type="box" size="0.4 0.4 0.3"', 'size="1"'))


@pytest.mark.parametrize("limit", ["0", "-3", "nan", "inf"])
def test_an_impossible_time_limit_is_refused(refusal, limit):
    custom = f'<custom><numeric name="time_limit" data="{limit}"/></custom><worldbody>'
    assert "time_limit" in refusal(WORLD.replace("<worldbody>", custom))


@pytest.mark.parametrize("text", ["", "<mujoco>", "<robot/>", WORLD.replace("<site", "<sight")])
def test_a_file_that_is_no_mjcf_is_refused(refusal, text):
    refusal(text)


def test_a_scene_that_already_has_a_target_of_that_name_is_refused(refusal):
    body = '<body name="target_0"><freejoint/><geom size="0.1"/></body></worldbody>'
    assert "target_0" in refusal(WORLD.replace("</worldbody>", body))
