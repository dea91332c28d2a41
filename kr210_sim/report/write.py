"""A run's folder -> `report.html` and `plots/` in it."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from kr210_sim.plots.cycle_plots import grip_plot, joints_plot
from kr210_sim.plots.map_plots import grid_plot, map_plot
from kr210_sim.plots.recorded import Recorded, Scenery
from kr210_sim.plots.run_plots import offset_plot, stage_plot
from kr210_sim.plots.space_plot import path_plot
from kr210_sim.plots.theme import Plot
from kr210_sim.report.page import render_page
from kr210_sim.report.reading import RunData
from kr210_sim.results import write_text
from kr210_sim.separation import telling_pair

REPORT = "report.html"
PLOTS = "plots"


def write_report(run: RunData, scenery: Scenery | None) -> Path:
    """Write the page and every plot of it as a file of its own; files of those names are replaced.

    Args:
        run: what `read_run` has read.
        scenery: of the cycles that are shown in detail; needed if there are any.

    Returns:
        The page.

    Raises:
        OSError: if a file cannot be written; the page is then the old one, or none.
    """
    plots: list[Plot] = []
    cycle_plots: dict[int, list[Plot]] = {}
    moved = [cycle for cycle in run.detailed if cycle.moved]
    if scenery is not None and moved:
        plots = _run_plots(run, moved, scenery)
        for cycle in run.detailed:
            cycle_plots[cycle.cycle] = _cycle_plots(run, cycle, scenery) if cycle.moved else []
    if run.cells:
        plots.append(map_plot(run.cells, scenery))
    if run.grid is not None:
        plots.append(grid_plot(run.grid, "" if run.grid_asked else _why(run)))
    page = render_page(run, plots, cycle_plots)
    folder = run.out / PLOTS
    if plots:
        folder.mkdir(exist_ok=True)
    for plot in (*plots, *(plot for found in cycle_plots.values() for plot in found)):
        write_text(folder / f"{plot.name}.svg", plot.file())
    path = run.out / REPORT
    write_text(path, page)
    return path


def _why(run: RunData) -> str:
    """Return why the two quantities of the map are shown, and what that is worth."""
    found = run.separation.differences()
    pair = telling_pair(found)
    assert pair is not None  # else there is no map
    sizes = " and ".join(f"{each.name} by {abs(each.size):.1f}" for each in pair)
    return (
        f"Of the {len(found)} quantities that vary, the means of failed and other cycles differ "
        f"most in these: {sizes} standard deviations. If none mattered, the largest difference "
        f"would still be about {run.separation.by_chance():.1f}."
    )


def _run_plots(run: RunData, moved: Sequence[Recorded], scenery: Scenery) -> list[Plot]:
    offsets = offset_plot(moved, run.config["options"].get("max_ik_offset"))
    found = [offsets, path_plot(moved, scenery) if len(moved) > 1 else None, stage_plot(moved)]
    return [plot for plot in found if plot is not None]


def _cycle_plots(run: RunData, cycle: Recorded, scenery: Scenery) -> list[Plot]:
    return [
        joints_plot(cycle, scenery, run.summary["limits"]),
        grip_plot(cycle),
        path_plot([cycle], scenery),
    ]
