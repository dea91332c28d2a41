"""URDF model -> MjSpec of the robot: bodies, geometry, servo actuators, TCP site, home keyframe."""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np

from kr210_sim.arrays import Array
from kr210_sim.description import Description
from kr210_sim.exceptions import BadInput
from kr210_sim.robot import TCP_LINK, Robot

TIMESTEP = 0.0005
"""Physics step [s]: Euler at 0.5 ms reports actuator forces honestly and keeps the grasp."""

SERVO_BANDWIDTH = 200.0
"""Natural frequency w of the joint servos [rad/s]; kp = M w^2, kv = 2 M w (critical damping)."""

ROTOR_ACCELERATION = 180.0
"""Effort limit over reflected rotor inertia [rad/s^2], from which the armature follows.

Geared servo drives of this class bring their own rotor to full speed in about 10 to 20 ms.
"""

FINGER_KP = 1e5  # [N/m]
FINGER_ARMATURE = 10.0  # [kg], spindle and motor seen by the jaw

PAD_MARK = "_pad"
"""Collision elements of a finger whose name contains this are the gripping surfaces."""

_PAD_FRICTION = (1.0, 0.005, 0.0001)
_STATIC_GEOM = {"contype": 0, "conaffinity": 0, "group": 2}


def robot_spec(description: Description, robot: Robot) -> mujoco.MjSpec:
    """Build the MJCF of a robot.

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
    materials = _add_materials(spec, description.model.robot)
    children: dict[str, list[Any]] = {}
    for joint in description.model.robot.joints:
        children.setdefault(joint.parent, []).append(joint)
    links = {link.name: link for link in description.model.robot.links}
    try:
        _add_link(spec.worldbody, links[robot.root], None, links, children, materials)
    except BadInput as error:
        raise BadInput(f"{description.path}: {error}") from error
    for name in (*robot.arm_joints, robot.finger_joint):
        _add_servo(spec, name)
    _couple_fingers(spec, description, robot)
    _grip_with_pads(spec, robot)
    spec.add_numeric(name="joint_velocity_limit", size=6, data=list(robot.velocity))
    try:
        _exclude_touching_at_zero(spec)
        _tune(spec, robot)
        model = spec.compile()
    except (ValueError, mujoco.FatalError) as error:
        reason = " ".join(str(error).split())
        raise BadInput(f"{description.path}: MuJoCo refuses the model: {reason}") from error
    _add_home(spec, model, robot)
    return spec


def _add_home(spec: mujoco.MjSpec, model: mujoco.MjModel, robot: Robot) -> None:
    """Add the keyframe `home`: the zero configuration, gripper open."""
    qpos, ctrl = np.zeros(model.nq), np.zeros(model.nu)
    for name in (robot.finger_joint, robot.mimic_joint):
        qpos[model.joint(name).qposadr[0]] = robot.finger_open
    ctrl[model.actuator(robot.finger_joint).id] = robot.finger_open
    spec.add_key(name="home", qpos=qpos, ctrl=ctrl)


def _add_materials(spec: mujoco.MjSpec, urdf: Any) -> dict[str, str]:
    """Add the named URDF colours; return material name by URDF material name."""
    named = {material.name: material for material in urdf.materials if material.color is not None}
    for link in urdf.links:
        for visual in link.visuals:
            material = visual.material
            if material is not None and material.name and material.color is not None:
                named.setdefault(material.name, material)
    for name, material in named.items():
        spec.add_material(name=name, rgba=material.color.rgba, specular=0.3, shininess=0.4)
    return {name: name for name in named}


def _add_link(
    parent: Any,
    link: Any,
    joint: Any,
    links: dict[str, Any],
    children: dict[str, list[Any]],
    materials: dict[str, str],
) -> None:
    """Add one link with its geometry and inertial, then its children."""
    body = parent.add_body(name=link.name, gravcomp=1.0)
    if joint is not None and joint.origin is not None:
        body.pos, body.quat = _pose(joint.origin)
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
    for index, visual in enumerate(link.visuals):
        name = visual.name or f"{link.name}_visual_{index}"
        geom = _add_geom(body, name, visual, density=0.0, **_STATIC_GEOM)
        if visual.material is not None and visual.material.name in materials:
            geom.material = materials[visual.material.name]
    for index, collision in enumerate(link.collisions):
        name = collision.name or f"{link.name}_collision_{index}"
        _add_geom(body, name, collision, density=0.0, group=3)
    if link.name == TCP_LINK:
        body.add_site(name="tcp", size=[0.006] * 3, rgba=[0.1, 0.8, 0.3, 1], group=4)
    for child in children.get(link.name, []):
        _add_link(body, links[child.child], child, links, children, materials)


def _pose(T: Array) -> tuple[Array, Array]:
    """Split a (4, 4) transform into position (3,) and quat_wxyz (4,)."""
    quat_wxyz = np.empty(4)
    mujoco.mju_mat2Quat(quat_wxyz, np.ascontiguousarray(T[:3, :3]).ravel())
    return np.array(T[:3, 3]), quat_wxyz


def _add_joint(body: Any, joint: Any) -> None:
    slide = joint.type == "prismatic"
    limited = joint.type != "continuous"
    effort = float(joint.limit.effort)
    body.add_joint(
        name=joint.name,
        type=mujoco.mjtJoint.mjJNT_SLIDE if slide else mujoco.mjtJoint.mjJNT_HINGE,
        axis=joint.axis,
        limited=limited,
        range=[joint.limit.lower, joint.limit.upper] if limited else [0.0, 0.0],
        damping=0.0 if joint.dynamics is None else float(joint.dynamics.damping or 0.0),
        frictionloss=0.0 if joint.dynamics is None else float(joint.dynamics.friction or 0.0),
        armature=FINGER_ARMATURE if slide else effort / ROTOR_ACCELERATION,
        actfrclimited=True,
        actfrcrange=[-effort, effort],
        actgravcomp=True,
    )


def _add_geom(body: Any, name: str, element: Any, **options: Any) -> Any:
    shape = element.geometry
    types = mujoco.mjtGeom
    if shape.box is not None:
        options |= {"type": types.mjGEOM_BOX, "size": np.asarray(shape.box.size) / 2}
    elif shape.cylinder is not None:
        size = [shape.cylinder.radius, shape.cylinder.length / 2, 0]
        options |= {"type": types.mjGEOM_CYLINDER, "size": size}
    elif shape.sphere is not None:
        options |= {"type": types.mjGEOM_SPHERE, "size": [shape.sphere.radius, 0, 0]}
    else:
        raise BadInput(f"geometry '{name}' is a mesh; use box, cylinder or sphere")
    position, quat_wxyz = _pose(np.eye(4) if element.origin is None else element.origin)
    return body.add_geom(name=name, pos=position, quat=quat_wxyz, **options)


def _add_servo(spec: mujoco.MjSpec, joint_name: str) -> None:
    """Add a position actuator, force = kp (ctrl - q) - kv qd; gains are set by `_tune`."""
    spec.add_actuator(
        name=joint_name,
        target=joint_name,
        trntype=mujoco.mjtTrn.mjTRN_JOINT,
        gaintype=mujoco.mjtGain.mjGAIN_FIXED,
        biastype=mujoco.mjtBias.mjBIAS_AFFINE,
    )


def _couple_fingers(spec: mujoco.MjSpec, description: Description, robot: Robot) -> None:
    """Make the second finger follow the driven one, as the jaws of a parallel gripper do."""
    mimic = next(
        joint.mimic for joint in description.model.robot.joints if joint.name == robot.mimic_joint
    )
    coefficients = np.zeros(mujoco.mjNEQDATA)
    coefficients[0] = mimic.offset or 0.0
    coefficients[1] = 1.0 if mimic.multiplier is None else mimic.multiplier
    spec.add_equality(
        name="finger_coupling",
        type=mujoco.mjtEq.mjEQ_JOINT,
        objtype=mujoco.mjtObj.mjOBJ_JOINT,
        name1=robot.mimic_joint,
        name2=robot.finger_joint,
        data=coefficients,
        solref=[2 * TIMESTEP, 1.0],
    )


def _grip_with_pads(spec: mujoco.MjSpec, robot: Robot) -> None:
    """Give the pads their contact: stiff (what holds a target is solref = 2 dt), friction 1."""
    for finger in robot.fingers:
        pads = [geom for geom in spec.body(finger).geoms if PAD_MARK in geom.name]
        if not pads:
            raise BadInput(
                f"{robot.path}: link '{finger}' has no gripping surface; name a <collision> of it "
                f"'...{PAD_MARK}'"
            )
        for pad in pads:
            pad.priority = 1
            pad.condim = 4
            pad.friction = _PAD_FRICTION
            pad.solref = [2 * TIMESTEP, 1.0]


def _exclude_touching_at_zero(spec: mujoco.MjSpec) -> None:
    """Exclude the pairs of links that touch in the zero configuration (beside parent and child)."""
    model = spec.compile()
    data = mujoco.MjData(model)
    mujoco.mj_fwdPosition(model, data)
    bodies = model.geom_bodyid[data.contact.geom] if data.ncon else np.empty((0, 2), dtype=int)
    for first, second in sorted({(int(min(pair)), int(max(pair))) for pair in bodies}):
        names = model.body(first).name, model.body(second).name
        spec.add_exclude(name="--".join(names), bodyname1=names[0], bodyname2=names[1])


def _tune(spec: mujoco.MjSpec, robot: Robot) -> None:
    """Set servo gains from the reflected inertia of each joint.

    M is the largest diagonal entry of the joint-space inertia (armature included) over the
    workspace sampled below; with it the loop is never less than critically damped.
    """
    model = spec.compile()
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
    actuator = _set_gains(
        spec, robot.finger_joint, FINGER_KP, kv, (robot.finger_open, robot.finger_closed)
    )
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
