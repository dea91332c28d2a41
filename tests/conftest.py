"""What the tests share: the bundled robot and scene, the default run, and cycles on demand."""

from __future__ import annotations

import os
import pickle
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import measured
import mujoco
import numpy as np
import pytest

import kr210_sim.episodes
import kr210_sim.loading
from kr210_sim.cli import main
from kr210_sim.config import RunConfig
from kr210_sim.cycle import CycleSetup, Probe, run_cycle
from kr210_sim.description import Description, load_description
from kr210_sim.episodes import TARGET_LENGTH
from kr210_sim.exceptions import BadInput
from kr210_sim.limits import MotionLimits
from kr210_sim.mjcf import robot_spec
from kr210_sim.robot import Robot, bundled_robot, find_robot
from kr210_sim.runner import run
from kr210_sim.scene import Scene, Target, build_scene, find_scene
from kr210_sim.score import CycleScore, score_cycle
from kr210_sim.simulation import Simulation
from kr210_sim.video import find_gl

TURNED_2X2 = Path(__file__).parent / "scenes" / "turned_2x2.xml"


@dataclass(frozen=True, kw_only=True)
class Run:
    """A finished run: its folder, its summary and the scores as they were reported."""

    out: Path
    summary: dict[str, Any]
    scores: list[CycleScore]


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Put the files that use the default run first: one process makes it, none has to wait for it.

    Another process begins in the middle of the list and takes from its end.
    """
    using = {item.path for item in items if "default_run" in getattr(item, "fixturenames", ())}
    items.sort(key=lambda item: item.path not in using)


@pytest.fixture(scope="session", autouse=True)
def _no_log_file() -> None:
    """Keep MuJoCo's warnings out of MUJOCO_LOG.TXT; tests ask `data.warning` instead."""
    mujoco.set_mju_user_warning(lambda _message: None)


@pytest.fixture(scope="session", autouse=True)
def _measured() -> Iterator[None]:
    """Under coverage, measure solvers and workers too."""
    with pytest.MonkeyPatch.context() as patch:
        if measured.SETTINGS in os.environ:
            measured.hand_in(patch)
        yield


@pytest.fixture(scope="session")
def description() -> Description:
    return load_description(bundled_robot())


@pytest.fixture(scope="session", autouse=True)
def _expand_once(description: Description) -> Iterator[None]:
    """Let runs share one expansion of the bundled xacro; test_description shows it repeatable."""

    def load(path: Path, *options: Any) -> Description:
        return description if path == bundled_robot() else load_description(path, *options)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(kr210_sim.loading, "load_description", load)
        yield


@pytest.fixture(scope="session")
def robot(description: Description) -> Robot:
    return find_robot(description)


@pytest.fixture(scope="session")
def spec(description: Description, robot: Robot) -> mujoco.MjSpec:
    return robot_spec(description, robot)


@pytest.fixture(scope="session")
def robot_model(spec: mujoco.MjSpec) -> mujoco.MjModel:
    """The robot alone, as MuJoCo compiles it."""
    return spec.copy().compile()


@pytest.fixture(scope="session")
def scene(robot: Robot, spec: mujoco.MjSpec) -> Scene:
    return build_scene(find_scene("shelf_and_bin"), robot, spec)


@pytest.fixture(scope="session")
def turned_scene(robot: Robot, spec: mujoco.MjSpec) -> Scene:
    return build_scene(TURNED_2X2, robot, spec)


@pytest.fixture(scope="session")
def limits(robot: Robot) -> MotionLimits:
    return MotionLimits.from_velocity(robot.velocity)


@pytest.fixture(scope="session")
def default_run(tmp_path_factory: pytest.TempPathFactory) -> Run:
    """The run of `python run_cycles.py`: ten cycles, seed 0. Everything that can shares it.

    Of parallel test processes one makes it, and the others wait for it.
    """
    root = tmp_path_factory.getbasetemp()
    folder = (root.parent if "PYTEST_XDIST_WORKER" in os.environ else root) / "default"
    done, part = folder / "run.pickle", folder / "run.part"
    try:
        folder.mkdir()
    except FileExistsError:
        while not done.exists():
            assert not (folder / "failed").exists(), "the default run raised in another process"
            time.sleep(0.1)
        made = pickle.loads(done.read_bytes())
        assert isinstance(made, Run)
        return made
    scores: list[CycleScore] = []

    def score(*given: Any, **named: Any) -> CycleScore:
        scores.append(score_cycle(*given, **named))
        return scores[-1]

    try:
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(kr210_sim.episodes, "score_cycle", score)
            _, summary = run(RunConfig(out=folder / "run"))
    except BaseException:
        (folder / "failed").touch()
        raise
    made = Run(out=folder / "run", summary=summary, scores=scores)
    part.write_bytes(pickle.dumps(made))
    part.rename(done)
    return made


@pytest.fixture(scope="session")
def gl() -> str:
    """The backend of OpenGL that films are drawn with."""
    try:
        return find_gl()
    except BadInput as error:
        pytest.skip(f"needs OpenGL: {error}")


def refused(capfd: pytest.CaptureFixture[str], *words: str) -> str:
    """Return the one line that `kr210-sim view` refuses these words with."""
    assert main(["view", *words]) == 2
    out, err = capfd.readouterr()
    assert out == ""
    assert err.count("\n") == 1
    return err


def densified(corners: np.ndarray, step: float = 0.012) -> np.ndarray:
    """Configurations (M, 6) along the polyline through corners (N, 6), at most `step` apart."""
    pieces = [corners[:1]]
    for q_from, q_to in pairwise(corners):
        count = max(1, int(np.ceil(np.max(np.abs(q_to - q_from)) / step)))
        pieces.append(q_from + np.linspace(0.0, 1.0, count + 1)[1:, None] * (q_to - q_from))
    return np.concatenate(pieces)


def standing_target(scene: Scene, cell: int, number: int = 0, mass: float = 1.0) -> Target:
    return Target(
        number=number,
        cell=cell,
        mass=mass,
        T_base_target=scene.stand_in_cell(cell, TARGET_LENGTH),
        length=TARGET_LENGTH,
    )


RunOneCycle = Callable[..., CycleScore]


@pytest.fixture(scope="session")
def one_cycle(scene: Scene, limits: MotionLimits) -> RunOneCycle:
    """Run one cycle through the real sequencer, in a world of its own or in one that is given."""

    def play(
        probe: Probe | None = None,
        *,
        cell: int = 5,
        world: Scene | None = None,
        simulation: Simulation | None = None,
        target: Target | None = None,
        **of_setup: Any,
    ) -> CycleScore:
        place = world or (simulation.scene if simulation else scene)
        simulation = simulation or Simulation(place)
        target = target or standing_target(place, cell)
        if target.name not in simulation.targets:
            simulation.add(target)
        given = {"cycle": target.number, "episode": 0, "seed": 0, "limits": limits} | of_setup
        setup = CycleSetup(**given)
        record = run_cycle(simulation, target, setup, probe=probe)
        return score_cycle(record, time_limit=place.time_limit)

    return play


@pytest.fixture(scope="session")
def good_cycle(default_run: Run) -> CycleScore:
    """A cycle that went well, for tests that compare with one."""
    return default_run.scores[0]


@pytest.fixture
def impatient(monkeypatch: pytest.MonkeyPatch) -> None:
    """Make every wait of the sequencer shorter, for tests in which it waits in vain."""
    monkeypatch.setattr("kr210_sim.cycle.WAIT_LIMIT", 0.5)
    monkeypatch.setattr("kr210_sim.cycle.SETTLE_LIMIT", 0.8)
