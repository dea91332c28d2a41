"""Inertials that no body can have -> the nearest that one can, by stated rules."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from kr210_sim.arrays import Array
from kr210_sim.exceptions import BadInput
from kr210_sim.packages import Packages
from kr210_sim.shapes import shape_points

DENSITY = 2700.0
"""Of the sphere that stands for a link without any shape [kg/m^3]: aluminium."""

_SLACK = 1e-9  # relative, for sums of moments that are equal but for rounding


def repair_inertials(where: str, model: Any, packages: Packages) -> tuple[str, ...]:
    """Make every inertial of a description possible, in place.

    The rules, in order:

    1. A link that is fixed to its parent and has mass 0 has no inertial.
    2. Moments that are positive but break the triangle inequality a + b >= c: the two smaller ones
       are raised by the same amount until they sum to the largest; the principal axes stay.
    3. Any other impossible tensor (zero, negative, indefinite): a solid box of the same mass, of
       the size of the link's collision (else visual) shapes; a sphere of aluminium without any.

    Args:
        where: the file, for messages.
        model: `yourdfpy.URDF`, changed.
        packages: resolves meshes.

    Returns:
        A note for each link changed, with its name and the rule.

    Raises:
        BadInput: if a mass is not a positive number, or a tensor is not of numbers.
    """
    joint_of = {joint.child: joint for joint in model.robot.joints}
    notes = []
    for link in model.robot.links:
        inertial = link.inertial
        if inertial is None:
            continue
        joint = joint_of.get(link.name)
        if inertial.mass == 0 and (joint is None or joint.type == "fixed"):
            link.inertial = None
            notes.append(f"link '{link.name}': mass 0 on a fixed link is read as no inertial")
            continue
        mass, tensor = inertial.mass, inertial.inertia
        if mass is None or not math.isfinite(mass) or mass <= 0:
            raise BadInput(f"{where}: link '{link.name}': mass is {mass}; give kilograms above 0")
        if tensor is None:
            tensor = inertial.inertia = np.zeros((3, 3))
        if not np.all(np.isfinite(tensor)):
            raise BadInput(f"{where}: link '{link.name}': inertia holds no numbers; correct it")
        if is_inertia(tensor):
            continue
        moments, axes = np.linalg.eigh(tensor)
        if moments[0] > 0:
            inertial.inertia = axes @ np.diag(_raised(moments)) @ axes.T
            rule = "the smaller moments are raised until they sum to the largest"
        else:
            rule = _replace(link, mass, packages)
        notes.append(f"link '{link.name}': inertia is impossible; {rule}")
    return tuple(notes)


def is_inertia(tensor: Array) -> bool:
    """Tell whether a (3, 3) tensor can be the inertia of a body."""
    if not np.all(np.isfinite(tensor)):
        return False
    a, b, c = np.linalg.eigvalsh(tensor)
    return bool(a > 0 and a + b >= c * (1 - _SLACK))


def _raised(moments: Array) -> Array:
    """Raise the two smaller of three moments, in ascending order, by the same amount."""
    a, b, c = moments
    return np.array([a + (c - a - b) / 2, b + (c - a - b) / 2, c])


def _replace(link: Any, mass: float, packages: Packages) -> str:
    """Give a link the inertia of its bounding box or of a sphere; return the rule."""
    origin = np.eye(4) if link.inertial.origin is None else np.array(link.inertial.origin)
    origin[:3, :3] = np.eye(3)
    link.inertial.origin = origin
    points = shape_points(link.collisions or link.visuals, packages)
    if len(points):
        x, y, z = np.maximum(np.ptp(points, axis=0), 1e-3) ** 2
        link.inertial.inertia = mass / 12 * np.diag([y + z, x + z, x + y])
        return "replaced by that of a solid box of its mass and size"
    radius = (3 * mass / (4 * math.pi * DENSITY)) ** (1 / 3)
    link.inertial.inertia = 0.4 * mass * radius**2 * np.eye(3)
    return "replaced by that of an aluminium sphere of its mass"
