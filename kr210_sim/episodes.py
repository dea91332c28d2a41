"""The episodes of a run: their seeds, cells and targets, and the running of one."""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import closing, contextmanager
from dataclasses import dataclass, replace

import numpy as np

import ik
from kr210_sim.config import RunConfig
from kr210_sim.cycle import CycleSetup, run_cycle
from kr210_sim.draws import Draws
from kr210_sim.exceptions import BadInput
from kr210_sim.grading.findings import Refused
from kr210_sim.grading.foreign import ForeignSolver
from kr210_sim.limits import MotionLimits
from kr210_sim.loading import load_robot
from kr210_sim.randomize import Randomization
from kr210_sim.robot import Robot
from kr210_sim.scene import Scene, Target, build_scene, find_scene
from kr210_sim.score import CycleScore, score_cycle
from kr210_sim.simulation import Simulation
from kr210_sim.stepping import Probe
from kr210_sim.tracks import Solver
from kr210_sim.variation import Variation, check_block, vary

TARGET_LENGTH = 0.25  # [m]
MAX_GRIP = 500.0  # [N], for the physics to stay honest


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


@contextmanager
def solver_of(config: RunConfig, robot: Robot) -> Iterator[Solver | None]:
    """Give the solver of `--ik`, None for the analytic one; its process ends with the context."""
    source = config.own_solver()
    if source is None:
        is_numeric = config.ik == "numeric"
        yield ik.numeric_solver(robot.geometry, robot.lower, robot.upper) if is_numeric else None
        return
    solver = ForeignSolver(source, robot, frame=config.frame, limits=config.solver_limits())
    with closing(solver):
        yield solver


def check_solver(config: RunConfig, robot: Robot) -> None:
    """Load the user's own solver once.

    Raises:
        BadInput: if it cannot be loaded, with the line of its source.
    """
    with solver_of(config, robot) as solver:
        if isinstance(solver, ForeignSolver):
            try:
                solver.load()
            except Refused as refused:
                raise BadInput(f"--ik: {refused.finding.text(solver.source.name)}") from refused


def episode_size(config: RunConfig, scene: Scene) -> int:
    """Return the number of cycles of a full episode."""
    return len(scene.cells) if config.cell == "all" else config.episode_cycles


def plan_episodes(config: RunConfig, scene: Scene) -> Iterator[Episode]:
    """Share the cycles of a run out to episodes, one at a time."""
    size = episode_size(config, scene)
    wanted = range(math.ceil(config.cycles / size))
    if config.only_cycle is not None:
        wanted = wanted[config.only_cycle // size :][:1]
    return (plan_episode(config, scene, index) for index in wanted)


def requested_cycles(config: RunConfig, scene: Scene) -> int:
    """Return the number of cycles that a run plays."""
    if config.only_cycle is None:
        return config.cycles
    return config.only_cycle % episode_size(config, scene) + 1


def last_cycle(config: RunConfig, episode: Episode) -> int:
    """Return the index in the run of the last cycle of an episode that is played."""
    return (
        episode.first_cycle + len(episode.seeds) - 1
        if (only := config.only_cycle) is None
        else only
    )


def plan_episode(config: RunConfig, scene: Scene, index: int) -> Episode:
    """Return one episode of a run.

    One SeedSequence is spawned per episode and from there per cycle, so an episode depends on its
    own index only.
    """
    everywhere, randomization = config.cell == "all", config.randomization()
    size = episode_size(config, scene)
    first = index * size
    sequence = np.random.SeedSequence(config.seed, spawn_key=(index,))
    children = sequence.spawn(min(size, config.cycles - first))
    seeds = tuple(int(child.generate_state(1)[0]) for child in children)
    if everywhere:
        cells = tuple(cell.number for cell in scene.cells)[: len(seeds)]
    elif randomization is not None and "cell" in randomization.block:
        cells = tuple(int(Draws(randomization.block, seed).number("cell")) for seed in seeds)
    elif config.cell == "random":
        cells = tuple(
            int(np.random.default_rng(seed).integers(1, len(scene.cells) + 1)) for seed in seeds
        )
    else:
        cells = (int(config.cell),) * len(seeds)
    return Episode(
        index=index, first_cycle=first, seeds=seeds, cells=cells, all_from_start=everywhere
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


def setup_of(config: RunConfig, scene: Scene, solver: Solver | None) -> CycleSetup:
    """Return what the options of a run say of all its cycles; what tells them apart is 0."""
    return CycleSetup(
        cycle=0,
        episode=0,
        seed=0,
        limits=MotionLimits.from_velocity(scene.robot.velocity, config.speed),
        solver=solver,
        scope=config.scope,
        clearance=config.clearance,
        retries=config.retries,
    )


def run_episode(
    scene: Scene,
    episode: Episode,
    common: CycleSetup,
    *,
    mass: float,
    randomization: Randomization | None = None,
    probe: Probe | None = None,
) -> Iterator[CycleScore]:
    """Run the cycles of one episode, yielding each score as it is finished.

    A target that was placed stays in the bin. A cycle that failed leaves no trace: its target is
    taken away and everything else is put back as it was when the cycle began, the robot at home.

    Args:
        scene: with its robot.
        episode: of a run.
        common: what all cycles share, as `setup_of` returns it.
        mass: of every target [kg].
        randomization: what is random in a cycle.
        probe: looks on at every record step.
    """
    simulation = Simulation(scene)
    targets = episode_targets(scene, episode, mass, randomization)
    if episode.all_from_start:
        for target, _ in targets:
            simulation.add(target)
    for index, (target, variation) in enumerate(targets[: len(episode.cells)]):
        if not episode.all_from_start:
            simulation.add(target)
        setup = replace(
            common,
            cycle=episode.first_cycle + index,
            episode=episode.index,
            seed=episode.seeds[index],
            variation=variation,
        )
        record = run_cycle(simulation, target, setup, probe=probe)
        score = score_cycle(record, time_limit=scene.time_limit)
        yield score
        if not score.success:
            simulation.remove(target.name)
            simulation.restart(record.start)
