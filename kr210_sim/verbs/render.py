"""The verb `render`: a film of a finished run."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from kr210_sim.film.format import FILM, FPS, SIZE, make_format
from kr210_sim.interrupts import one_interrupt
from kr210_sim.verbs.common import EXIT_PASSED, film_with_bar, whole


def add(verbs: Any) -> None:
    """Add `render` to the verbs."""
    parser = verbs.add_parser(
        "render",
        help="film a finished run, or one cycle of it",
        description="Film a finished run, or one cycle of it, from its records; nothing is "
        "simulated. Drawn off screen by EGL or OSMesa.",
        allow_abbrev=False,
    )
    parser.add_argument("run", type=Path, metavar="RUN", help="folder of the run")
    parser.add_argument("--cycle", type=whole, metavar="N", help="the only cycle to show")
    parser.add_argument(
        "--camera", action="append", default=[], metavar="NAME",
        help="camera of the scene, 'gripper', which follows it, or 'free', which shows the whole "
        "scene; repeatable: several share the picture (default: overview)",
    )  # fmt: skip
    parser.add_argument("--size", default=SIZE, metavar="WxH", help=f"[pixels] (default: {SIZE})")
    parser.add_argument(
        "--fps", type=float, default=FPS, metavar="N", help=f"frames a second (default: {FPS:g})"
    )
    parser.add_argument(
        "--speed", type=float, default=1.0, metavar="F", help="2: twice as fast (default: 1)"
    )
    parser.add_argument(
        "--out", type=Path, metavar="PATH",
        help=f"the .mp4 to write (default: RUN/{FILM}, or RUN/cycle_NNNN.mp4 with --cycle)",
    )  # fmt: skip
    parser.set_defaults(verb=_render)


def _render(options: argparse.Namespace) -> int:
    from kr210_sim.film.format import check_cameras
    from kr210_sim.video import check_target, find_gl, moments_of, run_cameras

    form = make_format(
        cameras=options.camera, size=options.size, fps=options.fps, speed=options.speed
    )
    run, cycle = options.run, options.cycle
    moments_of(run, form, cycle)
    check_cameras(form.cameras, run_cameras(run), "--camera")
    film = options.out or run / (FILM if cycle is None else f"cycle_{cycle:04d}.mp4")
    check_target(film, "--out")
    backend = find_gl("render")
    with one_interrupt():
        film_with_bar(run, film, form, backend=backend, cycle=cycle)
    print(film)
    return EXIT_PASSED
