"""Campaigns: any number of workers, any interruption, the same bits; failures are never lost."""

from __future__ import annotations

import errno
import json
import os
import random
import signal
import subprocess
import sys
import time
import xml.etree.ElementTree as ET
from functools import partial
from pathlib import Path

import pytest

import kr210_sim.episode_files
import kr210_sim.runner
from kr210_sim.cli import main
from kr210_sim.config import RunConfig
from kr210_sim.episodes import episode_targets, plan_episode
from kr210_sim.exceptions import BadInput, Interrupted, NotWritten
from kr210_sim.record import Event, unplayed_record
from kr210_sim.resources import resource
from kr210_sim.results import read_lines
from kr210_sim.runner import run
from kr210_sim.score import score_cycle

ROOT = Path(__file__).parent.parent


def bits_of(out: Path) -> list[dict]:
    """Return what must be the same in every run: all but the clock."""
    lines = list(read_lines(out))
    for line in lines:
        del line["wall_clock"]
    return lines


def summary_of(out: Path) -> dict:
    return json.loads((out / "summary.json").read_text())


def without_clock(summary: dict) -> dict:
    clock = {"wall_time_s", "realtime_factor", "ik_time_s", "plan_time_s", "lost_workers"}
    return {name: value for name, value in summary.items() if name not in clock}


# ---- with cycles that cost nothing ----------------------------------------------------------


def quick_episode(config, scene, episode, _out, _onlooker=None):
    """Stand in for `play_episode`: cycles that follow from their seed alone, without a world."""
    for index, (target, _) in enumerate(episode_targets(scene, episode, config.mass)):
        identity = {"cycle": episode.first_cycle + index, "episode": episode.index}
        record = unplayed_record(target, **identity, seed=episode.seeds[index])
        stage = ("LIFT", "LOWER")[episode.seeds[index] % 2]
        record.events.append(Event(reason="dropped", stage=stage, time=0.5, detail="as written"))
        yield score_cycle(record, time_limit=60.0).as_json()


@pytest.fixture
def quick(monkeypatch, scene, tmp_path):
    """Run with `quick_episode` in the bundled scene; returns the folder."""
    monkeypatch.setattr(kr210_sim.runner, "load_world", lambda _config: scene)
    monkeypatch.setattr(kr210_sim.runner, "play_episode", quick_episode)

    def play(name: str = "run", on_cycle=lambda line: None, **options) -> Path:
        options = {"cycles": 12, "episode_cycles": 4} | options
        run(RunConfig(out=tmp_path / name, **options), on_cycle=on_cycle)
        return tmp_path / name

    return play


def interrupt_after(count: int):
    seen = []

    def stop(line):
        seen.append(line)
        if len(seen) == count:
            raise KeyboardInterrupt

    return stop


def test_a_complete_run_says_so(quick):
    summary = summary_of(quick())
    assert (summary["complete"], summary["requested_cycles"], summary["cycles"]) == (True, 12, 12)


@pytest.mark.parametrize("count", [1, 4, 6, 11])
def test_an_interrupted_run_says_what_it_has_and_goes_on_to_the_same_bits(quick, count):
    with pytest.raises(Interrupted, match=f"{count} of 12 cycles are kept"):
        quick("cut", interrupt_after(count))
    cut = summary_of(quick("whole").parent / "cut")
    assert (cut["complete"], cut["requested_cycles"], cut["cycles"]) == (False, 12, count)
    assert not cut["passed"]
    out = quick("cut", resume=True)
    assert bits_of(out) == bits_of(out.parent / "whole")
    assert without_clock(summary_of(out)) == without_clock(summary_of(out.parent / "whole"))


def test_a_grown_run_is_the_longer_run(quick):
    out = quick("grown", cycles=6)
    quick("grown", cycles=15, resume=True)
    assert bits_of(out) == bits_of(quick("long", cycles=15))
    assert json.loads((out / "config.json").read_text())["options"]["cycles"] == 15
    assert summary_of(out)["complete"]


def test_a_finished_run_that_is_resumed_is_left_as_it_is(quick):
    out = quick()
    before = (out / "cycles.jsonl").read_bytes()
    quick(resume=True, on_cycle=lambda line: pytest.fail("nothing is left to do"))
    assert (out / "cycles.jsonl").read_bytes() == before


def test_a_run_that_never_began_is_resumed_from_nothing(quick, tmp_path):
    (tmp_path / "run" / "cycles").mkdir(parents=True)
    assert len(bits_of(quick(resume=True))) == 12


@pytest.mark.parametrize(
    ("change", "named"),
    [
        ({"seed": 1}, "seed"),
        ({"mass": 2.0}, "mass"),
        ({"episode_cycles": 3}, "episode-cycles"),
        ({"cell": "5"}, "cell"),
        ({"cycles": 8}, "--cycles"),
        ({"record": "none"}, "record"),
    ],
    ids=str,
)
def test_another_run_is_not_gone_on_with(quick, change, named):
    out = quick()
    before = {path: path.read_bytes() for path in out.iterdir() if path.is_file()}
    with pytest.raises(BadInput, match=named):
        quick(resume=True, **change)
    assert {path: path.read_bytes() for path in out.iterdir() if path.is_file()} == before


@pytest.mark.parametrize("change", [{"jobs": 1}, {"min_success": 0.1}, {"json": True}], ids=str)
def test_what_changes_no_cycle_may_change(quick, change):
    quick()
    quick(resume=True, **change)


def test_another_world_is_not_gone_on_with(quick, monkeypatch, turned_scene):
    quick()
    monkeypatch.setattr(kr210_sim.runner, "load_world", lambda _config: turned_scene)
    with pytest.raises(BadInput, match="world"):
        quick(resume=True)


def test_a_folder_that_is_no_run_is_not_gone_on_with(quick, tmp_path):
    (tmp_path / "run").mkdir()
    (tmp_path / "run" / "thesis.txt").write_text("precious")
    with pytest.raises(BadInput, match="--resume"):
        quick(resume=True)
    assert [path.name for path in (tmp_path / "run").iterdir()] == ["thesis.txt"]


def test_an_episode_depends_on_its_index_alone(scene):
    long = RunConfig(cycles=1000, episode_cycles=7, seed=5)
    short = RunConfig(cycles=24, episode_cycles=7, seed=5)
    episode = plan_episode(long, scene, 3)
    assert episode.first_cycle == 21
    assert plan_episode(short, scene, 3).seeds == episode.seeds[:3]


def test_files_are_named_so_that_the_configuration_holds_anywhere(quick, monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    given = {"scene": "own.xml", "robot": Path("arm.urdf"), "package": ("arm=folder",)}
    options = json.loads((quick(**given) / "config.json").read_text())["options"]
    assert options["scene"] == str(tmp_path / "own.xml")
    assert options["robot"] == str(tmp_path / "arm.urdf")
    assert options["package"] == [f"arm={tmp_path / 'folder'}"]
    bundled = json.loads((quick("other") / "config.json").read_text())["options"]
    assert (bundled["scene"], bundled["robot"]) == ("shelf_and_bin", None)


@pytest.mark.parametrize("full", ["cycles.jsonl", "summary.json", "episodes"])
def test_on_a_full_disk_what_is_finished_is_kept_and_said(quick, monkeypatch, tmp_path, full):
    """The disk is full from the third episode on, for one file or another."""

    def episode_on_full_disk(config, scene, episode, out, _onlooker=None):
        if episode.index == 2 and full == "episodes":
            raise OSError(errno.ENOSPC, "No space left on device", str(out / "episodes" / "0002"))
        yield from quick_episode(config, scene, episode, out)

    append, write_json = kr210_sim.runner.Journal._append, kr210_sim.runner.write_json

    def append_on_full_disk(journal, lines):
        if '"episode": 2' in lines[0] and full == "cycles.jsonl":
            raise OSError(errno.ENOSPC, "No space left on device", str(journal._path))
        append(journal, lines)

    def write_on_full_disk(path, content):
        if path.name == full:
            raise OSError(errno.ENOSPC, "No space left on device", str(path))
        write_json(path, content)

    monkeypatch.setattr(kr210_sim.runner, "play_episode", episode_on_full_disk)
    monkeypatch.setattr(kr210_sim.runner.Journal, "_append", append_on_full_disk)
    monkeypatch.setattr(kr210_sim.runner, "write_json", write_on_full_disk)
    with pytest.raises(NotWritten) as failed:
        quick()
    kept = 12 if full == "summary.json" else 8
    assert full in str(failed.value)
    assert "No space left" in str(failed.value)
    assert f"{kept} of 12 cycles are kept" in str(failed.value)
    assert [line["cycle"] for line in bits_of(tmp_path / "run")] == list(range(kept))
    monkeypatch.setattr(kr210_sim.runner, "write_json", write_json)
    monkeypatch.setattr(kr210_sim.runner.Journal, "_append", append)
    monkeypatch.setattr(kr210_sim.runner, "play_episode", quick_episode)
    out = quick(resume=True)
    assert bits_of(out) == bits_of(quick("whole"))


def test_a_film_that_fails_does_not_take_the_summary_with_it(quick, monkeypatch, tmp_path, capfd):
    def fail(_out):
        raise OSError("the film could not be drawn")

    monkeypatch.setattr("kr210_sim.verbs.run._film", lambda _config: fail)
    arguments = ["--json", "--video", "--min-success", "0", "--cycles", "2"]
    assert main(["run", *arguments, "--out", str(tmp_path / "run")]) == 3
    out, err = capfd.readouterr()
    assert json.loads(out)["cycles"] == 2
    assert "film" in err


@pytest.mark.usefixtures("quick")
def test_junit_has_a_case_per_cycle_of_the_run(tmp_path, capfd):
    junit = tmp_path / "run" / "junit.xml"
    arguments = ["--cycles", "12", "--out", str(tmp_path / "run"), "--junit", str(junit)]
    assert main(["run", *arguments]) == 1
    cases = ET.parse(junit).getroot().findall("testsuite/testcase")
    assert len(cases) == 12
    assert {case.find("failure").get("type") for case in cases} == {"dropped"}
    assert "dropped 12" in capfd.readouterr().out


@pytest.mark.usefixtures("quick")
def test_the_command_line_wins_over_the_file(tmp_path, monkeypatch, capfd):
    (tmp_path / "run.toml").write_text("cycles = 30\nmin-success = 0\ncell = 5\n")
    monkeypatch.chdir(tmp_path)
    assert main(["run", "--config", "run.toml", "--cycles", "10", "--out", "run"]) == 0
    options = json.loads((tmp_path / "run" / "config.json").read_text())["options"]
    assert (options["cycles"], options["cell"]) == (10, "5")
    capfd.readouterr()
    (tmp_path / "bad.json").write_text('{"cycels": 3}')
    assert main(["run", "--config", "bad.json"]) == 2
    err = capfd.readouterr().err
    assert "cycels" in err
    assert err.count("\n") == 1


# ---- with real cycles and real workers ------------------------------------------------------


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


def test_dask_that_is_not_installed_is_named_with_the_remedy(quick, monkeypatch):
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(BadInput, match=r"kr210-sim\[cluster\]"):
        quick(backend="dask")
