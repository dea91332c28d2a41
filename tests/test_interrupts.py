"""One interrupt stops a run, none tears what is being written, and handlers come back."""

from __future__ import annotations

import signal
import threading
from collections.abc import Iterator
from typing import Any

import pytest

from kr210_sim.interrupts import no_interrupt, one_interrupt

BOTH = (signal.SIGINT, signal.SIGTERM)


@pytest.fixture
def handlers() -> Iterator[list[Any]]:
    """The handlers as they are, and are again after the test."""
    before = [signal.getsignal(number) for number in BOTH]
    yield before
    for number, handler in zip(BOTH, before, strict=True):
        signal.signal(number, handler)


def now() -> list[Any]:
    return [signal.getsignal(number) for number in BOTH]


@pytest.mark.parametrize("number", BOTH)
def test_the_first_interrupt_stops_and_the_next_do_nothing(handlers, number):
    done = []

    def play() -> None:
        try:
            signal.raise_signal(number)
            done.append("went on")
        finally:
            for again in BOTH:
                signal.raise_signal(again)
            done.append("cleaned up")

    with pytest.raises(KeyboardInterrupt), one_interrupt():
        play()
    assert done == ["cleaned up"]
    for again in BOTH:  # the process is about to end, and nothing disturbs it
        signal.raise_signal(again)


def test_without_an_interrupt_all_is_as_before(handlers):
    with one_interrupt():
        assert now() != handlers
    assert now() == handlers
    with no_interrupt():
        assert now() != handlers
    assert now() == handlers


@pytest.mark.parametrize("number", BOTH)
def test_an_interrupt_waits_until_the_writing_is_done(handlers, number):
    done = []

    def write() -> None:
        with no_interrupt():
            signal.raise_signal(number)
            signal.raise_signal(number)
            done.append("written")
        done.append("went on")

    with pytest.raises(KeyboardInterrupt), one_interrupt():
        write()
    assert done == ["written"]


@pytest.mark.parametrize("guard", [one_interrupt, no_interrupt])
def test_threads_leave_interrupts_to_the_main_one(handlers, guard):
    seen: list[Any] = []

    def work() -> None:
        with guard():
            seen.append(now())

    thread = threading.Thread(target=work)
    thread.start()
    thread.join()
    assert seen == [handlers]
