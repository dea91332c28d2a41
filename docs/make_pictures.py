"""Regenerate the pictures of README.md and docs/: `python docs/make_pictures.py`."""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np
from PIL import Image

from kr210_sim.video import Player, find_gl

IMAGES = Path(__file__).resolve().parent / "images"
PICTURES = {"cycle.png": (5, "overview", 0.5), "grasp.png": (5, "shelf", 0.22)}
"""File -> cell of the target, camera, and share of the cycle at which to look."""


def main() -> None:
    """Run one cycle a picture and draw it from the record."""
    if "MUJOCO_GL" not in os.environ:  # MuJoCo reads it when first imported
        environment = os.environ | {"MUJOCO_GL": find_gl()}
        sys.exit(subprocess.call([sys.executable, __file__], env=environment))
    from kr210_sim.cli import main as kr210_sim

    for name, (cell, camera, share) in PICTURES.items():
        with tempfile.TemporaryDirectory() as folder:
            out = Path(folder) / "run"
            kr210_sim(["run", "--cycles", "1", "--cell", str(cell), "--out", str(out)])
            player = Player(out, 0, fine=True)
            (frame,) = player.frames(camera, np.array([share * player.duration]))
            Image.fromarray(frame).save(IMAGES / name, optimize=True)


if __name__ == "__main__":
    main()
