"""Your turn: write the inverse kinematics of the KUKA KR210.

    kr210-sim grade examples/student_ik.py

grades it: ten cycles of pick and place. As it stands, it answers zero to every pose: 0 of 10.
"""

# Derive these from the robot: `kr210-sim dh` prints the tables to compare yours with.
# Lengths in metres, angles in radians.


def wrist_center(position, rotation):
    """Where axes 4, 5 and 6 meet, from the pose of the gripper."""
    raise NotImplementedError


def first_three(center):
    """Theta 1 to 3, from the wrist center: a triangle and the law of cosines."""
    raise NotImplementedError


def last_three(theta1, theta2, theta3, rotation):
    """Theta 4 to 6, from what is left of the rotation: R3_6 = R0_3^T R0_6."""
    raise NotImplementedError


def handle_calculate_IK(req):
    """Answer a list of gripper poses by a list of six joint angles each [rad]."""
    angles = []
    for pose in req.poses:
        position = (pose.position.x, pose.position.y, pose.position.z)
        turn = pose.orientation
        quaternion = (turn.x, turn.y, turn.z, turn.w)

        # 1. the rotation matrix of the quaternion
        # 2. the wrist center
        # 3. theta 1 to 3
        # 4. theta 4 to 6
        theta1 = theta2 = theta3 = theta4 = theta5 = theta6 = 0.0

        angles.append([theta1, theta2, theta3, theta4, theta5, theta6])
    return angles
