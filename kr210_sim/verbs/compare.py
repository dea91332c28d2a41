"""The verb `compare`: tell whether one run is a regression of another."""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import Any

from kr210_sim.exceptions import BadInput
from kr210_sim.verbs.common import EXIT_GATE, EXIT_PASSED


def add(verbs: Any) -> None:
    """Add `compare` to the verbs."""
    parser = verbs.add_parser(
        "compare",
        help="compare two runs and tell whether the second is a regression",
        description="Compare run B with run A. Cycles of the same seed are paired: exact McNemar "
        "test for success, Wilcoxon signed-rank test for the rest; without common seeds Fisher's "
        "and Mann-Whitney's. A regression is worse with p < 0.05 and, success apart, by more than "
        "1 % of a simulated figure or 100 % of a wall-clock one. Exit status: 0 no regression, 1 "
        "regression, 2 bad input, or too few cycles for any test: six pairs are the least, or four "
        "unpaired ones each.",
        allow_abbrev=False,
    )
    for name in ("A", "B"):
        parser.add_argument(
            f"run_{name.lower()}",
            type=Path,
            metavar=f"RUN_{name}",
            help="a run's folder, or its summary.json or cycles.jsonl",
        )
    parser.add_argument("--json", action="store_true", help="print JSON")
    parser.set_defaults(verb=_compare)


def _compare(options: argparse.Namespace) -> int:
    from kr210_sim.compare import compare_runs
    from kr210_sim.comparison import comparison_text, too_few

    report = compare_runs(options.run_a, options.run_b)
    print(
        json.dumps(report, indent=2, allow_nan=False) if options.json else comparison_text(report)
    )
    if text := too_few(report):
        raise BadInput(text)
    return EXIT_GATE if report["regressions"] else EXIT_PASSED
