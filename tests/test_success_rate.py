"""The success rate of the default run: ten of ten, and the figures promised with it."""

from __future__ import annotations

import numpy as np
import pytest

from kr210_sim.config import RunConfig
from kr210_sim.criteria import CONDITIONS
from kr210_sim.results import read_lines
from kr210_sim.runner import run
from kr210_sim.summary import HEADER, cycle_line, summary_text


def table_of(out, summary) -> str:
    """Return the table of a run, with the first cause under every failed cycle."""
    return "\n".join([HEADER, *map(cycle_line, read_lines(out)), summary_text(summary)])


def test_ten_of_ten_default_cycles_succeed(default_run):
    assert len(default_run.scores) == 10
    table = table_of(default_run.out, default_run.summary)
    assert default_run.summary["succeeded"] == 10, f"first causes in the table:\n{table}"
    assert default_run.summary["passed"]


@pytest.mark.slow
@pytest.mark.parametrize(
    "options",
    [
        *({"seed": seed} for seed in (1, 2, 3, 4)),
        *({"mass": mass} for mass in (0.05, 2.0, 5.0)),
        {"cell": "all", "cycles": 9},
        {"speed": 0.4, "cycles": 4},
    ],
    ids=str,
)
def test_every_cycle_of_other_runs_succeeds_too(tmp_path, options):
    out, summary = run(RunConfig(out=tmp_path / "run", **options))
    table = table_of(out, summary)
    assert summary["succeeded"] == summary["cycles"] == options.get("cycles", 10), table
    assert summary["ik_offset_m"]["max"] <= 1e-12
    assert summary["tracking_offset_m"]["max"] <= 2e-3


def test_every_condition_of_every_default_cycle_is_true(default_run):
    for score in default_run.scores:
        assert list(score.conditions) == list(CONDITIONS)
        assert all(score.conditions.values()), (score.record.cycle, score.conditions)
        assert score.cause is None


def test_every_offset_of_the_default_run_is_within_its_promise(default_run):
    summary = default_run.summary
    assert summary["ik_offset_m"]["max"] <= 1e-12
    assert summary["ik_offset_rad"]["max"] <= 1e-12
    assert summary["tracking_offset_m"]["max"] <= 2e-3
    assert summary["grasp_slip_m"]["max"] < 5e-3
    assert min(len(score.ik_offset_m) for score in default_run.scores) > 50


def test_the_mean_cycle_takes_at_most_eight_simulated_seconds(default_run):
    assert default_run.summary["cycle_time_s"]["mean"] <= 8.0


def test_the_limits_of_the_default_run_are_those_it_states(default_run, robot):
    limits = default_run.summary["limits"]
    np.testing.assert_allclose(limits["velocity_rad_s"], robot.velocity)
    acceleration = np.array(limits["acceleration_rad_s2"])
    assert np.all(acceleration <= robot.velocity / 0.25 * (1 + 1e-12))
    assert np.all(np.array(limits["jerk_rad_s3"]) <= acceleration / 0.05 * (1 + 1e-12))
