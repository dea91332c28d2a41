"""Drawing a film against a bare render-and-read loop: `python benchmarks/render.py`."""

from __future__ import annotations

import argparse
import multiprocessing
import os
import sys
import tempfile
import time
from multiprocessing.queues import Queue
from multiprocessing.synchronize import Barrier
from pathlib import Path
from statistics import median
from typing import Any

import numpy as np

if __name__ == "__main__":
    sys.path.pop(0)  # this folder has an ik.py of its own

from kr210_sim.film.drawing import cores, draw
from kr210_sim.film.format import FPS, SIZE, Moment, make_format
from kr210_sim.film.worker import Job

LIMIT = 1.15
"""Largest cost of drawing a film, encoding apart, over the fastest bare loop."""

CAMERA = "overview"


def main() -> None:
    """Print a Markdown table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--run", type=Path, help="run to draw; by default ten cycles are played")
    parser.add_argument("--every", type=int, default=12, help="draw every k-th frame (12)")
    parser.add_argument("--rounds", type=int, default=3, help="of bare loops and film (3)")
    parser.add_argument("--size", default=SIZE)
    parser.add_argument("--processes", type=int, nargs="+", default=sorted({1, cores()}))
    options = parser.parse_args()
    if options.every < 1 or options.rounds < 1 or min(options.processes) < 1:
        parser.error("--every, --rounds, --processes: give at least 1")
    with tempfile.TemporaryDirectory() as folder:
        run = options.run or _played(Path(folder) / "run")
        compare(run, options)


def compare(run: Path, options: argparse.Namespace) -> None:
    """Draw the same frames by bare loops and as a film, in turns, and print what they cost."""
    from kr210_sim.video import find_gl, moments_of

    form = make_format(cameras=(CAMERA,), size=options.size, fps=FPS)
    moments = list(dict.fromkeys(moments_of(run, form)))[:: options.every]
    job = Job(out=str(run), cameras=(CAMERA,), size=form.size, moments=moments)
    backend = find_gl("benchmark")
    walls: dict[str, list[float]] = {}
    busy: dict[str, list[float]] = {}
    for _ in range(options.rounds):
        for count in options.processes:
            wall, cpu = bare_loops(job, count, backend)
            walls.setdefault(f"bare loop, processes: {count}", []).append(wall)
            busy.setdefault(f"bare loop, processes: {count}", []).append(cpu)
        wall, cpu = film(job, backend)
        walls.setdefault("film", []).append(wall)
        busy.setdefault("film", []).append(cpu)
    frames = len(moments)
    print(f"{frames} frames of {options.size}, {options.rounds} rounds, {cores()} cores\n")
    print("| | ms a frame, median | ms of processor a frame, median |")
    print("|---|---|---|")
    for name, times in walls.items():
        wall, cpu = (1e3 * median(each) / frames for each in (times, busy[name]))
        print(f"| {name} | {wall:.1f} | {cpu:.1f} |")
    print(f"\nfilm / fastest bare loop (at most {LIMIT}):")
    for what, times in (("time", walls), ("processor time", busy)):
        bare = [name for name in times if name != "film"]
        fastest = min(bare, key=lambda name: median(times[name]))
        ratios = [a / b for a, b in zip(times["film"], times[fastest], strict=True)]
        print(f"{what}: {median(ratios):.3f} against {fastest}; {min(ratios):.3f} at least")


def film(job: Job, backend: str) -> tuple[float, float]:
    """Return the time that drawing a film takes, and that of its processors [s].

    Every process draws its first picture twice, so that neither its start nor the loading of the
    world counts: a film of full length has ten times as many pictures.
    """
    count = cores()
    first = job.moments[:count]
    begun = _children()
    _drain(Job(**(vars(job) | {"moments": first})), backend, count)
    start = _children() - begun
    warm = Job(**(vars(job) | {"moments": first + job.moments}))
    pictures = draw(warm, backend=backend, processes=count)
    for _ in range(count):
        next(pictures)
    begun, started = _children(), time.perf_counter()
    drawn = sum(1 for _ in pictures)
    wall = time.perf_counter() - started
    assert drawn == len(job.moments)
    return wall, _children() - begun - start


def _drain(job: Job, backend: str, count: int) -> None:
    for _ in draw(job, backend=backend, processes=count):
        pass


def _children() -> float:
    """Return the processor time of all child processes that have ended [s]."""
    times = os.times()
    return times.children_user + times.children_system


def bare_loops(job: Job, count: int, backend: str) -> tuple[float, float]:
    """Return the time of bare loops that share the frames, and that of their processors [s]."""
    os.environ |= {"MUJOCO_GL": backend, "LP_NUM_THREADS": str(max(1, cores() // count))}
    context = multiprocessing.get_context("spawn")
    barrier, answers = context.Barrier(count + 1), context.Queue()
    loops = [
        context.Process(target=bare_loop, args=(job, job.moments[first::count], barrier, answers))
        for first in range(count)
    ]
    for loop in loops:
        loop.start()
    barrier.wait(300)
    started = time.perf_counter()
    busy = [answers.get(timeout=3600) for _ in loops]
    wall = time.perf_counter() - started
    for loop in loops:
        loop.join()
    return wall, sum(busy)


def bare_loop(job: Job, moments: list[Moment], barrier: Barrier, answers: Queue[float]) -> None:
    """Pose, render and read frames by `mujoco.Renderer`, and nothing else.

    Light, geometry, camera and quality are those of the film; states are known beforehand.
    """
    import mujoco

    from kr210_sim.film.painter import fit, hide_parked
    from kr210_sim.film.studio import studio_model, visible
    from kr210_sim.results import world_path

    width, height = job.size
    model = studio_model(world_path(Path(job.out), 0), job.size)
    data, groups = mujoco.MjData(model), np.array(model.geom_group)
    states = _states(job, moments, model)
    with mujoco.Renderer(model, height, width) as renderer:

        def draw_one(state: tuple[Any, set[str]]) -> Any:
            data.qpos[:] = state[0]
            mujoco.mj_forward(model, data)
            renderer.update_scene(data, CAMERA, visible())
            fit(renderer.scene, width / height)
            return renderer.render()

        hide_parked(model, groups, states[0][1])
        draw_one(states[0])
        barrier.wait(300)
        begun, shown = time.process_time(), states[0][1]
        for state in states:
            if state[1] != shown:
                hide_parked(model, groups, state[1])
                shown = state[1]
            draw_one(state)
        answers.put(time.process_time() - begun)


def _states(job: Job, moments: list[Moment], model: Any) -> list[tuple[Any, set[str]]]:
    """Return qpos of every moment, and the joints of its cycle."""
    from kr210_sim.film.take import read_take
    from kr210_sim.playback import place_joints
    from kr210_sim.results import read_lines

    lines = {line["cycle"]: line for line in read_lines(Path(job.out))}
    takes = {
        cycle: read_take(Path(job.out), lines[cycle], cycles=len(lines), succeeded=0)
        for cycle in dict.fromkeys(cycle for cycle, _ in moments)
    }
    states = []
    for cycle, moment in moments:
        qpos = np.array(model.key(f"cycle_{cycle:04d}").qpos)
        joints = takes[cycle].joints
        place_joints(model, qpos, joints, takes[cycle].at("qpos", moment))
        states.append((qpos, {name for name, _ in joints}))
    return states


def _played(out: Path) -> Path:
    """Play ten cycles."""
    from kr210_sim.config import RunConfig
    from kr210_sim.runner import run

    run(RunConfig(out=out))
    return out


if __name__ == "__main__":
    main()
