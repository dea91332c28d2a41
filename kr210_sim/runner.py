"""Many cycles: episodes played here or shared out, in one folder, with one summary."""

from __future__ import annotations

import hashlib
import platform
import shlex
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import closing, suppress
from dataclasses import replace
from functools import partial
from importlib.metadata import version
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from kr210_sim import __version__, sampling
from kr210_sim.config import RunConfig
from kr210_sim.episode_files import (
    Line,
    Onlooker,
    hang_limit,
    lost_lines,
    play_elsewhere,
    play_episode,
    silence_mujoco,
)
from kr210_sim.episodes import (
    Episode,
    check_solver,
    episode_size,
    load_world,
    plan_episodes,
    requested_cycles,
)
from kr210_sim.exceptions import Interrupted, NotWritten
from kr210_sim.gates import Gates
from kr210_sim.interrupts import no_interrupt
from kr210_sim.limits import MotionLimits
from kr210_sim.randomize import PRESETS
from kr210_sim.results import (
    CONFIG,
    SUMMARY,
    Journal,
    check_same,
    drop_files,
    is_unused,
    new_folder,
    read_lines,
    record_path,
    take_up,
    write_json,
)
from kr210_sim.scene import Scene, list_scenes
from kr210_sim.schemas import SCHEMA_VERSION
from kr210_sim.summary import summarize
from kr210_sim.workers import Loss, share_out, share_out_by_dask

OnCycle = Callable[[Line], None]


def run(
    config: RunConfig,
    *,
    on_cycle: OnCycle = lambda line: None,
    onlooker: Onlooker | None = None,
) -> tuple[Path, dict[str, Any]]:
    """Run all cycles, or those that a run which is resumed still lacks, and write the results.

    With `config.jobs` above 1 this module is imported anew by each worker, so a script that calls
    this needs the usual `if __name__ == "__main__"`.

    Args:
        config: the options.
        on_cycle: called with every cycle as it is finished, in cycle order.
        onlooker: watches the cycles, where they are played in this process.

    Returns:
        The folder of the results and the summary.

    Raises:
        BadInput: before anything is written.
        Interrupted: after what is finished has been written.
        NotWritten: if a file cannot be written; what is finished is kept.
    """
    started = time.perf_counter()
    silence_mujoco()
    scene = load_world(config)
    check_solver(config, scene.robot)
    requested = requested_cycles(config, scene)
    out, journal = _open(config, scene)
    campaign = _Campaign(config, scene, out, journal, on_cycle, onlooker)

    def finish() -> dict[str, Any]:
        summary = summarize(
            read_lines(out),
            config=absolute(config),
            limits=MotionLimits.from_velocity(scene.robot.velocity, config.speed),
            notes=scene.notes,
            wall_time_s=time.perf_counter() - started,
            simulated_s=campaign.simulated_s,
            lost_workers=campaign.lost,
            stopped_early=campaign.stopped,
            requested=requested,
        )
        write_json(out / SUMMARY, summary)
        return summary

    try:
        campaign.play()
        return out, finish()
    except BaseException as error:
        with no_interrupt(), suppress(OSError):
            journal.close()
        with no_interrupt(), suppress(OSError):
            finish()
        _explain(error, config, requested, out)
        raise


def _explain(error: BaseException, config: RunConfig, requested: int, out: Path) -> None:
    """Raise an error of ours that says what is kept, where the user can go on from there."""
    count = sum(1 for _ in read_lines(out))
    kept = f"{count} of {requested} cycles are kept in {out}"
    if config.only_cycle is None:
        kept += f"; the same command with --out {shlex.quote(str(out))} --resume goes on"
    if isinstance(error, KeyboardInterrupt):
        raise Interrupted(f"interrupted; {kept}") from error
    if isinstance(error, OSError) and not isinstance(error, BrokenPipeError):
        where = error.filename or "output"
        raise NotWritten(f"{where}: {error.strerror or error}; {kept}") from error


def _open(config: RunConfig, scene: Scene) -> tuple[Path, Journal]:
    """Return the folder of the run, with its configuration, and what is finished in it."""
    provenance = _provenance(config, scene)
    out, size = config.out, episode_size(config, scene)
    if not config.resume or out is None or not out.is_dir() or is_unused(out):
        out = new_folder(config)
        write_json(out / CONFIG, provenance)
        return out, Journal(out, first=(config.only_cycle or 0) // size)
    check_same(out, provenance)
    journal = take_up(out, config.cycles, lambda index: min(size, config.cycles - index * size))
    (out / SUMMARY).unlink(missing_ok=True)  # it is not true any more
    write_json(out / CONFIG, provenance)
    return out, journal


def _provenance(config: RunConfig, scene: Scene) -> dict[str, Any]:
    packages = ("mujoco", "numpy", "scipy", "ruckig", "yourdfpy", "xacro")
    model = scene.spec.compile()
    content = np.empty(mujoco.mj_sizeModel(model), np.uint8)
    mujoco.mj_saveModel(model, None, content)
    return {
        "schema_version": SCHEMA_VERSION,
        "options": absolute(config).as_json(),
        "randomization": None if (block := config.randomization()) is None else block.as_json(),
        "scene_cells": len(scene.cells),
        "world_sha256": hashlib.sha256(content.tobytes()).hexdigest(),
        "solver_sha256": _solver_checksum(config),
        "versions": {"kr210-sim": __version__, "python": platform.python_version()}
        | {name: version(name) for name in packages}
        | {"ompl": version("ompl") if sampling.available() else None},
    }


def absolute(config: RunConfig) -> RunConfig:
    """Return the configuration with its files named so that it holds in any working folder."""
    own_block = config.randomize is not None and config.randomize not in PRESETS
    folders = (text.partition("=") for text in config.package)
    return replace(
        config,
        scene=config.scene if config.scene in list_scenes() else str(Path(config.scene).absolute()),
        robot=config.robot and config.robot.absolute(),
        ik=_absolute_solver(config),
        randomize=str(Path(config.randomize or "").absolute()) if own_block else config.randomize,
        package=tuple(f"{name}={Path(folder).absolute()}" for name, _, folder in folders),
    )


def _solver_checksum(config: RunConfig) -> str | None:
    """Return the checksum of the file of the user's own solver."""
    source = config.own_solver()
    if source is None or source.file is None:
        return None
    return hashlib.sha256(source.file.read_bytes()).hexdigest()


def _absolute_solver(config: RunConfig) -> str:
    source = config.own_solver()
    if source is None or source.file is None:
        return config.ik
    return f"{source.file}:{source.function}"


class _Campaign:
    """The episodes of a run that are still to be played.

    Attributes:
        simulated_s: time simulated by now [s].
        lost: workers that were lost by now, as the summary has them.
        stopped: whether the success rate was decided and the rest is left out.
    """

    def __init__(
        self,
        config: RunConfig,
        scene: Scene,
        out: Path,
        journal: Journal,
        on_cycle: OnCycle,
        onlooker: Onlooker | None,
    ) -> None:
        self._config, self._scene, self._out = config, scene, out
        self._journal, self._on_cycle, self._onlooker = journal, on_cycle, onlooker
        self.simulated_s = 0.0
        self.lost: list[dict[str, Any]] = []
        self.stopped = False

    def play(self) -> None:
        """Play them all, each written as soon as those before it are, or until it is decided."""
        self._watch()
        if self._config.jobs == 1 and self._config.backend == "processes":
            self._play_here()
        else:
            self._play_by_workers()
        self._journal.close()
        if self._journal.ended:
            first = self._journal.next
            cycle = first * episode_size(self._config, self._scene)
            drop_files(self._out, episode=first, cycle=cycle)
            self.stopped = True

    def _watch(self) -> None:
        """Let the journal end where the success rate is decided, by its cycles in their order."""
        watch = Gates.of(self._config).watch()
        if watch is None:
            return

        def enough(lines: Iterable[Line]) -> bool:
            for line in lines:
                watch.see(line["success"])
            return watch.decided

        known = (line for line in read_lines(self._out) if line["episode"] < self._journal.next)
        self._journal.enough, self._journal.ended = enough, enough(known)

    def _left(self) -> Iterator[Episode]:
        for episode in plan_episodes(self._config, self._scene):
            if not self._journal.finished(episode.index):
                yield episode

    def _play_here(self) -> None:
        for episode in self._left():
            lines: list[Line] = []
            try:
                playing = play_episode(
                    self._config, self._scene, episode, self._out, self._onlooker
                )
                with closing(playing) as cycles:
                    for line in cycles:
                        lines.append(line)
                        self.simulated_s += line["simulated_s"]
                        self._on_cycle(line)
            finally:
                self._journal.add(episode.index, lines)

    def _play_by_workers(self) -> None:
        task = partial(play_elsewhere, absolute(self._config), self._out.absolute())
        if self._config.backend == "dask":
            results = share_out_by_dask(task, self._left(), jobs=self._config.jobs)
        else:
            results = share_out(
                task,
                self._left(),
                jobs=self._config.jobs,
                limit=partial(hang_limit, time_limit=self._scene.time_limit),
                on_loss=self._lose,
            )
        with closing(results):
            for played in results:
                self._take(played.episode, played.lines)
                if played.error is not None:
                    raise played.error
                if self._journal.ended:  # the workers of later episodes are ended with them
                    break

    def _take(self, episode: int, lines: list[Line]) -> None:
        self.simulated_s += sum(line["simulated_s"] for line in lines)
        for line in self._journal.add(episode, lines):
            self._on_cycle(line)

    def _lose(self, loss: Loss[Episode]) -> None:
        """Note a lost worker; the cycles of an episode that is lost for good have failed."""
        episode = loss.item
        self.lost.append({"episode": episode.index, "attempt": loss.attempt, "cause": loss.cause})
        if loss.final:
            for index in range(len(episode.seeds)):
                record_path(self._out, episode.first_cycle + index).unlink(missing_ok=True)
            self._take(episode.index, lost_lines(self._config, self._scene, loss))
