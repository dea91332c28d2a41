"""Early stop: the same cycles and files with any workers, in any order, after any interruption."""

from __future__ import annotations

import json
import random
import time
from functools import partial
from pathlib import Path

import pytest

import kr210_sim.runner
from kr210_sim.config import RunConfig
from kr210_sim.episode_files import Played
from kr210_sim.exceptions import Interrupted
from kr210_sim.proof import SequentialTest, Watch
from kr210_sim.results import read_lines, record_path
from kr210_sim.runner import run

SIZE = 3
TEST = {"min_success": 0.8, "confidence": 0.95, "stop_early": True}
SEED, DECIDED, KEPT = 79, 37, 39
"""After two failures and 37 cycles the rate is proved, one cycle into an episode of three."""

EMPTY = {"mean": None, "p99": None, "max": None}


def line_of(episode, index: int) -> dict:
    """A cycle that follows from its seed: one in eight fails."""
    success = episode.seeds[index] % 8 != 0
    return {
        "cycle": episode.first_cycle + index, "episode": episode.index, "cell": 1,
        "seed": episode.seeds[index], "success": success, "first_try": success,
        "retries": 0, "retried": [],
        "reason": None if success else "dropped", "failed_stage": None if success else "LIFT",
        "failed_time_s": None if success else 1.5, "detail": None if success else "as written",
        "cycle_time_s": 5.0, "motion_time_s": 4.0, "sampled_motions": [], "slowed_to": 1.0,
        "ik_offset_m": EMPTY, "ik_offset_rad": EMPTY, "tracking_offset_m": EMPTY,
        "grasp_slip_m": None, "grasp_slip_rad": None, "place_offset_m": None,
        "min_clearance_m": None, "simulated_s": 5.0, "wall_clock": {},
        "histograms": {
            name: {"zeros": 0, "first": 0, "counts": []}
            for name in ("ik_offset_m", "ik_offset_rad", "tracking_offset_m")
        },
    }  # fmt: skip


def play_here(_config, _scene, episode, out, _onlooker=None):
    """Stand in for `play_episode`, files included."""
    for index in range(len(episode.seeds)):
        record_path(out, episode.first_cycle + index).touch()
        yield line_of(episode, index)
    folder = out / "episodes" / f"{episode.index:04d}"
    (folder / "assets").mkdir(parents=True)
    (folder / "scene.xml").touch()


def play_in_worker(out, episode) -> Played:
    """Stand in for `play_elsewhere`; earlier episodes take longer."""
    time.sleep(0.02 * (-episode.index % 4))
    lines = list(play_here(None, None, episode, out))
    return Played(episode=episode.index, lines=lines, error=None)


def shuffled(order: random.Random, config, out):
    """Return a stand-in for `share_out`: as many tasks at a time, finished in any order."""

    def share_out(_task, items, *, jobs, **_):
        held, items = [], iter(items)
        while True:
            while len(held) < jobs and (item := next(items, None)) is not None:
                held.append(item)
            if not held:
                return
            yield play_in_worker(out, held.pop(order.randrange(len(held))))

    return share_out


@pytest.fixture
def play(monkeypatch, scene, tmp_path):
    """Run with cycles that cost nothing; returns the folder."""
    monkeypatch.setattr(kr210_sim.runner, "load_world", lambda _config: scene)
    monkeypatch.setattr(
        kr210_sim.runner, "_provenance", lambda config, _: {"options": config.as_json()}
    )
    monkeypatch.setattr(kr210_sim.runner, "play_episode", play_here)
    monkeypatch.setattr(time, "sleep", lambda _seconds: None)

    def start(name: str = "run", order: int = 0, on_cycle=lambda line: None, **options) -> Path:
        out = tmp_path / name
        config = RunConfig(
            out=out, **{"cycles": 90, "episode_cycles": SIZE, "seed": SEED} | TEST | options
        )
        share = shuffled(random.Random(order), config, out)
        monkeypatch.setattr(kr210_sim.runner, "share_out", share)
        run(config, on_cycle=on_cycle)
        return out

    return start


def files_of(out: Path) -> dict[str, bytes]:
    return {
        str(path.relative_to(out)): path.read_bytes() if path.suffix == ".jsonl" else b""
        for path in out.rglob("*")
        if not path.is_dir()
    }


def summary_of(out: Path) -> dict:
    clock = {"wall_time_s", "realtime_factor"}
    found = json.loads((out / "summary.json").read_text())
    return {name: value for name, value in found.items() if name not in clock}


def test_a_run_ends_with_the_episode_that_decides(play):
    out = play()
    watch = Watch(SequentialTest.of_gate(0.8, 0.95))
    lines = list(read_lines(out))
    for count, line in enumerate(lines, start=1):
        watch.see(line["success"])
        assert watch.decided == (count >= DECIDED)
    assert sum(not line["success"] for line in lines) == 3  # one of them after the verdict
    assert [line["cycle"] for line in lines] == list(range(KEPT))
    summary = summary_of(out)
    assert (summary["complete"], summary["stopped_early"], summary["passed"]) == (True, True, True)
    assert (summary["cycles"], summary["requested_cycles"]) == (KEPT, 90)
    assert summary["gates"]["min_success"]["proof"]["decided_after"] == DECIDED


@pytest.mark.parametrize("order", range(3))
@pytest.mark.parametrize("jobs", [2, 40])
def test_any_workers_in_any_order_leave_the_same_cycles_and_files(play, jobs, order):
    alone = play("alone")
    shared = play("shared", jobs=jobs, order=order)
    assert files_of(shared) == files_of(alone)
    assert summary_of(shared) == summary_of(alone)
    assert {f"cycles/{cycle:04d}.npz" for cycle in range(KEPT)} < files_of(alone).keys()


@pytest.mark.parametrize("jobs", [1, 4])
@pytest.mark.parametrize("count", [1, 20, 38])
def test_an_interrupted_run_goes_on_to_the_same_bits(play, jobs, count):
    seen = []

    def interrupt(line):
        seen.append(line)
        if len(seen) == count:
            raise KeyboardInterrupt

    with pytest.raises(Interrupted):
        play(on_cycle=interrupt, jobs=jobs, order=1)
    assert not summary_of(play("alone").parent / "run")["passed"]
    for path in (play("alone2").parent / "run" / "episodes").glob("*"):  # as a kill leaves it
        (path / "assets").rmdir()
        (path / "scene.xml").unlink()
        path.rmdir()
    out = play(resume=True, jobs=jobs, order=2)
    assert (out / "cycles.jsonl").read_bytes() == (out.parent / "alone/cycles.jsonl").read_bytes()
    assert summary_of(out) == summary_of(out.parent / "alone")


def test_a_run_that_is_decided_is_resumed_without_a_cycle(play):
    before = files_of(play())
    assert files_of(play(resume=True, on_cycle=lambda line: pytest.fail("needless"))) == before


def test_files_that_a_kill_left_of_unneeded_episodes_go(play):
    out = play()
    before = files_of(out)
    record_path(out, 44).touch()
    (out / "episodes" / "0014").mkdir()
    assert files_of(play(resume=True)) == before
    assert not (out / "episodes" / "0014").exists()


def test_a_stricter_gate_goes_on_and_a_longer_run_keeps_what_it_has(play):
    out = play()
    first = (out / "cycles.jsonl").read_bytes()
    play(resume=True, confidence=0.99)
    assert (out / "cycles.jsonl").read_bytes().startswith(first)
    assert len(list(read_lines(out))) > KEPT
    whole = play("whole", stop_early=False, confidence=None, min_success=0.8)
    before = (whole / "cycles.jsonl").read_bytes()
    play("whole", resume=True)
    assert (whole / "cycles.jsonl").read_bytes() == before
    summary = summary_of(whole)
    assert (summary["cycles"], summary["stopped_early"]) == (90, False)
    assert summary["gates"]["min_success"]["proof"]["decided_after"] == DECIDED


def test_a_run_too_short_to_be_decided_is_complete_and_has_not_passed(play):
    summary = summary_of(play(cycles=10))
    assert (summary["complete"], summary["stopped_early"]) == (True, False)
    assert not summary["passed"]
    proof = summary["gates"]["min_success"]["proof"]
    assert (proof["verdict"], proof["decided_after"]) == ("undecided", None)
    assert proof["cycles_if_all_succeed"] > 10


def in_worker(task, _config, out, episode):
    return task(out, episode)


@pytest.mark.slow
@pytest.mark.parametrize("jobs", [2, 3])
def test_real_workers_leave_the_same_cycles_and_files(play, monkeypatch, scene, tmp_path, jobs):
    alone = play("alone")
    from kr210_sim.workers import share_out

    monkeypatch.setattr(kr210_sim.runner, "share_out", share_out)
    task = partial(in_worker, play_in_worker)
    monkeypatch.setattr(kr210_sim.runner, "play_elsewhere", task)
    config = RunConfig(
        out=tmp_path / "shared", cycles=90, episode_cycles=SIZE, seed=SEED, jobs=jobs, **TEST
    )
    run(config)
    assert files_of(config.out) == files_of(alone)
    assert summary_of(config.out) == summary_of(alone)
