"""The progress bar: rate and time left of this session, and nothing where there is no terminal."""

from __future__ import annotations

import io

import pytest

from kr210_sim.progress import ProgressBar, progress_bar


@pytest.mark.parametrize(
    ("done", "begun", "seconds", "expected"),
    [
        (0, 0, 0.0, "0/40 cycles"),
        (10, 0, 30.0, "10/40 cycles, 20.0 a minute, 1:30 left"),
        (30, 20, 30.0, "30/40 cycles, 20.0 a minute, 0:30 left"),
        (1, 0, 600.0, "1/40 cycles, 0.1 a minute, 6:30:00 left"),
        (20, 20, 5.0, "20/40 cycles"),
    ],
)
def test_rate_and_time_left_are_those_of_this_session(done, begun, seconds, expected):
    assert progress_bar(done, 40, begun=begun, seconds=seconds).endswith(f"] {expected}")


def test_only_a_terminal_gets_a_bar():
    class Terminal(io.StringIO):
        def isatty(self) -> bool:
            return True

    for stream in (io.StringIO(), Terminal()):
        bar = ProgressBar(4, stream)
        bar.show(2)
        bar.clear()
        assert ("3/4 cycles" in stream.getvalue()) == stream.isatty()
        assert bool(stream.getvalue()) == stream.isatty()
