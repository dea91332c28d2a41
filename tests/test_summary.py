"""The summary counts what the scores say, passes its gate, and never prints what is not there."""

from __future__ import annotations

import copy
import json

import numpy as np
import pytest

from kr210_sim.config import RunConfig
from kr210_sim.record import CycleRecord, Event
from kr210_sim.score import score_cycle
from kr210_sim.summary import HEADER, cycle_line, exit_text, summarize, summary_text

KEYS = {
    "cycles", "succeeded", "success_rate", "ci95", "passed", "seed", "cycle_time_s",
    "motion_time_s", "ik_offset_m", "ik_offset_rad", "tracking_offset_m", "grasp_slip_m",
    "grasp_slip_rad", "place_offset_m", "ik_time_s", "plan_time_s", "wall_time_s",
    "realtime_factor", "failures", "limits", "gates", "gates_missed", "slowed",
}  # fmt: skip


@pytest.fixture
def summary_of(limits):
    def make(scores, min_success=0.8, *, requested=None, notes=(), lost=(), **gates):
        lines = [score.as_json() for score in scores]
        return summarize(
            iter(lines),
            config=RunConfig(
                seed=5, cycles=requested or len(lines) or 1, min_success=min_success, **gates
            ),
            limits=limits,
            notes=notes,
            wall_time_s=2.0,
            simulated_s=9.0,
            lost_workers=lost,
        )

    return make


@pytest.fixture
def failed():
    """A cycle that failed before anything moved."""

    def make(reason: str):
        record = CycleRecord(cycle=7, episode=0, seed=99, cell=2, target={"mass_kg": 1.0})
        record.events = [Event(reason=reason, stage="MOVE_TO_PICK", time=0.0, detail="no way in")]
        return score_cycle(record, time_limit=60.0)

    return make


def test_a_summary_has_every_field_of_the_contract(summary_of, good_cycle):
    summary = summary_of([good_cycle])
    assert set(summary) >= KEYS
    assert summary["seed"] == 5
    for name, fields in {
        "cycle_time_s": "mean p50 p95 max", "motion_time_s": "mean p50 p95 max",
        "ik_offset_m": "mean p99 max", "ik_offset_rad": "mean p99 max",
        "tracking_offset_m": "mean p99 max", "grasp_slip_m": "mean p95 max",
        "grasp_slip_rad": "mean p95 max", "place_offset_m": "mean p95 max",
        "ik_time_s": "mean p50 p95 max", "plan_time_s": "mean p50 p95 max",
    }.items():  # fmt: skip
        assert set(summary[name]) == set(fields.split()), name
        assert all(isinstance(value, float) for value in summary[name].values()), name


@pytest.mark.parametrize(
    ("good", "bad", "gate", "passed"),
    [(8, 2, 0.8, True), (7, 3, 0.8, False), (0, 3, 0.0, True), (9, 0, 1, True), (9, 1, 1, False)],
)
def test_the_gate_is_passed_at_its_very_value(
    summary_of, good_cycle, failed, good, bad, gate, passed
):
    summary = summary_of([good_cycle] * good + [failed("no_path")] * bad, gate)
    assert summary["passed"] is passed
    assert (summary["cycles"], summary["succeeded"]) == (good + bad, good)
    assert summary["success_rate"] == pytest.approx(good / (good + bad))
    low, high = summary["ci95"]
    assert low <= summary["success_rate"] <= high


def test_the_longest_cycle_and_the_largest_offset_have_gates_of_their_own(summary_of, good_cycle):
    time, offset = good_cycle.cycle_time_s, float(np.max(good_cycle.ik_offset_m))
    for limits, missed in (
        ({"max_cycle_time": time}, []),
        ({"max_cycle_time": 0.999 * time}, ["max_cycle_time"]),
        ({"max_ik_offset": offset}, []),
        ({"max_ik_offset": 0.999 * offset}, ["max_ik_offset"]),
        (
            {"max_ik_offset": 0.5 * offset, "max_cycle_time": 0.5 * time},
            ["max_ik_offset", "max_cycle_time"],
        ),
    ):
        summary = summary_of([good_cycle] * 2, **limits)
        assert summary["gates_missed"] == missed
        assert summary["passed"] is (not missed)
        assert set(summary["gates"]) == {"min_success", *limits}
        text = summary_text(summary)
        assert text.count("FAILED") == len(missed)
        assert ("longest cycle" in text) == ("max_cycle_time" in limits)
        assert f"{time:.4g} s" in text or "max_cycle_time" not in limits


def test_the_slowest_cycle_decides_and_not_the_mean(summary_of, good_cycle):
    slow = copy.deepcopy(good_cycle.record)
    slow.home_time = 2 * good_cycle.cycle_time_s
    scores = [good_cycle] * 9 + [score_cycle(slow, time_limit=60.0)]
    summary = summary_of(scores, max_cycle_time=1.5 * good_cycle.cycle_time_s)
    assert summary["cycle_time_s"]["mean"] < 1.5 * good_cycle.cycle_time_s
    assert summary["gates_missed"] == ["max_cycle_time"]


def test_a_figure_that_does_not_exist_misses_its_gate(summary_of, failed):
    summary = summary_of([failed("no_path")], 0.0, max_ik_offset=1.0, max_cycle_time=60.0)
    assert summary["gates_missed"] == ["max_ik_offset", "max_cycle_time"]
    assert summary["gates"]["max_cycle_time"] == {"limit": 60.0, "value": None, "met": False}
    assert "longest cycle none" in summary_text(summary)


def test_cycles_that_a_tcp_limit_slowed_are_counted_and_shown(summary_of, good_cycle, failed):
    assert good_cycle.record.slowed_to == 1.0
    summary = summary_of([good_cycle, failed("no_path")])
    assert summary["slowed"] == {"cycles": 0, "least": None}
    assert "slowed" not in summary_text(summary)
    heavy = copy.deepcopy(good_cycle.record)
    heavy.slowed_to = 0.625
    summary = summary_of([good_cycle, score_cycle(heavy, time_limit=60.0)])
    assert summary["slowed"] == {"cycles": 1, "least": 0.625}
    assert "down to 0.62 of" in summary_text(summary)


def test_times_are_those_of_successful_cycles_only(summary_of, good_cycle, failed):
    slow = copy.deepcopy(good_cycle.record)
    slow.home_time = 59.0
    slow.final["supported"] = 0.0
    scores = [good_cycle, score_cycle(slow, time_limit=60.0), failed("no_path")]
    summary = summary_of(scores)
    assert summary["cycle_time_s"]["max"] == pytest.approx(good_cycle.cycle_time_s)


def test_failures_are_counted_by_reason(summary_of, good_cycle, failed):
    scores = [failed("timeout"), failed("no_path"), good_cycle, failed("no_path")]
    assert summary_of(scores)["failures"] == {"no_path": 2, "timeout": 1}


def test_offsets_are_pooled_over_all_points(summary_of, good_cycle):
    summary = summary_of([good_cycle, good_cycle])
    assert summary["ik_offset_m"]["max"] == np.max(good_cycle.ik_offset_m)
    assert summary["tracking_offset_m"]["max"] == np.max(good_cycle.tracking_offset_m)
    assert summary["tracking_offset_m"]["mean"] == pytest.approx(
        np.mean(good_cycle.tracking_offset_m)
    )


def test_the_simulated_time_over_the_wall_time_is_the_real_time_factor(summary_of, good_cycle):
    assert summary_of([good_cycle] * 3)["realtime_factor"] == 4.5
    assert good_cycle.as_json()["simulated_s"] == good_cycle.record.series["time"][-1]


def test_a_run_that_is_not_complete_has_not_passed(summary_of, good_cycle):
    assert summary_of([good_cycle] * 3)["complete"]
    part = summary_of([good_cycle] * 3, requested=4)
    assert (part["complete"], part["requested_cycles"], part["passed"]) == (False, 4, False)
    assert "3 of 4 cycles are finished" in summary_text(part)


@pytest.mark.parametrize("scores", ["none", "failed"])
def test_what_does_not_exist_is_null_and_never_nan(summary_of, failed, scores):
    summary = summary_of([] if scores == "none" else [failed("no_path")])
    text = json.dumps(summary, allow_nan=False)
    assert "NaN" not in text
    assert set(summary["cycle_time_s"].values()) == {None}
    assert set(summary["ik_offset_m"].values()) == {None}
    assert not summary["passed"]


def test_no_cycles_have_no_rate(summary_of):
    summary = summary_of([])
    assert (summary["cycles"], summary["success_rate"], summary["ci95"]) == (0, None, None)


# ---- on the terminal ------------------------------------------------------------------------


def test_the_table_has_a_column_under_every_heading(good_cycle):
    line = cycle_line(good_cycle.as_json())
    assert len(line) <= len(HEADER) + 1
    assert "success" in line
    assert str(good_cycle.record.seed) in line


def test_a_failed_cycle_shows_its_first_cause(failed):
    first, second = cycle_line(failed("no_path").as_json()).split("\n")
    assert "no_path" in first
    assert "MOVE_TO_PICK" in second
    assert "no way in" in second


def test_nothing_that_is_not_there_is_printed_as_a_number(summary_of, failed):
    for text in (
        cycle_line(failed("no_path").as_json()),
        summary_text(summary_of([failed("no_path")])),
        summary_text(summary_of([])),
    ):
        assert "nan" not in text.lower()
        assert "None" not in text
        assert "0.0e+00" not in text


def test_the_text_has_the_notes_and_the_workers_that_were_lost(summary_of, good_cycle):
    loss = {"episode": 3, "attempt": 1, "cause": "killed by signal 9"}
    text = summary_text(summary_of([good_cycle], notes=["link_3 is light"], lost=[loss]))
    assert "link_3 is light" in text
    assert "episode 3, attempt 1: killed by signal 9" in text


def test_the_text_says_the_rate_its_interval_and_the_gate(summary_of, good_cycle):
    text = summary_text(summary_of([good_cycle] * 10))
    assert "10 of 10" in text
    assert "69.1 to 100.0 %" in text
    assert "passed" in text
    assert "FAILED" not in text


def test_the_text_says_that_the_success_rate_failed(summary_of, good_cycle, failed):
    assert "gate 0.8: FAILED" in summary_text(summary_of([good_cycle, failed("no_path")]))


def test_the_text_says_what_the_cycles_prove_and_no_more(summary_of, good_cycle, failed):
    text = summary_text(summary_of([good_cycle] * 10))
    assert "proves         a success rate above 69.1 % with 95 % confidence (exact), and no" in text
    text = summary_text(summary_of([good_cycle] * 8 + [failed("no_path")] * 2))
    assert "a success rate between 44.3 and 97.5 %" in text


def test_an_undecided_run_says_how_many_cycles_it_takes(summary_of, good_cycle, failed):
    summary = summary_of([good_cycle] * 10, 0.95, confidence=0.95)
    text = summary_text(summary)
    assert "gate 0.95: UNDECIDED" in text
    assert "rate at least 74.11 %, 95 % confidence (exact, one-sided), to prove 0.95" in text
    assert "cycles needed  59 if all that follow succeed, about 59 at the rate so far" in text
    assert exit_text(summary) == "exit status 1: --min-success undecided"
    text = summary_text(summary_of([failed("no_path")] * 10, 0.95, confidence=0.95))
    assert "gate 0.95: FAILED" in text
    assert "rate at most 25.89 %" in text
    assert "cycles needed" not in text


def test_a_sequential_verdict_says_its_test_and_its_cycle(summary_of, good_cycle):
    proof = {"confidence": 0.95, "stop_early": True}
    text = summary_text(summary_of([good_cycle] * 20, 0.8, **proof))
    assert "Wald's sequential test of 0.8 against 0.96, error rates up to 0.05 and 0.05" in text
    assert "decided after 17 cycles" in text
    text = summary_text(summary_of([good_cycle] * 16, 0.8, **proof))
    assert "UNDECIDED" in text
    assert "cycles needed  17 if all" in text


def test_the_exit_status_is_told_with_its_reason(summary_of, good_cycle):
    assert exit_text(summary_of([good_cycle])) == "exit status 0: all gates met"
    missed = summary_of([good_cycle], 1.0, max_cycle_time=0.1, requested=2)
    assert exit_text(missed) == "exit status 1: the run is not complete, --max-cycle-time missed"
