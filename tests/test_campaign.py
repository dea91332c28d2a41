"""Campaigns of cycles that cost nothing: interrupted, resumed, grown, on a full disk."""

from __future__ import annotations

import errno
import json
import sys
import xml.etree.ElementTree as ET
from pathlib import Path

import pytest
from campaigns import bits_of, summary_of, without_clock

import kr210_sim.episode_files
import kr210_sim.runner
from kr210_sim.cli import main
from kr210_sim.config import RunConfig
from kr210_sim.episodes import episode_targets, plan_episode
from kr210_sim.exceptions import BadInput, Interrupted, NotWritten
from kr210_sim.record import Event, unplayed_record
from kr210_sim.runner import run
from kr210_sim.score import score_cycle


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


def test_dask_that_is_not_installed_is_named_with_the_remedy(quick, monkeypatch):
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(BadInput, match=r"kr210-sim\[cluster\]"):
        quick(backend="dask")
