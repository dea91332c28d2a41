"""A Denavit-Hartenberg table as formulas, with sympy (the `symbolic` extra)."""

from __future__ import annotations

import math
from typing import Any

from .dh import DH

PI_DIGITS = 1e-9
"""Angles this close to a multiple of pi/12 are written as one [rad]."""


def dh_formulas(dh: DH) -> list[Any]:
    """Write the transform of each row of a table as a sympy matrix in q1, q2, ...

    Args:
        dh: The table.

    Returns:
        T_base_0, then T_{i-1,i} for each row, then T_n_tool: n + 2 sympy matrices (4, 4). Their
        product is the pose of the tool in the base frame. `sympy.sstr(T, full_prec=False)` prints
        0.35 as 0.35.

    Raises:
        ModuleNotFoundError: sympy is not installed; the message says how to get it.
    """
    sympy = _sympy()
    result = [_matrix(dh.T_base)]
    for i in range(len(dh.alpha)):
        theta = _angle(dh.theta[i])
        if i < len(dh.signs):
            theta = dh.signs[i] * sympy.Symbol(f"q{i + 1}") + theta
        spin = _turn(theta, 2) * _shift(dh.d[i], 2)
        twist = _turn(_angle(dh.alpha[i]), 0) * _shift(dh.a[i], 0)
        result.append(twist * spin if dh.convention == "modified" else spin * twist)
    return [*result, _matrix(dh.T_tool)]


def pose_formula() -> Any:
    """Write T_base_tool from the tool's pose alone, as the course asked.

    Returns:
        The sympy matrix (4, 4) of position px, py, pz and the rotation
        Rz(yaw) Ry(pitch) Rx(roll).

    Raises:
        ModuleNotFoundError: sympy is not installed; the message says how to get it.
    """
    sympy = _sympy()
    px, py, pz, roll, pitch, yaw = sympy.symbols("px py pz roll pitch yaw")
    T = sympy.eye(4)
    T[:3, 3] = sympy.Matrix([px, py, pz])
    return T * _turn(yaw, 2) * _turn(pitch, 1) * _turn(roll, 0)


def _sympy() -> Any:
    """Import sympy where it is used, since `ik` itself needs numpy alone."""
    try:
        import sympy  # type: ignore[import-not-found, import-untyped, unused-ignore]
    except ModuleNotFoundError as error:
        raise ModuleNotFoundError(
            "formulas need sympy: pip install 'kr210-sim[symbolic]', or pip install sympy"
        ) from error
    return sympy


def _number(x: float) -> Any:
    """Write a length without rounding noise, integers as such."""
    sympy = _sympy()
    x = round(float(x), 12)
    return sympy.Integer(int(x)) if x == int(x) else sympy.Float(repr(x))


def _angle(x: float) -> Any:
    """Write an angle as a multiple of pi where it is one."""
    sympy = _sympy()
    twelfths = round(12.0 * x / math.pi)
    if abs(x - twelfths * math.pi / 12.0) < PI_DIGITS:
        return sympy.Rational(twelfths, 12) * sympy.pi
    return _number(x)


def _turn(angle: Any, k: int) -> Any:
    """Rotate about axis k."""
    sympy = _sympy()
    i, j = (k + 1) % 3, (k + 2) % 3
    T = sympy.eye(4)
    T[i, i] = T[j, j] = sympy.cos(angle)
    T[j, i], T[i, j] = sympy.sin(angle), -sympy.sin(angle)
    return T


def _shift(length: float, k: int) -> Any:
    """Move along axis k."""
    T = _sympy().eye(4)
    T[k, 3] = _number(length)
    return T


def _matrix(T: Any) -> Any:
    """Write a fixed transform."""
    return _sympy().Matrix(4, 4, [_number(x) for x in T.ravel()])
