"""What a script needs in a few calls: a scene, a plan, an episode, and what a run left behind."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from kr210_sim import motions
from kr210_sim.collision import MujocoOracle
from kr210_sim.config import RunConfig
from kr210_sim.episode_files import score_episode, silence_mujoco
from kr210_sim.episodes import (
    episode_size,
    episode_targets,
    load_world,
    plan_episode,
    setup_of,
    solver_of,
)
from kr210_sim.exceptions import BadInput
from kr210_sim.motions import TimedMotion
from kr210_sim.options import read_options
from kr210_sim.record import load_series
from kr210_sim.results import CONFIG, SUMMARY, finished_cycles, record_path
from kr210_sim.scene import Scene
from kr210_sim.score import CycleScore
from kr210_sim.simulation import Simulation


def build_scene(config: RunConfig) -> Scene:
    """Build the scene of a run, the robot in it, and check the options that depend on them.

    Raises:
        BadInput: naming the option or file.
    """
    silence_mujoco()
    return load_world(config)


def plan_cycle(config: RunConfig, scene: Scene) -> list[TimedMotion]:
    """Plan the first cycle of a run; nothing moves.

    Returns:
        The motions from stop to stop, home to home: `motion.stages` names the legs of one,
        `motion.trajectory.duration` is its time [s], and `motion.trajectory(t)` gives q, qd and qdd
        (N, 6) [rad, rad/s, rad/s^2] at times t (N,) [s] since its start.

    Raises:
        CycleFailure: if there is no plan: unreachable, joint_limits, no_path or bad_ik.
    """
    episode = plan_episode(config, scene, 0)
    target, variation = episode_targets(scene, episode, config.mass, config.randomization())[0]
    simulation = Simulation(scene)
    simulation.add(target)
    variation.prepare(simulation, target)
    with solver_of(config, scene.robot) as solver:
        common = setup_of(config, scene, solver)
        setup = replace(common, seed=episode.seeds[0], variation=variation)
        believed = variation.believed(target, scene)
        oracle = MujocoOracle(simulation, scene, believed)
        return motions.plan_cycle(simulation, believed, setup, oracle)[1]


def run_episode(config: RunConfig, scene: Scene, *, index: int = 0) -> Iterator[CycleScore]:
    """Run the cycles of one episode of a run and yield each score; nothing is written.

    What a cycle left behind stays with its score: `score.record`.

    Args:
        config: options of the run.
        scene: that `build_scene` made of them.
        index: of the episode.

    Raises:
        BadInput: if the run has no such episode.
    """
    if not 0 <= index * episode_size(config, scene) < config.cycles:
        raise BadInput(f"index: a run of {config.cycles} cycles has no episode {index}")
    return score_episode(config, scene, plan_episode(config, scene, index))


@dataclass(frozen=True, kw_only=True)
class SavedRun:
    """A run as its folder has it.

    Attributes:
        out: the folder.
        config: options of the run.
        summary: content of `summary.json`; `schemas.load_schema("summary")` describes it.
        cycles: the lines of `cycles.jsonl`, in order; `schemas.load_schema("cycle")` describes one.
    """

    out: Path
    config: RunConfig
    summary: dict[str, Any]
    cycles: list[dict[str, Any]]

    def record(self, cycle: int) -> dict[str, Any]:
        """Return the arrays of a cycle's record by name; `record.SERIES` explains each.

        Raises:
            BadInput: if it has none, or a damaged one.
        """
        path = record_path(self.out, cycle)
        if not path.is_file():
            raise BadInput(f"{path} does not exist; --record says of which cycles records are kept")
        return load_series(path)


def load_run(out: Path | str) -> SavedRun:
    """Read the folder of a run.

    Raises:
        BadInput: naming what is missing or damaged.
    """
    out = Path(out)
    cycles = finished_cycles(out)
    try:
        summary = json.loads((out / SUMMARY).read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise BadInput(f"{out / SUMMARY} cannot be read ({error}); --resume the run") from error
    config = RunConfig(**read_options(out / CONFIG))
    return SavedRun(out=out, config=config, summary=summary, cycles=cycles)
