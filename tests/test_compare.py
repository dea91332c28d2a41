"""compare: a run against itself is no regression, a worse one is, and what is no run is refused."""

from __future__ import annotations

import copy
import json

import numpy as np
import pytest

from kr210_sim.cli import main
from kr210_sim.compare import METRICS, compare_runs


def make_line(index: int, *, seed: int = 1000) -> dict:
    rng = np.random.default_rng([seed, index])
    return {
        "cycle": index,
        "seed": seed + index,
        "cell": 1 + index % 9,
        "success": True,
        "cycle_time_s": 4.5 + rng.uniform(),
        "motion_time_s": 4.0 + rng.uniform(),
        "ik_offset_m": {"mean": 1e-15, "p99": 2e-15, "max": 1e-15 * (1 + rng.uniform())},
        "tracking_offset_m": {"mean": 1e-4, "p99": 5e-4, "max": 6e-4 + 1e-4 * rng.uniform()},
        "grasp_slip_m": 1.5e-3 + 3e-4 * rng.uniform(),
        "wall_clock": {"plan_time_s": 0.05 + 0.02 * rng.uniform()},
    }


@pytest.fixture
def write(tmp_path):
    """Write a run folder of such lines."""

    def make(name: str, lines: list[dict], schema: int = 1):
        folder = tmp_path / name
        folder.mkdir()
        text = "".join(json.dumps(line) + "\n" for line in lines)
        (folder / "cycles.jsonl").write_text(text)
        (folder / "summary.json").write_text(json.dumps({"schema_version": schema}))
        return folder

    return make


@pytest.fixture
def lines():
    return [make_line(index) for index in range(12)]


def scaled(lines: list[dict], path: tuple[str, ...], factor: float) -> list[dict]:
    changed = copy.deepcopy(lines)
    for line in changed:
        *above, last = path
        place = line
        for name in above:
            place = place[name]
        place[last] *= factor
    return changed


def failing(lines: list[dict], count: int) -> list[dict]:
    changed = copy.deepcopy(lines)
    for line in changed[:count]:
        line.update(success=False, cycle_time_s=None, motion_time_s=None, grasp_slip_m=None)
    return changed


def status_of(capsys, *arguments) -> tuple[int, str, str]:
    status = main(["compare", *map(str, arguments)])
    return status, *capsys.readouterr()


# ---- verdicts -------------------------------------------------------------------------------


def test_a_real_run_against_itself_differs_in_nothing(default_run, capsys):
    status, out, _ = status_of(capsys, default_run.out, default_run.out, "--json")
    report = json.loads(out)
    assert status == 0
    assert report["pairs"] == 10
    for item in report["differences"]:
        assert (item["change"], item["p"], item["regression"]) == (0.0, 1.0, False), item["name"]
        assert item["a"] is not None


def test_a_run_is_the_same_by_its_folder_and_by_its_files(write, lines):
    folder = write("a", lines)
    reports = [
        compare_runs(folder, path)["differences"]
        for path in (folder, folder / "summary.json", folder / "cycles.jsonl")
    ]
    assert reports[0] == reports[1] == reports[2]


PATHS = {
    "cycle time": ("cycle_time_s",),
    "motion time": ("motion_time_s",),
    "IK offset, max": ("ik_offset_m", "max"),
    "tracking, max": ("tracking_offset_m", "max"),
    "grasp slip": ("grasp_slip_m",),
    "plan time": ("wall_clock", "plan_time_s"),
}


@pytest.mark.parametrize("paired", [True, False])
@pytest.mark.parametrize("name", PATHS)
def test_each_figure_alone_is_a_regression_when_it_is_clearly_worse(write, lines, name, paired):
    other = lines if paired else [make_line(index, seed=9000) for index in range(12)]
    factor = 1e9 if name == "IK offset, max" else 3.0
    a, b = write("a", lines), write("b", scaled(other, PATHS[name], factor))
    report = compare_runs(a, b)
    assert report["regressions"] == [name]
    assert report["paired"] is paired
    assert compare_runs(b, a)["regressions"] == []


def test_every_figure_is_tried():
    assert {metric.name for metric in METRICS} == set(PATHS)


@pytest.mark.parametrize(
    ("name", "factor", "regression"),
    [
        ("cycle time", 1.005, False),
        ("cycle time", 1.02, True),
        ("plan time", 1.9, False),
        ("plan time", 2.5, True),
        ("IK offset, max", 50.0, False),
    ],
)
def test_a_significant_change_counts_only_above_its_threshold(
    write, lines, name, factor, regression
):
    a, b = write("a", lines), write("b", scaled(lines, PATHS[name], factor))
    report = compare_runs(a, b)
    found = next(item for item in report["differences"] if item["name"] == name)
    assert found["p"] < 0.05
    assert found["regression"] is regression
    assert found["relative"] == pytest.approx(factor - 1)


def test_a_change_that_is_large_but_in_one_cycle_only_is_not_significant(write, lines):
    other = copy.deepcopy(lines)
    other[3]["cycle_time_s"] *= 10
    assert compare_runs(write("a", lines), write("b", other))["regressions"] == []


@pytest.mark.parametrize(("lost", "regression"), [(0, False), (5, False), (6, True), (12, True)])
def test_fewer_successes_are_a_regression_once_mcnemar_says_so(write, lines, lost, regression):
    """Two-sided exact: 5 of 5 discordant pairs have p = 0.0625, 6 of 6 have 0.03125."""
    a, b = write("a", lines), write("b", failing(lines, lost))
    report = compare_runs(a, b)
    assert ("success rate" in report["regressions"]) is regression
    assert report["differences"][0]["p"] == pytest.approx(min(1.0, 2 * 0.5**lost))
    assert compare_runs(b, a)["regressions"] == []


def test_without_common_seeds_the_success_rate_is_compared_by_fishers_test(write, lines):
    other = failing([make_line(index, seed=9000) for index in range(12)], 6)
    item = compare_runs(write("a", lines), write("b", other))["differences"][0]
    assert item["test"] == "Fisher, exact"
    assert item["p"] == pytest.approx(0.0137, abs=2e-4)
    assert item["regression"]


def test_runs_of_different_length_are_compared_on_what_both_have_and_it_is_said(
    write, lines, capsys
):
    status, out, _ = status_of(capsys, write("a", lines), write("b", lines[:7]))
    assert status == 0
    assert "A has 12 cycles, B 7" in out
    assert "compared on the 7 cycles" in out
    assert "compared: paired cycle by cycle; n: pairs" in out


def test_options_in_which_the_runs_differ_are_said(write, lines, capsys):
    a, b = write("a", lines), write("b", lines)
    for folder, mass in ((a, 1.0), (b, 10.0)):
        options = {"mass": mass, "seed": 0, "out": str(folder), "min_success": mass / 10}
        (folder / "config.json").write_text(json.dumps({"options": options}))
    status, out, _ = status_of(capsys, a, b)
    assert status == 0
    assert [line for line in out.splitlines() if "note" in line] == [
        "note: --mass was 1.0 for A, 10.0 for B"
    ]
    assert out.splitlines()[-1] == "no regression; but the runs are not alike, see --mass"


def test_nothing_in_common_to_compare_is_said_and_is_no_number(write, lines, capsys):
    a, b = write("a", lines), write("b", failing(lines, 12))
    status, out, _ = status_of(capsys, a, b)
    assert status == 1
    assert "REGRESSION: success rate" in out
    assert "not compared" in out
    assert "nan" not in out.lower()
    assert "None" not in out


def test_the_table_names_what_became_worse(write, lines, capsys):
    status, out, _ = status_of(
        capsys, write("a", lines), write("b", scaled(lines, ("cycle_time_s",), 1.5))
    )
    assert status == 1
    assert "REGRESSION: cycle time" in out
    assert "+50.0" in out


def row_of(out: str, name: str) -> list[str]:
    (line,) = (line for line in out.splitlines() if line.startswith(name))
    return line.removeprefix(name).split()


@pytest.mark.parametrize(
    ("count_a", "count_b", "paired", "told"),
    [
        (5, 5, True, []),
        (6, 6, True, ["success rate", "IK offset, max"]),
        (3, 3, False, []),
        (3, 4, False, ["success rate"]),
        (4, 4, False, ["success rate", "IK offset, max"]),
    ],
)
def test_too_few_cycles_for_a_test_are_no_verdict(
    write, lines, capsys, count_a, count_b, paired, told
):
    """As much worse as can be; of 3 and 4 cycles Fisher's test alone has p < 0.05.

    The other figures are those of successful cycles, and B has none.
    """
    other = lines if paired else [make_line(index, seed=9000) for index in range(12)]
    worse = failing(scaled(other, ("ik_offset_m", "max"), 1e9), count_b)
    a, b = write("a", lines[:count_a]), write("b", worse[:count_b])
    report = compare_runs(a, b)
    assert [item["name"] for item in report["differences"] if item["enough"]] == told
    status, out, err = status_of(capsys, a, b)
    n = str(count_a) if paired else f"{count_a}/{count_b}"
    assert row_of(out, "success rate")[4] == n
    assert ("unpaired" in out) is not paired
    assert report["regressions"] == told
    if told:
        assert status == 1
        assert "; too few cycles to tell: " in out.splitlines()[-1]
    else:
        assert status == 2
        assert row_of(out, "success rate")[-3:] == ["too", "few", "cycles"]
        assert out.splitlines()[-1] == "NO VERDICT: too few cycles"
        assert err.startswith("kr210-sim: RUN_A, RUN_B: ")
        assert err.count("\n") == 1
        assert "give six or more of the same seeds, or four or more each" in err


def test_one_failure_more_is_not_called_no_difference(write, lines, capsys):
    status, out, _ = status_of(capsys, write("a", lines), write("b", failing(lines, 1)))
    assert status == 0
    assert row_of(out, "success rate")[-2:] == ["not", "significant"]
    assert row_of(out, "tracking, max [mm]")[-2:] == ["no", "difference"]


# ---- bad input ------------------------------------------------------------------------------


def spoiled(kind: str, lines: list[dict]) -> str:
    changed = copy.deepcopy(lines)
    if kind == "torn":
        return json.dumps(changed[0])[:-20]
    if kind == "empty":
        return ""
    if kind == "list":
        return "[1, 2]"
    if kind == "nan":
        return json.dumps(changed[0]).replace(str(changed[0]["cycle_time_s"]), "NaN")
    if kind == "lacking":
        del changed[0]["motion_time_s"]
    if kind == "text":
        changed[0]["cycle_time_s"] = "4.5"
    if kind == "twice":
        changed.append(changed[0])
    if kind == "verdict":
        changed[0]["success"] = 1
    return "".join(json.dumps(line) + "\n" for line in changed)


@pytest.mark.parametrize(
    ("kind", "says"),
    [
        ("torn", "broken JSON"), ("nan", "broken JSON"), ("empty", "no finished cycle"),
        ("list", "not a cycle"), ("lacking", "not a cycle"), ("text", "not a cycle"),
        ("verdict", "not a cycle"), ("twice", "twice"),
    ],
)  # fmt: skip
def test_what_is_no_run_is_refused_in_one_line(write, lines, capsys, kind, says):
    a, b = write("a", lines), write("b", lines)
    (b / "cycles.jsonl").write_text(spoiled(kind, lines))
    status, out, err = status_of(capsys, a, b)
    assert (status, out) == (2, "")
    assert err.count("\n") == 1
    assert says in err
    assert str(b) in err


def test_missing_files_another_schema_and_binary_are_refused(write, lines, capsys, tmp_path):
    a, old = write("a", lines), write("old", lines, schema=7)
    bare, binary = tmp_path / "bare", tmp_path / "binary.jsonl"
    bare.mkdir()
    binary.write_bytes(b"\xff\xfe\x00")
    for path, says in (
        (tmp_path / "none", "no such file"),
        (bare, "no such file"),
        (old, "schema_version is 7"),
        (binary, "cannot be read"),
    ):
        for pair in ((a, path), (path, a)):
            status, _, err = status_of(capsys, *pair)
            assert status == 2
            assert says in err
            assert err.count("\n") == 1
