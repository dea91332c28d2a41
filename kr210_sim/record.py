"""CycleRecord: everything that was commanded and measured in one cycle, in memory and on disk."""

from __future__ import annotations

import json
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from kr210_sim.arrays import Array
from kr210_sim.exceptions import BadInput

if TYPE_CHECKING:
    from kr210_sim.scene import Target

RECORD_STEP = 0.010
"""Interval at which the state is kept [s]; extremes cover every physics step in between."""

STAGES = (
    "MOVE_TO_PICK",
    "APPROACH",
    "CLOSE_GRIPPER",
    "LIFT",
    "WITHDRAW",
    "MOVE_TO_PLACE",
    "LOWER",
    "OPEN_GRIPPER",
    "RETREAT",
    "MOVE_HOME",
    "SETTLE",
    "BACK_OUT",
)
"""The stages of a cycle; SETTLE waits, arm at home, until the target rests. BACK_OUT comes before
another try: the arm stops, opens, goes straight back out of the cell and waits for a new look."""

FREE_STAGES = frozenset({"MOVE_TO_PICK", "MOVE_TO_PLACE", "MOVE_HOME"})
"""Motions outside cell and place volume."""

MOTION_STAGES = frozenset(STAGES) - {"CLOSE_GRIPPER", "OPEN_GRIPPER", "SETTLE"}


def stage_label(stage: str) -> str:
    """Return a stage's name as people write it."""
    return stage.lower().replace("_", " ")


@dataclass(frozen=True, kw_only=True)
class Event:
    """Something that went wrong: a condition broken or a stage that could not go on.

    Attributes:
        reason: one of the closed list of reasons in `score`.
        stage: stage in which it happened.
        time: since the start of the cycle [s].
        detail: bodies, joints or values involved, one clause.
    """

    reason: str
    stage: str
    time: float
    detail: str


@dataclass(kw_only=True)
class Retry:
    """An attempt at the grasp that was given up for another.

    Attributes:
        event: what it failed for, and when the gripper noticed it.
        until: when the next attempt began [s]; None if there was none.
        drawn: quantity -> value of what was drawn for the new look.
    """

    event: Event
    until: float | None = None
    drawn: dict[str, Any] = field(default_factory=dict)


@dataclass(kw_only=True)
class CycleRecord:
    """One cycle as it was planned, commanded, measured; `score.score_cycle` judges it.

    Attributes:
        cycle, episode: indices in the run.
        seed: of this cycle.
        cell: number of the cell the target stood in.
        target: mass [kg], radius and length [m] of the target.
        drawn: quantity -> value of everything random about it, empty without randomisation.
        series: name -> (n, ...) array over record steps; `SERIES` explains each.
        events: of the last attempt in order of time; the first is the cause of a failure.
        retries: attempts that were given up for another, in order.
        final: name -> number at the end of the cycle; null where it was not reached.
        p_base_release: (3,) planned release point of the last attempt, or None without a plan.
        sampled_motions: stages whose path comes from the sampling planner.
        ik_tcp: (N, 7) the poses that the IK was asked for, as `POINTS` explains.
        ik_offset_m, ik_offset_rad: (N,) offsets of the answers.
        clearance_m: stage -> least clearance of its motion as it was timed [m], at most
            `criteria.CLEARANCE_CAP`; empty without a plan.
        slowed_to: speed of the slowest motion over that which its joints allow.
        home_time: when the arm was back at home [s], or None.
        wall_clock: everything that depends on the machine's clock [s].
        start: joint name -> its part of `qpos` at the beginning of the cycle, in order of `qpos`.
    """

    cycle: int
    episode: int
    seed: int
    cell: int
    target: dict[str, float]
    drawn: dict[str, Any] = field(default_factory=dict)
    series: dict[str, Array] = field(default_factory=dict)
    events: list[Event] = field(default_factory=list)
    retries: list[Retry] = field(default_factory=list)
    final: dict[str, float] = field(default_factory=dict)
    p_base_release: Array | None = None
    sampled_motions: tuple[str, ...] = ()
    ik_tcp: Array = field(default_factory=lambda: np.empty((0, 7)))
    ik_offset_m: Array = field(default_factory=lambda: np.empty(0))
    ik_offset_rad: Array = field(default_factory=lambda: np.empty(0))
    clearance_m: dict[str, float] = field(default_factory=dict)
    slowed_to: float | None = None
    home_time: float | None = None
    wall_clock: dict[str, float] = field(default_factory=dict)
    start: dict[str, Array] = field(default_factory=dict)

    def stage_mask(self, stages: frozenset[str]) -> NDArray[np.bool_]:
        """Return which record steps (n,) belong to the stages named."""
        indices = [index for index, stage in enumerate(STAGES) if stage in stages]
        return np.isin(self.series["stage"], indices)


def unplayed_record(target: Target, *, cycle: int, episode: int, seed: int) -> CycleRecord:
    """Return the record of a cycle of which nothing but its identity and target is known."""
    return CycleRecord(
        cycle=cycle,
        episode=episode,
        seed=seed,
        cell=target.cell,
        target={"mass_kg": target.mass, "radius_m": target.radius, "length_m": target.length},
    )


SERIES = {
    "time": "since the start of the cycle [s], at the end of the record step",
    "stage": "index into STAGES",
    "qpos": "MuJoCo's qpos [m, rad]",
    "ctrl": "actuator commands [rad, m]",
    "tcp_commanded": "position [m] and quat_wxyz in the base frame",
    "tcp_measured": "position [m] and quat_wxyz in the base frame",
    "tracking_max": "largest distance of measured from commanded TCP [m]",
    "finger_force": "net contact force of the right and left finger on the target [N]",
    "grip_force": "the same forces as vectors of the world frame, right then left [N]",
    "friction_ratio": "its part along the jaws over its part across them, right and left finger",
    "fingers_touch": "1 if the right, left finger touched the target at every physics step",
    "finger_contacts_min": "least number of contact points of the right and left finger",
    "clear_height_max": "largest height [m] above rest with both fingers and nothing else touching",
    "slip_m_max": "largest shift of the target in the TCP frame since lift-off [m]",
    "slip_rad_max": "largest turn of the target in the TCP frame since lift-off [rad]",
    "position_excess_max": "largest excess of a joint position over its limit [rad]",
    "speed_ratio_max": "largest joint speed over its limit",
    "effort_ratio_max": "largest joint effort, gravity compensation included, over its limit",
    "target_speed_max": "largest speed of the target [m/s]",
    "target_spin_max": "largest angular speed of the target [rad/s]",
    "foreign_contacts_max": "largest number of contacts that are not permitted",
}
"""What each series of a record holds."""

POINTS = {
    "ik_tcp": "requested position [m] and quat_wxyz of the TCP in the base frame",
    "ik_offset_m": "distance of MuJoCo's own TCP at the answered angles from it [m]",
    "ik_offset_rad": "angle between them [rad]",
}
"""What a record holds of each pose the IK solved: the lines of the pick, then of the place."""


def record_arrays(record: CycleRecord) -> dict[str, Any]:
    """Return what is kept of a record: series and points as float32, joint and stage names."""
    points = {name: getattr(record, name) for name in POINTS}
    arrays: dict[str, Any] = {
        name: values.astype(np.float32) for name, values in (record.series | points).items()
    }
    arrays["stage_names"] = np.array(STAGES)
    arrays["joint_names"] = np.array(list(record.start))
    arrays["drawn"] = np.array(json.dumps(record.drawn, allow_nan=False))
    arrays["joint_widths"] = np.array([len(values) for values in record.start.values()])
    return arrays


def save_record(record: CycleRecord, path: Path) -> None:
    """Write a record to an .npz file."""
    arrays = record_arrays(record)
    path.parent.mkdir(parents=True, exist_ok=True)
    with path.open("wb") as file:
        np.savez_compressed(file, **arrays)


def load_series(path: Path, *names: str) -> dict[str, Any]:
    """Read what `save_record` wrote.

    Args:
        path: of the record.
        names: of what is read; everything without any.

    Raises:
        BadInput: naming the file, if it is damaged.
    """
    try:
        with np.load(path) as archive:
            return {name: archive[name] for name in archive.files if name in names or not names}
    except Exception as error:  # what wrong bytes end in: errors of zip, zlib, tokenize and more
        raise BadInput(f"{path} is damaged, or missing; run its cycle again") from error
