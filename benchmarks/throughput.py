"""Cycles against bare physics, and two workers against one: `python benchmarks/throughput.py`."""

from __future__ import annotations

import argparse
import copy
import json
import multiprocessing
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from multiprocessing.synchronize import Barrier
from pathlib import Path
from typing import Any
from unittest import mock

import mujoco
import numpy as np
from mujoco import rollout

if __name__ == "__main__":
    sys.path.pop(0)  # this folder has an ik.py of its own

from kr210_sim import cycle, episode_files, episodes
from kr210_sim.config import RunConfig
from kr210_sim.episode_files import silence_mujoco
from kr210_sim.results import SUMMARY
from kr210_sim.simulation import Simulation
from kr210_sim.variation import Variation

LIMIT = 1.25
"""Largest cost of stepping, control, recording and scoring over the bare loop's."""

GAIN_LIMIT = 0.93
"""Least gain of two workers over that of two bare loops."""

ASIDE: dict[str, tuple[tuple[Any, str], ...]] = {
    "planning": ((cycle, "_plan"),),
    "building the worlds": (
        (Simulation, "__init__"),
        (Simulation, "add"),
        (Simulation, "remove"),
        (Simulation, "restart"),
        (Variation, "prepare"),
        (episodes, "episode_targets"),
    ),
    "saving the worlds": ((episode_files, "episode_world"), (episode_files, "save_model")),
}
"""Parts of an episode that are timed apart; the rest is stepping, control, recording, scoring."""

SHARE = 8
"""A bare loop of two processes repeats a cycle this many times less often than the command."""

DOOR = Path(__file__).resolve().parents[1] / "run_cycles.py"
BLOCK = 20  # physics steps that one call of mujoco.rollout takes
State = mujoco.mjtState.mjSTATE_FULLPHYSICS


def main() -> None:
    """Print Markdown tables."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--cycles", type=int, default=200, help="with 1 and 2 workers (200), or 0")
    parser.add_argument("--episode-cycles", type=int, default=10, help="of an episode (10)")
    parser.add_argument("--rounds", type=int, default=1, help="of that comparison (1)")
    parser.add_argument("--replayed", type=int, default=10, help="cycles replayed bare (10)")
    parser.add_argument("--passes", type=int, default=3, help="over these (3)")
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    if options.replayed < 1 or options.passes < 1 or options.rounds < 1:
        parser.error("--replayed, --passes, --rounds: give at least 1")
    size = 2 * options.episode_cycles
    if size < 1 or options.cycles < 0 or options.cycles % size:
        parser.error(f"--cycles: give a multiple of {size}, whole episodes for two, or 0")
    silence_mujoco()
    config = RunConfig(cycles=options.replayed, seed=options.seed)
    passes = [Pass(config) for _ in range(options.passes)]
    print_overhead(passes)
    if options.cycles:
        run = {
            "--cycles": options.cycles,
            "--episode-cycles": options.episode_cycles,
            "--seed": options.seed,
        }
        rounds = [Round(run, passes[0].first_ctrl) for _ in range(options.rounds)]
        print_gain(rounds, options.cycles)


# ---- cycles against a bare loop, in one process ---------------------------------------------


class Pass:
    """Some cycles as `run` plays them, each followed by a replay of what it commanded.

    Times are the processor's for this process, so that other load disturbs little.

    Attributes:
        spent: name of a part -> its time in each cycle [s]; "rest" is what is not in ASIDE.
        bare: time of each cycle's commands in a loop of mj_step [s].
        rolled: the same by calls of mujoco.rollout [s].
        steps, simulated: number of physics steps, simulated time of all cycles [s].
        first_ctrl: (n, nu) commands of the first cycle.
    """

    def __init__(self, config: RunConfig) -> None:
        self.spent: dict[str, list[float]] = {name: [] for name in (*ASIDE, "rest")}
        self.bare: list[float] = []
        self.rolled: list[float] = []
        self.steps, self.simulated = 0, 0.0
        self.first_ctrl = np.empty((0, 0))
        self._meter = Meter()
        scene = episodes.load_world(config)
        with tempfile.TemporaryDirectory() as folder, self._meter.watching():
            for episode in episodes.plan_episodes(config, scene):
                lines = episode_files.play_episode(config, scene, episode, Path(folder))
                for _ in episode.seeds:
                    self._cycle(lines)
                next(lines, None)

    def _cycle(self, lines: Iterator[dict[str, Any]]) -> None:
        meter = self._meter
        meter.reset()
        begun = time.process_time()
        line = next(lines)
        total = time.process_time() - begun
        if meter.simulation is None or meter.start is None:
            raise SystemExit(f"cycle {line['cycle']} did not move: {line['reason']}")
        for name, seconds in meter.spent.items():
            self.spent[name].append(seconds)
        self.spent["rest"].append(total - meter.lost - sum(meter.spent.values()))
        ctrl, model = np.concatenate(meter.ctrl), meter.simulation.model
        for times, play in ((self.bare, step_bare), (self.rolled, step_rolled)):
            data = copy.copy(meter.start)
            begun = time.process_time()
            play(model, data, ctrl)
            times.append(time.process_time() - begun)
            if not same_state(data, meter.simulation.data):
                raise SystemExit(f"cycle {line['cycle']}: {play.__name__} ends in another state")
        self.steps += len(ctrl)
        self.simulated += line["simulated_s"]
        if not len(self.first_ctrl):
            self.first_ctrl = ctrl


def step_bare(model: mujoco.MjModel, data: mujoco.MjData, ctrl: Any) -> None:
    """Step through commands (n, nu) with nothing else."""
    for row in ctrl:
        data.ctrl[:] = row
        mujoco.mj_step(model, data)


def step_rolled(model: mujoco.MjModel, data: mujoco.MjData, ctrl: Any) -> None:
    """Step through commands (n, nu) by blocks; states and measurements are kept, too."""
    state = np.empty((1, mujoco.mj_stateSize(model, State)))
    with rollout.Rollout(nthread=0) as roll:
        for first in range(0, len(ctrl), BLOCK):
            mujoco.mj_getState(model, data, state[0], State)
            warmstart = np.array(data.qacc_warmstart)
            block = ctrl[first : first + BLOCK]
            roll.rollout(model, data, state, block, initial_warmstart=warmstart)


def same_state(a: mujoco.MjData, b: mujoco.MjData) -> bool:
    """Tell whether two states of a model are equal, bit for bit."""
    names = ("time", "qpos", "qvel", "act", "sensordata", "qacc_warmstart")
    return all(
        np.asarray(getattr(a, name)).tobytes() == np.asarray(getattr(b, name)).tobytes()
        for name in names
    )


class Meter:
    """Times parts of an episode and keeps what is commanded.

    Attributes:
        spent: name of a part -> its time since `reset` [s].
        lost: time that keeping the start of a cycle took [s].
        simulation: what has been stepped since `reset`, None before.
        start: its state then.
        ctrl: its commands, blocks of rows.
    """

    def __init__(self) -> None:
        self._inside = False
        self.reset()

    def reset(self) -> None:
        """Begin a cycle."""
        self.spent = dict.fromkeys(ASIDE, 0.0)
        self.lost = 0.0
        self.simulation: Simulation | None = None
        self.start: mujoco.MjData | None = None
        self.ctrl: list[Any] = []

    @contextmanager
    def watching(self) -> Iterator[None]:
        """Have the parts timed and the commands kept."""
        patches = [
            mock.patch.object(owner, name, self._timed(part, getattr(owner, name)))
            for part, places in ASIDE.items()
            for owner, name in places
        ]
        patches.append(mock.patch.object(Simulation, "step", self._kept(Simulation.step)))
        patches.append(mock.patch.object(Simulation, "undo", self._dropped(Simulation.undo)))
        for patch in patches:
            patch.start()
        try:
            yield
        finally:
            for patch in patches:
                patch.stop()

    def _timed(self, part: str, function: Callable[..., Any]) -> Callable[..., Any]:
        def timed(*args: Any, **options: Any) -> Any:
            if self._inside:
                return function(*args, **options)
            self._inside, begun = True, time.process_time()
            try:
                return function(*args, **options)
            finally:
                self.spent[part] += time.process_time() - begun
                self._inside = False

        return timed

    def _kept(self, step: Callable[..., Any]) -> Callable[..., Any]:
        def kept(simulation: Simulation, ctrl: Any) -> Any:
            if self.start is None:
                begun = time.process_time()
                self.simulation, self.start = simulation, copy.copy(simulation.data)
                self.lost += time.process_time() - begun
            count = len(self.ctrl)
            self.ctrl.append(ctrl)
            rows = step(simulation, ctrl)
            self.ctrl[count:] = [ctrl[: len(rows)]]
            return rows

        return kept

    def _dropped(self, undo: Callable[..., Any]) -> Callable[..., Any]:
        def dropped(simulation: Simulation) -> None:
            undo(simulation)
            self.ctrl.pop()

        return dropped


def print_overhead(passes: list[Pass]) -> None:
    """Print what cycles cost over the bare loop, part by part."""
    first = passes[0]
    bare = np.array([one.bare for one in passes])  # (passes, cycles)
    parts = {name: np.array([one.spent[name] for one in passes]) for name in first.spent}
    labels = {"rest": "**stepping, control, recording, scoring**"}
    rows = [(labels.get(name, name), parts[name]) for name in ("rest", *ASIDE)]
    rows.append(("the whole episode", np.sum(list(parts.values()), axis=0)))
    rows.append((f"mujoco.rollout, blocks of {BLOCK}", np.array([one.rolled for one in passes])))
    rows.append(("bare mj_step loop", bare))
    print(
        f"{bare.shape[1]} cycles, {first.steps} steps; every replay ends in the same bits. Times "
        f"of the processor, {len(passes)} passes.\n"
    )
    print(
        "| | per step [us] | over bare, median | range of passes | quietest |\n|---|" + "---|" * 4
    )
    for label, times in rows:
        ratios = times.sum(axis=1) / bare.sum(axis=1)
        quietest = times.min(axis=0).sum() / bare.min(axis=0).sum()
        print(
            f"| {label} | {1e6 * times.min(axis=0).sum() / first.steps:.2f} "
            f"| {np.median(ratios):.3f} | {ratios.min():.3f} to {ratios.max():.3f} "
            f"| {quietest:.3f} |"
        )
    ratio = float(np.median(parts["rest"].sum(axis=1) / bare.sum(axis=1)))
    seconds = float(rows[-3][1].min(axis=0).sum())
    print(
        f"\nStepping, control, recording and scoring cost {ratio:.3f} times the bare loop: "
        f"{_verdict(ratio <= LIMIT)} (at most {LIMIT}).\n"
        f"{60 * bare.shape[1] / seconds:.0f} cycles per minute, {first.steps / seconds:.0f} steps "
        f"per second, {first.simulated / seconds:.1f} times real time, planning and worlds "
        "included, start-up apart."
    )


# ---- two workers against one ----------------------------------------------------------------


class Round:
    """Bare loops and whole commands, each with one process and with two, in turn.

    Attributes:
        rate: number of processes -> steps per second of bare loops, all together.
        wall: number of workers -> time of the whole command [s].
        summary: number of workers -> summary of its run.
    """

    def __init__(self, run: dict[str, int], ctrl: Any) -> None:
        self.rate: dict[int, float] = {}
        self.wall: dict[int, float] = {}
        self.summary: dict[int, dict[str, Any]] = {}
        for count in (1, 2):
            self.rate[count] = bare_rate(count, run["--cycles"] // SHARE + 1, ctrl)
            self.wall[count], self.summary[count] = command(run | {"--jobs": count})

    @property
    def gains(self) -> tuple[float, float]:
        """Gain of two over one: of the command, and of the bare loop."""
        return self.wall[1] / self.wall[2], self.rate[2] / self.rate[1]


def command(run: dict[str, int]) -> tuple[float, dict[str, Any]]:
    """Return the wall time [s] of a whole command with some options, and its summary."""
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "run"
        words = [str(word) for pair in (run | {"--out": out}).items() for word in pair]
        begun = time.perf_counter()
        subprocess.run([sys.executable, str(DOOR), *words], check=False, capture_output=True)
        wall = time.perf_counter() - begun
        return wall, json.loads((out / SUMMARY).read_text(encoding="utf-8"))


def bare_rate(processes: int, repeats: int, ctrl: Any) -> float:
    """Return the steps per second [1/s] that bare loops of some processes make together."""
    context = multiprocessing.get_context("spawn")
    ready, answers = context.Barrier(processes), context.Queue()
    loops = [
        context.Process(target=loop_bare, args=(ready, answers, repeats, ctrl), daemon=True)
        for _ in range(processes)
    ]
    for loop in loops:
        loop.start()
    seconds = max(answers.get() for _ in loops)
    for loop in loops:
        loop.join()
    return processes * repeats * len(ctrl) / seconds


def loop_bare(ready: Barrier, answers: Any, repeats: int, ctrl: Any) -> None:
    """Step a world with one target through the same commands again and again."""
    config = RunConfig()
    scene = episodes.load_world(config)
    episode = episodes.plan_episode(config, scene, 0)
    target, variation = episodes.episode_targets(scene, episode, config.mass)[0]
    simulation = Simulation(scene)
    simulation.add(target)
    variation.prepare(simulation, target)
    ready.wait()
    begun = time.perf_counter()
    for _ in range(repeats):
        simulation.restart({})
        step_bare(simulation.model, simulation.data, ctrl)
    answers.put(time.perf_counter() - begun)


def print_gain(rounds: list[Round], cycles: int) -> None:
    """Print what one and two processes do, and what the second one gains."""
    whole, bare = np.array([one.gains for one in rounds]).T
    ends = [one.summary[n] for one in rounds for n in (1, 2)]
    ratio = float(np.median(whole / bare))
    print(f"\n{cycles} cycles by the whole command; {len(rounds)} rounds, median (range).\n")
    print("| processes | 1 | 2 | gain |\n|---|---|---|---|")
    for label, value in (
        ("cycles per minute", lambda one, n: 60 * cycles / one.wall[n]),
        ("times real time, start-up apart", lambda one, n: one.summary[n]["realtime_factor"]),
        ("steps per second, bare loops", lambda one, n: one.rate[n]),
    ):
        values = np.array([[value(one, n) for n in (1, 2)] for one in rounds])
        cells = " | ".join(f"{np.median(column):.1f}" for column in values.T)
        print(f"| {label} | {cells} | {_spread(values[:, 1] / values[:, 0])} |")
    print(
        f"\nThe gain of the command is {_spread(whole / bare)} of the bare loops': "
        f"{_verdict(ratio >= GAIN_LIMIT)} (at least {GAIN_LIMIT}). "
        f"Least success rate: {min(end['success_rate'] for end in ends):.3f}."
    )


def _spread(values: Any) -> str:
    return f"{np.median(values):.3f} ({np.min(values):.3f} to {np.max(values):.3f})"


def _verdict(good: bool) -> str:
    return "met" if good else "NOT met"


if __name__ == "__main__":
    main()
