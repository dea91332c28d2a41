"""Whether links and joints of a URDF form one tree of numbers to reckon with: checked at first."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Iterable

from kr210_sim.exceptions import BadInput

MAX_DEPTH = 100
"""Links from the root to the farthest one; more than any robot has."""

MAX_NAME = 200
"""Characters of a name, which becomes part of a file's."""

LARGEST = 1e50
"""A larger number means nothing, and products of some are too large for the computer."""

_WORLD = "world"
"""What MuJoCo calls its own root."""


def rename_world(robot: ET.Element) -> tuple[str, ...]:
    """Give a link named like MuJoCo's root another name, in place; return what was changed."""
    links = {link.get("name"): link for link in robot.findall("link")}
    if _WORLD not in links:
        return ()
    new = next(name for n in range(len(links) + 1) if (name := f"world_{n or 'link'}") not in links)
    links[_WORLD].set("name", new)
    for end in (*robot.findall("joint/parent"), *robot.findall("joint/child")):
        if end.get("link") == _WORLD:
            end.set("link", new)
    return (f"link '{_WORLD}' is called '{new}', because MuJoCo keeps that name for its own root",)


def check_tree(where: str, robot: ET.Element) -> None:
    """Refuse a description whose links and joints are not one tree.

    Args:
        where: the file, for messages.
        robot: the <robot> element.

    Raises:
        BadInput: naming the link or joint and the remedy.
    """
    links = _names(where, robot.findall("link"))
    if not links:
        raise BadInput(f"{where}: holds no <link>; a robot has at least a base and six more")
    joints = robot.findall("joint")
    _names(where, joints)
    parent_of: dict[str, str] = {}
    for joint in joints:
        name = joint.get("name")
        ends = {}
        for end in ("parent", "child"):
            element = joint.find(end)
            link = None if element is None else element.get("link")
            if link is None:
                raise BadInput(f"{where}: joint '{name}' has no <{end} link=...>; give one")
            if link not in links:
                raise BadInput(f"{where}: joint '{name}': no {end} link '{link}'; define it")
            ends[end] = link
        if ends["child"] in parent_of:
            raise BadInput(
                f"{where}: joint '{name}': link '{ends['child']}' has two parent joints; keep one"
            )
        parent_of[ends["child"]] = ends["parent"]
    for link in links:
        _check_no_loop(where, link, parent_of)
    roots = [link for link in links if link not in parent_of]
    if len(roots) > 1:
        listed = ", ".join(f"'{root}'" for root in roots[:4])
        raise BadInput(f"{where}: links {listed} have no parent; join them to one tree")
    _check_mimics(where, joints)
    _check_shapes(where, robot.findall("link"))
    for element in (*robot.findall("link"), *joints):
        _check_numbers(f"{where}: {element.tag} '{element.get('name')}'", element)


def _names(where: str, elements: Iterable[ET.Element]) -> dict[str, None]:
    names: dict[str, None] = {}
    for element in elements:
        name = element.get("name")
        if not name:
            raise BadInput(f"{where}: a <{element.tag}> has no name; give it one")
        if not name.isprintable():
            raise BadInput(f"{where}: {element.tag} {name!r} holds a control character; rename it")
        if len(name) > MAX_NAME:
            raise BadInput(
                f"{where}: {element.tag} '{name[:40]}...' has too long a name; shorten it"
            )
        if name in names:
            raise BadInput(f"{where}: {element.tag} '{name}' is defined twice; rename one")
        names[name] = None
    return names


def _check_no_loop(where: str, link: str, parent_of: dict[str, str]) -> None:
    seen = {link}
    above = link
    while above in parent_of:
        above = parent_of[above]
        if above in seen:
            raise BadInput(f"{where}: link '{above}' is part of a loop of joints; open it")
        seen.add(above)
        if len(seen) > MAX_DEPTH:
            raise BadInput(f"{where}: link '{link}' is more than {MAX_DEPTH} links deep; join some")


def _check_mimics(where: str, joints: list[ET.Element]) -> None:
    names = {joint.get("name") for joint in joints}
    for joint in joints:
        mimic = joint.find("mimic")
        if mimic is not None and mimic.get("joint") not in names - {joint.get("name")}:
            raise BadInput(
                f"{where}: joint '{joint.get('name')}': <mimic> of '{mimic.get('joint')}', which "
                "is no other joint; correct the name"
            )


def _check_shapes(where: str, links: Iterable[ET.Element]) -> None:
    for link in links:
        for kind in ("visual", "collision"):
            for shape in link.findall(kind):
                geometry = shape.find("geometry")
                if geometry is None or len(geometry) == 0:
                    raise BadInput(
                        f"{where}: link '{link.get('name')}': a <{kind}> has no geometry; give it "
                        "a shape or remove it"
                    )


def _check_numbers(where: str, element: ET.Element) -> None:
    for part in element.iter():
        for attribute, text in part.items():
            for word in text.split():
                if LARGEST < _size(word) < float("inf"):  # what is infinite is refused by its field
                    field = f"<{part.tag}> {attribute} {word}"
                    raise BadInput(f"{where}: {field} is too large; correct it")


def _size(word: str) -> float:
    """Return the absolute value of a number, 0 of what is none."""
    try:
        return abs(float(word))
    except ValueError:
        return 0.0
