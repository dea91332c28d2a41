"""Timed motions -> the least clearance between cell and bin, rounded corners included."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Protocol

import numpy as np

from kr210_sim.arrays import Array
from kr210_sim.planning import Hand, Leg
from kr210_sim.record import FREE_STAGES
from kr210_sim.trajectory import Trajectory

_STEP = 0.002
"""Spacing in time of the configurations between which a trajectory counts as straight [s]; at the
acceleration limits it bends by less than 0.1 mm in between."""


class Gauge(Protocol):
    """What measures clearance."""

    def least(self, q: Array, *, hand: Hand) -> float:
        """Return the least clearance [m] along the polyline through configurations (N, 6)."""
        ...


def least_clearance(legs: Sequence[Leg], trajectory: Trajectory, gauge: Gauge) -> dict[str, float]:
    """Return the least clearance [m] in each stage of a motion that lies outside cell and bin.

    While two legs overlap, the tool rounds the corner between them: that counts for the leg that
    need not keep as much, so that what is near a cell's wall belongs to a line in the cell.

    Args:
        legs: as planned.
        trajectory: of these legs.
        gauge: measures.
    """
    found: dict[str, float] = {}
    for stage, hand, begin, end in _pieces(legs, trajectory):
        if stage not in FREE_STAGES:
            continue
        count = max(2, int(np.ceil((end - begin) / _STEP)) + 1)
        q = trajectory.positions(np.linspace(begin, end, count))
        found[stage] = min(found.get(stage, np.inf), gauge.least(q, hand=hand))
    return found


def _pieces(
    legs: Sequence[Leg], trajectory: Trajectory
) -> Iterator[tuple[str, Hand, float, float]]:
    """Yield stage, hand, begin and end [s] of what is one leg alone and of the overlaps."""
    begin = 0.0
    for index, leg in enumerate(legs):
        if index + 1 == len(legs):
            yield leg.stage, leg.hand, begin, trajectory.duration
            return
        after = legs[index + 1]
        start, end = float(trajectory.starts[index + 1]), float(trajectory.ends[index])
        yield leg.stage, leg.hand, begin, max(begin, start)
        owner = leg if leg.clearance < after.clearance else after
        yield owner.stage, after.hand, start, max(start, end)
        begin = max(start, end)
