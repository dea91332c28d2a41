"""Maps of success: every cycle in the bin it belongs to, and exact intervals."""

from __future__ import annotations

import json

import numpy as np
import pytest

from kr210_sim.exceptions import BadInput
from kr210_sim.stats import success_interval
from kr210_sim.success_map import map_text, quantities, success_map


def line(cell: int, success: bool, **drawn) -> dict:
    return {"cell": cell, "success": success, "drawn": drawn}


def random_lines(count: int) -> list[dict]:
    rng = np.random.default_rng(3)
    return [
        line(
            int(rng.integers(1, 10)),
            bool(rng.random() < 0.7),
            target_mass_kg=float(np.exp(rng.uniform(np.log(0.05), np.log(10)))),
            target_x_m=float(rng.uniform(-0.05, 0.05)),
            perceived_shift_m=rng.normal(0, 0.005, 3).tolist(),
        )
        for _ in range(count)
    ]


def test_every_drawn_number_is_a_quantity_and_vectors_have_parts_and_a_length():
    found = quantities(line(4, True, pad_friction=0.7, perceived_shift_m=[3.0, 0.0, -4.0]))
    assert found == {
        "cell": 4, "pad_friction": 0.7, "perceived_shift_m.1": 3.0, "perceived_shift_m.2": 0.0,
        "perceived_shift_m.3": -4.0, "perceived_shift_m.norm": 5.0,
    }  # fmt: skip
    assert quantities({"cell": 2, "success": True}) == {"cell": 2}


def test_a_hand_made_map_has_its_counts():
    lines = [line(1, True, m=0.0), line(1, False, m=1.9), line(3, True, m=4.0), line(3, True, m=2)]
    lines.append(line(3, True))  # lacks the quantity
    found = success_map(iter(lines), "cell", "m", 2)
    np.testing.assert_array_equal(found.x.values, [1, 3])
    np.testing.assert_array_equal(found.y.edges, [0, 2, 4])
    np.testing.assert_array_equal(found.cycles, [[2, 0], [0, 2]])
    np.testing.assert_array_equal(found.succeeded, [[1, 0], [0, 2]])
    np.testing.assert_array_equal(found.rate, [[0.5, np.nan], [np.nan, 1.0]])
    assert (found.low[1, 1], found.high[1, 1]) == success_interval(2, 2)
    assert found.left_out == 1


@pytest.mark.parametrize("x", ["cell", "target_mass_kg", "target_x_m", "perceived_shift_m.norm"])
def test_every_cycle_is_counted_once_in_the_bin_of_its_value(x):
    lines = random_lines(300)
    found = success_map(lines, x, "target_x_m", 7, bins_y=4)
    assert found.cycles.sum() == 300
    assert found.succeeded.sum() == sum(line["success"] for line in lines)
    values = np.array([quantities(line)[x] for line in lines])
    if found.x.edges is None:
        counts = [np.sum(values == value) for value in found.x.values]
    else:
        counts = np.histogram(values, found.x.edges)[0]
    np.testing.assert_array_equal(found.cycles.sum(axis=1), counts)


def test_over_a_decade_bins_have_equal_ratios_and_otherwise_equal_widths():
    found = success_map(random_lines(200), "target_mass_kg", "target_x_m", 4)
    np.testing.assert_allclose(np.diff(np.log(found.x.edges)), np.log(200) / 4, rtol=0.05)
    np.testing.assert_allclose(np.diff(found.y.edges), 0.1 / 4, rtol=0.05)
    assert np.ptp(np.diff(np.log(found.x.edges))) < 1e-12


def test_given_edges_are_kept_and_what_is_outside_is_left_out():
    lines = [line(1, True, m=value) for value in (-1.0, 0.0, 0.5, 1.0, 1.1)]
    found = success_map(lines, "m", "cell", [0.0, 0.5, 1.0], bins_y=1)
    np.testing.assert_array_equal(found.cycles, [[1], [2]])
    assert found.left_out == 2


def test_the_same_quantity_twice_is_a_diagonal():
    found = success_map(random_lines(100), "cell", "cell")
    assert found.cycles.sum() == np.trace(found.cycles) == 100


def test_as_json_has_null_where_there_is_no_cycle():
    found = success_map([line(1, True, m=0.0), line(2, False, m=1.5)], "cell", "m", 2)
    again = json.loads(json.dumps(found.as_json(), allow_nan=False))
    assert again["rate"] == [[1.0, None], [None, 0.0]]
    assert again["x"] == {"name": "cell", "edges": None, "values": [1, 2]}


def test_the_table_has_a_row_and_a_column_per_bin():
    lines = [line(1, True, m=0.0), line(1, False, m=0.1), line(2, True, m=1.5), line(2, True)]
    text = map_text(success_map(lines, "cell", "m", 2))
    assert [row.split() for row in text.splitlines()] == [
        ["m"], ["cell", "0..0.75", "0.75..1.5"], ["1", "1/2", "-"], ["2", "-", "1/1"],
        ["1", "cycles", "are", "left", "out"],
    ]  # fmt: skip


@pytest.mark.parametrize(
    ("x", "y", "bins", "named"),
    [
        ("colour", "cell", 5, "colour.*cell, target_mass_kg"),
        ("cell", "", 5, "no quantity ''"),
        ("cell", "target_mass_kg", 0, "cell: 0 bins"),
        ("cell", "target_mass_kg", 65, "65 bins"),
        ("cell", "target_mass_kg", [1.0], "edges"),
        ("cell", "target_mass_kg", [2.0, 1.0], "edges"),
        ("cell", "target_mass_kg", [0.0, float("nan")], "edges"),
    ],
)
def test_what_makes_no_sense_is_refused(x, y, bins, named):
    with pytest.raises(BadInput, match=named):
        success_map([line(1, True, target_mass_kg=1.0), line(2, True)], x, y, bins)


def test_a_run_without_cycles_and_a_pair_no_cycle_has_are_refused():
    with pytest.raises(BadInput, match="no finished cycle"):
        success_map([], "cell", "cell")
    with pytest.raises(BadInput, match="both 'a' and 'b'"):
        success_map([line(1, True, a=1.0), line(1, True, b=1.0)], "a", "b")
