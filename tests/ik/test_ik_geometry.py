"""Recognising arms: from chains and tables, and refusing what is no arm of the class."""

from __future__ import annotations

import numpy as np
import pytest
from ik_arms import KR210, OTHERS, SEVEN_AXES, UR_LIKE, X, Y, Z, parse_urdf, turn_about, urdf

import ik


def random_rotation(rng: np.random.Generator) -> np.ndarray:
    Q, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    return Q * np.linalg.det(Q)


def random_pose(rng: np.random.Generator) -> np.ndarray:
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = random_rotation(rng), rng.normal(size=3)
    return T


def random_arm(rng: np.random.Generator) -> ik.Arm:
    return ik.Arm(
        a1=rng.uniform(-0.5, 0.5),
        b=rng.choice([0.0, 0.2]),
        d1=rng.normal(),
        L2=rng.uniform(0.3, 1.3),
        a3=rng.choice([0.0, -0.1, 0.2]),
        d4=rng.uniform(0.3, 1.5),
        signs=tuple(rng.choice([-1, 1], 6)),
        offsets=tuple(rng.uniform(-3, 3, 6)),
        T_base=random_pose(rng),
        T_tool=random_pose(rng),
    )


def disguised(arm: ik.Arm, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The same arm as a chain of random frames: turned, shifted along axes, of any axis length."""
    frames = ik.link_frames(arm, np.zeros(6))
    own = np.eye(3)[[2, 1, 1, 0, 1, 0]]
    origins, axes, before = [], [], np.eye(4)
    for j in range(6):
        direction = frames[j, :3, :3] @ own[j] * arm.signs[j]
        frame = np.eye(4)
        frame[:3, :3] = random_rotation(rng)
        frame[:3, 3] = frames[j, :3, 3] + direction * rng.normal()
        origins.append(np.linalg.inv(before) @ frame)
        axes.append(frame[:3, :3].T @ direction * rng.uniform(0.5, 2.0))
        before = frame
    return np.array(origins), np.array(axes), np.linalg.inv(before) @ frames[6]


def test_kr210_is_read_off_its_description():
    chain = parse_urdf(KR210)
    assert ik.from_chain(chain.origins, chain.axes) == ik.KR210


def test_kr210_has_the_lengths_of_the_dh_table():
    arm = ik.KR210
    assert (arm.a1, arm.d1, arm.L2, arm.a3, arm.d4, arm.b) == (0.35, 0.75, 1.25, -0.054, 1.5, 0.0)
    assert arm.T_tool[:3, 3].tolist() == [0.303, 0.0, 0.0]
    assert np.array_equal(arm.T_base, np.eye(4))


@pytest.mark.parametrize("name", OTHERS)
def test_other_arms_move_as_their_descriptions_do(name):
    chain = parse_urdf(OTHERS[name])
    arm = ik.from_chain(chain.origins, chain.axes, name=name)
    q = np.random.default_rng(0).uniform(-3, 3, (300, 6))
    assert np.abs(ik.forward(arm, q) - chain.forward(q)).max() < 1e-14
    assert arm.name == name


def test_the_lateral_offset_is_found():
    chain = parse_urdf(OTHERS["lateral offset"])
    assert ik.from_chain(chain.origins, chain.axes).b == pytest.approx(0.12)


def test_any_frames_along_the_axes_give_the_same_arm():
    rng = np.random.default_rng(4)
    for _ in range(25):
        arm = random_arm(rng)
        found = ik.from_chain(*disguised(arm, rng))
        q = rng.uniform(-3, 3, (40, 6))
        T = ik.forward(arm, q)
        assert np.abs(ik.forward(found, q) - T).max() < 5e-14
        back = ik.inverse(found, T)
        assert back.valid.any(axis=1).all()
        assert np.nanmax(np.abs(ik.forward(arm, back.q) - T[:, None])) < 5e-14


@pytest.mark.parametrize("flipped", [None, *range(6)])
@pytest.mark.parametrize("a1", [0.0, 0.3])
def test_an_axis_that_points_the_other_way_changes_its_sign_and_nothing_else(a1, flipped):
    signs = tuple(-1 if joint == flipped else 1 for joint in range(6))
    arm = ik.Arm(a1=a1, d1=0.5, L2=1.0, a3=0.1, d4=1.2, signs=signs)
    found = ik.from_chain(*disguised(arm, np.random.default_rng(6)))
    assert found.signs == signs
    lengths = [(one.a1, one.b, one.d1, one.L2, one.a3, one.d4) for one in (found, arm)]
    assert lengths[0] == pytest.approx(lengths[1], abs=1e-14)
    assert found.offsets == pytest.approx((0.0,) * 6, abs=1e-14)
    assert np.abs(np.stack([found.T_base, found.T_tool]) - np.eye(4)).max() < 1e-14


def test_fixed_joints_are_folded_in_wherever_they_are():
    chain = parse_urdf(KR210)
    rng = np.random.default_rng(5)
    origins, axes = [], []
    for origin, axis in zip(chain.origins, chain.axes, strict=True):
        detour = random_pose(rng)
        origins += [origin @ detour, np.linalg.inv(detour)]
        axes += [np.zeros(3), axis]
    arm = ik.from_chain(origins, axes)
    q = rng.uniform(-3, 3, (50, 6))
    assert np.abs(ik.forward(arm, q) - ik.forward(ik.KR210, q)).max() < 2e-14


def test_the_tip_moves_the_tool():
    chain = parse_urdf(KR210)
    tip = random_pose(np.random.default_rng(6))
    q = np.array([0.1, 0.2, 0.3, 0.4, 0.5, 0.6])
    arm = ik.from_chain(chain.origins, chain.axes, tip)
    assert np.abs(ik.forward(arm, q) - ik.forward(ik.KR210, q) @ tip).max() < 1e-14


def refusal(text: str, **tolerances: float) -> str:
    chain = parse_urdf(text)
    with pytest.raises(ik.UnsupportedArm) as error:
        ik.from_chain(chain.origins, chain.axes, **tolerances)
    assert error.value.reasons
    return str(error.value)


def test_a_ur_is_refused_for_its_wrist():
    message = refusal(UR_LIKE)
    assert "axes 3 and 4 are not perpendicular: 0 deg apart" in message
    assert "axes 4 and 6 meet axis 5 0.095 m apart, not in one point" in message
    assert "tolerance 1e-06 rad and 1e-06 m" in message


def test_seven_axes_are_refused_for_their_number():
    assert "it has 7 moving joints, and the class has six" in refusal(SEVEN_AXES)


KR_JOINTS = [
    ("0 0 0.33", "0 0 0", Z),
    ("0.35 0 0.42", "0 0 0", Y),
    ("0 0 1.25", "0 0 0", Y),
    ("0.96 0 -0.054", "0 0 0", X),
    ("0.54 0 0", "0 0 0", Y),
    ("0.193 0 0", "0 0 0", X),
]


@pytest.mark.parametrize(
    ("joint", "change", "reason"),
    [
        (1, ("0.35 0 0.42", "0 0 0", "0 1 0.01"), "axes 1 and 2 are not perpendicular: 89.42"),
        (2, ("0 0 1.25", "0 0 0", X), "axes 2 and 3 are not parallel: 90 deg apart"),
        (2, ("0 0 0", "0 0 0", Y), "axis 3 lies on axis 2"),
        (3, ("0.96 0 -0.054", "0 0 0", Y), "axes 3 and 4 are not perpendicular: 0 deg"),
        (4, ("0.54 0 0.02", "0 0 0", Y), "axes 4 and 5 do not meet: they pass 0.02 m apart"),
        (4, ("0.54 0 0", "0 0 0", "1 1 0"), "axes 4 and 5 are not perpendicular: 45 deg apart"),
        (4, ("0.54 0 0", "0 0 0", X), "axes 4 and 5 of the wrist are parallel"),
        (5, ("0.193 0 0.003", "0 0 0", X), "axes 5 and 6 do not meet: they pass 0.003 m apart"),
        (5, ("0 0 0.1", "0 0 0", Z), None),
        (5, ("0 0.2 0.1", "0 0 0", Z), "axes 4 and 6 meet axis 5 0.2 m apart"),
    ],
)
def test_reasons_name_axes_and_deviation(joint, change, reason):
    joints = [(*row, -180.0, 180.0) for row in KR_JOINTS]
    joints[joint] = (*change, -180.0, 180.0)
    if reason is None:  # axis 6 across axis 4 is a wrist bent by a right angle, and fine
        chain = parse_urdf(urdf(*joints))
        assert abs(ik.from_chain(chain.origins, chain.axes).offsets[4]) == pytest.approx(np.pi / 2)
    else:
        assert reason in refusal(urdf(*joints))


def test_rounded_angles_need_a_larger_tolerance():
    text = OTHERS["KUKA that folds"].replace(repr(np.pi / 2), "1.5708")
    assert "1.5708" in refusal(text)
    chain = parse_urdf(text)
    arm = ik.from_chain(chain.origins, chain.axes, angle_tolerance=1e-4, length_tolerance=1e-4)
    q = np.random.default_rng(0).uniform(-3, 3, (100, 6))
    assert np.abs(ik.forward(arm, q) - chain.forward(q)).max() < 2e-5


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"axes": np.zeros((7, 3))}, r"got \(8, 4, 4\) and \(7, 3\)"),
        ({"origins": np.zeros((8, 4))}, "want origins"),
        ({"axes": np.full((8, 3), np.nan)}, "axes must be finite"),
        ({"origins": np.ones((8, 4, 4))}, r"origins\[0\] has the bottom row"),
        ({"T_tip": np.eye(3)}, "T_tip"),
        ({"T_tip": -np.eye(4)}, "T_tip"),
    ],
)
def test_arrays_that_are_no_chain_are_refused(change, words):
    chain = parse_urdf(KR210)
    arguments = {"origins": chain.origins, "axes": chain.axes} | change
    with pytest.raises(ik.IKError, match=words):
        ik.from_chain(**arguments)


def test_chain_frames_end_at_the_tool():
    chain = parse_urdf(KR210)
    q = np.random.default_rng(1).uniform(-3, 3, (2, 20, 6))
    frames = ik.chain_frames(chain.origins, chain.axes, q)
    assert frames.shape == (2, 20, 8, 4, 4)
    assert np.abs(frames[..., -1, :, :] - ik.forward(ik.KR210, q)).max() < 5e-15
    with pytest.raises(ik.IKError, match="q must have shape"):
        ik.chain_frames(chain.origins, chain.axes, np.zeros(8))


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"L2": 0.0}, "L2 must be positive"),
        ({"a1": np.nan}, "a1 must be a finite length"),
        ({"d4": 0.0, "a3": 0.0}, "d4 and a3"),
        ({"signs": (1, 1, 1, 1, 1)}, "signs"),
        ({"signs": (1, 1, 1, 1, 1, 2)}, "signs"),
        ({"offsets": (0, 0, 0, 0, 0, np.inf)}, "offsets"),
        ({"T_base": np.eye(3)}, "T_base"),
        ({"T_tool": turn_about(0, 1.0) * 2}, "T_tool"),
    ],
)
def test_geometry_is_checked(change, words):
    with pytest.raises(ik.IKError, match=words):
        ik.Arm(**({"a1": 0.3, "d1": 0.7, "L2": 1.0, "a3": 0.1, "d4": 1.0} | change))


def test_an_arm_is_a_frozen_value():
    arm = ik.Arm(a1=0.35, d1=0.75, L2=1.25, a3=-0.054, d4=1.5, T_tool=ik.KR210.T_tool)
    assert arm == ik.KR210
    assert hash(arm) == hash(ik.KR210)
    assert arm != ik.Arm(a1=0.36, d1=0.75, L2=1.25, a3=-0.054, d4=1.5)
    assert arm != "KR210"
    with pytest.raises(AttributeError):
        arm.a1 = 0.0
    with pytest.raises(ValueError, match="read-only"):
        arm.T_tool[0, 3] = 0.0
