"""A model in a pose: where its bodies, frames and cameras are, by kinematics alone."""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray

from kr210_sim.arrays import Array
from kr210_sim.robot import Robot

_NEAREST = 0.5
"""Least distance of the point that a camera turns about [m]."""


@dataclass(frozen=True, kw_only=True, eq=False)
class View:
    """A camera: where it stands, what it looks at, both (3,) in the world frame [m], and how wide.

    `fovy` is the vertical field of view [rad].
    """

    position: Array
    look_at: Array
    fovy: float


class Puppet:
    """A compiled model that is posed and never simulated.

    Args:
        model: anything MuJoCo compiles.
        prefix: before the robot's names in it.
        robot: if there is one whose joints and links are to be found.
    """

    def __init__(
        self, model: mujoco.MjModel, *, prefix: str = "", robot: Robot | None = None
    ) -> None:
        self.model, self._prefix = model, prefix
        self._data = mujoco.MjData(model)
        self._arm = self._fingers = np.empty(0, dtype=np.int64)
        if robot is not None:
            self._arm = self._addresses(robot.arm_joints)
            self._fingers = self._addresses((robot.finger_joint, robot.mimic_joint))
        self.place(np.array(model.qpos0))

    def _addresses(self, joints: tuple[str, ...]) -> NDArray[np.int64]:
        found = [int(self.model.joint(self._prefix + name).qposadr[0]) for name in joints]
        return np.array(found)

    def place(self, qpos: Array) -> tuple[Array, Array]:
        """Pose every joint by qpos (nq,).

        Returns:
            Positions (nbody, 3) [m] and quat_wxyz (nbody, 4) of the bodies, world frame.
        """
        self._data.qpos[:] = qpos
        mujoco.mj_kinematics(self.model, self._data)
        return np.array(self._data.xpos), np.array(self._data.xquat)

    def place_robot(self, q: Array, fingers: Array | None = None) -> tuple[Array, Array]:
        """Pose the arm by q (6,) [rad], and the fingers by their joints (2,) [m]; see `place`."""
        qpos = np.array(self._data.qpos)
        qpos[self._arm] = q
        if fingers is not None:
            qpos[self._fingers] = fingers
        return self.place(qpos)

    def site(self, name: str) -> Array:
        """Return where a site of the robot is (3,), world frame [m]."""
        # mj_kinematics places sites, too
        return np.array(self._data.site(self._prefix + name).xpos)

    def links(self) -> dict[str, int]:
        """Return the body ids of the robot's links by name; all bodies without a prefix."""
        names = {self.model.body(index).name: index for index in range(1, self.model.nbody)}
        return {
            name.removeprefix(self._prefix): index
            for name, index in names.items()
            if name.startswith(self._prefix)
        }

    def views(self) -> dict[str, View]:
        """Return the model's cameras by name, as they are in this pose."""
        mujoco.mj_comPos(self.model, self._data)
        mujoco.mj_camlight(self.model, self._data)
        center, found = np.array(self.model.stat.center), {}
        for index in range(self.model.ncam):
            position = np.array(self._data.cam_xpos[index])
            ahead = -self._data.cam_xmat[index].reshape(3, 3)[:, 2]
            distance = max(float((center - position) @ ahead), _NEAREST)
            found[self.model.camera(index).name] = View(
                position=position,
                look_at=position + distance * ahead,
                fovy=float(np.radians(self.model.cam_fovy[index])),
            )
        return found
