"""Spreads and exact intervals, against values from tables."""

from __future__ import annotations

import pickle

import numpy as np
import pytest
from scipy.stats import binomtest

from kr210_sim.stats import Pool, histogram, in_percent, spread, success_interval


@pytest.mark.parametrize(
    ("succeeded", "cycles", "low", "high"),
    [
        (10, 10, 0.6915, 1.0),
        (0, 10, 0.0, 0.3085),
        (8, 10, 0.4439, 0.9748),
        (5, 10, 0.1871, 0.8129),
        (50, 50, 0.9289, 1.0),
        (1, 1, 0.025, 1.0),
    ],
)
def test_the_interval_is_that_of_clopper_and_pearson(succeeded, cycles, low, high):
    assert success_interval(succeeded, cycles) == pytest.approx((low, high), abs=5e-5)


@pytest.mark.parametrize(
    ("succeeded", "cycles", "confidence"),
    [(0, 10, 0.95), (3, 7, 0.9), (7190, 7200, 0.99), (10**8 - 100, 10**8, 1 - 1e-6)],
)
def test_the_interval_is_that_of_the_binomial_test_of_scipy(succeeded, cycles, confidence):
    test = binomtest(succeeded, cycles).proportion_ci(confidence, method="exact")
    found = success_interval(succeeded, cycles, confidence)
    assert found == pytest.approx((test.low, test.high), rel=1e-12, abs=1e-12)


@pytest.mark.parametrize("cycles", [1, 7, 40])
def test_the_interval_holds_the_rate_and_mirrors_with_failures(cycles):
    for succeeded in range(cycles + 1):
        low, high = success_interval(succeeded, cycles)
        assert 0.0 <= low <= succeeded / cycles <= high <= 1.0
        mirrored = success_interval(cycles - succeeded, cycles)
        assert (low, high) == pytest.approx((1 - mirrored[1], 1 - mirrored[0]), abs=1e-9)


def test_the_interval_narrows_with_more_cycles_and_widens_with_confidence():
    widths = [np.ptp(success_interval(n // 2, n)) for n in (10, 100, 1000)]
    assert widths == sorted(widths, reverse=True)
    assert np.ptp(success_interval(5, 10, 0.99)) > np.ptp(success_interval(5, 10, 0.95))


@pytest.mark.parametrize("values", [[], np.empty(0), ()])
def test_the_spread_of_nothing_is_none(values):
    assert spread(values, "mean", "p50", "max") == {"mean": None, "p50": None, "max": None}


def test_a_spread_says_what_its_names_say():
    values = np.random.default_rng(30).permutation(np.arange(101.0))
    assert spread(values, "mean", "p50", "p95", "p99", "max") == pytest.approx(
        {"mean": 50.0, "p50": 50.0, "p95": 95.0, "p99": 99.0, "max": 100.0}
    )


def test_a_spread_of_one_value_is_that_value():
    assert set(spread([0.25], "mean", "p50", "p99", "max").values()) == {0.25}


def test_a_spread_holds_plain_floats_in_the_order_asked_for():
    found = spread(np.float32([1, 2]), "max", "mean")
    assert list(found) == ["max", "mean"]
    assert all(type(value) is float for value in found.values())


def test_an_unknown_name_is_an_error():
    with pytest.raises(KeyError):
        spread([1.0], "median")


def pool_of(samples) -> Pool:
    pool = Pool()
    for values in samples:
        pool.add(spread(values, "mean", "p99", "max"), histogram(values))
    return pool


@pytest.mark.parametrize("scale", [1e-16, 1e-4, 1.0])
def test_points_of_many_cycles_are_pooled_to_what_they_are_together(scale):
    rng = np.random.default_rng(31)
    samples = [scale * rng.lognormal(size=rng.integers(0, 400)) for _ in range(50)]
    names = ("mean", "p50", "p95", "p99", "max")
    pooled, exact = pool_of(samples).spread(*names), spread(np.concatenate(samples), *names)
    assert pooled["max"] == exact["max"]
    assert pooled["mean"] == pytest.approx(exact["mean"], rel=1e-12, abs=0)
    for name in names:
        assert pooled[name] == pytest.approx(exact[name], rel=0.045, abs=0), name


def test_zeros_are_points_too_and_no_points_pool_to_nothing():
    assert pool_of([np.zeros(99), [4.0]]).spread("mean", "p95", "max") == {
        "mean": 0.04, "p95": 0.0, "max": 4.0
    }  # fmt: skip
    assert pool_of([[], []]).spread("mean", "max") == {"mean": None, "max": None}


def test_a_pool_takes_no_more_memory_with_more_points():
    few, many = (
        pool_of(np.random.default_rng(seed).uniform(1e-6, 1e-3, 500) for seed in range(count))
        for count in (20, 200)
    )
    assert len(pickle.dumps(many)) <= 1.2 * len(pickle.dumps(few))


def test_bounds_in_percent_claim_no_more_than_is_so():
    assert in_percent(*success_interval(10, 10)) == ("69.1", "100.0")  # 69.150 %
    assert in_percent(*success_interval(0, 10)) == ("0.0", "30.9")  # 30.850 %
    for succeeded in range(41):
        low, high = success_interval(succeeded, 40)
        below, above = in_percent(low, high)
        assert 100 * low - 0.1 < float(below) <= 100 * low + 1e-6
        assert 100 * high + 0.1 > float(above) >= 100 * high - 1e-6
