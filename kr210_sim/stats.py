"""CycleScores -> Summary numbers: spreads and exact intervals."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from scipy.stats import binomtest

_QUANTILES = {"p50": 0.50, "p95": 0.95, "p99": 0.99}


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


def success_interval(succeeded: int, cycles: int, confidence: float = 0.95) -> tuple[float, float]:
    """Return the exact (Clopper-Pearson) interval of a success rate."""
    interval = binomtest(succeeded, cycles).proportion_ci(confidence, method="exact")
    return float(interval.low), float(interval.high)


def count_reasons(reasons: Sequence[str | None]) -> dict[str, int]:
    """Count failures by reason, most frequent first."""
    found: dict[str, int] = {}
    for reason in reasons:
        if reason is not None:
            found[reason] = found.get(reason, 0) + 1
    return dict(sorted(found.items(), key=lambda item: (-item[1], item[0])))


def pooled(arrays: Sequence[Any]) -> Any:
    """Join the samples of several cycles."""
    return np.concatenate(arrays) if arrays else np.empty(0)
