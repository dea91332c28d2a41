"""The course's classic: wrist center, triangle with the law of cosines, Euler angles of the wrist.

kr210-sim grade examples/solutions/geometric_ik.py
"""

from math import acos, atan2, cos, hypot, pi, sin

D1, A1 = 0.75, 0.35  # height and distance of axis 2 from axis 1 [m]
A2 = 1.25  # upper arm, axis 2 to axis 3 [m]
D4, A3 = 1.50, -0.054  # forearm, axis 3 to the wrist center, along and across [m]
D7 = 0.303  # wrist center to gripper_link [m]

FOREARM = hypot(D4, A3)
SAG = atan2(-A3, D4)  # the wrist center lies below the line of the forearm [rad]


def rotation_of(x, y, z, w):
    """Rotation matrix of a quaternion."""
    length = (x * x + y * y + z * z + w * w) ** 0.5
    x, y, z, w = x / length, y / length, z / length, w / length
    return [
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
    ]


def angle_opposite(opposite, one, other):
    """Angle of a triangle by the law of cosines; rounding must not push it over the edge."""
    cosine = (one**2 + other**2 - opposite**2) / (2 * one * other)
    return acos(max(-1.0, min(1.0, cosine)))


def first_three(wx, wy, wz):
    """Angles of joints 1 to 3: facing the wrist center, elbow up."""
    theta1 = atan2(wy, wx)
    along, up = hypot(wx, wy) - A1, wz - D1
    distance = hypot(along, up)
    shoulder = angle_opposite(FOREARM, A2, distance)
    elbow = angle_opposite(distance, A2, FOREARM)
    theta2 = pi / 2 - shoulder - atan2(up, along)
    theta3 = pi / 2 - elbow - SAG
    return theta1, theta2, theta3


def last_three(theta1, theta2, theta3, R):
    """Angles of joints 4 to 6 from R3_6 = Ry(-(theta2 + theta3)) Rz(-theta1) R."""
    c1, s1 = cos(theta1), sin(theta1)
    c, s = cos(theta2 + theta3), sin(theta2 + theta3)

    def turned(column):
        x, y, z = (R[row][column] for row in range(3))
        ahead = c1 * x + s1 * y
        return c * ahead - s * z, c1 * y - s1 * x, s * ahead + c * z

    (m00, m10, m20), (m01, _, _), (m02, _, _) = turned(0), turned(1), turned(2)
    return atan2(m10, -m20), atan2(hypot(m10, m20), m00), atan2(m01, m02)


def handle_calculate_IK(req):
    """Answer a list of gripper poses by a list of six joint angles each [rad]."""
    angles = []
    for pose in req.poses:
        p, turn = pose.position, pose.orientation
        R = rotation_of(turn.x, turn.y, turn.z, turn.w)
        wx, wy, wz = (value - D7 * R[row][0] for row, value in enumerate((p.x, p.y, p.z)))
        arm = first_three(wx, wy, wz)
        angles.append([*arm, *last_three(*arm, R)])
    return angles
