"""A solver in a process of its own, as planning calls it; what goes wrong is a finding."""

from __future__ import annotations

import contextlib
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from kr210_sim.arrays import Array
from kr210_sim.exceptions import BadInput, CycleFailure
from kr210_sim.grading.findings import Finding, Refused
from kr210_sim.grading.process import KEPT_OUTPUT, Answer, SolverProcess
from kr210_sim.grading.source import SolverLimits, SolverSource
from kr210_sim.robot import Robot

MAX_STARTS = 3
"""A process that was lost is started again for the next request, up to this many in all."""


@dataclass(frozen=True, kw_only=True)
class Asked:
    """A request and what came of it.

    Attributes:
        T_base_palm: (N, 4, 4) the poses asked for.
        q_start: (6,) where the arm stood [rad].
        q: (n, 6) the first n answers [rad].
        seconds: (n,) of each [s].
        finding: why there are no more answers, or None.
    """

    T_base_palm: Array
    q_start: Array
    q: Array
    seconds: Array
    finding: Finding | None


class ForeignSolver:
    """A `tracks.Solver` whose code runs elsewhere.

    Attributes:
        seconds_left: of the time limit [s].
        output: the beginning of what it printed, `output_bytes` how much it was.

    Args:
        source: the file or module.
        robot: its joints, and its frames.
        frame: whose poses it is sent: "gripper_link" (the palm) or "link_6".
        limits: what it may use.
        on_asked: called after every request.
    """

    def __init__(
        self,
        source: SolverSource,
        robot: Robot,
        *,
        frame: str = "gripper_link",
        limits: SolverLimits | None = None,
        on_asked: Callable[[Asked], None] = lambda asked: None,
    ) -> None:
        self.source = source
        self._limits = limits or SolverLimits()
        self._joints = (*robot.arm_joints, robot.finger_joint, robot.mimic_joint)
        self._T_palm_asked = (
            np.linalg.inv(robot.chain.T_last_palm) if frame == "link_6" else np.eye(4)
        )
        self._on_asked = on_asked
        self._process: SolverProcess | None = None
        self._refused: Finding | None = None
        self.seconds_left = self._limits.time_limit
        self.output, self.output_bytes = b"", 0
        self._starts = 0

    def __call__(self, T_base_palm: Array, q_start: Array) -> Array:
        """Return the answers (N, 6) [rad], NaN rows for no answer.

        Raises:
            CycleFailure: bad_ik, with the finding.
        """
        answer = self.ask(T_base_palm, q_start)
        self._on_asked(
            Asked(
                T_base_palm=T_base_palm,
                q_start=q_start,
                q=answer.q,
                seconds=answer.seconds,
                finding=answer.finding,
            )
        )
        if answer.finding is not None:
            raise CycleFailure("bad_ik", answer.finding.text(self.source.name))
        return answer.q

    def load(self) -> SolverProcess:
        """Start the process, unless it runs.

        Raises:
            Refused: if it cannot be loaded, now or ever before, or was lost too often.
        """
        if self._refused is not None:
            raise Refused(self._refused)
        if self._process is None:
            self._starts += 1
            try:
                self._process = SolverProcess(
                    self.source, self._limits, joints=self._joints, time_limit=self.seconds_left
                )
            except Refused as refused:
                self._refused = refused.finding
                raise
        return self._process

    def ask(self, T_base_palm: Array, q_start: Array) -> Answer:
        """Ask for palm poses (N, 4, 4); what goes wrong is in the answer."""
        try:
            process = self.load()
        except Refused as refused:
            return Answer(q=np.empty((0, 6)), seconds=np.empty(0), finding=refused.finding)
        answer = process.ask(T_base_palm @ self._T_palm_asked, q_start)
        self.seconds_left = process.seconds_left
        self._take_output(process)
        if not process.alive:
            self.close()
            if self.seconds_left <= 0.0 or self._starts >= MAX_STARTS:
                why = "no time is left" if self.seconds_left <= 0.0 else "it was lost too often"
                self._refused = Finding(kind="not_tried", detail=f"not asked any more: {why}")
        return answer

    def close(self) -> None:
        """End its process."""
        if self._process is not None:
            self._take_output(self._process)
            with contextlib.suppress(OSError):
                self._process.close()
            self._process = None

    def _take_output(self, process: SolverProcess) -> None:
        room = max(0, KEPT_OUTPUT - len(self.output))
        self.output += process.output[:room]
        self.output_bytes += process.output_bytes
        process.output, process.output_bytes = b"", 0


def refuse_mistyped(source: SolverSource, refused: Refused) -> None:
    """Tell the user that the function which was named is not there: that is no fault of a solver.

    Raises:
        BadInput: if it is that for which the solver was refused.
    """
    if source.function is not None and refused.finding.kind == "not_found":
        raise BadInput(f"SOLVER: {refused.finding.text(source.name)}") from refused
