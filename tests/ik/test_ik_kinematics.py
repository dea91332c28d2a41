"""Forward kinematics, Jacobian and distances from singularities."""

from __future__ import annotations

import numpy as np
import pytest
from ik_arms import KR210, OTHERS, parse_urdf

import ik

Q = np.random.default_rng(0).uniform(-3, 3, (200, 6))
ARMS = {"KR210": ik.KR210} | {
    name: ik.from_chain(parse_urdf(text).origins, parse_urdf(text).axes)
    for name, text in OTHERS.items()
}


@pytest.fixture(params=ARMS)
def arm(request):
    return ARMS[request.param]


def test_forward_is_the_product_of_the_chain():
    assert np.abs(ik.forward(ik.KR210, Q) - parse_urdf(KR210).forward(Q)).max() < 2e-15


def test_one_configuration_and_many_give_the_same(arm):
    many = ik.link_frames(arm, Q[:10].reshape(2, 5, 6))
    assert many.shape == (2, 5, 7, 4, 4)
    for q, frames in zip(Q[:10], many.reshape(10, 7, 4, 4), strict=True):
        assert np.abs(ik.link_frames(arm, q) - frames).max() < 2e-15
        assert np.abs(ik.forward(arm, q) - frames[6]).max() < 2e-15


def test_link_frames_are_parallel_in_the_zero_pose_of_the_arm():
    frames = ik.link_frames(ik.KR210, np.zeros(6))
    assert np.array_equal(frames[:, :3, :3], np.tile(np.eye(3), (7, 1, 1)))
    assert frames[:, :3, 3].tolist() == pytest.approx(
        np.array(
            [
                (0, 0, 0.75),
                (0.35, 0, 0.75),
                (0.35, 0, 2.0),
                (1.85, 0, 1.946),
                (1.85, 0, 1.946),
                (1.85, 0, 1.946),
                (2.153, 0, 1.946),
            ]
        )
    )


def test_the_wrist_center_is_where_axes_4_5_and_6_meet(arm):
    center = ik.wrist_center(arm, ik.forward(arm, Q))
    assert np.abs(center - ik.link_frames(arm, Q)[:, 5, :3, 3]).max() < 5e-15


def test_the_jacobian_is_the_derivative_of_the_pose(arm):
    J = ik.jacobian(arm, Q)
    h = 1e-6
    for j in range(6):
        dq = np.zeros(6)
        dq[j] = h
        T = ik.forward(arm, Q)
        dT = (ik.forward(arm, Q + dq) - ik.forward(arm, Q - dq)) / (2 * h)
        spin = dT[:, :3, :3] @ T[:, :3, :3].transpose(0, 2, 1)
        want = np.stack([spin[:, 2, 1], spin[:, 0, 2], spin[:, 1, 0]], axis=1)
        assert np.abs(J[:, :3, j] - dT[:, :3, 3]).max() < 1e-8
        assert np.abs(J[:, 3:, j] - want).max() < 1e-8


def test_the_jacobian_of_one_configuration_is_that_of_many():
    assert np.abs(ik.jacobian(ik.KR210, Q[3]) - ik.jacobian(ik.KR210, Q)[3]).max() < 1e-15


def test_manipulability_is_the_determinant(arm):
    want = np.abs(np.linalg.det(ik.jacobian(arm, Q)))
    assert ik.manipulability(arm, Q) == pytest.approx(want, abs=1e-13)


def test_distances_vanish_at_the_singularities_they_are_named_after():
    stretched = -np.pi / 2 - ik.KR210.constants.phi
    q = np.array([0.3, 0.2, -0.4, 0.5, 0.6, 0.7])
    regular = ik.singularity_distances(ik.KR210, q)
    assert (regular > 0.1).all()
    q_elbow = np.where(np.arange(6) == 2, stretched + 1e-8, q)
    assert ik.singularity_distances(ik.KR210, q_elbow)[1] == pytest.approx(1e-8, rel=1e-6)
    q_wrist = np.where(np.arange(6) == 4, -1e-8, q)
    assert ik.singularity_distances(ik.KR210, q_wrist)[2] == pytest.approx(1e-8, rel=1e-6)
    T = np.eye(4)
    T[0, 3], T[2, 3] = 0.303 + 1e-8 * 2.751, 2.3
    on_axis = ik.inverse(ik.KR210, T)
    assert ik.singularity_distances(ik.KR210, on_axis.q[on_axis.valid])[:, 0] == pytest.approx(
        1e-8, rel=1e-3
    )
    assert not ik.singular(ik.KR210, q).any()
    assert ik.singular(ik.KR210, q_wrist, tolerance=1e-7).tolist() == [False, False, True]


@pytest.mark.parametrize("function", [ik.forward, ik.jacobian, ik.manipulability, ik.link_frames])
@pytest.mark.parametrize("q", [np.zeros(5), 0.0, np.zeros((6, 7))])
def test_wrong_numbers_of_angles_are_refused(function, q):
    with pytest.raises(ik.IKError, match=r"q must have shape \(\.\.\., 6\)"):
        function(ik.KR210, q)
