"""Write the picture and the table of docs/architecture.md from the imports and docstrings.

`python docs/make_architecture.py`; tests/test_papers.py fails where the page is not what it gives.
"""

from __future__ import annotations

import ast
from functools import cache
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
PAGE = ROOT / "docs" / "architecture.md"
BEGIN, END = "<!-- {}: written by docs/make_architecture.py -->", "<!-- end of {} -->"

STEPS = {
    "inverse kinematics": "ik",
    "ground": "exceptions arrays resources criteria record interrupts stats schemas",
    "options": "config options source randomize draws film.format grading.source viewers.address "
    "viewers.pace progress",
    "description": "packages safe_xml expand urdf_tree inertials dae meshes shapes description",
    "robot": "gripper arm robot dynamics effort kinematics",
    "world": "geometry mjcf physics loading scene simulation mjcf_files",
    "conversion": "parity convert",
    "planning": "task legs path tracks planning sampling advance distances "
    "pairs looks collision course room variation",
    "timing": "limits time_law path_law trajectory tcp_limits motions clearance",
    "cycle": "control seen monitor stepping grip recovery offsets cycle",
    "a solver of one's own": "grading.findings grading.process grading.foreign grading.child "
    "grading.confine grading.forms grading.python2 grading.stand_ins",
    "verdict": "score proof gates failures summary separation success_map compare",
    "campaign": "episodes episode_files workers results playback runner verify",
    "pictures": "film plots scenery report video viewers junit",
    "grades": "grading",
    "scripts and command line": "api verbs cli kr210_sim",
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


def picture() -> str:
    """Return the data flow as a Mermaid graph."""
    label = {step: f's{index}["{step}"]' for index, step in enumerate(STEPS)}
    lines = [f"  {label[first]} --> {label[then]}" for first, then in arrows()]
    return "\n".join(["```mermaid", "graph TD", *lines, "```"])


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
    """Return the page with its picture and its table as they are now."""
    for name, content in (("picture", picture()), ("table", table())):
        begin, end = BEGIN.format(name), END.format(name)
        head, _, rest = page.partition(begin)
        tail = rest.partition(end)[2]
        page = f"{head}{begin}\n\n{content}\n\n{end}{tail}"
    return page


if __name__ == "__main__":
    PAGE.write_text(written(PAGE.read_text(encoding="utf-8")), encoding="utf-8")
