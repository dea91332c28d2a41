"""The exercises of the course, solved: one function for each step of docs/course.

kr210-sim grade examples/course/solution.py --step all
kr210-sim grade examples/course/solution.py

Lengths in m, angles in rad, frames as the pages name them.
"""

import itertools
from math import atan2, cos, hypot, pi, sin, sqrt

import numpy as np

LOWER = np.radians([-185, -45, -210, -350, -125, -350])  # joint limits
UPPER = np.radians([185, 85, 65, 350, 125, 350])
D1, A1, A2, A3, D4, D7 = 0.75, 0.35, 1.25, -0.054, 1.5, 0.303  # of the DH table
FOREARM, SAG = hypot(D4, A3), atan2(-A3, D4)  # from axis 3 to the wrist center


# ---- page 1 ---------------------------------------------------------------------------------


def joint_table():
    """Origin in the parent and axis of joint_1 to joint_6, and of gripper_joint."""
    return [
        (0.00, 0, 0.330, 0, 0, 1),
        (0.35, 0, 0.420, 0, 1, 0),
        (0.00, 0, 1.250, 0, 1, 0),
        (0.96, 0, -0.054, 1, 0, 0),
        (0.54, 0, 0.000, 0, 1, 0),
        (0.193, 0, 0.00, 1, 0, 0),
        (0.11, 0, 0.000, 0, 0, 0),
    ]


# ---- page 2 ---------------------------------------------------------------------------------


def dh_table():
    """Rows alpha_(i-1), a_(i-1), d_i, theta_i at q = 0."""
    return [
        (0, 0, D1, 0),
        (-pi / 2, A1, 0, -pi / 2),
        (0, A2, 0, 0),
        (-pi / 2, A3, D4, 0),
        (pi / 2, 0, 0, 0),
        (-pi / 2, 0, 0, 0),
        (0, 0, D7, 0),
    ]


# ---- page 3 ---------------------------------------------------------------------------------


def transform(alpha, a, d, theta):
    """T_(i-1)_i = Rx(alpha) Tx(a) Rz(theta) Tz(d)."""
    ca, sa, ct, st = cos(alpha), sin(alpha), cos(theta), sin(theta)
    return np.array(
        [
            [ct, -st, 0, a],
            [st * ca, ct * ca, -sa, -sa * d],
            [st * sa, ct * sa, ca, ca * d],
            [0, 0, 0, 1],
        ]
    )


def total_transform(q):
    """T_0_7 of six joint angles; the seventh row does not turn."""
    T = np.eye(4)
    for (alpha, a, d, theta), angle in zip(dh_table(), [*q, 0.0], strict=True):
        T = T @ transform(alpha, a, d, theta + angle)
    return T


# ---- page 4 ---------------------------------------------------------------------------------


def rotation(quaternion_xyzw):
    """Rotation matrix of a quaternion."""
    x, y, z, w = np.array(quaternion_xyzw) / np.linalg.norm(quaternion_xyzw)
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
    )


def dh_pose(T_0_gripper):
    """T_0_7: z takes the place of x, x that of z, and y turns round."""
    correction = np.array([[0, 0, 1, 0], [0, -1, 0, 0], [1, 0, 0, 0], [0, 0, 0, 1]])
    return T_0_gripper @ correction


# ---- page 5 ---------------------------------------------------------------------------------


def wrist_center(T_0_7):
    """Back from the gripper along z_7."""
    return T_0_7[:3, 3] - D7 * T_0_7[:3, 2]


# ---- page 6 ---------------------------------------------------------------------------------


def arm_angles(center, front, elbow):
    """Theta 1 to 3 with axis 1 facing the center (front = 1) or not (-1), elbow up (1) or down."""
    x, y, z = center
    theta1 = atan2(front * y, front * x)
    along, up = front * hypot(x, y) - A1, z - D1
    reach = hypot(along, up)
    B = corner(reach, A2, FOREARM)
    A = corner(FOREARM, A2, reach)
    theta2 = pi / 2 - atan2(up, along) - elbow * A
    theta3 = -pi / 2 - SAG + elbow * (pi - B)
    return theta1, theta2, theta3


def corner(opposite, one, other):
    """Angle of a triangle from its three sides, the first one opposite."""
    cosine = (one**2 + other**2 - opposite**2) / (2 * one * other)
    return np.arccos(np.clip(cosine, -1, 1))


def first_three(center):
    """Theta 1 to 3: facing the wrist center, elbow up."""
    return arm_angles(center, 1, 1)


# ---- page 7 ---------------------------------------------------------------------------------


def last_three(theta1, theta2, theta3, T_0_7):
    """Theta 4 to 6 of R3_6 = R0_3^T R0_6, theta 5 not negative."""
    R0_3 = np.eye(3)
    for (alpha, a, d, theta), angle in zip(dh_table(), (theta1, theta2, theta3), strict=False):
        R0_3 = R0_3 @ transform(alpha, a, d, theta + angle)[:3, :3]
    R = R0_3.T @ T_0_7[:3, :3]
    theta5 = atan2(hypot(R[0, 2], R[2, 2]), R[1, 2])
    if sin(theta5) < 1e-9:  # only the sum or the difference of the others is given
        return 0.0, theta5, atan2(-R[0, 1], R[0, 0])
    theta4 = atan2(R[2, 2], -R[0, 2])
    theta6 = atan2(-R[1, 1], R[1, 0])
    return theta4, theta5, theta6


# ---- page 8 ---------------------------------------------------------------------------------


def all_branches(T_0_7):
    """Every configuration of a pose: two shoulders, two elbows, two wrists."""
    center = wrist_center(T_0_7)
    found = []
    for front, elbow in itertools.product((1, -1), repeat=2):
        x, y, z = center
        reach = hypot(front * hypot(x, y) - A1, z - D1)
        if not abs(A2 - FOREARM) <= reach <= A2 + FOREARM:
            continue
        arm = arm_angles(center, front, elbow)
        theta4, theta5, theta6 = last_three(*arm, T_0_7)
        found.append([*arm, theta4, theta5, theta6])
        found.append([*arm, theta4 + pi, -theta5, theta6 + pi])
    return np.array(found).reshape(-1, 6)


def nearest_turns(q, q_before, lower, upper):
    """Each angle plus the whole turns that bring it next to the one before, within limits."""
    near = q + 2 * pi * np.round((q_before - q) / (2 * pi))
    near -= 2 * pi * np.ceil(np.maximum(near - upper, 0) / (2 * pi))
    near += 2 * pi * np.ceil(np.maximum(lower - near, 0) / (2 * pi))
    return near


def solve(T_0_gripper, q_start):
    """For each pose in turn the configuration next to the one before."""
    q, answers = np.array(q_start), []
    for T in T_0_gripper:
        near = [nearest_turns(row, q, LOWER, UPPER) for row in all_branches(dh_pose(T))]
        near = [row for row in near if np.all((row >= LOWER) & (row <= UPPER))]
        if near:
            q = min(near, key=lambda row: np.max(np.abs(row - q)))
        answers.append(q if near else np.full(6, np.nan))
    return np.array(answers)


# ---- page 9 ---------------------------------------------------------------------------------


def singularity(q):
    """Distance of the wrist center from axis 1, |sin gamma| of the elbow, |sin theta 5|."""
    center = wrist_center(total_transform(q))
    return hypot(center[0], center[1]), abs(cos(q[2] + SAG)), abs(sin(q[4]))


# ---- page 11 --------------------------------------------------------------------------------


def motion_time(distance, velocity, acceleration, jerk):
    """Least time from rest to rest within three limits."""

    def ramp(speed):
        """Time from rest to a speed, with no acceleration at either end."""
        if speed * jerk > acceleration**2:
            return speed / acceleration + acceleration / jerk
        return 2 * sqrt(speed / jerk)

    if velocity * ramp(velocity) <= distance:
        return distance / velocity + ramp(velocity)
    slow, fast = 0.0, velocity
    for _ in range(100):  # the speed whose two ramps are as long as the way
        middle = (slow + fast) / 2
        slow, fast = (middle, fast) if middle * ramp(middle) < distance else (slow, middle)
    return 2 * ramp(slow)


# ---- page 12 --------------------------------------------------------------------------------


def proved_rate(cycles):
    """The rate at which so many successes in a row still have a chance of 2.5 %."""
    return 0.025 ** (1 / cycles)
