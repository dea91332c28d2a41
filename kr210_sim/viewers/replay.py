"""A recorded cycle in motion: any time of it, played at a pace or sought by hand."""

from __future__ import annotations

import threading
import time
from dataclasses import dataclass, replace
from pathlib import Path

import mujoco
import numpy as np

from kr210_sim.arrays import Array
from kr210_sim.exceptions import BadInput
from kr210_sim.film.take import Take, read_take
from kr210_sim.playback import place_joints
from kr210_sim.results import finished_cycles, record_path, world_path
from kr210_sim.scene import ROBOT_PREFIX
from kr210_sim.viewers.live import Moment, Screen
from kr210_sim.viewers.pace import Pace

_FRAME = 1.0 / 30.0
"""Least real time between two pictures [s]."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Replay:
    """A recorded cycle with the world it took place in.

    Attributes:
        take: the record.
        model: with all targets of the episode.
        start: (nq,) in which the cycle began.
    """

    take: Take
    model: mujoco.MjModel
    start: Array

    def qpos(self, at: float) -> Array:
        """Return qpos (nq,) at a time since the start of the cycle [s]."""
        qpos = self.start.copy()
        values = self.take.at("qpos", at)
        if values is not None:
            place_joints(self.model, qpos, self.take.joints, values)
        return qpos

    def moment(self, at: float) -> Moment:
        """Return what is said at a time [s]; the verdict, once it is known."""
        score = self.take.score
        known = at >= self.take.verdict_time
        verdict = "success" if score["success"] else f"{score['reason']}"
        return Moment(
            cycle=self.take.cycle,
            stage=self.take.stage(at),
            time=at,
            note=verdict if known else "",
        )


def load_replay(out: Path, cycle: int | None) -> Replay:
    """Load the record of a cycle.

    Args:
        out: folder of the run.
        cycle: index in the run; None for the first that has a record.

    Raises:
        BadInput: if there is no such cycle, or it has no record.
    """
    lines = finished_cycles(out, cycle)
    kept = [line for line in lines if record_path(out, line["cycle"]).is_file()]
    if not kept:
        raise BadInput(f"{out}: has no record of any cycle; run with --record all")
    score = next((line for line in kept if cycle in (None, line["cycle"])), None)
    if score is None:
        first = kept[0]["cycle"]
        raise BadInput(f"--cycle: cycle {cycle} has no record; the first that has one is {first}")
    before = [line for line in lines if line["cycle"] < score["cycle"]]
    succeeded = sum(bool(line["success"]) for line in before)
    path = world_path(out, score["episode"])
    try:
        take = read_take(out, score, cycles=len(lines), succeeded=succeeded)
        model = mujoco.MjModel.from_xml_path(str(path))
        start = np.array(model.key(f"cycle_{score['cycle']:04d}").qpos)
    except (OSError, ValueError, KeyError) as error:
        reason = " ".join(str(error).split())
        raise BadInput(f"{out}: record or world of cycle {score['cycle']}: {reason}") from error
    return Replay(take=take, model=model, start=start)


class Player:
    """Plays a replay on a screen; any thread may seek.

    Args:
        replay: what to play.
        screen: where to.
        pace: pause, stages and speed.
    """

    def __init__(self, replay: Replay, screen: Screen, pace: Pace) -> None:
        self._replay, self._screen, self._pace = replay, screen, pace
        screen.load(replay.model, ROBOT_PREFIX)
        self._lock = threading.Lock()
        self._time = 0.0
        self._sought: float | None = None

    @property
    def time(self) -> float:
        """What is shown, since the start of the cycle [s]."""
        return self._time

    def seek(self, at: float) -> None:
        """Go to a time [s]; it is kept within the record."""
        with self._lock:
            self._sought = float(np.clip(at, 0.0, self._replay.take.duration))
        self._pace.jump()

    def play(self, *, pictures: int | None = None) -> None:
        """Play on until nobody watches any more, standing still at the end of the record.

        Args:
            pictures: end after so many of them, for tests.
        """
        shown = 0
        while not self._pace.ended and (pictures is None or shown < pictures):
            started = time.monotonic()
            self._show()
            at, duration = self._time, self._replay.take.duration
            shown += 1
            longest = max(_FRAME, time.monotonic() - started)
            step = min(at + longest * self._pace.speed, duration)
            if at >= duration:
                self._pace.pause()
                step = 0.0  # once it goes on
            self._pace.hold(self._replay.take.stage(step), step, idle=self._idle)
            with self._lock:
                if self._sought is None and self._time == at:  # nobody has sought meanwhile
                    self._sought = step

    def _idle(self) -> None:
        with self._lock:
            waiting = self._sought is not None
        if waiting:
            self._show()
        self._screen.idle()

    def _show(self) -> None:
        with self._lock:
            if self._sought is not None:
                self._time, self._sought = self._sought, None
            at = self._time
        moment = replace(self._replay.moment(at), still=self._pace.paused)
        self._screen.show(self._replay.qpos(at), moment)
