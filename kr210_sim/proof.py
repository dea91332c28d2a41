"""What successes prove: a rate tested exactly after all cycles, or by Wald's test as they come."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from kr210_sim.stats import lower_bound, upper_bound

MOST_CYCLES = 10**8
"""Needed cycles are not counted beyond this."""

PASSED, FAILED, UNDECIDED = "passed", "failed", "undecided"

FEWER_FAILURES = 5.0
"""Without an indifference width, a pass is to be likely where failures are this many times rarer
than the gate allows."""


@dataclass(frozen=True, kw_only=True)
class ExactTest:
    """The test of all cycles at once; its error rates are those of a single look.

    A rate below the limit passes, and one above it fails, with a chance of at most 1 - confidence
    each, exactly and for any number of cycles.

    Attributes:
        limit: rate that must be proved.
        confidence: of the proof.
    """

    limit: float
    confidence: float

    def verdict(self, succeeded: int, cycles: int) -> str:
        """Return whether the rate is proved to reach the limit, not to reach it, or neither."""
        if cycles and lower_bound(succeeded, cycles, self.confidence) >= self.limit:
            return PASSED
        if cycles and upper_bound(succeeded, cycles, self.confidence) < self.limit:
            return FAILED
        return UNDECIDED

    def as_json(self, succeeded: int, cycles: int) -> dict[str, Any]:
        """Return verdict, bounds and what is still needed."""
        bounds = (lower_bound, upper_bound) if cycles else ()
        return {
            "test": "Clopper-Pearson, one-sided",
            "confidence": self.confidence,
            "bounds": [bound(succeeded, cycles, self.confidence) for bound in bounds] or None,
            **_outlook(self.verdict, succeeded, cycles),
        }


@dataclass(frozen=True, kw_only=True)
class SequentialTest:
    """Wald's sequential probability ratio test, looked at after every cycle.

    The likelihood of the cycles at the rate `limit + indifference` over that at `limit` is
    compared with 1 / alpha (passed) and beta (failed). The first never happens with a chance above
    alpha while the rate is at the limit or below, the second never with a chance above beta while
    it is at the sum or above, however many cycles there are (A. Wald, Sequential Analysis, 1947,
    eq. 3:27 to 3:30, in the form that holds without his approximation). In between either verdict
    may come. A run that ends first is undecided, which is no pass: its alpha holds all the same.

    Attributes:
        limit: rate that must be proved, 0 < limit < 1.
        indifference: width above it in which either verdict is right, limit + it < 1.
        alpha: chance of a pass at the limit, at most.
        beta: chance of a fail at the limit and the width, at most.
    """

    limit: float
    indifference: float
    alpha: float
    beta: float

    def __post_init__(self) -> None:
        """Check the rates; ValueError otherwise."""
        if not 0 < self.limit < self.limit + self.indifference < 1:
            raise ValueError
        if not (0 < self.alpha and 0 < self.beta and self.alpha + self.beta < 1):
            raise ValueError

    @classmethod
    def of_gate(
        cls, limit: float, confidence: float, indifference: float | None = None
    ) -> SequentialTest:
        """Return the test whose two error rates are what the confidence leaves."""
        width = (1 - limit) * (1 - 1 / FEWER_FAILURES) if indifference is None else indifference
        return cls(limit=limit, indifference=width, alpha=1 - confidence, beta=1 - confidence)

    @property
    def steps(self) -> tuple[float, float]:
        """What a success and a failure add to the logarithm of the ratio."""
        above = self.limit + self.indifference
        return math.log(above / self.limit), math.log((1 - above) / (1 - self.limit))

    @property
    def thresholds(self) -> tuple[float, float]:
        """Logarithms of the ratios at which it fails and passes."""
        return math.log(self.beta), -math.log(self.alpha)

    def verdict(self, succeeded: int, cycles: int) -> str:
        """Return the verdict after some cycles, if it had not come before."""
        success, failure = self.steps
        ratio = succeeded * success + (cycles - succeeded) * failure  # no sum: order counts nothing
        fails, passes = self.thresholds
        return PASSED if ratio >= passes else FAILED if ratio <= fails else UNDECIDED

    def as_json(self, succeeded: int, cycles: int) -> dict[str, Any]:
        """Return verdict, hypotheses, error rates and what is still needed."""
        return {
            "test": "Wald's SPRT",
            "hypotheses": [self.limit, self.limit + self.indifference],
            "alpha": self.alpha,
            "beta": self.beta,
            **_outlook(self.verdict, succeeded, cycles),
        }


class Watch:
    """A sequential test that follows a run, cycle by cycle, until it has its verdict.

    Attributes:
        decided: whether the verdict is there; later cycles do not change it.
    """

    def __init__(self, test: SequentialTest) -> None:
        self._test = test
        self._succeeded = self._cycles = 0
        self.decided = False

    def see(self, success: bool) -> None:
        """Take the next cycle of the run."""
        if not self.decided:
            self._succeeded += success
            self._cycles += 1
            self.decided = self._test.verdict(self._succeeded, self._cycles) != UNDECIDED

    def as_json(self) -> dict[str, Any]:
        """Return what the test says, and after how many cycles it was decided."""
        decided_after = self._cycles if self.decided else None
        return {
            **self._test.as_json(self._succeeded, self._cycles),
            "decided_after": decided_after,
        }


def _outlook(
    verdict: Callable[[int, int], str], succeeded: int, cycles: int
) -> dict[str, str | int | None]:
    """Return the verdict, and if there is none the numbers of cycles after which there were one.

    `cycles_if_all_succeed` is the least number, exactly; `cycles_at_this_rate` is about where the
    share of successes so far leads, None if it leads nowhere.
    """
    failed = cycles - succeeded
    found = verdict(succeeded, cycles)
    if found != UNDECIDED:
        return {"verdict": found, "cycles_if_all_succeed": None, "cycles_at_this_rate": None}

    def decided(count: int) -> bool:
        share = (2 * succeeded * count + cycles) // (2 * cycles) if cycles else count  # rounded
        return verdict(share, count) != UNDECIDED

    return {
        "verdict": found,
        "cycles_if_all_succeed": _least(cycles, lambda n: verdict(n - failed, n) == PASSED),
        "cycles_at_this_rate": _least(cycles, decided),
    }


def _least(after: int, holds: Callable[[int], bool]) -> int | None:
    """Return the least number above `after` from which on a condition holds, None if there is none.

    Found by bisection.
    """
    low, high = after, max(1, 2 * after)
    while not holds(high):
        if high >= MOST_CYCLES:
            return None
        low, high = high, 2 * high
    while high - low > 1:
        middle = (low + high) // 2
        low, high = (low, middle) if holds(middle) else (middle, high)
    return high
