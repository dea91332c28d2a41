"""What sets failures apart: the quantity that matters is named, and chance is told from it."""

from __future__ import annotations

import numpy as np
import pytest

from kr210_sim.separation import Difference, Separation, telling_pair


def separated(cell: np.ndarray, drawn: dict[str, np.ndarray], success: np.ndarray) -> Separation:
    found = Separation()
    for index, good in enumerate(success):
        values = {name: column[index].tolist() for name, column in drawn.items()}
        found.add({"cell": int(cell[index]), "success": bool(good), "drawn": values})
    return found


def test_differences_are_those_of_the_means_in_standard_deviations():
    rng = np.random.default_rng(1)
    mass, shift = rng.uniform(1e6, 1e6 + 1, 200), rng.normal(0, 0.01, (200, 3))
    good = (mass < 1e6 + 0.8) & (np.linalg.norm(shift, axis=1) < 0.03)
    drawn = {"mass": mass, "shift": shift, "same": np.full(200, 0.3)}
    differences = separated(np.arange(200), drawn, good).differences()
    sizes = dict(differences)
    assert sizes.keys() == {"mass", "shift.1", "shift.2", "shift.3", "shift.norm"}
    columns = {"mass": mass, "shift.2": shift[:, 1], "shift.norm": np.linalg.norm(shift, axis=1)}
    for name, column in columns.items():
        expected = (column[~good].mean() - column[good].mean()) / column.std()
        assert sizes[name] == pytest.approx(expected, rel=1e-4)
    assert [abs(each.size) for each in differences] == sorted(map(abs, sizes.values()))[::-1]
    assert [each.name for each in telling_pair(differences)] == ["mass", "shift.norm"]


@pytest.mark.parametrize("good", [True, False])
def test_nothing_is_told_where_all_cycles_end_alike(good):
    found = separated(np.arange(5), {"mass": np.arange(5.0)}, np.full(5, good))
    assert found.differences() == []
    assert found.by_chance() == 0.0
    assert telling_pair([]) is None
    assert telling_pair([Difference("mass", 2.0)]) is None


def test_a_single_vector_gives_two_of_its_parts():
    parts = [Difference("shift.norm", 2.0), Difference("shift.1", -1.0), Difference("shift.2", 0.1)]
    assert telling_pair(parts) == tuple(parts[:2])


def test_chance_alone_is_as_large_as_it_is_said_to_be():
    rng = np.random.default_rng(7)
    largest, said = [], []
    for _ in range(60):
        drawn = {f"q{index}": rng.normal(size=30) for index in range(8)}
        found = separated(np.zeros(30), drawn, np.arange(30) >= 6)
        largest.append(abs(found.differences()[0].size))
        said.append(found.by_chance())
    assert np.median(largest) == pytest.approx(np.median(said), rel=0.15)
