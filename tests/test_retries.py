"""Another try at a grasp: when there is one, by what it is noticed, and what is said of it."""

from __future__ import annotations

import json
from itertools import groupby

import numpy as np
import pytest
from conftest import RunOneCycle, standing_target
from probes import TARGET, assert_failed, once, set_pad_friction
from test_cycle import assert_equal_but_for_the_clock

from kr210_sim.config import RunConfig
from kr210_sim.cycle import Probe
from kr210_sim.draws import Draws
from kr210_sim.exceptions import BadInput
from kr210_sim.grip import Grip
from kr210_sim.limits import MotionLimits
from kr210_sim.randomize import make_randomization
from kr210_sim.record import RECORD_STEP, STAGES
from kr210_sim.runner import run
from kr210_sim.scene import Scene
from kr210_sim.score import CycleScore
from kr210_sim.simulation import Simulation
from kr210_sim.summary import cycle_line, summary_text
from kr210_sim.variation import Variation

SHORT = {"perceived_depth_m": -0.12}
"""Every look is this short: all tries close in front of the target [m]."""


def seen(scene: Scene, *, first: float, later: float | None = None) -> Variation:
    """Return what makes the first look err along the cell's x [m], and later ones, if they do."""
    T = standing_target(scene, 5).T_base_target.copy()
    T[:3, 3] += first * scene.cell(5).T_base_cell[:3, 0]
    block = {} if later is None else {"perceived_depth_m": later}
    draws = Draws(make_randomization("a test", block).block, seed=0)
    return Variation(T_base_perceived=T, draws=draws)


def loses_friction(after: float) -> Probe:
    """Take the pads' friction some time into the lift [s], until the gripper has opened again."""
    lose = once("LIFT", lambda simulation: set_pad_friction(simulation, 1e-6), after=after)
    back = once("BACK_OUT", lambda simulation: set_pad_friction(simulation, 1.0), after=0.3)
    return lambda *now: (lose(*now), back(*now))[0]


def stages_of(score: CycleScore) -> list[str]:
    """The stages in the order in which they came."""
    return [STAGES[int(index)] for index, _ in groupby(score.record.series["stage"])]


@pytest.fixture(scope="module")
def recovered(one_cycle: RunOneCycle, scene: Scene) -> CycleScore:
    """A cycle whose first look is 0.12 m short, and whose second is right."""
    return one_cycle(variation=seen(scene, first=-0.12), retries=1)


# ---- a grasp that missed --------------------------------------------------------------------


def test_a_missed_grasp_is_tried_again_where_the_target_is_seen_then(recovered):
    assert recovered.success, recovered.cause
    first = ["MOVE_TO_PICK", "APPROACH", "CLOSE_GRIPPER", "BACK_OUT"]
    home = STAGES.index("MOVE_HOME") + 1
    # a target that rests by then leaves nothing to wait for
    assert stages_of(recovered)[: len(first) + home] == [*first, *STAGES[:home]]
    assert set(stages_of(recovered)[len(first) + home :]) <= {"SETTLE"}
    (attempt,) = recovered.retried
    assert (attempt["reason"], attempt["stage"]) == ("missed_grasp", "CLOSE_GRIPPER")
    assert attempt["detail"] == "the fingers have closed on nothing"
    assert not attempt["lifted"]
    assert all(recovered.conditions.values())


def test_a_recovered_cycle_says_so_everywhere(recovered):
    line = recovered.as_json()
    assert (line["success"], line["first_try"], line["retries"]) == (True, False, 1)
    text = cycle_line(line)
    assert "success, try 2" in text
    assert "try 1: missed_grasp, CLOSE_GRIPPER at" in text
    json.dumps(line, allow_nan=False)


def test_the_time_of_every_try_counts(recovered, one_cycle):
    straight = one_cycle()
    (attempt,) = recovered.retried
    lost = attempt["until_s"]
    assert lost > attempt["time_s"] + 0.5  # the look alone
    assert recovered.cycle_time_s > straight.cycle_time_s + 1.0
    assert recovered.cycle_time_s == recovered.record.home_time
    assert len(recovered.ik_offset_m) > 1.5 * len(straight.ik_offset_m)


def test_without_retries_the_same_miss_is_a_failure(one_cycle, scene, impatient):
    score = one_cycle(variation=seen(scene, first=-0.12))
    assert_failed(score, "missed_grasp", "lifted", "CLOSE_GRIPPER")
    line = score.as_json()
    assert (line["first_try"], line["retries"], line["retried"]) == (False, 0, [])


def test_when_no_try_is_left_the_cycle_has_failed(one_cycle, scene, impatient):
    score = one_cycle(variation=seen(scene, first=-0.12, later=-0.12), retries=1)
    assert_failed(score, "missed_grasp", "lifted", "CLOSE_GRIPPER")
    (attempt,) = score.retried
    assert attempt["drawn"] == {"perceived_depth_m": -0.12}
    assert score.cause.time > attempt["until_s"] > attempt["time_s"]
    assert not score.as_json()["first_try"]


# ---- a target that was dropped --------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize(
    ("after", "reason"),
    [(0.08, "dropped"), (0.02, "missed_grasp")],
)
def test_a_target_that_slides_back_onto_its_board_is_taken_again(one_cycle, after, reason):
    score = one_cycle(loses_friction(after), retries=1)
    assert score.success, score.cause
    (attempt,) = score.retried
    assert (attempt["reason"], attempt["stage"]) == (reason, "LIFT")
    assert "the pads carry 0.00 kg" in attempt["detail"]
    assert attempt["lifted"] == (reason == "dropped")
    assert score.grasp_slip_m < 2e-3  # of the second grasp


@pytest.mark.slow
def test_a_target_dropped_in_the_cell_by_fingers_that_open_is_taken_again(one_cycle):
    def act(simulation: Simulation, grip: float) -> None:
        simulation.model.actuator_forcerange[simulation.addresses.finger_ctrl] = [-grip, grip]

    lose = once("LIFT", lambda simulation: act(simulation, 0.5), after=0.1)
    back = once("BACK_OUT", lambda simulation: act(simulation, 500.0), after=0.1)
    score = one_cycle(lambda *now: (lose(*now), back(*now))[0], retries=1)
    assert score.success, score.cause
    assert [attempt["reason"] for attempt in score.retried] == ["dropped"]
    assert "pad feels" in score.retried[0]["detail"]


@pytest.mark.slow
def test_a_target_that_has_fallen_over_is_not_taken_again(one_cycle):
    def topple(simulation: Simulation) -> None:
        simulation.data.joint(TARGET).qvel[:] = [0.8, 0.0, 0.0, 0.0, 6.0, 0.0]

    lose, fell = loses_friction(0.02), once("BACK_OUT", topple, after=1.0)
    score = one_cycle(lambda *now: (lose(*now), fell(*now))[0], retries=3)
    assert not score.success
    assert len(score.retried) == 1
    assert score.cause.reason in ("missed_grasp", "collision")
    assert score.cause.stage == "BACK_OUT"


@pytest.mark.slow
def test_a_target_lost_outside_its_cell_is_not_taken_again(one_cycle):
    lose = once("MOVE_TO_PLACE", lambda simulation: set_pad_friction(simulation, 1e-6))
    score = one_cycle(lose, retries=3)
    assert_failed(score, "dropped", "held", "MOVE_TO_PLACE")
    assert score.retried == []


@pytest.mark.slow
def test_a_collision_on_the_way_out_is_no_reason_to_try_again(one_cycle, scene):
    def move_shelf(simulation: Simulation) -> None:
        simulation.model.opt.enableflags = 0  # with sleep static bodies stay where they were
        simulation.model.body("shelf").pos[1] += 0.3

    score = one_cycle(once("BACK_OUT", move_shelf), variation=seen(scene, first=-0.12), retries=3)
    assert_failed(score, "collision", "clean", "BACK_OUT")
    assert len(score.retried) == 1


# ---- what the gripper knows -----------------------------------------------------------------


@pytest.mark.slow
def test_what_the_gripper_does_not_feel_is_not_tried_again(one_cycle, monkeypatch):
    """The judge sees the target slide; the gripper must notice by itself."""
    monkeypatch.setattr(Grip, "feel", lambda *_: None)
    score = one_cycle(loses_friction(0.08), retries=3)
    assert_failed(score, "dropped", "held", "LIFT")
    assert score.retried == []


@pytest.mark.slow
@pytest.mark.parametrize("mass", [0.05, 5.0], ids=lambda mass: f"{mass:g} kg")
def test_a_good_grasp_is_never_given_up(one_cycle, scene, mass):
    """The tries that are allowed change nothing, not a bit, as long as the first holds."""
    target = standing_target(scene, 2, mass=mass)
    without, allowed = (one_cycle(target=target, retries=retries) for retries in (0, 3))
    assert allowed.success
    assert allowed.as_json()["first_try"]
    assert_equal_but_for_the_clock(without, allowed)


@pytest.mark.slow
def test_a_slow_lift_is_not_taken_for_a_missed_one(one_cycle, robot):
    """At a fifth of the speed the board carries its share for many record steps."""
    score = one_cycle(retries=1, limits=MotionLimits.from_velocity(robot.velocity, 0.2))
    assert score.success, score.cause
    assert score.retried == []


@pytest.mark.slow
def test_the_brake_keeps_the_arm_on_its_path_and_within_its_limits(one_cycle, scene, limits):
    score = one_cycle(loses_friction(0.12), retries=1)
    assert score.success, score.cause
    series = score.record.series
    assert np.max(series["speed_ratio_max"]) <= 1.0 + 1e-3
    assert np.max(series["effort_ratio_max"]) < 0.9
    q = series["ctrl"][:, :6]
    assert np.max(np.abs(np.diff(q, n=2, axis=0)) / RECORD_STEP**2 / limits.acceleration) < 1.6


# ---- runs -----------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize("jobs", [1, 2])
def test_a_run_counts_first_tries_and_retries_apart(tmp_path, jobs):
    """Of three cycles that see the target 0.07 m short or not, some miss at first."""
    block = tmp_path / "short.toml"
    block.write_text("perceived_depth_m = { choice = [0.0, -0.12] }")
    config = RunConfig(
        cycles=4, episode_cycles=2, seed=3, randomize=str(block), retries=4, jobs=jobs,
        out=tmp_path / "run", record="none",
    )  # fmt: skip
    out, summary = run(config)
    lines = [json.loads(line) for line in (out / "cycles.jsonl").read_text().splitlines()]
    missed = [line for line in lines if line["drawn"]["perceived_depth_m"] < 0]
    assert 0 < len(missed) < 4
    assert [line["cycle"] for line in lines if line["retries"]] == [m["cycle"] for m in missed]
    assert summary["success_rate"] == 1.0
    assert summary["first_try"]["succeeded"] == 4 - len(missed)
    assert summary["retries"]["recovered"] == len(missed)
    assert summary["retries"]["made"] == sum(line["retries"] for line in lines)
    assert summary["retries"]["reasons"] == {"missed_grasp": summary["retries"]["made"]}
    text = summary_text(summary)
    assert f"first try      {4 - len(missed)} of 4 succeeded" in text
    assert f"after retries  {len(missed)} more succeeded" in text


@pytest.mark.parametrize("count", [-1, 101])
def test_an_impossible_number_of_retries_is_bad_input(count):
    with pytest.raises(BadInput, match=r"--retries: .* give 0 to 100"):
        RunConfig(retries=count)
