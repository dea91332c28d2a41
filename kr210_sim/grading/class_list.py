"""Many solvers graded in parallel, each in a folder of its own, with one list of the class."""

from __future__ import annotations

import csv
import json
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

from kr210_sim.exceptions import BadInput
from kr210_sim.grading.findings import Finding
from kr210_sim.grading.grade import GradeConfig, checksum, grade
from kr210_sim.grading.page import class_page, folder_of, grade_page
from kr210_sim.grading.report import COLUMNS, class_row
from kr210_sim.grading.source import SolverSource
from kr210_sim.results import write_json, write_text
from kr210_sim.workers import Loss, share_out

GRADE = "grade.json"
CLASS = "class.csv"
PAGES = "grade.html", "class.html"


@dataclass(frozen=True, kw_only=True)
class Item:
    """A solver to grade.

    Attributes:
        name: that a reader calls it, different for each of a class.
        source: where it is.
        folder: where its grade goes.
    """

    name: str
    source: SolverSource
    folder: Path


def find_items(paths: Sequence[Path], out: Path) -> list[Item]:
    """Return the solvers in some files and folders, sorted by name.

    Of a folder all .py files count, in folders below it as well; names with a leading underscore or
    dot do not.

    Raises:
        BadInput: if there is none, naming the path.
    """
    found: dict[str, tuple[str, Path]] = {}  # by the name of the folder
    for path in paths:
        if path.is_dir():
            inside = [
                file
                for file in sorted(path.rglob("*.py"))
                if not any(part[0] in "._" for part in file.relative_to(path).parts)
            ]
            if not inside:
                raise BadInput(f"{path} has no .py files; name a folder with solvers, or a file")
            named = {file.relative_to(path).with_suffix("").as_posix(): file for file in inside}
        else:
            named = {path.stem: path}
        for name, file in named.items():
            unique, number = name, 2
            while folder_of(unique) in found:
                unique, number = f"{name}-{number}", number + 1
            found[folder_of(unique)] = unique, file
    return [
        Item(name=name, source=SolverSource.from_file(file), folder=out / folder_of(name))
        for name, file in sorted(found.values())
    ]


def open_folder(out: Path, *, resume: bool, of_class: bool = True) -> None:
    """Make the folder of the results.

    Raises:
        BadInput: if it is not empty and shall not be taken up again, or cannot be written.
    """
    try:
        if out.exists() and not resume and (not out.is_dir() or any(out.iterdir())):
            going_on = ", or go on with the class in it by --resume" if of_class else ""
            raise BadInput(
                f"--out: {out} is no empty folder; name one that does not exist yet{going_on}"
            )
        out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise BadInput(
            f"--out: {out} cannot be written ({error.strerror}); name another"
        ) from error


def finished(item: Item, config: GradeConfig) -> dict[str, Any] | None:
    """Return the grade of a solver that was graded before: same file, same options.

    One that lacked a package is not finished: the package may be installed by now.
    """
    try:
        content = json.loads((item.folder / GRADE).read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return None
    same = isinstance(content, dict) and (
        content.get("sha256") == checksum(item.source)
        and content.get("options") == config.as_json()
        and all(finding["kind"] != "import" for finding in content["findings"])
    )
    return content if same else None


def grade_item(config: GradeConfig, item: Item) -> dict[str, Any]:
    """Grade one solver into its folder; return `grade.json`."""
    content = grade(item.source, config).content | {"name": item.name}
    write_grade(item.folder, content)
    return content


def write_grade(folder: Path, content: dict[str, Any]) -> None:
    """Write the files of a grade; the JSON is the last, so that it stands for all of them."""
    folder.mkdir(parents=True, exist_ok=True)
    write_text(folder / PAGES[0], grade_page(content))
    write_json(folder / GRADE, content)


def grade_class(
    items: Sequence[Item],
    config: GradeConfig,
    *,
    jobs: int,
    on_grade: Callable[[dict[str, Any]], None],
) -> list[dict[str, Any]]:
    """Grade solvers that are not graded yet, and return the grades of all, in order.

    Args:
        items: the solvers.
        config: the options.
        jobs: processes that grade; each has one solver at a time in a further process.
        on_grade: told of every grade, those of an earlier session first.
    """
    known = {item.name: content for item in items if (content := finished(item, config))}
    for content in known.values():
        on_grade(content)
    left = [item for item in items if item.name not in known]
    lost: list[dict[str, Any]] = []

    def lose(loss: Loss[Item]) -> None:
        if loss.final:
            lost.append(_lost(loss.item, config, loss.cause))

    task = partial(grade_item, config)
    for content in _grades(task, left, config, jobs, lose):
        known[content["name"]] = content
        on_grade(content)
    for content in lost:
        known[content["name"]] = content
        on_grade(content)
    return [known[item.name] for item in items]


def _grades(
    task: Callable[[Item], dict[str, Any]],
    items: Sequence[Item],
    config: GradeConfig,
    jobs: int,
    on_loss: Callable[[Loss[Item]], None],
) -> Iterator[dict[str, Any]]:
    if jobs == 1:
        yield from map(task, items)
        return
    longest = 120.0 * (config.cycles + 1) + 1.5 * config.limits.time_limit
    yield from share_out(task, items, jobs=jobs, limit=lambda item: longest, on_loss=on_loss)


def _lost(item: Item, config: GradeConfig, cause: str) -> dict[str, Any]:
    """Return what is known of a solver whose judge was lost twice."""
    finding = Finding(kind="died", detail=f"could not be graded: {cause}")
    return {
        "name": item.name,
        "succeeded": 0,
        "cycles": config.cycles,
        "passed": False,
        "findings": [finding.as_json()],
        "diagnoses": [],
        "figures": None,
    }


def write_class(out: Path, contents: Sequence[dict[str, Any]], *, total: int, command: str) -> None:
    """Write the list of a class as CSV and as a page.

    Args:
        out: folder of the results.
        contents: the grades that there are, in order.
        total: how many solvers the class has.
        command: that goes on with it.
    """
    part = out / (CLASS + ".part")
    with part.open("w", encoding="utf-8", errors="backslashreplace", newline="") as file:
        table = csv.DictWriter(file, COLUMNS)
        table.writeheader()
        table.writerows(_safe(class_row(content)) for content in contents)
    part.replace(out / CLASS)
    write_text(out / PAGES[1], class_page(contents, total=total, command=command))


def _safe(row: dict[str, Any]) -> dict[str, Any]:
    """Let no spreadsheet take text for a formula: names and findings come from others."""
    return {
        name: f"'{value}" if isinstance(value, str) and value[:1] in "=+-@\t" else value
        for name, value in row.items()
    }
