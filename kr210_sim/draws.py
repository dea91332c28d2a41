"""The random values of a cycle, drawn by its seed from the distributions of a block."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import TypeAlias

import numpy as np

from kr210_sim.arrays import Array
from kr210_sim.randomize import (
    QUANTITIES,
    Choice,
    Distribution,
    Fixed,
    LogUniform,
    Normal,
    Uniform,
)

Value: TypeAlias = float | int | list[float]


class Draws:
    """The random values of one cycle.

    Every quantity has a stream of its own, a child of the cycle's seed: what is drawn for one does
    not depend on which others are random, on how often they are drawn, or on other cycles.

    Args:
        block: quantity -> distribution.
        seed: of the cycle.
    """

    def __init__(self, block: Mapping[str, Distribution], seed: int) -> None:
        self._block = block
        self._streams = {
            name: np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(place,)))
            for place, name in enumerate(QUANTITIES)
            if name in block
        }

    def __contains__(self, name: str) -> bool:
        """Tell whether a quantity is random."""
        return name in self._block

    def number(self, name: str) -> float:
        """Return the next value of a random quantity that has one."""
        return self.vector(name)[0]

    def vector(self, name: str) -> list[float]:
        """Return the next values of a random quantity."""
        values = _drawn(self._block[name], self._streams[name], QUANTITIES[name].count)
        return [float(value) for value in values]


def _drawn(distribution: Distribution, rng: np.random.Generator, count: int) -> Array:
    """Return values (count,) of a distribution, in the unit of its quantity."""
    match distribution:
        case Fixed(value):
            return np.full(count, value)
        case Uniform(low, high):
            return rng.uniform(low, high, count)
        case LogUniform(low, high):
            values = np.exp(rng.uniform(math.log(low), math.log(high), count))
            return np.clip(values, low, high)  # what rounding brings out of the bounds
        case Normal(mean, sigma):
            return rng.normal(mean, sigma, count)
        case Choice(values):
            return np.array(values, dtype=float)[rng.integers(0, len(values), count)]
