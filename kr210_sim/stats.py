"""CycleScores -> Summary numbers: spreads, pooled points, exact intervals."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import betainccinv, betaincinv  # scipy.stats takes a second to import

_ROUNDING = 1e-9  # of a bound in tenths of a percent that means a round number

_QUANTILES = {"p50": 0.50, "p95": 0.95, "p99": 0.99}

BINS_PER_OCTAVE = 16
"""Of a histogram: bins are 4.4 % wide."""

SMALLEST = 1e-18
"""Below this a value counts as zero in a histogram; offsets are sums of terms of 1e-16."""


def spread(values: ArrayLike, *names: str) -> dict[str, float | None]:
    """Summarise numbers by name: "mean", "max", "p50", "p95", "p99"; None where there are none."""
    array = np.asarray(values, dtype=float)
    if array.size == 0:
        return dict.fromkeys(names)
    found = {"mean": float(np.mean(array)), "max": float(np.max(array))}
    return {
        name: found[name] if name in found else float(np.quantile(array, _QUANTILES[name]))
        for name in names
    }


def lower_bound(succeeded: int, cycles: int, confidence: float) -> float:
    """Return the exact one-sided lower bound of a success rate.

    The rate at which so many successes or more have a chance of 1 - confidence (C. J. Clopper and
    E. S. Pearson, Biometrika 26, 1934); by the beta distribution, whose sum of binomial terms it is
    (NIST Digital Library of Mathematical Functions, 8.17.5).
    """
    if not succeeded:
        return 0.0
    return float(betainccinv(succeeded, cycles - succeeded + 1, confidence))


def upper_bound(succeeded: int, cycles: int, confidence: float) -> float:
    """Return the exact one-sided upper bound of a success rate, likewise."""
    if succeeded == cycles:
        return 1.0
    return float(betaincinv(succeeded + 1, cycles - succeeded, confidence))


def success_interval(succeeded: int, cycles: int, confidence: float = 0.95) -> tuple[float, float]:
    """Return the exact (Clopper-Pearson) two-sided interval of a success rate."""
    each = (1 + confidence) / 2
    return lower_bound(succeeded, cycles, each), upper_bound(succeeded, cycles, each)


def in_percent(low: float, high: float) -> tuple[str, str]:
    """Return bounds in percent, one decimal, rounded outwards: they claim no more than is so."""
    lower = math.floor(1000 * low + _ROUNDING) / 10
    upper = math.ceil(1000 * high - _ROUNDING) / 10
    return f"{lower:.1f}", f"{upper:.1f}"


def histogram(values: ArrayLike) -> dict[str, Any]:
    """Count non-negative values in bins of equal ratio, as JSON: zeros, first bin, counts."""
    array = np.asarray(values, dtype=float)
    positive = array[array >= SMALLEST]
    bins = np.floor(np.log2(positive) * BINS_PER_OCTAVE).astype(int)
    first = int(bins.min()) if bins.size else 0
    return {
        "zeros": int(array.size - positive.size),
        "first": first,
        "counts": np.bincount(bins - first).tolist(),
    }


class Pool:
    """The points of many cycles taken together, in constant memory.

    Mean and maximum are those of the points; a quantile is that of their histogram, within 4.4 %.
    """

    def __init__(self) -> None:
        self._counts: dict[int, int] = {}
        self._zeros, self._total, self._sum, self._max = 0, 0, 0.0, 0.0

    def add(self, spread: dict[str, float | None], histogram: dict[str, Any]) -> None:
        """Add the points of one cycle, by what `spread` and `histogram` say of them."""
        points = histogram["zeros"] + sum(histogram["counts"])
        if not points:
            return
        self._total += points
        self._zeros += histogram["zeros"]
        self._sum += points * float(spread["mean"] or 0.0)
        self._max = max(self._max, float(spread["max"] or 0.0))
        for bin_, count in enumerate(histogram["counts"], start=histogram["first"]):
            if count:
                self._counts[bin_] = self._counts.get(bin_, 0) + count

    def spread(self, *names: str) -> dict[str, float | None]:
        """Summarise like the function `spread`."""
        if not self._total:
            return dict.fromkeys(names)
        found = {"mean": self._sum / self._total, "max": self._max}
        return {
            name: found[name] if name in found else self._quantile(_QUANTILES[name])
            for name in names
        }

    def _quantile(self, share: float) -> float:
        rank = share * (self._total - 1) - self._zeros
        if rank < 0:
            return 0.0
        for bin_, count in sorted(self._counts.items()):
            if rank < count:
                return float(min(self._max, 2 ** ((bin_ + (rank + 0.5) / count) / BINS_PER_OCTAVE)))
            rank -= count
        return self._max
