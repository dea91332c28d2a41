"""A comparison of two runs as a table, with what stands in the way of believing it."""

from __future__ import annotations

from typing import Any

from kr210_sim.compare import ALPHA


def comparison_text(report: dict[str, Any]) -> str:
    """Return a comparison as a table."""
    lines = [
        f"{side.upper()}  {report[side]['succeeded']} of {report[side]['cycles']} cycles "
        f"succeeded  {report[side]['path']}"
        for side in ("a", "b")
    ]
    lines += [f"note: {note}" for note in report["notes"]]
    how = "paired cycle by cycle" if report["paired"] else "unpaired, all of A with all of B"
    lines += [
        f"compared: {how}; n: {'pairs' if report['paired'] else 'cycles of A/B'}",
        "",
        f"{'':<18} {'A':>10} {'B':>10} {'B - A':>10} {'%':>8} {'n':>9} {'p':>7}  verdict",
    ]
    for item in report["differences"]:
        name = f"{item['name']} [{item['unit']}]" if item["unit"] else item["name"]
        share = None if item["relative"] is None else 100 * item["relative"]
        cells = [_cell(item[key]) for key in ("a", "b", "change")]
        p = "-" if item["p"] is None else f"{item['p']:.3f}"
        shown = "-" if share is None else f"{share:+.1f}"
        n = str(item["n"][0]) if report["paired"] else "{}/{}".format(*item["n"])
        row = f"{name:<18} {' '.join(f'{c:>10}' for c in cells)} {shown:>8} {n:>9} {p:>7}"
        lines.append(f"{row}  {_verdict(item)}")
    return "\n".join([*lines, "", _conclusion(report)])


def _conclusion(report: dict[str, Any]) -> str:
    """Return the last line: what was found, and what stands in the way of believing it."""
    found = ", ".join(report["regressions"])
    text = f"REGRESSION: {found}" if found else "no regression"
    untold = [item["name"] for item in report["differences"] if not item["enough"]]
    if len(untold) == len(report["differences"]):
        text = "NO VERDICT: too few cycles"
    elif untold:
        text += f"; too few cycles to tell: {', '.join(untold)}"
    if report["other_options"]:
        text += f"; but the runs are not alike, see {', '.join(report['other_options'])}"
    return text


def too_few(report: dict[str, Any]) -> str | None:
    """Return what to do where no test of a comparison can find anything, None where one can."""
    if any(item["enough"] for item in report["differences"]):
        return None
    n = report["differences"][0]["n"]
    what = f"{n[0]} pairs of cycles are" if report["paired"] else f"{n[0]} and {n[1]} cycles are"
    return (
        f"RUN_A, RUN_B: {what} too few for any test to tell a difference; give six or more of the "
        "same seeds, or four or more each of others"
    )


def _cell(value: float | None) -> str:
    return "-" if value is None else f"{value:.4g}"


def _verdict(item: dict[str, Any]) -> str:
    if item["regression"]:
        return "WORSE"
    if item["p"] is None:
        return "not compared"
    if not item["enough"]:
        return "too few cycles"
    if item["p"] >= ALPHA:
        return "no difference" if item["change"] == 0.0 else "not significant"
    better = item["change"] > 0 if item["name"] == "success rate" else item["change"] < 0
    return "better" if better else "worse, below the threshold"
