"""What the measurements of some record steps mean, before anything is concluded from it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from kr210_sim.arrays import Array


@dataclass(frozen=True, kw_only=True)
class Seen:
    """Some record steps of equal length, a row per physics step if not said else.

    Attributes:
        count: number of record steps.
        rows, column: the measurements, and parts of them by name.
        touch: (n, 2) of the right and left finger.
        clear: height above the rest while both fingers and nothing else touch, else 0 [m].
        lifted: (count,), whether the target has been lifted by the end of a record step.
        slip_m, slip_rad, lift_off: since lift-off, and its pose in the TCP frame then.
        foreign: number of contacts that are not permitted.
        excess, speed_ratio, effort_ratio: of the joints' positions, speeds and efforts.
        tracking: distance of measured from commanded TCP [m].
        speed, spin: of the target [m/s, rad/s].
    """

    count: int
    rows: Array
    column: dict[str, Array]
    touch: NDArray[np.bool_]
    clear: Array
    lifted: NDArray[np.bool_]
    slip_m: Array
    slip_rad: Array
    lift_off: tuple[Array, Array] | None
    foreign: Array
    excess: Array
    speed_ratio: Array
    effort_ratio: Array
    tracking: Array
    speed: Array
    spin: Array

    def each(self, values: NDArray[Any]) -> NDArray[Any]:
        """Return values (n, ...) with an axis of record steps in front."""
        return values.reshape(self.count, -1, *values.shape[1:])

    def peaks(self) -> dict[str, Array]:
        """Return the series (count,) of the largest values in each record step."""
        single = {
            "tracking_max": self.tracking,
            "clear_height_max": self.clear,
            "slip_m_max": self.slip_m,
            "slip_rad_max": self.slip_rad,
            "target_speed_max": self.speed,
            "target_spin_max": self.spin,
            "foreign_contacts_max": self.foreign,
        }
        several = {
            "position_excess_max": self.excess,
            "speed_ratio_max": self.speed_ratio,
            "effort_ratio_max": self.effort_ratio,
        }
        largest = np.max(self.each(np.column_stack([*single.values(), *several.values()])), axis=1)
        peaks = dict(zip(single, largest.T, strict=False))
        first = len(single)
        for name, values in several.items():
            peaks[name] = np.max(largest[:, first : first + values.shape[1]], axis=1)
            first += values.shape[1]
        peaks["position_excess_max"] = np.maximum(0.0, peaks["position_excess_max"])
        return peaks
