"""A run as it happens: what the sequencer's probe sees, handed to whoever shows it."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import mujoco
import numpy as np

from kr210_sim.arrays import Array
from kr210_sim.playback import episode_world, parked, place_joints
from kr210_sim.scene import ROBOT_PREFIX, Scene, Target
from kr210_sim.simulation import Simulation
from kr210_sim.viewers.pace import Pace

_FRAME = 1.0 / 30.0
"""Least real time between two pictures [s]."""


@dataclass(frozen=True, kw_only=True)
class Moment:
    """What is shown beside the picture.

    Attributes:
        cycle: index in the run, or None before the first.
        stage: of the sequencer.
        time: since the start of the cycle [s].
        note: one line, e.g. why a cycle failed.
        still: whether time stands still, so that this is what remains to be seen.
    """

    cycle: int | None
    stage: str
    time: float
    note: str = ""
    still: bool = False


class Screen(Protocol):
    """Something that shows a model in a pose; it never touches the simulation."""

    def load(self, model: mujoco.MjModel, prefix: str) -> None:
        """Show another model, whose robot's names begin with a prefix."""

    def show(self, qpos: Array, moment: Moment) -> None:
        """Show qpos (nq,)."""

    def idle(self) -> None:
        """Do what has to be done while nothing moves."""

    def tell(self, line: dict[str, Any]) -> None:
        """Note a finished cycle, as `cycles.jsonl` has it."""

    def close(self) -> None:
        """Take the window or page away."""


class Watcher:
    """Shows a run on a screen, from copies: the simulation is only read.

    The model that is shown is not the one that is simulated. It has all targets of an episode from
    the start; those that are not in the world are parked behind the robot.

    Args:
        screen: where to.
        pace: which waits.
    """

    def __init__(self, screen: Screen, pace: Pace) -> None:
        self._screen, self._pace = screen, pace
        self._model: mujoco.MjModel | None = None
        self._parked = np.empty(0)
        self._cycle = 0
        self._due = -np.inf

    def begin(self, scene: Scene, targets: Sequence[Target], first_cycle: int) -> None:
        """Show another episode.

        Args:
            scene: without targets.
            targets: all that the episode will have, those that are picked first.
            first_cycle: index in the run of its first cycle.
        """
        model = episode_world(scene, targets, []).compile()
        self._parked = parked(model, scene, targets)
        self._model, self._cycle = model, first_cycle
        self._screen.load(model, ROBOT_PREFIX)

    def __call__(self, simulation: Simulation, stage: str, simulated: float) -> None:
        """Look at the simulation, and hold it back until it may go on; this is a `Probe`."""
        started = time.monotonic()
        waiting = True  # to be seen, should time stand still here

        def idle() -> None:
            nonlocal waiting
            if waiting and self._pace.paused:
                waiting = False
                self._show(simulation, stage, simulated)
            self._screen.idle()

        if started >= self._due:
            self._show(simulation, stage, simulated)
            shown = time.monotonic()
            self._due = shown + max(_FRAME, shown - started)  # at least half the time simulates
        self._pace.hold(stage, simulated, idle=idle)

    def tell(self, line: dict[str, Any]) -> None:
        """Note a finished cycle, as `cycles.jsonl` has it."""
        self._cycle = int(line["cycle"]) + 1
        self._due = -np.inf
        self._screen.tell(line)

    def _show(self, simulation: Simulation, stage: str, simulated: float) -> None:
        assert self._model is not None
        positions = simulation.positions()
        qpos = self._parked.copy()
        widths = [(name, len(values)) for name, values in positions.items()]
        place_joints(self._model, qpos, widths, np.concatenate(list(positions.values())))
        moment = Moment(cycle=self._cycle, stage=stage, time=simulated, still=self._pace.paused)
        self._screen.show(qpos, moment)
