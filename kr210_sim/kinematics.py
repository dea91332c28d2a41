"""What the verbs `ik` and `dh` say about a robot, as data and as text."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

import ik
from kr210_sim.arrays import Array
from kr210_sim.exceptions import BadInput
from kr210_sim.robot import Robot

_SHOULDER, _ELBOW, _WRIST = ("front", "back"), ("up", "down"), ("+", "-")


def read_pose(
    *,
    position: list[float] | None,
    quaternion: list[float] | None,
    rpy: list[float] | None,
    pose: str | None,
) -> Array:
    """Read T_base_palm (4, 4) from what the command line gives.

    Args:
        position: x, y, z [m].
        quaternion: x, y, z, w; normalised here.
        rpy: roll, pitch, yaw [rad] about the fixed x, y and z axes.
        pose: the matrix as JSON instead, or a file that holds it.

    Raises:
        BadInput: naming the option and the remedy.
    """
    if pose is not None:
        if position or quaternion or rpy:
            raise BadInput("--pose: give either the matrix or position and orientation, not both")
        return _read_matrix(pose)
    if position is None:
        raise BadInput("--position: is missing; give X Y Z in metres, or --pose MATRIX")
    if quaternion and rpy:
        raise BadInput("--rpy: give either --quaternion or --rpy, not both")
    T = np.eye(4)
    T[:3, 3] = _finite("--position", position)
    if quaternion:
        quat_xyzw = _finite("--quaternion", quaternion)
        if not 1e-6 < np.max(np.abs(quat_xyzw)) < 1e6:
            raise BadInput("--quaternion: is zero or huge; give X Y Z W of about unit length")
        T[:3, :3] = Rotation.from_quat(quat_xyzw).as_matrix()
    elif rpy:
        T[:3, :3] = Rotation.from_euler("xyz", _finite("--rpy", rpy)).as_matrix()
    return T


def _finite(option: str, values: list[float]) -> Array:
    array = np.array(values, dtype=float)
    if not np.all(np.isfinite(array)):
        raise BadInput(f"{option}: {values} must be finite numbers")
    return array


def _read_matrix(text: str) -> Array:
    try:
        content = text if text.lstrip().startswith("[") else Path(text).read_text(encoding="utf-8")
        rows = json.loads(content)
        if not all(type(number) in (int, float) for row in rows for number in row):
            raise TypeError("it must hold numbers only")
        T = np.array(rows, dtype=float)
        ik.check_poses(T)
    except OSError as error:
        raise BadInput(
            f"--pose: '{text[:60]}' is no matrix [[...], ...], and no file that can be read "
            f"({error.strerror})"
        ) from error
    except (ValueError, TypeError, RecursionError, OverflowError) as error:
        reason = " ".join(str(error).split())
        raise BadInput(f"--pose: no 4 x 4 rigid transform as JSON: {reason}") from error
    if T.shape != (4, 4):
        raise BadInput(f"--pose: the matrix has shape {T.shape}; give 4 x 4")
    return T


def solve_report(robot: Robot, T_base_palm: Array) -> dict[str, Any]:
    """Solve one pose and describe every branch.

    Args:
        robot: the arm with its limits.
        T_base_palm: (4, 4).
    """
    arm = robot.geometry
    solutions = ik.inverse(arm, T_base_palm, (robot.lower, robot.upper))
    branches = []
    for index, (q, valid) in enumerate(zip(solutions.q, solutions.valid, strict=True)):
        name = (_SHOULDER[index // 4], _ELBOW[index // 2 % 2], _WRIST[index % 2])
        branch: dict[str, Any] = dict(zip(("shoulder", "elbow", "wrist"), name, strict=True))
        branch["exists"] = bool(valid)
        if valid:
            reached = ik.forward(arm, q)
            chord = np.linalg.norm(reached[:3, :3] - T_base_palm[:3, :3]) / np.sqrt(8.0)
            copies = ik.turns(q, robot.lower, robot.upper).q
            branch |= {
                "q_rad": q.tolist(),
                "within_limits": bool(solutions.in_limits[index]),
                "configurations_within_limits": len(copies),
                "residual_m": float(np.linalg.norm(reached[:3, 3] - T_base_palm[:3, 3])),
                "residual_rad": float(2 * np.arcsin(min(1.0, chord))),
                "singularity_distance": dict(
                    zip(
                        ("shoulder", "elbow", "wrist"),
                        ik.singularity_distances(arm, q).tolist(),
                        strict=True,
                    )
                ),
            }
        branches.append(branch)
    return {
        "frame": f"{robot.root} to {robot.palm}",
        "T_base_palm": T_base_palm.tolist(),
        "wrist_center_m": wrist_center_of_pose(robot, T_base_palm).tolist(),
        "branches": branches,
    }


def wrist_center_of_pose(robot: Robot, T_base_palm: Array) -> Array:
    """Return where the wrist center is (3,) when the palm is at a pose (4, 4), base frame [m]."""
    T_wrist_palm = robot.geometry.T_tool
    return np.asarray((T_base_palm @ np.linalg.inv(T_wrist_palm))[:3, 3])


def solve_text(report: dict[str, Any]) -> str:
    """Return the report of `solve_report` as a table."""
    x, y, z = report["wrist_center_m"]
    lines = [
        f"pose of {report['frame']}; wrist center {x:.5f} {y:.5f} {z:.5f} m",
        f"{'branch':<16}{'q1':>9}{'q2':>9}{'q3':>9}{'q4':>9}{'q5':>9}{'q6':>9}  deg   limits  turns"
        "  residual m  rad      to singularity",
    ]
    for branch in report["branches"]:
        name = f"{branch['shoulder']} {branch['elbow']} {branch['wrist']}"
        if not branch["exists"]:
            lines.append(f"{name:<16}out of reach")
            continue
        angles = "".join(f"{np.degrees(q):9.3f}" for q in branch["q_rad"])
        inside = "inside" if branch["within_limits"] else "BEYOND"
        kind, distance = min(branch["singularity_distance"].items(), key=lambda item: item[1])
        lines.append(
            f"{name:<16}{angles}        {inside}{branch['configurations_within_limits']:>6}"
            f"   {branch['residual_m']:.1e}  {branch['residual_rad']:.1e}  {kind} {distance:.4f}"
        )
    lines.append("branch: shoulder to the front or back, elbow up or down, sign of theta 5")
    lines.append("turns: configurations within limits, whole turns counted")
    return "\n".join(lines)


def dh_report(robot: Robot) -> dict[str, Any]:
    """Describe the chain of a robot: its joint table and the modified DH table derived from it."""
    chain = robot.chain
    table = ik.dh_from_chain(chain.origins, chain.axes, chain.T_last_palm)
    joints = [
        {
            "joint": name,
            "origin_m": origin[:3, 3].tolist(),
            "rpy_rad": Rotation.from_matrix(origin[:3, :3]).as_euler("xyz").tolist(),
            "axis": axis.tolist(),
            "lower_rad": float(robot.lower[index]),
            "upper_rad": float(robot.upper[index]),
        }
        for index, (name, origin, axis) in enumerate(
            zip(robot.arm_joints, chain.origins, chain.axes, strict=True)
        )
    ]
    rows = [
        {
            "i": index + 1,
            "alpha_rad": float(table.alpha[index]),
            "a_m": float(table.a[index]),
            "d_m": float(table.d[index]),
            "theta_rad": float(table.theta[index]),
            "joint": robot.arm_joints[index] if index < len(robot.arm_joints) else None,
        }
        for index in range(len(table.alpha))
    ]
    return {
        "robot": str(robot.path),
        "joints": joints,
        "modified_dh": rows,
        "T_base_0": table.T_base.tolist(),
        "T_7_palm": table.T_tool.tolist(),
        "transforms_at_zero": table.transforms(np.zeros(6)).tolist(),
    }


def dh_text(report: dict[str, Any]) -> str:
    """Return the report of `dh_report` as tables."""
    lines = [
        "joint origins and axes, parent frame to joint (fixed joints folded in)",
        f"{'joint':<12}{'x':>9}{'y':>9}{'z':>9}{'roll':>9}{'pitch':>9}{'yaw':>9}   axis"
        f"{'lower':>15}{'upper':>9} deg",
    ]
    for joint in report["joints"]:
        origin = "".join(f"{value:9.4f}" for value in joint["origin_m"])
        angles = "".join(f"{value:9.4f}" for value in joint["rpy_rad"])
        axis = " ".join(f"{value:g}" for value in joint["axis"])
        lower, upper = np.degrees(joint["lower_rad"]), np.degrees(joint["upper_rad"])
        lines.append(f"{joint['joint']:<12}{origin}{angles}   {axis:<10}{lower:9.1f}{upper:9.1f}")
    lines += [
        "",
        "modified DH (Craig): T_i-1,i = Rx(alpha_i-1) Tx(a_i-1) Rz(theta_i) Tz(d_i)",
        f"{'i':>2}{'alpha_i-1':>12}{'a_i-1 m':>10}{'d_i m':>10}   theta_i",
    ]
    for row in report["modified_dh"]:
        turning = "" if row["joint"] is None else f"q{row['i']}"
        theta = _sum(turning, row["theta_rad"])
        lines.append(
            f"{row['i']:>2}{_angle(row['alpha_rad']):>12}{row['a_m']:>10.4g}{row['d_m']:>10.4g}"
            f"   {theta}"
        )
    lines += ["", "T_base_0", _matrix(report["T_base_0"])]
    for index, T in enumerate(report["transforms_at_zero"], start=1):
        lines += [f"T_{index - 1}_{index} at q = 0", _matrix(T)]
    lines += [f"T_{len(report['modified_dh'])}_palm", _matrix(report["T_7_palm"])]
    return "\n".join(lines)


def dh_symbols(robot: Robot) -> str:
    """Return each transform of the DH table, and the tool pose, as formulas.

    Raises:
        BadInput: if sympy is not installed.
    """
    chain = robot.chain
    table = ik.dh_from_chain(chain.origins, chain.axes, chain.T_last_palm)
    try:
        formulas = [*ik.dh_formulas(table), ik.pose_formula()]
    except ModuleNotFoundError as error:
        raise BadInput(f"--symbolic: {error}") from error
    count = len(table.alpha)
    names = ["T_base_0", *(f"T_{i}_{i + 1}" for i in range(count)), f"T_{count}_palm"]
    names.append("T_base_palm from the pose (px py pz roll pitch yaw) alone")
    blocks = [
        f"{name}\n" + "\n".join(f"  {matrix.row(i).tolist()[0]}" for i in range(4))
        for name, matrix in zip(names, formulas, strict=True)
    ]
    return "\n".join(blocks)


def _angle(value: float) -> str:
    """Write an angle as a multiple of pi/2 where it is one."""
    quarter = round(value / (np.pi / 2))
    if abs(value - quarter * np.pi / 2) > 1e-9:
        return f"{value:.6f}"
    names = {0: "0", 1: "pi/2", -1: "-pi/2", 2: "pi", -2: "-pi"}
    return names.get(quarter, f"{quarter} pi/2")


def _sum(first: str, angle: float) -> str:
    if not first:
        return _angle(angle)
    if abs(angle) < 1e-9:
        return first
    return f"{first} {'-' if angle < 0 else '+'} {_angle(abs(angle))}"


def _matrix(T: list[list[float]]) -> str:
    return "\n".join("  " + "".join(f"{round(value, 5) + 0.0:10.5f}" for value in row) for row in T)
