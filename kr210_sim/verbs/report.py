"""The verb `report`: write the page that shows a run."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from kr210_sim.verbs.common import EXIT_PASSED


def add(verbs: Any) -> None:
    """Add `report` to the verbs."""
    parser = verbs.add_parser(
        "report",
        help="write the report of a run: one page with verdict, failures, plots and all figures",
        description="Write RUN/report.html, one page that needs nothing but itself, and its plots "
        "as RUN/plots/*.svg, from the records of a run; nothing is simulated. Exit status: 0 "
        "written, 2 bad input, 3 full disk.",
        allow_abbrev=False,
    )
    parser.add_argument("run", type=Path, metavar="RUN", help="a run's folder")
    parser.add_argument(
        "--map", nargs=2, default=(), metavar=("X", "Y"), dest="quantities",
        help="quantities of the map of success: what --randomize draws, NAME.1, NAME.2, ... and "
        "NAME.norm of a vector, and cell (default: where failed cycles differ most)",
    )  # fmt: skip
    parser.set_defaults(verb=_report)


def _report(options: argparse.Namespace) -> int:
    print(report_on(options.run, options.quantities))
    return EXIT_PASSED


def report_on(out: Path, quantities: Sequence[str] = ()) -> Path:
    """Write the report of a run and return the page.

    Args:
        out: folder of the run.
        quantities: the two of the map of success, if they are named.
    """
    from kr210_sim.report.reading import read_run
    from kr210_sim.report.write import write_report

    run = read_run(out, quantities)
    scenery = None
    if run.detailed:
        from kr210_sim.scenery import read_scenery

        scenery = read_scenery(out, run.detailed[0].cycle)
    return write_report(run, scenery)
