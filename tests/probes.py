"""Probes that disturb a running cycle before a record step, and what a failure then looks like."""

from __future__ import annotations

from collections.abc import Callable

from kr210_sim.cycle import Probe
from kr210_sim.score import CycleScore
from kr210_sim.simulation import Simulation

Act = Callable[[Simulation], None]

TARGET = "target_0"


def once(stage: str, act: Act, *, after: float = 0.0) -> Probe:
    """Act at the first record step that is at least `after` seconds into a stage."""
    began: list[float] = []
    done: list[bool] = []

    def probe(simulation: Simulation, now: str, time: float) -> None:
        if now != stage or done:
            return
        began.append(time)
        if time >= began[0] + after - 1e-9:
            done.append(True)
            act(simulation)

    return probe


def throughout(stages: str, act: Act) -> Probe:
    """Act at every record step of the stages (separated by blanks)."""

    def probe(simulation: Simulation, now: str, _time: float) -> None:
        if now in stages.split():
            act(simulation)

    return probe


def set_pad_friction(simulation: Simulation, coefficient: float) -> None:
    model = simulation.model
    for geom in range(model.ngeom):
        if "_pad" in model.geom(geom).name:
            model.geom_friction[geom, 0] = coefficient


def assert_failed(score: CycleScore, reason: str, condition: str, stage: str) -> None:
    assert not score.success
    assert score.cause is not None
    assert (score.cause.reason, score.cause.stage) == (reason, stage), score.cause
    assert not score.conditions[condition]
    assert score.cause.detail
    assert 0.0 <= score.cause.time <= 60.0
