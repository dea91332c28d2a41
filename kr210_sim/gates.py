"""Gates of a run: the figures it must reach for exit status 0."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True, kw_only=True)
class Gates:
    """What a run must reach; None is no gate. A figure that does not exist misses its gate.

    Attributes:
        min_success: least success rate.
        max_ik_offset: largest end-effector offset of any solved pose [m].
        max_cycle_time: longest cycle time of any successful cycle [s].
    """

    min_success: float
    max_ik_offset: float | None = None
    max_cycle_time: float | None = None

    def judge(
        self, success_rate: float | None, ik_offset: float | None, cycle_time: float | None
    ) -> dict[str, dict[str, Any]]:
        """Return limit, value and verdict of every gate there is, by the option's name.

        Args:
            success_rate: of the run.
            ik_offset: largest of the run [m].
            cycle_time: longest of the successful cycles [s].
        """
        found: dict[str, dict[str, Any]] = {}
        for name, limit, value, met in (
            (
                "min_success",
                self.min_success,
                success_rate,
                _reaches(success_rate, self.min_success),
            ),
            ("max_ik_offset", self.max_ik_offset, ik_offset, _keeps(ik_offset, self.max_ik_offset)),
            (
                "max_cycle_time",
                self.max_cycle_time,
                cycle_time,
                _keeps(cycle_time, self.max_cycle_time),
            ),
        ):
            if limit is not None:
                found[name] = {"limit": limit, "value": value, "met": met}
        return found


def _reaches(value: float | None, limit: float) -> bool:
    return value is not None and value >= limit


def _keeps(value: float | None, limit: float | None) -> bool:
    return value is not None and limit is not None and value <= limit
