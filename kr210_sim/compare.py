"""Two finished runs -> their differences, the significance of each, and the regressions."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, NoReturn

import numpy as np
from scipy.stats import binomtest, fisher_exact, mannwhitneyu, wilcoxon

from kr210_sim.arrays import Array
from kr210_sim.config import FREE
from kr210_sim.exceptions import BadInput
from kr210_sim.schemas import SCHEMA_VERSION

ALPHA = 0.05
"""Two-sided p value below which a difference is significant."""

SIMULATED = 0.01
"""Change of a mean, relative, up to which a simulated figure is no regression."""

WALL_CLOCK = 1.00
"""The same for what the machine's clock says, which other load on it changes as well."""

_OUTWARD = FREE - {"jobs", "backend"}
"""Options of a run that change none of the figures compared; load changes those of the clock."""

_PAIRED_SHARE = 0.5  # of the smaller run's cycles that both must have for a paired test


@dataclass(frozen=True, kw_only=True)
class _Metric:
    """A figure of a cycle, better if smaller.

    Attributes:
        name, unit, scale, digits: as it is shown.
        read: from a line of cycles.jsonl to the figure or None.
        successful: whether failed cycles are left out.
        relative, floor: a mean that grew by less than either, share and amount, is no regression.
    """

    name: str
    unit: str
    scale: float
    read: Callable[[dict[str, Any]], Any]
    floor: float
    successful: bool = True
    relative: float = SIMULATED


METRICS = (
    _Metric(name="cycle time", unit="s", scale=1, read=lambda x: x["cycle_time_s"], floor=1e-3),
    _Metric(name="motion time", unit="s", scale=1, read=lambda x: x["motion_time_s"], floor=1e-3),
    _Metric(
        name="IK offset, max",
        unit="m",
        scale=1,
        read=lambda x: x["ik_offset_m"]["max"],
        floor=1e-9,
        successful=False,
    ),
    _Metric(
        name="tracking, max",
        unit="mm",
        scale=1e3,
        read=lambda x: x["tracking_offset_m"]["max"],
        floor=1e-5,
    ),
    _Metric(name="grasp slip", unit="mm", scale=1e3, read=lambda x: x["grasp_slip_m"], floor=1e-5),
    _Metric(
        name="plan time",
        unit="ms",
        scale=1e3,
        read=lambda x: x["wall_clock"]["plan_time_s"],
        floor=5e-3,
        relative=WALL_CLOCK,
    ),
)


@dataclass(frozen=True, kw_only=True)
class Difference:
    """One figure of two runs.

    Attributes:
        name, unit: what it is.
        a, b: success rate, or mean over the cycles compared; None without any.
        change: b - a.
        relative: change over a, None if a is 0.
        p: two-sided p value of the test, None without data.
        test: which test it was.
        n: cycles of A and B it rests on; pairs count once in each.
        enough: whether the test can be significant with so many cycles at all.
        regression: whether B is worse, significantly and by more than the thresholds.
    """

    name: str
    unit: str
    a: float | None
    b: float | None
    change: float | None
    relative: float | None
    p: float | None
    test: str
    n: tuple[int, int]
    enough: bool
    regression: bool


Cycles = dict[tuple[int, int, int], dict[str, Any]]
"""Lines of a cycles.jsonl by cycle index, seed and cell."""


def compare_runs(path_a: Path | str, path_b: Path | str) -> dict[str, Any]:
    """Compare two runs, B against A.

    Cycles of the same index, seed and cell are paired; if that is less than half of the smaller
    run, the tests are unpaired.

    Args:
        path_a: a run's folder, or its summary.json or cycles.jsonl.
        path_b: the run that must not be worse.

    Raises:
        BadInput: if a file is missing or is not what a run writes.
    """
    path_a, path_b = Path(path_a), Path(path_b)
    a, b = (_read(path) for path in (path_a, path_b))
    common = [key for key in a if key in b]
    paired = len(common) >= _PAIRED_SHARE * min(len(a), len(b))
    rows_a = [a[key] for key in common] if paired else list(a.values())
    rows_b = [b[key] for key in common] if paired else list(b.values())
    differences = [_success(rows_a, rows_b, paired)]
    differences += [_metric(metric, rows_a, rows_b, paired) for metric in METRICS]
    other_options, notes = _other_options(path_a, path_b)
    if len(a) != len(b):
        notes.append(f"A has {len(a)} cycles, B {len(b)}")
    if paired and len(common) < max(len(a), len(b)):
        notes.append(f"compared on the {len(common)} cycles of the same index, seed and cell")
    if not paired:
        notes.append(f"{len(common)} cycles have the same index, seed and cell: too few to pair")
    return {
        "schema_version": SCHEMA_VERSION,
        "alpha": ALPHA,
        "a": _identity(path_a, a),
        "b": _identity(path_b, b),
        "paired": paired,
        "pairs": len(common),
        "other_options": other_options,
        "differences": [asdict(difference) for difference in differences],
        "regressions": [item.name for item in differences if item.regression],
        "notes": notes,
    }


def _identity(path: Path, cycles: Cycles) -> dict[str, Any]:
    succeeded = sum(line["success"] for line in cycles.values())
    return {"path": str(path), "cycles": len(cycles), "succeeded": succeeded}


# ---- reading --------------------------------------------------------------------------------


def _read(path: Path) -> Cycles:
    """Return the cycles of a run."""
    folder = path if path.is_dir() else path.parent
    file = folder / "cycles.jsonl" if path.is_dir() or path.name == "summary.json" else path
    for name in (path, file):
        if not name.exists():
            raise BadInput(f"{name}: no such file; give a run's folder or its cycles.jsonl")
    summary = folder / "summary.json"
    if file.name == "cycles.jsonl" and summary.is_file():
        found = _parse(str(summary), _text(summary))
        version = found.get("schema_version") if isinstance(found, dict) else None
        if version != SCHEMA_VERSION:
            raise BadInput(
                f"{summary}: schema_version is {version}, not {SCHEMA_VERSION}; run it again "
                "with this version, or compare with the one that wrote it"
            )
    cycles: Cycles = {}
    for number, text in enumerate(_text(file).splitlines(), start=1):
        where = f"{file}, line {number}"
        line = _parse(where, text)
        key = _check(where, line)
        if key in cycles:
            raise BadInput(f"{where}: cycle {key[0]} is there twice; give one run's file")
        cycles[key] = line
    if not cycles:
        raise BadInput(f"{file}: no finished cycle in it; give a run that finished one")
    return cycles


def _other_options(path_a: Path, path_b: Path) -> tuple[list[str], list[str]]:
    """Return the options that the runs differ in, and say how; a difference may be theirs."""
    files = [(path if path.is_dir() else path.parent) / "config.json" for path in (path_a, path_b)]
    if not all(file.is_file() for file in files):
        return [], []
    found = [_parse(str(file), _text(file)) for file in files]
    a, b = (config.get("options") if isinstance(config, dict) else None for config in found)
    if not (isinstance(a, dict) and isinstance(b, dict)):
        return [], []
    names = [name for name in (*a, *sorted(set(b) - set(a))) if name not in _OUTWARD]
    differing = {
        f"--{name.replace('_', '-')}": f"{a.get(name)} for A, {b.get(name)} for B"
        for name in names
        if a.get(name) != b.get(name)
    }
    return list(differing), [f"{name} was {values}" for name, values in differing.items()]


def _text(path: Path) -> str:
    try:
        return path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise BadInput(f"{path}: cannot be read ({error}); give a file of a run") from error


def _parse(where: str, text: str) -> Any:
    def refuse(constant: str) -> NoReturn:
        raise ValueError(f"{constant} is no JSON")

    try:
        return json.loads(text, parse_constant=refuse)
    except (ValueError, RecursionError) as error:
        raise BadInput(f"{where}: broken JSON ({error}); give a file as a run wrote it") from error


def _check(where: str, line: Any) -> tuple[int, int, int]:
    """Return the key of a line that holds everything that is compared."""
    try:
        key = tuple(line[name] for name in ("cycle", "seed", "cell"))
        figures = [metric.read(line) for metric in METRICS if metric.name != "plan time"]
        figures.append(line["wall_clock"].get("plan_time_s"))
        line["wall_clock"].setdefault("plan_time_s", None)
        known = all(type(value) in (int, float, type(None)) for value in figures)
        if not (known and all(type(value) is int for value in key)):
            raise TypeError
        if type(line["success"]) is not bool:
            raise TypeError
    except (KeyError, TypeError, AttributeError) as error:
        raise BadInput(
            f"{where}: not a cycle as this version writes it (schema {SCHEMA_VERSION}); give the "
            "cycles.jsonl of a run"
        ) from error
    return (int(key[0]), int(key[1]), int(key[2]))


# ---- tests ----------------------------------------------------------------------------------


def _least_p(count_a: int, count_b: int, paired: bool) -> float:
    """Return the p value if every pair changed alike, or every cycle of A came before those of B.

    The p values of McNemar's, Wilcoxon's and Mann-Whitney's tests are no smaller.
    """
    return 2 / (2**count_a if paired else math.comb(count_a + count_b, count_a))


def _success(rows_a: Sequence[Any], rows_b: Sequence[Any], paired: bool) -> Difference:
    good_a, good_b = (np.array([row["success"] for row in rows]) for rows in (rows_a, rows_b))
    if paired:
        lost, won = int(np.sum(good_a & ~good_b)), int(np.sum(~good_a & good_b))
        p = float(binomtest(lost, lost + won, 0.5).pvalue) if lost + won else 1.0
        test, least = "McNemar, exact", _least_p(len(good_a), len(good_b), paired)
    else:
        table = [[int(good.sum()), int((~good).sum())] for good in (good_a, good_b)]
        p, test = float(fisher_exact(table).pvalue), "Fisher, exact"
        least = float(fisher_exact([[len(good_a), 0], [0, len(good_b)]]).pvalue)
    a, b = float(np.mean(good_a)), float(np.mean(good_b))
    return Difference(
        name="success rate",
        unit="",
        a=a,
        b=b,
        change=b - a,
        relative=(b - a) / a if a else None,
        p=p,
        test=test,
        n=(len(good_a), len(good_b)),
        enough=least < ALPHA,
        regression=least < ALPHA and p < ALPHA and b < a,
    )


def _metric(
    metric: _Metric, rows_a: Sequence[Any], rows_b: Sequence[Any], paired: bool
) -> Difference:
    a, b = (_values(metric, rows) for rows in (rows_a, rows_b))
    if paired:
        both = ~np.isnan(a) & ~np.isnan(b)
        a, b = a[both], b[both]
        test = "Wilcoxon, paired"
    else:
        a, b = a[~np.isnan(a)], b[~np.isnan(b)]
        test = "Mann-Whitney"
    known = len(a) > 0 and len(b) > 0
    mean_a, mean_b = (float(np.mean(x)) if known else None for x in (a, b))
    p = _p_value(a, b, paired) if known else None
    enough = _least_p(len(a), len(b), paired) < ALPHA
    change = relative = None
    worse = False
    if mean_a is not None and mean_b is not None:
        change = mean_b - mean_a
        relative = change / mean_a if mean_a else None
        worse = change > max(metric.floor, metric.relative * mean_a)
    return Difference(
        name=metric.name,
        unit=metric.unit,
        a=_scaled(mean_a, metric.scale),
        b=_scaled(mean_b, metric.scale),
        change=_scaled(change, metric.scale),
        relative=relative,
        p=p,
        test=test,
        n=(len(a), len(b)),
        enough=enough,
        regression=enough and p is not None and p < ALPHA and worse,
    )


def _values(metric: _Metric, rows: Sequence[Any]) -> Array:
    """Return the figure of each cycle, NaN where it does not count."""
    values = [metric.read(row) if row["success"] or not metric.successful else None for row in rows]
    return np.array([np.nan if value is None else float(value) for value in values])


def _p_value(a: Array, b: Array, paired: bool) -> float:
    if paired:
        # Differences in the last bits are none; ranked, they would count like any other.
        change = np.where(np.isclose(a, b, rtol=1e-9, atol=0.0), 0.0, b - a)
        return float(wilcoxon(change).pvalue) if np.any(change) else 1.0
    return float(mannwhitneyu(a, b).pvalue)


def _scaled(value: float | None, scale: float) -> float | None:
    return None if value is None else value * scale
