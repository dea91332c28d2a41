"""Laws of the inverse: what it returns reproduces the pose, and nothing is missing."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import numpy as np
import pytest
from ik_arms import DEG, KR210, OTHERS, parse_urdf, residuals, wrapped

import ik

LIMITS = (parse_urdf(KR210).lower, parse_urdf(KR210).upper)

# position; quaternion xyzw; wrist center; joint angles, as the course gives them
GOLDEN = [
    (
        (2.16135, -1.42635, 1.55109),
        (0.708611, 0.186356, -0.157931, 0.661967),
        (1.89451, -1.44302, 1.69366),
        (-0.65, 0.45, -0.36, 0.95, 0.79, 0.49),
    ),
    (
        (-0.56754, 0.93663, 3.0038),
        (0.62073, 0.48318, 0.38759, 0.480629),
        (-0.638, 0.64198, 2.9988),
        (-0.79, -0.11, -2.33, 1.94, 1.14, -3.68),
    ),
    (
        (-1.3863, 0.02074, 0.90986),
        (0.01735, -0.2179, 0.9025, 0.371016),
        (-1.1669, -0.17989, 0.85137),
        (-2.99, -0.12, 0.94, 4.06, 1.29, -4.12),
    ),
]


def pose(position: tuple[float, ...], xyzw: tuple[float, ...]) -> np.ndarray:
    x, y, z, w = np.array(xyzw) / np.linalg.norm(xyzw)
    T = np.eye(4)
    T[:3, :3] = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
    ]
    T[:3, 3] = position
    return T


def random_poses(n: int, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    q = np.random.default_rng(seed).uniform(*LIMITS, (n, 6))
    return q, parse_urdf(KR210).forward(q).astype(float)


@pytest.mark.parametrize(("position", "xyzw", "center", "angles"), GOLDEN)
def test_golden_poses_of_the_course(position, xyzw, center, angles):
    T = pose(position, xyzw)
    assert ik.wrist_center(ik.KR210, T) == pytest.approx(center, abs=1e-4)
    found = ik.inverse(ik.KR210, T)
    assert found.valid.any()
    error = np.abs(wrapped(found.q - angles)).max(axis=1)
    assert np.nanmin(error) < 0.01
    assert ik.forward(ik.KR210, found.q[found.valid]) == pytest.approx(
        np.broadcast_to(T, (found.valid.sum(), 4, 4)), abs=5e-15
    )


def test_zero_configuration_points_along_x():
    T = ik.forward(ik.KR210, np.zeros(6))
    assert T[:3, 3] == pytest.approx([0.35 + 0.96 + 0.54 + 0.193 + 0.11, 0, 0.33 + 0.42 + 1.196])
    assert np.array_equal(T[:3, :3], np.eye(3))


@pytest.mark.parametrize("name", OTHERS)
def test_other_arms_round_trip(name):
    chain = parse_urdf(OTHERS[name])
    arm = ik.from_chain(chain.origins, chain.axes)
    q = np.random.default_rng(1).uniform(chain.lower, chain.upper, (400, 6))
    T = chain.forward(q).astype(float)
    found = ik.inverse(arm, T, (chain.lower, chain.upper))
    assert np.isin(found.valid.sum(axis=1), (4, 8)).all()
    far, angle = residuals(chain.forward(found.q), T[:, None])
    assert np.nanmax(far) < 5e-14
    assert np.nanmax(angle) < 5e-14
    error = np.abs(wrapped(found.q - q[:, None])).max(axis=-1)
    error[~found.in_limits] = np.inf
    assert error.min(axis=1).max() < 1e-9


@pytest.mark.parametrize("name", ["KR210", *OTHERS])
def test_one_pose_and_many_give_the_same(name):
    chain = parse_urdf({"KR210": KR210, **OTHERS}[name])
    arm = ik.from_chain(chain.origins, chain.axes)
    rng = np.random.default_rng(2)
    q = rng.uniform(chain.lower, chain.upper, (60, 6))
    q[::3, 4] = 0.0  # at the wrist singularity, for most of the arms
    q[::4, 2] = np.round(q[::4, 2])
    T = ik.forward(arm, q)
    T[::5, :3, 3] *= rng.uniform(0.2, 2.0, (12, 1))  # some out of reach
    T[::20, :3, 3] = arm.T_base[:3, 3]
    limits = (chain.lower, chain.upper)
    many = ik.inverse(arm, T, limits)
    assert 0 < many.valid.sum() < many.valid.size
    for i in range(len(T)):
        one = ik.inverse(arm, T[i], limits)
        assert np.array_equal(one.valid, many.valid[i])
        assert np.array_equal(one.in_limits, many.in_limits[i])
        same = np.abs(one.q - many.q[i])[one.valid]
        # +pi and -pi are the same angle, and rounding decides between them
        assert np.minimum(same, np.abs(same - 2 * np.pi)).max(initial=0.0) < 1e-14
        assert np.array_equal(np.isnan(one.q), np.isnan(many.q[i]))


@pytest.mark.parametrize("signs", [(1,) * 6, (1, -1, 1, 1, -1, 1)])
@pytest.mark.parametrize("offsets", [(0.0,) * 6, (0.1, -0.2, 0.3, 0.0, -0.5, 0.6)])
def test_joints_that_are_turned_or_shifted_are_so_in_one_pose_and_in_many(signs, offsets):
    plain = ik.Arm(a1=0.3, d1=0.5, L2=1.0, a3=0.1, d4=1.1)
    arm = replace(plain, signs=signs, offsets=offsets)
    q = np.array([0.4, 0.2, -0.6, 0.5, 0.8, -0.3])
    T = ik.forward(arm, q)
    assert np.abs(T - ik.forward(plain, np.multiply(signs, q) + offsets)).max() < 1e-15
    one, many = ik.inverse(arm, T), ik.inverse(arm, T[None])
    assert np.abs(ik.forward(arm, one.q[one.valid]) - T).max() < 1e-14
    assert np.abs(wrapped(one.q[one.valid] - q)).max(axis=1).min() < 1e-13
    assert np.nanmax(np.abs(wrapped(one.q - many.q[0]))) < 1e-13


def test_odd_lengths_are_solved_as_well():
    rng = np.random.default_rng(8)
    for _ in range(60):
        arm = ik.Arm(
            a1=rng.choice([0.0, -0.3, 0.4]),
            b=rng.choice([0.0, -0.2, 0.1]),
            d1=rng.normal(),
            L2=rng.choice([0.5, 0.8]),
            a3=rng.choice([-0.3, 0.0, 0.4]),
            d4=rng.choice([-0.4, 0.5]),
            signs=tuple(rng.choice([-1, 1], 6)),
            offsets=tuple(rng.uniform(-4, 4, 6)),
        )
        q = rng.uniform(-np.pi, np.pi, (30, 6))
        T = ik.forward(arm, q)
        limits = -rng.uniform(0, 7, 6), rng.uniform(0, 7, 6)
        many = ik.inverse(arm, T, limits)
        assert np.abs(ik.forward(arm, many.q) - T[:, None])[many.valid].max() < 1e-14
        error = np.abs(wrapped(many.q - q[:, None])).max(axis=-1)
        assert np.nanmin(error, axis=1).max() < 1e-9
        assert np.array_equal(many.in_limits, ik.within_limits(many.q, *limits))
        for i in range(5):
            one = ik.inverse(arm, T[i], limits)
            assert np.array_equal(one.in_limits, many.in_limits[i])
            assert one.q == pytest.approx(many.q[i], abs=1e-14, nan_ok=True)


def test_branches_come_in_the_documented_order():
    _, T = random_poses(500, seed=3)
    found = ik.inverse(ik.KR210, T)
    frames = ik.link_frames(ik.KR210, found.q)
    center, elbow_x = frames[..., 5, :3, 3], frames[..., 0, :3, 0]
    ahead = (center * elbow_x).sum(axis=-1)  # along x of link 1: in front of axis 1 or behind it
    stretched = -np.pi / 2 - ik.KR210.constants.phi
    for branch in range(8):
        shoulder, elbow, wrist = branch >> 2, branch >> 1 & 1, branch & 1
        exists = found.valid[:, branch]
        q = found.q[exists, branch]
        assert ((ahead[exists, branch] > 0) == (shoulder == 0)).all()
        assert ((wrapped(q[:, 2] - stretched) > 0) == (elbow == 0)).all()
        assert ((q[:, 4] > 0) == (wrist == 0)).all()


def test_random_poses_have_as_many_branches_as_expected():
    _, T = random_poses(3000)
    found = ik.inverse(ik.KR210, T)
    assert found.valid.sum(axis=1).mean() == pytest.approx(6.67, abs=0.1)
    lower, upper = LIMITS
    assert len(ik.turns(found.q, lower, upper).q) / 3000 == pytest.approx(16.2, abs=0.6)


def test_unreachable_poses_are_no_error_and_hold_no_angles():
    T = np.eye(4)
    T[0, 3] = 5.0
    for poses in (T, np.tile(T, (3, 1, 1))):
        found = ik.inverse(ik.KR210, poses)
        assert not found.valid.any()
        assert not found.in_limits.any()
        assert np.isnan(found.q).all()
        assert not found.singular.any()
    T[0, 3] = 1e200  # its square overflows
    assert not ik.inverse(ik.KR210, T).valid.any()
    assert not ik.inverse(ik.KR210, T[None]).valid.any()


@pytest.mark.parametrize("shape", [(0,), (1,), (2, 3), (2050,), (3, 0)])
def test_leading_dimensions_are_kept(shape):
    T = np.broadcast_to(ik.forward(ik.KR210, [0.1, 0.2, 0.3, 0.4, 0.5, 0.6]), (*shape, 4, 4))
    found = ik.inverse(ik.KR210, T)
    assert found.q.shape == (*shape, 8, 6)
    assert found.valid.shape == found.in_limits.shape == (*shape, 8)
    assert found.singular.shape == (*shape, 8, 3)
    assert found.valid.all()


def test_lists_and_other_layouts_are_taken():
    _, T = random_poses(4)
    want = ik.inverse(ik.KR210, T).q
    for same in (T.tolist(), np.asfortranarray(T), np.repeat(T, 2, axis=0)[::2]):
        assert np.array_equal(ik.inverse(ik.KR210, same).q, want, equal_nan=True)


def test_limits_turn_angles_inside():
    # joint 3 at -200 deg is +160 deg: outside as it is, inside a turn further down
    q = np.array([0.3, 0.2, -200 * DEG, 0.5, 0.7, 0.1])
    T = ik.forward(ik.KR210, q)
    lower, upper = LIMITS
    for found in (ik.inverse(ik.KR210, T, LIMITS), ik.inverse(ik.KR210, T[None], LIMITS)):
        hit = np.abs(found.q - q).max(axis=-1) < 1e-12
        assert hit.sum() == 1
        assert found.in_limits[hit].all()
        assert np.array_equal(found.in_limits, ik.within_limits(found.q, lower, upper))
    plain = ik.inverse(ik.KR210, T)
    assert np.array_equal(plain.in_limits, plain.valid)
    assert np.nanmax(np.abs(plain.q)) <= np.pi


def test_limits_of_a_full_turn_leave_nothing_out():
    T = ik.forward(ik.KR210, np.random.default_rng(5).uniform(-3.0, 3.0, (40, 6)))
    for wide in (np.pi, np.full(6, 7.0), np.full(6, np.inf)):
        got = ik.inverse(ik.KR210, T, (-wide * np.ones(6), wide * np.ones(6)))
        assert np.array_equal(got.q, ik.inverse(ik.KR210, T).q, equal_nan=True)


def test_limits_have_slack():
    q = np.array([0.3, 85 * DEG + 5e-10, -1.0, 0.5, 0.7, 0.1])
    found = ik.inverse(ik.KR210, ik.forward(ik.KR210, q), LIMITS)
    assert (np.abs(found.q - q).max(axis=-1) < 1e-12)[found.in_limits].any()
    q[1] += 1e-8
    found = ik.inverse(ik.KR210, ik.forward(ik.KR210, q), LIMITS)
    assert not (np.abs(found.q - q).max(axis=-1) < 1e-7)[found.in_limits].any()


@pytest.mark.parametrize(
    "limits",
    [
        (np.zeros(5), np.ones(5)),
        (np.ones(6), np.zeros(6)),
        (np.zeros((2, 3)), np.ones((2, 3))),
        (np.full(6, np.nan), np.ones(6)),
    ],
)
def test_bad_limits_are_refused(limits):
    with pytest.raises(ik.IKError, match="limits"):
        ik.inverse(ik.KR210, np.eye(4), limits)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda T: T[:3, :3].__imul__(1.001), "not orthonormal"),
        (lambda T: T[:3, 1].__imul__(-1), "reflection"),
        (lambda T: T.__setitem__((0, 3), np.nan), "not finite"),
        (lambda T: T.__setitem__((1, 1), np.inf), "not finite"),
        (lambda T: T.__setitem__((3, 0), 0.1), "bottom row"),
        (lambda T: T.__setitem__((3, 3), 2.0), "bottom row"),
        (lambda T: T[:3, 0].__iadd__(0.01), "not orthonormal"),
        (lambda T: T[:3, :3].__imul__(0), "not orthonormal"),
        (lambda T: T[:3, :3].__imul__(1e200), "not orthonormal"),
        (lambda T: T[:3, :3].__imul__(np.inf), "not finite"),
    ],
)
def test_what_is_no_pose_is_refused(change, words):
    T = ik.forward(ik.KR210, [0.1, 0.2, 0.3, 0.4, 0.5, 0.6])
    change(T)
    with pytest.raises(ik.InvalidPose, match=words):
        ik.inverse(ik.KR210, T)
    batch = np.tile(np.eye(4), (2, 1500, 1, 1))
    batch[1, 1403] = T
    with pytest.raises(ik.InvalidPose, match=r"T\[1, 1403\].*" + words):
        ik.inverse(ik.KR210, batch)


@pytest.mark.parametrize("change", [1e-3, -1e-3])
@pytest.mark.parametrize("entry", [(i, j) for i in range(3) for j in range(3)])
def test_every_entry_of_a_rotation_is_looked_at(entry, change):
    T = ik.forward(ik.KR210, [0.1, 0.2, 0.3, 0.4, 0.5, 0.6])
    T[entry] += change
    for given in (T, np.stack([np.eye(4), T])):
        with pytest.raises(ik.InvalidPose, match="not orthonormal"):
            ik.inverse(ik.KR210, given)


def test_how_far_a_matrix_is_from_a_rotation_is_told():
    T = ik.forward(ik.KR210, np.zeros(6))
    T[:3, :3] *= 1.5
    with pytest.raises(ik.InvalidPose, match=r"\|R R\^T - I\| = 1.25 .*length \[1.5, 1.5, 1.5\]"):
        ik.inverse(ik.KR210, T)


@pytest.mark.parametrize("shape", [(4,), (3, 4), (2, 4, 3), ()])
def test_wrong_shapes_are_refused(shape):
    with pytest.raises(ik.InvalidPose, match="shape"):
        ik.inverse(ik.KR210, np.zeros(shape))
    with pytest.raises(ik.InvalidPose, match="the tool must have shape"):
        ik.check_poses(np.zeros(shape), "the tool")


def test_no_poses_at_all_are_poses():
    ik.check_poses(np.empty((0, 4, 4)))


def test_poses_kept_as_float32_are_taken():
    T = ik.forward(ik.KR210, [0.1, 0.2, 0.3, 0.4, 0.5, 0.6]).astype(np.float32)
    found = ik.inverse(ik.KR210, T)
    assert found.valid.all()
    assert ik.forward(ik.KR210, found.q) == pytest.approx(np.tile(T, (8, 1, 1)), abs=1e-6)


def test_reach_ends_at_the_named_tolerance():
    out = ik.forward(ik.KR210, np.array([0.4, 0.3, -np.pi / 2 - ik.KR210.constants.phi, 1, 1, 1]))
    shoulder = np.array([0.35 * np.cos(0.4), 0.35 * np.sin(0.4), 0.75])
    outwards = ik.wrist_center(ik.KR210, out) - shoulder
    outwards /= np.linalg.norm(outwards)
    for step, reached in ((-1e-9, True), (0.0, True), (1e-14, True), (1e-12, False), (1e-3, False)):
        T = out.copy()
        T[:3, 3] += step * outwards
        assert ik.inverse(ik.KR210, T).valid[:4].all() == reached
        assert ik.inverse(ik.KR210, T[None]).valid[0, :4].all() == reached


def test_at_the_wrist_singularity_joint_4_is_zero_and_flagged():
    q = np.array([0.2, -0.3, 0.4, 0.9, 0.0, -0.2])
    T = np.eye(4)
    T[:3, 3] = ik.forward(ik.KR210, np.zeros(6))[:3, 3]  # the zero configuration, exactly
    for count in (None, 1, 700):
        found = ik.inverse(ik.KR210, T if count is None else np.tile(T, (count, 1, 1)))
        q_zero = found.q.reshape(-1, 8, 6)[:, 0]
        assert np.abs(q_zero).max() < 1e-15
        assert (found.singular.reshape(-1, 8, 3)[:, 0] == [False, False, True]).all()
    found = ik.inverse(ik.KR210, ik.forward(ik.KR210, q))
    same = np.abs(found.q[:, 3] + found.q[:, 5] - 0.7) < 1e-9
    assert (found.singular[:, 2] & same).any()


def test_on_axis_1_joint_1_is_free_and_flagged():
    T = np.eye(4)
    T[:3] = [[0, 0, -1, 0], [0, 1, 0, 0], [1, 0, 0, 2.3]]  # the tool straight up
    for found in (ik.inverse(ik.KR210, T), ik.inverse(ik.KR210, T[None])):
        exists = found.valid.reshape(8)
        assert exists.all()
        assert found.singular.reshape(8, 3)[:, 0].all()
        assert found.q.reshape(8, 6)[:4, 0] == pytest.approx(np.zeros(4))


def test_threads_share_an_arm():
    _, T = random_poses(6000, seed=5)
    want = ik.inverse(ik.KR210, T).q
    with ThreadPoolExecutor(4) as pool:
        for got in pool.map(lambda _: ik.inverse(ik.KR210, T).q, range(8)):
            assert np.array_equal(got, want, equal_nan=True)


def test_the_given_poses_are_left_alone():
    _, T = random_poses(10)
    T.setflags(write=False)
    found = ik.inverse(ik.KR210, T, LIMITS)
    found.q[:] = 0.0  # and the answer belongs to the caller
    assert ik.inverse(ik.KR210, T[0], LIMITS).q.flags.writeable
