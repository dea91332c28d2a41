"""Proofs of a success rate: error rates by exact sums and by simulation, bounds, needed cycles."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.stats import binom

from kr210_sim.config import RunConfig
from kr210_sim.exceptions import BadInput
from kr210_sim.gates import Gates
from kr210_sim.proof import (
    FAILED,
    PASSED,
    UNDECIDED,
    ExactTest,
    SequentialTest,
    Watch,
)
from kr210_sim.stats import lower_bound, success_interval, upper_bound

# ---- all cycles at once ---------------------------------------------------------------------


@pytest.mark.parametrize(("succeeded", "cycles"), [(10, 10), (8, 10), (0, 7), (195, 200)])
def test_a_one_sided_bound_is_that_of_the_wider_interval(succeeded, cycles):
    low, high = success_interval(succeeded, cycles, 0.90)
    assert lower_bound(succeeded, cycles, 0.95) == pytest.approx(low, abs=1e-9)
    assert upper_bound(succeeded, cycles, 0.95) == pytest.approx(high, abs=1e-9)


@pytest.mark.parametrize("limit", [0.5, 0.8, 0.95])
@pytest.mark.parametrize("cycles", [10, 59, 200])
def test_the_error_rates_of_the_exact_test_are_kept_and_no_pass_is_given_away(limit, cycles):
    test = ExactTest(limit=limit, confidence=0.95)
    verdicts = [test.verdict(count, cycles) for count in range(cycles + 1)]
    chance = binom.pmf(np.arange(cycles + 1), cycles, limit)
    passes, fails = (np.array([each == name for each in verdicts]) for name in (PASSED, FAILED))
    assert chance[passes].sum() <= 0.05
    assert chance[fails].sum() <= 0.05
    least = int(np.argmax(passes)) if passes.any() else cycles + 1
    assert passes[least:].all()
    assert chance[least - 1 :].sum() > 0.05  # one success less would break the promise


@pytest.mark.parametrize(
    ("limit", "confidence", "needed"),
    [(0.8, 0.95, 14), (0.9, 0.95, 29), (0.95, 0.95, 59), (0.99, 0.95, 299), (0.95, 0.99, 90)],
)
def test_without_a_failure_it_takes_the_cycles_of_the_tables(limit, confidence, needed):
    test = ExactTest(limit=limit, confidence=confidence)
    assert needed == math.ceil(math.log(1 - confidence) / math.log(limit))
    found = test.as_json(10, 10)
    assert (found["verdict"], found["cycles_if_all_succeed"]) == (UNDECIDED, needed)
    assert found["cycles_at_this_rate"] == needed
    assert test.verdict(needed, needed) == PASSED
    assert test.verdict(needed - 1, needed - 1) == UNDECIDED


@pytest.mark.parametrize("test", [ExactTest, SequentialTest.of_gate], ids=["exact", "sequential"])
@pytest.mark.parametrize(("succeeded", "cycles"), [(57, 59), (95, 100), (3, 4), (0, 0)])
def test_the_cycles_needed_are_the_fewest(test, succeeded, cycles):
    test = test(limit=0.9, confidence=0.95)
    needed = test.as_json(succeeded, cycles)["cycles_if_all_succeed"]
    failed = cycles - succeeded
    assert needed > cycles
    assert test.verdict(needed - failed, needed) == PASSED
    assert test.verdict(needed - 1 - failed, needed - 1) == UNDECIDED


def test_the_cycles_needed_at_the_rate_so_far_lead_to_a_verdict():
    test = ExactTest(limit=0.95, confidence=0.95)
    count = test.as_json(195, 200)["cycles_at_this_rate"]
    assert 200 < count < 1000
    assert test.verdict(round(0.975 * count), count) == PASSED
    assert test.as_json(190, 200)["cycles_at_this_rate"] is None  # the limit itself
    count = test.as_json(9, 10)["cycles_at_this_rate"]
    assert test.verdict(round(0.9 * count), count) == FAILED


# ---- cycle by cycle -------------------------------------------------------------------------


def play(test: SequentialTest, rate: float, *, runs: int, cycles: int, seed: int):
    """Play many runs of Bernoulli cycles; returns verdicts and how many cycles each took."""
    successes = np.random.default_rng(seed).random((runs, cycles)) < rate
    counts = np.cumsum(successes, axis=1, dtype=np.int32)
    success, failure = test.steps
    fails, passes = test.thresholds
    ratio = counts * (success - failure) + np.arange(1, cycles + 1) * failure
    out = (ratio >= passes) | (ratio <= fails)
    at = np.where(out.any(axis=1), out.argmax(axis=1), cycles - 1)
    last = ratio[np.arange(runs), at]
    verdicts = np.where(last >= passes, PASSED, np.where(last <= fails, FAILED, UNDECIDED))
    return successes, verdicts, at + 1


RUNS = 4000
ERROR = 3 * math.sqrt(0.05 * 0.95 / RUNS)
"""Three standard deviations of a share of 5 % of the runs."""


@pytest.mark.parametrize("cycles", [1500, 120], ids=["long", "truncated"])
@pytest.mark.parametrize(("limit", "width"), [(0.95, None), (0.8, 0.1), (0.9, 0.05)])
def test_the_error_rates_of_the_sequential_test_are_kept(limit, width, cycles):
    test = SequentialTest.of_gate(limit, 0.95, width)
    _, at_limit, _ = play(test, limit, runs=RUNS, cycles=cycles, seed=1)
    _, above, _ = play(test, limit + test.indifference, runs=RUNS, cycles=cycles, seed=2)
    false_pass, false_fail = np.mean(at_limit == PASSED), np.mean(above == FAILED)
    assert false_pass <= 0.05 + ERROR
    assert false_fail <= 0.05 + ERROR
    if cycles == 1500:  # nor is it wasteful, and nearly all runs are decided
        assert false_pass >= 0.025
        assert false_fail >= 0.02
        assert np.mean(np.concatenate([at_limit, above]) == UNDECIDED) < 0.01
        assert np.mean(above == PASSED) >= 0.95 - ERROR
    else:
        assert np.mean(at_limit == UNDECIDED) > 0.05


def test_below_the_limit_a_pass_is_rarer_still():
    test = SequentialTest.of_gate(0.95, 0.95)
    _, verdicts, _ = play(test, 0.93, runs=RUNS, cycles=1500, seed=3)
    assert np.mean(verdicts == PASSED) < 0.01


def test_a_test_with_too_bold_thresholds_would_be_caught():
    class Bold(SequentialTest):
        @property
        def thresholds(self):
            return math.log(0.2), -math.log(0.2)

    _, verdicts, _ = play(Bold.of_gate(0.95, 0.95), 0.95, runs=RUNS, cycles=1500, seed=1)
    assert np.mean(verdicts == PASSED) > 0.05 + ERROR


def fixed_size(low: float, high: float, error: float) -> int:
    """Return the cycles of the smallest test of fixed size with these error rates."""
    for cycles in range(1, 1000):
        least = int(binom.isf(error, cycles, low)) + 1
        if binom.cdf(least - 1, cycles, high) <= error:
            return cycles
    raise AssertionError


@pytest.mark.parametrize("limit", [0.8, 0.95])
def test_it_takes_fewer_cycles_than_a_test_of_fixed_size(limit):
    test = SequentialTest.of_gate(limit, 0.95)
    high = limit + test.indifference
    needed = fixed_size(limit, high, 0.05)
    for rate in (limit, high):
        _, _, taken = play(test, rate, runs=RUNS, cycles=1500, seed=4)
        assert np.mean(taken) < 0.75 * needed
    assert test.as_json(0, 0)["cycles_if_all_succeed"] < needed / 2


def test_a_watch_decides_where_the_simulation_does_and_stays_with_it():
    test = SequentialTest.of_gate(0.9, 0.95)
    successes, verdicts, taken = play(test, 0.93, runs=40, cycles=400, seed=5)
    for row, verdict, count in zip(successes, verdicts, taken, strict=True):
        watch = Watch(test)
        for success in row:
            watch.see(bool(success))
        found = watch.as_json()
        assert found["verdict"] == verdict
        assert found["decided_after"] == (count if verdict != UNDECIDED else None)
        assert watch.decided == (verdict != UNDECIDED)
    assert {PASSED, FAILED} <= set(verdicts)


@pytest.mark.parametrize("rates", [(0.9, 0.1), (0.9, 0.0), (0.0, 0.1), (1.0, 0.1)])
def test_rates_without_a_test_are_refused(rates):
    with pytest.raises(ValueError):  # noqa: PT011, the configuration refuses them with a message
        SequentialTest(limit=rates[0], indifference=rates[1], alpha=0.05, beta=0.05)
    with pytest.raises(ValueError):  # noqa: PT011
        SequentialTest(limit=0.9, indifference=0.05, alpha=0.5, beta=0.5)


# ---- the gate -------------------------------------------------------------------------------


def judged(succeeded: int, cycles: int, **gates) -> dict:
    gate = Gates(min_success=0.95, **gates)
    watch = gate.watch()
    if watch:
        for cycle in range(cycles):
            watch.see(cycle >= cycles - succeeded)
    nothing = {"ik_offset_m": {"max": None}, "cycle_time_s": {"max": None}}
    return gate.judge(succeeded, cycles, watch, nothing)["min_success"]


def test_a_plain_rate_passes_what_is_not_proved():
    assert judged(10, 10) == {"limit": 0.95, "value": 1.0, "met": True}
    proved = judged(10, 10, confidence=0.95)
    assert (proved["met"], proved["proof"]["verdict"]) == (False, UNDECIDED)
    assert proved["proof"]["bounds"][0] == pytest.approx(0.05**0.1)
    assert judged(59, 59, confidence=0.95)["met"]
    assert judged(80, 100, confidence=0.95)["proof"]["verdict"] == FAILED


@pytest.mark.parametrize(("cycles", "decided"), [(72, None), (73, 73), (200, 73)])
def test_an_early_stop_is_judged_at_the_cycle_that_decided(cycles, decided):
    found = judged(cycles, cycles, confidence=0.95, stop_early=True)
    assert found["proof"]["decided_after"] == decided
    assert found["met"] == (decided is not None)
    assert found["proof"]["hypotheses"] == [0.95, pytest.approx(0.99)]


def test_nothing_is_proved_by_no_cycles():
    for gates in ({"confidence": 0.95}, {"confidence": 0.95, "stop_early": True}):
        found = judged(0, 0, **gates)
        assert (found["met"], found["value"], found["proof"]["verdict"]) == (False, None, UNDECIDED)


@pytest.mark.parametrize(
    ("options", "named"),
    [
        ({"confidence": 0.5}, "--confidence"),
        ({"confidence": 1.0}, "--confidence"),
        ({"confidence": -1.0}, "--confidence"),
        ({"confidence": 95.0}, "--confidence"),
        ({"confidence": math.nan}, "--confidence"),
        ({"confidence": 0.95, "min_success": 1.0}, "rate of 1.0 is proved by no"),
        ({"confidence": 0.95, "min_success": 0.0}, "rate of 0.0 needs no proof"),
        ({"stop_early": True}, "--stop-early.*--confidence"),
        ({"indifference": 0.1}, "--indifference.*--stop-early"),
        ({"confidence": 0.9, "indifference": 0.1}, "--indifference.*--stop-early"),
        *(
            ({"confidence": 0.9, "stop_early": True, "indifference": width}, "less than 0.2")
            for width in (0.0, -0.1, 0.2, math.nan, math.inf, 1e-30)
        ),
    ],
    ids=str,
)
def test_a_proof_that_makes_no_sense_is_refused(options, named):
    with pytest.raises(BadInput, match=named):
        RunConfig(**options)


@pytest.mark.parametrize("rate", [1e-6, 0.5, 0.999, 1 - 1e-6])
@pytest.mark.parametrize("confidence", [0.500001, 1 - 1e-6])
def test_whatever_is_not_refused_can_be_tested(rate, confidence):
    config = RunConfig(min_success=rate, confidence=confidence, stop_early=True)
    gates = Gates.of(config)
    watch = gates.watch()
    watch.see(True)
    assert watch.as_json()["verdict"] in (PASSED, FAILED, UNDECIDED)
