"""What the TCP may do beside the joints: a top speed, and no more load on a grasp than it holds."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from kr210_sim.arrays import Array
from kr210_sim.dynamics import GRAVITY
from kr210_sim.gripper import PAD_FRICTION
from kr210_sim.robot import Robot
from kr210_sim.trajectory import Trajectory

TCP_SPEED = 8.0
"""Top speed of the TCP [m/s] if nothing else is asked for; the bundled arm reaches about 7."""

GRIP_SAFETY = 1.5
"""Grip force over the largest load a motion may put on it.

It stands for what `grip_load` leaves out: the moments of a turning target, and that each pad bears
its own share. Simulated grasps of 500 N were lost from a load of 620 N on.
"""

_STEP = 4e-3  # [s], of the samples of a trajectory
_HALVINGS = 40


@dataclass(frozen=True, kw_only=True)
class TcpLimits:
    """Cartesian limits of a cycle's motions.

    Attributes:
        speed: of the TCP [m/s].
        grip_safety: grip force over the largest load on it while a target is held.
    """

    speed: float = TCP_SPEED
    grip_safety: float = GRIP_SAFETY

    def share(
        self,
        robot: Robot,
        trajectory: Trajectory,
        held_mass: float | None,
        *,
        friction: float = PAD_FRICTION,
    ) -> float:
        """Return how fast a trajectory may be run: 1 as it is, 0.5 in twice the time.

        Args:
            robot: tool and grip force.
            trajectory: of the arm.
            held_mass: of the target in the hand [kg], None for an empty hand.
            friction: coefficient to count on. With too little of it for twice the weight, what is
                enough for that is counted on: else nothing would be carried at all.

        Raises:
            ValueError: if the grip does not even hold the target at rest.
        """
        if trajectory.duration == 0.0:
            return 1.0
        count = max(4, int(np.ceil(trajectory.duration / _STEP)) + 1)
        t, step = np.linspace(0.0, trajectory.duration, count, retstep=True)
        T_base_tcp = robot.forward(trajectory.positions(t))
        velocity = np.diff(T_base_tcp[:, :3, 3], axis=0) / step
        fastest = float(np.max(np.linalg.norm(velocity, axis=1)))
        share = min(1.0, self.speed / fastest) if fastest > 0.0 else 1.0
        if held_mass is None:
            return share
        acceleration = np.diff(velocity, axis=0) / step
        R_base_tcp = T_base_tcp[1:-1, :3, :3]
        limit = robot.grip_force / self.grip_safety
        friction = max(friction, min(PAD_FRICTION, 2 * held_mass * GRAVITY / limit))

        def holds(share: float) -> bool:
            load = grip_load(R_base_tcp, acceleration * share**2, held_mass, friction)
            return bool(np.max(load) <= limit)

        if holds(share):
            return share
        if not holds(0.0):
            raise ValueError(f"a grip of {robot.grip_force:g} N does not hold {held_mass:g} kg")
        # The load is convex in share^2, so what holds is an interval that begins at standstill.
        low, high = 0.0, share
        for _ in range(_HALVINGS):
            middle = (low + high) / 2
            low, high = (middle, high) if holds(middle) else (low, middle)
        return low


def grip_load(
    R_base_tcp: Array, acceleration: Array, mass: float, friction: float = PAD_FRICTION
) -> Array:
    """Return the grip force (N,) [N] that a target at the TCP needs at least.

    The pads press along the tool's y axis with forces that add up to the grip force G, so the
    target's inertia and weight F, in the tool frame, may shift the balance between the fingers by
    |F_y| until one of them is free; friction mu on both must bear the rest, half each:

        |F_xz| / 2 <= mu (G - |F_y|) / 2,   so   G >= |F_y| + |F_xz| / mu.

    Args:
        R_base_tcp: (N, 3, 3) orientation of the tool; base frame, z up.
        acceleration: (N, 3) of the TCP, base frame [m/s^2].
        mass: [kg].
        friction: coefficient mu.
    """
    specific = acceleration + np.array([0.0, 0.0, GRAVITY])
    force = mass * np.einsum("nji,nj->ni", R_base_tcp, specific)
    across = np.hypot(force[:, 0], force[:, 2])
    return np.asarray(np.abs(force[:, 1]) + across / friction)
