"""The house: who may import whom, what every file says of itself, and how long things may be."""

from __future__ import annotations

import ast
import importlib
import json
import subprocess
import sys
from functools import cache
from pathlib import Path

import pytest

import ik
import kr210_sim

PACKAGE = Path(kr210_sim.__file__).parent
FILES = sorted(PACKAGE.rglob("*.py"))
NAMES = [".".join(path.relative_to(PACKAGE).with_suffix("").parts) for path in FILES]
PRINTING = ("cli", "video", "verbs.")
"""Modules that print."""

WITHOUT_MUJOCO = (
    "arrays", "compare", "comparison", "config", "criteria", "exceptions", "failures", "gates",
    "grading.advice", "grading.diagnosis", "grading.explain", "grading.mistakes", "grading.steps",
    "legs", "path", "planning", "proof", "randomize", "record", "resources",
    "sampling", "score", "separation", "stats", "success_map", "summary", "task", "tcp_limits",
    "time_law", "tracks", "trajectory",
    "plots.cycle_plots", "plots.grade_plots", "plots.map_plots", "plots.offsets",
    "plots.recorded", "plots.run_plots", "plots.space_plot", "plots.theme",
    "report.page", "report.reading", "report.templating", "report.write",
)  # fmt: skip


@cache
def text_of(name: str) -> str:
    return PACKAGE.joinpath(*name.split(".")).with_suffix(".py").read_text(encoding="utf-8")


@cache
def tree_of(name: str) -> ast.Module:
    return ast.parse(text_of(name))


def is_type_checking(node: ast.AST) -> bool:
    return isinstance(node, ast.If) and ast.unparse(node.test) == "TYPE_CHECKING"


@cache
def imports_of(tree: ast.AST) -> set[str]:
    """Return the full names of what a module imports when it runs, in functions too."""
    found: set[str] = set()
    waiting: list[ast.AST] = [tree]
    while waiting:
        node = waiting.pop()
        if is_type_checking(node):
            continue
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module:
            found.add(node.module)
            found |= {f"{node.module}.{alias.name}" for alias in node.names}
        waiting += ast.iter_child_nodes(node)
    return found


def ours(imported: set[str]) -> set[str]:
    """Return the modules of kr210_sim among imported names."""
    inside = {name.removeprefix("kr210_sim.") for name in imported if name.startswith("kr210_sim.")}
    found = set()
    for name in inside:
        parts = name.split(".")
        prefixes = (".".join(parts[:count]) for count in range(len(parts), 0, -1))
        known = (form for prefix in prefixes for form in (prefix, f"{prefix}.__init__"))
        found |= {form for form in known if form in NAMES}
    return found


NEEDS = {name: ours(imports_of(tree_of(name))) for name in NAMES}


@cache
def below(name: str) -> set[str]:
    """Return a module of ours and all of ours that it needs, directly or through others."""
    seen, waiting = set(), {name}
    while waiting:
        seen |= waiting
        waiting = set().union(*(NEEDS[module] for module in waiting)) - seen
    return seen


def brought_by(statement: str) -> set[str]:
    """Return the top-level modules that a statement adds to a fresh interpreter."""
    program = (
        "import json, sys; before = set(sys.modules)\n"
        f"{statement}\n"
        "print(json.dumps(sorted(set(sys.modules) - before)))"
    )
    done = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, check=True
    )
    return {name.split(".")[0] for name in json.loads(done.stdout)}


# ---- imports --------------------------------------------------------------------------------


def test_ik_brings_numpy_and_nothing_else():
    brought = brought_by("import ik; ik.inverse") - set(sys.stdlib_module_names)
    assert {name for name in brought if not name.startswith("_")} == {"ik", "numpy"}


@pytest.mark.slow
def test_planning_timing_and_scoring_run_without_mujoco():
    brought = brought_by("; ".join(f"import kr210_sim.{name}" for name in WITHOUT_MUJOCO))
    assert "kr210_sim" in brought
    assert not {"mujoco", "ompl"} & brought  # ompl only when a path is sampled


@pytest.mark.parametrize("name", WITHOUT_MUJOCO)
def test_no_module_reaches_mujoco_through_another_of_ours(name):
    reaching = {module for module in below(name) if "mujoco" in imports_of(tree_of(module))}
    assert reaching == set()


def test_imports_form_a_ladder():
    """Modules can be put in an order in which each imports only earlier ones."""
    left, order = dict(NEEDS), []
    while left:
        free = sorted(name for name, needs in left.items() if needs <= set(order) | {name})
        assert free, f"these import each other in a circle: {sorted(left)}"
        order += free
        for name in free:
            del left[name]


def test_ik_knows_nothing_of_the_simulation():
    for path in Path(ik.__file__).parent.glob("*.py"):
        imported = imports_of(ast.parse(path.read_text(encoding="utf-8")))
        assert not any(name.startswith(("kr210_sim", "mujoco")) for name in imported), path.name


def test_the_command_line_stands_at_the_top():
    assert not any(
        "cli" in needs for name, needs in NEEDS.items() if name not in ("cli", "__main__")
    )
    for name, needs in NEEDS.items():
        if name != "cli" and not name.startswith("verbs."):
            assert not any(needed.startswith("verbs.") for needed in needs), name


SHOW_HELP = """
import contextlib, io
from kr210_sim.cli import main
with contextlib.redirect_stdout(io.StringIO()), contextlib.suppress(SystemExit):
    main(["--help"])
"""


@pytest.mark.parametrize("statement", ["import kr210_sim", SHOW_HELP], ids=["import", "help"])
def test_what_needs_no_package_loads_none(statement):
    assert brought_by(statement) - set(sys.stdlib_module_names) == {"kr210_sim"}


def test_a_run_loads_nothing_that_only_other_verbs_need():
    needed = below("runner")
    assert "cycle" in needed
    heavy = ("scipy.stats", "matplotlib", "jinja2", "PIL", "imageio_ffmpeg", "viser")
    for name in needed:
        found = [each for each in imports_of(tree_of(name)) if each.startswith(heavy)]
        assert not found, name


# ---- names ----------------------------------------------------------------------------------


@pytest.mark.parametrize("module", ["ik", "kr210_sim", *(f"kr210_sim.{name}" for name in NAMES)])
def test_every_public_name_resolves(module):
    loaded = importlib.import_module(module.removesuffix(".__init__"))
    for name in getattr(loaded, "__all__", ()):
        assert hasattr(loaded, name), name


def test_the_package_is_typed():
    assert (PACKAGE / "py.typed").is_file()
    assert (Path(ik.__file__).parent / "py.typed").is_file()


# ---- form -----------------------------------------------------------------------------------


@pytest.mark.parametrize("name", NAMES)
def test_one_sentence_says_what_the_file_is_for(name):
    text = ast.get_docstring(tree_of(name))
    assert text
    sentence = text.split("\n\n")[0]
    assert sentence.endswith(".")
    assert "\n" not in sentence
    assert sentence.count(". ") == 0


@pytest.mark.parametrize("name", NAMES)
def test_no_file_is_over_400_lines_and_no_function_over_60(name):
    lines = text_of(name).splitlines()
    assert len(lines) <= 400
    for node in ast.walk(tree_of(name)):
        if isinstance(node, ast.FunctionDef):
            assert node.end_lineno - node.lineno + 1 <= 60, node.name


@pytest.mark.parametrize(
    "name", [name for name in NAMES if name not in PRINTING and not name.startswith("verbs.")]
)
def test_the_library_is_silent(name):
    calls = [
        node.func.id
        for node in ast.walk(tree_of(name))
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Name)
    ]
    assert "print" not in calls


def test_no_random_number_comes_from_a_global_generator():
    for name in NAMES:
        text = text_of(name)
        assert "np.random.seed" not in text
        assert "import random" not in text
