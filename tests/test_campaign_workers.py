"""Campaigns: any number of workers, any interruption, the same bits; failures are never lost."""

from __future__ import annotations

import os
import random
import signal
import subprocess
import sys
import time
from functools import partial
from pathlib import Path

import pytest
from campaigns import bits_of, summary_of, without_clock

import kr210_sim.episode_files
import kr210_sim.runner
from kr210_sim.config import RunConfig
from kr210_sim.resources import resource
from kr210_sim.runner import run

ROOT = Path(__file__).parent.parent


@pytest.fixture(scope="module")
def hasty(tmp_path_factory) -> Path:
    """The bundled scene with a time limit that no cycle can keep, so that cycles are short."""
    path = tmp_path_factory.mktemp("hasty") / "hasty.xml"
    text = resource("scenes", "shelf_and_bin.xml").read_text()
    path.write_text(text.replace('"time_limit" data="60"', '"time_limit" data="0.05"'))
    return path


@pytest.fixture(scope="module")
def far(tmp_path_factory) -> Path:
    """The bundled scene with every cell out of reach, so that cycles cost next to nothing."""
    path = tmp_path_factory.mktemp("far") / "far.xml"
    text = resource("scenes", "shelf_and_bin.xml").read_text()
    moved = text.replace('name="robot_base" pos="0 0 0"', 'name="robot_base" pos="-9 0 0"')
    assert moved != text
    path.write_text(moved)
    return path


@pytest.fixture(scope="module")
def whole(hasty, tmp_path_factory) -> Path:
    """An undisturbed run of nine cycles in five episodes, in one process."""
    out = tmp_path_factory.mktemp("whole") / "run"
    run(RunConfig(scene=str(hasty), out=out, cycles=9, episode_cycles=2, min_success=0.0))
    return out


def files_of(out: Path) -> set[str]:
    return {str(path.relative_to(out)) for path in out.rglob("*") if path.is_file()}


@pytest.mark.slow
def test_two_workers_give_the_bits_and_the_files_of_one(whole, hasty, tmp_path):
    shown: list[int] = []
    config = RunConfig(
        scene=str(hasty), out=tmp_path / "run", cycles=9, episode_cycles=2, jobs=2, min_success=0.0
    )
    _, summary = run(config, on_cycle=lambda line: shown.append(line["cycle"]))
    assert bits_of(config.out) == bits_of(whole)
    assert files_of(config.out) == files_of(whole)
    assert without_clock(summary) == without_clock(summary_of(whole))
    assert shown == list(range(9))
    for name in sorted(files_of(whole)):
        if name.endswith((".npz", "scene.xml")):
            assert (config.out / name).read_bytes() == (whole / name).read_bytes(), name


@pytest.mark.slow
@pytest.mark.parametrize("jobs", [1, 2])
def test_a_run_killed_at_any_moment_goes_on_to_the_bits_of_an_undisturbed_one(
    whole, hasty, tmp_path, jobs
):
    command = [
        sys.executable, str(ROOT / "run_cycles.py"), "--scene", str(hasty), "--cycles", "9",
        "--episode-cycles", "2", "--jobs", str(jobs), "--out", str(tmp_path / "run"), "--resume",
        "--min-success", "0",
    ]  # fmt: skip
    draw = random.Random(jobs)
    for _ in range(3):
        running = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        try:
            running.wait(timeout=draw.uniform(2.0, 12.0))
        except subprocess.TimeoutExpired:
            running.kill()
            running.wait()
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert bits_of(tmp_path / "run") == bits_of(whole)
    assert without_clock(summary_of(tmp_path / "run")) == without_clock(summary_of(whole))


@pytest.mark.slow
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM], ids=lambda number: number.name)
def test_an_interrupt_is_exit_130_and_keeps_what_is_finished(hasty, tmp_path, number):
    out = tmp_path / "run"
    command = [
        sys.executable, str(ROOT / "run_cycles.py"), "--scene", str(hasty), "--cycles", "400",
        "--episode-cycles", "1", "--jobs", "2", "--out", str(out),
    ]  # fmt: skip
    running = subprocess.Popen(
        command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True,
        start_new_session=True,
    )  # fmt: skip
    deadline = time.monotonic() + 120
    while not (out / "cycles.jsonl").exists():
        assert time.monotonic() < deadline
        time.sleep(0.1)
    for _ in range(3):  # to the whole group, as a terminal does, and impatiently
        os.killpg(running.pid, number)
        time.sleep(0.05)
    _, err = running.communicate(timeout=60)
    assert running.returncode == 130
    assert err.count("\n") == 1, err
    summary = summary_of(out)
    assert not summary["complete"]
    assert summary["requested_cycles"] == 400
    assert 1 <= summary["cycles"] == len(bits_of(out)) < 400
    assert summary["lost_workers"] == []


def lose_worker(deaths: int, mark: Path, config, out, episode):
    """Play an episode in a worker that is killed, in episode 1, as often as given."""
    marks = len(list(mark.iterdir()))
    if episode.index == 1 and marks < deaths:
        (mark / str(marks)).touch()
        os.kill(os.getpid(), signal.SIGKILL)
    return kr210_sim.episode_files.play_elsewhere(config, out, episode)


@pytest.mark.slow
@pytest.mark.parametrize("deaths", [1, 2])
def test_a_worker_that_dies_costs_a_retry_and_twice_its_episode(far, tmp_path, monkeypatch, deaths):
    (tmp_path / "mark").mkdir()
    task = partial(lose_worker, deaths, tmp_path / "mark")
    monkeypatch.setattr(kr210_sim.runner, "play_elsewhere", task)
    config = RunConfig(scene=str(far), out=tmp_path / "run", cycles=8, episode_cycles=2, jobs=2)
    _, summary = run(config)
    lines = bits_of(tmp_path / "run")
    assert [line["cycle"] for line in lines] == list(range(8))
    lost = [line["cycle"] for line in lines if line["reason"] == "simulation_diverged"]
    assert lost == ([2, 3] if deaths == 2 else [])
    assert {line["reason"] for line in lines if line["cycle"] not in lost} == {"unreachable"}
    assert [(loss["episode"], loss["attempt"]) for loss in summary["lost_workers"]] == [
        (1, attempt + 1) for attempt in range(deaths)
    ]
    assert "signal 9" in summary["lost_workers"][0]["cause"]
    present = {path.name for path in (tmp_path / "run" / "cycles").iterdir()}
    assert present == {f"{line['cycle']:04d}.npz" for line in lines if line["cycle"] not in lost}


@pytest.mark.slow
@pytest.mark.parametrize(
    ("record", "kept"), [("all", {0, 1, 2}), ("failed", {0, 1, 2}), ("none", set())]
)
def test_records_are_kept_of_the_cycles_asked_for(far, tmp_path, record, kept):
    out, _ = run(
        RunConfig(scene=str(far), out=tmp_path / "run", cycles=3, episode_cycles=2, record=record)
    )
    assert {int(path.stem) for path in (out / "cycles").iterdir()} == kept
    worlds = {path.parent.name for path in out.glob("episodes/*/scene.xml")}
    assert worlds == {f"{cycle // 2:04d}" for cycle in kept}
    assert len(bits_of(out)) == 3


@pytest.mark.slow
def test_of_cycles_that_succeed_failed_keeps_nothing(tmp_path):
    out, summary = run(RunConfig(out=tmp_path / "run", cycles=1, cell="5", record="failed"))
    assert summary["succeeded"] == 1
    assert files_of(out) == {"config.json", "cycles.jsonl", "summary.json"}


@pytest.mark.slow
def test_dasks_workers_give_the_bits_of_one_process(whole, hasty, tmp_path):
    pytest.importorskip("distributed", reason="the extra cluster is not installed")
    program = (
        "import sys\n"
        "from kr210_sim.cli import main\n"
        "if __name__ == '__main__':\n"
        "    sys.exit(main(sys.argv[1:]))\n"
    )
    (tmp_path / "main.py").write_text(program)
    command = [
        sys.executable, str(tmp_path / "main.py"), "run", "--scene", str(hasty), "--cycles", "9",
        "--episode-cycles", "2", "--jobs", "2", "--backend", "dask", "--min-success", "0",
        "--out", str(tmp_path / "run"),
    ]  # fmt: skip
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert bits_of(tmp_path / "run") == bits_of(whole)
    assert files_of(tmp_path / "run") == files_of(whole)
