"""What sets failed cycles apart: quantities drawn at random whose means differ from successes'."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
from scipy.stats import norm

from kr210_sim.arrays import Array
from kr210_sim.success_map import quantities

_NOT_ORDERED = "cell"
"""A quantity whose mean says nothing."""


class Difference(NamedTuple):
    """How far the mean of the failed cycles is above that of the others [standard deviations]."""

    name: str
    size: float


class Separation:
    """Compares what was drawn for failed and for other cycles, in memory that does not grow."""

    def __init__(self) -> None:
        self._first: dict[str, float] = {}
        self._sums: dict[str, Array] = {}

    def add(self, line: Mapping[str, Any]) -> None:
        """Take a cycle as `cycles.jsonl` has it."""
        for name, value in quantities(line).items():
            if name == _NOT_ORDERED:
                continue
            shifted = value - self._first.setdefault(name, value)  # keeps digits in the squares
            sums = self._sums.setdefault(name, np.zeros((2, 3)))
            sums[int(line["success"])] += 1.0, shifted, shifted**2

    def differences(self) -> list[Difference]:
        """Return the quantities that vary, the largest difference first.

        None without a failure, or without a success.
        """
        found = []
        for name, sums in self._sums.items():
            count, total, squares = sums.sum(axis=0)
            spread = math.sqrt(max(0.0, squares / count - (total / count) ** 2))
            if np.all(sums[:, 0] > 0) and spread > 1e-9 * abs(self._first[name]):
                failed, other = sums[:, 1] / sums[:, 0]
                found.append(Difference(name, float((failed - other) / spread)))
        return sorted(found, key=lambda each: (-abs(each.size), each.name))

    def by_chance(self) -> float:
        """Return how large the largest difference is, in the median, if nothing matters.

        Quantities are taken for independent, and their means for normal.
        """
        found = self.differences()
        if not found:
            return 0.0
        failed, other = self._sums[found[0].name][:, 0]
        largest = norm.ppf((1.0 + 0.5 ** (1.0 / len(found))) / 2.0)
        return float(largest * math.sqrt(1.0 / failed + 1.0 / other))


def telling_pair(found: list[Difference]) -> tuple[Difference, Difference] | None:
    """Return the two largest differences, if there are others not of parts of the same vector."""
    if len(found) < 2:
        return None
    vector = found[0].name.partition(".")[0]
    others = (each for each in found[1:] if each.name.partition(".")[0] != vector)
    return found[0], next(others, found[1])
