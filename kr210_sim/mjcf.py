"""URDF model -> MjSpec of the robot: bodies, geometry, servo actuators, TCP site, home keyframe."""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np

from kr210_sim.description import Description
from kr210_sim.effort import ROTOR_ACCELERATION
from kr210_sim.exceptions import BadInput
from kr210_sim.geometry import ShapeBuilder, split_pose
from kr210_sim.gripper import PAD_FRICTION, PAD_MARK, joint_axis
from kr210_sim.robot import Robot

TIMESTEP = 0.0005
"""Physics step [s]: Euler at 0.5 ms reports actuator forces honestly and keeps the grasp."""

SERVO_BANDWIDTH = 200.0
"""Natural frequency w of the joint servos [rad/s]; kp = M w^2, kv = 2 M w (critical damping)."""

FINGER_KP = 1e5  # [N/m]
FINGER_ARMATURE = 10.0  # [kg], spindle and motor seen by the jaw

PAD_PRIORITY = 2
"""Contact priority of the pads: their friction and stiffness count, whatever they touch."""

_PAD_FRICTION = (PAD_FRICTION, 0.005, 0.0001)  # sliding, torsional [m], rolling [m]
_PAD_IMPEDANCE = (0.8, 0.95, 0.001, 0.5, 2.0)
"""MuJoCo's solimp of a pad: at first touch 0.8 instead of 0.9, the softness of a rubber facing.

Contact constraints leave out the centripetal acceleration of the moving hand, and a pad lets go for
a step once that exceeds its force times (1 - d)/d over the target's mass. With 0.9 this dropped
10 kg at a quarter of what friction holds; with 0.8 a grasp is lost where `grip_load` says.
"""

PAD_DAMPING = 1.7
"""Damping of a pad's contact times the physics step, where MuJoCo's standard format ends at 1/0.95.

A friction constraint has no memory of position: it brakes the sliding speed v by a = -B v. The
centripetal acceleration c of the moving hand is left out of it, so that a held target drifts by
c dt (1 / (B dt) - 1/2): 2 mm a cycle at B dt = 1.05, 0.4 mm at 1.7. At 2 sliding would not decay.
"""

_PAD_SOLREF = (-1.0 / (2 * TIMESTEP) ** 2, -PAD_DAMPING * _PAD_IMPEDANCE[1] / TIMESTEP)
"""MuJoCo's direct format: stiffness [1/s^2] of solref = 2 dt, and the damping above [1/s]."""

_TCP_COLOR = (0.1, 0.8, 0.3, 1.0)


def robot_spec(description: Description, robot: Robot) -> mujoco.MjSpec:
    """Build the MJCF of a robot; see `build_robot`."""
    return build_robot(description, robot)[0]


def build_robot(description: Description, robot: Robot) -> tuple[mujoco.MjSpec, tuple[str, ...]]:
    """Build the MJCF of a robot, and list what was approximated or guessed on the way.

    The root link is the root body. Visual geometry goes to group 2 without contact, collision
    geometry to group 3. Velocity limits, which MJCF cannot express, are kept in the custom numeric
    `joint_velocity_limit` in arm-joint order. Servo gains come from the reflected inertia. Gravity
    compensation of the robot's own links acts through the motors (`actuatorgravcomp`), so that it
    counts against the effort limits.

    Raises:
        BadInput: if MuJoCo refuses the model, with its reason.
    """
    spec = mujoco.MjSpec()
    spec.modelname = description.model.robot.name or "robot"
    spec.compiler.degree = False
    spec.option.timestep = TIMESTEP
    shapes = ShapeBuilder(spec, description.model.robot, description.packages)
    children: dict[str, list[Any]] = {}
    for joint in description.model.robot.joints:
        children.setdefault(joint.parent, []).append(joint)
    links = {link.name: link for link in description.model.robot.links}
    efforts = dict(zip(robot.arm_joints, robot.effort.tolist(), strict=True))
    efforts |= dict.fromkeys((robot.finger_joint, robot.mimic_joint), robot.grip_force)
    try:
        _add_link(spec.worldbody, links[robot.root], None, links, children, shapes)
    except BadInput as error:
        raise BadInput(f"{description.path}: {error}") from error
    for name, effort in efforts.items():
        _limit_effort(spec.joint(name), effort)
    position, quat_wxyz = split_pose(robot.T_palm_tcp)
    spec.body(robot.palm).add_site(
        name="tcp", pos=position, quat=quat_wxyz, size=[0.006] * 3, rgba=_TCP_COLOR, group=4
    )
    for name in (*robot.arm_joints, robot.finger_joint):
        _add_servo(spec, name)
    _couple_fingers(spec, robot)
    notes = [*shapes.notes, *_grip_with_pads(spec, robot)]
    spec.add_numeric(name="joint_velocity_limit", size=6, data=list(robot.velocity))
    try:
        model = spec.compile()
    except (ValueError, mujoco.FatalError) as error:
        reason = " ".join(str(error).split())
        raise BadInput(f"{description.path}: MuJoCo refuses the model: {reason}") from error
    _exclude_touching_at_zero(spec, model)
    _tune(spec, model, robot)
    _add_home(spec, model, robot)
    return spec, tuple(notes)


def _add_home(spec: mujoco.MjSpec, model: mujoco.MjModel, robot: Robot) -> None:
    """Add the keyframe `home`: the zero configuration, gripper open."""
    qpos, ctrl = np.zeros(model.nq), np.zeros(model.nu)
    fingers = (robot.finger_joint, robot.mimic_joint)
    for name, position in zip(fingers, robot.open_positions, strict=True):
        qpos[model.joint(name).qposadr[0]] = position
    ctrl[model.actuator(robot.finger_joint).id] = robot.finger_open
    spec.add_key(name="home", qpos=qpos, ctrl=ctrl)


def _add_link(
    parent: Any,
    link: Any,
    joint: Any,
    links: dict[str, Any],
    children: dict[str, list[Any]],
    shapes: ShapeBuilder,
) -> None:
    """Add one link with its geometry and inertial, then its children."""
    body = parent.add_body(name=link.name, gravcomp=1.0)
    if joint is not None:
        body.pos, body.quat = split_pose(joint.origin)
    if link.inertial is not None:
        origin = np.eye(4) if link.inertial.origin is None else link.inertial.origin
        rotation = origin[:3, :3]
        inertia = rotation @ link.inertial.inertia @ rotation.T
        body.explicitinertial = True
        body.mass = link.inertial.mass
        body.ipos = origin[:3, 3]
        body.fullinertia = [
            inertia[0, 0],
            inertia[1, 1],
            inertia[2, 2],
            inertia[0, 1],
            inertia[0, 2],
            inertia[1, 2],
        ]
    if joint is not None and joint.type != "fixed":
        _add_joint(body, joint)
        if link.visuals and not link.collisions:
            raise BadInput(
                f"link '{link.name}' moves and can be seen but has no <collision>; give it one"
            )
    shapes.add_link(body, link)
    for child in children.get(link.name, []):
        _add_link(body, links[child.child], child, links, children, shapes)


def _add_joint(body: Any, joint: Any) -> None:
    slide = joint.type == "prismatic"
    body.add_joint(
        name=joint.name,
        type=mujoco.mjtJoint.mjJNT_SLIDE if slide else mujoco.mjtJoint.mjJNT_HINGE,
        axis=joint_axis(joint),
        limited=True,
        range=[joint.limit.lower, joint.limit.upper],
        damping=0.0 if joint.dynamics is None else float(joint.dynamics.damping or 0.0),
        frictionloss=0.0 if joint.dynamics is None else float(joint.dynamics.friction or 0.0),
        armature=FINGER_ARMATURE,
        actgravcomp=True,
    )


def _limit_effort(joint: Any, effort: float) -> None:
    """Limit the force of a joint; a turning one gets the rotor that goes with that limit."""
    joint.actfrclimited = True
    joint.actfrcrange = [-effort, effort]
    if joint.type == mujoco.mjtJoint.mjJNT_HINGE:
        joint.armature = effort / ROTOR_ACCELERATION


def _add_servo(spec: mujoco.MjSpec, joint_name: str) -> None:
    """Add a position actuator, force = kp (ctrl - q) - kv qd; gains are set by `_tune`."""
    spec.add_actuator(
        name=joint_name,
        target=joint_name,
        trntype=mujoco.mjtTrn.mjTRN_JOINT,
        gaintype=mujoco.mjtGain.mjGAIN_FIXED,
        biastype=mujoco.mjtBias.mjBIAS_AFFINE,
    )


def _couple_fingers(spec: mujoco.MjSpec, robot: Robot) -> None:
    """Make the second finger follow the driven one, as the jaws of a parallel gripper do."""
    coefficients = np.zeros(mujoco.mjNEQDATA)
    coefficients[:2] = robot.mimic_offset, robot.mimic_multiplier
    spec.add_equality(
        name="finger_coupling",
        type=mujoco.mjtEq.mjEQ_JOINT,
        objtype=mujoco.mjtObj.mjOBJ_JOINT,
        name1=robot.mimic_joint,
        name2=robot.finger_joint,
        data=coefficients,
        solref=[2 * TIMESTEP, 1.0],
    )


def _grip_with_pads(spec: mujoco.MjSpec, robot: Robot) -> list[str]:
    """Give the pads their contact: stiff and well damped, friction 1."""
    notes = []
    for finger in robot.fingers:
        touching = [geom for geom in spec.body(finger).find_all("geom") if geom.group == 3]
        pads = [geom for geom in touching if PAD_MARK in geom.name]
        if not touching:
            raise BadInput(
                f"{robot.path}: link '{finger}' has no gripping surface; give it a <collision>, "
                f"named '...{PAD_MARK}' where it grips"
            )
        if not pads:
            pads = touching
            notes.append(
                f"link '{finger}': no <collision> named '...{PAD_MARK}'; all of the finger grips"
            )
        for pad in pads:
            pad.priority = PAD_PRIORITY
            pad.condim = 4
            pad.friction = _PAD_FRICTION
            pad.solref = _PAD_SOLREF
            pad.solimp = _PAD_IMPEDANCE
    return notes


def _exclude_touching_at_zero(spec: mujoco.MjSpec, model: mujoco.MjModel) -> None:
    """Exclude the pairs of links that touch in the zero configuration (beside parent and child)."""
    data = mujoco.MjData(model)
    mujoco.mj_fwdPosition(model, data)
    bodies = model.geom_bodyid[data.contact.geom] if data.ncon else np.empty((0, 2), dtype=int)
    for first, second in sorted({(int(min(pair)), int(max(pair))) for pair in bodies}):
        names = model.body(first).name, model.body(second).name
        spec.add_exclude(name="--".join(names), bodyname1=names[0], bodyname2=names[1])


def _tune(spec: mujoco.MjSpec, model: mujoco.MjModel, robot: Robot) -> None:
    """Set servo gains from the reflected inertia of each joint.

    M is the largest diagonal entry of the joint-space inertia (armature included) over the
    workspace sampled below; with it the loop is never less than critically damped.
    """
    data = mujoco.MjData(model)
    address = np.array([model.joint(name).qposadr[0] for name in robot.arm_joints])
    dof = np.array([model.joint(name).dofadr[0] for name in robot.arm_joints])
    inertia = np.zeros(6)
    dense = np.empty((model.nv, model.nv))
    rng = np.random.default_rng(0)
    for q in rng.uniform(robot.lower, robot.upper, (64, 6)):
        data.qpos[address] = q
        mujoco.mj_fwdPosition(model, data)
        mujoco.mj_fullM(model, data, dense)
        inertia = np.maximum(inertia, np.diag(dense)[dof])
    for name, mass in zip(robot.arm_joints, inertia, strict=True):
        index = robot.arm_joints.index(name)
        kp, kv = mass * SERVO_BANDWIDTH**2, 2 * mass * SERVO_BANDWIDTH
        lead = kv / kp * robot.velocity[index]
        _set_gains(spec, name, kp, kv, (robot.lower[index] - lead, robot.upper[index] + lead))
    # The jaw's own mass is small beside its armature, so critical damping follows from that.
    kv = 2 * np.sqrt(FINGER_KP * 2 * FINGER_ARMATURE)
    narrow, wide = sorted((robot.finger_open, robot.finger_closed))
    actuator = _set_gains(spec, robot.finger_joint, FINGER_KP, kv, (narrow, wide))
    actuator.forcelimited = True
    actuator.forcerange = [-robot.grip_force, robot.grip_force]


def _set_gains(
    spec: mujoco.MjSpec, name: str, kp: float, kv: float, ctrlrange: tuple[float, float]
) -> Any:
    actuator = spec.actuator(name)
    actuator.gainprm[0] = kp
    actuator.biasprm[:3] = [0.0, -kp, -kv]
    actuator.ctrllimited = True
    actuator.ctrlrange = list(ctrlrange)
    return actuator
