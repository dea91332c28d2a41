"""Recorded cycles: played on a screen, and simulated again to prove their bits."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from conftest import refused

import kr210_sim.verify
from kr210_sim import load_run
from kr210_sim.cli import main
from kr210_sim.exceptions import BadInput
from kr210_sim.record import load_series
from kr210_sim.scene import ROBOT_PREFIX
from kr210_sim.verify import verify
from kr210_sim.viewers.pace import MAX_SPEED, Pace
from kr210_sim.viewers.puppet import Puppet
from kr210_sim.viewers.replay import Player, Replay, load_replay
from tests.test_live import FakeScreen


@pytest.fixture(scope="module")
def first(default_run) -> Replay:
    """The first cycle of the default run; it is only read."""
    return load_replay(default_run.out, None)


@pytest.fixture
def copied(default_run, tmp_path) -> Path:
    """A copy of the default run without its worlds, to be spoilt."""
    out = tmp_path / "copy"
    shutil.copytree(default_run.out, out, ignore=shutil.ignore_patterns("episodes"))
    return out


@pytest.fixture
def simulated(default_run, scene, monkeypatch) -> None:
    """Let the episode of the default run be simulated again at once, by what it gave before."""

    def again(*_given: Any) -> Iterator[Any]:
        yield from default_run.scores

    monkeypatch.setattr(kr210_sim.verify, "score_episode", again)
    monkeypatch.setattr(kr210_sim.verify, "load_world", lambda _config: scene)


# ---- playing --------------------------------------------------------------------------------


def test_a_replay_poses_the_world_as_it_was_recorded(default_run, robot):
    replay = load_replay(default_run.out, 3)
    series = load_series(default_run.out / "cycles" / "0003.npz")
    puppet = Puppet(replay.model, prefix=ROBOT_PREFIX)
    for step in (0, 150, len(series["time"]) - 1):
        at = float(series["time"][step])
        puppet.place(replay.qpos(at))
        np.testing.assert_allclose(puppet.site("tcp"), series["tcp_measured"][step, :3], atol=2e-6)
        assert replay.moment(at).stage == series["stage_names"][int(series["stage"][step])]
    assert replay.moment(replay.take.duration).note == "success"
    assert replay.moment(0.1).note == ""


def test_targets_that_are_not_in_the_world_are_parked(first):
    positions, _ = Puppet(first.model).place(first.qpos(1.0))
    assert positions[first.model.body("target_9").id][0] < -1.5
    assert positions[first.model.body("target_0").id][0] > 2.0


def test_without_a_number_the_first_recorded_cycle_is_played(first):
    assert first.take.cycle == 0


def test_the_player_shows_what_is_sought_and_goes_on_from_there(first):
    screen, pace = FakeScreen(), Pace(MAX_SPEED)
    player = Player(first, screen, pace)
    player.seek(2.0)
    player.play(pictures=2)
    times = [moment.time for moment in screen.moments]
    assert times[0] == 2.0
    assert 2.0 < times[1] <= first.take.duration
    np.testing.assert_array_equal(screen.poses[0], first.qpos(2.0))


def test_the_player_stands_still_at_the_end_and_begins_anew(first):
    screen, pace = FakeScreen(), Pace(MAX_SPEED)
    stood = []

    def idle() -> None:
        stood.append(pace.paused)
        pace.resume()

    screen.idle = idle
    player = Player(first, screen, pace)
    player.seek(1e9)
    player.play(pictures=2)
    assert [moment.time for moment in screen.moments] == [first.take.duration, 0.0]
    assert stood[0]


@pytest.mark.slow
def test_seeking_while_paused_shows_that_time_and_stays_there(first):
    screen, pace = FakeScreen(), Pace(1.0)
    acts: list[Callable[[], None]] = [lambda: player.seek(3.0), lambda: None, pace.resume]
    screen.idle = lambda: acts.pop(0)() if acts else None
    player = Player(first, screen, pace)
    pace.pause()
    player.play(pictures=2)
    assert [moment.time for moment in screen.moments] == [0.0, 3.0, 3.0]


# ---- proving --------------------------------------------------------------------------------


def test_the_same_bits_are_said_to_be_the_same(default_run, simulated, capsys):
    assert main(["view", str(default_run.out), "--cycle", "4", "--verify"]) == 0
    said = capsys.readouterr().out
    assert "10 lines of cycles.jsonl and 10 records" in said
    assert "SAME" in said


def test_one_changed_number_in_a_line_is_found(copied, simulated, capsys):
    lines = [json.loads(line) for line in (copied / "cycles.jsonl").read_text().splitlines()]
    lines[3]["slowed_to"] = np.nextafter(lines[3]["slowed_to"], 0.0)
    lines[5]["wall_clock"] = {}  # is not compared
    (copied / "cycles.jsonl").write_text("".join(json.dumps(line) + "\n" for line in lines))
    assert main(["view", str(copied), "--verify"]) == 1
    said = capsys.readouterr().out.splitlines()
    assert [line for line in said if line.startswith("cycle 3: slowed_to was 0.99999")]
    assert len([line for line in said if line.startswith("cycle ")]) == 1
    assert said[-1].startswith("DIFFERENT")


def test_one_changed_bit_in_a_record_is_found(copied, simulated):
    path = copied / "cycles" / "0002.npz"
    arrays = load_series(path)
    arrays["qpos"].view(np.uint32)[7, 1] ^= 1
    np.savez_compressed(path, **arrays)
    verdict = verify(copied, 2)
    assert not verdict.same
    assert verdict.differences == ("cycle 2: record: qpos differs from step 7 on",)


def test_cycles_that_a_run_did_not_reach_are_not_asked_for(copied, simulated):
    lines = (copied / "cycles.jsonl").read_text().splitlines(keepends=True)
    (copied / "cycles.jsonl").write_text("".join(lines[:4]))
    verdict = verify(copied, 1)
    assert verdict.same
    assert verdict.cycles == (0, 1, 2, 3)


def test_other_versions_are_named(copied, simulated):
    config = json.loads((copied / "config.json").read_text())
    config["versions"]["mujoco"] = "3.0.0"
    (copied / "config.json").write_text(json.dumps(config))
    assert any(note.startswith("note: mujoco was 3.0.0") for note in verify(copied, 0).notes)


def test_a_run_with_a_film_is_proved_without_one(copied, simulated):
    config = json.loads((copied / "config.json").read_text())
    config["options"] |= {"video": "", "camera": ["gripper"], "size": "320x240", "fps": 10}
    (copied / "config.json").write_text(json.dumps(config))
    assert verify(copied, 0).same


@pytest.mark.slow
def test_an_episode_gives_the_same_bits_when_it_is_simulated_again(tmp_path, capsys):
    out = tmp_path / "run"
    assert main(["run", "--cycles", "1", "--randomize", "nominal", "--out", str(out)]) in (0, 1)
    assert main(["view", str(out), "--cycle", "0", "--verify"]) == 0
    assert "SAME" in capsys.readouterr().out


# ---- bad input ------------------------------------------------------------------------------


def test_a_cycle_that_is_not_there_is_refused(default_run, capfd):
    assert "give 0 to 9" in refused(capfd, str(default_run.out), "--cycle", "10", "--verify")
    assert "give 0 to 9" in refused(capfd, str(default_run.out), "--cycle", "-1")


def test_a_cycle_without_a_record_is_refused(copied):
    (copied / "cycles" / "0000.npz").unlink()
    with pytest.raises(BadInput, match="first that has one is 1"):
        load_replay(copied, 0)
    shutil.rmtree(copied / "cycles")
    with pytest.raises(BadInput, match="--record all"):
        load_replay(copied, None)


def test_a_damaged_record_is_named(copied, simulated, capfd):
    path = copied / "cycles" / "0001.npz"
    content = bytearray(path.read_bytes())
    content[len(content) // 2] ^= 0xFF
    path.write_bytes(content)
    assert "0001.npz is damaged" in refused(capfd, str(copied), "--verify")
    with pytest.raises(BadInput, match=r"0001\.npz is damaged"):
        load_run(copied).record(1)


def test_a_missing_or_broken_world_is_named(copied):
    with pytest.raises(BadInput, match="world of cycle 1"):
        load_replay(copied, 1)


def test_a_folder_that_is_no_run_is_refused(capfd, tmp_path):
    assert "no folder of a run" in refused(capfd, str(tmp_path))
    (tmp_path / "cycles.jsonl").write_text("[1]\n")
    assert "cycles.jsonl" in refused(capfd, str(tmp_path), "--verify")


@pytest.mark.parametrize(
    "words", [("--cycle", "1"), ("shelf_and_bin", "--verify"), ("--viewer", "native")]
)
def test_what_only_a_run_has_is_refused_without_one(capfd, words):
    assert "run" in refused(capfd, *words)


def test_an_impossible_speed_is_refused(capfd, default_run):
    assert "--speed" in refused(capfd, str(default_run.out), "--speed", "0")
