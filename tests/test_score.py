"""Scoring is a pure function of the record: each condition by itself turns the verdict."""

from __future__ import annotations

import ast
import copy
import json
from pathlib import Path

import numpy as np
import pytest

import kr210_sim
from kr210_sim.criteria import CONDITIONS, REASONS
from kr210_sim.record import STAGES, CycleRecord, Event
from kr210_sim.score import CycleScore, score_cycle

LIMIT = 60.0


@pytest.fixture
def record(good_cycle) -> CycleRecord:
    """A cycle that went well, to be falsified."""
    return copy.deepcopy(good_cycle.record)


def judge(record: CycleRecord, *, time_limit: float = LIMIT) -> CycleScore:
    return score_cycle(record, time_limit=time_limit)


def assert_only(score: CycleScore, *conditions: str) -> None:
    """Exactly these conditions fail, and the first of them is the reason."""
    failed = [name for name, holds in score.conditions.items() if not holds]
    assert failed == list(conditions)
    assert not score.success
    assert score.cause is not None
    assert score.cause.reason == CONDITIONS[conditions[0]]


def test_the_untouched_record_is_a_success(record):
    score = judge(record)
    assert score.success
    assert score.cause is None


@pytest.mark.parametrize(
    ("series", "value", "condition"),
    [
        ("slip_m_max", 0.005, "held"),
        ("foreign_contacts_max", 1.0, "clean"),
        ("position_excess_max", 1.01e-4, "within_limits"),
        ("speed_ratio_max", 1.021, "within_limits"),
        ("effort_ratio_max", 0.99, "within_limits"),
    ],
)
def test_one_bad_step_turns_the_verdict(record, series, value, condition):
    step = int(np.argmax(record.series["stage"] == STAGES.index("MOVE_TO_PLACE"))) + 5
    record.series[series][step] = value
    assert_only(judge(record), condition)


@pytest.mark.parametrize(
    ("series", "value"),
    [
        ("slip_m_max", 0.00499),
        ("position_excess_max", 0.99e-4),
        ("speed_ratio_max", 1.0199),
        ("effort_ratio_max", 0.9899),
    ],
)
def test_a_step_just_inside_its_limit_is_good(record, series, value):
    record.series[series][:] = np.minimum(record.series[series], value)
    record.series[series][7] = value
    assert judge(record).success


def test_a_target_held_lower_than_a_centimetre_was_never_lifted(record):
    record.series["clear_height_max"][:] = 0.0099
    assert_only(judge(record), "lifted", "held")


@pytest.mark.parametrize("finger", [0, 1])
@pytest.mark.parametrize("stage", ["WITHDRAW", "MOVE_TO_PLACE", "LOWER"])
def test_one_finger_off_for_a_moment_while_carrying_has_dropped_the_target(record, finger, stage):
    step = np.flatnonzero(record.series["stage"] == STAGES.index(stage))[3]
    record.series["fingers_touch"][step, finger] = 0.0
    assert_only(judge(record), "held")


@pytest.mark.parametrize("stage", ["APPROACH", "RETREAT", "MOVE_HOME"])
def test_fingers_need_not_touch_the_target_when_they_do_not_carry_it(record, stage):
    record.series["fingers_touch"][record.series["stage"] == STAGES.index(stage)] = 0.0
    assert judge(record).success


@pytest.mark.parametrize(
    ("name", "value", "condition"),
    [
        ("fingers_open", 0.0, "released"),
        ("finger_contacts", 1.0, "released"),
        ("resting_for", 0.4999, "placed"),
        ("in_place_volume", 0.0, "placed"),
        ("supported", 0.0, "placed"),
        ("home_distance", 1.01e-3, "returned"),
        ("home_distance", np.nan, "returned"),
        ("resting_for", np.nan, "placed"),
    ],
)
def test_one_bad_fact_at_the_end_turns_the_verdict(record, name, value, condition):
    record.final[name] = value
    assert_only(judge(record), condition)


def test_a_cycle_that_did_not_come_home_is_neither_home_nor_in_time(record):
    record.home_time = None
    score = judge(record)
    assert_only(score, "returned", "in_time")
    assert score.cycle_time_s is None
    assert score.motion_time_s is None


def test_the_time_limit_is_the_last_good_moment(record):
    assert judge(record, time_limit=record.home_time).success
    assert_only(judge(record, time_limit=record.home_time - 1e-6), "in_time")


# ---- the first cause ------------------------------------------------------------------------


def event(reason: str, time: float) -> Event:
    return Event(reason=reason, stage="LIFT", time=time, detail="as the test wants it")


def test_the_earliest_event_is_the_cause_whatever_the_order(record):
    record.home_time = None
    record.events = [event("timeout", 3.0), event("dropped", 1.0), event("collision", 2.0)]
    assert judge(record).cause.reason == "dropped"


def test_an_event_goes_before_a_condition_at_the_end(record):
    record.final["fingers_open"] = 0.0
    record.events = [event("tracking", 2.0)]
    assert judge(record).cause.reason == "tracking"


def test_several_failed_conditions_give_the_first_of_the_list(record):
    record.final |= {"home_distance": 1.0, "in_place_volume": 0.0, "fingers_open": 0.0}
    assert_only(judge(record), "released", "placed", "returned")


@pytest.mark.parametrize("reason", ["tracking", "bad_ik", "simulation_diverged", "collision"])
def test_an_event_always_fails_the_cycle(record, reason):
    record.events = [event(reason, 1.0)]
    score = judge(record)
    assert not score.success
    assert score.cause.reason == reason


def test_a_cycle_that_never_moved_fails_with_its_event_and_has_no_numbers(record):
    empty = CycleRecord(cycle=3, episode=0, seed=1, cell=2, target=record.target)
    empty.events = [event("no_path", 0.0)]
    score = judge(empty)
    assert set(score.conditions.values()) == {None}
    assert score.cause.reason == "no_path"
    line = score.as_json()
    for name in ("cycle_time_s", "motion_time_s", "grasp_slip_m", "place_offset_m"):
        assert line[name] is None
    assert line["tracking_offset_m"] == {"mean": None, "p99": None, "max": None}
    json.dumps(line, allow_nan=False)


def test_the_reasons_are_the_closed_list():
    assert set(REASONS) == {
        "missed_grasp", "dropped", "collision", "limits_exceeded", "not_released", "outside_bin",
        "not_home", "timeout", "bad_ik", "unreachable", "joint_limits", "no_path", "tracking",
        "simulation_diverged",
    }  # fmt: skip
    assert len(REASONS) == len(set(REASONS))
    assert tuple(CONDITIONS) == (
        "lifted", "held", "clean", "within_limits", "released", "placed", "returned", "in_time",
    )  # fmt: skip


def test_no_reason_in_the_code_is_off_the_list():
    """Every literal reason that is raised or noted is one of REASONS."""
    found = set()
    for path in Path(kr210_sim.__file__).parent.glob("*.py"):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if not isinstance(node, ast.Call) or not isinstance(node.func, ast.Name):
                continue
            arguments = {"CycleFailure": node.args[:1], "_Breach": node.args[1:2]}
            literal = arguments.get(node.func.id, [])
            if node.func.id == "Event":
                literal = [key.value for key in node.keywords if key.arg == "reason"]
            found |= {x.value for x in literal if isinstance(x, ast.Constant)}
    assert len(found) > 8
    assert found <= set(REASONS)


# ---- the numbers ----------------------------------------------------------------------------


def test_scoring_twice_gives_the_same_and_changes_nothing(record):
    before = copy.deepcopy(record)
    assert judge(record).as_json() == judge(record).as_json()
    for name, values in before.series.items():
        np.testing.assert_array_equal(record.series[name], values)
    assert record.final == before.final


def test_the_slip_is_the_largest_of_the_carry(record):
    record.series["slip_m_max"][100] = 0.0042
    assert judge(record).grasp_slip_m == pytest.approx(0.0042)


def test_the_place_offset_is_horizontal_from_the_planned_release(record):
    record.p_base_release = np.array([0.1, 2.4, 0.9])
    record.final |= {"target_x": 0.4, "target_y": 2.8, "target_z": -7.0}
    assert judge(record).place_offset_m == pytest.approx(0.5)


def test_a_target_that_was_not_placed_has_no_place_offset(record):
    record.final["in_place_volume"] = 0.0
    assert judge(record).place_offset_m is None


WAITS = [STAGES.index(stage) for stage in ("CLOSE_GRIPPER", "OPEN_GRIPPER", "SETTLE")]


def test_tracking_counts_motion_stages_only(record):
    waiting = np.isin(record.series["stage"], WAITS)
    record.series["tracking_max"][waiting] = 1.0
    score = judge(record)
    assert np.max(score.tracking_offset_m) < 1.0
    assert len(score.tracking_offset_m) == np.sum(~waiting)


def test_motion_time_and_waits_add_up_to_the_cycle_time(record):
    score = judge(record)
    waits = np.isin(record.series["stage"], WAITS[:2])
    assert score.motion_time_s + 0.01 * waits.sum() == pytest.approx(score.cycle_time_s, abs=1e-6)


def test_the_margin_to_slipping_is_what_friction_has_left_at_its_worst(record):
    carried = np.flatnonzero(record.series["stage"] == STAGES.index("MOVE_TO_PLACE"))
    record.series["friction_ratio"][:] = 0.1
    record.series["friction_ratio"][carried[2], 1] = 0.25
    assert judge(record).grasp["slip_margin"] == pytest.approx(0.75)
    record.drawn = {"pad_friction": 0.5}
    assert judge(record).grasp["slip_margin"] == pytest.approx(0.5)


def test_a_grasp_is_described_by_its_weaker_finger(record):
    carried = np.flatnonzero(record.series["stage"] == STAGES.index("MOVE_TO_PLACE"))
    record.series["finger_force"][:] = 240.0
    record.series["finger_force"][carried, 0] = 230.0
    record.series["finger_contacts_min"][:] = 4
    record.series["finger_contacts_min"][carried[0], 1] = 2
    grasp = judge(record).grasp
    assert grasp["grip_force_n"]["min"] == pytest.approx(230.0)
    assert 230.0 < grasp["grip_force_n"]["mean"] < 240.0
    assert grasp["contacts"] == 2


def test_a_target_that_was_never_lifted_has_no_grasp(record):
    record.series["clear_height_max"][:] = 0.0
    assert judge(record).grasp is None
