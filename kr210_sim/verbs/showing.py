"""Pages and windows as the verbs open them: checked before anything else, and announced."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

from kr210_sim.config import RunConfig
from kr210_sim.interrupts import one_interrupt
from kr210_sim.verbs.common import warn
from kr210_sim.viewers.address import is_loopback

if TYPE_CHECKING:
    from kr210_sim.viewers.live import Watcher
    from kr210_sim.viewers.page import Page


@contextmanager
def opened_page(host: str, port: int, title: str) -> Iterator[Page]:
    """Serve a page as long as the body runs, and say where it is.

    Raises:
        BadInput: if the extra is missing, or the place cannot be listened on.
    """
    from kr210_sim.viewers.page import Page

    page = Page(host, port, title)
    try:
        print(f"kr210-sim: {page.url}   Ctrl-C ends", file=sys.stderr, flush=True)
        if not is_loopback(host):
            warn([f"--host {host}: whoever reaches this address can use the page"])
        yield page
    finally:
        page.close()


def until_interrupted(wait: Callable[[], None]) -> None:
    """Wait until the window is closed, or for Ctrl-C, which is how looking is meant to end."""
    with one_interrupt():
        try:
            wait()
        except KeyboardInterrupt:
            return


@contextmanager
def watching(config: RunConfig) -> Iterator[Watcher | None]:
    """Open what `--viewer` asks for as long as the body runs.

    Raises:
        BadInput: if it cannot be opened, with the remedy.
    """
    if config.viewer is None:
        yield None
        return
    from kr210_sim.viewers.live import Watcher
    from kr210_sim.viewers.pace import Pace

    pace = Pace(config.viewer_speed)
    if config.viewer == "web":
        with opened_page(config.host, config.port, f"run, seed {config.seed}") as page:
            from kr210_sim.viewers.cycle_page import LivePage

            yield Watcher(LivePage(page, pace), pace)
        return
    from kr210_sim.viewers.native import KEYS, NativeScreen, check_display

    check_display()
    print(f"kr210-sim: {KEYS}", file=sys.stderr, flush=True)
    screen = NativeScreen(pace)
    try:
        yield Watcher(screen, pace)
    finally:
        screen.close()
