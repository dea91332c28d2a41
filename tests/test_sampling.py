"""Sampled paths are free, the same for the same seed, bounded, and asked for only where needed."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Callable
from itertools import islice
from pathlib import Path

import numpy as np
import pytest
from conftest import densified, standing_target

from kr210_sim import planning, sampling
from kr210_sim.collision import MujocoOracle
from kr210_sim.config import RunConfig
from kr210_sim.criteria import CLEARANCE_FREE
from kr210_sim.exceptions import CycleFailure
from kr210_sim.legs import (
    CYCLE_CONFIGURATIONS,
    SAMPLED_CONFIGURATIONS,
    Blocked,
    ClearanceOracle,
    Hand,
    LegFinder,
    Wanted,
)
from kr210_sim.planning import CyclePlanner
from kr210_sim.runner import run
from kr210_sim.sampling import Budget, Query, sample_path
from kr210_sim.scene import build_scene, find_scene
from kr210_sim.simulation import Simulation
from kr210_sim.task import pick_options, place_options, release_point

NO_WAY = Path(__file__).parent / "scenes" / "no_way.xml"
HOME = np.zeros(6)
AWAY = np.array([1.5, 0.0, 0.0, 0.0, 0.0, 0.0])
needs_ompl = pytest.mark.skipif(not sampling.available(), reason="ompl is not installed")


def gate(q: np.ndarray) -> bool:
    """A wall across axis 1 that is open only where axes 2 and 3 are both far from home."""
    return not np.any((np.abs(q[:, 0] - 0.75) < 0.1) & ((q[:, 1] > -0.2) | (q[:, 2] > -0.4)))


def wall(q: np.ndarray) -> bool:
    return not np.any(np.abs(q[:, 0] - 0.75) < 0.1)


class World(ClearanceOracle):
    """An oracle in joint space for what holds the target; everything else is free."""

    def __init__(self, free: Callable[[np.ndarray], bool], hand: Hand = Hand.HOLDING) -> None:
        self.free, self.hand, self.single = free, hand, 0

    def blocked(self, q, *, hand, clearance):
        self.single += len(q) == 1
        return None if hand is not self.hand or self.free(densified(q)) else "a wall"


def query_of(robot, free, q_to=AWAY) -> Query:
    return Query(
        q_from=HOME,
        q_to=q_to,
        lower=robot.lower,
        upper=robot.upper,
        velocity=robot.velocity,
        free=lambda corners: free(densified(corners)),
    )


def path_of(robot, seed: int, free=gate) -> np.ndarray:
    path = sample_path(query_of(robot, free), np.random.default_rng(seed), Budget(20_000))
    assert path is not None
    return path


# ---- the path -------------------------------------------------------------------------------


@needs_ompl
def test_a_sampled_path_is_free_within_limits_and_joins_its_ends(robot):
    path = path_of(robot, 1)
    np.testing.assert_array_equal(path[[0, -1]], [HOME, AWAY])
    fine = densified(path, 0.002)
    assert gate(fine)
    assert np.all((fine >= robot.lower) & (fine <= robot.upper))


@needs_ompl
def test_shortcuts_leave_few_corners_and_little_detour(robot):
    """Without the gate it takes 0.70 s."""
    for seed in range(3):
        path = path_of(robot, seed)
        seconds = np.sum(query_of(robot, gate).seconds(path))
        assert len(path) <= 5
        assert seconds < 1.0


@needs_ompl
@pytest.mark.parametrize("end", [0.0, -1.0])
def test_axes_4_and_6_turn_no_further_than_from_end_to_end(robot, end):
    q_to = np.array([1.5, 0.0, 0.0, end, 0.0, end])
    for seed in range(3):
        rng = np.random.default_rng(seed)
        path = sample_path(query_of(robot, gate, q_to), rng, Budget(20_000))
        travel = np.sum(np.abs(np.diff(path, axis=0)), axis=0)
        np.testing.assert_allclose(travel[[3, 5]], abs(end), atol=2e-3)
        assert gate(densified(path))


@needs_ompl
@pytest.mark.slow
def test_an_axis_that_must_turn_aside_does_so_and_the_other_does_not(robot):
    def free(q: np.ndarray) -> bool:
        return gate(q) and not np.any((np.abs(q[:, 0] - 0.75) < 0.1) & (q[:, 3] < 0.3))

    path = path_of(robot, 1, free)
    assert free(densified(path))
    assert np.max(path[:, 3]) > 0.3
    assert np.sum(np.abs(np.diff(path[:, 5]))) < 2e-3


@needs_ompl
def test_the_same_seed_gives_the_same_bits_whatever_was_planned_before(robot):
    first = path_of(robot, 7)
    other = path_of(robot, 8)
    again = path_of(robot, 7)
    np.testing.assert_array_equal(first, again)
    assert not np.array_equal(first, other)


@needs_ompl
@pytest.mark.slow
def test_the_same_seed_gives_the_same_bits_in_another_process(robot):
    program = (
        "import json, sys, numpy as np\n"
        "from ompl import util\n"
        "[util.RNG().uniform01() for _ in range(5)]\n"
        "sys.path.insert(0, sys.argv[1])\n"
        "from types import SimpleNamespace\n"
        "from test_sampling import path_of\n"
        "arrays = {k: np.array(v) for k, v in json.loads(sys.argv[2]).items()}\n"
        "print(json.dumps(path_of(SimpleNamespace(**arrays), 7).tolist()))\n"
    )
    limits = {name: getattr(robot, name).tolist() for name in ("lower", "upper", "velocity")}
    done = subprocess.run(
        [sys.executable, "-c", program, str(Path(__file__).parent), json.dumps(limits)],
        capture_output=True,
        text=True,
        check=True,
    )
    np.testing.assert_array_equal(json.loads(done.stdout), path_of(robot, 7))
    assert done.stderr == ""


@needs_ompl
def test_no_path_is_found_through_a_wall_and_the_budget_is_kept(robot):
    asked = []
    budget = Budget(3_000)
    answer = sample_path(
        query_of(robot, lambda q: asked.append(len(q)) is None and wall(q)),
        np.random.default_rng(0),
        budget,
    )
    assert answer is None
    assert budget.left <= 0
    assert sum(asked) < 3_200  # a branch that has begun is finished


# ---- the legs -------------------------------------------------------------------------------


def wish(q_from=HOME, q_to=AWAY) -> Wanted:
    return Wanted.move("MOVE_TO_PLACE", q_from, q_to, Hand.HOLDING, CLEARANCE_FREE)


@needs_ompl
def test_a_move_is_sampled_only_when_no_cheap_one_is_free(robot):
    finder = LegFinder(robot, World(lambda q: True), seed=0)
    found = finder.sample(wish())
    assert not isinstance(found, Blocked)
    assert [leg.sampled for leg in found] == [False]
    finder = LegFinder(robot, World(gate), seed=0)
    assert isinstance(finder.find(wish()), Blocked)
    found = finder.sample(wish())
    assert not isinstance(found, Blocked)
    assert len(found) > 1
    assert all(leg.sampled and leg.clearance == CLEARANCE_FREE for leg in found)
    assert finder.find(wish()) is found


@pytest.mark.parametrize(("q_from", "q_to", "name"), [(HOME, AWAY, "end"), (AWAY, HOME, "start")])
def test_an_end_that_is_blocked_says_so_and_is_not_sampled(robot, monkeypatch, q_from, q_to, name):
    monkeypatch.setattr(sampling, "sample_path", None)
    world = World(lambda q: not np.any(q[:, 0] > 1.4))
    answer = LegFinder(robot, world, seed=0).sample(wish(q_from, q_to))
    assert isinstance(answer, Blocked)
    assert answer.what == f"a wall already at the {name}"


@needs_ompl
@pytest.mark.slow
def test_all_moves_of_a_cycle_share_one_budget(robot):
    world = World(wall)
    finder = LegFinder(robot, world, seed=0)
    for shift in np.linspace(0.0, 0.5, 6):
        answer = finder.sample(wish(q_to=AWAY + shift * np.eye(6)[1]))
        assert isinstance(answer, Blocked)
        assert "sampling found no way" in answer.what
    assert CYCLE_CONFIGURATIONS <= world.single < CYCLE_CONFIGURATIONS + 500
    assert CYCLE_CONFIGURATIONS < 6 * SAMPLED_CONFIGURATIONS


# ---- the cycle ------------------------------------------------------------------------------


def plan(scene, oracle, cell=5, seed=0):
    place = scene.place
    release = release_point(place.T_base_place, place.half_size, place.kind, 0.25, [])
    return CyclePlanner(scene.robot, oracle, seed=seed).plan(
        q_home=HOME,
        picks=pick_options(scene.stand_in_cell(cell, 0.25), scene.cell(cell).T_base_cell)[:2],
        places=islice(place_options(release), 1),
    )


@needs_ompl
@pytest.mark.slow
def test_a_plan_names_the_motions_that_were_sampled(scene, monkeypatch):
    monkeypatch.setattr(planning, "MAX_TRIALS", 4)
    found = plan(scene, World(gate))
    assert found.sampled_motions == ("MOVE_TO_PLACE",)
    again = plan(scene, World(gate))
    for one, other in zip(found.motions, again.motions, strict=True):
        for leg, same in zip(one, other, strict=True):
            np.testing.assert_array_equal(leg.path.samples(0.05), same.path.samples(0.05))


@pytest.mark.parametrize(
    ("hand", "stage"),
    [
        (Hand.EMPTY, "MOVE_TO_PICK"),
        (Hand.HOLDING, "MOVE_TO_PLACE"),
        (Hand.RELEASED, "MOVE_HOME"),
    ],
)
def test_without_the_planner_no_path_names_stage_and_remedy(scene, monkeypatch, hand, stage):
    monkeypatch.setattr(sampling, "available", lambda: False)
    monkeypatch.setattr(planning, "MAX_TRIALS", 4)

    def free(q):  # a move is blocked on its way, its ends and the lines are free
        return len(q) == 1 or np.max(np.ptp(q, axis=0)) < 0.3

    with pytest.raises(CycleFailure) as caught:
        plan(scene, World(free, hand), cell=1)
    assert (caught.value.reason, caught.value.stage) == ("no_path", stage)
    assert "pip install ompl" in caught.value.detail


@pytest.mark.slow
def test_a_run_in_the_default_scene_never_imports_ompl(tmp_path):
    """Not even for a cell whose moves need detours; test_architecture shows it of the modules."""
    program = (
        "import sys\n"
        "from pathlib import Path\n"
        "from kr210_sim.config import RunConfig\n"
        "from kr210_sim.runner import run\n"
        "_, summary = run(RunConfig(cycles=1, cell='3', out=Path(sys.argv[1])))\n"
        "assert summary['succeeded'] == 1 and summary['sampled_motions'] == 0\n"
        "assert 'ompl' not in sys.modules\n"
    )
    subprocess.run([sys.executable, "-c", program, str(tmp_path / "run")], check=True)


def test_a_default_run_samples_nothing(default_run):
    assert default_run.summary["sampled_motions"] == 0
    assert all(score.as_json()["sampled_motions"] == [] for score in default_run.scores)


# ---- the bundled obstacles ------------------------------------------------------------------


@pytest.fixture(scope="module", params=["column", "low_beam"])
def obstacle_scene(request, robot, spec):
    return build_scene(find_scene(request.param), robot, spec)


def test_the_obstacle_scenes_share_shelf_and_bin(obstacle_scene, scene):
    assert obstacle_scene.time_limit == scene.time_limit
    for one, other in zip(obstacle_scene.cells, scene.cells, strict=True):
        np.testing.assert_array_equal(one.T_base_cell, other.T_base_cell)


@needs_ompl
@pytest.mark.slow
def test_sampled_paths_keep_their_clearance_between_the_checks(obstacle_scene):

    for cell in (2, 6, 7):
        simulation = Simulation(obstacle_scene)
        target = standing_target(obstacle_scene, cell)
        simulation.add(target)
        simulation.watch(target)
        oracle = MujocoOracle(simulation, obstacle_scene, target)
        found = plan(obstacle_scene, oracle, cell, seed=cell)
        assert "MOVE_TO_PLACE" in found.sampled_motions
        for motion in found.motions:
            for leg in motion:
                if leg.sampled:
                    q = leg.path.samples(0.002)
                    near = oracle.blocked(q, hand=leg.hand, clearance=CLEARANCE_FREE)
                    assert near is None, (cell, leg.stage)


@needs_ompl
@pytest.mark.slow
def test_a_scene_that_needs_the_planner_succeeds_with_the_same_bits_twice(obstacle_scene, tmp_path):
    lines = []
    for name in ("first", "second"):
        config = RunConfig(scene=obstacle_scene.name, cycles=1, out=tmp_path / name)
        out, summary = run(config)
        assert summary["succeeded"] == 1
        assert summary["sampled_motions"] >= 1
        line = json.loads((out / "cycles.jsonl").read_text())
        assert "MOVE_TO_PLACE" in line["sampled_motions"]
        lines.append({key: line[key] for key in line if key != "wall_clock"})
    assert lines[0] == lines[1]


@pytest.mark.slow
@needs_ompl
def test_a_scene_without_a_way_is_no_path_after_a_bounded_number_of_questions(
    tmp_path, monkeypatch
):
    asked = []
    blocked_each = MujocoOracle.blocked_each

    def counted(self, questions):
        asked.extend(len(question.q) == 1 for question in questions)
        return blocked_each(self, questions)

    monkeypatch.setattr(MujocoOracle, "blocked_each", counted)
    config = RunConfig(scene=str(NO_WAY), cycles=1, cell="8", out=tmp_path / "run")
    _, summary = run(config)
    assert summary["failures"] == {"no_path": 1}
    assert not summary["passed"]
    lines = (tmp_path / "run" / "cycles.jsonl").read_text().splitlines()
    assert [json.loads(line)["failed_stage"] for line in lines] == ["MOVE_HOME"]
    assert sum(asked) < CYCLE_CONFIGURATIONS + 1_500
    assert len(asked) - sum(asked) < 4_000


def test_the_limits_on_effort_are_numbers_of_configurations():
    assert SAMPLED_CONFIGURATIONS < CYCLE_CONFIGURATIONS
