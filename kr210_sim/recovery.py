"""Another try at a grasp: back out of the cell, look again, and take the target as it is then."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from kr210_sim.arrays import Array
from kr210_sim.collision import MujocoOracle
from kr210_sim.draws import Value
from kr210_sim.exceptions import CycleFailure
from kr210_sim.legs import CLEARANCE_CELL, Hand, Leg
from kr210_sim.motions import CycleSetup, TimedMotion, timed_motions
from kr210_sim.path import Path
from kr210_sim.scene import Target
from kr210_sim.simulation import Simulation
from kr210_sim.task import WITHDRAW_DISTANCE
from kr210_sim.tracks import TrackFinder

LOOK_TIME = 0.5
"""What a new picture and a new plan take, during which the arm waits [s]; planning alone takes 0.1
to 0.2 s."""

MAX_TILT = np.radians(20.0)
"""A target seen further from upright has fallen over: no grasp is planned for that [rad]."""

MAX_HEIGHT_ERROR = 0.05
"""A target seen this much higher or lower than one on its board is not there any more [m]."""

_SAME = 1e-6  # [rad], between the arm and the IK's answer to its pose


class GraspLost(Exception):
    """The gripper feels that it has no target; the message says by what."""


def way_out(
    simulation: Simulation, target: Target, setup: CycleSetup, q: Array, q_grasp: Array
) -> TimedMotion | None:
    """Return the motion straight back out of the cell, None if the tool is out.

    It ends as far back as a lift and withdrawal would have. The target is where the gripper has
    been, and may be touched.

    Args:
        simulation: the world as it is.
        target: that was to be picked.
        setup: limits.
        q: (6,) where the arm is, at rest, fingers open [rad].
        q_grasp: (6,) where it was to grasp [rad].

    Raises:
        CycleFailure: if that way is blocked.
    """
    robot = simulation.scene.robot
    T_now = robot.forward(q)
    x = T_now[:3, 0]
    distance = WITHDRAW_DISTANCE - float((robot.forward(q_grasp) - T_now)[:3, 3] @ x)
    if distance < 1e-3:
        return None
    T_out = T_now.copy()
    T_out[:3, 3] -= min(distance, WITHDRAW_DISTANCE) * x
    tracks = [
        track.q
        for track in TrackFinder(robot).find([(T_now, T_out)], anchor=0, q_start=q)
        if np.max(np.abs(track.q[0] - q)) < _SAME
    ]
    if not tracks:
        raise CycleFailure("no_path", "no IK branch leads straight back out of the cell")
    oracle = MujocoOracle(simulation, simulation.scene, target)
    what = oracle.blocked(tracks[0], hand=Hand.RELEASED, clearance=CLEARANCE_CELL)
    if what is not None:
        raise CycleFailure("no_path", f"the way straight back out of the cell is blocked: {what}")
    path = Path.through(tracks[0], robot.velocity)
    leg = Leg(stage="BACK_OUT", path=path, hand=Hand.RELEASED, clearance=CLEARANCE_CELL)
    return timed_motions([(leg,)], oracle, setup.limits)[0]


def look_again(
    simulation: Simulation, target: Target, setup: CycleSetup
) -> tuple[Target, dict[str, Value]]:
    """Return the target as it is believed to be after another look, and what that look drew.

    The look has the errors of the first one, drawn anew from the same streams of the cycle's seed.

    Raises:
        CycleFailure: missed_grasp, if it is not seen standing on its board.
    """
    scene = simulation.scene
    T_world_target = np.eye(4)
    body = simulation.data.body(target.name)
    T_world_target[:3, 3], T_world_target[:3, :3] = body.xpos, body.xmat.reshape(3, 3)
    T_base_target = np.linalg.inv(scene.T_world_base) @ T_world_target
    T_base_cell = scene.cell(target.cell).T_base_cell
    seen, drawn = setup.variation.look(T_base_target, T_base_cell)
    seen = T_base_target if seen is None else seen
    up = T_base_cell[:3, 2]
    tilt = float(np.arccos(np.clip(seen[:3, 2] @ up, -1.0, 1.0)))
    height = float(up @ (seen[:3, 3] - T_base_cell[:3, 3])) - target.length / 2
    if tilt > MAX_TILT or abs(height) > MAX_HEIGHT_ERROR:
        where = f"tilted by {np.degrees(tilt):.0f} deg, {1000 * height:.0f} mm above its board"
        raise CycleFailure("missed_grasp", f"no further try: the target is seen {where}")
    there = replace(setup.variation, T_base_perceived=seen)
    return there.believed(target, scene), drawn
