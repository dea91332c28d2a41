"""Without any formula for the angles: Newton's way from where the arm stands, pose after pose.

kr210-sim grade examples/solutions/numeric_ik.py:solve
"""

import numpy as np

# Each joint: where it sits in the frame of the one before [m], and its axis.
OFFSETS = [
    (0.0, 0.0, 0.33), (0.35, 0.0, 0.42), (0.0, 0.0, 1.25),
    (0.96, 0.0, -0.054), (0.54, 0.0, 0.0), (0.193, 0.0, 0.0),
]  # fmt: skip
AXES = "zyyxyx"
GRIPPER = (0.11, 0.0, 0.0)

TOLERANCE = 1e-11  # error at which a pose counts as reached, [m] and [rad] together
STEPS = 200
LONGEST = 0.2  # of a step [rad]


def about(axis, angle):
    """Rotation matrix about x, y or z."""
    c, s = np.cos(angle), np.sin(angle)
    return np.array(
        {
            "x": [[1, 0, 0], [0, c, -s], [0, s, c]],
            "y": [[c, 0, s], [0, 1, 0], [-s, 0, c]],
            "z": [[c, -s, 0], [s, c, 0], [0, 0, 1]],
        }[axis]
    )


def forward(q):
    """Position and rotation of the gripper, and the place and direction of every axis."""
    p, R = np.zeros(3), np.eye(3)
    places, directions = [], []
    for offset, axis, angle in zip(OFFSETS, AXES, q, strict=True):
        p = p + R @ offset
        places.append(p)
        directions.append(R[:, "xyz".index(axis)])
        R = R @ about(axis, angle)
    return p + R @ GRIPPER, R, np.array(places), np.array(directions)


def error_to(T, p, R):
    """What is missing to a pose: a translation and a rotation vector."""
    turn = T[:3, :3] @ R.T
    axis = np.array([turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0], turn[1, 0] - turn[0, 1]])
    sine = np.linalg.norm(axis) / 2
    angle = np.arctan2(sine, (np.trace(turn) - 1) / 2)
    return np.concatenate([T[:3, 3] - p, axis * (angle / (2 * sine) if sine > 1e-12 else 0.5)])


def solve_one(T, q):
    """Joint angles of a pose near those given, or a row of NaN."""
    for _ in range(STEPS):
        p, R, places, directions = forward(q)
        error = error_to(T, p, R)
        size = np.linalg.norm(error)
        if size < TOLERANCE:
            return q
        jacobian = np.vstack([np.cross(directions, p - places).T, directions.T])
        # damping keeps the step finite where the wrist is stretched
        damped = jacobian.T @ jacobian + 1e-3 * size**2 * np.eye(6)
        step = np.linalg.solve(damped + 1e-12 * np.eye(6), jacobian.T @ error)
        q = q + step * min(1.0, LONGEST / max(np.max(np.abs(step)), 1e-12))
    return np.full(6, np.nan)


def solve(T_base_gripper_link, q_start):
    """Joint angles (N, 6) of poses (N, 4, 4), starting where the arm stands."""
    q, answers = q_start, []
    for T in T_base_gripper_link:
        answer = solve_one(T, q)
        answers.append(answer)
        q = q if np.isnan(answer).any() else answer
    return np.array(answers)
