"""With sympy, as many did: transforms as formulas, made once; numbers are put in per pose.

kr210-sim grade examples/solutions/sympy_ik.py
"""

from sympy import Matrix, acos, atan2, cos, pi, sin, sqrt, symbols

q1, q2, q3 = symbols("q1:4")


def rotation_z(angle):
    """Rotation about z, as a formula."""
    return Matrix([[cos(angle), -sin(angle), 0], [sin(angle), cos(angle), 0], [0, 0, 1]])


def rotation_x(angle):
    """Rotation about x, as a formula."""
    return Matrix([[1, 0, 0], [0, cos(angle), -sin(angle)], [0, sin(angle), cos(angle)]])


# Modified DH: R_(i-1)_i = Rx(alpha_(i-1)) Rz(theta_i), with theta_2 = q2 - pi/2.
R0_3 = rotation_z(q1) * rotation_x(-pi / 2) * rotation_z(q2 - pi / 2) * rotation_z(q3)
# From the axes of the DH table's last frame to those of gripper_link.
R_CORRECTION = Matrix([[0, 0, 1], [0, -1, 0], [1, 0, 0]])

D1, A1, A2, A3, D4, D7 = 0.75, 0.35, 1.25, -0.054, 1.5, 0.303
FOREARM = sqrt(D4**2 + A3**2)


def solve(position, quaternion_xyzw):
    """Six joint angles of a gripper pose, as sympy's numbers."""
    x, y, z, w = (float(value) for value in quaternion_xyzw)
    R0_G = Matrix(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
    )
    wx, wy, wz = Matrix([float(value) for value in position]) - D7 * R0_G[:, 0]

    theta1 = atan2(wy, wx)
    along, up = sqrt(wx**2 + wy**2) - A1, wz - D1
    distance = sqrt(along**2 + up**2)
    shoulder = acos((A2**2 + distance**2 - FOREARM**2) / (2 * A2 * distance))
    elbow = acos((A2**2 + FOREARM**2 - distance**2) / (2 * A2 * FOREARM))
    theta2 = (pi / 2 - shoulder - atan2(up, along)).evalf()
    theta3 = (pi / 2 - elbow - atan2(-A3, D4)).evalf()

    # The transpose is the inverse, and stays orthogonal.
    R3_6 = R0_3.evalf(subs={q1: theta1, q2: theta2, q3: theta3}).T * R0_G * R_CORRECTION
    theta4 = atan2(R3_6[2, 2], -R3_6[0, 2])
    theta5 = atan2(sqrt(R3_6[0, 2] ** 2 + R3_6[2, 2] ** 2), R3_6[1, 2])
    theta6 = atan2(-R3_6[1, 1], R3_6[1, 0])
    return theta1, theta2, theta3, theta4, theta5, theta6
