"""How well a target is held: slip at full speed."""

from __future__ import annotations

import numpy as np
import pytest

from kr210_sim.config import RunConfig
from kr210_sim.runner import run


@pytest.mark.slow
def test_two_kilograms_are_held_within_a_millimetre_in_all_cells(tmp_path):
    lines = []
    config = RunConfig(cell="all", cycles=9, mass=2.0, record="none", out=tmp_path / "run")
    _, summary = run(config, on_cycle=lines.append)
    assert summary["succeeded"] == 9
    slip = [line["grasp_slip_m"] for line in lines]
    assert max(slip) < 1e-3
    assert np.median(slip) < 0.5e-3
    assert np.rad2deg(max(line["grasp_slip_rad"] for line in lines)) < 0.5
