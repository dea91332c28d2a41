"""The two fingers of a description: which joints they are, how they close, where they hold."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from kr210_sim.arrays import Array
from kr210_sim.exceptions import BadInput
from kr210_sim.packages import Packages
from kr210_sim.shapes import shape_points

PAD_MARK = "_pad"
"""Collision elements of a finger whose name contains this are the gripping surfaces; without any,
all of the finger's are."""

TCP_NAME = "tcp"
"""A link of this name, or one that ends in _tcp, is where the TCP is."""

PAD_FRICTION = 1.0
"""Sliding friction of a pad on a target; the pads' contact has priority over the target's own."""

JAW_TILT = np.deg2rad(15.0)
"""Tilt of the pads of the V jaws: a target off their middle touches one pad of each finger only,
and is pushed further out."""

_ALIGNED = 1e-6  # [rad]


@dataclass(frozen=True, kw_only=True)
class Gripper:
    """Two opposed fingers on one palm.

    Attributes:
        palm: link that carries the fingers.
        driven: the finger joint with an actuator.
        mimic: the finger joint that follows it.
        links: the finger links, the one on the smaller side along `axis` first.
        axis: (3,) direction of closing in the palm frame, unit, largest component positive.
        open, closed: position of the driven joint at the wider and the narrower limit [m].
    """

    palm: str
    driven: Any
    mimic: Any
    links: tuple[str, str]
    axis: Array
    open: float
    closed: float


def joint_origin(joint: Any) -> Array:
    """Return the transform (4, 4) from the parent link to a joint's frame."""
    return np.eye(4) if joint.origin is None else np.array(joint.origin, dtype=float)


def joint_axis(joint: Any) -> Array:
    """Return the unit axis (3,) of a joint in its own frame."""
    axis = np.array([1.0, 0, 0] if joint.axis is None else joint.axis, dtype=float)
    return np.asarray(axis / np.linalg.norm(axis))


def chain_to(link: str, joints: Sequence[Any]) -> list[Any]:
    """Return the joints from the root to a link, in order."""
    by_child = {joint.child: joint for joint in joints}
    chain: list[Any] = []
    while link in by_child:
        chain.append(by_child[link])
        link = chain[-1].parent
    return chain[::-1]


def finger_joints(joints: Sequence[Any]) -> list[Any]:
    """Return the prismatic joints beyond a revolute one: those of a gripper, not of a rail."""
    return [
        joint
        for joint in joints
        if joint.type == "prismatic"
        and any(above.type != "fixed" for above in chain_to(joint.parent, joints))
    ]


def find_gripper(where: str, joints: Sequence[Any]) -> Gripper:
    """Find the two fingers among the joints of a description.

    Raises:
        BadInput: if there are not two opposed, coupled prismatic joints on one link.
    """
    prismatic = finger_joints(joints)
    if len(prismatic) != 2 or len({joint.parent for joint in prismatic}) != 1:
        raise BadInput(
            f"{where}: found {len(prismatic)} prismatic joints; a gripper needs two opposed "
            "prismatic finger joints on one palm link; name them by --fingers A,B, or put ours in "
            "its place by --gripper"
        )
    driven = [joint for joint in prismatic if joint.mimic is None]
    mimic = next((joint for joint in prismatic if joint.mimic is not None), None)
    if len(driven) != 1 or mimic is None or mimic.mimic.joint != driven[0].name:
        raise BadInput(
            f"{where}: exactly one finger joint must carry <mimic> of the other, as the jaws of a "
            "parallel gripper are coupled; --fingers A,B couples two that do not"
        )
    first, second = driven[0], mimic
    axes = [joint_origin(joint)[:3, :3] @ joint_axis(joint) for joint in (first, second)]
    axis = axes[0] * np.sign(axes[0][np.argmax(np.abs(axes[0]))])
    multiplier, offset = coupling(mimic)

    def gap(q: float) -> float:
        ends = [
            axis @ (joint_origin(joint)[:3, 3] + direction * value)
            for joint, direction, value in (
                (first, axes[0], q),
                (second, axes[1], multiplier * q + offset),
            )
        ]
        return float(ends[1] - ends[0])

    limits = (float(first.limit.lower), float(first.limit.upper))
    gaps = [gap(limit) for limit in limits]
    if np.linalg.norm(np.cross(axes[0], axes[1])) > 1e-3 or abs(gaps[0] - gaps[1]) < 1e-6:
        raise BadInput(
            f"{where}: joints '{first.name}' and '{second.name}' do not move the fingers towards "
            "each other; correct axis or <mimic>, or put our gripper in its place by --gripper"
        )
    widest = int(np.argmax(np.abs(gaps)))
    links = (first.child, second.child) if gaps[widest] > 0 else (second.child, first.child)
    return Gripper(
        palm=first.parent,
        driven=first,
        mimic=mimic,
        links=links,
        axis=axis,
        open=limits[widest],
        closed=limits[1 - widest],
    )


def coupling(mimic: Any) -> tuple[float, float]:
    """Return multiplier and offset of a joint that follows another."""
    multiplier = mimic.mimic.multiplier
    return (1.0 if multiplier is None else float(multiplier)), float(mimic.mimic.offset or 0.0)


def find_tcp(
    where: str, robot: Any, gripper: Gripper, forward: Array, packages: Packages
) -> tuple[Array, tuple[str, ...]]:
    """Find the TCP: on the axis of a grasped cylinder, x along the approach, z along the cylinder.

    Position: the link named `tcp`, rigidly joined to the palm. Without one, midway between the
    fingers, at the middle of their gripping surfaces (collision elements named `..._pad`, else the
    front half of each finger).

    Orientation: that link's, if its y axis is the direction of closing and x points forward. Else
    y is the direction of closing and x the direction nearest to `forward` that is perpendicular.

    Args:
        where: the file, for messages.
        robot: `yourdfpy` robot.
        gripper: the fingers.
        forward: (3,) unit direction in the palm frame in which the hand points.
        packages: resolves meshes.

    Returns:
        T_palm_tcp (4, 4), and notes on what was guessed.

    Raises:
        BadInput: if the link named tcp moves against the palm, or no direction can be found.
    """
    notes = []
    T = _named_tcp(where, robot, gripper.palm)
    side = forward - gripper.axis * (gripper.axis @ forward)
    if np.linalg.norm(side) < 0.5:
        raise BadInput(
            f"{where}: the fingers close along the hand, not across it; correct their axes"
        )
    x = side / np.linalg.norm(side)
    if T is None:
        T = np.eye(4)
        T[:3, 3] = _between_fingers(robot, gripper, x, packages)
        T[:3, :3] = np.column_stack([x, gripper.axis, np.cross(x, gripper.axis)])
        position = " ".join(f"{value:.4f}" for value in T[:3, 3])
        notes.append(
            f"TCP: no link named '{TCP_NAME}'; it is taken midway between the fingers, at "
            f"{position} m in '{gripper.palm}'"
        )
    elif abs(T[:3, 1] @ gripper.axis) < 1 - _ALIGNED or T[:3, 0] @ x < 0.9:
        T[:3, :3] = np.column_stack([x, gripper.axis, np.cross(x, gripper.axis)])
        notes.append(
            f"TCP: the axes of link '{TCP_NAME}' are replaced: x along the approach, y along the "
            "closing of the fingers"
        )
    return T, tuple(notes)


def _named_tcp(where: str, robot: Any, palm: str) -> Array | None:
    names = [
        link.name
        for link in robot.links
        if link.name == TCP_NAME or link.name.endswith((f"_{TCP_NAME}", f"/{TCP_NAME}"))
    ]
    names.sort(key=lambda name: all(joint.child != palm for joint in chain_to(name, robot.joints)))
    rigid = {name: _rigid_root(name, robot.joints) for name in [*names, palm]}
    T_root_palm = rigid[palm][1]
    for name in names:
        if rigid[name][0] == rigid[palm][0]:
            return np.linalg.inv(T_root_palm) @ rigid[name][1]
    if TCP_NAME in names:
        raise BadInput(
            f"{where}: link '{TCP_NAME}' is not fixed to '{palm}'; fix it there, on the axis of a "
            "grasped cylinder, +x along the approach"
        )
    return None


def _rigid_root(link: str, joints: Sequence[Any]) -> tuple[str, Array]:
    """Return the highest link that a link is rigidly joined to, and its pose (4, 4) there."""
    T = np.eye(4)
    for joint in reversed(chain_to(link, joints)):
        if joint.type != "fixed":
            break
        T, link = joint_origin(joint) @ T, joint.parent
    return link, T


def gripping(link: Any) -> list[Any]:
    """Return the collision elements of a finger that grip."""
    pads = [element for element in link.collisions if PAD_MARK in (element.name or "")]
    return pads or list(link.collisions)


def _between_fingers(robot: Any, gripper: Gripper, x: Array, packages: Packages) -> Array:
    """Return the point (3,) in the palm frame midway between the gripping surfaces."""
    links = {link.name: link for link in robot.links}
    multiplier, offset = coupling(gripper.mimic)
    centres = []
    for joint, q in (
        (gripper.driven, gripper.open),
        (gripper.mimic, multiplier * gripper.open + offset),
    ):
        T = joint_origin(joint)
        T[:3, 3] += T[:3, :3] @ joint_axis(joint) * q
        grips = gripping(links[joint.child])
        points = shape_points(grips, packages) @ T[:3, :3].T + T[:3, 3]
        if not len(points):
            points = T[None, :3, 3]
        named = any(PAD_MARK in (element.name or "") for element in grips)
        along = points @ x
        front = points if named else points[along >= (along.min() + along.max()) / 2 - 1e-9]
        centre = (front.min(axis=0) + front.max(axis=0)) / 2
        share = 0.5 if named else 0.75
        ahead = along.min() + share * np.ptp(along)
        centres.append(centre + x * (ahead - centre @ x))
    return np.asarray((centres[0] + centres[1]) / 2)
