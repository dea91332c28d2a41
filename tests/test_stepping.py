"""Record steps that are simulated at once give the bits of single ones, whatever happens."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from conftest import standing_target

from kr210_sim.control import Controller
from kr210_sim.cycle import CycleSetup, run_cycle
from kr210_sim.record import CycleRecord
from kr210_sim.simulation import Simulation
from kr210_sim.stepping import Stepping, Stopped
from kr210_sim.variation import Variation

WEAK = np.full(6, 0.02)  # share of the servos' force with which a motion overshoots


def played(scene, limits, variation: Variation, *, singly: bool) -> tuple[CycleRecord, Simulation]:
    """Run a cycle; a probe, though it does nothing, has record steps simulated one by one."""
    simulation, target = Simulation(scene), standing_target(scene, 5)
    simulation.add(target)
    setup = CycleSetup(cycle=0, episode=0, seed=0, limits=limits, variation=variation)
    probe = (lambda *_: None) if singly else None
    return run_cycle(simulation, target, setup, probe=probe), simulation


@pytest.mark.parametrize(
    ("reason", "variation", "time_limit"),
    [
        pytest.param(None, Variation(delay=0.001), 60.0, marks=pytest.mark.slow),
        pytest.param("limits_exceeded", Variation(gain=WEAK), 60.0, marks=pytest.mark.slow),
        ("tracking", Variation(gain=WEAK / 4), 60.0),
        ("timeout", Variation(), 0.3),
    ],
)
def test_a_cycle_has_the_same_bits_step_by_step(scene, limits, reason, variation, time_limit):
    world = replace(scene, time_limit=time_limit)
    together, one = played(world, limits, variation, singly=False)
    alone, other = played(world, limits, variation, singly=True)
    assert [event.reason for event in together.events] == [reason] * (reason is not None)
    assert together.events == alone.events
    assert together.final == alone.final
    assert together.series.keys() == alone.series.keys()
    for name, values in alone.series.items():
        assert together.series[name].tobytes() == values.tobytes(), name
    for name in ("time", "qpos", "qvel", "sensordata", "qacc_warmstart"):
        assert getattr(one.data, name) == pytest.approx(getattr(other.data, name), abs=0), name


@pytest.fixture
def stepping(scene) -> Stepping:
    simulation, target = Simulation(scene), standing_target(scene, 5)
    simulation.add(target)
    simulation.watch(target)
    return Stepping(simulation, 0.0, None)


def test_steps_end_at_the_first_contact_that_is_not_permitted(stepping):
    """The same one as if every step were looked at by itself, and in the same state."""
    simulation = stepping.simulation
    ctrl = np.tile(simulation.data.ctrl, (400, 1))
    ctrl[:, simulation.addresses.arm_ctrl[1]] = np.linspace(0.0, 0.5, len(ctrl))  # to the shelf
    rows = simulation.step(ctrl)
    end, pair = np.array(simulation.data.qpos), simulation.foreign_pair()
    assert 1 < len(rows) < len(ctrl)
    assert len(simulation.measured) == len(rows)
    simulation.undo()
    singly = [simulation.step(ctrl[index : index + 1]) for index in range(len(rows))]
    np.testing.assert_array_equal(np.concatenate(singly), rows)
    np.testing.assert_array_equal(simulation.data.qpos, end)
    assert simulation.foreign_pair() == pair
    foreign = rows @ simulation.foreign_weights > 0.5
    assert foreign[-1]
    assert not foreign[:-1].any()


def test_what_is_undone_leaves_no_trace(stepping):
    simulation, controller = stepping.simulation, stepping.controller
    controller.drive_fingers(simulation.scene.robot.finger_closed)
    first = controller.next(40)
    rows = simulation.step(first.ctrl)
    controller.undo()
    simulation.undo()
    again = controller.next(40)
    np.testing.assert_array_equal(again.ctrl, first.ctrl)
    np.testing.assert_array_equal(simulation.step(again.ctrl), rows)


def test_delayed_commands_are_undone_with_the_rest(scene):
    controller = Controller(Simulation(scene), 0.003)
    controller.drive_fingers(scene.robot.finger_closed)
    first = controller.next(10).ctrl
    controller.undo()
    np.testing.assert_array_equal(controller.next(10).ctrl, first)


def test_a_breach_within_several_record_steps_stops_at_its_own(stepping):
    monitor, simulation = stepping.monitor, stepping.simulation
    monitor.lifted = True  # as if it had been carried: no finger touches it
    with pytest.raises(Stopped):
        stepping.advance(5)
    assert [event.reason for event in monitor.events] == ["dropped"]
    assert len(monitor.series()["time"]) == 1
    assert simulation.data.time == pytest.approx(monitor.time)
