"""The papers of the house: made pages are up to date, and every paper says what stands."""

from __future__ import annotations

import importlib.util
import re
import tomllib
from pathlib import Path
from types import ModuleType

import pytest
import yaml

import kr210_sim

ROOT = Path(__file__).parent.parent
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))


def script(name: str) -> ModuleType:
    spec = importlib.util.spec_from_file_location(name, ROOT / "docs" / f"{name}.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


architecture, licences = script("make_architecture"), script("make_licences")


def test_the_page_of_the_architecture_is_that_of_the_files():
    page = (ROOT / "docs" / "architecture.md").read_text(encoding="utf-8")
    assert page == architecture.written(page), "run python docs/make_architecture.py"
    assert "(images/architecture.svg)" in page
    drawn = architecture.PICTURE.read_text(encoding="utf-8")
    assert drawn == architecture.picture(), "run python docs/make_architecture.py"
    for path in (*(ROOT / "ik").glob("*.py"), *(ROOT / "kr210_sim").rglob("*.py")):
        shown = path.relative_to(ROOT).as_posix().removeprefix("kr210_sim/")
        assert page.count(f"| `{shown}` |") == 1


def test_steps_that_need_each_other_in_a_circle_are_refused(monkeypatch):
    turned = dict(reversed(architecture.STEPS.items()))
    monkeypatch.setattr(architecture, "STEPS", turned)
    with pytest.raises(ValueError, match="imports from a later one"):
        architecture.arrows()


def test_a_module_without_a_step_is_refused(monkeypatch):
    rest = {step: names for step, names in architecture.STEPS.items() if step != "verdict"}
    monkeypatch.setattr(architecture, "STEPS", rest)
    with pytest.raises(ValueError, match=r"in which step .* belong"):
        architecture.steps()


def test_the_licence_of_every_dependency_is_listed_and_of_nothing_else():
    page = (ROOT / "docs" / "licences.md").read_text(encoding="utf-8")
    assert page.startswith(licences.HEAD)
    needed = licences.needed()
    assert {"mujoco", "toppra", "ruff", "viser"} <= needed.keys()
    assert list(licences.rows(page)) == list(needed), "run python docs/make_licences.py"
    for name, line in licences.rows(page).items():
        _, extras, licence, version = (part.strip(" |") for part in line.split(" | "))
        assert extras == ", ".join(needed[name])
        assert licence
        assert "not stated" not in licence
        assert version[0].isdigit()


def test_the_licence_of_an_installed_package_is_read_from_its_metadata():
    page = licences.written("")
    rows = licences.rows(page)
    assert "BSD" in rows["scipy"]
    assert "Apache" in rows["mujoco"]
    assert "BSD" in rows["xacro"]  # which has no more than the text


def test_citation_and_project_say_the_same():
    found = yaml.safe_load((ROOT / "CITATION.cff").read_text(encoding="utf-8"))
    assert found["cff-version"] == "1.2.0"
    assert found["version"] == kr210_sim.__version__
    assert found["license"] == PROJECT["project"]["license"]
    assert found["title"].startswith(PROJECT["project"]["name"])


def test_the_changelog_tells_of_this_version_below_what_is_unreleased():
    text = (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")
    titles = re.findall(r"^## (\S+)", text, flags=re.MULTILINE)
    assert titles[:2] == ["Unreleased", kr210_sim.__version__.partition(".dev")[0]]
    kinds = set(re.findall(r"^### (.*)$", text, flags=re.MULTILINE))
    assert kinds <= {
        "Added", "Changed", "Deprecated", "Removed", "Fixed", "Security", "Dependencies",
    }  # fmt: skip


def test_contributing_is_short_and_has_one_check_that_exists():
    text = (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8")
    assert len(text.splitlines()) <= 50
    assert "\n.ci/run\n" in text
    assert (ROOT / ".ci" / "run").is_file()


def test_the_sdist_has_every_paper():
    included = PROJECT["tool"]["hatch"]["build"]["targets"]["sdist"]["include"]
    papers = {path.name for path in ROOT.glob("*.md")} | {"CITATION.cff", "LICENSE"}
    assert papers <= set(included)
    assert {"docs", "tests", "examples", "assets", "scenes", "ik", "kr210_sim"} <= set(included)
