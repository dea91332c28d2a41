"""Your turn: the exercises of the course (docs/course), one function for each.

Copy this file, fill in a function, and ask:

kr210-sim grade my_file.py --step wrist_center

When all of them are right, the last one drives the arm:

kr210-sim grade my_file.py

Lengths in m, angles in rad. Sequences may be lists, tuples or arrays. Write functions of your own
beside these as you like.
"""

import numpy as np

LOWER = np.radians([-185, -45, -210, -350, -125, -350])  # joint limits, joint_1 to joint_6
UPPER = np.radians([185, 85, 65, 350, 125, 350])


def joint_table():
    """Page 1. Seven rows (x, y, z, axis x, axis y, axis z): joint_1 to joint_6, gripper_joint.

    Origin in the frame of the parent link; the axis of the fixed gripper_joint is (0, 0, 0).
    """
    raise NotImplementedError("page 1")


def dh_table():
    """Page 2. Seven rows (alpha_(i-1), a_(i-1), d_i, theta_i at q = 0), modified convention."""
    raise NotImplementedError("page 2")


def transform(alpha, a, d, theta):
    """Page 3. T_(i-1)_i (4, 4) of one row of the table."""
    raise NotImplementedError("page 3")


def total_transform(q):
    """Page 3. T_0_7 (4, 4) of the joint angles q (6,)."""
    raise NotImplementedError("page 3")


def rotation(quaternion_xyzw):
    """Page 4. The rotation matrix (3, 3) of a quaternion (x, y, z, w)."""
    raise NotImplementedError("page 4")


def dh_pose(T_0_gripper):
    """Page 4. T_0_7 (4, 4): the pose of gripper_link (4, 4), with the axes of DH frame 7."""
    raise NotImplementedError("page 4")


def wrist_center(T_0_7):
    """Page 5. Where axes 4, 5 and 6 meet (3,), in the base frame."""
    raise NotImplementedError("page 5")


def first_three(center):
    """Page 6. Theta 1, 2, 3 that bring the wrist center there: facing it, elbow up."""
    raise NotImplementedError("page 6")


def last_three(theta1, theta2, theta3, T_0_7):
    """Page 7. Theta 4, 5, 6 that turn the gripper as T_0_7 wants it."""
    raise NotImplementedError("page 7")


def all_branches(T_0_7):
    """Page 8. Every configuration (n, 6) that reaches the pose, in any order, turns aside."""
    raise NotImplementedError("page 8")


def nearest_turns(q, q_before, lower, upper):
    """Page 8. The angles q (6,) plus whole turns: next to q_before (6,), within the limits."""
    raise NotImplementedError("page 8")


def solve(T_0_gripper, q_start):
    """Page 8. Angles (N, 6) for the poses (N, 4, 4) of gripper_link, one after the other.

    The arm stands at q_start (6,) before the first. A row of NaN is no answer.
    """
    raise NotImplementedError("page 8")


def singularity(q):
    """Page 9. Distance of the wrist center from axis 1 [m], |sin gamma|, |sin theta 5|."""
    raise NotImplementedError("page 9")


def motion_time(distance, velocity, acceleration, jerk):
    """Page 11. The least time from rest to rest within three limits [s]."""
    raise NotImplementedError("page 11")


def proved_rate(cycles):
    """Page 12. Lower end of the exact 95 % interval of the rate when all cycles succeed."""
    raise NotImplementedError("page 12")
