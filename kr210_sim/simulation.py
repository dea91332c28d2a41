"""The running world of one episode: targets that come and go, steps, and measurements."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from kr210_sim.arrays import Array
from kr210_sim.gripper import PAD_FRICTION
from kr210_sim.mjcf import PAD_PRIORITY
from kr210_sim.scene import ROBOT_PREFIX, Scene, Target, add_target

_SENSOR_PREFIX = "measure/"
_PAYLOAD = ROBOT_PREFIX + "unknown_payload"
_PAYLOAD_RADIUS = 0.05  # [m], of a solid ball


@dataclass(frozen=True, kw_only=True)
class Addresses:
    """Where the robot's joints lie in `qpos`, `qvel` and `ctrl`."""

    arm: NDArray[np.int64]
    arm_dof: NDArray[np.int64]
    arm_ctrl: NDArray[np.int64]
    fingers: NDArray[np.int64]
    finger_ctrl: int


class Simulation:
    """One world: a scene with its robot, and the targets added to it so far.

    Attributes:
        scene: what the names mean.
        model, data: the compiled world; both are replaced whenever a target comes or goes.
        addresses: of the robot in `model`.
        columns: slice of each measurement in the rows that `step` returns; present while a target
            is watched.
        measured: (n, nq), the positions that the rows of the latest `step` belong to.
        foreign_weights: (m,), a row of measurements times this is the number of contacts of robot
            and watched target that are not permitted.
    """

    def __init__(self, scene: Scene) -> None:
        self.scene = scene
        self.targets: dict[str, Target] = {}
        self._spec = scene.spec.copy()
        self.model: mujoco.MjModel = self._spec.compile()
        self.data = mujoco.MjData(self.model)
        self.columns: dict[str, slice] = {}
        self.foreign_weights = np.zeros(self.model.nsensordata)
        self.measured = np.array(self.data.qpos)[None]
        self._before: mujoco.MjData | None = None
        self._watched = ""
        self._permitted: set[str] = set()
        self._bind()
        self.restart({})

    def _bind(self) -> None:
        robot, model = self.scene.robot, self.model
        arm = [model.joint(ROBOT_PREFIX + name) for name in robot.arm_joints]
        fingers = [
            model.joint(ROBOT_PREFIX + name) for name in (robot.finger_joint, robot.mimic_joint)
        ]
        self.addresses = Addresses(
            arm=np.array([joint.qposadr[0] for joint in arm]),
            arm_dof=np.array([joint.dofadr[0] for joint in arm]),
            arm_ctrl=np.array([model.actuator(ROBOT_PREFIX + n).id for n in robot.arm_joints]),
            fingers=np.array([joint.qposadr[0] for joint in fingers]),
            finger_ctrl=int(model.actuator(ROBOT_PREFIX + robot.finger_joint).id),
        )

    def body_id(self, link: str) -> int:
        """Return the id of a robot link's body."""
        return int(self.model.body(ROBOT_PREFIX + link).id)

    def restart(self, start: dict[str, Array]) -> None:
        """Put every joint where it was in an earlier `positions()`, at rest, the robot at home.

        Used between cycles only. Joints that did not exist then go to their initial places.
        """
        mujoco.mj_resetData(self.model, self.data)
        for name, values in start.items():
            if mujoco.mj_name2id(self.model, mujoco.mjtObj.mjOBJ_JOINT, name) >= 0:
                first = int(self.model.joint(name).qposadr[0])
                self.data.qpos[first : first + len(values)] = values
        opening = self.scene.robot.open_positions
        self.data.qpos[self.addresses.arm] = 0.0
        self.data.qpos[self.addresses.fingers] = opening
        self.data.ctrl[:] = 0.0
        self.data.ctrl[self.addresses.finger_ctrl] = opening[0]
        mujoco.mj_forward(self.model, self.data)

    def positions(self) -> dict[str, Array]:
        """Return the part of `qpos` of every joint by its name, in order."""
        ends = [*self.model.jnt_qposadr[1:].tolist(), self.model.nq]
        return {
            self.model.joint(index).name: np.array(self.data.qpos[start:end])
            for index, (start, end) in enumerate(zip(self.model.jnt_qposadr, ends, strict=True))
        }

    def add(self, target: Target) -> None:
        """Add a target to the world; everything else keeps its state."""
        add_target(self._spec, self.scene, target)
        self.targets[target.name] = target
        self._recompile()

    def remove(self, name: str) -> None:
        """Take a target out of the world."""
        self._watch(None)
        self._spec.delete(self._spec.body(name))
        del self.targets[name]
        self._recompile()

    def begin_at(self, q: Array) -> None:
        """Put the arm at rest in a configuration (6,) [rad]; used between cycles only."""
        self.data.qpos[self.addresses.arm] = q
        self.data.qvel[self.addresses.arm_dof] = 0.0
        self.data.ctrl[self.addresses.arm_ctrl] = q
        mujoco.mj_forward(self.model, self.data)

    def alter_robot(
        self, *, pad_friction: float | None = None, gain: Array | None = None, payload: float = 0.0
    ) -> None:
        """Make the robot differ from its description, from the next `watch` on.

        Args:
            pad_friction: coefficient of the pads; None for the description's.
            gain: (6,) factor of each arm servo's force; None for 1.
            payload: at the TCP, not compensated by the drives [kg].
        """
        robot, described = self.scene.robot, self.scene.spec
        for finger in robot.fingers:
            for geom in self._spec.body(ROBOT_PREFIX + finger).find_all("geom"):
                if geom.priority == PAD_PRIORITY:
                    geom.friction[0] = PAD_FRICTION if pad_friction is None else pad_friction
        for index, name in enumerate(robot.arm_joints):
            factor = 1.0 if gain is None else float(gain[index])
            actuator = self._spec.actuator(ROBOT_PREFIX + name)
            nominal = described.actuator(ROBOT_PREFIX + name)
            actuator.gainprm = nominal.gainprm * factor
            actuator.biasprm = nominal.biasprm * factor
        if (body := self._spec.body(_PAYLOAD)) is not None:
            self._spec.delete(body)
        if payload:
            body = self._spec.body(ROBOT_PREFIX + robot.palm).add_body(
                name=_PAYLOAD, pos=robot.T_palm_tcp[:3, 3], mass=payload, explicitinertial=True
            )
            body.inertia = np.full(3, 0.4 * payload * _PAYLOAD_RADIUS**2)

    def watch(self, target: Target) -> None:
        """Measure this target from now on, as the one to be picked."""
        self._watch(target)
        self._recompile()

    def _recompile(self) -> None:
        self.model, self.data = self._spec.recompile(self.model, self.data)
        self._before = None
        self._bind()
        self.columns = {}
        self.foreign_weights = np.zeros(self.model.nsensordata)
        for index in range(self.model.nsensor):
            sensor = self.model.sensor(index)
            if not sensor.name.startswith(_SENSOR_PREFIX):
                continue  # the scene's own
            start = int(sensor.adr[0])
            name = sensor.name.removeprefix(_SENSOR_PREFIX)
            self.columns[name] = slice(start, start + int(sensor.dim[0]))
            if sensor.type[0] == mujoco.mjtSensor.mjSENS_CONTACT:
                self.foreign_weights[start] = 1.0 if name.endswith("_all") else -1.0
        mujoco.mj_forward(self.model, self.data)

    def step(self, ctrl: Array) -> Array:
        """Advance one physics step per row of ctrl (n, nu); return the measurements (n, m).

        A row holds what MuJoCo measured in the state before that step was integrated. The steps
        end early at the first contact that is not permitted, so that its bodies can be named.
        """
        if self._before is None:
            self._before = mujoco.MjData(self.model)
        mujoco.mj_copyData(self._before, self.model, self.data)
        with np.errstate(invalid="ignore"):  # a diverging state is for the caller to see
            try:
                rows = self._run(ctrl)
                if not np.any(rows @ self.foreign_weights > 0.5):
                    return rows
            except mujoco.FatalError:
                pass  # perhaps such a contact came first
            self.undo()
            return self._run(ctrl, careful=True)

    def _run(self, ctrl: Array, *, careful: bool = False) -> Array:
        """Step; only a careful run, which is slower, ends at a contact that is not permitted."""
        model, data, weights = self.model, self.data, self.foreign_weights
        sensordata, target, qpos = data.sensordata, data.ctrl, data.qpos
        rows = np.empty((len(ctrl), model.nsensordata))
        measured = np.empty((len(ctrl), model.nq))
        count = len(ctrl)
        for index in range(count):
            target[:] = ctrl[index]
            measured[index] = qpos
            mujoco.mj_step(model, data)
            rows[index] = sensordata
            if careful and weights @ sensordata > 0.5:
                count = index + 1
                break
        self.measured = measured[:count]
        return rows[:count]

    def undo(self) -> None:
        """Go back to the state before the latest `step`, bit for bit."""
        mujoco.mj_copyData(self.data, self.model, self._before)

    @property
    def diverged(self) -> bool:
        """Whether MuJoCo has warned of a bad position, velocity or acceleration."""
        warnings = mujoco.mjtWarning
        kinds = (warnings.mjWARN_BADQPOS, warnings.mjWARN_BADQVEL, warnings.mjWARN_BADQACC)
        return any(self.data.warning[int(kind)].number for kind in kinds)

    def foreign_pair(self) -> str:
        """Name the two bodies of the first contact that is not permitted, as of the last step."""
        model = self.model
        for geoms in self.data.contact.geom:
            names = [self.model.body(int(model.geom_bodyid[geom])).name for geom in geoms]
            geom_names = [model.geom(int(geom)).name for geom in geoms]
            on_target = self._watched in names
            of_robot = [name.startswith(ROBOT_PREFIX) for name in names]
            other = names[0] if names[1] == self._watched else names[1]
            other_geom = geom_names[0] if names[1] == self._watched else geom_names[1]
            permitted = on_target and (other in self._permitted or other_geom in self._permitted)
            if (any(of_robot) or on_target) and not permitted:
                return " touched ".join(
                    name.removeprefix(ROBOT_PREFIX) or "world" for name in names
                )
        return "a contact that ended within the step"

    def world_xml(self) -> str:
        """Return the MJCF of the world as it is now compiled."""
        return str(self._spec.to_xml())

    # ---- measurements -----------------------------------------------------------------------

    def _watch(self, target: Target | None) -> None:
        for sensor in list(self._spec.sensors):
            if sensor.name.startswith(_SENSOR_PREFIX):
                self._spec.delete(sensor)
        if target is None:
            return
        # Sleeping bodies report no contacts; only the others may sleep.
        for name in self.targets:
            never = name == target.name
            self._spec.body(name).sleep = (
                mujoco.mjtSleepPolicy.mjSLEEP_NEVER
                if never
                else mujoco.mjtSleepPolicy.mjSLEEP_ALLOWED
            )
        self._watched = target.name
        robot = self.scene.robot
        types = mujoco.mjtSensor
        for name in robot.arm_joints:
            self._sense_joint(f"q/{name}", types.mjSENS_JOINTPOS, name)
        for name in robot.arm_joints:
            self._sense_joint(f"qd/{name}", types.mjSENS_JOINTVEL, name)
        for name in robot.arm_joints:
            self._sense_joint(f"effort/{name}", types.mjSENS_JOINTACTFRC, name)
        for name in (robot.finger_joint, robot.mimic_joint):
            self._sense_joint(f"finger/{name}", types.mjSENS_JOINTPOS, name)
        for name in (robot.finger_joint, robot.mimic_joint):
            self._sense_joint(f"fingerd/{name}", types.mjSENS_JOINTVEL, name)
        tcp = {"objtype": mujoco.mjtObj.mjOBJ_SITE, "objname": ROBOT_PREFIX + "tcp"}
        base = {"reftype": mujoco.mjtObj.mjOBJ_SITE, "refname": "robot_base"}
        in_tcp = {"reftype": mujoco.mjtObj.mjOBJ_SITE, "refname": ROBOT_PREFIX + "tcp"}
        body = {"objtype": mujoco.mjtObj.mjOBJ_XBODY, "objname": target.name}
        for name, kind, frame in (
            ("tcp_position", types.mjSENS_FRAMEPOS, tcp | base),
            ("tcp_quat_wxyz", types.mjSENS_FRAMEQUAT, tcp | base),
            ("held_position", types.mjSENS_FRAMEPOS, body | in_tcp),
            ("held_quat_wxyz", types.mjSENS_FRAMEQUAT, body | in_tcp),
            ("target_position", types.mjSENS_FRAMEPOS, body | base),
            ("target_velocity", types.mjSENS_FRAMELINVEL, body),
            ("target_spin", types.mjSENS_FRAMEANGVEL, body),
        ):
            self._spec.add_sensor(name=_SENSOR_PREFIX + name, type=kind, **frame)
        self._sense_contacts(target)

    def _sense_joint(self, name: str, kind: Any, joint: str) -> None:
        self._spec.add_sensor(
            name=_SENSOR_PREFIX + name,
            type=kind,
            objtype=mujoco.mjtObj.mjOBJ_JOINT,
            objname=ROBOT_PREFIX + joint,
        )

    def _sense_contacts(self, target: Target) -> None:
        """Count contacts in C at every physics step: all of them, and the permitted ones."""
        subtree, body, geom = (
            mujoco.mjtObj.mjOBJ_XBODY,
            mujoco.mjtObj.mjOBJ_BODY,
            mujoco.mjtObj.mjOBJ_GEOM,
        )
        robot = (subtree, ROBOT_PREFIX + self.scene.robot.root)
        picked = (body, target.name)
        right, left = ((subtree, ROBOT_PREFIX + name) for name in self.scene.robot.fingers)
        self._count("robot_all", robot)
        self._count("robot_target", robot, picked)
        self._count("target_all", picked)
        self._count("target_right", picked, right, force=True)
        self._count("target_left", picked, left, force=True)
        support = self.scene.cell(target.cell).support
        if not self._in_bin(support):  # or its contacts would be permitted twice
            self._count("target_support", picked, (geom, support))
        self._count("target_bin", picked, (subtree, "bin"))
        neighbours = [
            name for name in self.targets if name != target.name and self.in_place_volume(name)
        ]
        for name in neighbours:
            self._count(f"target_neighbour/{name}", picked, (body, name))
        self._permitted = {right[1], left[1], support, "bin", *neighbours}

    def _count(
        self,
        name: str,
        first: tuple[Any, str],
        second: tuple[Any, str] | None = None,
        *,
        force: bool = False,
    ) -> None:
        found = 1 << int(mujoco.mjtConDataField.mjCONDATA_FOUND)
        fields = found | (1 << int(mujoco.mjtConDataField.mjCONDATA_FORCE) if force else 0)
        net_force = 3  # reduction "netforce": all matching contacts summed, in the world frame
        options = {} if second is None else {"reftype": second[0], "refname": second[1]}
        self._spec.add_sensor(
            name=_SENSOR_PREFIX + name,
            type=mujoco.mjtSensor.mjSENS_CONTACT,
            objtype=first[0],
            objname=first[1],
            intprm=[fields, net_force if force else 0, 1],
            **options,
        )

    def _in_bin(self, geom: str) -> bool:
        """Whether a geom belongs to the bin."""
        body = int(self.model.geom(geom).bodyid[0])
        while body > 0:
            if self.model.body(body).name == "bin":
                return True
            body = int(self.model.body_parentid[body])
        return False

    def in_place_volume(self, name: str) -> bool:
        """Whether a target's centre lies in the place volume."""
        p_world = np.array(self.data.body(name).xpos)
        T = self.scene.T_world_base
        return self.scene.place.contains((p_world - T[:3, 3]) @ T[:3, :3])

    def placed(self) -> list[Array]:
        """Return the positions (3,) of the targets in the place volume, base frame [m]."""
        T = self.scene.T_world_base
        return [
            (np.array(self.data.body(name).xpos) - T[:3, 3]) @ T[:3, :3]
            for name in self.targets
            if self.in_place_volume(name)
        ]
