"""CycleRecord -> CycleScore: the eight conditions of success, and the first cause of a failure."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from kr210_sim.arrays import Array
from kr210_sim.criteria import (
    CONDITIONS,
    EFFORT_RATIO_LIMIT,
    HOME_SLACK,
    LIFT_HEIGHT_LIMIT,
    POSITION_SLACK,
    REST_TIME,
    SLIP_LIMIT,
    SPEED_RATIO_LIMIT,
)
from kr210_sim.gripper import PAD_FRICTION
from kr210_sim.record import FREE_STAGES, MOTION_STAGES, STAGES, CycleRecord, Event
from kr210_sim.stats import histogram, spread

_CARRYING = frozenset({"LIFT", "WITHDRAW", "MOVE_TO_PLACE", "LOWER"})


@dataclass(frozen=True, kw_only=True)
class CycleScore:
    """The verdict on one cycle.

    Attributes:
        conditions: name -> whether it holds, all of `criteria.CONDITIONS`; None if nothing moved.
            `lifted` and `held` are those of the last attempt at the grasp, the others of all.
        cause: the first cause of the failure in the last attempt, None on success.
        retried: attempts that were given up for another, as `cycles.jsonl` has them.
        cycle_time_s: from leaving home to the return to it [s], None if it did not return.
        motion_time_s: time in the motion stages [s].
        grasp_slip_m, grasp_slip_rad: largest from lift-off to release in the last attempt; None if
            never lifted.
        grasp: how well the target was held meanwhile, see `_grasp`; None if never lifted.
        place_offset_m: horizontal distance of the resting target from its planned release point.
        ik_offset_m, ik_offset_rad: (N,) of every solved pose.
        tracking_offset_m: (n,) largest of every record step in motion.
        record: identity of the cycle and its wall clock come from here.
    """

    conditions: dict[str, bool | None]
    cause: Event | None
    retried: list[dict[str, Any]]
    cycle_time_s: float | None
    motion_time_s: float | None
    grasp_slip_m: float | None
    grasp_slip_rad: float | None
    grasp: dict[str, Any] | None
    place_offset_m: float | None
    ik_offset_m: Array
    ik_offset_rad: Array
    tracking_offset_m: Array
    record: CycleRecord

    @property
    def min_clearance_m(self) -> float | None:
        """Least clearance of the motions outside cell and place volume [m], None without a plan."""
        found = self.record.clearance_m
        return min((found[stage] for stage in FREE_STAGES & found.keys()), default=None)

    @property
    def success(self) -> bool:
        """Whether all conditions hold and no event cut the cycle short."""
        return self.cause is None

    def as_json(self) -> dict[str, Any]:
        """Return the line of `cycles.jsonl`; what does not exist is None."""
        record, cause = self.record, self.cause
        return {
            "cycle": record.cycle,
            "episode": record.episode,
            "seed": record.seed,
            "cell": record.cell,
            "target": record.target,
            "drawn": record.drawn,
            "success": self.success,
            "first_try": self.success and not self.retried,
            "retries": len(self.retried),
            "retried": self.retried,
            "failed_stage": cause.stage if cause else None,
            "reason": cause.reason if cause else None,
            "failed_time_s": cause.time if cause else None,
            "detail": cause.detail if cause else None,
            **self.conditions,
            "cycle_time_s": self.cycle_time_s,
            "motion_time_s": self.motion_time_s,
            "sampled_motions": list(record.sampled_motions),
            "slowed_to": record.slowed_to,
            "ik_offset_m": spread(self.ik_offset_m, "mean", "p99", "max"),
            "ik_offset_rad": spread(self.ik_offset_rad, "mean", "p99", "max"),
            "tracking_offset_m": spread(self.tracking_offset_m, "mean", "p99", "max"),
            "grasp_slip_m": self.grasp_slip_m,
            "grasp_slip_rad": self.grasp_slip_rad,
            "grasp": self.grasp,
            "place_offset_m": self.place_offset_m,
            "min_clearance_m": self.min_clearance_m,
            "clearance_m": record.clearance_m,
            "simulated_s": float(record.series["time"][-1]) if record.series else 0.0,
            "histograms": {
                "ik_offset_m": histogram(self.ik_offset_m),
                "ik_offset_rad": histogram(self.ik_offset_rad),
                "tracking_offset_m": histogram(self.tracking_offset_m),
            },
            "wall_clock": record.wall_clock,
        }


def score_cycle(record: CycleRecord, *, time_limit: float) -> CycleScore:
    """Judge a cycle by its record alone.

    Args:
        record: of the cycle, complete or cut short by a failure.
        time_limit: of the scene, for the whole cycle [s].
    """
    series, final = record.series, record.final
    if not series:  # it failed before anything moved
        untried: dict[str, bool | None] = dict.fromkeys(CONDITIONS)
        return _score(record, untried, _first_cause(record, untried))
    last = _attempt(record, len(record.retries))
    carrying = _carrying(record, last)
    conditions: dict[str, bool | None] = {
        "lifted": _lifted(record, last),
        "held": bool(
            carrying.any()
            and np.all(series["fingers_touch"][carrying] == 1)
            and np.max(series["slip_m_max"][last]) < SLIP_LIMIT
        ),
        "clean": bool(np.max(series["foreign_contacts_max"]) == 0),
        "within_limits": bool(
            np.max(series["position_excess_max"]) <= POSITION_SLACK
            and np.max(series["speed_ratio_max"]) <= SPEED_RATIO_LIMIT
            and np.max(series["effort_ratio_max"]) < EFFORT_RATIO_LIMIT
        ),
        "released": final["fingers_open"] == 1 and final["finger_contacts"] == 0,
        "placed": bool(
            final["resting_for"] >= REST_TIME
            and final["in_place_volume"] == 1
            and final["supported"] == 1
        ),
        "returned": record.home_time is not None and final["home_distance"] <= HOME_SLACK,
        "in_time": record.home_time is not None and record.home_time <= time_limit,
    }
    return _score(record, conditions, _first_cause(record, conditions))


def _attempt(record: CycleRecord, index: int) -> NDArray[np.bool_]:
    """Return the record steps (n,) of an attempt, until it was given up if it was."""
    time, retries = record.series["time"], record.retries
    begin = retries[index - 1].until if index else 0.0
    end = retries[index].event.time if index < len(retries) else np.inf
    return (time > (np.inf if begin is None else begin)) & (time <= end)


def _carrying(record: CycleRecord, attempt: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return its record steps (n,) from the lift at the height that counts to release or end."""
    clear = attempt & (record.series["clear_height_max"] >= LIFT_HEIGHT_LIMIT)
    lifted = np.arange(len(clear)) >= (int(np.argmax(clear)) if clear.any() else len(clear))
    return attempt & lifted & record.stage_mask(_CARRYING)


def _lifted(record: CycleRecord, attempt: NDArray[np.bool_]) -> bool:
    """Tell whether the target was held clear at the height that counts in an attempt."""
    return bool(np.any(record.series["clear_height_max"][attempt] >= LIFT_HEIGHT_LIMIT))


def _retried(record: CycleRecord) -> list[dict[str, Any]]:
    """Return the attempts that were given up, as `cycles.jsonl` has them."""
    found = []
    for index, retry in enumerate(record.retries):
        event = retry.event
        lifted = _lifted(record, _attempt(record, index))
        found.append(
            {
                "reason": event.reason,
                "stage": event.stage,
                "time_s": event.time,
                "detail": event.detail,
                "lifted": lifted,
                "until_s": retry.until,
                "drawn": retry.drawn,
            }
        )
    return found


def _first_cause(record: CycleRecord, conditions: dict[str, bool | None]) -> Event | None:
    """Return the earliest event, or the first condition that fails at the end; None on success."""
    if record.events:
        return min(record.events, key=lambda event: event.time)
    if all(conditions.values()):
        return None
    name = next(name for name, holds in conditions.items() if not holds)
    time = float(record.series["time"][-1])
    stage = STAGES[int(record.series["stage"][-1])]
    return Event(reason=CONDITIONS[name], stage=stage, time=time, detail=f"{name} is false")


def _score(
    record: CycleRecord, conditions: dict[str, bool | None], cause: Event | None
) -> CycleScore:
    series = record.series
    moving = record.stage_mask(MOTION_STAGES) if series else np.zeros(0, dtype=bool)
    last = _attempt(record, len(record.retries)) if series else np.zeros(0, dtype=bool)
    lifted = conditions["lifted"]
    offset = None
    if record.p_base_release is not None and conditions["placed"]:
        final = np.array([record.final["target_x"], record.final["target_y"]])
        offset = float(np.linalg.norm(final - record.p_base_release[:2]))
    return CycleScore(
        conditions=conditions,
        cause=cause,
        retried=_retried(record),
        cycle_time_s=record.home_time,
        motion_time_s=_motion_time(record, moving) if record.home_time is not None else None,
        grasp_slip_m=float(np.max(series["slip_m_max"][last])) if lifted else None,
        grasp_slip_rad=float(np.max(series["slip_rad_max"][last])) if lifted else None,
        grasp=_grasp(record, last),
        place_offset_m=offset,
        ik_offset_m=record.ik_offset_m,
        ik_offset_rad=record.ik_offset_rad,
        tracking_offset_m=series["tracking_max"][moving] if series else np.empty(0),
        record=record,
    )


def _grasp(record: CycleRecord, attempt: NDArray[np.bool_]) -> dict[str, Any] | None:
    """Return how well a target was held from the height that counts to the release, if it was.

    Returns:
        slip_rate_um_s: slip over the time it took [um/s].
        grip_force_n: least and mean force of the finger that presses less [N].
        contacts: least number of contact points of a finger.
        slip_margin: least share of friction that was left, 1 - |F_t| / (mu |F_n|), a finger's force
            across the jaws being F_n and along them F_t, as if they were flat; a V holds more.
            Sampled at every record step, like the force.
    """
    series = record.series
    if not series or not (carrying := _carrying(record, attempt)).any():
        return None
    steps = np.diff(series["time"], prepend=0.0)[carrying]
    force = np.min(series["finger_force"][carrying], axis=1)
    friction = float(record.drawn.get("pad_friction", PAD_FRICTION))
    return {
        "slip_rate_um_s": 1e6 * float(np.max(series["slip_m_max"][attempt]) / np.sum(steps)),
        "grip_force_n": {"min": float(np.min(force)), "mean": float(np.mean(force))},
        "contacts": int(np.min(series["finger_contacts_min"][carrying])),
        "slip_margin": 1.0 - float(np.max(series["friction_ratio"][carrying])) / friction,
    }


def _motion_time(record: CycleRecord, moving: NDArray[np.bool_]) -> float:
    steps = np.diff(record.series["time"], prepend=0.0)
    return float(np.sum(steps[moving]))
