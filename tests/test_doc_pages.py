"""The pages of docs/: snippets print what stands below them, and lists name all there is."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
import test_benchmarks
from shown import ROOT, assert_prints_what_stands_below, blocks, my_scene

import ik
import kr210_sim
from kr210_sim import RunConfig, build_scene, plan_cycle

DOCS = ROOT / "docs"
PAGES = sorted(DOCS.glob("*.md"))
SNIPPETS = [
    page
    for page in PAGES
    if page.name != "ci.md"  # for pytest: test_ci_docs.py
    and any(language == "python" for language, _ in blocks(page))
]


@pytest.mark.slow
@pytest.mark.parametrize("page", SNIPPETS, ids=lambda page: page.stem)
def test_every_snippet_prints_what_stands_below_it(page, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    my_scene(Path("my_scene.xml"))
    assert_prints_what_stands_below(page)


@pytest.mark.slow
def test_the_obstacle_of_the_page_about_scenes_is_in_the_way(tmp_path, scene):
    my_scene(tmp_path / "my_scene.xml")
    config = RunConfig(cell="5", scene=str(tmp_path / "my_scene.xml"))
    changed = [motion.stages for motion in plan_cycle(config, build_scene(config))]
    plain = [motion.stages for motion in plan_cycle(RunConfig(cell="5"), scene)]
    for stage in ("MOVE_TO_PLACE", "MOVE_HOME"):
        assert sum(stages.count(stage) for stages in plain) == 1
        assert sum(stages.count(stage) for stages in changed) == 2  # a detour has two legs


def test_the_api_has_every_public_name_once():
    shown = re.findall(r"^::: (.+)$", (DOCS / "api.md").read_text(encoding="utf-8"), re.MULTILINE)
    names = [f"{package.__name__}.{name}" for package in (kr210_sim, ik)
             for name in package.__all__]  # fmt: skip
    assert sorted(shown) == sorted(names)


@pytest.mark.parametrize("where", ["docs/README.md", "mkdocs.yml"])
def test_every_page_is_reached(where):
    text = (ROOT / where).read_text(encoding="utf-8")
    for page in PAGES:
        if page.name != "README.md":
            assert f"({page.name})" in text or f"- {page.name}\n" in text, page.name


def test_the_page_about_benchmarks_has_every_one():
    text = (DOCS / "benchmarks.md").read_text(encoding="utf-8")
    for script in test_benchmarks.SCRIPTS:
        assert f"| `{script}" in text, script
