"""The page in a real browser: a slider moves the arm, and the numbers are those of `ik.forward`.

Skipped where viser, playwright or Chromium is missing. KR210_SCREENSHOTS=FOLDER keeps pictures.
"""

from __future__ import annotations

import os
import shutil
import socket
import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import ik
from kr210_sim.config import RunConfig
from kr210_sim.runner import run
from kr210_sim.source import RobotSource
from kr210_sim.viewers.arm_page import ArmPage
from kr210_sim.viewers.cycle_page import LivePage, ReplayPage
from kr210_sim.viewers.live import Watcher
from kr210_sim.viewers.pace import Pace
from kr210_sim.viewers.page import Page
from kr210_sim.viewers.replay import Player, load_replay
from kr210_sim.viewers.subject import load_subject

pytestmark = pytest.mark.slow
pytest.importorskip("viser", reason="the extra 'view' is not installed")
playwright = pytest.importorskip("playwright.sync_api", reason="playwright is not installed")

CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser")
if CHROMIUM is None:
    pytest.skip("no Chromium is installed", allow_module_level=True)

SOFTWARE_GL = ("--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader")
QUIET = (
    "--no-sandbox", "--no-first-run", "--disable-background-networking", "--disable-sync",
    "--disable-component-update",
)  # fmt: skip
SIZE = {"width": 720, "height": 400}
"""Small, as every pixel is drawn without a GPU."""
PATIENCE = 240_000
"""Longest wait for the page [ms]: it is drawn without a GPU."""
STEP = 100
"""Between two looks at what is waited for [ms]."""


def free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    with playwright.sync_playwright() as started:
        chromium = started.chromium.launch(
            executable_path=CHROMIUM, args=[*SOFTWARE_GL, *QUIET], timeout=PATIENCE
        )
        yield chromium
        chromium.close()


def open_page(browser: Any, url: str) -> tuple[Any, list[str]]:
    """Open a page; the list collects what it asks the network for, and its errors."""
    tab, said = browser.new_page(viewport=SIZE), []
    tab.set_default_timeout(PATIENCE)
    tab.on("request", lambda request: said.append(request.url))
    tab.on("pageerror", lambda error: said.append(f"error: {error}"))
    tab.goto(url)
    return tab, said


def matrix(tab: Any, name: str) -> np.ndarray:
    rows = tab.locator(f"#{name} tr").all()
    return np.array([[float(x) for x in row.locator("td").all_inner_texts()] for row in rows])


def picture(tab: Any, name: str, clip: dict[str, float] | None = None) -> bytes:
    """Return a screenshot, or a part of it, and keep it where KR210_SCREENSHOTS says."""
    shot = tab.screenshot(timeout=PATIENCE, animations="disabled", clip=clip)
    if folder := os.environ.get("KR210_SCREENSHOTS"):
        Path(folder, f"{name}.png").write_bytes(shot)
    return bytes(shot)


def until(tab: Any, holds: Callable[[], bool]) -> None:
    """Wait for what follows a click: the browser tells the server, which answers when it can."""
    waited = 0
    while not holds():
        assert waited < PATIENCE, "it does not come true"
        tab.wait_for_timeout(STEP)
        waited += STEP


def settle(tab: Any) -> None:
    """Wait for a picture that does not change any more."""
    shots = [b""]

    def same() -> bool:
        tab.wait_for_timeout(1000)
        shots.append(picture(tab, "settling"))
        return shots[-1] == shots[-2]

    until(tab, same)


@pytest.fixture
def arm_page() -> Iterator[ArmPage]:
    page = Page("127.0.0.1", free_port(), "test")
    page.cast_shadows(False)
    try:
        yield ArmPage(page, load_subject(None, RobotSource()))
    finally:
        page.close()


def test_a_slider_moves_the_arm_and_the_numbers_are_those_of_ik_forward(browser, arm_page):
    tab, said = open_page(browser, arm_page.page.url)
    tab.wait_for_selector("#kr-poses")
    robot = arm_page.robot
    np.testing.assert_allclose(
        matrix(tab, "T_base_palm"), ik.forward(robot.geometry, np.zeros(6)), atol=6e-7
    )
    before = picture(tab, "arm_home")
    at_home = arm_page.body_positions()

    thumb = tab.get_by_role("slider").first.bounding_box()  # of joint_1
    x, y = thumb["x"] + thumb["width"] / 2, thumb["y"] + thumb["height"] / 2
    tab.mouse.move(x, y)
    tab.mouse.down()
    tab.mouse.move(x + 60, y)
    tab.mouse.up()
    tab.wait_for_function(
        "() => parseFloat(document.querySelector('#T_base_tcp tr:nth-child(2) td:last-child')"
        ".innerText) > 0.01"
    )
    angle = tab.locator("input[type=text]").first
    until(tab, lambda: abs(float(angle.input_value()) - np.degrees(arm_page.q[0])) < 0.051)
    assert arm_page.q[0] > np.radians(1.0)
    until(
        tab,
        lambda: np.allclose(
            matrix(tab, "T_base_palm"), ik.forward(robot.geometry, arm_page.q), 0.0, 6e-7
        ),
    )
    np.testing.assert_allclose(
        matrix(tab, "T_base_tcp"),
        ik.forward(robot.geometry, arm_page.q) @ robot.T_palm_tcp,
        atol=6e-7,
    )
    assert np.linalg.norm(arm_page.body_positions() - at_home, axis=1).max() > 0.02
    until(tab, lambda: picture(tab, "arm_moved") != before)
    assert tab.locator("#kr-branches tr").count() == 9
    own = f"http://127.0.0.1:{arm_page.page.server.get_port()}/"
    assert {url for url in said if not url.startswith(("data:", "blob:"))} == {own}
    tab.close()


def test_a_recorded_cycle_is_played_and_its_slider_seeks(browser, default_run):
    replay, pace = load_replay(default_run.out, 1), Pace(1.0)
    pace.pause()
    page = Page("127.0.0.1", free_port(), "test")
    page.cast_shadows(False)
    seek: list[Callable[[float], None]] = []
    screen = ReplayPage(page, pace, replay.take.duration, lambda at: seek[0](at))
    player = Player(replay, screen, pace)
    seek.append(player.seek)
    playing = threading.Thread(target=player.play)
    playing.start()
    try:
        tab, _ = open_page(browser, page.url)
        tab.wait_for_selector("#kr-stage")
        assert tab.locator("#kr-stage").inner_text() == "MOVE_TO_PICK"
        thumb = tab.get_by_role("slider").first.bounding_box()
        x, y = thumb["x"] + thumb["width"] / 2, thumb["y"] + thumb["height"] / 2
        tab.mouse.move(x, y)
        tab.mouse.down()
        tab.mouse.move(x + 120, y)
        tab.mouse.up()
        tab.wait_for_function("() => document.querySelector('#kr-time').innerText > '1'")
        assert player.time > 1.0
        tab.wait_for_function(
            "stage => document.querySelector('#kr-stage').innerText === stage",
            arg=replay.take.stage(player.time),
        )
        assert tab.get_by_role("button", name="Go on").count() == 1
        picture(tab, "replay")
        tab.close()
    finally:
        pace.end()
        playing.join()
        page.close()


def test_a_run_pauses_steps_and_changes_its_speed(browser, tmp_path):
    pace = Pace(0.05)
    pace.pause()
    page = Page("127.0.0.1", free_port(), "test")
    page.cast_shadows(False)
    watcher = Watcher(LivePage(page, pace), pace)
    config = RunConfig(cycles=1, cell="5", seed=1, out=tmp_path / "run")
    done: list[Any] = []
    running = threading.Thread(
        target=lambda: done.append(run(config, on_cycle=watcher.tell, onlooker=watcher))
    )
    running.start()
    scene = {"x": 0.0, "y": 150.0, "width": 240.0, "height": 250.0}  # beside the panel

    def told(name: str) -> str:
        return str(tab.locator(f"#kr-{name}").inner_text())

    def wait_for(name: str, text: str) -> None:
        found = "([id, text]) => document.querySelector(id)?.innerText === text"
        tab.wait_for_function(found, arg=[f"#kr-{name}", text])

    def stands_still() -> bool:
        time = told("time")
        tab.wait_for_timeout(300)
        return told("time") == time

    def placed() -> np.ndarray:
        return np.array([node.position for node in page._bodies.values()])

    try:
        tab, _ = open_page(browser, page.url)
        wait_for("stage", "MOVE_TO_PICK")  # it stands still: nothing has been missed
        at_home, before = placed(), picture(tab, "live_home", scene)
        tab.get_by_label("speed").click()
        tab.get_by_role("option", name="5 x", exact=True).click()
        tab.get_by_role("button", name="Step a stage").click()
        wait_for("stage", "APPROACH")
        tab.get_by_role("button", name="Go on").wait_for()
        until(tab, lambda: (pace.speed, pace.paused) == (5.0, True))
        until(tab, lambda: np.linalg.norm(placed() - at_home, axis=1).max() > 0.1)
        until(tab, lambda: picture(tab, "live_step", scene) != before)
        until(tab, stands_still)
        tab.get_by_role("button", name="Go on").click()
        tab.get_by_role("button", name="Pause").click()
        until(tab, lambda: pace.paused)
        pace.end()
        tab.get_by_text("1 of 1 cycles succeeded").wait_for()
        running.join()
        assert done[0][1]["succeeded"] == 1
        tab.close()
    finally:
        pace.end()
        running.join()
        page.close()


def test_ghosts_appear(browser, arm_page):
    tab, _ = open_page(browser, arm_page.page.url)
    tab.wait_for_selector("#kr-branches")
    arm_page.move(np.array([-0.6, 0.3, -0.4, 0.7, 0.8, 0.2]))
    settle(tab)
    with_ghosts = picture(tab, "ghosts")
    box = tab.get_by_label("ghosts", exact=True)
    box.uncheck()
    until(tab, lambda: picture(tab, "no_ghosts") != with_ghosts)
    tab.close()
