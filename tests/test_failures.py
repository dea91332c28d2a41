"""Failures: grouped by first cause, and the one command that shows each again, bit for bit."""

from __future__ import annotations

import json
import shlex
from dataclasses import replace
from pathlib import Path

import pytest

import kr210_sim.runner
from kr210_sim.cli import main
from kr210_sim.config import RunConfig
from kr210_sim.episodes import last_cycle, plan_episode, plan_episodes, requested_cycles
from kr210_sim.exceptions import BadInput
from kr210_sim.failures import CYCLES_NAMED, SHOWN, FirstCauses, causes_text, show_again
from kr210_sim.results import read_lines
from kr210_sim.runner import run


def line(cycle: int, reason: str | None, stage="LIFT", time=1.0, detail="it fell") -> dict:
    return {
        "cycle": cycle, "success": reason is None, "reason": reason, "failed_stage": stage,
        "failed_time_s": time, "detail": detail,
    }  # fmt: skip


def groups_of(*lines: dict, **options) -> list[dict]:
    causes = FirstCauses(RunConfig(cycles=100, **options))
    for each in lines:
        causes.add(each)
    return causes.as_json()


# ---- groups ---------------------------------------------------------------------------------


def test_failures_of_one_kind_are_one_group_and_the_largest_comes_first():
    groups = groups_of(
        line(3, "collision", detail="target_3 touches board"),
        line(4, None),
        line(5, "dropped", time=2.5, detail="slipped 5.0 mm"),
        line(17, "dropped", time=1.5, detail="slipped 12.31 mm"),
        line(20, "dropped", detail="a finger lost the target"),
        line(21, "dropped", stage="LOWER", detail="slipped 5.1 mm"),
    )
    assert [(group["count"], group["cycles"]) for group in groups] == [
        (2, [5, 17]), (1, [3]), (1, [20]), (1, [21]),
    ]  # fmt: skip
    assert groups[0] == {
        "reason": "dropped", "count": 2, "stage": "LIFT", "time_s": [1.5, 2.5],
        "detail": "slipped 5.0 mm", "cycles": [5, 17],
        "command": "kr210-sim run --cycles 100 --only-cycle 5",
    }  # fmt: skip


def test_joints_are_causes_of_their_own_and_targets_are_not():
    details = ("joint_3: motor saturated", "joint_5: motor saturated", "target_1 hit 2.5e-3 m deep")
    groups = groups_of(
        *(line(cycle, "collision", detail=detail) for cycle, detail in enumerate(details)),
        line(7, "collision", detail="target_12 hit 3 m deep"),
    )
    assert [group["cycles"] for group in groups] == [[2, 7], [0], [1]]


def test_the_groups_stay_small_over_many_cycles():
    groups = groups_of(*(line(cycle, "dropped", detail=f"{cycle} mm") for cycle in range(5000)))
    assert [group["count"] for group in groups] == [5000]
    assert groups[0]["cycles"] == list(range(CYCLES_NAMED))


def test_the_terminal_has_reason_count_stage_time_bodies_and_command():
    first, second = causes_text(
        groups_of(line(5, "dropped", time=2.5), line(17, "dropped", time=1.5), line(18, None))
    )
    assert first == "  2 x dropped in LIFT at 1.50 to 2.50 s: it fell (cycles 5, 17)"
    assert second.strip() == "kr210-sim run --cycles 100 --only-cycle 5"
    many = causes_text(groups_of(*(line(c, "dropped", detail="x" * (c + 1)) for c in range(20))))
    assert len(many) == 2 * SHOWN + 1
    assert "8 more causes" in many[-1]
    assert causes_text([]) == []


# ---- the command ----------------------------------------------------------------------------

OPTIONS = [
    {},
    {"cycles": 2000, "jobs": 2, "seed": 7, "record": "failed", "min_success": 0.9, "json": True},
    {"mass": 0.1 + 0.2, "speed": 1 / 3, "clearance": 0.0, "cell": "all", "cycles": 18},
    {"robot": Path("my arm/it's.urdf"), "package": ("a=b c", "d=e"), "gripper": True},
    {"robot": Path("arm.urdf"), "joints": "-a,b,c,d,e,f", "xacro_arg": ("x=$HOME",)},
    {"confidence": 0.95, "stop_early": True, "cycles": 500, "ik": "numeric", "episode_cycles": 3},
]


@pytest.mark.parametrize("options", OPTIONS, ids=str)
def test_the_command_reads_as_the_run_and_its_cycle(monkeypatch, tmp_path, options):
    monkeypatch.chdir(tmp_path)
    config = RunConfig(out=Path("run"), **options)
    read = []

    def catch(config, **_):
        read.append(config)
        raise BadInput("seen")

    monkeypatch.setattr(kr210_sim.runner, "run", catch)
    words = shlex.split(show_again(config, 7))
    assert words[:2] == ["kr210-sim", "run"]
    main(words[1:])
    plain = {
        name: default
        for name, (default, _) in RunConfig.metadata().items()
        if name in {"jobs", "out", "record", "json", "min_success", "confidence", "stop_early"}
    }
    assert read == [replace(config, **plain, only_cycle=7)]


@pytest.mark.parametrize("cycle", range(14))
@pytest.mark.parametrize("options", [{"cell": "all"}, {"episode_cycles": 4}], ids=str)
def test_one_cycle_takes_its_episode_as_the_run_plans_it(scene, cycle, options):
    config = RunConfig(cycles=14, seed=3, **options)
    whole = next(
        episode
        for episode in plan_episodes(config, scene)
        if episode.first_cycle <= cycle < episode.first_cycle + len(episode.seeds)
    )
    only = replace(config, only_cycle=cycle)
    assert list(plan_episodes(only, scene)) == [whole]
    assert last_cycle(only, whole) == cycle
    assert requested_cycles(only, scene) == cycle - whole.first_cycle + 1
    assert last_cycle(config, plan_episode(config, scene, 1)) in (7, 13)
    assert requested_cycles(config, scene) == 14


@pytest.mark.parametrize(
    ("options", "named"),
    [
        ({"only_cycle": 10}, "give 0 to 9"),
        ({"only_cycle": -1}, "give 0 to 9"),
        ({"only_cycle": 3, "resume": True, "out": Path("run")}, "leave --resume out"),
        ({"only_cycle": 3, "stop_early": True, "confidence": 0.95}, "leave --stop-early out"),
    ],
    ids=str,
)
def test_a_cycle_that_cannot_be_shown_is_refused(options, named):
    with pytest.raises(BadInput, match=f"--only-cycle.*{named}"):
        RunConfig(**options)


# ---- with real cycles -----------------------------------------------------------------------


def bits_of(out: Path) -> list[dict]:
    return [each | {"wall_clock": None} for each in read_lines(out)]


@pytest.mark.slow
@pytest.mark.parametrize("jobs", [1, 2])
def test_the_command_in_the_summary_shows_the_failure_again_to_the_bit(
    tmp_path, monkeypatch, capfd, jobs
):
    (tmp_path / "seen badly.toml").write_text("perceived_shift_m = { normal = [0.0, 0.025] }\n")
    monkeypatch.chdir(tmp_path)
    config = RunConfig(
        cycles=4, episode_cycles=2, randomize="seen badly.toml", cell="5", seed=0, jobs=jobs,
        record="failed", out=Path("run"),
    )  # fmt: skip
    _, summary = run(config)
    lines = bits_of(Path("run"))
    assert [each["success"] for each in lines[2:]] == [True, False]  # a failure after a success
    (tmp_path / "elsewhere").mkdir()
    monkeypatch.chdir(tmp_path / "elsewhere")
    command = next(group["command"] for group in summary["first_causes"] if group["cycles"] == [3])
    assert main([*shlex.split(command)[1:], "--out", "again"]) == 1
    assert bits_of(Path("again")) == lines[2:]
    out = capfd.readouterr().out
    assert command in out
    again = json.loads(Path("again/summary.json").read_text())
    assert (again["complete"], again["requested_cycles"], again["cycles"]) == (True, 2, 2)
    assert (
        Path("again/cycles/0003.npz").read_bytes()
        == (tmp_path / "run/cycles/0003.npz").read_bytes()
    )
