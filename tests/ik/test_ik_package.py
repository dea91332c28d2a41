"""The package as a whole: what it imports, what it exports."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

import ik

IMPORT = """
import sys
before = set(sys.modules)
import ik
ik.inverse  # loads all of it
new = {name.partition(".")[0] for name in set(sys.modules) - before}
print(*sorted(new - {"ik", "numpy"} - sys.stdlib_module_names))
"""


def test_it_imports_numpy_and_nothing_else():
    where = Path(ik.__file__).parents[1]
    done = subprocess.run(
        [sys.executable, "-c", IMPORT], cwd=where, capture_output=True, text=True, check=True
    )
    foreign = [name for name in done.stdout.split() if not name.startswith("_")]
    assert foreign == []


def test_numpy_comes_with_the_first_name_that_is_asked_for():
    script = "import sys, ik; before = 'numpy' in sys.modules; ik.inverse; from ik import *"
    script += "; print(before, 'numpy' in sys.modules, inverse is ik.inverse, KR210 is ik.KR210)"
    where = Path(ik.__file__).parents[1]
    done = subprocess.run(
        [sys.executable, "-c", script], cwd=where, capture_output=True, text=True, check=True
    )
    assert done.stdout.split() == ["False", "True", "True", "True"]


def test_a_name_that_is_not_there_is_named():
    with pytest.raises(AttributeError, match="'ik' has no attribute 'invert'"):
        _ = ik.invert
    assert set(ik.__all__) <= set(dir(ik))


def test_every_exported_name_resolves():
    for name in ik.__all__:
        assert getattr(ik, name).__doc__ or name == "KR210"


def test_it_says_that_it_is_typed():
    assert (Path(ik.__file__).parent / "py.typed").exists()


def test_files_stay_short():
    for path in Path(ik.__file__).parent.glob("*.py"):
        assert len(path.read_text().splitlines()) < 400, path.name


def test_the_example_of_the_readme_runs():
    readme = Path(ik.__file__).with_name("README.md").read_text(encoding="utf-8")
    example = readme.split("```python\n")[1].split("```")[0]
    names: dict = {}
    exec(example, names)
    assert names["found"].in_limits.any(axis=1).all()
