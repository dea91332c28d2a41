"""The clearance oracle agrees with MuJoCo's distance function, asked pair by pair."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest
from conftest import standing_target

import ik
from kr210_sim.collision import MujocoOracle
from kr210_sim.planning import CLEARANCE_FREE, CyclePlanner, Hand
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
    path = plan.legs[stage].path
    for s in np.random.default_rng(20).uniform(0.02, 0.98, 15):
        assert distances.least(path(np.array([s]))[0], holding=holding) > clearance, s


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
    grasp = plan.legs["APPROACH"].path.end
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
    oracle.blocked(plan.legs["MOVE_HOME"].path.samples(0.05), hand=Hand.HOLDING, clearance=0.02)
    np.testing.assert_array_equal(simulation.data.qpos, before[0])
    np.testing.assert_array_equal(simulation.model.geom_margin, before[1])
    assert simulation.model.opt.disableflags == flags


def test_a_target_in_the_bin_is_an_obstacle(oracle, world, scene, plan):
    """The tool may come down beside what lies there, not upon it."""
    simulation, _ = world
    down = scene.robot.forward(plan.legs["LOWER"].path.end)
    on_top = down.copy()
    on_top[:3, 3] = simulation.data.body("target_0").xpos
    on_top[2, 3] += 0.1
    verdicts = []
    for T in (down, on_top):
        q = configuration(scene, T, plan.legs["LOWER"].path.end)[None]
        verdicts.append(oracle.blocked(q, hand=Hand.HOLDING, clearance=CLEARANCE_FREE))
    assert verdicts[0] is None
    assert "target_0" in verdicts[1]
