"""The report of a run: one valid page with everything in it, and one line for what is no run."""

from __future__ import annotations

import json
import re
import shlex
import shutil
from pathlib import Path

import numpy as np
import pytest
from drawn_runs import DROPPED, SCENERY, make_record, make_run
from pages import HTML, SVG, assert_alone, assert_readable, linked_ids, parsed, text_of

from kr210_sim.cli import main
from kr210_sim.config import RunConfig
from kr210_sim.exceptions import BadInput
from kr210_sim.proof import ExactTest
from kr210_sim.record import CycleRecord
from kr210_sim.report import page, reading, templating
from kr210_sim.report.reading import read_run
from kr210_sim.report.templating import percent
from kr210_sim.report.write import write_report


@pytest.fixture(scope="module")
def page_of_three(tmp_path_factory):
    """The report of a run with a failure, a success, and a cycle in which nothing moved."""
    out = tmp_path_factory.mktemp("runs") / "a&b <script>alert(1)"
    still = CycleRecord(cycle=2, episode=0, seed=7, cell=2, target={}, events=[DROPPED])
    still.events = [type(DROPPED)(reason="no_path", stage="MOVE_TO_PICK", time=0.0, detail="\"'<&")]
    make_run(out, [make_record(0), make_record(1, DROPPED), still], min_success=0.9)
    return write_report(read_run(out), SCENERY)


def test_how_a_rate_was_tested_is_told_with_what_is_still_needed():
    exact = ExactTest(limit=0.9, confidence=0.95)
    gate = {"proof": exact.as_json(20, 20)}
    text = page.tested(gate)
    assert "Clopper-Pearson, one-sided, 95" in text
    assert f": {gate['proof']['verdict']}. The rate is at least 86" in text
    assert text.endswith("29 cycles decide it if all that follow succeed.")
    none_yet = page.tested({"proof": exact.as_json(0, 0)})
    assert "at least" not in none_yet
    assert "decided after" in page.tested({"proof": gate["proof"] | {"decided_after": 12}}).lower()
    assert page.tested({}) == ""


# ---- the page -------------------------------------------------------------------------------


def test_the_page_is_valid_html_that_needs_nothing_else(page_of_three):
    assert_alone(page_of_three)


def test_every_link_of_the_page_leads_somewhere_and_every_id_is_there_once(page_of_three):
    assert {f"cycle-{cycle}" for cycle in range(3)} <= linked_ids(parsed(page_of_three))


def test_the_page_can_be_read_without_eyes_and_mouse(page_of_three):
    assert_readable(parsed(page_of_three), drawings=10)


def test_the_verdict_comes_first_with_what_it_proves(page_of_three):
    body = text_of(next(parsed(page_of_three).iter(f"{HTML}main")))
    assert body.index("✗ Failed") < body.index("Failures by first cause") < body.index("Plots")
    assert "1 of 3 proves a success rate between 0.8 and 90.6 % with 95 % confidence" in body
    assert "success rate, at least 90 % 33.3 % missed" in body
    assert "95 % interval 0.8 to 90.6 %, exact" in body  # rounded outwards, as in the sentence


def test_failures_stand_by_first_cause_with_time_stage_and_what_happened(page_of_three):
    tree = parsed(page_of_three)
    section = next(e for e in tree.iter(f"{HTML}section") if e.get("id") == "failures")
    text = text_of(section)
    assert "dropped : 1 of 3 cycles" in text
    assert "1 0.22 move to place a finger lost <b>it</b> 2 1001" in text
    assert "no_path : 1 of 3 cycles" in text
    assert "2 0.00 move to pick \"'<& 2 7" in text
    assert "--only-cycle 1" in text
    assert "--only-cycle 2" in text


def test_failed_cycles_are_open_and_a_cycle_that_did_not_move_says_so(page_of_three):
    details = [e for e in parsed(page_of_three).iter(f"{HTML}details") if e.get("class", "")]
    cycles = [e for e in details if "cycle" in e.get("class")]
    assert [e.get("open") is not None for e in cycles] == [False, True, True]
    assert "nothing to plot" in text_of(cycles[2])


def test_what_users_name_stays_text(page_of_three):
    text = page_of_three.read_text()
    assert "<script" not in text
    assert "a finger lost <b>" not in text
    assert "a &lt;note&gt;" in text


def test_every_plot_is_a_file_too_and_nothing_else_is_left(page_of_three):
    names = {path.name for path in (page_of_three.parent / "plots").iterdir()}
    assert names == {"offsets.svg", "paths.svg", "stages.svg", "cells.svg"} | {
        f"cycle-{cycle}-{kind}.svg" for cycle in (0, 1) for kind in ("joints", "grip", "path")
    }
    assert not list(page_of_three.parent.rglob("*.part"))


def test_the_same_run_gives_the_same_page(tmp_path):
    out = tmp_path / "run"
    make_run(out, [make_record(0)], kept=False)
    first = write_report(read_run(out), None).read_bytes()
    assert write_report(read_run(out), None).read_bytes() == first


def test_a_run_without_records_has_a_page_without_plots_that_says_so(tmp_path, capsys):
    out = tmp_path / "run"
    make_run(out, [make_record(0), make_record(1)], kept=False, record="none")
    assert main(["report", str(out)]) == 0
    assert capsys.readouterr().out.strip() == str(out / "report.html")
    text = text_of(parsed(out / "report.html"))
    assert "No plots: no record of a cycle was kept ( --record none )" in text
    assert "Passed" in text


def test_an_unfinished_run_is_called_so(tmp_path):
    out = tmp_path / "run"
    make_run(out, [make_record(0)], cycles=5, kept=False)
    text = text_of(parsed(write_report(read_run(out), None)))
    assert "Not complete" in text
    assert "1 of 5 cycles are finished" in text


def test_a_run_of_no_cycle_at_all_has_a_page(tmp_path):
    out = tmp_path / "run"
    make_run(out, [], cycles=5)
    text = text_of(parsed(write_report(read_run(out), None)))
    assert "No cycle was finished, so nothing is proved." in text


def test_a_randomised_run_has_a_map_over_what_sets_its_failures_apart(tmp_path, capsys):
    out = tmp_path / "run"
    masses = (1.0, 1.1, 7.0)
    records = [
        make_record(cycle, DROPPED if mass > 5 else None, drawn={"mass_kg": mass, "x_m": x})
        for cycle, (mass, x) in enumerate(zip(masses, (0.02, 0.03, 0.01), strict=True))
    ]
    make_run(out, records, kept=False)
    assert main(["report", str(out)]) == 0
    text = (out / "report.html").read_text()
    assert "differ most in these: mass_kg by 2.1 and x_m by 1.8 standard deviations" in text
    assert main(["report", str(out), "--map", "cell", "x_m"]) == 0
    assert "differ most" not in (out / "report.html").read_text()
    assert (out / "plots" / "map.svg").read_text().count(">cell<") == 1
    capsys.readouterr()
    assert main(["report", str(out), "--map", "x_m", "weight"]) == 2
    err = capsys.readouterr().err
    assert "'weight' in this run; there are: cell, mass_kg, x_m\n" in err
    assert err.count("\n") == 1


def test_the_film_beside_the_page_is_shown(tmp_path):
    out = tmp_path / "run"
    make_run(out, [make_record(0)], kept=False)
    (out / "film.mp4").write_bytes(b"film")
    tree = parsed(write_report(read_run(out), None))
    assert [video.get("src") for video in tree.iter(f"{HTML}video")] == ["film.mp4"]


def test_a_page_that_cannot_be_written_leaves_the_old_one(tmp_path, capsys):
    out = tmp_path / "run"
    make_run(out, [make_record(0)], kept=False)
    (out / "report.html").write_text("old")
    (out / "plots").write_text("in the way")
    assert main(["report", str(out)]) == 3
    assert "plots" in capsys.readouterr().err
    assert (out / "report.html").read_text() == "old"


# ---- numbers and words ----------------------------------------------------------------------


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (None, page.DASH),
        (0.0, "0"),
        (4.786, "4.79"),
        (12.34, "12.3"),
        (512.6, "513"),
        (-0.5, "\N{MINUS SIGN}0.500"),
        (1.7e-15, "1.7e-15"),
        (123456.0, "1.2e+05"),
    ],
)
def test_numbers_have_three_digits(value, text):
    assert templating.number(value) == text


@pytest.mark.parametrize(
    ("changes", "expected"),
    [
        ({}, ("good", "passed")),
        ({"passed": False, "complete": False}, ("warn", "not complete")),
        ({"passed": False, "gates": {"a": {"met": False}}}, ("bad", "failed")),
        (
            {"passed": False, "gates": {"a": {"met": False, "proof": {"verdict": "undecided"}}}},
            ("warn", "undecided"),
        ),
    ],
)
def test_the_verdict_of_a_run(changes, expected):
    assert page.verdict({"passed": True, "complete": True, "gates": {}} | changes) == expected


def test_ten_of_ten_proves_no_more_than_it_does():
    summary = {"cycles": 10, "succeeded": 10, "ci95": [0.6915, 1.0]}
    assert "above 69.1 % with 95 % confidence, no more" in page.proof(summary)
    assert "below" in page.proof({"cycles": 3, "succeeded": 0, "ci95": [0.0, 0.7]})


def test_the_command_to_repeat_gives_the_same_options(tmp_path, monkeypatch):
    config = RunConfig(
        cycles=3, seed=5, cell="all", mass=2.5, gripper=True, scene="a b's.xml", jobs=2,
        package=("one=/x y", "two=/z"), out=tmp_path, max_cycle_time=9.5, video="",
    )  # fmt: skip
    seen = []
    monkeypatch.setattr("kr210_sim.runner.run", lambda config, **_: seen.append(config) or 1 / 0)
    words = shlex.split(page.repeat_command(json.loads(json.dumps(config.as_json()))))
    assert words[0] == "kr210-sim"
    main(words[1:])
    again = seen[0].as_json()
    left_out = {name: RunConfig().as_json()[name] for name in ("jobs", "out", "video")}
    assert again == config.as_json() | left_out


# ---- long runs ------------------------------------------------------------------------------


def test_of_a_long_run_the_failures_are_shown_first_and_the_page_says_so(tmp_path):
    out = tmp_path / "run"
    [line] = make_run(out, [make_record(0)], kept=False)
    bad = line | {"success": False, "reason": "dropped", "failed_stage": "LIFT"}
    bad |= {"failed_time_s": 1.0, "detail": "x"}
    lines = [(bad if n % 50 == 49 else line) | {"cycle": n, "seed": n} for n in range(3000)]
    (out / "cycles.jsonl").write_text("".join(json.dumps(each) + "\n" for each in lines))
    summary = json.loads((out / "summary.json").read_text())
    (out / "summary.json").write_text(json.dumps(summary | {"cycles": 3000, "succeeded": 2940}))
    run = read_run(out)
    shown = [row["cycle"] for row in run.rows]
    assert len(shown) == reading.MOST_ROWS
    assert shown == sorted(set(shown))
    assert {n for n in range(3000) if n % 50 == 49} <= set(shown)
    assert run.counts == {"dropped": 60}
    assert len(run.failures["dropped"]) == reading.MOST_OF_A_REASON
    path = write_report(run, None)
    assert path.stat().st_size < 500_000
    text = text_of(parsed(path))
    assert "200 of 3000 cycles" in text
    assert "The first 10 of 60" in text


def test_in_detail_there_is_room_for_failures_and_at_least_one_success(tmp_path):
    out = tmp_path / "run"
    records = [make_record(n, DROPPED) for n in range(15)] + [make_record(15)]
    make_run(out, records)
    shown = [cycle.cycle for cycle in read_run(out).detailed]
    assert len(shown) == reading.MOST_DETAILED
    assert shown == [*range(11), 15]


# ---- what is no run -------------------------------------------------------------------------


def rewrite_cycle(out: Path, **values: object) -> None:
    """Put other values in the only line of a run's cycles."""
    line = json.loads((out / "cycles.jsonl").read_text())
    (out / "cycles.jsonl").write_text(json.dumps(line | values) + "\n")


@pytest.mark.parametrize(
    ("spoil", "message"),
    [
        (lambda out: (out / "config.json").unlink(), "is no run"),
        (lambda out: (out / "summary.json").unlink(), "run/config.json --out"),
        (lambda out: (out / "summary.json").write_text("{"), "cannot be read"),
        (lambda out: (out / "summary.json").write_text("[]"), "has no 'passed'"),
        (lambda out: (out / "config.json").write_text("{}"), "has no 'options'"),
        (lambda out: (out / "cycles.jsonl").write_text("nonsense\n"), "line 1 cannot be read"),
        (lambda out: (out / "cycles.jsonl").write_text('{"cycle": 0}\n'), "has no 'seed'"),
        (lambda out: rewrite_cycle(out, success="yes"), "'success' is not what a run writes"),
        (lambda out: rewrite_cycle(out, drawn={"mass": "heavy"}), "'drawn' is not what a run"),
        (lambda out: rewrite_cycle(out, drawn={"p": [0.0, None]}), "'drawn' is not what a run"),
    ],
)
def test_what_is_no_run_is_refused_in_one_line(tmp_path, capsys, spoil, message):
    out = tmp_path / "run"
    make_run(out, [make_record(0)], kept=False)
    spoil(out)
    assert main(["report", str(out)]) == 2
    error = capsys.readouterr().err
    assert message in error
    assert error.count("\n") == 1
    assert not (out / "report.html").exists()


def test_a_folder_that_does_not_exist_is_refused(tmp_path, capsys):
    assert main(["report", str(tmp_path / "none")]) == 2
    assert "is no run" in capsys.readouterr().err


def test_a_torn_last_line_and_a_damaged_record_are_left_out(tmp_path):
    out = tmp_path / "run"
    make_run(out, [make_record(0), make_record(1)])
    with (out / "cycles.jsonl").open("a") as lines:
        lines.write('{"cycle": 2, ')
    record = out / "cycles" / "0001.npz"
    record.write_bytes(record.read_bytes()[:100])
    run = read_run(out)
    assert [line["cycle"] for line in run.rows] == [0, 1]
    assert run.unreadable == [1]
    assert [cycle.cycle for cycle in run.detailed] == [0]


def test_reading_refuses_by_an_error_of_ours(tmp_path):
    with pytest.raises(BadInput, match="is no run"):
        read_run(tmp_path)


# ---- a run as it is -------------------------------------------------------------------------


@pytest.mark.slow
def test_the_report_of_ten_cycles_shows_each_of_them_and_stays_small(default_run, tmp_path):
    out = tmp_path / "run"
    shutil.copytree(default_run.out, out)
    assert main(["report", str(out)]) == 0
    path = out / "report.html"
    assert path.stat().st_size < 5_000_000
    tree = parsed(path)
    ids = {element.get("id") for element in tree.iter()}
    assert {f"cycle-{cycle}" for cycle in range(10)} <= ids
    assert len(list(tree.iter(f"{SVG}svg"))) == 4 + 3 * 10
    offsets = np.concatenate([score.ik_offset_m for score in default_run.scores])
    assert f"{len(offsets)} points, at most {offsets.max():.1e} m" in text_of(tree)


@pytest.mark.slow
def test_a_run_with_report_writes_the_page(tmp_path, capsys):
    out = tmp_path / "run"
    options = ["--cycles", "1", "--mass", "16", "--report", "--min-success", "0"]
    assert main(["run", *options, "--out", str(out)]) == 0
    printed = capsys.readouterr().out
    assert re.search(rf"^report +{re.escape(str(out / 'report.html'))}$", printed, re.M)
    parsed(out / "report.html")


def test_a_share_is_all_or_nothing_only_if_it_is_so():
    shares = (0.0, 1e-4, 2 / 3, 1999 / 2000, 1.0)
    assert [percent(share) for share in shares] == ["0 %", "0.1 %", "66.7 %", "99.9 %", "100 %"]


@pytest.mark.parametrize("name", ["cell", "reason", "cycle"])
def test_a_line_whose_groups_are_no_names_is_refused(tmp_path, name):
    out = tmp_path / "run"
    make_run(out, [make_record(0)], kept=False)
    lines = (out / "cycles.jsonl").read_text().splitlines()
    lines[0] = json.dumps(json.loads(lines[0]) | {name: []})
    (out / "cycles.jsonl").write_text("\n".join(lines) + "\n")
    with pytest.raises(BadInput, match=f"line 1: '{name}' is not what"):
        read_run(out)
