"""Many cycles: seeds, episodes, targets, and the files a run leaves behind."""

from __future__ import annotations

import json
import math
import platform
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from importlib.metadata import version
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

import ik
from kr210_sim import __version__, sampling
from kr210_sim.config import EPISODE_CYCLES, RunConfig
from kr210_sim.criteria import CLEARANCE_FREE
from kr210_sim.cycle import CycleSetup, Probe, run_cycle
from kr210_sim.exceptions import BadInput
from kr210_sim.loading import load_robot
from kr210_sim.mjcf_files import save_model
from kr210_sim.playback import episode_world
from kr210_sim.randomize import Randomization
from kr210_sim.record import save_record
from kr210_sim.robot import Robot
from kr210_sim.scene import Scene, Target, build_scene, find_scene
from kr210_sim.score import CycleScore, score_cycle
from kr210_sim.simulation import Simulation
from kr210_sim.summary import summarize
from kr210_sim.tracks import Solver
from kr210_sim.trajectory import MotionLimits
from kr210_sim.variation import Variation, check_block, vary

TARGET_LENGTH = 0.25  # [m]
MAX_GRIP = 500.0  # [N], for the physics to stay honest

OnCycle = Callable[[CycleScore], None]


@dataclass(frozen=True, kw_only=True)
class Episode:
    """Cycles that share a scene: indices, seed, and the cell of every cycle.

    Attributes:
        index: in the run.
        first_cycle: index in the run of its first cycle.
        seeds: one per cycle.
        cells: cell number per cycle.
        all_from_start: whether a target stands in every cell of the scene from the start.
    """

    index: int
    first_cycle: int
    seeds: tuple[int, ...]
    cells: tuple[int, ...]
    all_from_start: bool


def load_world(config: RunConfig) -> Scene:
    """Build the scene with its robot, and check the options that depend on them.

    Raises:
        BadInput: naming the option or file.
    """
    model = load_robot(config.robot_source())
    robot = model.robot
    scene = build_scene(find_scene(config.scene), robot, model.spec)
    scene = replace(scene, notes=(*model.notes, *scene.notes))
    if config.cell not in ("random", "all") and int(config.cell) > len(scene.cells):
        raise BadInput(
            f"--cell: scene '{scene.name}' has no cell {config.cell}; give 1 to "
            f"{len(scene.cells)}, random or all"
        )
    if robot.grip_force > MAX_GRIP:
        raise BadInput(
            f"{robot.path}: joint '{robot.finger_joint}': effort {robot.grip_force:g} N is no "
            f"honest grip; give at most {MAX_GRIP:g}"
        )
    if config.mass > robot.max_payload:
        raise BadInput(
            f"--mass: {config.mass:g} kg is more than the grip holds; give at most "
            f"{robot.max_payload:.3g} kg (grip force over 15 N per kg and finger)"
        )
    if (randomization := config.randomization()) is not None:
        check_block(randomization, scene, TARGET_LENGTH)
    return scene


def make_solver(name: str, robot: Robot) -> Solver | None:
    """Return the solver of `--ik NAME`, None for the analytic one."""
    if name == "analytic":
        return None
    return ik.numeric_solver(robot.geometry, robot.lower, robot.upper)


def plan_episodes(config: RunConfig, scene: Scene) -> Iterator[Episode]:
    """Share the cycles of a run out to episodes.

    One SeedSequence is spawned per episode and from there per cycle, so an episode depends on its
    own index only.
    """
    everywhere, randomization = config.cell == "all", config.randomization()
    size = len(scene.cells) if everywhere else EPISODE_CYCLES
    count = math.ceil(config.cycles / size)
    for index, sequence in enumerate(np.random.SeedSequence(config.seed).spawn(count)):
        first = index * size
        seeds = tuple(int(child.generate_state(1)[0]) for child in sequence.spawn(size))
        if everywhere:
            cells = tuple(cell.number for cell in scene.cells)
        elif randomization is not None and "cell" in randomization.block:
            cells = tuple(int(randomization.draws(seed).number("cell")) for seed in seeds)
        elif config.cell == "random":
            cells = tuple(
                int(np.random.default_rng(seed).integers(1, len(scene.cells) + 1)) for seed in seeds
            )
        else:
            cells = (int(config.cell),) * size
        yield Episode(
            index=index,
            first_cycle=first,
            seeds=seeds[: config.cycles - first],
            cells=cells[: config.cycles - first],
            all_from_start=everywhere,
        )


def episode_targets(
    scene: Scene, episode: Episode, mass: float, randomization: Randomization | None = None
) -> list[tuple[Target, Variation]]:
    """Return the targets of an episode, first those that are picked, in turn.

    Beside each is what else is random about its cycle; nothing is without a block, nor about the
    targets that are not picked.
    """
    rest = [cell.number for cell in scene.cells if cell.number not in episode.cells]
    targets = [
        Target(
            number=index,
            cell=cell,
            mass=mass,
            T_base_target=scene.stand_in_cell(cell, TARGET_LENGTH),
            length=TARGET_LENGTH,
        )
        for index, cell in enumerate([*episode.cells, *rest * episode.all_from_start])
    ]
    if randomization is None:
        return [(target, Variation()) for target in targets]
    picked = targets[: len(episode.seeds)]
    varied = vary(scene, picked, episode.seeds, randomization)
    return varied + [(target, Variation()) for target in targets[len(picked) :]]


def run_episode(
    scene: Scene,
    episode: Episode,
    *,
    mass: float,
    limits: MotionLimits,
    solver: Solver | None = None,
    clearance: float = CLEARANCE_FREE,
    randomization: Randomization | None = None,
    probe: Probe | None = None,
) -> Iterator[CycleScore]:
    """Run the cycles of one episode, yielding each score as it is finished.

    A target that was placed stays in the bin. A cycle that failed leaves no trace: its target is
    taken away and everything else is put back as it was when the cycle began, the robot at home.
    """
    simulation = Simulation(scene)
    targets = episode_targets(scene, episode, mass, randomization)
    if episode.all_from_start:
        for target, _ in targets:
            simulation.add(target)
    for index, (target, variation) in enumerate(targets[: len(episode.cells)]):
        if not episode.all_from_start:
            simulation.add(target)
        setup = CycleSetup(
            cycle=episode.first_cycle + index,
            episode=episode.index,
            seed=episode.seeds[index],
            limits=limits,
            solver=solver,
            clearance=clearance,
            variation=variation,
        )
        record = run_cycle(simulation, target, setup, probe=probe)
        score = score_cycle(record, time_limit=scene.time_limit)
        yield score
        if not score.success:
            simulation.remove(target.name)
            simulation.restart(record.start)


def _ignore(_message: str) -> None:
    return


def run(
    config: RunConfig, *, on_cycle: OnCycle = lambda score: None
) -> tuple[Path, dict[str, Any]]:
    """Run all cycles and write the results.

    Args:
        config: the options.
        on_cycle: called with every score as it is finished.

    Returns:
        The folder of the results and the summary.

    Raises:
        BadInput: before anything is written.
        KeyboardInterrupt: after what is finished has been written.
    """
    started = time.perf_counter()
    mujoco.set_mju_user_warning(_ignore)  # the simulation is asked instead, and no log file appears
    scene = load_world(config)
    limits = MotionLimits.from_velocity(scene.robot.velocity, config.speed)
    solver, block = make_solver(config.ik, scene.robot), config.randomization()
    out = _new_folder(config)
    _write_json(out / "config.json", _provenance(config, scene))
    scores: list[CycleScore] = []
    try:
        for episode in plan_episodes(config, scene):
            finished: list[CycleScore] = []
            targets = [item for item, _ in episode_targets(scene, episode, config.mass, block)]
            try:
                for score in run_episode(
                    scene,
                    episode,
                    mass=config.mass,
                    limits=limits,
                    solver=solver,
                    clearance=config.clearance,
                    randomization=block,
                ):
                    finished.append(score)
                    on_cycle(score)
            finally:
                scores += finished
                _write_episode(out, scene, episode, targets, finished)
    finally:
        summary = summarize(
            scores,
            seed=config.seed,
            gates=config.gates(),
            clearance=config.clearance,
            limits=limits,
            notes=scene.notes,
            wall_time_s=time.perf_counter() - started,
        )
        _write_json(out / "summary.json", summary)
    return out, summary


def _new_folder(config: RunConfig) -> Path:
    stamp = time.strftime("%Y%m%d-%H%M%S")
    out = config.out or _unused(Path("runs") / f"{stamp}-seed{config.seed}")
    try:
        if out.exists() and (not out.is_dir() or any(out.iterdir())):
            raise BadInput(f"--out: {out} is not empty; name a folder that does not exist yet")
        out.mkdir(parents=True, exist_ok=True)
        (out / "cycles").mkdir()
    except OSError as error:
        raise BadInput(
            f"--out: {out} cannot be written ({error.strerror}); name another"
        ) from error
    return out


def _unused(folder: Path) -> Path:
    """Return the folder, or the first of its numbered namesakes that does not exist."""
    path, number = folder, 2
    while path.exists():
        path, number = folder.with_name(f"{folder.name}-{number}"), number + 1
    return path


def _provenance(config: RunConfig, scene: Scene) -> dict[str, Any]:
    packages = ("mujoco", "numpy", "scipy", "ruckig", "yourdfpy", "xacro")
    return {
        "schema_version": 1,
        "options": config.as_json(),
        "randomization": None if (block := config.randomization()) is None else block.as_json(),
        "scene_cells": len(scene.cells),
        "versions": {"kr210-sim": __version__, "python": platform.python_version()}
        | {name: version(name) for name in packages}
        | {"ompl": version("ompl") if sampling.available() else None},
    }


def _write_episode(
    out: Path,
    scene: Scene,
    episode: Episode,
    targets: list[Target],
    finished: list[CycleScore],
) -> None:
    if not finished:
        return
    records = [score.record for score in finished]
    folder = out / "episodes" / f"{episode.index:04d}"
    folder.mkdir(parents=True, exist_ok=True)
    save_model(episode_world(scene, targets, records), folder / "scene.xml")
    for record in records:
        save_record(record, out / "cycles" / f"{record.cycle:04d}.npz")
    with (out / "cycles.jsonl").open("a", encoding="utf-8") as file:
        for score in finished:
            file.write(json.dumps(score.as_json(), allow_nan=False) + "\n")


def _write_json(path: Path, content: dict[str, Any]) -> None:
    path.write_text(json.dumps(content, indent=2, allow_nan=False) + "\n", encoding="utf-8")
