"""Spreads and exact intervals, against values from tables."""

from __future__ import annotations

import numpy as np
import pytest

from kr210_sim.stats import count_reasons, pooled, spread, success_interval


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


def test_reasons_are_counted_most_frequent_first_and_successes_not_at_all():
    reasons = ["no_path", None, "dropped", "timeout", "dropped", None]
    assert list(count_reasons(reasons).items()) == [
        ("dropped", 2), ("no_path", 1), ("timeout", 1)
    ]  # fmt: skip
    assert count_reasons([None, None]) == {}


def test_samples_are_pooled_in_order_and_nothing_pools_to_nothing():
    np.testing.assert_array_equal(pooled([np.array([1.0]), np.empty(0), np.array([2.0])]), [1, 2])
    assert len(pooled([])) == 0
