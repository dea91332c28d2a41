"""Gates of a run: the figures it must reach for exit status 0."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Any

from kr210_sim.config import RunConfig
from kr210_sim.proof import PASSED, ExactTest, SequentialTest, Watch


@dataclass(frozen=True, kw_only=True)
class Gates:
    """What a run must reach; None is no gate. A figure that does not exist misses its gate.

    Attributes:
        min_success: least success rate.
        confidence: with which it must be proved; None compares the plain rate.
        stop_early: whether the proof is looked for after every cycle, by Wald's test.
        indifference: width above `min_success` of that test.
        max_ik_offset: largest end-effector offset of any solved pose [m].
        max_cycle_time: longest cycle time of any successful cycle [s].
    """

    min_success: float
    confidence: float | None = None
    stop_early: bool = False
    indifference: float | None = None
    max_ik_offset: float | None = None
    max_cycle_time: float | None = None

    @classmethod
    def of(cls, config: RunConfig) -> Gates:
        """Return what a run must reach: options and gates have the same names."""
        return cls(**{gate.name: getattr(config, gate.name) for gate in fields(cls)})

    def watch(self) -> Watch | None:
        """Return what follows the cycles of a run until its success rate is decided."""
        if not self.stop_early or self.confidence is None:
            return None
        test = SequentialTest.of_gate(self.min_success, self.confidence, self.indifference)
        return Watch(test)

    def judge(
        self,
        succeeded: int,
        cycles: int,
        watch: Watch | None,
        spreads: Mapping[str, Mapping[str, float | None]],
    ) -> dict[str, dict[str, Any]]:
        """Return limit, value and verdict of every gate there is, by the option's name.

        Args:
            succeeded: cycles of the run that did.
            cycles: of the run.
            watch: of this object, having seen all of them in order.
            spreads: `ik_offset_m` of all points and `cycle_time_s` of the successful cycles.
        """
        found = {"min_success": self._success(succeeded, cycles, watch)}
        for name, limit, value in (
            ("max_ik_offset", self.max_ik_offset, spreads["ik_offset_m"]["max"]),
            ("max_cycle_time", self.max_cycle_time, spreads["cycle_time_s"]["max"]),
        ):
            if limit is not None:
                met = value is not None and value <= limit
                found[name] = {"limit": limit, "value": value, "met": met}
        return found

    def _success(self, succeeded: int, cycles: int, watch: Watch | None) -> dict[str, Any]:
        rate = succeeded / cycles if cycles else None
        found = {"limit": self.min_success, "value": rate}
        if self.confidence is None:
            return found | {"met": rate is not None and rate >= self.min_success}
        test = ExactTest(limit=self.min_success, confidence=self.confidence)
        proof = watch.as_json() if watch else test.as_json(succeeded, cycles)
        return found | {"met": proof["verdict"] == PASSED, "proof": proof}
