"""Seeds and cells of a run, and the files it leaves behind: complete, honest, and nowhere else."""

from __future__ import annotations

import json
import re
from pathlib import Path

import mujoco
import numpy as np
import pytest
import trimesh

from kr210_sim.config import RunConfig
from kr210_sim.criteria import CONDITIONS
from kr210_sim.episodes import load_world, plan_episodes, run_episode, setup_of
from kr210_sim.exceptions import BadInput
from kr210_sim.record import SERIES, load_series
from kr210_sim.resources import resource
from kr210_sim.runner import run


def write_hasty(source: Path, path: Path) -> Path:
    """Write a scene with a time limit that no cycle can keep, so that cycles are short."""
    text = re.sub(r'"time_limit" data="\d+"', '"time_limit" data="0.05"', source.read_text())
    path.write_text(text)
    return path


@pytest.fixture
def hasty_scene(tmp_path) -> Path:
    return write_hasty(resource("scenes", "shelf_and_bin.xml"), tmp_path / "hasty.xml")


@pytest.fixture
def hasty_2x2(tmp_path, turned_scene) -> Path:
    return write_hasty(turned_scene.path, tmp_path / "hasty_2x2.xml")


# ---- episodes -------------------------------------------------------------------------------


def episodes_of(scene, **options):
    return list(plan_episodes(RunConfig(**options), scene))


def cells_of(scene, **options) -> list[int]:
    return [cell for episode in episodes_of(scene, **options) for cell in episode.cells]


def seeds_of(scene, **options) -> list[int]:
    return [seed for episode in episodes_of(scene, **options) for seed in episode.seeds]


@pytest.mark.parametrize(
    ("cycles", "sizes"), [(1, [1]), (10, [10]), (11, [10, 1]), (25, [10, 10, 5])]
)
def test_ten_cycles_are_an_episode(scene, cycles, sizes):
    episodes = episodes_of(scene, cycles=cycles)
    assert [len(episode.seeds) for episode in episodes] == sizes
    assert [episode.first_cycle for episode in episodes] == [0, 10, 20][: len(sizes)]
    assert [episode.index for episode in episodes] == list(range(len(sizes)))


def test_every_cycle_has_a_seed_of_its_own(scene):
    seeds = [seed for s in range(5) for seed in seeds_of(scene, cycles=100, seed=s)]
    assert len(set(seeds)) == 500


def test_a_longer_run_begins_like_a_shorter_one(scene):
    long = episodes_of(scene, cycles=40, seed=3)
    short = episodes_of(scene, cycles=15, seed=3)
    assert short[0] == long[0]
    assert short[1].seeds == long[1].seeds[:5]
    assert short[1].cells == long[1].cells[:5]


def test_random_cells_are_all_cells_about_equally_often(scene):
    cells = cells_of(scene, cycles=900)
    counts = np.bincount(cells, minlength=len(scene.cells) + 1)[1:]
    assert len(counts) == len(scene.cells)
    assert np.all(counts > 60)
    assert np.all(counts < 140)


def test_a_cell_drawn_at_random_depends_on_the_seed_of_its_cycle_alone(scene):
    assert cells_of(scene, cycles=20, seed=1) == cells_of(scene, cycles=20, seed=1)
    assert cells_of(scene, cycles=20, seed=1) != cells_of(scene, cycles=20, seed=2)


def test_a_fixed_cell_is_every_cycles_cell(turned_scene):
    assert cells_of(turned_scene, cycles=12, cell="3") == [3] * 12


def test_all_cells_are_taken_in_turn_an_episode_being_one_round(turned_scene):
    assert cells_of(turned_scene, cycles=8, cell="all") == [1, 2, 3, 4] * 2
    episodes = episodes_of(turned_scene, cycles=8, cell="all")
    assert [episode.first_cycle for episode in episodes] == [0, 4]
    assert all(episode.all_from_start for episode in episodes)


@pytest.mark.parametrize("cycles", [1, 4])
def test_with_all_cells_a_target_stands_in_every_one_from_the_start(hasty_2x2, cycles):
    """However few of them are picked: an episode does not depend on the length of the run."""
    config = RunConfig(cycles=cycles, cell="all", scene=str(hasty_2x2))
    scene = load_world(config)
    seen: list[int] = []

    def count(simulation, _stage, _time):
        seen.append(len(simulation.targets))

    episode = next(iter(plan_episodes(config, scene)))
    common = setup_of(config, scene, None)
    next(iter(run_episode(scene, episode, common, mass=1.0, probe=count)))
    assert seen[0] == len(scene.cells)


# ---- the files ------------------------------------------------------------------------------


def lines_of(out: Path) -> list[dict]:
    return [json.loads(line) for line in (out / "cycles.jsonl").read_text().splitlines()]


def test_a_run_leaves_these_files_and_no_others(default_run):
    found = {str(path.relative_to(default_run.out)) for path in default_run.out.rglob("*.*")}
    meshes = {name for name in found if re.fullmatch(r"episodes/0000/assets/\w[\w.]*\.obj", name)}
    assert meshes  # what scene.xml names; test_honesty loads it
    assert found - meshes == {
        "config.json",
        "cycles.jsonl",
        "summary.json",
        "episodes/0000/scene.xml",
        *(f"cycles/{index:04d}.npz" for index in range(10)),
    }


def test_the_summary_on_disk_is_the_one_returned(default_run):
    summary = json.loads((default_run.out / "summary.json").read_text())
    assert summary == default_run.summary
    assert summary["schema_version"] >= 1


def test_nothing_on_disk_is_nan_or_infinite(default_run):
    for name in ("config.json", "cycles.jsonl", "summary.json"):
        text = (default_run.out / name).read_text()
        assert "NaN" not in text
        assert "Infinity" not in text


def test_the_configuration_says_everything_needed_to_run_it_again(default_run):
    config = json.loads((default_run.out / "config.json").read_text())
    assert config["schema_version"] >= 1
    assert {"kr210-sim", "python", "mujoco", "numpy", "scipy", "ruckig"} <= set(config["versions"])
    options = config["options"]
    assert RunConfig(**(options | {"out": None})) == RunConfig(
        **{name: options[name] for name in ("cycles", "seed", "scene", "cell", "mass", "speed")}
    )


def test_a_line_of_the_cycles_has_every_field_of_the_contract(default_run):
    lines = lines_of(default_run.out)
    assert [line["cycle"] for line in lines] == list(range(10))
    for line, score in zip(lines, default_run.scores, strict=True):
        assert set(line) >= {
            "cycle", "episode", "seed", "cell", "success", "failed_stage", "reason",
            "cycle_time_s", "motion_time_s", "ik_offset_m", "ik_offset_rad", "tracking_offset_m",
            "grasp_slip_m", "grasp_slip_rad", "grasp", "place_offset_m", "wall_clock", *CONDITIONS,
        }  # fmt: skip
        assert line == json.loads(json.dumps(score.as_json()))


def test_what_depends_on_the_clock_stands_under_wall_clock_alone(default_run):
    for line in lines_of(default_run.out):
        clock = line.pop("wall_clock")
        assert set(clock) >= {"ik_time_s", "plan_time_s", "wall_time_s"}
        assert not set(clock) & set(line)


def test_records_on_disk_are_those_of_the_cycles(default_run):
    for score in default_run.scores:
        series = load_series(default_run.out / "cycles" / f"{score.record.cycle:04d}.npz")
        assert set(SERIES) <= set(series)
        np.testing.assert_array_equal(
            series["qpos"], score.record.series["qpos"].astype(np.float32)
        )


def test_seeds_and_cells_on_disk_are_those_planned(default_run, scene):
    lines = lines_of(default_run.out)
    assert [line["seed"] for line in lines] == seeds_of(scene)
    assert [line["cell"] for line in lines] == cells_of(scene)


# ---- a run that does not go well ------------------------------------------------------------


@pytest.mark.slow
def test_failed_cycles_are_written_like_any_other(hasty_scene, tmp_path):
    out = tmp_path / "run"
    _, summary = run(RunConfig(cycles=2, scene=str(hasty_scene), out=out))
    assert summary["failures"] == {"timeout": 2}
    assert [line["reason"] for line in lines_of(out)] == ["timeout", "timeout"]
    assert {path.name for path in (out / "cycles").iterdir()} == {"0000.npz", "0001.npz"}
    assert (out / "episodes" / "0000" / "scene.xml").is_file()


@pytest.mark.slow
def test_an_interrupted_run_keeps_what_is_finished(hasty_scene, tmp_path):
    out = tmp_path / "run"
    lines = []

    def interrupt(line):
        lines.append(line)
        if len(lines) == 2:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        run(RunConfig(cycles=12, scene=str(hasty_scene), out=out), on_cycle=interrupt)
    assert [line["cycle"] for line in lines_of(out)] == [0, 1]
    assert json.loads((out / "summary.json").read_text())["cycles"] == 2
    assert len(list((out / "cycles").iterdir())) == 2


@pytest.mark.slow
def test_an_episode_is_written_as_soon_as_it_is_finished(hasty_2x2, tmp_path):
    out = tmp_path / "run"
    seen: list[int] = []

    def look(_line):
        path = out / "cycles.jsonl"
        seen.append(len(path.read_text().splitlines()) if path.exists() else 0)

    run(RunConfig(cycles=5, cell="all", scene=str(hasty_2x2), out=out), on_cycle=look)
    assert seen == [0, 0, 0, 0, 4]
    assert len(lines_of(out)) == 5


def test_a_scene_with_joints_and_meshes_of_its_own_is_written_with_them(tmp_path):
    (tmp_path / "shapes").mkdir()
    trimesh.creation.box((0.1, 0.2, 0.3)).export(tmp_path / "shapes" / "block.obj")
    path = write_hasty(resource("scenes", "shelf_and_bin.xml"), tmp_path / "own.xml")
    text = path.read_text()
    text = text.replace("<compiler ", '<compiler meshdir="shapes" ', 1)
    text = text.replace("<asset>", '<asset><mesh name="block" file="block.obj"/>', 1)
    lamp = (
        '<body pos="-3 -3 1"><joint type="slide"/><joint/><geom type="mesh" mesh="block"/></body>'
    )
    path.write_text(text.replace("<worldbody>", f"<worldbody>{lamp}", 1))
    run(RunConfig(cycles=1, scene=str(path), out=tmp_path / "out"))
    folder = tmp_path / "out" / "episodes" / "0000"
    assert (folder / "assets" / "block.obj").is_file()
    world = mujoco.MjModel.from_xml_path(str(folder / "scene.xml"))
    assert world.mesh("block").id >= 0


def test_an_existing_run_is_never_overwritten(default_run):
    before = (default_run.out / "cycles.jsonl").read_text()
    with pytest.raises(BadInput, match="--out"):
        run(RunConfig(cycles=1, out=default_run.out))
    assert (default_run.out / "cycles.jsonl").read_text() == before


@pytest.mark.slow
def test_an_empty_folder_that_exists_may_be_used(hasty_scene, tmp_path):
    out = tmp_path / "empty"
    out.mkdir()
    folder, _ = run(RunConfig(cycles=1, scene=str(hasty_scene), out=out))
    assert folder == out
    assert lines_of(out)


@pytest.mark.slow
def test_without_a_name_two_runs_in_one_second_get_folders_of_their_own(
    hasty_scene, tmp_path, monkeypatch
):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("time.strftime", lambda *_: "20260102-030405")
    config = RunConfig(cycles=1, scene=str(hasty_scene))
    folders = {run(config)[0] for _ in range(2)}
    assert len(folders) == 2
    assert all(folder.parent == Path("runs") for folder in folders)
    assert {path.name for path in tmp_path.iterdir()} == {"runs", "hasty.xml"}


@pytest.mark.slow
def test_a_slower_run_states_its_lower_limits(hasty_scene, tmp_path, robot):
    config = RunConfig(cycles=1, speed=0.5, scene=str(hasty_scene), out=tmp_path / "run")
    _, summary = run(config)
    np.testing.assert_allclose(summary["limits"]["velocity_rad_s"], 0.5 * robot.velocity)
    np.testing.assert_allclose(
        summary["limits"]["acceleration_rad_s2"], 0.25 * robot.velocity / 0.25
    )
