"""JUnit: one test case per cycle, failures with their cause, well-formed whatever a name holds."""

from __future__ import annotations

import xml.etree.ElementTree as ET

import pytest

from kr210_sim.junit import write_junit


def line(cycle: int, reason: str | None = None, detail: str | None = None) -> dict:
    return {
        "cycle": cycle, "episode": cycle // 10, "seed": 77, "cell": 3, "success": reason is None,
        "reason": reason, "detail": detail, "failed_stage": reason and "LIFT",
        "failed_time_s": reason and 1.25, "wall_clock": {"wall_time_s": 2.5},
    }  # fmt: skip


def suite_of(path, lines) -> ET.Element:
    failed = sum(not line["success"] for line in lines)
    summary = {"cycles": len(lines), "succeeded": len(lines) - failed, "wall_time_s": 9.0}
    write_junit(path, iter(lines), summary, name="seed 0", command="kr210-sim <{}>".format)
    return ET.parse(path).getroot().find("testsuite")


def test_there_is_a_case_per_cycle_and_failures_tell_their_cause(tmp_path):
    lines = [line(0), line(1, "dropped", "target_1 slipped"), line(12)]
    suite = suite_of(tmp_path / "junit.xml", lines)
    assert (suite.get("tests"), suite.get("failures"), suite.get("errors")) == ("3", "1", "0")
    cases = suite.findall("testcase")
    assert [case.get("name") for case in cases] == ["cycle_0000", "cycle_0001", "cycle_0012"]
    assert [case.get("classname") for case in cases] == ["episode_0000"] * 2 + ["episode_0001"]
    assert [case.find("failure") is None for case in cases] == [True, False, True]
    failure = cases[1].find("failure")
    assert failure.get("type") == "dropped"
    assert "LIFT at 1.250 s" in failure.text
    assert "target_1 slipped" in failure.text
    assert "seed 77" in failure.text
    assert failure.text.endswith("show it again: kr210-sim <1>")


@pytest.mark.parametrize("detail", ['<a href="x">&\'', "a\x00b\x1b", "]]>", "\u0416 \U0001f916"])
def test_any_detail_makes_a_file_that_parses(tmp_path, detail):
    suite = suite_of(tmp_path / "junit.xml", [line(0, "collision", detail)])
    assert suite.find("testcase/failure").get("message")


def test_no_cycles_are_an_empty_suite(tmp_path):
    assert suite_of(tmp_path / "junit.xml", []).get("tests") == "0"
