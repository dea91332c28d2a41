"""Description -> that of one arm with one gripper: what else moves is frozen, ours mounted."""

from __future__ import annotations

import copy
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from kr210_sim.arrays import Array
from kr210_sim.description import Description, kinematic_model, load_description
from kr210_sim.exceptions import BadInput
from kr210_sim.gripper import chain_to, finger_joints, joint_axis, joint_origin
from kr210_sim.resources import resource
from kr210_sim.source import ArmChoice

FLANGE_NAMES = ("tool0", "flange")
"""Links, possibly behind a prefix, that mark the mounting face; the first that is found counts."""

_TURNING = ("revolute", "continuous")


def isolate_arm(description: Description, choice: ArmChoice | None = None) -> Description:
    """Reduce a description to one arm with one gripper.

    The gripper is the two finger joints named or found: prismatic, beyond a revolute joint. Where
    there is none, or `choice.gripper` asks for it, the bundled gripper is mounted on the flange:
    `choice.tip`, else the link named tool0 or flange (possibly behind a prefix), else the child of
    the sixth revolute joint. The arm is the joints named, else the turning ones from the base to
    the gripper. Every other joint, a rail's for one, is fixed at 0.

    Args:
        description: as it was read.
        choice: what to override.

    Returns:
        The description itself if nothing has to change, else a new one, with notes.

    Raises:
        BadInput: if a name is unknown or no flange can be found.
    """
    choice = choice or ArmChoice()
    where = str(description.path)
    robot = description.model.robot
    _check_names(where, robot, choice)
    own = _own_fingers(robot, choice)
    mounting = choice.gripper or (not own and not choice.fingers)
    moving = [joint for joint in robot.joints if joint.type != "fixed"]
    if not mounting and choice == ArmChoice() and len(moving) == 8:
        return description
    robot = copy.deepcopy(robot)
    notes: list[str] = []
    if choice.base:
        _keep_below(robot, choice.base, notes)
    packages = description.packages
    if mounting:
        tip = choice.tip or _flange(where, robot, choice)
        _drop_below(robot, tip, notes)
        chain = chain_to(tip, robot.joints)
        if sum(joint.type in _TURNING for joint in chain) < 6:
            raise BadInput(f"--tip: '{tip}' is not beyond six revolute joints; name the flange")
        packages.allow(_mount(where, robot, tip, chain))
        notes.append(f"gripper: the bundled two-finger gripper is mounted on '{tip}'")
        own = finger_joints(robot.joints)
    elif choice.fingers:
        own = _own_fingers(robot, choice)
        _couple(own, notes)
    if own:
        keep = set(choice.joints) | {joint.name for joint in own}
        if not choice.joints:
            chain = chain_to(own[0].parent, robot.joints)
            keep |= {joint.name for joint in chain if joint.type in _TURNING}
        _freeze(robot, keep, notes)
    model = kinematic_model(robot)
    return replace(description, model=model, packages=packages, notes=(*description.notes, *notes))


def _check_names(where: str, robot: Any, choice: ArmChoice) -> None:
    links = {link.name for link in robot.links}
    joints = {joint.name for joint in robot.joints}
    for option, names, known in (
        ("--base", [choice.base], links),
        ("--tip", [choice.tip], links),
        ("--joints", choice.joints, joints),
        ("--fingers", choice.fingers, links | joints),
    ):
        for name in names:
            if name is not None and name not in known:
                listed = ", ".join(sorted(known)[:40])
                raise BadInput(f"{option}: {where} has no '{name}'; it has {listed}")


def _own_fingers(robot: Any, choice: ArmChoice) -> list[Any]:
    if not choice.fingers:
        return finger_joints(robot.joints)
    return [
        joint
        for joint in robot.joints
        if joint.name in choice.fingers or joint.child in choice.fingers
    ]


def _below(robot: Any, link: str) -> set[str]:
    """Return the names of the links below a link, without itself."""
    found: set[str] = set()
    open_links = [link]
    while open_links:
        parent = open_links.pop()
        children = [joint.child for joint in robot.joints if joint.parent == parent]
        found.update(children)
        open_links += children
    return found


def _remove(robot: Any, links: set[str]) -> None:
    robot.links = [link for link in robot.links if link.name not in links]
    robot.joints = [joint for joint in robot.joints if not {joint.child, joint.parent} & links]


def _keep_below(robot: Any, base: str, notes: list[str]) -> None:
    dropped = {link.name for link in robot.links} - _below(robot, base) - {base}
    if dropped:
        _remove(robot, dropped)
        notes.append(f"base: '{base}'; {len(dropped)} links that are not above it are left out")


def _drop_below(robot: Any, tip: str, notes: list[str]) -> None:
    """Take away what is on the flange: it would be inside the gripper."""
    dropped = _below(robot, tip)
    moving = {joint.child for joint in robot.joints if joint.type != "fixed"}
    shaped = {link.name for link in robot.links if link.collisions or link.visuals}
    if dropped & (moving | shaped):
        notes.append(f"gripper: the {len(dropped)} links on '{tip}' give way to ours")
    _remove(robot, dropped)


def _flange(where: str, robot: Any, choice: ArmChoice) -> str:
    """Find the link that the gripper is mounted on."""
    last = _sixth_link(where, robot, choice)
    rigid = [last] + [
        link
        for link in _below(robot, last)
        if all(j.type == "fixed" for j in _between(robot, last, link))
    ]
    for name in FLANGE_NAMES:
        for link in sorted(rigid):
            if link == name or link.endswith((f"_{name}", f"/{name}", f"-{name}")):
                return link
    return last


def _between(robot: Any, above: str, link: str) -> list[Any]:
    chain = chain_to(link, robot.joints)
    start = next((i + 1 for i, joint in enumerate(chain) if joint.child == above), 0)
    return chain[start:]


def _sixth_link(where: str, robot: Any, choice: ArmChoice) -> str:
    """Return the child of the last arm joint: the sixth revolute joint from the base."""
    if choice.joints:
        last = max(choice.joints, key=lambda name: len(_chain_of(robot, name)))
        return str(next(joint.child for joint in robot.joints if joint.name == last))
    best: list[Any] = []
    for link in robot.links:
        turning = [j for j in chain_to(link.name, robot.joints) if j.type in _TURNING]
        if len(turning) > len(best):
            best = turning
    if len(best) < 6:
        found = ", ".join(joint.name for joint in best) or "none"
        raise BadInput(
            f"{where}: an arm of six revolute joints is needed; the longest chain has {len(best)}: "
            f"{found}"
        )
    return str(best[5].child)


def _chain_of(robot: Any, name: str) -> list[Any]:
    child = next(joint.child for joint in robot.joints if joint.name == name)
    return chain_to(child, robot.joints)


def _mount(where: str, robot: Any, tip: str, chain: Sequence[Any]) -> Path:
    """Graft the bundled gripper onto a link; return the folder its meshes come from."""
    path = resource("assets", "gripper", "mount.urdf.xacro")
    ours = load_description(path)
    graft = copy.deepcopy(ours.model.robot)
    taken = {link.name for link in robot.links} | {joint.name for joint in robot.joints}
    names = {
        item.name: f"mounted_{item.name}" if item.name in taken else item.name
        for item in (*graft.links, *graft.joints)
    }
    root = ours.model.base_link
    for link in graft.links:
        link.name = names[link.name]
        for element in (*link.visuals, *link.collisions):
            mesh = element.geometry.mesh
            if mesh is not None:
                mesh.filename = ours.packages.resolve(mesh.filename, where=str(path)).as_uri()
    for joint in graft.joints:
        joint.name, joint.child = names[joint.name], names[joint.child]
        if joint.mimic is not None:
            joint.mimic.joint = names[joint.mimic.joint]
        if joint.parent == root:
            joint.parent = tip
            joint.origin = _hand_frame(tip, chain) @ joint_origin(joint)
        else:
            joint.parent = names[joint.parent]
    robot.links += [link for link in graft.links if link.name != names[root]]
    robot.joints += graft.joints
    known = {material.name for material in robot.materials}
    robot.materials += [item for item in graft.materials if item.name not in known]
    return ours.packages.home


def _hand_frame(tip: str, chain: Sequence[Any]) -> Array:
    """Return the frame (4, 4) in the flange link whose x axis is the direction of the hand.

    The direction is that of axis 6, away from the fifth joint; where the two joints have the same
    place on it, out of the face: z of a tool0, x of a flange, else the positive axis.
    """
    turning = [index for index, joint in enumerate(chain) if joint.type in _TURNING]
    T_tip_6 = np.eye(4)
    for joint in reversed(chain[turning[-1] + 1 :]):
        T_tip_6 = T_tip_6 @ np.linalg.inv(joint_origin(joint))
    axis = T_tip_6[:3, :3] @ joint_axis(chain[turning[-1]])
    T_tip_5 = T_tip_6
    for joint in reversed(chain[turning[-2] + 1 : turning[-1] + 1]):
        T_tip_5 = T_tip_5 @ np.linalg.inv(joint_origin(joint))
    away = -float(T_tip_5[:3, 3] @ axis)
    if abs(away) < 1e-3:
        face = np.array([0.0, 0, 1]) if tip.endswith("tool0") else np.array([1.0, 0, 0])
        away = float(face @ axis) if tip.endswith(FLANGE_NAMES) else 1.0
    x = axis if away >= 0 else -axis
    helper = np.eye(3)[int(np.argmin(np.abs(x)))]
    y = np.cross(helper, x) / np.linalg.norm(np.cross(helper, x))
    T = np.eye(4)
    T[:3, :3] = np.column_stack([x, y, np.cross(x, y)])
    return T


def _couple(fingers: list[Any], notes: list[str]) -> None:
    """Make the second of two fingers that nothing couples mimic the first."""
    if len(fingers) == 2 and all(joint.mimic is None for joint in fingers):
        import yourdfpy

        driven, follower = fingers
        follower.mimic = yourdfpy.urdf.Mimic(joint=driven.name, multiplier=1.0, offset=0.0)
        notes.append(f"gripper: '{follower.name}' is made to mimic '{driven.name}'")


def _freeze(robot: Any, keep: set[str], notes: list[str]) -> None:
    for joint in robot.joints:
        if joint.type != "fixed" and joint.name not in keep:
            notes.append(f"joint '{joint.name}' is of neither arm nor gripper: fixed at 0")
            joint.type, joint.mimic = "fixed", None
