"""The pages of the course: snippets print what stands below, commands run, links lead on."""

from __future__ import annotations

import re
import shlex
import subprocess
import sys
from pathlib import Path

import pytest
from shown import FENCE, ROOT, assert_prints_what_stands_below, blocks, commands

from kr210_sim.grading.exercises import EXERCISES

DOCS = ROOT / "docs"
COURSE = DOCS / "course"
PAGES = sorted(COURSE.glob("*.md"))
LINKED = [*DOCS.rglob("*.md"), ROOT / "README.md", ROOT / "ik" / "README.md"]


# ---- snippets -------------------------------------------------------------------------------


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_every_snippet_prints_what_stands_below_it(page):
    assert {language for language, _ in blocks(page)} <= {"python", "sh", "text", ""}
    assert_prints_what_stands_below(page)


# ---- commands -------------------------------------------------------------------------------


def test_the_steps_of_the_pages_are_those_there_are():
    for exercise in EXERCISES:
        text = (COURSE / exercise.page).read_text(encoding="utf-8")
        assert f"kr210-sim grade my_file.py --step {exercise.name}\n" in text
    words = [shlex.split(command) for command in commands(PAGES)]
    assert {line[0] for line in words} == {"kr210-sim", "python", "cp"}
    steps = {line[line.index("--step") + 1] for line in words if "--step" in line}
    assert steps == {"all", *(exercise.name for exercise in EXERCISES)}


# ---- links and figures ----------------------------------------------------------------------


def anchors(page: Path) -> set[str]:
    """Anchors of the headings, as GitHub and mkdocs make them."""
    text = FENCE.sub("", page.read_text(encoding="utf-8"))
    titles = re.findall(r"^#+ (.*)$", text, flags=re.MULTILINE)
    plain = (re.sub(r"[^\w\- ]", "", re.sub(r"`|\*", "", title)) for title in titles)
    return {title.strip().lower().replace(" ", "-") for title in plain}


@pytest.mark.parametrize("page", LINKED, ids=lambda page: str(page.relative_to(ROOT)))
def test_every_link_leads_somewhere(page):
    text = FENCE.sub("", page.read_text(encoding="utf-8"))
    for target in re.findall(r"\]\(([^)\s]+)\)", text):
        if target.startswith(("http:", "https:")):
            continue
        path, _, anchor = target.partition("#")
        there = (page.parent / path).resolve() if path else page
        assert there.exists(), target
        assert there.is_relative_to(ROOT), target
        if anchor:
            assert anchor in anchors(there), target


def test_every_figure_is_shown_small_and_made_by_a_script():
    made = "".join(path.read_text() for path in (*COURSE.glob("*.py"),
                   ROOT / "benchmarks" / "course_comparisons.py"))  # fmt: skip
    shown = "".join(page.read_text(encoding="utf-8") for page in PAGES)
    figures = sorted((COURSE / "figures").iterdir())
    assert figures
    for figure in figures:
        assert figure.stat().st_size < 200_000, figure.name
        assert f'"{figure.name}"' in made
        assert f"(figures/{figure.name})" in shown


def test_every_page_is_reached_and_leads_on():
    index = (COURSE / "README.md").read_text(encoding="utf-8")
    for page in PAGES[:-3]:
        if page.name != "README.md":
            assert f"({page.name})" in index
    numbered = sorted(COURSE.glob("[0-9]*.md"))
    for page, following in zip(numbered, [*numbered[1:], COURSE / "comparisons.md"], strict=True):
        assert page.read_text(encoding="utf-8").rstrip().endswith(f"({following.name})")


def test_teachers_have_a_page_for_every_diagnosis():
    text = (COURSE / "teachers.md").read_text(encoding="utf-8")
    sections = re.findall(r"^## (\w+)$", (DOCS / "diagnoses.md").read_text(), flags=re.MULTILINE)
    assert sections
    for key in sections:
        assert f"[{key}](../diagnoses.md#{key})" in text


def test_the_rubric_adds_up_to_a_hundred():
    text = (COURSE / "teachers.md").read_text(encoding="utf-8")
    points = re.findall(r"^\| [^|]+ \| (\d+) \|", text, flags=re.MULTILINE)
    assert sum(map(int, points)) == 100


# ---- the site -------------------------------------------------------------------------------


@pytest.mark.slow
def test_the_pages_build_without_a_warning(tmp_path):
    pytest.importorskip("mkdocs")
    command = [sys.executable, "-m", "mkdocs", "build", "--quiet", "--strict", "--site-dir"]
    done = subprocess.run(
        [*command, str(tmp_path / "site")], cwd=ROOT, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    page = (tmp_path / "site" / "course" / "index.html").read_text(encoding="utf-8")
    assert "source/examples/course/exercises.py/" in page
    assert (tmp_path / "site/source/examples/course/exercises.py/index.html").is_file()
