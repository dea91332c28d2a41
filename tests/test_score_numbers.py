"""The score of records small enough to be reckoned in the head, at every limit and over retries."""

from __future__ import annotations

import json
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from kr210_sim.gripper import PAD_FRICTION
from kr210_sim.record import STAGES, CycleRecord, Event, Retry
from kr210_sim.score import CycleScore, score_cycle
from kr210_sim.stats import histogram

STEP = 0.5
"""Of these records [s]."""

TRY = ("MOVE_TO_PICK", "APPROACH", "CLOSE_GRIPPER", "LIFT", "LIFT")
REST = (
    "WITHDRAW", "MOVE_TO_PLACE", "MOVE_TO_PLACE", "LOWER", "OPEN_GRIPPER", "RETREAT", "MOVE_HOME",
)  # fmt: skip
RAISED = 4
"""First step of an attempt at which the target is up; it is in the air at the one before."""


def made(stages: tuple[str, ...] = TRY + REST) -> CycleRecord:
    """A cycle of one record step a stage, home with the last of them, in which all is well."""
    count = len(stages)
    carried = np.isin(stages, ["LIFT", "WITHDRAW", "MOVE_TO_PLACE", "LOWER"])
    series = {
        "time": STEP * np.arange(1, count + 1),
        "stage": np.array([STAGES.index(stage) for stage in stages], dtype=float),
        "tracking_max": 1e-4 * np.arange(1, count + 1),
        "finger_force": np.where(carried[:, None], [200.0, 220.0], 0.0),
        "friction_ratio": np.where(carried[:, None], [0.25, 0.125], 0.0),
        "fingers_touch": np.where(carried[:, None], [1.0, 1.0], 0.0),
        "finger_contacts_min": np.where(carried[:, None], [4.0, 3.0], 0.0),
        "clear_height_max": np.where(carried, 0.02, 0.0),
        "slip_m_max": np.where(carried, 0.001, 0.0),
        "slip_rad_max": np.where(carried, 0.002, 0.0),
        "position_excess_max": np.zeros(count),
        "speed_ratio_max": np.full(count, 0.5),
        "effort_ratio_max": np.full(count, 0.5),
        "foreign_contacts_max": np.zeros(count),
    }
    for step in range(RAISED):
        series["clear_height_max"][step] = min(series["clear_height_max"][step], 0.009)
    return CycleRecord(
        cycle=3,
        episode=1,
        seed=7,
        cell=5,
        target={"mass_kg": 1.0},
        series=series,
        final={
            "fingers_open": 1.0, "finger_contacts": 0.0, "resting_for": 0.6, "supported": 1.0,
            "in_place_volume": 1.0, "home_distance": 0.0, "target_x": 1.3, "target_y": 2.0,
        },
        p_base_release=np.array([1.0, 2.4, 9.0]),
        ik_offset_m=np.array([1e-9, 3e-9]),
        ik_offset_rad=np.array([2e-9, 4e-9]),
        clearance_m={"MOVE_TO_PICK": 0.04, "APPROACH": 0.001, "MOVE_HOME": 0.03},
        slowed_to=0.9,
        home_time=STEP * count,
    )  # fmt: skip


def judge(record: CycleRecord) -> CycleScore:
    return score_cycle(record, time_limit=60.0)


def failed(record: CycleRecord) -> list[str]:
    return [name for name, holds in judge(record).conditions.items() if not holds]


# ---- the limits themselves --------------------------------------------------------------------


@pytest.mark.parametrize(
    ("series", "value", "conditions"),
    [
        ("slip_m_max", 0.005, ["held"]),
        ("slip_m_max", 0.3, ["held"]),
        ("position_excess_max", 1e-4, []),
        ("position_excess_max", 0.2, ["within_limits"]),
        ("speed_ratio_max", 1.02, []),
        ("speed_ratio_max", 3.0, ["within_limits"]),
        ("effort_ratio_max", 0.99, ["within_limits"]),
        ("effort_ratio_max", 1.5, ["within_limits"]),
        ("foreign_contacts_max", 1.0, ["clean"]),
        ("foreign_contacts_max", 2.0, ["clean"]),
    ],
)
@pytest.mark.parametrize("step", [0, 7, -1])
def test_a_value_at_its_limit_counts_as_documented_at_any_step(series, value, conditions, step):
    record = made()
    record.series[series][step] = value
    assert failed(record) == conditions


@pytest.mark.parametrize(
    ("name", "value", "conditions"),
    [
        ("resting_for", 0.5, []),
        ("home_distance", 1e-3, []),
        ("fingers_open", 0.0, ["released"]),
        ("finger_contacts", 2.0, ["released"]),
        ("supported", 0.0, ["placed"]),
        ("in_place_volume", 0.0, ["placed"]),
    ],
)
def test_a_fact_at_its_limit_counts_as_documented(name, value, conditions):
    record = made()
    record.final[name] = value
    assert failed(record) == conditions


def test_a_centimetre_is_high_enough_and_needs_to_be_reached_once():
    record = made()
    record.series["clear_height_max"][:] = 0.0
    record.series["clear_height_max"][RAISED] = 0.010
    assert failed(record) == []
    record.series["clear_height_max"][RAISED] = np.nextafter(0.010, 0.0)
    assert failed(record) == ["lifted", "held"]


def test_fingers_have_to_touch_from_the_step_at_which_the_target_is_up():
    record = made()
    record.series["fingers_touch"][:RAISED] = 0.0
    assert failed(record) == []
    record.series["fingers_touch"][RAISED, 1] = 0.0
    assert failed(record) == ["held"]


def test_it_has_to_be_in_the_air_to_be_carried():
    record = made()
    not_carrying = ~np.isin(np.array(TRY + REST), ["LIFT", "WITHDRAW", "MOVE_TO_PLACE", "LOWER"])
    record.series["clear_height_max"][:] = np.where(not_carrying, 0.02, 0.0)
    record.series["fingers_touch"][not_carrying] = 0.0
    assert failed(record) == []
    record.series["stage"][:] = STAGES.index("MOVE_HOME")
    assert failed(record) == ["held"]


def test_home_too_late_is_a_timeout_of_the_last_stage():
    record = made()
    score = score_cycle(record, time_limit=record.home_time - 0.1)
    assert score.cause == Event(
        reason="timeout", stage="MOVE_HOME", time=6.0, detail="in_time is false"
    )
    assert score.cycle_time_s == 6.0


# ---- the numbers --------------------------------------------------------------------------------


def test_the_line_of_a_cycle_is_what_its_record_says():
    record = made()
    record.drawn, record.sampled_motions = {"length_m": 0.3}, ("MOVE_HOME",)
    record.wall_clock = {"plan_s": 0.25}
    line = judge(record).as_json()
    moving = 1e-4 * np.array([1, 2, 4, 5, 6, 7, 8, 9, 11, 12])
    place = line.pop("place_offset_m")
    assert place == pytest.approx(0.5)
    assert line.pop("grasp")["slip_rate_um_s"] == pytest.approx(400.0, rel=1e-9)
    tracking = line.pop("tracking_offset_m")
    assert tracking["mean"] == pytest.approx(6.5e-4)
    assert tracking["max"] == pytest.approx(12e-4)
    assert line.pop("ik_offset_m")["mean"] == pytest.approx(2e-9)
    assert line.pop("ik_offset_rad")["mean"] == pytest.approx(3e-9)
    assert line == {
        "cycle": 3, "episode": 1, "seed": 7, "cell": 5, "target": {"mass_kg": 1.0},
        "drawn": {"length_m": 0.3}, "success": True, "first_try": True, "retries": 0, "retried": [],
        "failed_stage": None, "reason": None, "failed_time_s": None, "detail": None,
        "lifted": True, "held": True, "clean": True, "within_limits": True, "released": True,
        "placed": True, "returned": True, "in_time": True,
        "cycle_time_s": 6.0, "motion_time_s": 5.0, "sampled_motions": ["MOVE_HOME"],
        "slowed_to": 0.9, "grasp_slip_m": 0.001, "grasp_slip_rad": 0.002,
        "min_clearance_m": 0.03, "clearance_m": record.clearance_m, "simulated_s": 6.0,
        "histograms": {
            "ik_offset_m": histogram([1e-9, 3e-9]),
            "ik_offset_rad": histogram([2e-9, 4e-9]),
            "tracking_offset_m": histogram(moving),
        },
        "wall_clock": {"plan_s": 0.25},
    }  # fmt: skip
    json.dumps(line, allow_nan=False)


def test_a_verdict_is_not_changed_afterwards():
    score = judge(made())
    with pytest.raises(AttributeError):
        score.cause = Event(reason="dropped", stage="LIFT", time=1.0, detail="an afterthought")


def test_a_failure_says_where_when_and_why():
    record = made()
    record.events = [Event(reason="dropped", stage="LIFT", time=2.25, detail="it fell")]
    line = judge(record).as_json()
    told = [line[name] for name in ("reason", "failed_stage", "failed_time_s", "detail")]
    assert told == ["dropped", "LIFT", 2.25, "it fell"]
    assert not line["success"]
    assert not line["first_try"]


def test_a_grasp_is_measured_while_it_carries_and_no_longer():
    record = made()
    carried = slice(RAISED, RAISED + 5)
    # before the target is up, and after its release: not of the grasp
    for step in (RAISED - 1, RAISED + 5):
        record.series["finger_force"][step] = 1.0
        record.series["friction_ratio"][step] = 0.9
        record.series["finger_contacts_min"][step] = 1.0
    record.series["finger_force"][carried, 0] = [200.0, 170.0, 240.0, 200.0, 200.0]
    grasp = judge(record).grasp
    # the weaker of 220 N and these, over five steps of half a second in which 1 mm was lost
    assert grasp == {
        "slip_rate_um_s": pytest.approx(400.0),
        "grip_force_n": {"min": 170.0, "mean": pytest.approx(198.0)},
        "contacts": 3,
        "slip_margin": pytest.approx(1.0 - 0.25 / PAD_FRICTION),
    }
    record.drawn = {"pad_friction": 0.8}
    assert judge(record).grasp["slip_margin"] == pytest.approx(1.0 - 0.25 / 0.8)


def test_what_a_plan_did_not_give_is_not_there():
    record = made()
    record.clearance_m, record.p_base_release = {}, None
    line = judge(record).as_json()
    assert line["success"]
    assert line["min_clearance_m"] is None
    assert line["place_offset_m"] is None


def test_a_cycle_that_never_moved_was_simulated_for_no_time():
    empty = CycleRecord(cycle=3, episode=0, seed=1, cell=2, target={"mass_kg": 1.0})
    empty.events = [Event(reason="no_path", stage="MOVE_TO_PICK", time=0.0, detail="no way")]
    line = judge(empty).as_json()
    assert line["simulated_s"] == 0.0
    assert line["retried"] == []
    assert line["grasp"] is None
    assert len(judge(empty).tracking_offset_m) == 0


# ---- retries ---------------------------------------------------------------------------------


def retried(*, until: float | None = 3.5, **of_the_first: Any) -> CycleRecord:
    """A cycle whose first grasp is given up after the LIFT and tried again after a look."""
    record = made((*TRY, "BACK_OUT", "SETTLE", *TRY, *REST))
    record.series["clear_height_max"][len(TRY) + 2 : len(TRY) + 2 + RAISED] = 0.0
    record.series["slip_m_max"][:RAISED] = 0.0
    for name, value in of_the_first.items():
        record.series[name][: len(TRY)] = value
    gone = Event(reason="dropped", stage="LIFT", time=2.5, detail="nothing between the fingers")
    record.retries = [Retry(event=gone, until=until, drawn={"seen_m": 0.01})]
    return record


@pytest.mark.parametrize("lifted", [True, False])
def test_the_last_attempt_alone_decides_about_the_grasp(lifted):
    record = retried(
        fingers_touch=0.0, slip_m_max=0.3, slip_rad_max=3.0, clear_height_max=0.02 * lifted
    )
    score = judge(record)
    assert score.success
    assert (score.grasp_slip_m, score.grasp_slip_rad) == (0.001, 0.002)
    assert score.grasp["slip_rate_um_s"] == pytest.approx(400.0)
    line = score.as_json()
    assert (line["retries"], line["first_try"]) == (1, False)
    assert line["retried"] == [
        {
            "reason": "dropped",
            "stage": "LIFT",
            "time_s": 2.5,
            "detail": "nothing between the fingers",
            "lifted": lifted,
            "until_s": 3.5,
            "drawn": {"seen_m": 0.01},
        }
    ]


def test_a_first_attempt_that_was_better_does_not_count():
    record = retried()
    record.series["clear_height_max"][len(TRY) :] = 0.0
    score = judge(record)
    assert failed(record) == ["lifted", "held"]
    assert score.retried[0]["lifted"]
    assert score.grasp is None
    assert score.grasp_slip_m is None


@pytest.mark.parametrize(
    ("series", "value", "condition"),
    [("foreign_contacts_max", 1.0, "clean"), ("speed_ratio_max", 1.1, "within_limits")],
)
def test_what_no_attempt_may_do_counts_in_all_of_them(series, value, condition):
    assert failed(retried(**{series: value})) == [condition]


def test_an_attempt_ends_with_its_event_and_the_next_begins_after_the_look():
    record = retried()
    record.series["clear_height_max"][: len(TRY)] = 0.0
    record.series["clear_height_max"][[5, 6]] = 0.02  # at 3.0 and 3.5 s: backing out, looking
    record.series["slip_m_max"][[5, 6]] = 0.3
    score = judge(record)
    assert score.success
    assert not score.retried[0]["lifted"]
    record.series["clear_height_max"][len(TRY) - 1] = 0.02  # at 2.5 s, as it was given up
    assert judge(record).retried[0]["lifted"]


def test_without_another_attempt_nothing_was_lifted_in_it():
    record = retried(until=None)
    record.events = [Event(reason="no_path", stage="BACK_OUT", time=3.5, detail="no way")]
    score = judge(record)
    assert score.conditions["lifted"] is False
    assert score.conditions["held"] is False
    assert score.grasp is None
    assert score.retried[0]["until_s"] is None


def test_of_four_attempts_each_has_its_own_time():
    record = retried()
    again = Event(reason="missed_grasp", stage="CLOSE_GRIPPER", time=4.5, detail="it rolled")
    record.retries.append(Retry(event=again, until=5.0))
    record.series["slip_m_max"][[7, 8]] = 0.3  # at 4.0 and 4.5 s, in the second one
    record.retries.append(Retry(event=replace(again, time=5.5), until=5.5))
    record.series["slip_m_max"][10] = 0.3  # at 5.5 s, in the third one
    score = judge(record)
    assert [attempt["lifted"] for attempt in score.retried] == [True, False, False]
    assert score.success
