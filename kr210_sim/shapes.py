"""Points of URDF shapes in the frame of their link, for bounds."""

from __future__ import annotations

from collections.abc import Iterable
from itertools import product
from typing import Any

import numpy as np

from kr210_sim.arrays import Array
from kr210_sim.meshes import load_mesh
from kr210_sim.packages import Packages

_CORNERS = np.array(list(product((-0.5, 0.5), repeat=3)))


def shape_points(elements: Iterable[Any], packages: Packages) -> Array:
    """Return points (n, 3) whose bounds are those of some <visual> or <collision> elements.

    A mesh gives its vertices, a primitive the corners of its box; link frame [m].

    Raises:
        BadInput: if a mesh cannot be read.
    """
    found = [np.empty((0, 3))]
    for element in elements:
        shape = element.geometry
        if shape.box is not None:
            points = _CORNERS * np.asarray(shape.box.size)
        elif shape.cylinder is not None:
            across = 2 * shape.cylinder.radius
            points = _CORNERS * np.array([across, across, shape.cylinder.length])
        elif shape.sphere is not None:
            points = _CORNERS * 2 * shape.sphere.radius
        elif shape.mesh is not None:
            where = f"{packages.robot_file.name}: mesh of '{element.name or 'a link'}'"
            path = packages.resolve(shape.mesh.filename or "", where=where)
            parts = load_mesh(path, shape.mesh.scale, where=where)
            points = np.concatenate([part.vertices for part in parts])
        else:
            continue
        T = np.eye(4) if element.origin is None else np.asarray(element.origin)
        found.append(points @ T[:3, :3].T + T[:3, 3])
    return np.concatenate(found)
