"""Failed cycles grouped by their first cause, each group with the command that shows it again."""

from __future__ import annotations

import re
import shlex
from collections.abc import Mapping
from typing import Any

from kr210_sim.config import FREE, RunConfig
from kr210_sim.options import command_words

SHOWN = 12
"""Groups that the terminal shows; `summary.json` has them all."""

CYCLES_NAMED = 5
"""Cycles that a group names."""

_NUMBER = re.compile(r"(?<=target_)\d+|(?<![\w.])\d+(\.\d+)?(e[-+]?\d+)?")
"""What differs between failures of one cause: values and targets, but neither joints nor links."""

_LEFT_OUT = (FREE - {"cycles"}) | {"record", "only_cycle"}
"""Options that do not change what happens in a cycle."""


def show_again(config: RunConfig, cycle: int) -> str:
    """Return the command that plays one cycle of a run again, to the same bits.

    Args:
        config: options of the run; its paths hold where the command is given.
        cycle: index in the run.
    """
    words = command_words(config.as_json(), _LEFT_OUT)
    return shlex.join([*words, "--only-cycle", str(cycle)])


class FirstCauses:
    """The failed cycles of a run in groups: same reason, stage and detail, `_NUMBER` apart."""

    def __init__(self, config: RunConfig) -> None:
        self._config = config
        self._groups: dict[tuple[str, str, str], dict[str, Any]] = {}

    def add(self, line: Mapping[str, Any]) -> None:
        """Take a cycle as `cycles.jsonl` has it; one that succeeded changes nothing."""
        if line["reason"] is None:
            return
        reason, stage, detail = line["reason"], line["failed_stage"], line["detail"]
        key = (reason, stage, _NUMBER.sub("#", detail))
        time = line["failed_time_s"]
        if key not in self._groups:
            self._groups[key] = {
                "reason": reason,
                "count": 0,
                "stage": stage,
                "time_s": [time, time],
                "detail": detail,
                "cycles": [],
                "command": show_again(self._config, line["cycle"]),
            }
        group = self._groups[key]
        group["count"] += 1
        group["time_s"] = [min(group["time_s"][0], time), max(group["time_s"][1], time)]
        if len(group["cycles"]) < CYCLES_NAMED:
            group["cycles"].append(line["cycle"])

    def as_json(self) -> list[dict[str, Any]]:
        """Return the groups, the largest first.

        Each has reason, stage, and count; the earliest and latest time since the start of the
        cycle [s]; the detail (bodies, joints or values) and the command of its first cycle; and
        its first cycles.
        """
        return sorted(self._groups.values(), key=lambda group: (-group["count"], group["cycles"]))


def causes_text(groups: list[dict[str, Any]]) -> list[str]:
    """Return the lines of the terminal for what `FirstCauses.as_json` returns."""
    lines = []
    for group in groups[:SHOWN]:
        first, last = (f"{time:.2f}" for time in group["time_s"])
        when = first if first == last else f"{first} to {last}"
        more = ", ..." if group["count"] > len(group["cycles"]) else ""
        cycles = f"cycle{'s' * (group['count'] > 1)} {', '.join(map(str, group['cycles']))}{more}"
        lines.append(
            f"  {group['count']} x {group['reason']} in {group['stage']} at {when} s: "
            f"{group['detail']} ({cycles})"
        )
        lines.append(f"      {group['command']}")
    if len(groups) > SHOWN:
        lines.append(f"  and {len(groups) - SHOWN} more causes, in summary.json")
    return lines
