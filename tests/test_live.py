"""Watching a run: the pace that holds it back, what is shown, and that nothing comes of it."""

from __future__ import annotations

import json
import threading
from dataclasses import dataclass, field
from typing import Any

import mujoco
import numpy as np
import pytest

from kr210_sim.cli import main
from kr210_sim.config import RunConfig
from kr210_sim.exceptions import BadInput
from kr210_sim.runner import run
from kr210_sim.simulation import Simulation
from kr210_sim.viewers import native
from kr210_sim.viewers.cycle_page import FASTEST, SPEEDS, speed_choices
from kr210_sim.viewers.live import Moment, Watcher
from kr210_sim.viewers.pace import MAX_SPEED, Pace
from tests.conftest import standing_target


class Clock:
    """A clock that goes on by 10 ms whenever it is looked at."""

    def __init__(self) -> None:
        self.now = 0.0

    def __call__(self) -> float:
        self.now += 0.01
        return self.now


@dataclass
class FakeScreen:
    """Keeps what it is shown."""

    models: list[mujoco.MjModel] = field(default_factory=list)
    poses: list[np.ndarray] = field(default_factory=list)
    moments: list[Moment] = field(default_factory=list)
    lines: list[dict[str, Any]] = field(default_factory=list)

    def load(self, model: mujoco.MjModel, prefix: str) -> None:
        self.models.append(model)

    def show(self, qpos: np.ndarray, moment: Moment) -> None:
        self.poses.append(qpos)
        self.moments.append(moment)

    def idle(self) -> None:
        pass

    def tell(self, line: dict[str, Any]) -> None:
        self.lines.append(line)

    def close(self) -> None:
        pass


# ---- pace -----------------------------------------------------------------------------------


@pytest.mark.parametrize("speed", [0.5, 4.0])
def test_simulated_time_keeps_its_ratio_to_real_time(speed):
    clock = Clock()
    pace = Pace(speed, clock)
    pace.hold("LIFT", 0.0)
    started = clock.now
    for simulated in np.arange(0.0, 0.4, 0.1):
        pace.hold("LIFT", float(simulated))
    assert clock.now - started == pytest.approx(0.3 / speed, abs=0.1)


def test_a_simulation_that_is_late_does_not_hurry():
    clock = Clock()
    pace = Pace(1.0, clock)
    pace.hold("LIFT", 0.0)
    clock.now += 100.0  # planning
    pace.hold("LIFT", 0.1)
    before = clock.now
    pace.hold("LIFT", 0.4)
    assert clock.now - before == pytest.approx(0.3, abs=0.05)


def test_the_next_cycle_begins_anew_at_time_zero():
    clock = Clock()
    pace = Pace(1.0, clock)
    pace.hold("SETTLE", 5.0)
    pace.hold("MOVE_TO_PICK", 0.0)
    assert clock.now < 0.1


def test_a_pause_lasts_until_it_is_lifted():
    pace, waited = Pace(1.0, Clock()), []

    def idle() -> None:
        waited.append(1)
        if len(waited) == 3:
            pace.resume()

    pace.pause()
    pace.hold("LIFT", 0.0, idle=idle)
    assert len(waited) == 3


def test_a_step_goes_on_to_the_next_stage_and_stands_still_there():
    pace, changes = Pace(MAX_SPEED, Clock()), []
    pace.on_change = lambda: changes.append(pace.paused)
    pace.pause()
    held = iter(["step", "end"])
    seen = []

    def idle() -> None:
        seen.append(pace.paused)
        if next(held) == "step":
            pace.step_stage()
        else:
            pace.end()

    pace.hold("APPROACH", 0.0, idle=idle)
    pace.hold("APPROACH", 0.01)
    assert not pace.paused
    pace.hold("CLOSE_GRIPPER", 0.02, idle=idle)
    assert seen == [True, True]
    assert changes == [True, False, True]


@pytest.mark.parametrize(("speed", "name"), [(1.0, "1 x"), (0.05, "0.05 x"), (20.0, FASTEST)])
def test_the_speed_of_the_start_is_one_to_choose(speed, name):
    choices = speed_choices(speed)
    assert choices[name] == speed
    assert list(choices.values()) == sorted({*SPEEDS.values(), MAX_SPEED, speed})


def test_nobody_is_held_back_once_nobody_watches():
    pace = Pace(1.0, Clock())
    pace.pause()
    threading.Timer(0.01, pace.end).start()
    pace.hold("LIFT", 0.0)
    pace.hold("LIFT", 1e6)


# ---- what is shown --------------------------------------------------------------------------


def test_the_watcher_shows_the_simulated_pose_and_leaves_the_simulation_alone(scene):
    targets = [standing_target(scene, cell, number) for number, cell in enumerate((5, 2))]
    simulation, screen = Simulation(scene), FakeScreen()
    watcher = Watcher(screen, Pace(MAX_SPEED))
    watcher.begin(scene, targets, 20)
    simulation.add(targets[0])
    simulation.begin_at(np.array([0.3, 0.2, -0.4, 0.1, 0.6, 0.2]))
    kind = mujoco.mjtState.mjSTATE_INTEGRATION
    before = np.empty(mujoco.mj_stateSize(simulation.model, kind))
    after = before.copy()
    mujoco.mj_getState(simulation.model, simulation.data, before, kind)
    watcher(simulation, "LIFT", 1.25)
    mujoco.mj_getState(simulation.model, simulation.data, after, kind)
    assert before.tobytes() == after.tobytes()

    (model,), (qpos,) = screen.models, screen.poses
    assert screen.moments == [Moment(cycle=20, stage="LIFT", time=1.25)]
    shown = mujoco.MjData(model)
    shown.qpos[:] = qpos
    mujoco.mj_forward(model, shown)
    for body in range(simulation.model.nbody):
        name = simulation.model.body(body).name
        np.testing.assert_allclose(shown.body(name).xpos, simulation.data.xpos[body], atol=1e-12)
    assert shown.body("target_1").xpos[0] < -1.5  # of a later cycle: parked


def test_what_remains_to_be_seen_while_time_stands_still_is_of_that_moment(scene):
    target = standing_target(scene, 5)
    simulation, screen, pace = Simulation(scene), FakeScreen(), Pace(MAX_SPEED)
    watcher = Watcher(screen, pace)
    watcher.begin(scene, [target], 0)
    simulation.add(target)
    watcher(simulation, "APPROACH", 1.0)
    pace.step_stage()
    screen.idle = pace.resume
    watcher(simulation, "CLOSE_GRIPPER", 1.001)  # too soon for another picture
    assert screen.moments[-1] == Moment(cycle=0, stage="CLOSE_GRIPPER", time=1.001, still=True)


@pytest.mark.slow
def test_a_watched_run_has_the_bits_of_one_that_is_not(default_run, tmp_path):
    screen = FakeScreen()
    watcher = Watcher(screen, Pace(MAX_SPEED))
    config = RunConfig(cycles=1, viewer="web", viewer_speed=MAX_SPEED, out=tmp_path / "run")
    out, _ = run(config, on_cycle=watcher.tell, onlooker=watcher)
    first = (out / "cycles.jsonl").read_text().splitlines()[0]
    other = (default_run.out / "cycles.jsonl").read_text().splitlines()[0]
    lines = [{k: v for k, v in json.loads(x).items() if k != "wall_clock"} for x in (first, other)]
    assert lines[0] == lines[1]
    records = [(folder / "cycles" / "0000.npz").read_bytes() for folder in (out, default_run.out)]
    assert records[0] == records[1]
    stages = [moment.stage for moment in screen.moments]
    assert {"MOVE_TO_PICK", "MOVE_TO_PLACE", "MOVE_HOME"} <= set(stages)
    assert len(screen.lines) == 1


# ---- options --------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("options", "named"),
    [
        ({"viewer": "hologram"}, "--viewer"),
        ({"viewer": "web", "jobs": 2}, "--viewer"),
        ({"viewer": "web", "backend": "dask"}, "--viewer"),
        ({"viewer": "web", "viewer_speed": 0.0}, "--viewer-speed"),
        ({"viewer": "web", "viewer_speed": float("nan")}, "--viewer-speed"),
    ],
)
def test_a_viewer_that_cannot_be_is_refused(options, named):
    with pytest.raises(BadInput, match=named):
        RunConfig(**options)


def test_without_a_display_the_native_window_is_refused_in_one_line(capfd, monkeypatch, tmp_path):
    monkeypatch.setattr(native, "_PROBE", "raise SystemExit(1)")
    out = tmp_path / "run"
    assert main(["run", "--cycles", "1", "--viewer", "native", "--out", str(out)]) == 2
    said = capfd.readouterr()
    assert said.out == ""
    assert said.err.count("\n") == 1
    assert "--viewer web" in said.err
    assert not out.exists()
