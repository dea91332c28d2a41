"""One solver graded: ten cycles driven through its answers, and every answer judged by itself."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Sequence
from contextlib import closing
from dataclasses import asdict, dataclass, field, replace
from functools import lru_cache
from typing import Any

import numpy as np

import ik
from kr210_sim import __version__
from kr210_sim.arrays import Array
from kr210_sim.config import RunConfig
from kr210_sim.episode_files import silence_mujoco
from kr210_sim.episodes import load_world, plan_episodes, run_episode, setup_of
from kr210_sim.exceptions import BadInput
from kr210_sim.grading.diagnosis import diagnose
from kr210_sim.grading.findings import Finding, Refused
from kr210_sim.grading.foreign import Asked, ForeignSolver, refuse_mistyped
from kr210_sim.grading.poses import Leg, LegMarks, mark_leg, rows_of, summarize_marks
from kr210_sim.grading.source import FRAMES, SCOPES, SolverLimits, SolverSource
from kr210_sim.record import stage_label
from kr210_sim.robot import Robot
from kr210_sim.scene import Scene
from kr210_sim.stats import success_interval

PASS_RATE = 0.8
"""Share of the cycles that the course asked for: 8 of 10."""

PROBES = 24
"""Poses from all over the reach of the arm, asked one by one after the cycles."""

SAME = 1e-6
"""Answers to the same request that differ by less are the same [rad]."""

_STAGES = {
    "course": ("MOVE_TO_PICK", "MOVE_TO_PLACE"),
    "all": ("MOVE_TO_PICK", "APPROACH", "LIFT", "WITHDRAW", "MOVE_TO_PLACE", "LOWER"),
}
"""Scope -> stages in the order in which a cycle asks for them."""


@dataclass(frozen=True, kw_only=True)
class GradeConfig:
    """How solvers are graded.

    Attributes:
        cycles, seed: of the run, as in RunConfig.
        scope: where the solver is asked, one of `source.SCOPES`.
        frame: whose poses it is sent.
        limits: what it may use.
    """

    cycles: int = 10
    seed: int = 0
    scope: str = SCOPES[0]
    frame: str = FRAMES[0]
    limits: SolverLimits = field(default_factory=SolverLimits)

    def __post_init__(self) -> None:
        """Check the options.

        Raises:
            BadInput: naming the option and the remedy.
        """
        self.run_config()
        if not 1 <= self.cycles <= 1000:
            raise BadInput(f"--cycles: {self.cycles} is out of range; give 1 to 1000")
        for option, value, known in (
            ("--frame", self.frame, FRAMES),
            ("--ik-scope", self.scope, SCOPES),
        ):
            if value not in known:
                raise BadInput(f"{option}: no '{value}'; give one of {', '.join(known)}")

    def run_config(self) -> RunConfig:
        """Return the options of the cycles."""
        return RunConfig(cycles=self.cycles, seed=self.seed)

    def as_json(self) -> dict[str, Any]:
        """Return the options as plain JSON values."""
        return asdict(self)


@dataclass(frozen=True, kw_only=True)
class Evidence:
    """All requests that were answered, for a diagnosis.

    Attributes:
        legs: (T_base_palm (N, 4, 4), q_start (6,), q (N, 6)) of each leg, in order.
        probe_poses: (M, 4, 4) poses from all over the reach of the arm.
        probe_answers: (M, 6) a row of NaN where there was no answer.
    """

    legs: Sequence[tuple[Array, Array, Array]]
    probe_poses: Array
    probe_answers: Array


@dataclass(kw_only=True)
class Grade:
    """What became of a solver.

    Attributes:
        content: `grade.json`.
        marks: of every leg.
        evidence: for a diagnosis.
    """

    content: dict[str, Any]
    marks: list[LegMarks]
    evidence: Evidence


OnCycle = Callable[[dict[str, Any]], None]


def grade(
    source: SolverSource, config: GradeConfig, *, on_cycle: OnCycle = lambda line: None
) -> Grade:
    """Grade a solver; whatever is wrong with it is in the result, but a mistyped function is not.

    Args:
        source: where it is.
        config: the options.
        on_cycle: called with every cycle as it is finished.

    Raises:
        BadInput: if the function that `source` names is not there.
    """
    scene = _scene(config.run_config())
    grading = _Grading(source, config, scene)
    with closing(grading.solver):
        loaded = grading.load()
        if loaded:
            grading.drive(on_cycle)
            grading.ask_again()
            grading.probe()
        return grading.result()


@lru_cache(maxsize=1)
def _scene(config: RunConfig) -> Scene:
    silence_mujoco()
    return load_world(config)


class _Grading:
    """The steps of grading one solver."""

    def __init__(self, source: SolverSource, config: GradeConfig, scene: Scene) -> None:
        self._config, self._scene = config, scene
        self._legs: list[Leg] = []
        self._cycles: list[dict[str, Any]] = []
        self._findings: list[Finding] = []
        self._requests = 0  # of the cycle under way
        self._about: dict[str, Any] = {}
        self._probe_poses = _probe_poses(scene.robot)
        self._probe_answers = np.full((PROBES, 6), np.nan)
        self.solver = ForeignSolver(
            source,
            scene.robot,
            frame=config.frame,
            limits=config.limits,
            on_asked=self._note,
        )

    def load(self) -> bool:
        """Load the solver; tell whether it can be asked."""
        try:
            self._observe()
        except Refused as refused:
            refuse_mistyped(self.solver.source, refused)
            self._findings.append(refused.finding)
            return False
        return True

    def _observe(self) -> None:
        process = self.solver.load()
        self._about = {
            "form": process.form,
            "language": process.language,
            "isolation": process.kept,
        }

    def drive(self, on_cycle: OnCycle) -> None:
        """Run the cycles."""
        config, run_config = self._config, self._config.run_config()
        common = setup_of(run_config, self._scene, self.solver)
        setup = replace(common, scope=config.scope)
        for episode in plan_episodes(run_config, self._scene):
            for score in run_episode(self._scene, episode, setup, mass=run_config.mass):
                line = score.as_json()
                self._cycles.append(line)
                self._requests = 0
                on_cycle(line)

    def _note(self, asked: Asked) -> None:
        stages = _STAGES[self._config.scope]
        stage = stages[min(self._requests, len(stages) - 1)]
        self._requests += 1
        self._legs.append(Leg(cycle=len(self._cycles), stage=stage, asked=asked))
        if asked.finding is not None and all(
            (known.kind, known.line) != (asked.finding.kind, asked.finding.line)
            for known in self._findings
        ):
            self._findings.append(asked.finding)

    def ask_again(self) -> None:
        """Ask for the first leg once more: the same request has the same answer."""
        answered = [leg.asked for leg in self._legs if leg.asked.finding is None]
        if not answered:
            return
        first = answered[0]
        again = self.solver.ask(first.T_base_palm, first.q_start)
        if again.finding is not None and again.finding.kind in ("timeout", "not_tried"):
            self._findings.append(again.finding)
            return
        if again.finding is not None:
            apart = again.finding.detail
        else:
            largest = float(np.nanmax(np.abs(again.q - first.q), initial=0.0))
            if largest <= SAME:
                return
            apart = f"an angle differs by {largest:.3g} rad"
        detail = f"the same request was answered otherwise the second time: {apart}"
        self._findings.append(Finding(kind="changed", detail=detail))

    def probe(self) -> None:
        """Ask for poses from all over the reach of the arm, one by one."""
        for index, T in enumerate(self._probe_poses):
            answer = self.solver.ask(T[None], np.zeros(6))
            if answer.finding is not None and answer.finding.kind in ("not_tried", "timeout"):
                return
            if len(answer.q):
                self._probe_answers[index] = answer.q[0]

    def result(self) -> Grade:
        """Return what was found."""
        config, robot = self._config, self._scene.robot
        source = self.solver.source
        marks = [mark_leg(robot, leg) for leg in self._legs]
        succeeded = sum(bool(line["success"]) for line in self._cycles)
        evidence = Evidence(
            legs=[
                (leg.asked.T_base_palm[: len(leg.asked.q)], leg.asked.q_start, leg.asked.q)
                for leg in self._legs
                if len(leg.asked.q)
            ],
            probe_poses=self._probe_poses,
            probe_answers=self._probe_answers,
        )
        content = {
            "schema_version": 1,
            "version": __version__,
            "name": source.name,
            "solver": source.text,
            "sha256": checksum(source),
            "options": config.as_json(),
            **self._about,
            "cycles": config.cycles,
            "succeeded": succeeded,
            "success_rate": succeeded / config.cycles,
            "ci95": list(success_interval(succeeded, config.cycles)),
            "pass_rate": PASS_RATE,
            "passed": succeeded >= PASS_RATE * config.cycles,
            "findings": [finding.as_json() for finding in self._findings],
            "unsolved": _is_constant(self._legs),
            "diagnoses": self._diagnoses(evidence),
            "figures": summarize_marks(marks),
            "probes": self._probes(robot),
            "limits_rad": {"lower": robot.lower.tolist(), "upper": robot.upper.tolist()},
            "results": self._cycles,
            "output": self.solver.output.decode("utf-8", "replace"),
            "output_bytes": self.solver.output_bytes,
            "seconds": config.limits.time_limit - self.solver.seconds_left,
            "poses": [row for mark in marks for row in rows_of(mark)],
        }
        return Grade(content=content, marks=marks, evidence=evidence)

    def _diagnoses(self, evidence: Evidence) -> list[dict[str, str]]:
        """Return which known mistakes explain the answers."""
        robot = self._scene.robot
        found = diagnose(
            evidence.legs,
            robot.lower,
            robot.upper,
            probes=(evidence.probe_poses, evidence.probe_answers),
            arm=robot.geometry,
            frame=self._config.frame,
            names=[
                f"cycle {leg.cycle}, {stage_label(leg.stage)}"
                for leg in self._legs
                if len(leg.asked.q)
            ],
        )
        return [diagnosis.as_json() for diagnosis in found]

    def _probes(self, robot: Robot) -> dict[str, Any]:
        """Return how the solver does on poses from all over the reach of the arm."""
        answered = np.all(np.isfinite(self._probe_answers), axis=1)
        reached = ik.forward(robot.geometry, self._probe_answers[answered])[:, :3, 3]
        error = np.linalg.norm(reached - self._probe_poses[answered, :3, 3], axis=1)
        return {
            "asked": PROBES,
            "answered": int(answered.sum()),
            "within_1_mm": int((error < 1e-3).sum()),
        }


def checksum(source: SolverSource) -> str | None:
    """Return the SHA-256 of the solver's file, None for a module."""
    if source.file is None:
        return None
    return hashlib.sha256(source.file.read_bytes()).hexdigest()


def _is_constant(legs: Sequence[Leg]) -> bool:
    """Tell whether every pose got the same answer, as from a template that is not filled in."""
    answers = [leg.asked.q for leg in legs if len(leg.asked.q)]
    if not answers:
        return False
    q = np.concatenate(answers)
    return len(q) > 1 and bool(np.all(q == q[0]))


def _probe_poses(robot: Robot) -> Array:
    """Return palm poses (PROBES, 4, 4) that the arm reaches within its limits, the same always."""
    rng = np.random.default_rng(210)
    q = rng.uniform(robot.lower, robot.upper, (20 * PROBES, 6))
    poses = ik.forward(robot.geometry, q)
    above = poses[:, 2, 3] > 0.2
    return poses[above][:PROBES]
