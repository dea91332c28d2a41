"""Effort limits that cannot hold the arm up -> ones that can carry and move it, by rule."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

import ik
from kr210_sim.arrays import Array
from kr210_sim.description import Description, load_description
from kr210_sim.dynamics import GRAVITY, arm_load
from kr210_sim.robot import ACCELERATION_TIME, Robot, bundled_robot, find_robot

ROTOR_ACCELERATION = 180.0
"""Effort limit over reflected rotor inertia [rad/s^2], from which the armature follows.

Geared servo drives of this class bring their own rotor to full speed in about 10 to 20 ms.
"""

PAYLOAD = 10.0
"""Load in the hand that replaced limits can carry and move [kg]."""

OFF_AXIS = 0.1
"""The load's distance from the TCP, so that a joint through the TCP carries something [m]."""

RESERVE = 1.5
"""Factor on the torque of one joint moving alone: the others move, too."""

TARGET = 1.0
"""Load in the hand for the advice on speed [kg]: the default target."""

MARGIN = 1.2
"""Torque over that of one joint moving alone at which no advice is needed."""

_SAMPLES = 512
_SAME_LENGTH = 1e-3  # [m]


def rate_efforts(description: Description, robot: Robot) -> Robot:
    """Replace effort limits with which the arm cannot hold itself up.

    Over 512 configurations within the limits, the largest gravity torque of the empty arm is
    computed for each joint. If one of the description's limits is below it, they cannot be those of
    the real drives, and all six are replaced: for an arm with the lengths of the KR210 by those of
    the bundled description, for any other by

        effort = 1.5 (G + M v / 0.25 s) / (1 - 1.5 v / (0.25 s x 180 rad/s^2))

    with G and M the largest gravity torque and reflected inertia with 10 kg in the hand, as if it
    were 0.1 m further out, and v the velocity limit: the acceleration of the planned motions, the
    rotors' share included. A limit of the description that is higher stays.

    Limits that can hold the arm stay; a note then says if they call for a lower `--speed`.

    Returns:
        The robot, with a note if limits were replaced or are tight.
    """
    rng = np.random.default_rng(0)
    q = rng.uniform(robot.lower, robot.upper, (_SAMPLES, 6))
    needed = np.max(np.abs(arm_load(description.model, robot, q).gravity), axis=0)
    weak = np.flatnonzero((robot.effort < needed) | (robot.effort <= 0))
    if not len(weak):
        return _with_advice(description, robot, q)
    listed = ", ".join(
        f"{robot.arm_joints[i]} {robot.effort[i]:g} of {needed[i]:.0f} N m" for i in weak
    )
    if _is_kr210(robot):
        effort, rule = find_robot(load_description(bundled_robot())).effort, "of the KR210 here"
    else:
        effort, rule = np.maximum(_able(description, robot, q), robot.effort), "by rule"
    effort = np.array(effort)
    effort.flags.writeable = False
    note = (
        f"effort: the description's limits cannot hold the empty arm against gravity ({listed}); "
        f"replaced by those {rule}: {', '.join(f'{value:.0f}' for value in effort)} N m"
    )
    return replace(robot, effort=effort, notes=(*robot.notes, note))


def _able(description: Description, robot: Robot, q: Array) -> Array:
    """Return effort limits (6,) by the rule of `rate_efforts`, to two digits upwards."""
    loaded = arm_load(description.model, robot, q, load=PAYLOAD)
    acceleration = robot.velocity / ACCELERATION_TIME
    gravity = np.max(np.abs(loaded.gravity), axis=0) + PAYLOAD * GRAVITY * OFF_AXIS
    inertia = np.max(loaded.inertia, axis=0) + PAYLOAD * OFF_AXIS**2
    alone = gravity + inertia * acceleration
    share = np.minimum(RESERVE * acceleration / ROTOR_ACCELERATION, 0.5)
    torque = RESERVE * alone / (1 - share)
    step = 10.0 ** np.floor(np.log10(torque) - 1)
    return np.asarray(np.ceil(torque / step) * step)


def _with_advice(description: Description, robot: Robot, q: Array) -> Robot:
    """Note the speed at which limits that hold the arm can also move it, if that is below 1."""
    load = arm_load(description.model, robot, q, load=TARGET)
    holding = np.max(np.abs(load.gravity), axis=0)
    rotor = robot.effort / ROTOR_ACCELERATION
    moving = (np.max(load.inertia, axis=0) + rotor) * robot.velocity / ACCELERATION_TIME
    share = np.clip((robot.effort / MARGIN - holding) / moving, 0.01, None)
    slowest = int(np.argmin(share))
    if share[slowest] >= 1:
        return robot
    speed = np.floor(100 * np.sqrt(share[slowest])) / 100
    note = (
        f"effort: {robot.arm_joints[slowest]} has {robot.effort[slowest]:g} N m, too little for "
        f"the arm's full acceleration; --speed {speed:g} keeps within it"
    )
    return replace(robot, notes=(*robot.notes, note))


def _is_kr210(robot: Robot) -> bool:
    arm, ours = robot.geometry, ik.KR210
    lengths = [(getattr(arm, name), getattr(ours, name)) for name in ("a1", "d1", "L2", "a3", "d4")]
    return all(abs(own - known) < _SAME_LENGTH for own, known in lengths) and abs(arm.b) < 1e-3
