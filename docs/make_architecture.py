"""Make the picture and the table of docs/architecture.md from the imports and docstrings.

`python docs/make_architecture.py`; tests/test_papers.py fails where they are not what it gives.
"""

from __future__ import annotations

import ast
import html
from functools import cache
from itertools import pairwise
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
PAGE = ROOT / "docs" / "architecture.md"
PICTURE = ROOT / "docs" / "images" / "architecture.svg"
BEGIN, END = "<!-- table: written by docs/make_architecture.py -->", "<!-- end of table -->"

BOX, GAP = (176, 34), (200, 62)
"""Width and height of a box, and from the centre of one to those beside and below it [px]."""

STEPS = {
    "inverse kinematics": "ik",
    "ground": "exceptions arrays resources criteria record interrupts stats schemas",
    "options": "config options kinds source randomize draws film.format grading.source "
    "viewers.address viewers.pace progress",
    "description": "packages safe_xml expand urdf_tree inertials dae meshes shapes description",
    "robot": "gripper arm robot dynamics effort kinematics",
    "world": "geometry mjcf physics loading scene simulation mjcf_files",
    "conversion": "parity convert",
    "planning": "task legs path spline tracks planning sampling advance chain distances "
    "pairs looks collision course room variation",
    "timing": "limits time_law path_law trajectory tcp_limits motions clearance",
    "cycle": "control seen monitor stepping grip recovery offsets cycle",
    "a solver of one's own": "grading.findings grading.process grading.foreign grading.child "
    "grading.confine grading.forms grading.python2 grading.stand_ins",
    "verdict": "score proof gates failures summary separation success_map compare comparison",
    "campaign": "episodes episode_files workers results playback runner verify",
    "pictures": "film plots scenery report video viewers junit",
    "grades": "grading",
    "scripts and command line": "api verbs cli __main__ kr210_sim",
}
"""Step of the data flow -> its modules, or sub-packages with all that no other step names."""


@cache
def modules() -> dict[str, Path]:
    """Return module or sub-package -> file, of both packages, as the steps name them."""
    files = [*sorted((ROOT / "ik").glob("*.py")), *sorted((ROOT / "kr210_sim").rglob("*.py"))]
    found = {}
    for path in files:
        parts = path.relative_to(ROOT).with_suffix("").parts
        name = ".".join(part for part in parts if part != "__init__")
        found[name.removeprefix("kr210_sim.")] = path
    return found


def steps() -> dict[str, list[str]]:
    """Return step -> modules.

    Raises:
        ValueError: naming what is in no step, or in two, or does not exist.
    """
    known = modules()
    named = {name: step for step, names in STEPS.items() for name in names.split()}
    if unknown := named.keys() - known.keys():
        raise ValueError(f"no such module: {', '.join(sorted(unknown))}")
    found: dict[str, list[str]] = {step: [] for step in STEPS}
    for name in known:
        parts = name.split(".")
        above = [".".join(parts[:count]) for count in range(len(parts), 0, -1)]
        step = next((named[each] for each in above if each in named), None)
        if step is None:
            raise ValueError(f"{name}: in which step of docs/make_architecture.py does it belong?")
        found[step].append(name)
    return found


@cache
def tree(path: Path) -> ast.Module:
    """Return the syntax of a file."""
    return ast.parse(path.read_text(encoding="utf-8"))


@cache
def imported(path: Path) -> set[str]:
    """Return the modules and packages that a file imports when it runs, as the steps name them."""
    found: set[str] = set()
    waiting: list[ast.AST] = [tree(path)]
    while waiting:
        node = waiting.pop()
        if isinstance(node, ast.If) and getattr(node.test, "id", "") == "TYPE_CHECKING":
            continue
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module and not node.level:
            within = {
                f"{node.module}.{alias.name}".removeprefix("kr210_sim.") for alias in node.names
            }
            found |= (within & modules().keys()) or {node.module}
        inside = ast.iter_child_nodes(node)
        waiting += (each for each in inside if not isinstance(each, ast.expr))
    found.discard("kr210_sim")  # for its version
    return {name.removeprefix("kr210_sim.") for name in found} & modules().keys()


def arrows() -> list[tuple[str, str]]:
    """Return the arrows of the picture: what a step imports, but for what another one brings.

    Raises:
        ValueError: if steps need each other in a circle.
    """
    home = {name: step for step, names in steps().items() for name in names}
    needs: dict[str, set[str]] = {step: set() for step in STEPS}
    for name, path in modules().items():
        if home[name] != "inverse kinematics":
            needs[home[name]] |= {home[each] for each in imported(path)} - {home[name]}
    order = list(STEPS)
    for step, needed in needs.items():
        if late := [each for each in needed if order.index(each) > order.index(step)]:
            raise ValueError(f"step '{step}' imports from a later one: {', '.join(late)}")
    brought: dict[str, set[str]] = {}
    for step in order:
        brought[step] = needs[step].union(*(brought[each] for each in needs[step]))
    return [
        (needed, step)
        for step in order
        for needed in order
        if needed in needs[step]
        and not any(needed in brought[other] for other in needs[step] - {needed})
    ]


def rows(lines: list[tuple[str, str]]) -> list[list[tuple[str, str]]]:
    """Return what stands in each row of the picture, from left to right.

    A step stands below all that it needs, and one that needs nothing just above what needs it. It
    is (step, step); an arrow that passes a row has a place there, too: (first, then).
    """
    level: dict[str, int] = {}
    for step in STEPS:
        level[step] = 1 + max((level[first] for first, then in lines if then == step), default=-1)
    for step in set(STEPS) - {then for _, then in lines}:
        level[step] = min(level[then] for first, then in lines if first == step) - 1
    found: list[list[tuple[str, str]]] = [[] for _ in range(max(level.values()) + 1)]
    for step in STEPS:
        found[level[step]].append((step, step))
    for first, then in lines:
        for passed in range(level[first] + 1, level[then]):
            found[passed].append((first, then))
    for above, row in pairwise(found):  # below the middle of what leads there

        def middle(place: tuple[str, str], above: list[tuple[str, str]] = above) -> float:
            step, then = place
            sources = [step] if step != then else [first for first, end in lines if end == step]
            at = [index - len(above) / 2 for index, (first, _) in enumerate(above)
                  if first in sources]  # fmt: skip
            return sum(at) / len(at) if at else 0.0

        row.sort(key=middle)
    return found


def picture() -> str:
    """Return the data flow as an SVG that reads on light and on dark."""
    lines = arrows()
    found = rows(lines)
    beside, below = GAP
    width, height = beside * max(map(len, found)), below * len(found)
    at = {
        (place, y): (width / 2 + beside * (x - (len(row) - 1) / 2), below * (y + 0.5))
        for y, row in enumerate(found)
        for x, place in enumerate(row)
    }
    drawn = [HEAD.format(width=width, height=height)]
    for first, then in lines:
        passed = {(first, first), (first, then), (then, then)}
        drawn.append(arrow([point for (place, _), point in at.items() if place in passed]))
    drawn += [box(step, *point) for ((step, then), _), point in at.items() if step == then]
    return "\n".join([*drawn, "</svg>", ""])


def arrow(points: list[tuple[float, float]]) -> str:
    """Return an arrow from the box at the first point, past others, to the box at the last."""
    half, tip = BOX[1] / 2, 5
    x, y = points[0]
    path = f"M{x:g} {y + half:g}"
    for index, (x_next, y_next) in enumerate(points[1:], 2):
        end = y_next - half - tip * (index == len(points))
        bend = (y + half + end) / 2
        path += f"C{x:g} {bend:g} {x_next:g} {bend:g} {x_next:g} {end:g}"
        path += f"V{y_next + half:g}" * (index < len(points))
        x, y = x_next, y_next
    return f'<path d="{path}" marker-end="url(#tip)"/>'


def box(step: str, x: float, y: float) -> str:
    """Return the box of a step, its centre at x, y."""
    width, height = BOX
    corner = f'x="{x - width / 2:g}" y="{y - height / 2:g}"'
    return (
        f'<rect {corner} width="{width}" height="{height}" rx="5"/>'
        f'<text x="{x:g}" y="{y + 5:g}">{html.escape(step, quote=False)}</text>'
    )


HEAD = """\
<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width} {height}" width="{width}" \
height="{height}">
<title>The steps of the data flow; an arrow leads from a step to one that imports it</title>
<style>
path {{ fill: none; stroke: #7d8ca3; stroke-width: 1.5 }}
#tip path {{ fill: #7d8ca3; stroke: none }}
rect {{ fill: #e9eff8; stroke: #44689b }}
text {{ font: 14px sans-serif; fill: #16202e; text-anchor: middle }}
</style>
<marker id="tip" viewBox="0 0 8 8" refX="3" refY="4" markerWidth="6" markerHeight="6" \
orient="auto"><path d="M0 0L8 4L0 8Z"/></marker>"""


def table() -> str:
    """Return step by step what each file is for: the first sentence of its docstring."""
    known, lines = modules(), []
    for step, names in steps().items():
        lines += [f"### {step[0].upper()}{step[1:]}", "", "| file | what it is for |", "|---|---|"]
        for name in names:
            path = known[name]
            text = ast.get_docstring(tree(path)) or ""
            sentence = text.split("\n\n")[0].replace("\n", " ").replace("|", "\\|")
            shown = path.relative_to(ROOT).as_posix().removeprefix("kr210_sim/")
            lines.append(f"| `{shown}` | {sentence} |")
        lines.append("")
    return "\n".join(lines).rstrip()


def written(page: str) -> str:
    """Return the page with its table as it is now."""
    head, _, rest = page.partition(BEGIN)
    return f"{head}{BEGIN}\n\n{table()}\n\n{END}{rest.partition(END)[2]}"


if __name__ == "__main__":
    PAGE.write_text(written(PAGE.read_text(encoding="utf-8")), encoding="utf-8")
    PICTURE.write_text(picture(), encoding="utf-8")
