"""The numbers that decide success, and the closed list of reasons for a failure."""

from __future__ import annotations

LIFT_HEIGHT_LIMIT = 0.010
"""`lifted`: held clear at least this far above the rest height [m]."""

SLIP_LIMIT = 0.005
"""`held`: shift in the TCP frame from lift-off to release stays below this [m]."""

POSITION_SLACK = 1e-4
"""`within_limits`: a joint may pass its limit by this much [rad]."""

SPEED_RATIO_LIMIT = 1.02
"""`within_limits`: largest joint speed over its limit."""

EFFORT_RATIO_LIMIT = 0.99
"""`within_limits`: joint effort over its limit from which the motor counts as saturated."""

JUMP_SLACK = 1e-3
"""A target that moves this much further in one physics step than its speed explains [m] was moved
by something else than forces; no such cycle succeeds."""

CLEARANCE_FREE = 0.02
"""Kept to everything while moving outside the cells, unless another is asked for [m]."""

CLEARANCE_CAP = 0.1
"""The clearance oracle measures no farther [m]: more can be neither asked for nor recorded."""

REST_SPEED = 0.005
"""`placed`: slower than this [m/s]."""

REST_SPIN = 0.05
"""`placed`: turning slower than this [rad/s]."""

REST_TIME = 0.5
"""`placed`: at rest for this long [s]."""

HOME_SLACK = 1e-3
"""`returned`: distance of each joint from the home configuration [rad]."""

CONDITIONS = {
    "lifted": "missed_grasp",
    "held": "dropped",
    "clean": "collision",
    "within_limits": "limits_exceeded",
    "released": "not_released",
    "placed": "outside_bin",
    "returned": "not_home",
    "in_time": "timeout",
}
"""Condition of success -> reason when it does not hold, in the order they are reported."""

REASONS = (
    *CONDITIONS.values(),
    "bad_ik",
    "unreachable",
    "joint_limits",
    "no_path",
    "tracking",
    "simulation_diverged",
)
"""Every reason a cycle can fail for."""
