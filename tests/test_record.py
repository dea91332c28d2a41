"""A record goes to disk and comes back, and shows an unbroken course of events."""

from __future__ import annotations

import numpy as np
import pytest

from kr210_sim.exceptions import BadInput
from kr210_sim.record import POINTS, RECORD_STEP, SERIES, STAGES, load_series, save_record


def test_a_saved_record_comes_back_to_float32(good_cycle, tmp_path):
    record = good_cycle.record
    path = tmp_path / "deep" / "0000.npz"
    save_record(record, path)
    loaded = load_series(path)
    for name in SERIES:
        assert loaded[name].dtype == np.float32
        np.testing.assert_array_equal(loaded[name], record.series[name].astype(np.float32))
    assert tuple(loaded["stage_names"]) == STAGES
    assert list(loaded["joint_names"]) == list(record.start)
    assert loaded["joint_widths"].sum() == loaded["qpos"].shape[1]


def test_a_saved_record_needs_no_pickle(good_cycle, tmp_path):
    path = tmp_path / "0000.npz"
    save_record(good_cycle.record, path)
    with np.load(path, allow_pickle=False) as archive:
        assert set(SERIES) | set(POINTS) <= set(archive.files)


def test_a_record_with_wrong_bytes_is_damaged_whatever_they_break(good_cycle, tmp_path):
    path = tmp_path / "record.npz"
    save_record(good_cycle.record, path)
    content = path.read_bytes()
    for start in range(0, len(content), len(content) // 60):
        path.write_bytes(content[:start] + b"\xff" * 64 + content[start + 64 :])
        with pytest.raises(BadInput, match="damaged"):
            load_series(path)


def test_a_record_keeps_every_point_that_was_solved(good_cycle, robot, tmp_path):
    path = tmp_path / "0000.npz"
    save_record(good_cycle.record, path)
    loaded = load_series(path)
    for name in POINTS:
        assert len(loaded[name]) == len(good_cycle.ik_offset_m) > 30
    np.testing.assert_allclose(loaded["ik_offset_m"], good_cycle.ik_offset_m, rtol=1e-6)
    grasped = good_cycle.record.series["stage"] == STAGES.index("CLOSE_GRIPPER")
    p_base_grasp = good_cycle.record.series["tcp_measured"][grasped][-1, :3]
    gaps = np.linalg.norm(loaded["ik_tcp"][:, :3] - p_base_grasp, axis=1)
    assert gaps.min() < 1e-3


def test_a_record_has_a_row_for_every_record_step_and_no_gaps(default_run):
    for score in default_run.scores:
        series = score.record.series
        assert set(series) == set(SERIES)
        count = len(series["time"])
        assert {len(values) for values in series.values()} == {count}
        np.testing.assert_allclose(series["time"], RECORD_STEP * np.arange(1, count + 1))
        assert all(np.all(np.isfinite(values)) for values in series.values())


def test_stages_follow_each_other_in_order(default_run):
    for score in default_run.scores:
        stages = score.record.series["stage"].astype(int)
        assert np.all(np.diff(stages) >= 0)
        assert set(stages) >= set(range(STAGES.index("SETTLE")))


def test_quaternions_in_a_record_are_unit_and_follow_each_other(good_cycle):
    series = good_cycle.record.series
    for name in ("tcp_commanded", "tcp_measured"):
        quat_wxyz = series[name][:, 3:]
        np.testing.assert_allclose(np.linalg.norm(quat_wxyz, axis=1), 1.0, atol=1e-9)
    dot = np.abs(np.sum(series["tcp_commanded"][:, 3:] * series["tcp_measured"][:, 3:], axis=1))
    assert np.all(dot > np.cos(0.01))


def test_the_arm_never_moves_faster_in_the_record_than_its_limits(default_run, robot):
    """10 ms apart, so no faster on average either; the position itself is the witness."""
    for score in default_run.scores:
        names = list(score.record.start)
        widths = [len(values) for values in score.record.start.values()]
        first = dict(zip(names, np.cumsum([0, *widths[:-1]]), strict=True))
        arm = [first[f"robot/{name}"] for name in robot.arm_joints]
        q = score.record.series["qpos"][:, arm]
        assert np.all(np.abs(np.diff(q, axis=0)) <= 1.02 * robot.velocity * RECORD_STEP)
        assert np.all((q >= robot.lower - 1e-4) & (q <= robot.upper + 1e-4))


def test_the_positions_in_a_record_are_those_that_were_measured(good_cycle, robot):
    record = good_cycle.record
    columns = dict(zip(record.start, _columns(record), strict=True))
    q = np.column_stack(
        [record.series["qpos"][:, columns[f"robot/{name}"].start] for name in robot.arm_joints]
    )
    expected = robot.forward(q)[:, :3, 3]
    np.testing.assert_allclose(record.series["tcp_measured"][:, :3], expected, atol=1e-9)


def _columns(record):
    """The slice of `qpos` that belongs to each joint."""
    ends = np.cumsum([len(values) for values in record.start.values()])
    return [
        slice(end - len(values), end)
        for end, values in zip(ends, record.start.values(), strict=True)
    ]
