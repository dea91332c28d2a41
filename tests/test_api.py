"""`import kr210_sim`: its names, what type checkers see of them, and what they give."""

from __future__ import annotations

import ast
import inspect
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from drawn_runs import make_record, make_run

import kr210_sim
from kr210_sim import BadInput, RunConfig, load_run, plan_cycle, run_episode

EXAMPLE = Path(__file__).parent.parent / "examples" / "one_episode.py"


def test_type_checkers_see_the_names_that_are_loaded_on_demand():
    source = Path(kr210_sim.__file__).read_text(encoding="utf-8")
    block = next(node for node in ast.parse(source).body if isinstance(node, ast.If))
    seen = {}
    for node in block.body:
        assert isinstance(node, ast.ImportFrom)
        for alias in node.names:
            assert alias.asname == alias.name  # else it is private to a type checker
            seen[alias.name] = node.module
    homes = {name: f"kr210_sim.{home}" for name, home in kr210_sim._HOMES.items()}
    assert seen == homes
    assert set(kr210_sim.__all__) == set(homes) <= set(dir(kr210_sim))


def test_every_name_is_documented_and_typed_and_options_have_names():
    for name in kr210_sim.__all__:
        found = getattr(kr210_sim, name)
        assert inspect.getdoc(found), name
        if inspect.isfunction(found):
            signature = inspect.signature(found)
            assert signature.return_annotation is not inspect.Signature.empty, name
            kinds = [parameter.kind for parameter in signature.parameters.values()]
            assert all(kind is inspect.Parameter.KEYWORD_ONLY for kind in kinds[2:]), name


def test_a_name_that_is_not_there_is_named():
    with pytest.raises(AttributeError, match="'kr210_sim' has no attribute 'run_all'"):
        _ = kr210_sim.run_all


def test_a_plan_goes_from_home_to_home_within_the_limits_of_the_joints(scene, limits):
    motions = plan_cycle(RunConfig(cell="5"), scene)
    assert motions[0].stages[0] == "MOVE_TO_PICK"
    assert motions[-1].stages[-1] == "MOVE_HOME"
    walked = [
        motion.trajectory(np.linspace(0.0, motion.trajectory.duration, 50)) for motion in motions
    ]
    q = np.concatenate([motion[0] for motion in walked])
    np.testing.assert_allclose(q[[0, -1]], 0.0, atol=1e-9)
    speeds = np.concatenate([motion[1] for motion in walked])
    assert np.all(np.abs(speeds) <= limits.velocity * (1 + 1e-6))


@pytest.mark.parametrize("index", [-1, 2, 10])
def test_an_episode_that_a_run_does_not_have_is_refused(scene, index):
    with pytest.raises(BadInput, match=f"has no episode {index}"):
        run_episode(RunConfig(cycles=20), scene, index=index)


def test_a_run_is_read_with_options_summary_cycles_and_records(tmp_path):
    lines = make_run(tmp_path / "run", [make_record(0), make_record(1)], seed=7)
    run = load_run(tmp_path / "run")
    assert (run.config.seed, run.config.cycles) == (7, 2)
    assert run.summary["succeeded"] == 2
    assert run.cycles == lines
    assert run.record(1)["qpos"].shape[1] == 6
    with pytest.raises(BadInput, match="does not exist"):
        run.record(2)
    (tmp_path / "run" / "summary.json").write_text("{")
    with pytest.raises(BadInput, match=r"summary\.json cannot be read"):
        load_run(tmp_path / "run")


def test_the_example_fits_a_screen():
    assert len(EXAMPLE.read_text(encoding="utf-8").splitlines()) <= 40


@pytest.mark.slow
def test_the_example_shows_a_plan_and_the_cycles_of_the_default_run(tmp_path, default_run):
    done = subprocess.run(
        [sys.executable, EXAMPLE], capture_output=True, text=True, cwd=tmp_path, check=True
    )
    shown = [line for line in done.stdout.splitlines() if line.startswith("cell")]
    scores = default_run.scores[:2]
    assert shown == [f"cell {score.record.cell}: success in {score.cycle_time_s:.2f} s"
                     for score in scores]  # fmt: skip
    assert done.stdout.splitlines()[1].startswith("  MOVE_TO_PICK")
    assert list(tmp_path.iterdir()) == []


def test_paths_may_be_text(tmp_path):
    config = RunConfig(out=str(tmp_path / "run"), junit="junit.xml")
    assert (config.out, config.junit) == (tmp_path / "run", Path("junit.xml"))
    assert RunConfig(robot="arm.urdf") == RunConfig(robot=Path("arm.urdf"))


def test_a_schema_that_does_not_exist_is_refused():
    with pytest.raises(BadInput, match="give one of summary, cycle"):
        kr210_sim.load_schema("episode")
