"""Denavit-Hartenberg tables: what is derived moves as the chain does, as numbers and formulas."""

from __future__ import annotations

import sys

import numpy as np
import pytest
from ik_arms import KR210, OTHERS, SEVEN_AXES, UR_LIKE, parse_urdf

import ik
from ik.chain import rotation_about

H = np.pi / 2
# alpha_{i-1}, a_{i-1}, d_i, theta_i at zero
MODIFIED = np.array(
    [
        (0, 0, 0.75, 0),
        (-H, 0.35, 0, -H),
        (0, 1.25, 0, 0),
        (-H, -0.054, 1.5, 0),
        (H, 0, 0, 0),
        (-H, 0, 0, 0),
        (0, 0, 0.303, 0),
    ]
)
# alpha_i, a_i, d_i, theta_i at zero
CLASSIC = np.array(
    [
        (-H, 0.35, 0.75, 0),
        (0, 1.25, 0, -H),
        (-H, -0.054, 0, 0),
        (H, 0, 1.5, 0),
        (-H, 0, 0, 0),
        (0, 0, 0.303, 0),
    ]
)
GRIPPER = np.array([[0, 0, 1, 0], [0, -1, 0, 0], [1, 0, 0, 0], [0, 0, 0, 1]])
"""Rz(pi) Ry(-pi/2): from the last frame to gripper_link."""


def table(rows: np.ndarray, convention: str) -> ik.DH:
    alpha, a, d, theta = rows.T
    return ik.DH(alpha=alpha, a=a, d=d, theta=theta, convention=convention, T_tool=GRIPPER)


def test_the_table_of_the_course_is_derived():
    chain = parse_urdf(KR210)
    dh = ik.dh_from_chain(chain.origins, chain.axes)
    derived = np.column_stack([dh.alpha, dh.a, dh.d, dh.theta])
    assert np.array_equal(derived, MODIFIED)
    assert np.array_equal(dh.T_base, np.eye(4))
    assert np.array_equal(dh.T_tool, GRIPPER)


@pytest.mark.parametrize(
    ("rows", "convention"), [(MODIFIED, "modified"), (CLASSIC, "classic")], ids=["mod", "classic"]
)
def test_the_kr210_is_read_off_either_table(rows, convention):
    dh = table(rows, convention)
    arm = ik.from_dh(dh)
    q = np.random.default_rng(0).uniform(-3, 3, (100, 6))
    assert np.abs(dh.forward(q) - ik.forward(ik.KR210, q)).max() < 5e-15
    assert np.abs(ik.forward(arm, q) - ik.forward(ik.KR210, q)).max() < 5e-15


def test_rounding_of_a_right_angle_does_not_reach_the_table():
    chain = parse_urdf(KR210)
    exact = ik.dh_from_chain(chain.origins, chain.axes)
    origins = chain.origins.copy()
    joint = int(np.flatnonzero(chain.axes.any(axis=1))[1])
    origins[joint, :3, :3] = origins[joint, :3, :3] @ rotation_about(np.eye(3)[0], 4e-15)[:3, :3]
    found = ik.dh_from_chain(origins, chain.axes)
    assert found.alpha.tolist() == exact.alpha.tolist()
    assert set(np.abs(found.alpha)) == {0.0, np.pi / 2}
    assert found.theta.tolist() == exact.theta.tolist()


def test_signs_of_a_table_are_kept():
    dh = table(MODIFIED, "modified")
    signs = (1, -1, 1, -1, -1, 1)
    turned = ik.DH(
        alpha=dh.alpha, a=dh.a, d=dh.d, theta=dh.theta, signs=signs, T_base=GRIPPER, T_tool=GRIPPER
    )
    arm = ik.from_dh(turned)
    q = np.random.default_rng(1).uniform(-3, 3, (50, 6))
    assert np.abs(ik.forward(arm, q) - turned.forward(q)).max() < 5e-15
    assert np.abs(turned.forward(q) - GRIPPER @ dh.forward(q * signs)).max() < 5e-15


@pytest.mark.parametrize("text", [KR210, *OTHERS.values(), UR_LIKE, SEVEN_AXES])
def test_derived_tables_move_as_their_chains_do(text):
    chain = parse_urdf(text)
    dh = ik.dh_from_chain(chain.origins, chain.axes)
    q = np.random.default_rng(2).uniform(-3, 3, (100, len(dh.signs)))
    assert np.abs(dh.forward(q) - chain.forward(q)).max() < 5e-14


def test_tables_of_random_chains_move_as_the_chains_do():
    rng = np.random.default_rng(3)
    for n in (1, 2, 3, 6, 9):
        origins = np.tile(np.eye(4), (n, 1, 1))
        for T in origins:
            T[:3, :3] = np.linalg.qr(rng.normal(size=(3, 3)))[0]
            T[:3, :3] *= np.linalg.det(T[:3, :3])
            T[:3, 3] = rng.normal(size=3)
        axes, tip = rng.normal(size=(n, 3)), origins[0]
        dh = ik.dh_from_chain(origins, axes, tip)
        q = rng.uniform(-3, 3, (20, n))
        want = ik.chain_frames(origins, axes, q)[:, -1] @ tip
        assert np.abs(dh.forward(q) - want).max() < 1e-11


def test_transforms_multiply_up_to_the_pose():
    dh = table(MODIFIED, "modified")
    q = np.array([0.1, 0.2, 0.3, 0.4, 0.5, 0.6])
    steps = dh.transforms(q)
    assert steps.shape == (7, 4, 4)
    T = np.linalg.multi_dot([dh.T_base, *steps, dh.T_tool])
    assert np.abs(T - ik.forward(ik.KR210, q)).max() < 5e-15


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"a": [0.0]}, "a must be 7 finite numbers"),
        ({"d": [np.nan] * 7}, "d must be 7 finite numbers"),
        ({"signs": (1, 1, 0, 1, 1, 1)}, "signs"),
        ({"signs": (1,) * 8}, "signs"),
        ({"convention": "craig"}, "convention must be"),
        ({"T_tool": np.eye(4) * 2}, "T_tool"),
    ],
)
def test_bad_tables_are_refused(change, words):
    alpha, a, d, theta = MODIFIED.T
    with pytest.raises(ik.IKError, match=words):
        ik.DH(**({"alpha": alpha, "a": a, "d": d, "theta": theta} | change))


def test_wrong_numbers_of_angles_are_refused():
    with pytest.raises(ik.IKError, match="q must have shape"):
        table(MODIFIED, "modified").transforms(np.zeros(7))
    with pytest.raises(ik.IKError, match="no moving joint"):
        ik.dh_from_chain(np.eye(4)[None], np.zeros((1, 3)))


@pytest.mark.parametrize(("rows", "convention"), [(MODIFIED, "modified"), (CLASSIC, "classic")])
def test_formulas_agree_with_the_numbers(rows, convention):
    sympy = pytest.importorskip("sympy")
    dh = table(rows, convention)
    formulas = ik.dh_formulas(dh)
    assert len(formulas) == len(rows) + 2
    q = np.array([0.1, -0.2, 0.3, -0.4, 0.5, -0.6])
    values = dict(zip(sympy.symbols("q1:7"), q, strict=True))
    steps = [np.array(T.subs(values).evalf(), dtype=float) for T in formulas]
    assert np.abs(np.stack(steps[1:-1]) - dh.transforms(q)).max() < 1e-14
    assert np.abs(np.linalg.multi_dot(steps) - ik.forward(ik.KR210, q)).max() < 5e-15


def test_angles_that_are_no_part_of_a_turn_are_written_as_numbers():
    sympy = pytest.importorskip("sympy")
    rows = np.vstack([(0.3, 0.2, 0.1, 0.7), MODIFIED[1:]])
    dh = table(rows, "modified")
    T_0_1 = ik.dh_formulas(dh)[1].subs("q1", 0.25).evalf()
    assert np.abs(np.array(T_0_1, dtype=float) - dh.transforms([0.25] * 6)[0]).max() < 1e-15
    assert "pi" not in sympy.sstr(ik.dh_formulas(dh)[1])


def test_without_sympy_formulas_say_how_to_get_it(monkeypatch):
    monkeypatch.setitem(sys.modules, "sympy", None)
    with pytest.raises(ModuleNotFoundError, match="pip install sympy"):
        ik.pose_formula()


def test_formulas_are_written_without_rounding():
    sympy = pytest.importorskip("sympy")
    T_1_2 = ik.dh_formulas(table(MODIFIED, "modified"))[2]
    text = [sympy.sstr(entry, full_prec=False) for entry in T_1_2[0, :]]
    assert text == ["sin(q2)", "cos(q2)", "0", "0.35"]


def test_the_pose_is_written_from_position_and_angles():
    sympy = pytest.importorskip("sympy")
    T = ik.pose_formula()
    assert T[:3, 3] == sympy.Matrix(sympy.symbols("px py pz"))
    yaw, pitch = sympy.symbols("yaw pitch")
    assert T[0, 0] == sympy.cos(yaw) * sympy.cos(pitch)
