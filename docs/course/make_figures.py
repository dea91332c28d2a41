"""Regenerate the figures of the course: `python docs/course/make_figures.py`.

With names as arguments only those are drawn: `python docs/course/make_figures.py dh_frames.svg`.
The plots of comparisons.md come from `python benchmarks/course_comparisons.py all`.
"""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

HERE = Path(__file__).resolve().parent
sys.path[:0] = [str(HERE), str(HERE.parent)]

import drawings
import plots
import renders

from kr210_sim.video import find_gl

FIGURES = HERE / "figures"


def main(chosen: list[str]) -> None:
    """Draw the chosen figures, or all."""
    if "MUJOCO_GL" not in os.environ:  # MuJoCo reads it when first imported
        environment = os.environ | {"MUJOCO_GL": find_gl()}
        sys.exit(subprocess.call([sys.executable, __file__, *chosen], env=environment))
    FIGURES.mkdir(exist_ok=True)
    for name, draw in (drawings.DRAWINGS | plots.PLOTS).items():
        if not chosen or name in chosen:
            drawings.save(draw(), FIGURES / name)
    for name, render in renders.RENDERS.items():
        if not chosen or name in chosen:
            image = render().quantize(192)  # flat studio light: it looks the same, at a third
            image.save(FIGURES / name, optimize=True)


if __name__ == "__main__":
    main(sys.argv[1:])
