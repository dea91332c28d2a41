"""The package `angles`: differences and normal forms of angles [rad]."""

from __future__ import annotations

import math


def normalize_angle_positive(angle: float) -> float:
    """Return the same angle in [0, 2 pi)."""
    return float(angle) % (2.0 * math.pi)


def normalize_angle(angle: float) -> float:
    """Return the same angle in (-pi, pi]."""
    positive = normalize_angle_positive(angle)
    return positive - 2.0 * math.pi if positive > math.pi else positive


def shortest_angular_distance(from_angle: float, to_angle: float) -> float:
    """Return the turn, in (-pi, pi], that leads from one angle to another."""
    return normalize_angle(to_angle - from_angle)


def two_pi_complement(angle: float) -> float:
    """Return the angle that is the same the other way round."""
    if abs(angle) > 2.0 * math.pi:
        angle = math.fmod(angle, 2.0 * math.pi)
    return angle + 2.0 * math.pi if angle < 0 else angle - 2.0 * math.pi


def from_degrees(degrees: float) -> float:
    """Return an angle in radians."""
    return math.radians(degrees)


def to_degrees(radians: float) -> float:
    """Return an angle in degrees."""
    return math.degrees(radians)


d2r, r2d = from_degrees, to_degrees
