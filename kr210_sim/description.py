"""Robot description: expand a xacro or read a URDF, and check it."""

from __future__ import annotations

import io
import math
import os
import warnings
import xml.etree.ElementTree as ET
from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np

from kr210_sim.exceptions import BadInput
from kr210_sim.expand import expand_xacro
from kr210_sim.inertials import repair_inertials
from kr210_sim.packages import Packages
from kr210_sim.safe_xml import read_xml
from kr210_sim.urdf_tree import check_tree, rename_world

_JOINT_TYPES = {"fixed", "revolute", "continuous", "prismatic"}


@dataclass(frozen=True, kw_only=True)
class Description:
    """A checked URDF model and where it came from.

    Attributes:
        path: the file that was read.
        urdf_text: the URDF after xacro expansion.
        model: `yourdfpy.URDF`, whose `robot` holds links and joints in file order.
        packages: resolves the mesh files it names.
        notes: what was changed in reading it, for the report.
    """

    path: Path
    urdf_text: str
    model: Any
    packages: Packages
    notes: tuple[str, ...] = ()


def load_description(
    path: Path,
    packages: Packages | None = None,
    arguments: Mapping[str, str] | None = None,
) -> Description:
    """Read a robot description.

    Args:
        path: a `.xacro` file (expanded without ROS) or a `.urdf` file.
        packages: where its packages are; by default as found from the file.
        arguments: values of `<xacro:arg>` by name.

    Raises:
        BadInput: if the file is missing, does not expand or parse, or is not a usable URDF.
    """
    if not os.path.isfile(path):  # Path.is_file raises for some impossible names
        raise BadInput(f"--robot: no file {path}; give the path of a .xacro or .urdf file")
    packages = packages or Packages(path)
    content = read_xml(path)
    if path.suffix == ".xacro":
        with ThreadPoolExecutor(1) as waiting:
            expanded = waiting.submit(expand_xacro, path, packages, arguments or {})
            import_module("yourdfpy")  # takes longer than the process that expands
        content = expanded.result().encode()
    try:
        root = ET.fromstring(content)
    except (ET.ParseError, ValueError, LookupError) as error:  # ValueError: unknown encodings
        raise BadInput(f"{path}: cannot be read as XML ({error}); correct the file") from error
    if root.tag != "robot":
        raise BadInput(f"{path}: root element is <{root.tag}>; a URDF starts with <robot>")
    check_tree(str(path), root)
    if renamed := rename_world(root):
        content = ET.tostring(root)
    model = _parse(path, content)
    _check(path, model)
    notes = (*renamed, *repair_inertials(str(path), model, packages))
    return Description(
        path=path, urdf_text=content.decode(), model=model, packages=packages, notes=notes
    )


def kinematic_model(robot: Any) -> Any:
    """Return the `yourdfpy.URDF` of a `yourdfpy` robot, able to do forward kinematics.

    Its scene graph holds frames only: drawing the shapes takes longer than all the rest.
    """
    import yourdfpy

    visuals = [link.visuals for link in robot.links]
    try:
        for link in robot.links:
            link.visuals = []
        return yourdfpy.URDF(robot=robot, build_scene_graph=True, load_meshes=False)
    finally:
        for link, drawn in zip(robot.links, visuals, strict=True):
            link.visuals = drawn


def _parse(path: Path, content: bytes) -> Any:
    import yourdfpy

    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # what is wrong is refused by _check, in our words
            parsed = yourdfpy.URDF.load(
                io.BytesIO(content), build_scene_graph=False, load_meshes=False
            )
            return kinematic_model(parsed.robot)
    except Exception as error:  # yourdfpy lets ValueError, KeyError, TypeError, its own out
        raise BadInput(f"{path}: not a usable URDF ({_one_line(error)}); correct it") from error


def _one_line(error: BaseException) -> str:
    return " ".join(str(error).split()) or type(error).__name__


def _check(path: Path, model: Any) -> None:
    """Refuse what would only fail later and less clearly: types, limits, numbers, shapes."""
    for joint in model.robot.joints:
        where = f"{path}: joint '{joint.name}'"
        if joint.type not in _JOINT_TYPES:
            known = ", ".join(sorted(_JOINT_TYPES))
            raise BadInput(f"{where}: type '{joint.type}' is not supported; use one of {known}")
        _check_origin(where, joint)
        if joint.type != "fixed":
            _check_limit(where, joint)
    for link in model.robot.links:
        elements = [*link.visuals, *link.collisions]
        for element in elements if link.inertial is None else [*elements, link.inertial]:
            _check_origin(f"{path}: link '{link.name}'", element)


def _check_origin(where: str, element: Any) -> None:
    if element.origin is not None and not np.all(np.isfinite(element.origin)):
        raise BadInput(f"{where}: <origin> holds values that are no finite numbers; correct it")


def _check_limit(where: str, joint: Any) -> None:
    if joint.axis is not None and not 0.0 < np.linalg.norm(joint.axis) < math.inf:
        raise BadInput(f"{where}: <axis> has no direction; give one")
    if joint.limit is None:
        raise BadInput(f"{where}: <limit> is missing; give lower, upper, effort and velocity")
    effort = joint.limit.effort = joint.limit.effort or 0.0  # 0 is replaced when it is rated
    if not math.isfinite(effort) or effort < 0:
        raise BadInput(f"{where}: limit effort is {effort}; give 0 or more, in N m or N")
    velocity = joint.limit.velocity
    follows = joint.mimic is not None
    if not follows and (velocity is None or not math.isfinite(velocity) or velocity <= 0):
        raise BadInput(f"{where}: limit velocity is {velocity}; give a positive number")
    lower, upper = joint.limit.lower, joint.limit.upper
    if joint.type != "continuous" and not _ordered(lower, upper):
        raise BadInput(f"{where}: limits {lower} .. {upper} are not a range; give lower < upper")


def _ordered(lower: float | None, upper: float | None) -> bool:
    if lower is None or upper is None:
        return False
    return math.isfinite(lower) and math.isfinite(upper) and lower < upper
