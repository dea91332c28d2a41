"""Randomisation: blocks that are read or refused, and the draws of a seed."""

from __future__ import annotations

import json
import math

import numpy as np
import pytest
from conftest import standing_target

from kr210_sim.cli import main
from kr210_sim.config import RunConfig
from kr210_sim.draws import Draws
from kr210_sim.episodes import TARGET_LENGTH, episode_targets, plan_episodes
from kr210_sim.exceptions import BadInput
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
from kr210_sim.variation import check_block, vary

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
    "too wide": ("perceived_shift_m = { uniform = [-1e308, 1e308] }", "low <= high"),
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
