"""The schemas: valid, as strict as the code, and kept by every result a run writes."""

from __future__ import annotations

import copy
import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from drawn_runs import DROPPED, LIMITS, make_record, make_run
from jsonschema import Draft202012Validator

from kr210_sim.config import RunConfig
from kr210_sim.criteria import CONDITIONS, REASONS
from kr210_sim.proof import FAILED, PASSED, UNDECIDED
from kr210_sim.randomize import QUANTITIES
from kr210_sim.record import STAGES, CycleRecord, Event, Retry
from kr210_sim.schemas import SCHEMA_VERSION, load_schema
from kr210_sim.summary import summarize

CYCLE, SUMMARY = load_schema("cycle"), load_schema("summary")


def check(schema: dict[str, Any], content: Any) -> None:
    """Validate what a reader of the JSON text would see."""
    Draft202012Validator(schema).validate(json.loads(json.dumps(content, allow_nan=False)))


def below(schema: Any) -> Iterator[dict[str, Any]]:
    """Yield a schema and all schemas in it."""
    if isinstance(schema, dict):
        yield schema
    for each in schema.values() if isinstance(schema, dict) else schema:
        if isinstance(each, dict | list):
            yield from below(each)


@pytest.fixture
def records() -> list[CycleRecord]:
    """One that succeeded, one that was dropped, one tried again, one that never moved."""
    unplayed = CycleRecord(
        cycle=3, episode=0, seed=1003, cell=2, target=make_record(3).target,
        events=[Event(reason="no_path", stage="MOVE_TO_PICK", time=0.0, detail="blocked")],
    )  # fmt: skip
    retry = Retry(
        event=Event(reason="missed_grasp", stage="CLOSE_GRIPPER", time=0.05, detail="nothing"),
        until=0.1,
        drawn={"perceived_shift_m": [0.0, 0.0, 0.001]},
    )
    again = make_record(2, retries=[retry], drawn={"cell": 1, "start_rad": [0.0] * 6})
    return [make_record(0), make_record(1, DROPPED), again, unplayed]


@pytest.mark.parametrize("schema", [CYCLE, SUMMARY], ids=["cycle", "summary"])
def test_it_is_a_schema_that_leaves_no_key_open(schema):
    Draft202012Validator.check_schema(schema)
    objects = [each for each in below(schema) if isinstance(each.get("properties"), dict)]
    assert objects
    for each in objects:
        assert each["additionalProperties"] is False
        optional = {"drawn", "proof", "max_ik_offset", "max_cycle_time"} | QUANTITIES.keys()
        optional |= {"ik_time_s", "plan_time_s", "wall_time_s"}  # nothing was planned
        assert each["properties"].keys() - set(each.get("required", ())) <= optional


def test_the_closed_lists_are_those_of_the_code():
    assert SUMMARY["properties"]["schema_version"]["const"] == SCHEMA_VERSION
    assert all(f":{SCHEMA_VERSION}:" in schema["$id"] for schema in (CYCLE, SUMMARY))
    assert CYCLE["properties"]["reason"]["enum"] == [*REASONS, None]
    assert CYCLE["properties"].keys() >= CONDITIONS.keys()
    assert CYCLE["$defs"]["stage"]["enum"] == list(STAGES)
    assert list(CYCLE["$defs"]["drawn"]["properties"]) == list(QUANTITIES)
    assert SUMMARY["$defs"]["counts"]["propertyNames"]["enum"] == list(REASONS)
    assert SUMMARY["$defs"]["cause"]["properties"]["reason"]["enum"] == list(REASONS)
    assert SUMMARY["$defs"]["cause"]["properties"]["stage"]["enum"] == list(STAGES)
    for proof in SUMMARY["$defs"]["proof"]["oneOf"]:
        assert set(proof["properties"]["verdict"]["enum"]) == {PASSED, FAILED, UNDECIDED}


def test_a_real_run_keeps_them(default_run):
    check(SUMMARY, json.loads((default_run.out / "summary.json").read_text()))
    lines = (default_run.out / "cycles.jsonl").read_text().splitlines()
    assert len(lines) == 10
    for line in lines:
        check(CYCLE, json.loads(line))


def test_failures_and_retries_keep_them(tmp_path, records):
    lines = make_run(tmp_path / "run", records, kept=False, retries=1)
    assert [line["success"] for line in lines] == [True, False, True, False]
    assert lines[2]["retries"] == 1
    for line in lines:
        check(CYCLE, line)
    check(SUMMARY, json.loads((tmp_path / "run" / "summary.json").read_text()))


@pytest.mark.parametrize("cycles", [0, 4])
@pytest.mark.parametrize("stop_early", [False, True])
def test_gates_and_proofs_keep_them_also_without_a_cycle(tmp_path, records, cycles, stop_early):
    lines = make_run(tmp_path / "run", records, kept=False)[:cycles]
    config = RunConfig(
        confidence=0.95, stop_early=stop_early, max_ik_offset=1e-6, max_cycle_time=9.0
    )
    loss = {"episode": 0, "attempt": 1, "cause": "killed"}
    summary = summarize(
        lines, config=config, limits=LIMITS, notes=["one"], wall_time_s=1.0, simulated_s=0.0,
        lost_workers=[loss],
    )  # fmt: skip
    check(SUMMARY, summary)


WRONG = {
    "a key too many": lambda line: line.update(extra=1),
    "a key too few": lambda line: line.pop("seed"),
    "a reason of one's own": lambda line: line.update(reason="bad luck"),
    "a condition that is a number": lambda line: line.update(lifted=1),
    "a spread with a key too few": lambda line: line["ik_offset_m"].pop("max"),
    "a quantity that nobody draws": lambda line: line["drawn"].update(luck=1.0),
    "a vector that is a number": lambda line: line["drawn"].update(start_rad=1.0),
    "a stage of one's own": lambda line: line["clearance_m"].update(HOVER=0.1),
}


@pytest.mark.parametrize("harm", WRONG.values(), ids=WRONG.keys())
def test_what_is_not_a_cycle_is_refused(tmp_path, records, harm):
    line = make_run(Path(tmp_path / "run"), records[:1], kept=False)[0]
    validator = Draft202012Validator(CYCLE)
    harmed = copy.deepcopy(line)
    harm(harmed)
    assert validator.is_valid(line)
    assert not validator.is_valid(harmed)
