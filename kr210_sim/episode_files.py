"""An episode with its files: played, its records and its world written, here or in a worker."""

from __future__ import annotations

import shutil
from collections.abc import Generator, Sequence
from contextlib import closing
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import Any, Protocol

import mujoco

from kr210_sim.config import RunConfig
from kr210_sim.episodes import (
    Episode,
    episode_targets,
    last_cycle,
    load_world,
    run_episode,
    setup_of,
    solver_of,
)
from kr210_sim.interrupts import no_interrupt
from kr210_sim.mjcf_files import save_model
from kr210_sim.playback import episode_world
from kr210_sim.record import CycleRecord, Event, save_record, unplayed_record
from kr210_sim.results import named, record_path, world_path
from kr210_sim.scene import Scene, Target
from kr210_sim.score import CycleScore, score_cycle
from kr210_sim.simulation import Simulation
from kr210_sim.workers import Loss

HANG_GRACE = 120.0
HANG_FACTOR = 5.0
"""A worker hangs if an episode takes longer than HANG_GRACE [s] per cycle, and once more to start,
plus HANG_FACTOR times the scene's time limit per cycle; a cycle takes a tenth of that."""

Line = dict[str, Any]
"""A cycle as `cycles.jsonl` has it."""


def silence_mujoco() -> None:
    """Let no log file appear; the simulation is asked for its warnings instead."""
    mujoco.set_mju_user_warning(_ignore)


def _ignore(_message: str) -> None:
    return


def hang_limit(episode: Episode, *, time_limit: float) -> float:
    """Return the longest time [s] that an episode may take in a worker."""
    cycles = len(episode.seeds)
    return (cycles + 1) * HANG_GRACE + cycles * HANG_FACTOR * time_limit


def lost_lines(config: RunConfig, scene: Scene, loss: Loss[Episode]) -> list[Line]:
    """Return the cycles of an episode that no worker survives.

    Of the closed list of reasons, `simulation_diverged` is the one for a simulator that cannot go
    on, and `timeout` the one for a cycle that does not end.
    """
    event = Event(
        reason="timeout" if loss.hung else "simulation_diverged",
        stage="MOVE_TO_PICK",
        time=0.0,
        detail=f"its worker was lost {loss.attempt} times, at last by: {loss.cause}",
    )
    episode, lines = loss.item, []
    targets = episode_targets(scene, episode, config.mass, config.randomization())
    for index, (target, variation) in enumerate(targets):
        if index < len(episode.seeds):
            record = unplayed_record(
                target,
                cycle=episode.first_cycle + index,
                episode=episode.index,
                seed=episode.seeds[index],
            )
            record.drawn = variation.drawn
            record.events.append(event)
            lines.append(score_cycle(record, time_limit=scene.time_limit).as_json())
    return lines[: last_cycle(config, episode) - episode.first_cycle + 1]


@dataclass(frozen=True, kw_only=True)
class Played:
    """What a worker answers: the finished cycles, and why there are no more of them."""

    episode: int
    lines: list[Line]
    error: OSError | None


def play_elsewhere(config: RunConfig, out: Path, episode: Episode) -> Played:
    """Play an episode in this process, which is a worker's."""
    lines: list[Line] = []
    error = None
    try:
        for line in play_episode(config, _world(config), episode, out):
            lines.append(line)
    except OSError as caught:  # lines go back as values, and so does what cut them short
        error = caught
    return Played(episode=episode.index, lines=lines, error=error)


@lru_cache(maxsize=1)
def _world(config: RunConfig) -> Scene:
    silence_mujoco()
    return load_world(config)


class Onlooker(Protocol):
    """Watches the cycles of a run: it may take its time, but must not touch the simulation."""

    def begin(self, scene: Scene, targets: Sequence[Target], first_cycle: int) -> None:
        """See an episode begin, with all targets that it will have."""

    def __call__(self, simulation: Simulation, stage: str, simulated: float) -> None:
        """Look at a record step; this is a `Probe`."""


def score_episode(
    config: RunConfig, scene: Scene, episode: Episode, onlooker: Onlooker | None = None
) -> Generator[CycleScore, None, None]:
    """Run the cycles of an episode as the options of a run ask for, yielding each score."""
    block = config.randomization()
    if onlooker is not None:
        targets = [target for target, _ in episode_targets(scene, episode, config.mass, block)]
        onlooker.begin(scene, targets, episode.first_cycle)
    with solver_of(config, scene.robot) as solver:
        yield from run_episode(
            scene,
            episode,
            setup_of(config, scene, solver),
            mass=config.mass,
            randomization=block,
            probe=onlooker,
        )


def play_episode(
    config: RunConfig,
    scene: Scene,
    episode: Episode,
    out: Path,
    onlooker: Onlooker | None = None,
) -> Generator[Line, None, None]:
    """Run the cycles of an episode and write their records and their world.

    The last cycle is yielded after the world is written, so that an episode whose world is missing
    is never a finished one.

    Raises:
        OSError: naming the file, if one cannot be written.
    """
    kept: list[CycleRecord] = []
    written = False

    def write_world() -> None:
        path = world_path(out, episode.index)
        if kept:
            targets = episode_targets(scene, episode, config.mass, config.randomization())
            world = episode_world(scene, [target for target, _ in targets], kept)
            try:
                with named(path), no_interrupt():
                    save_model(world, path)
            except OSError:  # makes room for the summary that says so
                shutil.rmtree(path.parent, ignore_errors=True)
                raise

    try:
        with closing(score_episode(config, scene, episode, onlooker)) as scores:
            for score in scores:
                record = score.record
                if config.record == "all" or (config.record == "failed" and not score.success):
                    _save_record(record, record_path(out, record.cycle))
                    kept.append(replace(record, series={}))
                last = record.cycle == last_cycle(config, episode)
                if last:
                    write_world()
                    written = True
                yield score.as_json()
                if last:
                    return
    finally:
        if not written:
            write_world()


def _save_record(record: CycleRecord, path: Path) -> None:
    try:
        with named(path):
            save_record(record, path)
    except BaseException:
        path.unlink(missing_ok=True)
        raise
