"""Your turn: write the inverse kinematics of the KUKA KR210, in the form of the original course.

cp examples/student_ik.py my_ik.py
kr210-sim grade my_ik.py --step wrist_center
kr210-sim grade my_ik.py

The second line checks one function, the third lets the arm do ten cycles of pick and place.
docs/course derives every function. As it stands, it answers zero to every pose: 0 of 10.
"""

import numpy as np

# Lengths in metres, angles in radians. `kr210-sim dh` prints the tables to compare yours with: the
# six joints that turn, and seven rows of the DH table, whose last is the fixed gripper.


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
    """Page 6. Theta 1 to 3, from the wrist center: a triangle and the law of cosines."""
    raise NotImplementedError("page 6")


def last_three(theta1, theta2, theta3, T_0_7):
    """Page 7. Theta 4 to 6, from what is left of the rotation: R_3_6 = R_0_3^T R_0_6."""
    raise NotImplementedError("page 7")


def handle_calculate_IK(req):
    """Answer a list of gripper poses by a list of six joint angles each [rad]."""
    angles = []
    for pose in req.poses:
        position = (pose.position.x, pose.position.y, pose.position.z)
        turn = pose.orientation
        quaternion = (turn.x, turn.y, turn.z, turn.w)
        T_0_gripper = np.eye(4)

        # 1. fill in its rotation, and its position as the last column
        # 2. T_0_7 from it, and the wrist center from that
        # 3. theta 1 to 3
        # 4. theta 4 to 6
        theta1 = theta2 = theta3 = theta4 = theta5 = theta6 = 0.0

        angles.append([theta1, theta2, theta3, theta4, theta5, theta6])
    return angles
