"""Randomised cycles: where things stand, what simulator and planner have, and whole cycles."""

from __future__ import annotations

import json
from dataclasses import replace

import mujoco
import numpy as np
import pytest
from conftest import standing_target

import kr210_sim.cycle
import kr210_sim.motions
from kr210_sim.config import RunConfig
from kr210_sim.control import Controller
from kr210_sim.cycle import CycleSetup, run_cycle
from kr210_sim.draws import Draws
from kr210_sim.mjcf import PAD_PRIORITY
from kr210_sim.randomize import (
    LogUniform,
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
from kr210_sim.variation import Variation, vary

HARD = read_randomization("hard")
NOMINAL = read_randomization("nominal")


def block(**content) -> Randomization:
    return make_randomization("block", content)


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
