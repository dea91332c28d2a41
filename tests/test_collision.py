"""The clearance oracle agrees with MuJoCo's distance function, asked pair by pair."""

from __future__ import annotations

from itertools import pairwise

import mujoco
import numpy as np
import pytest
from conftest import standing_target

import ik
from kr210_sim import pairs
from kr210_sim.advance import Stretches
from kr210_sim.collision import MujocoOracle
from kr210_sim.criteria import CLEARANCE_FREE
from kr210_sim.legs import Question
from kr210_sim.motions import timed_motions
from kr210_sim.planning import ClearanceOracle, CyclePlan, CyclePlanner, Hand, Leg
from kr210_sim.scene import ROBOT_PREFIX
from kr210_sim.simulation import Simulation
from kr210_sim.task import pick_options, place_options, release_point


@pytest.fixture(scope="module")
def world(scene):
    """A simulation with a target in cell 6, and one that already lies in the bin."""
    simulation = Simulation(scene)
    simulation.add(standing_target(scene, 1, number=0))
    lying = simulation.data.joint("target_0").qpos
    lying[:3] = scene.place.T_base_place[:3, 3] + [0.1, 0.1, -0.05]
    lying[3:] = [np.sqrt(0.5), np.sqrt(0.5), 0.0, 0.0]
    target = standing_target(scene, 6, number=1)
    simulation.add(target)
    return simulation, target


@pytest.fixture(scope="module")
def oracle(world, scene):
    simulation, target = world
    return MujocoOracle(simulation, scene, target)


@pytest.fixture(scope="module")
def plan(world, oracle, scene):
    simulation, target = world
    place = scene.place
    release = release_point(
        place.T_base_place, place.half_size, place.kind, target.length, simulation.placed()
    )
    return CyclePlanner(scene.robot, oracle).plan(
        q_home=np.zeros(6),
        picks=pick_options(target.T_base_target, scene.cell(6).T_base_cell),
        places=place_options(release),
    )


def legs_of(plan: CyclePlan, stage: str) -> list[Leg]:
    return [leg for motion in plan.motions for leg in motion if leg.stage == stage]


class Distances:
    """Smallest distances by mj_geomDistance, in a model and data of their own."""

    def __init__(self, simulation: Simulation, target: str) -> None:
        self.model = model = simulation.model
        self.data = mujoco.MjData(model)
        self.data.qpos[:] = simulation.data.qpos
        self.simulation, self.target = simulation, target
        solid = [g for g in range(model.ngeom) if model.geom_contype[g]]
        name = {g: model.body(int(model.geom_bodyid[g])).name for g in solid}
        self.robot = [
            g
            for g in solid
            if name[g].startswith(ROBOT_PREFIX) and not name[g].endswith(("base_link", "link_1"))
        ]
        self.held = [g for g in solid if name[g] == target]
        self.rest = [g for g in solid if not name[g].startswith(ROBOT_PREFIX) and name[g] != target]

    def least(self, q: np.ndarray, *, holding: bool) -> float:
        model, data, scene = self.model, self.data, self.simulation.scene
        data.qpos[self.simulation.addresses.arm] = q
        data.qpos[self.simulation.addresses.fingers] = scene.robot.finger_open
        if holding:
            T = scene.T_world_base @ scene.robot.forward(q)
            first = int(model.joint(self.target).qposadr[0])
            data.qpos[first : first + 3] = T[:3, 3]
            mujoco.mju_mat2Quat(data.qpos[first + 3 : first + 7], T[:3, :3].ravel())
        mujoco.mj_kinematics(model, data)
        moving = self.robot + (self.held if holding else [])
        return min(
            mujoco.mj_geomDistance(model, data, a, b, 0.05, None) for a in moving for b in self.rest
        )


@pytest.mark.parametrize(
    ("stage", "holding", "clearance"),
    [
        ("MOVE_TO_PICK", False, 0.01),
        ("APPROACH", False, 0.003),
        ("WITHDRAW", True, 0.003),
        ("MOVE_TO_PLACE", True, 0.01),
        ("LOWER", True, 0.01),
        ("MOVE_HOME", False, 0.01),
    ],
)
def test_a_planned_leg_keeps_its_distance_at_configurations_nobody_checked(
    world, plan, stage, holding, clearance
):
    simulation, target = world
    distances = Distances(simulation, target.name)
    for leg in legs_of(plan, stage):
        for share in np.random.default_rng(20).uniform(0.02, 0.98, 15):
            q = leg.path(np.array([share * leg.path.length]))[0]
            assert distances.least(q, holding=holding) > clearance, share


def test_rounded_corners_keep_their_distance_at_instants_nobody_checked(
    world, oracle, plan, limits
):
    """Every overlap of the trajectories as they will be run, every few milliseconds."""
    simulation, target = world
    distances = Distances(simulation, target.name)
    corners = 0
    for motion in plan.motions:
        trajectory = timed_motions([motion], oracle, limits)[0].trajectory
        for corner, (before, after) in enumerate(pairwise(motion)):
            begin, end = trajectory.starts[corner + 1], trajectory.ends[corner]
            if end - begin < 1e-6:
                continue
            corners += 1
            clearance = min(before.clearance, after.clearance)
            holding = after.hand in (Hand.LIFTING, Hand.HOLDING)
            t = np.linspace(begin, end, 60) + np.random.default_rng(22).uniform(0, 1e-3, 60)
            for q in trajectory(t)[0]:
                least = distances.least(q, holding=holding)
                assert least > clearance - 1e-3, (before.stage, after.stage)
    assert corners >= 3


def test_a_corner_that_is_blocked_is_not_rounded(plan, limits):
    class Wall(ClearanceOracle):
        def blocked(self, q, *, hand, clearance):
            asked.append((hand, clearance))
            return "a wall"

    asked: list[tuple[Hand, float]] = []
    for motion in plan.motions:
        asked.clear()
        trajectory = timed_motions([motion], Wall(), limits)[0].trajectory
        np.testing.assert_allclose(trajectory.ends[:-1], trajectory.starts[1:], atol=1e-9)
        allowed = {
            (after.hand, min(before.clearance, after.clearance))
            for before, after in pairwise(motion)
        }
        assert set(asked) <= allowed


def test_the_oracle_refuses_what_is_too_near_and_nothing_else(world, oracle):
    """At random configurations above the floor, compared with the distances themselves."""
    simulation, target = world
    distances = Distances(simulation, target.name)
    rng = np.random.default_rng(21)
    verdicts = []
    for _ in range(80):
        q = rng.uniform([-1.6, -0.4, -0.8, -1, -1, -1], [1.6, 0.9, 0.6, 1, 1, 1])
        least = distances.least(q, holding=False)
        if abs(least - CLEARANCE_FREE) > 1e-3:
            near = oracle.blocked(q[None], hand=Hand.RELEASED, clearance=CLEARANCE_FREE)
            verdicts.append((near is not None, least < CLEARANCE_FREE))
    refused = [verdict for verdict, _ in verdicts]
    assert all(verdict or not too_near for verdict, too_near in verdicts)
    assert any(refused)
    assert not all(refused)


def test_home_is_free(oracle):
    for hand in (Hand.EMPTY, Hand.RELEASED, Hand.HOLDING):
        assert oracle.blocked(np.zeros((1, 6)), hand=hand, clearance=CLEARANCE_FREE) is None


def test_an_arm_in_the_shelf_is_blocked_by_name(oracle, scene):
    answer = oracle.blocked(
        np.array([[0.17, 0.45, -0.2, 0.0, 0.0, 0.0]]), hand=Hand.EMPTY, clearance=CLEARANCE_FREE
    )
    assert answer is not None
    assert "shelf" in answer
    assert "mm" in answer


def test_one_bad_configuration_among_many_is_found(oracle):
    q = np.zeros((101, 6))
    for index in (0, 37, 100):
        bad = q.copy()
        bad[index] = [0.17, 0.45, -0.2, 0.0, 0.0, 0.0]
        assert oracle.blocked(bad, hand=Hand.EMPTY, clearance=CLEARANCE_FREE) is not None, index
    assert oracle.blocked(q, hand=Hand.EMPTY, clearance=CLEARANCE_FREE) is None


def configuration(scene, T_base_tcp: np.ndarray, near: np.ndarray) -> np.ndarray:
    """Return the configuration (6,) nearest to another that reaches a TCP pose."""
    answer = ik.inverse(scene.robot.geometry, scene.robot.tcp_to_palm(T_base_tcp))
    found = answer.q[answer.valid]
    found = near + (found - near + np.pi) % (2 * np.pi) - np.pi
    return found[np.argmin(np.max(np.abs(found - near), axis=1))]


def test_the_hand_decides_whether_the_target_is_an_obstacle(oracle, plan, scene):
    """25 mm beside the grasp a jaw is in the target, unless the target is held or gone."""
    grasp = legs_of(plan, "APPROACH")[-1].path.end
    beside = scene.robot.forward(grasp)
    beside[:3, 3] += 0.025 * beside[:3, 1]
    q = configuration(scene, beside, grasp)[None]
    near = {hand: oracle.blocked(q, hand=hand, clearance=0.004) for hand in Hand}
    assert {hand for hand, what in near.items() if what and "finger" in what} == {
        Hand.EMPTY,
        Hand.AROUND,
    }


def test_asking_changes_nothing_in_the_simulation(world, oracle, plan):
    simulation, _ = world
    before = simulation.data.qpos.copy(), simulation.model.geom_margin.copy()
    flags = simulation.model.opt.disableflags
    oracle.blocked(
        legs_of(plan, "MOVE_HOME")[0].path.samples(0.05), hand=Hand.HOLDING, clearance=0.02
    )
    np.testing.assert_array_equal(simulation.data.qpos, before[0])
    np.testing.assert_array_equal(simulation.model.geom_margin, before[1])
    assert simulation.model.opt.disableflags == flags


def test_a_target_in_the_bin_is_an_obstacle(oracle, world, scene, plan):
    """The tool may come down beside what lies there, not upon it."""
    simulation, _ = world
    down = scene.robot.forward(legs_of(plan, "LOWER")[-1].path.end)
    on_top = down.copy()
    on_top[:3, 3] = simulation.data.body("target_0").xpos
    on_top[2, 3] += 0.1
    verdicts = []
    for T in (down, on_top):
        q = configuration(scene, T, legs_of(plan, "LOWER")[-1].path.end)[None]
        verdicts.append(oracle.blocked(q, hand=Hand.HOLDING, clearance=CLEARANCE_FREE))
    assert verdicts[0] is None
    assert "target_0" in verdicts[1]


# ---- whole paths ----------------------------------------------------------------------------


def random_moves(count: int, seed: int):
    """Yield pairs of configurations in and before the shelf."""
    rng = np.random.default_rng(seed)
    for _ in range(count):
        q = rng.uniform([-0.6, 0.0, -0.6, -1, -1, -1], [0.6, 0.7, 0.3, 1, 1, 1])
        yield np.stack([q, q + rng.normal(size=6) * [0.3, 0.2, 0.2, 0.5, 0.4, 0.5]])


@pytest.mark.slow
@pytest.mark.parametrize("hand", [Hand.RELEASED, Hand.HOLDING])
def test_advancing_never_misses_what_a_dense_grid_finds(world, oracle, hand):
    simulation, target = world
    distances = Distances(simulation, target.name)
    verdicts = []
    for ends in random_moves(6, seed=51):
        count = int(np.max(np.abs(ends[1] - ends[0])) / 0.004) + 2
        dense = [
            distances.least(q, holding=hand is Hand.HOLDING) for q in np.linspace(*ends, count)
        ]
        blocked = oracle.blocked(ends, hand=hand, clearance=CLEARANCE_FREE) is not None
        verdicts.append(blocked)
        assert blocked or min(dense) >= CLEARANCE_FREE
        measured = oracle.least(ends, hand=hand)
        assert min(dense) - 1e-6 <= max(measured, 0.05) + 4e-3 * blocked
        if min(dense) < 0.05:  # Distances sees no farther
            assert measured <= min(dense) + 3e-3
            assert measured >= min(dense) - 4e-3
    assert any(verdicts)
    assert not all(verdicts)


def test_paths_asked_for_together_have_the_answers_they_have_one_by_one(oracle):
    """Of all hands and clearances at once: none is judged by the rules of another."""
    hands, clearances = list(Hand), (0.004, 0.02, 0.05)
    questions = [
        Question(q=q, hand=hands[index % 5], clearance=clearances[index % 3])
        for index, q in enumerate([*random_moves(28, seed=54), np.zeros((1, 6)), np.zeros((5, 6))])
    ]
    together = oracle.blocked_each(questions)
    alone = [oracle.blocked(one.q, hand=one.hand, clearance=one.clearance) for one in questions]
    assert [what is None for what in together] == [what is None for what in alone]
    assert 5 < sum(what is None for what in alone) < 25
    assert oracle.blocked_each([]) == []
    assert len({what.split(" within ")[0] for what in together if what}) > 2


@pytest.mark.parametrize("hand", [Hand.EMPTY, Hand.HOLDING])
def test_no_travel_that_a_look_allows_comes_too_near(oracle, scene, plan, hand):
    """The bound itself, to its very end, from where planned legs lead and in random directions."""
    eyes, rng = oracle._eyes, np.random.default_rng(5)
    legs = [leg for motion in plan.motions for leg in motion if leg.hand is hand]
    shares = rng.uniform(0.0, 1.0, (60, 1))
    q = np.concatenate([leg.path(shares[:, 0] * leg.path.length) for leg in legs])
    q = q + rng.normal(0.0, 0.05, q.shape)
    hands = np.full(len(q), pairs.HANDS[hand])
    required = np.tile([-np.inf, pairs.SELF_CLEARANCE, 0.004], (len(q), 1))
    seen = eyes.see(q, hands, required)
    excess = seen.distance - required[0, seen.kind]
    room = pairs.room(seen, excess, required[:, pairs.FREE])
    least = np.full(len(q), pairs.NEAR)
    np.minimum.at(least, seen.row, excess)
    free = least > 1e-3
    assert np.sum(free) > 20
    used_up = 0.0
    # At random, and along straight lines of the TCP, on which what joints do adds up to little.
    twists = np.concatenate([rng.normal(size=(20, 3)), np.zeros((20, 3))], axis=1)
    straight = np.linalg.solve(
        ik.jacobian(scene.robot.geometry, q),
        np.broadcast_to(twists[:, None, :, None], (20, len(q), 6, 1)),
    )[..., 0]
    for index in range(40):
        sparse = rng.normal(size=q.shape) * (rng.uniform(size=q.shape) < 0.4)
        travel = sparse if index < 20 else straight[index - 20]
        change = travel.T[:, None]
        share = room(Stretches(change=change, travel=np.abs(change), bend=np.zeros_like(change)))
        for part in (0.3, 0.7, 1.0):
            moved = (q + part * travel * np.minimum(share, 1.0).T)[free]
            after = eyes.see(moved, hands[free], np.full((len(moved), 3), 1.0))
            counts = (after.kind == pairs.FREE) & (after.pair < len(pairs._PAIRS))
            assert np.min(after.distance[counts] - 0.004) > -1e-6
        nearest = np.full(len(moved), pairs.NEAR)
        np.minimum.at(nearest, after.row[counts], after.distance[counts] - 0.004)
        used_up = max(used_up, float(np.max(1 - nearest / least[free])))
    assert used_up > 0.4  # or the bound would be of little use


def test_the_answer_depends_on_the_path_not_on_how_many_points_draw_it(oracle):
    for ends in random_moves(8, seed=52):
        answers = [
            oracle.blocked(np.linspace(*ends, count), hand=Hand.RELEASED, clearance=0.02) is None
            for count in (2, 3, 50)
        ]
        if abs(oracle.least(ends, hand=Hand.RELEASED) - 0.02) > 5e-3:
            assert len(set(answers)) == 1


def test_a_free_move_takes_a_small_part_of_the_looks_of_a_grid(oracle, plan):
    before = oracle.looks
    for leg in legs_of(plan, "MOVE_HOME"):
        q = np.stack([leg.path.start, leg.path.end])
        assert oracle.blocked(q, hand=Hand.RELEASED, clearance=CLEARANCE_FREE) is None
    assert oracle.looks - before < 80


def test_boxes_that_mujocos_contacts_miss_are_seen(world, oracle, scene):
    """Its box-box function reports no contact, or one that is too far, for many boxes apart."""
    simulation, target = world
    distances = Distances(simulation, target.name)
    rng = np.random.default_rng(53)
    for _ in range(40):
        q = rng.uniform([-1.6, -0.4, -0.8, -1, -1, -1], [1.6, 0.9, 0.6, 1, 1, 1])
        least = distances.least(q, holding=False)
        if 0.0 < least < 0.05:
            assert oracle.least(q[None], hand=Hand.RELEASED) == pytest.approx(least, abs=1e-5)
