"""Cycles on a page, as they happen or from a record: the picture, its camera, and what goes on."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from typing import Any

import mujoco
import numpy as np

from kr210_sim.arrays import Array
from kr210_sim.viewers.live import Moment
from kr210_sim.viewers.pace import MAX_SPEED, Pace
from kr210_sim.viewers.page import Page, add_shadow_box
from kr210_sim.viewers.puppet import Puppet
from kr210_sim.viewers.tables import cycles_html, status_html

FREE, FOLLOW = "free", "follow the gripper"

SPEEDS = {"0.1 x": 0.1, "0.25 x": 0.25, "0.5 x": 0.5, "1 x": 1.0, "2 x": 2.0, "5 x": 5.0}
"""Simulated over real time, to choose from."""

FASTEST = "as fast as it goes"

_TICK = 0.01
"""Step of the time slider [s]."""

_STATUS_PERIOD = 0.1  # [s], between two changes of the status


class CyclePage:
    """The picture of a cycle on a page, with the choice of a camera.

    Args:
        page: where it goes.

    Attributes:
        page: where it is.
    """

    def __init__(self, page: Page) -> None:
        self.page = page
        self._puppet: Puppet | None = None
        self._prefix = ""
        self._tcp = np.zeros(3)
        self._told = -np.inf
        gui = page.server.gui
        self._status = gui.add_html(status_html([("state", "planning")]), order=0)
        self._camera = gui.add_dropdown("camera", [FREE, FOLLOW], initial_value=FREE, order=9)
        self._camera.on_update(lambda _: self._look())
        add_shadow_box(page, order=11)

    def load(self, model: mujoco.MjModel, prefix: str) -> None:
        """Show another model, whose robot's names begin with a prefix."""
        first = self._puppet is None
        self._puppet, self._prefix = Puppet(model), prefix
        views = self._puppet.views()
        self.page.show(model)
        self._camera.options = [FREE, FOLLOW, *views]
        self._tcp = self._puppet.site(f"{prefix}tcp")
        if first and views:
            self.page.look(next(iter(views.values())))

    def show(self, qpos: Array, moment: Moment) -> None:
        """Show qpos (nq,)."""
        assert self._puppet is not None
        self.page.pose(*self._puppet.place(qpos))
        tcp = self._puppet.site(f"{self._prefix}tcp")
        if self._camera.value == FOLLOW:
            self.page.follow(tcp - self._tcp)
        self._tcp = tcp
        now = time.monotonic()
        if moment.still or now - self._told >= _STATUS_PERIOD:
            self._told = now
            self._status.content = status_html(self._rows(moment))

    def _rows(self, moment: Moment) -> list[tuple[str, str]]:
        rows = [
            ("cycle", "" if moment.cycle is None else str(moment.cycle)),
            ("stage", moment.stage),
            ("time", f"{moment.time:.2f} s"),
        ]
        return [*rows, ("note", moment.note)] if moment.note else rows

    def _look(self) -> None:
        assert self._puppet is not None
        view = self._puppet.views().get(self._camera.value)
        if view is not None:
            self.page.look(view)

    def idle(self) -> None:
        """Do nothing: the page has threads of its own."""

    def close(self) -> None:
        """Take the page away."""
        self.page.close()


class LivePage(CyclePage):
    """A run as it happens: pause, step a stage, speed, camera, and the cycles so far.

    Args:
        page: where it goes.
        pace: what its buttons change.
    """

    def __init__(self, page: Page, pace: Pace) -> None:
        super().__init__(page)
        add_pace(page, pace, step=True)
        self._lines: list[dict[str, Any]] = []
        self._cycles = page.server.gui.add_html(cycles_html([]), order=10)

    def tell(self, line: dict[str, Any]) -> None:
        """Note a finished cycle, as `cycles.jsonl` has it."""
        self._lines.append(line)
        self._told = -np.inf
        self._cycles.content = cycles_html(self._lines)


class ReplayPage(CyclePage):
    """A recorded cycle: play, time slider, speed and camera.

    Args:
        page: where it goes.
        pace: what its buttons change.
        duration: of the record [s].
        seek: called with the time [s] that the slider is moved to.
    """

    def __init__(
        self, page: Page, pace: Pace, duration: float, seek: Callable[[float], None]
    ) -> None:
        super().__init__(page)
        add_pace(page, pace, step=True)
        end = max(_TICK, _TICK * math.ceil(duration / _TICK))
        self._time = page.server.gui.add_slider("time, s", 0.0, end, _TICK, 0.0, order=5)

        def moved(event: Any) -> None:
            if event.client_id is not None:  # by a visitor, not by `show`
                seek(float(self._time.value))

        self._time.on_update(moved)

    def show(self, qpos: Array, moment: Moment) -> None:
        """Show qpos (nq,), and its time on the slider."""
        super().show(qpos, moment)
        self._time.value = round(moment.time / _TICK) * _TICK

    def tell(self, line: dict[str, Any]) -> None:
        """Do nothing: a record has one cycle."""


def add_pace(page: Page, pace: Pace, *, step: bool) -> None:
    """Add the controls of a pace to a page; `step` adds that of stages."""
    gui = page.server.gui
    button = gui.add_button("Pause", order=1)

    def update() -> None:
        button.label = "Go on" if pace.paused else "Pause"

    def toggle(_event: Any) -> None:
        pace.toggle()
        update()

    button.on_click(toggle)
    pace.on_change = update
    update()
    if step:
        gui.add_button("Step a stage", order=2).on_click(lambda _: pace.step_stage())
    speeds = speed_choices(pace.speed)
    start = next(name for name, speed in speeds.items() if speed == pace.speed)
    choice = gui.add_dropdown("speed", list(speeds), initial_value=start, order=3)
    choice.on_update(lambda _: pace.set_speed(speeds[choice.value]))


def speed_choices(speed: float) -> dict[str, float]:
    """Return the speeds to choose from, by name, a given one among them, the slowest first."""
    own = {} if speed in (*SPEEDS.values(), MAX_SPEED) else {f"{speed:g} x": speed}
    return dict(sorted((SPEEDS | own | {FASTEST: MAX_SPEED}).items(), key=lambda each: each[1]))
