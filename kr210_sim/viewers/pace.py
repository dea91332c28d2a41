"""When simulated time goes on while somebody watches: real time, faster, slower, not at all."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable

from kr210_sim.exceptions import BadInput

MIN_SPEED, MAX_SPEED = 0.05, 20.0
"""Simulated over real time; above what the machine can simulate nothing waits."""

_LATE = 0.25
"""A simulation that is later than this does not hurry to make up for it [s]."""

_TICK = 1.0 / 30.0
"""Longest wait before whoever waits looks about again [s]."""


def check_speed(option: str, speed: float) -> None:
    """Refuse a speed that cannot be kept.

    Raises:
        BadInput: naming the option.
    """
    if not MIN_SPEED <= speed <= MAX_SPEED:
        raise BadInput(f"{option}: {speed} is out of range; give {MIN_SPEED:g} to {MAX_SPEED:g}")


class Pace:
    """Holds the simulating thread back; any thread may pause, step and change the speed.

    Args:
        speed: simulated over real time.
        clock: time in seconds; another one makes tests independent of the machine.

    Attributes:
        on_change: called when simulated time stops or goes on.
    """

    def __init__(self, speed: float = 1.0, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock = clock
        self._changed = threading.Condition()
        self._speed, self._paused, self._ended = speed, False, False
        self._step_from: str | None = None
        self._anchor: tuple[float, float] | None = None  # real and simulated time that belong
        self._stage = ""
        self.on_change: Callable[[], None] = lambda: None

    @property
    def paused(self) -> bool:
        """Whether simulated time stands still."""
        return self._paused

    @property
    def speed(self) -> float:
        """Simulated over real time."""
        return self._speed

    @property
    def ended(self) -> bool:
        """Whether nobody watches any more."""
        return self._ended

    def jump(self) -> None:
        """Forget what was due when: simulated time makes a jump."""
        with self._changed:
            self._anchor = None
            self._changed.notify_all()

    def set_speed(self, speed: float) -> None:
        """Change the speed; it is kept between MIN_SPEED and MAX_SPEED."""
        with self._changed:
            self._speed = min(max(speed, MIN_SPEED), MAX_SPEED)
            self._anchor = None
            self._changed.notify_all()

    def pause(self) -> None:
        """Stand still at the next step."""
        self._set(paused=True)

    def resume(self) -> None:
        """Go on."""
        self._set(paused=False)

    def toggle(self) -> None:
        """Pause, or go on."""
        self._set(paused=not self._paused)

    def step_stage(self) -> None:
        """Go on until the next stage begins, and stand still there."""
        self._set(paused=False, step_from=self._stage)

    def end(self) -> None:
        """Hold nothing back any more, as nobody watches."""
        with self._changed:
            self._ended = True
            self._changed.notify_all()

    def _set(self, *, paused: bool, step_from: str | None = None) -> None:
        with self._changed:
            self._paused, self._step_from, self._anchor = paused, step_from, None
            self._changed.notify_all()
        self.on_change()

    def hold(
        self, stage: str, simulated: float, *, idle: Callable[[], None] = lambda: None
    ) -> None:
        """Return when the simulation may go on from a time.

        Args:
            stage: in which it is.
            simulated: its time since the start of the cycle [s].
            idle: called about 30 times a second while it waits.
        """
        self._enter(stage)
        while True:
            with self._changed:
                if self._ended:
                    return
                if not self._paused:
                    early = self._early(simulated)
                    if early <= 0.0:
                        return
                    self._changed.wait(min(early, _TICK))
                else:
                    self._changed.wait(_TICK)
            idle()

    def _enter(self, stage: str) -> None:
        with self._changed:
            arrived = self._step_from is not None and stage != self._step_from
            if arrived:
                self._paused, self._step_from = True, None
            self._stage = stage
        if arrived:
            self.on_change()

    def _early(self, simulated: float) -> float:
        """Return by how much a simulated time is too early [s]; at most 0 if it is due."""
        now = self._clock()
        if self._anchor is not None and simulated >= self._anchor[1]:
            early = self._anchor[0] + (simulated - self._anchor[1]) / self._speed - now
            if early >= -_LATE:
                return early
        self._anchor = (now, simulated)
        return 0.0
