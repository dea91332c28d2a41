"""The peers that `benchmarks/ik.py` compares with, each brought to the KR210 and to one interface.

Each loader raises ImportError where its library is not installed. What a library wants otherwise
than the URDF says it (axes, offsets, a transposed rotation) is done here and said here.
"""

from __future__ import annotations

import importlib
import subprocess
import sys
import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np

LOWER = np.deg2rad([-185, -45, -210, -350, -125, -350])
UPPER = np.deg2rad([185, 85, 65, 350, 125, 350])
VELOCITY = np.deg2rad([123, 115, 112, 179, 172, 219])
# the chain of the description: origin and axis of each joint, then the tool
ORIGINS = [
    (0, 0, 0.33),
    (0.35, 0, 0.42),
    (0, 0, 1.25),
    (0.96, 0, -0.054),
    (0.54, 0, 0),
    (0.193, 0, 0),
    (0.11, 0, 0),
]
AXES = [(0, 0, 1), (0, 1, 0), (0, 1, 0), (1, 0, 0), (0, 1, 0), (1, 0, 0)]
Solve = Callable[[np.ndarray], Any]


@dataclass(frozen=True)
class Solver:
    """One library in one mode."""

    name: str
    single: Solve | None = None
    """Called with one pose (4, 4), as the library's user would."""
    batch: Solve | None = None
    """Called with poses (n, 4, 4), or what `prepare` makes of them."""
    answers: Solve | None = None
    """All solutions of one pose, as rows (k, 6); for the accuracy."""
    prepare: Solve | None = None
    """Brings poses into the form the batch call wants, if that is another; not timed."""


def eaik() -> list[Solver]:
    """EAIK, C++: its raw binding."""
    binding = importlib.import_module("eaik.pybindings.EAIK")
    robot = binding.Robot(np.array(AXES, float).T, np.array(ORIGINS).T, np.eye(3), [], True)

    def answers(T: np.ndarray) -> np.ndarray:
        found = robot.calculate_IK(T)
        exact = [q for q, least in zip(found.Q, found.is_LS, strict=True) if not least]
        return np.reshape(exact, (-1, 6))

    return [
        Solver(
            f"EAIK {version('eaik')}",
            robot.calculate_IK,
            lambda poses: robot.calculate_IK_batched(poses, 1),
            answers,
            list,
        )
    ]


def opw() -> list[Solver]:
    """py-opw-kinematics, Rust: `inverse` for one pose, `reach` for many."""
    module = importlib.import_module("py_opw_kinematics")
    model = module.KinematicModel(
        a1=0.35,
        a2=0.054,
        b=0,
        c1=0.75,
        c2=1.25,
        c3=1.5,
        c4=0.303,
        offsets=(0, 0, -np.pi / 2, 0, 0, 0),
    )
    robot = module.Robot(model, degrees=False)
    to_tool = np.array([[0, 0, -1, 0], [0, 1, 0, 0], [1, 0, 0, 0], [0, 0, 0, 1.0]])
    transform = module.RigidTransform.from_matrix
    tool = transform(to_tool)
    nowhere = np.tile([10.0, 11.0], (6, 1))  # outside of its limits it leaves sigma_min out
    name = f"py-opw {version('py-opw-kinematics')}"
    return [
        Solver(
            f"{name} reach",
            None,
            lambda T: robot.reach(T, ee_transform=tool),
            lambda T: (q := robot.reach(transform(T[None]), ee_transform=tool).joints[0])[
                ~np.isnan(q[:, 0])
            ],
            transform,
        ),
        Solver(
            f"{name} reach, no sigma_min",
            None,
            lambda T: robot.reach(T, nowhere, ee_transform=tool),
            None,
            transform,
        ),
        Solver(f"{name} inverse", lambda T: robot.inverse(transform(T), ee_transform=tool)),
        Solver(
            f"{name} raw binding",
            lambda T: robot._robot.inverse(T, None, to_tool),
        ),
    ]


def ik_geo() -> list[Solver]:
    """ik-geo, Rust; wants the wrist center as origin of axes 4 to 6, and R transposed."""
    module = importlib.import_module("ik_geo")
    points = [(0, 0, 0.75), (0.35, 0, 0), (0, 0, 1.25), (1.5, 0, -0.054), (0,) * 3, (0,) * 3]
    robot = module.Robot.spherical_two_parallel(
        np.array(AXES, float), np.array([*points, (0.303, 0, 0)], float)
    )

    def single(T: np.ndarray) -> Any:
        return robot.get_ik(T[:3, :3].T.copy(), T[:3, 3].copy())

    def answers(T: np.ndarray) -> np.ndarray:
        return np.reshape([q for q, least in single(T) if not least], (-1, 6))

    return [Solver(f"ik-geo {version('ik-geo')}", single, None, answers)]


def ssik() -> list[Solver]:
    """ssik: the artifact it builds from a URDF, with limits and turns (default) and without."""
    importlib.import_module("ssik")
    with tempfile.TemporaryDirectory() as folder:
        urdf = Path(folder) / "kr210.urdf"
        urdf.write_text(description())
        subprocess.run(
            [Path(sys.executable).parent / "ssik", "build", urdf, "--base", "l0", "--ee", "l7"],
            cwd=folder,
            check=True,
            capture_output=True,
        )
        sys.path.insert(0, folder)
        module = importlib.import_module("kr210_ik")
        sys.path.remove(folder)
    name = f"ssik {version('ssik')}"

    def raw(T: np.ndarray) -> Any:
        return module.solve(T, respect_limits=False, enumerate_windings=False)

    return [
        Solver(f"{name}, default (limits, turns)", module.solve),
        Solver(f"{name}, raw", raw, None, lambda T: np.reshape([s.q for s in raw(T)], (-1, 6))),
    ]


def description() -> str:
    """The arm as a URDF."""
    joints = []
    for i, origin in enumerate(ORIGINS):
        kind = "revolute" if i < 6 else "fixed"
        axis = AXES[i] if i < 6 else (1, 0, 0)
        low, high = (LOWER[i], UPPER[i]) if i < 6 else (0, 0)
        joints.append(
            f'<link name="l{i}"/><joint name="j{i}" type="{kind}"><parent link="l{i}"/>'
            f'<child link="l{i + 1}"/><origin xyz="{" ".join(map(str, origin))}" rpy="0 0 0"/>'
            f'<axis xyz="{" ".join(map(str, axis))}"/><limit lower="{low}" upper="{high}" '
            f'velocity="2" effort="300"/></joint>'
        )
    return f'<robot name="kr210">{"".join(joints)}<link name="l7"/></robot>'


def load_mink() -> tuple[str, Callable[[np.ndarray], np.ndarray]]:
    """mink, differential IK on MuJoCo: 200 steps from the zero configuration, no restarts."""
    mink, mujoco = importlib.import_module("mink"), importlib.import_module("mujoco")
    body, end = "", ""
    for i, origin in enumerate(ORIGINS[:6]):
        body += (
            f'<body pos="{" ".join(map(str, origin))}"><joint axis="{" ".join(map(str, AXES[i]))}" '
            f'range="{LOWER[i]} {UPPER[i]}" limited="true"/><geom size="0.05" mass="1"/>'
        )
        end += "</body>"
    model = mujoco.MjModel.from_xml_string(
        f'<mujoco><compiler angle="radian"/><worldbody>{body}'
        f'<site name="tool" pos="0.11 0 0"/>{end}</worldbody></mujoco>'
    )
    limits = [mink.ConfigurationLimit(model)]
    task = mink.FrameTask("tool", "site", 1.0, 1.0, lm_damping=1e-3)

    def solve(T: np.ndarray) -> np.ndarray:
        configuration = mink.Configuration(model, np.zeros(6))
        task.set_target(mink.SE3.from_matrix(T))
        for _ in range(200):
            error = np.linalg.norm(task.compute_error(configuration))
            if error < 1e-6:
                return configuration.q.copy()
            step = mink.solve_ik(configuration, [task], 1.0, "daqp", limits=limits)
            configuration.integrate_inplace(step, 1.0)
        return np.full(6, np.nan)

    return f"mink {version('mink')}", solve


def load_peers() -> tuple[list[Solver], list[str]]:
    """Return the analytic peers that are installed, and say which are not."""
    solvers, missing = [], []
    for load in (eaik, opw, ik_geo, ssik):
        try:
            solvers += load()
        except ImportError as error:
            missing.append(f"{load.__name__} ({error})")
    return solvers, missing
