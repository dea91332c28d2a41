"""How exact the inverse is, against forward kinematics of its own in extended precision.

Each law has a short form that always runs and the full one, marked slow.
"""

from __future__ import annotations

import numpy as np
import pytest
from ik_arms import KR210, parse_urdf, residuals, turn_about, wrapped

import ik
from ik.tolerances import REACH_TOLERANCE

CHAIN = parse_urdf(KR210)
ARM = ik.KR210
STRETCHED = -np.pi / 2 - ARM.constants.phi
"""theta3 of the stretched arm [rad]; the folded one has half a turn more."""
RESIDUAL = 5e-15
"""Largest distance [m] and angle [rad] between a pose and that of its solution."""
BLOCK = 20_000

FULL = pytest.param(True, marks=pytest.mark.slow)


@pytest.mark.parametrize("full", [False, FULL])
def test_random_poses(full):
    rng = np.random.default_rng(20)
    for _ in range(25 if full else 1):
        q = rng.uniform(CHAIN.lower, CHAIN.upper, (BLOCK if full else 1000, 6))
        T = CHAIN.forward(q).astype(float)
        found = check(T)
        assert np.array_equal(found.valid, np.repeat(reserve(T) >= 0, 4, axis=1))
        error = np.nanmin(np.abs(wrapped(found.q - q[:, None])).max(axis=-1), axis=1)
        assert error.max() < 1e-9


@pytest.mark.parametrize("full", [False, FULL])
@pytest.mark.parametrize("kind", ["wrist", "elbow", "shoulder", "all"])
def test_next_to_singularities_and_on_them(kind, full):
    rng = np.random.default_rng(["wrist", "elbow", "shoulder", "all"].index(kind))
    for _ in range(4 if full else 1):
        T = near_singular(kind, 20_000 if full else 400, rng)
        found = check(T)
        assert found.valid.any(axis=1).all()


def near_singular(kind: str, n: int, rng: np.random.Generator) -> np.ndarray:
    """Poses 1e-16 to 0.1 away from a singularity [rad or m], and one in ten exactly on it."""
    q = rng.uniform(CHAIN.lower, CHAIN.upper, (n, 6))
    away = 10.0 ** rng.uniform(-16, -1, (3, n)) * rng.choice([-1.0, 1.0], (3, n))
    away[:, ::10] = 0.0
    if kind in ("wrist", "all"):
        q[:, 4] = away[0]
        q[::3, 4] += np.pi  # bent back onto itself
    if kind in ("elbow", "all"):
        q[:, 2] = STRETCHED + away[1]
        q[::4, 2] += np.pi  # folded
    T = CHAIN.forward(q).astype(float)
    if kind in ("shoulder", "all"):
        center = ik.wrist_center(ARM, T)
        radius = np.hypot(center[:, 0], center[:, 1])
        if kind == "all":  # a bent elbow must leave the wrist center where it is: lean q2 instead
            return np.concatenate([T, over_the_base(q, away[2])])
        # to 0.1 m from axis 1, at a height the arm can reach
        T[:, 0, 3] += (away[2] / radius - 1.0) * center[:, 0]
        T[:, 1, 3] += (away[2] / radius - 1.0) * center[:, 1]
        T[:, 2, 3] += rng.uniform(1.0, 3.0, n) - center[:, 2]
        T[::10, :2, 3] = 0.303 * T[::10, :2, 0]  # exactly on axis 1, as far as the solver can see
    return T


def over_the_base(q: np.ndarray, away: np.ndarray) -> np.ndarray:
    """Lean the stretched or folded arms of q until the wrist center is next to axis 1."""
    q = q.copy()
    length = np.where(np.arange(len(q)) % 4 == 0, 1.25 - ARM.constants.L3, ARM.constants.reach)
    reaches = np.abs((away - 0.35) / length) < 1.0
    q, away, length = q[reaches], away[reaches], length[reaches]
    q[:, 1] = np.arcsin((away - 0.35) / length)
    return CHAIN.forward(q).astype(float)


def check(T: np.ndarray) -> ik.Solutions:
    """Assert that every solution reproduces its pose, or the nearest one that is in reach."""
    found = ik.inverse(ARM, T)
    pose, branch = np.nonzero(found.valid)
    far, angle = residuals(CHAIN.forward(found.q[pose, branch]), T[pose])
    beyond = np.maximum(-reserve(T), 0)[pose, branch // 4]
    assert beyond.max() < 1.01 * REACH_TOLERANCE * ARM.constants.reach
    assert (far - beyond).max() < RESIDUAL
    assert angle.max() < RESIDUAL
    return found


@pytest.mark.skipif(np.finfo(np.longdouble).eps > 1e-18, reason="no extended precision here")
def test_next_to_the_edge_of_reach_the_elbow_keeps_the_digits_of_the_pose():
    rng = np.random.default_rng(4)
    q = rng.uniform(CHAIN.lower, CHAIN.upper, (2000, 6))
    bent = 10.0 ** rng.uniform(-6, -4.3, len(q)) * rng.choice([-1.0, 1.0], len(q))
    q[:, 2] = STRETCHED + bent
    q[::2, 2] += np.pi  # folded
    found = ik.inverse(ARM, CHAIN.forward(q).astype(float))
    error = np.nanmin(np.abs(wrapped(found.q[..., 2] - q[:, None, 2])), axis=1)
    # three coordinates off by 2.2e-16 m, half a unit in the last place, over L2 L3 / (L2 + L3)
    assert (error * np.abs(bent)).max() < np.sqrt(3) * 2.0**-52 / 0.68


def reserve(T: np.ndarray) -> np.ndarray:
    """How far inside of its reach the wrist center is, for both shoulders, in extended precision.

    Negative outside; what rounding of the pose does is left in. Shape (n, 2) [m].
    """
    exact = T.astype(np.longdouble)
    w = exact[:, :3, 3] - np.longdouble("0.303") * exact[:, :3, 0]
    rho = np.sqrt(w[:, 0] ** 2 + w[:, 1] ** 2)
    L2, L3 = np.longdouble("1.25"), np.sqrt(np.longdouble("1.5") ** 2 + np.longdouble("0.054") ** 2)
    result = []
    for side in (rho, -rho):
        D = np.sqrt((side - np.longdouble("0.35")) ** 2 + (w[:, 2] - np.longdouble("0.75")) ** 2)
        result.append(np.minimum(L2 + L3 - D, D - abs(L2 - L3)))
    return np.stack(result, axis=1)


def test_on_axis_1_with_the_arm_stretched():
    # the wrist singularity on top of it: the arm straight up, with no freedom left unused
    T = turn_about(1, -np.pi / 2)
    T[2, 3] = 0.75 + np.sqrt(ARM.constants.reach**2 - 0.35**2) + 0.303
    check(T[None])


@pytest.mark.parametrize("kind", ["wrist", "elbow", "shoulder", "all"])
def test_one_pose_is_as_exact_as_many(kind):
    T = near_singular(kind, 40, np.random.default_rng(9))
    for pose in T:
        found = ik.inverse(ARM, pose)
        assert found.valid.any()
        q = found.q[found.valid]
        far, angle = residuals(CHAIN.forward(q), np.broadcast_to(pose, (len(q), 4, 4)))
        assert max(far.max(), angle.max()) < RESIDUAL


def test_an_arm_that_folds_onto_its_shoulder():
    arm = ik.Arm(a1=0.2, d1=0.5, L2=0.7, a3=0.0, d4=0.7)
    T = np.eye(4)
    T[:3, 3] = (0.2, 0.0, 0.5)  # the wrist center is the shoulder: joint 2 is free
    for step in (0.0, 1e-300, 1e-150, 1e-80, 1e-16, 1e-8):
        T[2, 3] = 0.5 + step
        for found in (ik.inverse(arm, T), ik.inverse(arm, T[None])):
            exists = found.valid.reshape(8)
            assert exists[:4].all()
            back = ik.forward(arm, found.q.reshape(8, 6)[exists])
            assert np.abs(back - T).max() < RESIDUAL


def test_a_lateral_offset_as_far_as_the_wrist_center():
    arm = ik.Arm(a1=0.2, d1=0.5, L2=0.7, a3=0.1, d4=0.8, b=0.3)
    for away in (-1e-10, -1e-15, 0.0, 1e-16, 1e-12, 1e-6):
        T = turn_about(0, 0.7)
        T[:3, 3] = (0.6 * (0.3 + away), 0.8 * (0.3 + away), 1.1)
        for found in (ik.inverse(arm, T), ik.inverse(arm, T[None])):
            exists = found.valid.reshape(8)
            assert exists.all() == (away > -1e-11)
            back = ik.forward(arm, found.q.reshape(8, 6)[exists])
            assert np.abs(back - T).max(initial=0.0) < 1e-14 + max(0.0, -2 * away)


def test_a_wrist_center_on_axis_2_is_out_of_reach_unless_the_arm_folds_onto_it():
    T = turn_about(2, np.pi / 2)
    T[:3, 3] = 0.35, 0.303, 0.75
    for found in (ik.inverse(ARM, T), ik.inverse(ARM, T[None])):
        assert found.valid.reshape(8).tolist() == [False] * 4 + [True] * 4


@pytest.mark.skipif(np.finfo(np.longdouble).eps > 1e-18, reason="no extended precision here")
@pytest.mark.parametrize("excess", [1e-15, 1e-12, 1e-9, 1e-6])
def test_links_of_all_but_equal_length_fold_as_exactly(excess):
    arm = ik.Arm(a1=0.3, d1=0.4, L2=1.0, a3=0.0, d4=1.0 + excess)
    q = np.random.default_rng(3).uniform(-2.0, 2.0, (200, 6))
    q[:, 2] = np.pi / 2 + 10.0 ** np.random.default_rng(4).uniform(-16, -2, 200)
    T = ik.forward(arm, q)
    found = ik.inverse(arm, T)
    pose, branch = np.nonzero(found.valid)
    assert np.isin(np.arange(200), pose).all()
    assert np.abs(ik.forward(arm, found.q[pose, branch]) - T[pose]).max() < 2e-14
