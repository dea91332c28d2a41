"""The monitor notes the first breach of every condition, at the step where it happened."""

from __future__ import annotations

import numpy as np
import pytest
from conftest import standing_target

from kr210_sim.control import Controller
from kr210_sim.mjcf import TIMESTEP
from kr210_sim.monitor import Monitor
from kr210_sim.record import SERIES
from kr210_sim.simulation import Simulation

STEPS = 20


class Bench:
    """A monitor over a world at rest, fed with measurements that a test makes up."""

    def __init__(self, world: Simulation) -> None:
        self.simulation = world
        self.monitor = Monitor(world)
        self.columns = self.simulation.columns
        rest = np.array(self.simulation.data.sensordata)
        rest[self.columns["target_velocity"]] = 0.0
        rest[self.columns["target_spin"]] = 0.0
        self.rest = rest

    def rows(self, count: int = STEPS) -> np.ndarray:
        return np.tile(self.rest, (count, 1))

    def held(self, height: float, count: int = STEPS) -> np.ndarray:
        """Return measurements of a target between both fingers, that high above its board."""
        rows = self.rows(count)
        rows[:, self.columns["target_position"].start + 2] += height
        for name in ("target_support", "target_bin"):
            rows[:, self.columns[name].start] = 0
        for name in ("target_right", "target_left"):
            rows[:, self.columns[name]] = [2.0, 0.0, 250.0, 0.0]
        rows[:, self.columns["target_all"].start] = 4
        rows[:, self.columns["robot_all"].start] = 4
        rows[:, self.columns["robot_target"].start] = 4
        return rows

    def feed(self, rows: np.ndarray, stage: str = "MOVE_TO_PLACE") -> None:
        commands = Controller(self.simulation).next(len(rows))
        self.simulation.measured = np.tile(self.simulation.data.qpos, (len(rows), 1))
        self.monitor.observe(rows, commands, stage)

    def at(self, name: str, index: int = 0) -> int:
        return self.columns[name].start + index

    @property
    def reasons(self) -> list[str]:
        return [event.reason for event in self.monitor.events]


@pytest.fixture(scope="module")
def world(scene) -> Simulation:
    """A target at rest, watched; nothing here moves it."""
    simulation, target = Simulation(scene), standing_target(scene, 5)
    simulation.add(target)
    simulation.watch(target)
    return simulation


@pytest.fixture
def bench(world) -> Bench:
    return Bench(world)


def test_a_world_at_rest_breaks_nothing(bench):
    bench.feed(bench.rows())
    assert bench.monitor.events == []
    assert bench.monitor.time == pytest.approx(STEPS * TIMESTEP)
    assert not bench.monitor.lifted


def test_every_series_of_the_record_is_kept_at_every_record_step(bench):
    for _ in range(3):
        bench.feed(bench.rows())
    series = bench.monitor.series()
    assert set(series) == set(SERIES)
    assert {len(values) for values in series.values()} == {3}
    np.testing.assert_allclose(series["time"], STEPS * TIMESTEP * np.array([1, 2, 3]))
    assert np.all(series["tracking_max"] < 1e-9)


def test_no_measurements_change_nothing(bench):
    bench.feed(bench.rows(0))
    assert bench.monitor.time == 0.0
    assert bench.monitor.series() == {}


@pytest.mark.parametrize("joint", [0, 3, 5])
@pytest.mark.parametrize("side", ["lower", "upper"])
def test_a_position_limit_may_be_passed_by_a_tenth_of_a_milliradian(bench, joint, side):
    robot = bench.simulation.scene.robot
    limit = getattr(robot, side)[joint]
    sign = 1.0 if side == "upper" else -1.0
    for excess, expected in ((0.9e-4, []), (1.1e-4, ["limits_exceeded"])):
        rows = bench.rows()
        rows[11, bench.at(f"q/{robot.arm_joints[joint]}")] = limit + sign * excess
        bench.feed(rows)
        assert bench.reasons == expected
    event = bench.monitor.events[0]
    assert robot.arm_joints[joint] in event.detail
    assert event.time == pytest.approx((STEPS + 11) * TIMESTEP)
    assert event.stage == "MOVE_TO_PLACE"


@pytest.mark.parametrize(
    ("name", "field", "good", "bad"),
    [("qd", "velocity", 1.019, 1.021), ("effort", "effort", 0.989, 0.99)],
)
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_speed_and_effort_have_their_limits_in_both_directions(bench, name, field, good, bad, sign):
    robot = bench.simulation.scene.robot
    for share, expected in ((good, []), (bad, ["limits_exceeded"])):
        rows = bench.rows()
        rows[3, bench.at(f"{name}/joint_2")] = sign * share * getattr(robot, field)[1]
        bench.feed(rows)
        assert bench.reasons == expected
    assert "joint_2" in bench.monitor.events[0].detail


@pytest.mark.parametrize("whose", ["robot_all", "target_all"])
def test_a_contact_that_is_not_permitted_is_a_collision(bench, whose):
    rows = bench.rows()
    rows[-1, bench.at(whose)] += 1
    bench.feed(rows)
    assert bench.reasons == ["collision"]
    assert bench.monitor.series()["foreign_contacts_max"][0] == 1


def test_contacts_of_the_target_with_fingers_support_and_bin_are_permitted(bench):
    rows = bench.held(0.0)
    rows[:, bench.at("target_support")] = 3
    rows[:, bench.at("target_bin")] = 1
    rows[:, bench.at("target_all")] += 4
    bench.feed(rows)
    assert bench.monitor.events == []


# ---- the lift and the hold ------------------------------------------------------------------


@pytest.mark.parametrize(("height", "lifted"), [(0.0099, False), (0.0101, True)])
def test_lifted_means_one_centimetre_between_both_fingers(bench, height, lifted):
    bench.feed(bench.held(height))
    assert bench.monitor.lifted is lifted


@pytest.mark.parametrize("finger", ["target_right", "target_left"])
def test_a_target_on_one_finger_is_not_lifted(bench, finger):
    rows = bench.held(0.05)
    rows[:, bench.columns[finger]] = 0.0
    rows[:, bench.at("target_all")] = 2
    bench.feed(rows)
    assert not bench.monitor.lifted


def test_a_target_that_touches_something_else_too_is_not_lifted(bench):
    rows = bench.held(0.05)
    rows[:, bench.at("target_all")] += 1
    rows[:, bench.at("target_support")] = 1
    bench.feed(rows)
    assert not bench.monitor.lifted


@pytest.mark.parametrize("finger", ["target_right", "target_left"])
def test_a_finger_that_loses_the_target_for_one_step_has_dropped_it(bench, finger):
    bench.feed(bench.held(0.03))
    rows = bench.held(0.03)
    rows[7, bench.columns[finger]] = 0.0
    for name in ("target_all", "robot_all", "robot_target"):
        rows[7, bench.at(name)] -= 2
    bench.feed(rows)
    assert bench.reasons == ["dropped"]
    assert bench.monitor.events[0].time == pytest.approx((STEPS + 7) * TIMESTEP)


@pytest.mark.parametrize(("slip", "reasons"), [(0.0049, []), (0.0051, ["dropped"])])
def test_slip_is_the_shift_in_the_tcp_frame_since_lift_off(bench, slip, reasons):
    bench.feed(bench.held(0.02))
    rows = bench.held(0.02)
    rows[4:, bench.columns["held_position"]] += slip * np.array([0.6, 0.0, -0.8])
    bench.feed(rows)
    assert bench.reasons == reasons
    assert bench.monitor.series()["slip_m_max"][-1] == pytest.approx(slip)


@pytest.mark.parametrize("angle", [1e-6, 0.01, 1.0])
def test_a_turn_in_the_hand_is_measured_from_lift_off_whatever_its_sign(bench, angle):
    bench.feed(bench.held(0.02))
    w, x, y, z = bench.rest[bench.columns["held_quat_wxyz"]]
    c, s = np.cos(angle / 2), np.sin(angle / 2)
    turned = np.array([c * w - s * z, c * x + s * y, c * y - s * x, c * z + s * w])
    for sign in (1.0, -1.0):
        rows = bench.held(0.02)
        rows[:, bench.columns["held_quat_wxyz"]] = sign * turned
        bench.feed(rows)
        assert bench.monitor.series()["slip_rad_max"][-1] == pytest.approx(
            angle, rel=1e-3, abs=1e-7
        )


def test_after_the_release_nothing_can_be_dropped(bench):
    bench.feed(bench.held(0.03))
    bench.monitor.released = True
    rows = bench.rows()
    rows[:, bench.columns["target_position"].start + 2] += 0.03  # where it was held
    bench.feed(rows, "OPEN_GRIPPER")
    assert bench.monitor.events == []


def test_before_the_lift_nothing_can_be_dropped(bench):
    bench.feed(bench.held(0.001), "CLOSE_GRIPPER")
    bench.feed(bench.rows(), "CLOSE_GRIPPER")
    assert bench.monitor.events == []


# ---- order and rest -------------------------------------------------------------------------


def test_the_earlier_of_two_breaches_in_one_record_step_comes_first(bench):
    robot = bench.simulation.scene.robot
    rows = bench.rows()
    rows[12, bench.at("robot_all")] += 1
    rows[5, bench.at("qd/joint_1")] = 2 * robot.velocity[0]
    bench.feed(rows)
    assert bench.reasons == ["limits_exceeded", "collision"]


def test_a_reason_is_noted_once(bench):
    rows = bench.rows()
    rows[:, bench.at("robot_all")] += 1
    bench.feed(rows)
    bench.feed(rows)
    assert bench.reasons == ["collision"]


@pytest.mark.parametrize(
    ("name", "good", "bad"), [("target_velocity", 0.0049, 0.0051), ("target_spin", 0.049, 0.051)]
)
def test_a_target_rests_below_5_mm_and_50_mrad_a_second(bench, name, good, bad):
    rows = bench.rows()
    rows[:, bench.at(name, 1)] = good
    bench.feed(rows)
    bench.feed(rows)
    assert bench.monitor.resting_for == pytest.approx(2 * STEPS * TIMESTEP)
    rows[14, bench.at(name, 2)] = -bad
    bench.feed(rows)
    assert bench.monitor.resting_for == pytest.approx((STEPS - 15) * TIMESTEP)


def test_forces_and_fingers_are_the_latest(bench):
    rows = bench.held(0.02)
    rows[-1, bench.columns["target_right"]] = [2.0, 30.0, 0.0, 40.0]
    rows[-1, bench.columns["target_left"]] = 0.0
    bench.feed(rows)
    np.testing.assert_allclose(bench.monitor.force, [50.0, 0.0])
    assert bench.monitor.touching.tolist() == [True, False]


# ---- how the target is held -----------------------------------------------------------------


@pytest.mark.parametrize(("along", "ratio"), [(0.0, 0.0), (50.0, 0.2), (500.0, 2.0)])
@pytest.mark.parametrize("turn", [0.0, 0.7, np.pi / 2])
def test_friction_is_the_force_along_the_jaws_whichever_way_the_hand_is_turned(
    bench, scene, along, ratio, turn
):
    rows = bench.held(0.02)
    rows[:, bench.columns["tcp_quat_wxyz"]] = [np.cos(turn / 2), np.sin(turn / 2), 0.0, 0.0]
    across, tangent = np.array([0.0, np.cos(turn), np.sin(turn)]), np.array([1.0, 0.0, 0.0])
    rotation = scene.T_world_base[:3, :3]
    for name, sign in (("target_right", 1), ("target_left", -1)):
        rows[:, bench.at(name, 1) : bench.at(name, 4)] = rotation @ (
            sign * 250.0 * across + along * tangent
        )
    bench.feed(rows)
    np.testing.assert_allclose(bench.monitor.friction_ratio, ratio, atol=1e-12)
    np.testing.assert_allclose(bench.monitor.force, np.hypot(250.0, along))
