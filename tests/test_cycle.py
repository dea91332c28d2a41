"""Whole cycles: what one leaves behind, in another scene, after a failure, and twice over."""

from __future__ import annotations

import numpy as np
import pytest
from conftest import standing_target

from kr210_sim.cycle import GRIP_STEADY, CycleSetup
from kr210_sim.episodes import Episode, run_episode
from kr210_sim.monitor import GRIP_READY
from kr210_sim.record import RECORD_STEP, STAGES
from kr210_sim.scene import Target
from kr210_sim.simulation import Simulation


@pytest.fixture
def common(limits) -> CycleSetup:
    return CycleSetup(cycle=0, episode=0, seed=0, limits=limits)


def assert_equal_but_for_the_clock(one, other) -> None:
    """Two scores are the same to the last bit, wall clock apart."""
    a, b = one.as_json(), other.as_json()
    a.pop("wall_clock")
    b.pop("wall_clock")
    assert a == b
    for name, values in one.record.series.items():
        np.testing.assert_array_equal(values, other.record.series[name], err_msg=name)
    assert one.record.final == other.record.final


# ---- one cycle ------------------------------------------------------------------------------


def test_the_lift_waits_for_the_grip_and_the_retreat_for_the_release(default_run, robot):
    """No stage ends by a blind sleep: where a wait ends, its condition has just come true."""
    for score in default_run.scores:
        series = score.record.series
        closing = np.flatnonzero(series["stage"] == STAGES.index("CLOSE_GRIPPER"))
        grip = np.min(series["finger_force"][closing], axis=1)
        enough = GRIP_READY * robot.grip_force / 2
        steps = round(GRIP_STEADY / RECORD_STEP)
        assert np.all(grip[-steps:] >= enough)
        # The step before these may have begun without contact and ended with it.
        assert np.all(grip[: -steps - 1] < enough)
        opening = np.flatnonzero(series["stage"] == STAGES.index("OPEN_GRIPPER"))
        assert np.all(series["finger_force"][opening[-1]] == 0.0)


def test_the_target_hangs_between_both_fingers_all_the_way(default_run):
    carrying = [STAGES.index(s) for s in ("WITHDRAW", "MOVE_TO_PLACE", "LOWER")]
    for score in default_run.scores:
        series = score.record.series
        held = np.isin(series["stage"], carrying)
        assert np.all(series["fingers_touch"][held] == 1)
        assert np.all(series["finger_force"][held] > 100.0)
        assert np.max(series["clear_height_max"]) > 0.02


def test_a_placed_target_is_where_the_record_says(good_cycle, scene):
    final = good_cycle.record.final
    p_base = np.array([final["target_x"], final["target_y"], final["target_z"]])
    assert scene.place.contains(p_base)
    assert good_cycle.place_offset_m < 0.3


def test_the_ik_offset_is_that_of_every_pose_asked_for(default_run):
    for score in default_run.scores:
        assert len(score.ik_offset_m) == len(score.ik_offset_rad) > 50
        assert np.max(score.ik_offset_m) <= 1e-12
        assert np.max(score.ik_offset_rad) <= 1e-12
        assert np.max(score.tracking_offset_m) <= 2e-3


def test_a_target_of_ten_kilograms_is_carried_like_any_other(one_cycle, scene):
    score = one_cycle(target=standing_target(scene, 5, mass=10.0))
    assert score.success, score.cause


# ---- another scene --------------------------------------------------------------------------


@pytest.mark.parametrize(
    "cells", [(4,), pytest.param((1, 2, 3, 4), marks=pytest.mark.slow)], ids=["one", "all"]
)
def test_a_scene_nobody_tuned_for_passes(turned_scene, common, cells):
    episode = Episode(
        index=0,
        first_cycle=0,
        seeds=(0,) * len(cells),
        cells=cells,
        all_from_start=True,
    )
    for score in run_episode(turned_scene, episode, common, mass=1.0):
        assert score.success, (score.record.cell, score.cause)
        assert np.max(score.ik_offset_m) <= 1e-12
        assert np.max(score.tracking_offset_m) <= 2e-3


# ---- cycles that cannot be planned ----------------------------------------------------------


def moved(target: Target, *offset: float) -> Target:
    T = target.T_base_target.copy()
    T[:3, 3] += offset
    return Target(number=target.number, cell=target.cell, mass=target.mass, T_base_target=T)


def test_a_target_out_of_reach_fails_before_anything_moves(one_cycle, scene):
    far = moved(standing_target(scene, 5), 3.0, 0.0, 0.0)
    score = one_cycle(target=far)
    assert (score.cause.reason, score.cause.time) == ("unreachable", 0.0)
    assert set(score.conditions.values()) == {None}


def test_a_target_behind_a_wall_has_no_path(one_cycle, scene):
    walled = scene.spec.copy()
    walled.worldbody.add_geom(name="wall", type=6, size=[0.02, 3.0, 3.0], pos=[2.2, 0.0, 1.5])
    world = type(scene)(**(vars(scene) | {"spec": walled}))
    score = one_cycle(world=world)
    assert (score.cause.reason, score.cause.time) == ("no_path", 0.0)
    assert "within" in score.cause.detail


# ---- one after the other --------------------------------------------------------------------


def wreck(kind: str):
    """Return a probe that ruins the first cycle it sees, and leaves the others alone."""
    seen: list[str] = []

    def probe(simulation: Simulation, stage: str, time: float) -> None:
        if "target_0" not in simulation.targets or stage != "MOVE_TO_PLACE" or seen:
            return
        seen.append(stage)
        data = simulation.data
        if kind == "numbers":
            data.qvel[:] = np.nan
        else:
            data.qvel[simulation.addresses.arm_dof] = 3.0

    return probe


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["numbers", pytest.param("arm", marks=pytest.mark.slow)])
def test_a_failed_cycle_leaves_the_next_as_if_it_had_not_been(scene, common, default_run, kind):
    """The cycle after it is, to the last bit, the first one of the default run."""
    first = default_run.scores[0]
    episode = Episode(
        index=0,
        first_cycle=0,
        seeds=(0, first.record.seed),
        cells=(5, first.record.cell),
        all_from_start=False,
    )
    scores = [score for score in run_episode(scene, episode, common, mass=1.0, probe=wreck(kind))]
    assert not scores[0].success
    assert scores[1].success, scores[1].cause
    for name, values in first.record.series.items():
        np.testing.assert_array_equal(values, scores[1].record.series[name], err_msg=name)


def test_a_failed_cycle_does_not_disturb_what_lies_in_the_bin(scene, one_cycle):
    simulation = Simulation(scene)
    simulation.add(standing_target(scene, 5))
    lying = simulation.data.joint("target_0").qpos
    lying[:3] = scene.place.T_base_place[:3, 3] + [0.0, 0.0, -0.34]
    simulation.step(np.tile(simulation.data.ctrl, (600, 1)))
    before = simulation.positions()["target_0"]

    def kick(world: Simulation, stage: str, _time: float) -> None:
        if stage == "WITHDRAW":
            world.data.joint("target_1").qvel[:3] = [0.0, 0.0, 30.0]

    second = standing_target(scene, 5, number=1)
    score = one_cycle(kick, simulation=simulation, target=second)
    assert not score.success
    simulation.remove("target_1")
    simulation.restart(score.record.start)
    np.testing.assert_allclose(simulation.positions()["target_0"], before, atol=1e-6)
    np.testing.assert_array_equal(simulation.data.qpos[simulation.addresses.arm], 0.0)
    assert not simulation.diverged
    assert set(simulation.targets) == {"target_0"}


# ---- twice over -----------------------------------------------------------------------------


def test_the_same_seed_gives_the_same_bits(default_run, scene, common):
    """The first two cycles of the default run again, in an episode of two, with a looker-on."""
    records = [score.record for score in default_run.scores[:2]]
    episode = Episode(
        index=0,
        first_cycle=0,
        seeds=tuple(record.seed for record in records),
        cells=tuple(record.cell for record in records),
        all_from_start=False,
    )
    seen: list[float] = []

    def look(simulation: Simulation, _stage: str, _time: float) -> None:
        seen.append(float(simulation.data.qpos.sum()))

    again = run_episode(scene, episode, common, mass=1.0, probe=look)
    for first, second in zip(default_run.scores[:2], again, strict=True):
        assert_equal_but_for_the_clock(first, second)
    assert len(seen) == sum(len(record.series["time"]) for record in records)
