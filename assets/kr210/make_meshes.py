"""Draw the meshes of the KR210: `python assets/kr210/make_meshes.py` writes meshes/*.obj.

SPDX-License-Identifier: MIT

Needs manifold3d. Running it again gives the same bytes.
"""

from __future__ import annotations

import sys
from pathlib import Path

HERE = Path(__file__).resolve().parent
sys.dont_write_bytecode = True  # the folders are package data
sys.path[:0] = [str(HERE), str(HERE.parent / "common")]

import lower_links  # noqa: E402 - found in the folders just added
import upper_links  # noqa: E402
from mesh_files import write_meshes  # noqa: E402

LINKS = {
    "base_link": lower_links.base,
    "link_1": lower_links.carousel,
    "link_2": lower_links.lower_arm,
    "link_3": upper_links.forearm,
    "link_4": upper_links.fork,
    "link_5": upper_links.head,
    "link_6": upper_links.flange,
}


def main(folder: Path = HERE / "meshes") -> None:
    """Write all meshes of the arm."""
    write_meshes(folder, {name: build() for name, build in LINKS.items()})


if __name__ == "__main__":
    main()
