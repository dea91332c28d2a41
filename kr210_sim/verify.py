"""Is a recorded episode what its seed gives? It is simulated again, and the bits are compared."""

from __future__ import annotations

import json
import platform
from contextlib import closing
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

import numpy as np

from kr210_sim import __version__
from kr210_sim.config import FREE, RunConfig
from kr210_sim.episode_files import score_episode, silence_mujoco
from kr210_sim.episodes import load_world, plan_episode
from kr210_sim.options import read_options
from kr210_sim.record import load_series, record_arrays
from kr210_sim.results import CONFIG, CYCLES, finished_cycles, record_path
from kr210_sim.score import CycleScore


@dataclass(frozen=True, kw_only=True)
class Verdict:
    """What came of simulating an episode again.

    Attributes:
        episode: index in the run.
        cycles: that were compared.
        records: how many of them have a record, which was compared, too.
        differences: one line each, naming cycle and field; none if the bits are the same.
        notes: what may explain a difference, e.g. other versions.
    """

    episode: int
    cycles: tuple[int, ...]
    records: int
    differences: tuple[str, ...]
    notes: tuple[str, ...]

    @property
    def same(self) -> bool:
        """Whether every bit is the same."""
        return not self.differences

    def text(self) -> str:
        """Return the verdict as lines."""
        first, last = self.cycles[0], self.cycles[-1]
        what = (
            f"episode {self.episode}, cycles {first} to {last}: simulated again, "
            f"{len(self.cycles)} lines of {CYCLES} and {self.records} records compared"
        )
        verdict = "SAME: every bit, wall_clock apart" if self.same else "DIFFERENT"
        return "\n".join([what, *self.notes, *self.differences, verdict])


def verify(out: Path, cycle: int | None) -> Verdict:
    """Simulate the episode of a cycle again, and compare its lines and records.

    Args:
        out: folder of the run.
        cycle: index in the run; None for the first.

    Raises:
        BadInput: if the folder is no run, a record of it is damaged, or what it was run with is not
            there any more.
    """
    lines = {int(line["cycle"]): line for line in finished_cycles(out, cycle)}
    cycle = next(iter(lines)) if cycle is None else cycle
    episode_index = int(lines[cycle]["episode"])
    recorded = {index: line for index, line in lines.items() if line["episode"] == episode_index}
    options = read_options(out / CONFIG)
    ours = options.keys() - (FREE - {"cycles"})  # no film, no page, no workers
    config = RunConfig(**{name: options[name] for name in ours})
    silence_mujoco()
    scene = load_world(config)
    episode = plan_episode(config, scene, episode_index)
    differences: list[str] = []
    compared: list[int] = []
    records = 0
    with closing(score_episode(config, scene, episode)) as scores:
        for score in scores:
            index = score.record.cycle
            if index not in recorded:
                break  # of a run that broke off in this episode
            compared.append(index)
            differences += _line_differences(recorded[index], score)
            path = record_path(out, index)
            if path.is_file():
                records += 1
                differences += _record_differences(path, score)
    return Verdict(
        episode=episode_index,
        cycles=tuple(compared),
        records=records,
        differences=tuple(differences),
        notes=_other_versions(out),
    )


def _line_differences(recorded: dict[str, Any], score: CycleScore) -> list[str]:
    again = json.loads(json.dumps(score.as_json(), allow_nan=False))
    names = sorted((recorded.keys() | again.keys()) - {"wall_clock"})
    return [
        f"cycle {score.record.cycle}: {name} was {recorded.get(name)!r:.60}, "
        f"is {again.get(name)!r:.60}"
        for name in names
        if name not in recorded or name not in again or recorded[name] != again[name]
    ]


def _record_differences(path: Path, score: CycleScore) -> list[str]:
    recorded, again = load_series(path), record_arrays(score.record)
    where = f"cycle {score.record.cycle}: record:"
    differences = []
    for name in sorted(recorded.keys() | again.keys()):
        was, now = recorded.get(name), again.get(name)
        if was is None or now is None or was.shape != now.shape or was.dtype != now.dtype:
            differences.append(f"{where} {name} has another form")
        elif was.tobytes() != now.tobytes():
            differences.append(f"{where} {name} differs{_first_difference(was, now)}")
    return differences


def _first_difference(was: np.ndarray[Any, Any], now: np.ndarray[Any, Any]) -> str:
    if not was.ndim:
        return ""
    rows = np.flatnonzero((was != now).reshape(len(was), -1).any(axis=1))
    return f" from step {rows[0]} on" if len(rows) else ""


def _other_versions(out: Path) -> tuple[str, ...]:
    """Return which versions are others than when the run was made."""
    try:
        recorded = json.loads((out / CONFIG).read_text(encoding="utf-8")).get("versions", {})
    except (OSError, ValueError, AttributeError):
        return ()
    own = {"kr210-sim": __version__, "python": platform.python_version()}
    notes = []
    for name, was in recorded.items():
        try:
            now = own.get(name) or version(name)
        except PackageNotFoundError:
            now = None
        if was != now:
            notes.append(f"note: {name} was {was}, is {now}")
    return tuple(notes)
