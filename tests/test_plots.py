"""Plots are drawn from records alone: the same bits, every colour named, nothing unescaped."""

from __future__ import annotations

import re
import xml.etree.ElementTree as ET
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from drawn_runs import DROPPED, LIMITS, SCENERY, make_record, recorded

from kr210_sim.plots.cycle_plots import grip_plot, joints_plot
from kr210_sim.plots.map_plots import grid_plot, map_plot
from kr210_sim.plots.run_plots import offset_plot, stage_plot
from kr210_sim.plots.space_plot import path_plot
from kr210_sim.plots.theme import COLOURS
from kr210_sim.record import STAGES
from kr210_sim.success_map import success_map

BY_JOINT = {
    "velocity_rad_s": LIMITS.velocity.tolist(),
    "acceleration_rad_s2": LIMITS.acceleration.tolist(),
}
SVG = "{http://www.w3.org/2000/svg}"


@pytest.fixture(scope="module")
def good(tmp_path_factory):
    return recorded(make_record(0), tmp_path_factory.mktemp("good"))


@pytest.fixture(scope="module")
def failed(tmp_path_factory):
    return recorded(make_record(3, DROPPED), tmp_path_factory.mktemp("failed"))


def drawn(cycle):
    return {
        "joints": joints_plot(cycle, SCENERY, BY_JOINT),
        "grip": grip_plot(cycle),
        "path": path_plot([cycle], SCENERY),
        "stages": stage_plot([cycle]),
    }


@pytest.fixture(scope="module")
def of_good(good):
    """The plots of a cycle that succeeded."""
    return drawn(good)


@pytest.fixture(scope="module")
def of_failed(failed):
    """The plots of a cycle that failed."""
    return drawn(failed)


def words(plot) -> str:
    """All text in a plot."""
    return " ".join(element.text or "" for element in ET.fromstring(plot.svg).iter(f"{SVG}text"))


def luminance(colour: str) -> float:
    parts = [int(colour[start : start + 2], 16) / 255 for start in (1, 3, 5)]
    linear = [
        part / 12.92 if part <= 0.04045 else ((part + 0.055) / 1.055) ** 2.4 for part in parts
    ]
    return float(np.dot(linear, [0.2126, 0.7152, 0.0722]))


def contrast(one: str, other: str) -> float:
    """The contrast ratio of WCAG 2.2."""
    dark, light = sorted((luminance(one), luminance(other)))
    return (light + 0.05) / (dark + 0.05)


# ---- what a plot is given -------------------------------------------------------------------


def test_the_stages_of_a_cycle_fill_its_time(good):
    assert [span.stage for span in good.spans] == list(STAGES)
    assert good.spans[0].start == 0.0
    assert good.spans[-1].end == good.time[-1]
    for before, after in pairwise(good.spans):
        assert before.end == after.start > before.start


def test_joints_are_found_by_name_whatever_their_place(good):
    names = tuple(reversed(SCENERY.joints))
    np.testing.assert_array_equal(good.joints(names), good.joints(SCENERY.joints)[:, ::-1])


# ---- the plots ------------------------------------------------------------------------------


def test_the_same_record_gives_the_same_drawing(good, of_good):
    assert grip_plot(good) == of_good["grip"]


def test_a_failure_is_marked_at_its_time_with_its_reason(of_failed):
    for name in ("joints", "grip", "path"):
        assert "dropped at 0.22 s" in words(of_failed[name])
        assert "ycle 3 failed at 0.22 s in move to place: dropped" in of_failed[name].alt
    assert "dropped" in words(of_failed["stages"])


def test_a_success_has_no_mark_of_a_failure(of_good):
    for plot in of_good.values():
        assert "failed" not in plot.alt
        assert "dropped" not in words(plot)


def test_the_caption_tells_what_is_closest_to_its_limit(good, of_good):
    peak = np.max(np.abs(good.joints(SCENERY.joints))) / 3.0
    assert f"position {100 * peak:.0f} % (joint_" in of_good["joints"].caption


def test_offsets_of_all_points_are_drawn_zeros_and_gate_too(good, failed):
    plot = offset_plot([good, failed], 1e-9)
    assert "16 points, at most 1.0e-15 m" in plot.caption
    assert "rounding of double precision" in plot.caption
    assert "gate" in words(plot)
    assert "rounding" not in offset_plot([replace_offsets(good, 1e-4)], None).caption


def replace_offsets(cycle, size):
    return replace(cycle, record={**cycle.record, "ik_offset_m": np.full(3, size)})


def test_a_record_without_points_has_no_plot_of_offsets(good):
    assert offset_plot([replace(good, record={"time": good.time})], None) is None


def test_the_time_of_each_stage_is_the_time_between_its_ends(good, of_good):
    longest = max(span.end - span.start for span in good.spans)
    assert f"{longest:.2f} s" in of_good["stages"].caption
    labels = {element.text for element in ET.fromstring(of_good["stages"].svg).iter(f"{SVG}text")}
    assert {stage.lower().replace("_", " ") for stage in STAGES} <= labels


def test_cells_are_arranged_as_the_robot_sees_them():
    plot = map_plot({1: (2, 2), 2: (0, 1)}, SCENERY)
    assert "cell 1: 2 of 2, cell 2: 0 of 1" in plot.alt
    places = {
        element.text: float(element.get("x") or element.get("transform").split("(")[1].split()[0])
        for element in ET.fromstring(plot.svg).iter(f"{SVG}text")
    }
    assert places["2 of 2"] < places["0 of 1"]  # +y is on the left of who looks along +x


def test_a_map_of_two_quantities_has_every_cycle_in_its_tile():
    lines = [
        {"cell": 1 + index % 2, "success": index > 0, "drawn": {"mass_kg": 0.5 * index}}
        for index in range(5)
    ]
    plot = grid_plot(success_map(lines, "cell", "mass_kg", 2), "Because.")
    assert re.findall(r"\d/\d", words(plot)) == ["0/1", "2/2", "1/1", "1/1"]
    for text in ("mass_kg", "cell", "0", "1", "2"):
        assert text in words(plot).split()
    assert "0 of 1 at cell 1 and mass_kg 0..1 (95 % interval 0 to 98 %)" in plot.caption
    assert plot.caption.endswith("Because.")


def test_names_of_users_are_text_and_nothing_else(good):
    names = ("<b>&$x_1$", *SCENERY.joints[1:])
    known = {**good.record, "joint_names": np.array(names)}
    scenery = replace(SCENERY, joints=names)
    plot = joints_plot(replace(good, record=known), scenery, BY_JOINT)
    assert "<b>&$x_1$" in words(plot)
    assert "<b>" not in plot.inline()


# ---- colours --------------------------------------------------------------------------------


def test_a_page_recolours_a_plot_and_a_file_is_light(of_good):
    plot = of_good["grip"]
    assert "#0e0e" not in plot.inline() + plot.file()
    assert "var(--plot-line-1)" in plot.inline()
    assert set(re.findall(r"#[0-9a-f]{6}", plot.file())) <= {light for light, _ in COLOURS.values()}
    assert not re.findall(r"#[0-9a-f]{6}", plot.inline())
    ET.fromstring(plot.file().split("\n", 1)[1])


def test_ids_of_a_plot_are_its_own(of_good, of_failed):
    one, other = (re.findall(r'\bid="([^"]+)"', of["grip"].inline()) for of in (of_good, of_failed))
    assert len(one) == len(set(one)) > 0
    assert not set(one) & set(other)


@pytest.mark.parametrize("theme", [0, 1], ids=["light", "dark"])
def test_text_and_lines_stand_out_from_the_paper(theme):
    paper = COLOURS["paper"][theme]
    for name in ("ink", "soft", "good", "bad"):
        assert contrast(COLOURS[name][theme], paper) >= 4.5, name
    for number in range(1, 7):
        assert contrast(COLOURS[f"line-{number}"][theme], paper) >= 3.0, number
