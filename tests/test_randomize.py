"""Randomisation: blocks that are read or refused, draws of a seed, and what a cycle makes of it."""

from __future__ import annotations

import json
import math
from dataclasses import replace

import mujoco
import numpy as np
import pytest
from conftest import standing_target

import kr210_sim.cycle
import kr210_sim.motions
from kr210_sim.cli import main
from kr210_sim.config import RunConfig
from kr210_sim.control import Controller
from kr210_sim.cycle import CycleSetup, run_cycle
from kr210_sim.draws import Draws
from kr210_sim.episodes import TARGET_LENGTH, episode_targets, plan_episodes
from kr210_sim.exceptions import BadInput
from kr210_sim.mjcf import PAD_PRIORITY
from kr210_sim.randomize import (
    PRESETS,
    QUANTITIES,
    LogUniform,
    Normal,
    Randomization,
    Uniform,
    make_randomization,
    read_randomization,
)
from kr210_sim.record import load_series
from kr210_sim.results import read_lines
from kr210_sim.room import Room
from kr210_sim.runner import run
from kr210_sim.scene import ROBOT_PREFIX
from kr210_sim.simulation import Simulation
from kr210_sim.variation import Variation, check_block, vary

HARD = read_randomization("hard")
NOMINAL = read_randomization("nominal")


def block(**content) -> Randomization:
    return make_randomization("block", content)


# ---- what is refused ------------------------------------------------------------------------

BAD_FILES = {
    "unknown quantity": ('colour = { uniform = [0, 1] }', "colour"),
    "unknown distribution": ('target_x_m = { triangle = [0, 1] }', "triangle"),
    "two distributions": ('target_x_m = { uniform = [0, 1], normal = [0, 1] }', "one of"),
    "reversed": ('target_x_m = { uniform = [0.2, 0.1] }', "low <= high"),
    "one bound": ('target_x_m = { uniform = [0.2] }', "low <= high"),
    "text": ('target_x_m = { uniform = ["a", "b"] }', "low <= high"),
    "true": ("target_x_m = true", "no distribution"),
    "nan": ("target_x_m = nan", "no distribution"),
    "infinite": ('target_x_m = { uniform = [0, inf] }', "low <= high"),
    "huge": ("target_x_m = 1" + "0" * 400, "no distribution"),
    "log of zero": ('target_mass_kg = { log_uniform = [0, 1] }', "0 < low"),
    "negative sigma": ('perceived_shift_m = { normal = [0, -1] }', "sigma >= 0"),
    "empty choice": ("cell = { choice = [] }", "list of numbers"),
    "friction above 1": ('pad_friction = { uniform = [0.5, 1.1] }', "0.01 to 1"),
    "friction normal": ('target_friction = { normal = [0.8, 0.1] }', "without bounds"),
    "no mass": ("target_mass_kg = 0", "0.001"),
    "half a cell": ("cell = { choice = [1, 2.5] }", "whole"),
    "cells between": ("cell = { uniform = [1, 9] }", "whole"),
    "off its length": ("target_com_m = 0.03\ntarget_length_m = 0.15", "sixth"),
    "no TOML": ("target_x_m = = 1", "TOML"),
}  # fmt: skip


@pytest.mark.parametrize("case", BAD_FILES)
def test_a_bad_file_is_refused_in_one_line_that_names_file_field_and_remedy(tmp_path, case, capsys):
    text, says = BAD_FILES[case]
    path = tmp_path / "bad.toml"
    path.write_text(text)
    assert main(["run", "--randomize", str(path), "--out", str(tmp_path / "run")]) == 2
    line = capsys.readouterr().err
    assert line.count("\n") == 1
    assert "--randomize" in line
    assert str(path) in line
    assert says in line
    if case != "no TOML":
        assert text.split(" ")[0] in line
    assert "give" in line or "correct" in line
    assert not (tmp_path / "run").exists()


def test_a_file_that_is_missing_or_of_another_kind_is_refused(tmp_path):
    for name in ("nothing.toml", "nonsense"):
        with pytest.raises(BadInput, match="course, nominal, hard"):
            RunConfig(randomize=str(tmp_path / name))
    (tmp_path / "block.yaml").write_text("")
    with pytest.raises(BadInput, match="rename"):
        RunConfig(randomize=str(tmp_path / "block.yaml"))
    (tmp_path / "list.json").write_text("[1]")
    with pytest.raises(BadInput, match="table"):
        RunConfig(randomize=str(tmp_path / "list.json"))


def test_what_the_robot_or_the_scene_cannot_do_is_refused(scene):
    for content, says in (
        ({"target_mass_kg": 17.0}, "more than the grip holds"),
        ({"cell": {"choice": [1, 10]}}, "no cell 10"),
        ({"target_com_m": 0.05}, "sixth"),
    ):
        with pytest.raises(BadInput, match=says):
            check_block(block(**content), scene, TARGET_LENGTH)


def test_a_cell_named_twice_is_refused(tmp_path):
    path = tmp_path / "cells.toml"
    path.write_text("cell = 4")
    with pytest.raises(BadInput, match="leave one away"):
        RunConfig(randomize=str(path), cell="3")


def test_a_range_without_room_is_refused_and_not_searched_for_ever(scene):
    target = standing_target(scene, 5)
    with pytest.raises(BadInput, match="cell 5"):
        vary(scene, [target], [0], block(target_y_m={"uniform": [0.39, 0.41]}))


# ---- presets --------------------------------------------------------------------------------


def test_the_presets_have_the_ranges_promised():
    assert dict(read_randomization("course").block) == {}
    assert NOMINAL.block["target_x_m"] == Uniform(-0.02, 0.02)
    assert NOMINAL.block["target_radius_m"] == Uniform(0.048, 0.052)
    assert NOMINAL.block["target_mass_kg"] == LogUniform(0.05, 5.0)
    assert NOMINAL.block["pad_friction"] == Uniform(0.6, 1.0)
    assert NOMINAL.block["perceived_shift_m"] == Normal(0.0, 0.002)
    assert NOMINAL.block["perceived_turn_rad"] == Normal(0.0, math.radians(1))
    assert HARD.block["target_y_m"] == Uniform(-0.05, 0.05)
    assert HARD.block["target_length_m"] == Uniform(0.20, 0.30)
    assert HARD.block["target_com_m"] == Uniform(-0.03, 0.03)
    assert HARD.block["perceived_turn_rad"] == Normal(0.0, math.radians(3))
    assert HARD.block["actuator_delay_s"] == Uniform(0.0, 0.004)
    assert HARD.block["start_rad"] == Uniform(-0.2, 0.2)


def test_json_and_toml_give_the_same_block(tmp_path):
    content = {"target_x_m": {"uniform": [-0.01, 0.01]}, "payload_kg": 2}
    (tmp_path / "a.json").write_text(json.dumps(content))
    (tmp_path / "a.toml").write_text("target_x_m = { uniform = [-0.01, 0.01] }\npayload_kg = 2")
    blocks = [read_randomization(str(tmp_path / name)).block for name in ("a.json", "a.toml")]
    assert blocks[0] == blocks[1] == block(**content).block


# ---- draws ----------------------------------------------------------------------------------


@pytest.mark.parametrize("name", PRESETS)
def test_a_thousand_draws_keep_their_ranges_and_reach_their_ends(name):
    randomization = read_randomization(name)
    draws = [Draws(randomization.block, seed) for seed in range(1000)]
    for quantity, distribution in randomization.block.items():
        drawn = np.array([cycle.vector(quantity) for cycle in draws])
        assert drawn.shape == (1000, QUANTITIES[quantity].count)
        if isinstance(distribution, Normal):
            np.testing.assert_allclose(drawn.mean(), distribution.mean, atol=0.1 * drawn.std())
            np.testing.assert_allclose(drawn.std(), distribution.sigma, rtol=0.05)
            continue
        low, high = distribution.bounds
        assert np.all((drawn >= low) & (drawn <= high))
        if isinstance(distribution, LogUniform):
            low, high, drawn = np.log(low), np.log(high), np.log(drawn)
        share = (drawn - low) / (high - low)
        assert share.min() < 0.02
        assert share.max() > 0.98
        np.testing.assert_allclose(share.mean(), 0.5, atol=0.03)


def test_a_seed_always_draws_the_same_and_another_seed_something_else():
    for name in HARD.block:
        assert Draws(HARD.block, 7).vector(name) == Draws(HARD.block, 7).vector(name)
        assert Draws(HARD.block, 7).vector(name) != Draws(HARD.block, 8).vector(name)


def test_a_quantity_does_not_depend_on_which_others_are_random():
    alone = block(target_mass_kg={"log_uniform": [0.05, 10.0]})
    draws = Draws(HARD.block, 3)
    for _ in range(5):
        draws.vector("target_x_m")
    assert draws.number("target_mass_kg") == Draws(alone.block, 3).number("target_mass_kg")


def test_draws_of_a_cycle_do_not_depend_on_other_cycles(scene):
    targets = [standing_target(scene, cell, number=cell - 1) for cell in (1, 5, 9)]
    together = vary(scene, targets, [11, 22, 33], HARD)
    alone = vary(scene, targets[2:], [33], HARD)
    assert together[2][1].drawn == alone[0][1].drawn
    np.testing.assert_array_equal(together[2][0].T_base_target, alone[0][0].T_base_target)


def test_seeds_and_cells_are_those_without_randomisation(scene):
    plain, hard = (
        list(plan_episodes(RunConfig(cycles=20, randomize=name), scene)) for name in (None, "hard")
    )
    assert plain == hard


def test_a_block_may_draw_the_cell(scene, tmp_path):
    path = tmp_path / "cells.toml"
    path.write_text("cell = { choice = [2, 4] }")
    config = RunConfig(cycles=40, randomize=str(path))
    episodes = list(plan_episodes(config, scene))
    assert {cell for episode in episodes for cell in episode.cells} == {2, 4}
    _, variation = episode_targets(scene, episodes[0], 1.0, config.randomization())[0]
    assert variation.drawn == {"cell": episodes[0].cells[0]}


def test_every_quantity_of_a_block_is_drawn_and_kept(scene):
    [(_, variation)] = vary(scene, [standing_target(scene, 5)], [1], HARD)
    assert set(variation.drawn) == set(HARD.block)
    assert json.loads(json.dumps(variation.drawn)) == variation.drawn


# ---- where things stand ---------------------------------------------------------------------


def test_a_target_over_the_edge_or_in_an_upright_does_not_stand_free(scene):
    target = standing_target(scene, 5)
    room = Room(scene, target)

    def moved(x: float, y: float, z: float = 0.0) -> bool:
        T = target.T_base_target.copy()
        T[:3, 3] += [x, y, z]
        return room.stands_free(replace(target, T_base_target=T))

    assert moved(0.0, 0.0)
    assert moved(-0.059, 0.0)  # the front edge is 0.11 m before the middle of the cell
    assert not moved(-0.061, 0.0)
    assert moved(0.0, 0.349)
    assert not moved(0.0, 0.351)  # the upright begins at 0.40 m
    assert not moved(0.0, 0.0, 0.002)


def test_a_target_in_an_upright_is_drawn_again_until_it_stands_free(scene):
    wide = block(target_y_m={"uniform": [-0.5, 0.5]})
    first = [Draws(wide.block, seed).number("target_y_m") for seed in range(20)]
    targets = [standing_target(scene, 5)] * 20
    drawn = [
        variation.drawn["target_y_m"] for _, variation in vary(scene, targets, range(20), wide)
    ]
    assert max(map(abs, drawn)) < 0.35
    assert any(abs(value) > 0.35 for value in first)
    for before, after in zip(first, drawn, strict=True):
        assert (before == after) == (abs(before) < 0.35)


def test_a_start_configuration_is_clear_of_the_shelf(scene):
    wide = block(start_rad={"uniform": [-0.6, 0.6]})
    targets = [standing_target(scene, 5)] * 20
    room = Room(scene, targets[0])
    first = np.array([Draws(wide.block, seed).vector("start_rad") for seed in range(20)])
    clear = [room.clear(q[None], targets[0]) for q in first]
    assert any(clear)
    assert not all(clear)
    for q, kept, (_, variation) in zip(
        first, clear, vary(scene, targets, range(20), wide), strict=True
    ):
        assert room.clear(variation.q_start[None], targets[0])
        assert np.array_equal(variation.q_start, q) == kept


# ---- what the simulator has -----------------------------------------------------------------


@pytest.fixture(scope="module")
def hard_cycle(scene):
    """A world as the sequencer makes it from a block, with the target and what else was drawn."""
    with_load = make_randomization(
        "hard and a load", {"payload_kg": {"uniform": [1.0, 2.0]}} | hard_content()
    )
    [(target, variation)] = vary(scene, [standing_target(scene, 5)], [4], with_load)
    simulation = Simulation(scene)
    simulation.add(target)
    simulation.alter_robot(
        pad_friction=variation.pad_friction, gain=variation.gain, payload=variation.payload
    )
    simulation.watch(target)
    return simulation, target, variation.drawn


def hard_content() -> dict:
    kinds = {Uniform: "uniform", LogUniform: "log_uniform"}
    return {
        name: {kinds[type(item)]: list(item.bounds)}
        if type(item) in kinds
        else {"normal": [item.mean, item.sigma]}
        for name, item in HARD.block.items()
    }


def test_the_compiled_target_is_the_one_drawn(hard_cycle):
    simulation, target, drawn = hard_cycle
    model = simulation.model
    body, geom = model.body(target.name), model.geom(target.name)
    mass, radius, length, com = (
        drawn[f"target_{name}"] for name in ("mass_kg", "radius_m", "length_m", "com_m")
    )
    np.testing.assert_allclose(body.mass[0], mass)
    np.testing.assert_allclose(body.ipos, [0, 0, com])
    assert model.body_gravcomp[body.id] == 0
    across = mass * (3 * radius**2 + length**2) / 12 - mass * com**2
    np.testing.assert_allclose(body.inertia, [across, across, mass * radius**2 / 2])
    np.testing.assert_allclose(geom.friction, [drawn["target_friction"], 0.005, 0.002])
    start = int(model.mesh_vertadr[geom.dataid[0]])
    points = model.mesh_vert[start : start + int(model.mesh_vertnum[geom.dataid[0]])]
    np.testing.assert_allclose(np.hypot(points[:, 0], points[:, 1]), radius, atol=1e-6)
    np.testing.assert_allclose(np.abs(points[:, 2]), length / 2, atol=1e-6)


def test_the_compiled_robot_is_the_one_drawn(hard_cycle, scene):
    simulation, _, drawn = hard_cycle
    model, plain = simulation.model, Simulation(scene).model
    pads = [geom for geom in range(model.ngeom) if model.geom_priority[geom] == PAD_PRIORITY]
    assert len(pads) == 4
    np.testing.assert_allclose(model.geom_friction[pads, 0], drawn["pad_friction"])
    for name, factor in zip(scene.robot.arm_joints, drawn["actuator_gain"], strict=True):
        index = int(model.actuator(ROBOT_PREFIX + name).id)
        before = int(plain.actuator(ROBOT_PREFIX + name).id)
        for field in ("actuator_gainprm", "actuator_biasprm"):
            np.testing.assert_allclose(
                getattr(model, field)[index], factor * getattr(plain, field)[before]
            )
    load = model.body(f"{ROBOT_PREFIX}unknown_payload")
    np.testing.assert_allclose(load.mass[0], drawn["payload_kg"])
    assert model.body_gravcomp[load.id] == 0
    np.testing.assert_allclose(
        model.body_mass.sum() - plain.body_mass.sum(),
        drawn["payload_kg"] + drawn["target_mass_kg"],
    )


def test_the_next_cycle_has_the_robot_of_the_description_again(hard_cycle, scene):
    simulation = Simulation(scene)
    target = standing_target(scene, 5)
    simulation.add(target)
    plain = Simulation(scene)
    plain.add(target)
    simulation.alter_robot(pad_friction=0.4, gain=np.full(6, 1.1), payload=2.0)
    simulation.watch(target)
    simulation.alter_robot()
    for world in (simulation, plain):
        world.watch(target)
    for field in ("geom_friction", "actuator_gainprm", "actuator_biasprm", "body_mass"):
        np.testing.assert_array_equal(getattr(simulation.model, field), getattr(plain.model, field))


def test_the_friction_of_a_target_counts_against_its_board_and_that_of_the_pads_in_the_grip(scene):
    target = replace(standing_target(scene, 5), friction=0.4)
    simulation = Simulation(scene)
    simulation.add(target)
    simulation.alter_robot(pad_friction=0.7)
    simulation.watch(target)
    mujoco.mj_step(simulation.model, simulation.data, 50)
    contacts = simulation.data.contact
    assert len(contacts.friction)
    np.testing.assert_allclose(contacts.friction[:, 0], 0.4)
    assert simulation.model.geom(target.name).priority[0] < PAD_PRIORITY


def test_commands_arrive_as_late_as_was_drawn_and_otherwise_the_same(scene):
    simulation = Simulation(scene)
    prompt, late = Controller(simulation), Controller(simulation, 0.004)
    steps = round(0.004 / simulation.model.opt.timestep)
    rows = []
    for controller in (prompt, late):
        controller.drive_fingers(scene.robot.finger_closed)
        rows.append(np.concatenate([controller.next(20).ctrl for _ in range(5)]))
    assert np.ptp(rows[0]) > 0
    np.testing.assert_array_equal(rows[1][steps:], rows[0][:-steps])
    np.testing.assert_array_equal(rows[1][:steps], np.repeat(rows[0][:1], steps, axis=0))


# ---- what the planner knows -----------------------------------------------------------------


def test_planning_takes_a_target_for_upright_and_for_the_heaviest_that_may_come(scene):
    targets = [standing_target(scene, cell) for cell in (1, 5, 9)]
    for target, variation in vary(scene, targets, [1, 2, 3], HARD):
        believed = variation.believed(target, scene)
        seen, T = variation.T_base_perceived, believed.T_base_target
        cell = scene.cell(target.cell).T_base_cell
        np.testing.assert_allclose(T[:2, 3], seen[:2, 3])
        np.testing.assert_allclose(T[2, 3], cell[2, 3] + target.length / 2)
        np.testing.assert_allclose(T[:3, 2], [0, 0, 1], atol=1e-12)
        np.testing.assert_allclose(T[:3, :3] @ T[:3, :3].T, np.eye(3), atol=1e-12)
        assert believed.mass == 10.0
        assert believed.com == 0.0


def test_the_planner_is_told_the_perceived_pose_and_never_the_true_one(scene, limits, monkeypatch):
    """A spy on every door through which a target reaches planning."""
    true = standing_target(scene, 5)
    perceived = true.T_base_target.copy()
    perceived[:2, 3] += [0.003, -0.002]
    raised = perceived.copy()
    raised[2, 3] += 0.001
    told: list[np.ndarray] = []

    def spy_oracle(simulation, place, target):
        told.append(target.T_base_target)
        return real_oracle(simulation, place, target)

    def spy_picks(T_base_target, *arguments):
        told.append(T_base_target)
        return real_picks(T_base_target, *arguments)

    real_oracle, real_picks = kr210_sim.cycle.MujocoOracle, kr210_sim.motions.pick_options
    monkeypatch.setattr(kr210_sim.cycle, "MujocoOracle", spy_oracle)
    monkeypatch.setattr(kr210_sim.motions, "pick_options", spy_picks)
    monkeypatch.setattr(kr210_sim.cycle._Cycle, "run", lambda *_: None)
    simulation = Simulation(scene)
    simulation.add(true)
    setup = CycleSetup(
        cycle=0,
        episode=0,
        seed=0,
        limits=limits,
        variation=Variation(T_base_perceived=raised),
    )
    run_cycle(simulation, true, setup)
    assert len(told) >= 2
    for pose in told:
        np.testing.assert_allclose(pose, perceived, atol=1e-12)
    np.testing.assert_allclose(simulation.data.body(true.name).xpos, true.T_base_target[:3, 3])


# ---- whole cycles ---------------------------------------------------------------------------


@pytest.mark.slow
def test_a_nominal_run_is_repeatable_and_says_what_was_drawn(tmp_path):
    lines = []
    for name in ("one", "two"):
        run(RunConfig(cycles=3, seed=5, randomize="nominal", out=tmp_path / name))
        text = (tmp_path / name / "cycles.jsonl").read_text()
        lines.append([json.loads(line) for line in text.splitlines()])
    for first, second in zip(*lines, strict=True):
        assert first["success"]
        assert set(first["drawn"]) == set(NOMINAL.block)
        assert first["target"]["mass_kg"] == first["drawn"]["target_mass_kg"]
        first.pop("wall_clock"), second.pop("wall_clock")
        assert first == second


@pytest.mark.slow
def test_a_cycle_that_starts_away_from_home_ends_there(tmp_path):
    path = tmp_path / "start.toml"
    path.write_text("start_rad = { uniform = [-0.1, 0.1] }\nactuator_delay_s = 0.002")
    out, _ = run(RunConfig(cycles=2, randomize=str(path), out=tmp_path / "run"))
    for line in read_lines(out):
        q = load_series(out / "cycles" / f"{line['cycle']:04d}.npz")["qpos"][0, :6]
        assert line["success"]
        assert line["returned"]
        np.testing.assert_allclose(q, line["drawn"]["start_rad"], atol=1e-3)
