"""Conservative advancement proves what is free, refuses what is not, and looks seldom."""

from __future__ import annotations

import numpy as np
import pytest

from kr210_sim.advance import Room, Stretches, advance, advance_each

REACH = 2.0  # [m], of a point that every joint moves at most this far per radian


class Field:
    """A world in which distance is a function of q that changes by at most REACH per radian."""

    def __init__(self, seed: int, clearance: float = 0.0, tolerance: float = 1e-3) -> None:
        rng = np.random.default_rng(seed)
        self.centers = rng.uniform(-1.5, 1.5, (60, 6))
        self.clearance, self.tolerance, self.looks = clearance, tolerance, 0

    def distance(self, q: np.ndarray) -> np.ndarray:
        """Return the distance (...) at configurations (..., 6) [m]."""
        apart = np.max(np.abs(q[..., None, :] - self.centers), axis=-1)
        return REACH * (np.min(apart, axis=-1) - 0.58)

    def at(self, q: np.ndarray) -> tuple[float, bool]:
        """Return the room at a configuration (6,) [m], and whether it is too little."""
        room = float(self.distance(q)) - self.clearance
        return room, room < self.tolerance

    def look(self, q: np.ndarray) -> Room | None:
        self.looks += len(q)
        room = self.distance(q) - self.clearance
        if np.any(room < self.tolerance):
            return None
        return around(room)


def around(room: np.ndarray) -> Room:
    """Return what a room (B,) allows by the straight way and what a path leaves it by."""

    def share(stretches: Stretches) -> np.ndarray:
        straight = np.sum(np.abs(stretches.change), axis=0)
        assert np.all(straight <= np.sum(stretches.travel, axis=0) + 1e-9)
        used = REACH * (straight + np.sum(stretches.bend, axis=0))
        return room / np.maximum(used, 1e-9)

    return share


def walks(count: int):
    """Yield polylines of different lengths, some with points that repeat."""
    rng = np.random.default_rng(31)
    for index in range(count):
        q = np.cumsum(rng.normal(size=(2 + index % 7, 6)) * 0.4, axis=0)
        yield np.repeat(q, 1 + index % 3, axis=0)


def test_it_never_calls_free_what_a_dense_grid_finds_too_near():
    verdicts = []
    for seed, q in enumerate(walks(150)):
        field = Field(seed, clearance=0.05)
        share = np.linspace(0.0, 1.0, 150)[:, None, None]
        dense = field.distance((1 - share) * q[:-1] + share * q[1:])
        free = advance(q, field.look)
        verdicts.append(free)
        if free:
            assert np.min(dense) >= 0.05
        else:
            assert np.min(dense) < 0.05 + field.tolerance + 2e-2  # a grid misses a little
    assert 20 < sum(verdicts) < 130


def test_a_configuration_alone_is_a_path():
    field = Field(1)
    q = np.full((1, 6), 3.0)
    assert advance(q, field.look)
    assert not advance(field.centers[:1], field.look)


@pytest.mark.parametrize("index", [0, 37, 100])
def test_one_bad_configuration_among_equal_ones_is_found(index):
    field = Field(2)
    q = np.full((101, 6), 3.0)
    q[index] = field.centers[0]
    assert not advance(q, field.look)


def test_what_is_far_from_everything_needs_few_looks_however_many_points_are_given():
    looks = []
    for count in (2, 2000):
        field = Field(3)
        q = np.linspace(np.full(6, 10.0), np.full(6, 11.0), count)
        assert advance(q, field.look)
        looks.append(field.looks)
    assert max(looks) <= 5


def test_paths_looked_at_together_have_the_verdicts_they_have_alone():
    """Each in a field of its own, short and long ones, so that none answers for another."""
    fields = [Field(seed, clearance=0.05) for seed in range(150)]
    paths = [*walks(149), fields[149].centers[:1]]
    alone = [advance(q, field.look) for q, field in zip(paths, fields, strict=True)]
    blocked_at: dict[int, int] = {}
    rounds = 0

    def look(q: np.ndarray, which: np.ndarray) -> tuple[Room, np.ndarray]:
        nonlocal rounds
        rounds += 1
        assert all(blocked_at.get(path, rounds) == rounds for path in which.tolist())
        room, near = np.zeros(len(q)), np.zeros(len(q), dtype=bool)
        for row, path in enumerate(which.tolist()):
            room[row], near[row] = fields[path].at(q[row])
            if near[row]:
                blocked_at[path] = rounds  # and is not asked for again
        return around(room), near

    together = advance_each(paths, look)
    assert together.tolist() == alone
    assert 20 < sum(alone) < 130


def test_of_a_choice_the_first_free_path_is_taken_and_later_ones_are_hardly_looked_at():
    """Four choices of paths: the answer is what they would be alone, in order."""
    fields = [Field(seed, clearance=0.05) for seed in range(60)]
    paths = list(walks(60))
    choice = np.repeat(np.arange(4), 15)
    alone = np.array([advance(q, field.look) for q, field in zip(paths, fields, strict=True)])
    looks = np.zeros(60, dtype=int)

    def look(q: np.ndarray, which: np.ndarray) -> tuple[Room, np.ndarray]:
        room, near = np.zeros(len(q)), np.zeros(len(q), dtype=bool)
        for row, path in enumerate(which.tolist()):
            looks[path] += 1
            room[row], near[row] = fields[path].at(q[row])
        return around(room), near

    found = advance_each(paths, look, choice)
    for number in range(4):
        free = np.flatnonzero(alone & (choice == number))
        assert np.flatnonzero(found & (choice == number)).tolist() == free[:1].tolist()
        assert np.all(looks[free[1:]] <= 3)
