"""Solvers that make one known mistake each, or two: the course's formulas, with one thing wrong.

Each is f(T_base_gripper_link (N, 4, 4), q_start (6,)) -> (N, 6) rad, so it can be graded as well:
kr210-sim grade tests/mistaken_solvers.py:sag_omitted
"""

from __future__ import annotations

import numpy as np

PI = np.pi
A1, D1, A2, A3, D4 = 0.35, 0.75, 1.25, -0.054, 1.5
SAG = np.arctan2(-A3, D4)
LOWER = np.radians([-185, -45, -210, -350, -125, -350])
UPPER = np.radians([185, 85, 65, 350, 125, 350])


def rot_x(a):
    c, s, o, i = np.cos(a), np.sin(a), np.zeros_like(a), np.ones_like(a)
    return np.moveaxis(np.array([[i, o, o], [o, c, -s], [o, s, c]]), -1, 0)


def rot_y(a):
    c, s, o, i = np.cos(a), np.sin(a), np.zeros_like(a), np.ones_like(a)
    return np.moveaxis(np.array([[c, o, s], [o, i, o], [-s, o, c]]), -1, 0)


def rot_z(a):
    c, s, o, i = np.cos(a), np.sin(a), np.zeros_like(a), np.ones_like(a)
    return np.moveaxis(np.array([[c, -s, o], [s, c, o], [o, o, i]]), -1, 0)


def once(rotation, angle):
    return rotation(np.array([angle]))[0]


CORRECTION = once(rot_z, PI) @ once(rot_y, -PI / 2)


def euler(R):
    """Roll, pitch, yaw as tf's euler_from_quaternion has them (sxyz)."""
    return (
        np.arctan2(R[:, 2, 1], R[:, 2, 2]),
        np.arcsin(np.clip(-R[:, 2, 0], -1, 1)),
        np.arctan2(R[:, 1, 0], R[:, 0, 0]),
    )


def quaternion(R):
    """x, y, z, w of a rotation that is no half turn."""
    w = 0.5 * np.sqrt(1 + R[0, 0] + R[1, 1] + R[2, 2])
    return (
        (R[2, 1] - R[1, 2]) / (4 * w),
        (R[0, 2] - R[2, 0]) / (4 * w),
        (R[1, 0] - R[0, 1]) / (4 * w),
        w,
    )


def of_quaternion(x, y, z, w):
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
    )


def zyx(roll, pitch, yaw):
    return rot_z(yaw) @ rot_y(pitch) @ rot_x(roll)


def dh(alpha, a, d, theta):
    """Transforms of one row of the modified DH table."""
    T = np.zeros((len(theta), 4, 4))
    c, s, ca, sa = np.cos(theta), np.sin(theta), np.cos(alpha), np.sin(alpha)
    T[:, 0, 0], T[:, 0, 1], T[:, 0, 3] = c, -s, a
    T[:, 1, 0], T[:, 1, 1], T[:, 1, 2], T[:, 1, 3] = s * ca, c * ca, -sa, -sa * d
    T[:, 2, 0], T[:, 2, 1], T[:, 2, 2], T[:, 2, 3] = s * sa, c * sa, ca, ca * d
    T[:, 3, 3] = 1
    return T


def acos(cosine):
    return np.arccos(np.clip(cosine, -1, 1))


def solve(
    T,
    *,
    tool=0.303,
    correction=CORRECTION,
    compose=zyx,
    sag=SAG,
    elbow=(1, 1),
    theta2=0.0,
    theta3=0.0,
    dh2=-PI / 2,
    elevation_from=A1,
    azimuth=np.arctan2,
    inverse=lambda R: np.swapaxes(R, 1, 2),
    sign5=1,
    d1=D1,
    a2=A2,
):
    """The course's solution; every argument is a place for a mistake."""
    R = compose(*euler(T[:, :3, :3])) @ correction
    w = T[:, :3, 3] - tool * R[:, :, 2]
    q1 = azimuth(w[:, 1], w[:, 0])
    u, v = np.hypot(w[:, 0], w[:, 1]) - A1, w[:, 2] - d1
    forearm, reach = np.hypot(D4, A3), np.hypot(u, v)
    A = acos((reach**2 + a2**2 - forearm**2) / (2 * reach * a2))
    B = acos((forearm**2 + a2**2 - reach**2) / (2 * forearm * a2))
    q2 = PI / 2 - elbow[0] * A - np.arctan2(v, u + A1 - elevation_from) + theta2
    q3 = PI / 2 - elbow[1] * B - sag + theta3
    if elbow[1] < 0:
        q3 = q3 - 2 * PI
    T0_3 = dh(0, 0, d1, q1) @ dh(-PI / 2, A1, 0, q2 + dh2) @ dh(0, a2, 0, q3)
    M = inverse(T0_3[:, :3, :3]) @ R
    q4 = np.arctan2(M[:, 2, 2], -M[:, 0, 2])
    q5 = sign5 * np.arctan2(np.hypot(M[:, 0, 2], M[:, 2, 2]), M[:, 1, 2])
    q6 = np.arctan2(-M[:, 1, 1], M[:, 1, 0])
    return np.stack([q1, q2, q3, q4, q5, q6], axis=1)


def follow(q, q_start):
    """Take the wrist branch and the turns that are next to the answer before."""
    path, last = [], q_start
    for row in q:
        options = [row, row * [1, 1, 1, 1, -1, 1] + [0, 0, 0, PI, 0, PI]]
        near = []
        for option in options:
            turns = np.round((option - last) / (2 * PI))
            near.append(option - 2 * PI * turns * [0, 0, 0, 1, 0, 1])
            beyond = (near[-1] < LOWER).astype(int) - (near[-1] > UPPER)
            near[-1] += 2 * PI * beyond * [0, 0, 0, 1, 0, 1]
        last = min(near, key=lambda option: np.abs(option - last).max())
        path.append(last)
    return np.array(path)


def other_wrist(q):
    """The other wrist branch of every second three answers."""
    half = np.where(np.nanmean(q, axis=0) > 0, -PI, PI)
    flipped = q * [1, 1, 1, 1, -1, 1] + [0, 0, 0, 1, 0, 1] * half
    return np.where(np.arange(len(q))[:, None] % 6 < 3, q, flipped)


def with_(**mistake):
    """Return a solver with a mistake, smooth along the way but for it."""

    def solver(T, q_start):
        return follow(solve(T, **mistake), q_start)

    return solver


right = with_()


# ---- one mistake ----------------------------------------------------------------------------

LINK_6 = {"tool": 0.193}
MISSING = {"correction": np.eye(3)}


def xyz(roll, pitch, yaw):
    return rot_x(roll) @ rot_y(pitch) @ rot_z(yaw)


def swapped(roll, pitch, yaw):
    return zyx(yaw, pitch, roll)


def rounded_lu(R):
    return np.linalg.inv(np.round(R, 2))


link_6_for_gripper_link = with_(**LINK_6)
no_wrist_offset = with_(tool=0.0)
correction_missing = with_(**MISSING)
correction_wrong_sign = with_(correction=once(rot_z, PI) @ once(rot_y, PI / 2))
correction_without_z = with_(correction=once(rot_y, -PI / 2))
rpy_as_xyz = with_(compose=xyz)
roll_and_yaw_swapped = with_(compose=swapped)
theta2_without_quarter = with_(theta2=-PI / 2)
theta2_missing_in_dh = with_(dh2=0.0)
theta3_without_quarter = with_(theta3=-PI / 2)
sag_omitted = with_(sag=0.0)
sag_of_wrong_sign = with_(sag=-SAG)
elbows_mixed = with_(elbow=(-1, 1))
a1_ignored = with_(elevation_from=0.0)
height_mistyped = with_(d1=0.33)
upper_arm_mistyped = with_(a2=1.2)
orthogonality_lost = with_(inverse=rounded_lu)


def rotation_transposed(T, q_start):
    turned = T.copy()
    turned[:, :3, :3] = np.swapaxes(T[:, :3, :3], 1, 2)
    return right(turned, q_start)


def quaternion_w_first(T, q_start):
    """Right, but for x, y, z, w read as w, x, y, z."""
    turned = T.copy()
    for pose in turned:
        x, y, z, w = quaternion(pose[:3, :3])
        pose[:3, :3] = of_quaternion(y, z, w, x)
    return right(turned, q_start)


def elbow_down(T, q_start):
    """Right, but for the arm that stands with its elbow up."""
    return follow(solve(T, elbow=(-1, -1)), q_start)


def elbow_changes(T, q_start):
    up, down = solve(T), solve(T, elbow=(-1, -1))
    return follow(np.where(np.arange(len(T))[:, None] % 6 < 3, up, down), q_start)


theta5_sign_alone = with_(sign5=-1)


def wrist_changes(T, q_start):
    """Right, but on either wrist branch by turns."""
    return other_wrist(right(T, q_start))


def degrees(T, q_start):
    return np.degrees(right(T, q_start))


def radians_twice(T, q_start):
    return np.radians(right(T, q_start))


def turning(q):
    """Answers of which every fifth has joint 6 a turn off."""
    q = q.copy()
    turned = q[2::5, 5]
    turned -= 2 * PI * np.where(turned > 0, 1, -1) * (np.abs(turned) > 0.3)
    return q


def turns_jump(T, q_start):
    return turning(right(T, q_start))


def over_the_limits(T, q_start):
    q = right(T, q_start)
    q[:, 5] += 4 * PI
    return q


def by_atan(T, q_start):
    return follow(solve(T, azimuth=lambda y, x: np.arctan(y / x)), q_start)


def silent_behind(T, q_start):
    q = right(T, q_start)
    q[T[:, 0, 3] - 0.303 * T[:, 0, 0] < 0] = np.nan
    return q


def garbage_behind(T, q_start):
    q = right(T, q_start)
    behind = T[:, 0, 3] - 0.303 * T[:, 0, 0] < 0
    q[behind] = [0.1, 0.2, 0.3, 0.4, 0.5, 0.6]
    return q


# ---- pairs ----------------------------------------------------------------------------------


def frame_and_turns(T, q_start):
    return turning(link_6_for_gripper_link(T, q_start))


def sag_and_branch(T, q_start):
    """No sag angle, and the wrist branch by turns."""
    return other_wrist(sag_omitted(T, q_start))


sag_and_mixed_elbows = with_(sag=0.0, elbow=(-1, 1))
sag_and_theta5_sign = with_(sag=-SAG, sign5=-1)
frame_and_sag = with_(**LINK_6, sag=0.0)
frame_and_correction = with_(**LINK_6, **MISSING)
frame_and_rpy = with_(**LINK_6, compose=xyz)
correction_and_sag = with_(**MISSING, sag=0.0)
theta2_and_sag = with_(theta2=-PI / 2, sag=0.0)


def frame_and_degrees(T, q_start):
    return np.degrees(link_6_for_gripper_link(T, q_start))


def sag_and_atan(T, q_start):
    return follow(solve(T, sag=0.0, azimuth=lambda y, x: np.arctan(y / x)), q_start)
