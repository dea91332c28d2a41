"""Take the screenshots of the report in docs/images: `python docs/make_screenshots.py`.

Needs the extra `browser` and a Chromium. A run in which some cycles fail is made for them, or
given: `python docs/make_screenshots.py RUN`.
"""

from __future__ import annotations

import shutil
import sys
import tempfile
from pathlib import Path

from playwright.sync_api import sync_playwright

from kr210_sim.cli import main as kr210_sim

IMAGES = Path(__file__).resolve().parent / "images"
RUN = ["--randomize", "hard", "--seed", "1", "--min-success", "0.5"]
PICTURES = {
    "report_1440.png": (1440, 2000, "light"),
    "report_1440_dark.png": (1440, 2000, "dark"),
    "report_375.png": (375, 2400, "light"),
}
"""File -> width and height [pixels], and colour scheme."""


def main(given: list[str]) -> None:
    """Take all of them."""
    with tempfile.TemporaryDirectory() as folder:
        out = Path(given[0]) if given else Path(folder) / "hard"
        if not given:
            kr210_sim(["run", *RUN, "--out", str(out)])
        kr210_sim(["report", str(out)])
        take(out / "report.html")


def take(page: Path) -> None:
    """Take the pictures of a page, in the Chromium that is installed."""
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(
            executable_path=shutil.which("chromium"), args=["--no-sandbox"]
        )
        for name, (width, height, scheme) in PICTURES.items():
            tab = browser.new_page(viewport={"width": width, "height": height}, color_scheme=scheme)
            tab.goto(page.absolute().as_uri())
            tab.screenshot(path=IMAGES / name)
            tab.close()
        browser.close()


if __name__ == "__main__":
    main(sys.argv[1:])
