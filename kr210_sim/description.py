"""Robot description: expand a xacro or read a URDF, and check it."""

from __future__ import annotations

import io
import math
import xml.etree.ElementTree as ET
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from xml.dom import DOMException
from xml.parsers.expat import ExpatError

import numpy as np
import xacro
import yourdfpy

from kr210_sim.exceptions import BadInput

_JOINT_TYPES = {"fixed", "revolute", "continuous", "prismatic"}


@dataclass(frozen=True, kw_only=True)
class Description:
    """A checked URDF model and where it came from.

    Attributes:
        path: the file that was read.
        urdf_text: the URDF after xacro expansion.
        model: `yourdfpy.URDF`, whose `robot` holds links and joints in file order.
    """

    path: Path
    urdf_text: str
    model: Any


def load_description(path: Path) -> Description:
    """Read a robot description.

    Args:
        path: a `.xacro` file (expanded without ROS) or a `.urdf` file.

    Raises:
        BadInput: if the file is missing, does not expand or parse, or is not a usable URDF.
    """
    if not path.is_file():
        raise BadInput(f"--robot: no file {path}; give the path of a .xacro or .urdf file")
    text = _expand(path) if path.suffix == ".xacro" else _read(path)
    try:
        root = ET.fromstring(text)
    except ET.ParseError as error:
        raise BadInput(f"{path}: not well-formed XML ({error}); correct the file") from error
    if root.tag != "robot":
        raise BadInput(f"{path}: root element is <{root.tag}>; a URDF starts with <robot>")
    _check_tree(path, root)
    try:
        model = yourdfpy.URDF.load(
            io.BytesIO(text.encode()), build_scene_graph=True, load_meshes=False
        )
    except Exception as error:  # yourdfpy lets ValueError, KeyError, TypeError, its own out
        raise BadInput(f"{path}: not a usable URDF ({_one_line(error)}); correct it") from error
    _check(path, model)
    return Description(path=path, urdf_text=text, model=model)


def _expand(path: Path) -> str:
    try:
        return str(xacro.process_file(str(path)).toprettyxml(indent="  "))
    except (
        xacro.XacroException,
        ExpatError,
        DOMException,
        OSError,
        ValueError,
        RecursionError,
    ) as error:
        raise BadInput(
            f"{path}: xacro cannot expand it ({_one_line(error)}); correct the file"
        ) from error


def _read(path: Path) -> str:
    try:
        return path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise BadInput(f"{path}: cannot be read ({_one_line(error)})") from error


def _one_line(error: BaseException) -> str:
    return " ".join(str(error).split()) or type(error).__name__


def _check_tree(path: Path, root: ET.Element) -> None:
    """Refuse what is no tree of links: double or missing names, two parents, loops, two roots."""
    names = {kind: [e.get("name", "") for e in root.findall(kind)] for kind in ("link", "joint")}
    for kind, found in names.items():
        for name in found:
            if not name or found.count(name) > 1:
                raise BadInput(f"{path}: {kind} name '{name}' is empty or used twice; rename one")
    parent_of: dict[str, str] = {}
    for joint in root.findall("joint"):
        where = f"{path}: joint '{joint.get('name')}'"
        ends = [
            (end.get("link", "") if end is not None else "")
            for end in (joint.find("parent"), joint.find("child"))
        ]
        for end in ends:
            if end not in names["link"]:
                raise BadInput(f"{where}: there is no link '{end}'; name an existing one")
        if ends[1] in parent_of:
            raise BadInput(f"{where}: link '{ends[1]}' has a parent already; remove one joint")
        parent_of[ends[1]] = ends[0]
    for name in names["link"]:
        seen = {name}
        while (name := parent_of.get(name, "")) and name not in seen:
            seen.add(name)
        if name:
            raise BadInput(f"{path}: the links form a loop through '{name}'; break it")
    roots = [name for name in names["link"] if name not in parent_of]
    if len(roots) != 1:
        raise BadInput(f"{path}: root links are {', '.join(roots)}; a robot has exactly one")


def _check(path: Path, model: Any) -> None:
    """Refuse what would only fail later and less clearly: types, limits, masses, inertias."""
    for joint in model.robot.joints:
        where = f"{path}: joint '{joint.name}'"
        if joint.type not in _JOINT_TYPES:
            known = ", ".join(sorted(_JOINT_TYPES))
            raise BadInput(f"{where}: type '{joint.type}' is not supported; use one of {known}")
        if joint.type == "fixed":
            continue
        if joint.limit is None:
            raise BadInput(f"{where}: <limit> is missing; give lower, upper, effort and velocity")
        for field in ("effort", "velocity"):
            value = getattr(joint.limit, field)
            if value is None or not math.isfinite(value) or value <= 0:
                raise BadInput(f"{where}: limit {field} is {value}; give a positive number")
        lower, upper = joint.limit.lower, joint.limit.upper
        if joint.type != "continuous" and not _ordered(lower, upper):
            raise BadInput(
                f"{where}: limits {lower} .. {upper} are not a range; give lower < upper"
            )
    for link in model.robot.links:
        inertial = link.inertial
        if inertial is None:
            continue
        where = f"{path}: link '{link.name}'"
        mass = inertial.mass
        if mass is None or not math.isfinite(mass) or mass <= 0:
            raise BadInput(f"{where}: mass is {mass}; give a positive number of kg")
        if inertial.inertia is None or not _is_inertia(inertial.inertia):
            raise BadInput(
                f"{where}: inertia is impossible; principal moments must be positive "
                "and each no larger than the sum of the other two"
            )


def _ordered(lower: float | None, upper: float | None) -> bool:
    if lower is None or upper is None:
        return False
    return math.isfinite(lower) and math.isfinite(upper) and lower < upper


def _is_inertia(inertia: np.ndarray) -> bool:
    if not np.all(np.isfinite(inertia)):
        return False
    a, b, c = np.linalg.eigvalsh(inertia)
    return bool(a > 0 and a + b >= c * (1 - 1e-9))
