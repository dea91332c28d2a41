"""Reports and grades in a real browser: quiet, alone, as wide as the window, readable on paper.

Skipped where playwright or Chromium is missing.
"""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from drawn_grades import drawn_grade
from drawn_runs import DROPPED, SCENERY, make_record, make_run

from kr210_sim.grading.class_list import write_class, write_grade
from kr210_sim.grading.grade import GradeConfig
from kr210_sim.record import Event
from kr210_sim.report.reading import read_run
from kr210_sim.report.write import write_report

pytestmark = pytest.mark.slow
playwright = pytest.importorskip("playwright.sync_api", reason="playwright is not installed")

CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser")
if CHROMIUM is None:
    pytest.skip("no Chromium is installed", allow_module_level=True)

PATIENCE = 120_000  # [ms]
QUIET = ("--no-sandbox", "--no-first-run", "--disable-background-networking", "--disable-sync")


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    with playwright.sync_playwright() as started:
        chromium = started.chromium.launch(
            executable_path=CHROMIUM, args=[*QUIET, "--disable-gpu"], timeout=PATIENCE
        )
        yield chromium
        chromium.close()


@pytest.fixture(scope="module")
def report(tmp_path_factory):
    """A report with a success, failures, long words and a film."""
    out = tmp_path_factory.mktemp("report") / ("run-" + "x" * 60)
    record = make_record(1, DROPPED, drawn={"target_mass_kg": 1.0, "a" * 70: [1.0] * 6})
    lost = Event(reason="simulation_diverged", stage="LIFT", time=0.14, detail="impossible")
    records = [make_record(0), record, make_record(2, lost)]
    make_run(out, records, xacro_arg=("a=" + "b" * 150,), junit=out / ("j" * 90))
    return write_report(read_run(out), SCENERY)


@pytest.fixture(scope="module")
def grades(tmp_path_factory, scene):
    """The page of a solver with long words, and that of its class."""
    out = tmp_path_factory.mktemp("class")
    mistaken = Path(__file__).parent / "mistaken_solvers.py"
    content = drawn_grade(scene, mistaken, "frame_and_turns", GradeConfig(cycles=10))
    content |= {"name": "n" * 70, "solver": "s" * 150, "output": "printed " * 40 + "p" * 300}
    content["findings"] = [{"kind": "raised", "detail": "d" * 200, "line": 3, "source": "x" * 300}]
    write_grade(out / content["name"], content)
    write_class(out, [content], total=2, command="kr210-sim grade " + "c" * 200)
    return {"solver": out / content["name"] / "grade.html", "class": out / "class.html"}


def opened(browser: Any, report: Any, width: int = 1440, scheme: str = "light") -> Any:
    """Open the page; `said` of the tab collects requests, errors and what the console shows."""
    tab = browser.new_page(viewport={"width": width, "height": 800}, color_scheme=scheme)
    tab.set_default_timeout(PATIENCE)
    said: list[str] = []
    tab.on("request", lambda request: said.append(request.url))
    tab.on("console", lambda message: said.append(message.text))
    tab.on("pageerror", lambda error: said.append(str(error)))
    tab.goto(report.as_uri())
    return tab, said


@pytest.mark.parametrize(("width", "scheme"), [(375, "dark"), (1440, "light")])
def test_the_page_is_quiet_asks_for_nothing_and_never_scrolls_sideways(
    browser, report, width, scheme
):
    tab, said = opened(browser, report, width, scheme)
    tab.evaluate("document.querySelectorAll('details').forEach(each => each.open = true)")
    assert tab.evaluate("document.documentElement.scrollWidth") == width
    assert said == [report.as_uri()]
    edges = tab.evaluate(
        "[...document.querySelectorAll('svg')].map(each => each.getBoundingClientRect().right)"
    )
    assert max(edges) <= width
    tab.close()


@pytest.mark.parametrize("name", ["solver", "class"])
@pytest.mark.parametrize(("width", "scheme"), [(375, "dark"), (1440, "light")])
def test_the_pages_of_grades_are_quiet_and_as_wide_as_their_window(
    browser, grades, name, width, scheme
):
    tab, said = opened(browser, grades[name], width, scheme)
    tab.evaluate("document.querySelectorAll('details').forEach(each => each.open = true)")
    assert tab.evaluate("document.documentElement.scrollWidth") == width
    assert said == [grades[name].as_uri()]
    assert cut_off(tab) == []
    tab.close()


def test_on_paper_poses_stay_folded(browser, grades):
    tab, _ = opened(browser, grades["solver"])
    tab.emulate_media(media="print")
    assert not tab.locator("details.poses").first.is_visible()
    tab.close()


def test_nothing_a_plot_writes_is_cut_off(browser, report):
    """Every text lies within its drawing, in the fonts that the browser has."""
    tab, _ = opened(browser, report)
    tab.evaluate("document.querySelectorAll('details').forEach(each => each.open = true)")
    assert cut_off(tab) == []
    tab.close()


def cut_off(tab: Any) -> list[str]:
    """Return the texts of drawings that do not lie within them."""
    found: list[str] = tab.evaluate(
        "[...document.querySelectorAll('figure svg')].flatMap(svg => {"
        "const frame = svg.getBoundingClientRect();"
        "return [...svg.querySelectorAll('text')].filter(text => {"
        "const box = text.getBoundingClientRect();"
        "return box.left < frame.left - 1 || box.right > frame.right + 1"
        "|| box.top < frame.top - 1 || box.bottom > frame.bottom + 1"
        "}).map(text => text.textContent)})"
    )
    return found


def test_a_link_in_the_table_opens_the_cycle(browser, report):
    tab, _ = opened(browser, report)
    inside = tab.locator("#cycle-0")
    assert not inside.is_visible()
    tab.locator("#cycles a", has_text="0").first.click()
    inside.wait_for(state="visible")
    assert tab.evaluate("document.querySelector('#cycle-0').closest('details').open")
    tab.close()


def test_the_keyboard_reaches_the_verdict_first(browser, report):
    tab, _ = opened(browser, report)
    tab.keyboard.press("Tab")
    assert tab.evaluate("document.activeElement.textContent") == "Skip to the verdict"
    assert tab.evaluate("document.activeElement.getBoundingClientRect().left >= 0")
    tab.close()


def test_dark_and_paper_have_their_own_colours(browser, report):
    colours = "(() => {const of = getComputedStyle(document.querySelector('figure svg text'));"
    colours += "return [getComputedStyle(document.body).backgroundColor, of.fill]})()"
    tab, _ = opened(browser, report, scheme="dark")
    dark = tab.evaluate(colours)
    tab.emulate_media(media="print")
    paper = tab.evaluate(colours)
    tab.emulate_media(media="screen", color_scheme="light")
    light = tab.evaluate(colours)
    assert dark != light
    assert paper[1] == light[1]
    tab.close()


def test_on_paper_every_cycle_is_open(browser, report):
    tab, _ = opened(browser, report)
    tab.emulate_media(media="print")
    shown = tab.evaluate(
        "[...document.querySelectorAll('.inside')].map(each => each.getBoundingClientRect().height)"
    )
    assert len(shown) == 3
    assert min(shown) > 100
    tab.close()


def test_the_film_beside_the_page_may_be_shown(browser, report):
    """The page's own policy lets the film pass, though nothing else; an empty file cannot play."""
    film = report.with_name("film.mp4")
    film.write_bytes(b"")
    try:
        write_report(read_run(report.parent), SCENERY)
        tab, said = opened(browser, report)
        for _ in range(300):
            if film.as_uri() in said:
                break
            tab.wait_for_timeout(100)
        assert film.as_uri() in said
        assert not [text for text in said if "Content Security Policy" in text]
        tab.close()
    finally:
        film.unlink()
