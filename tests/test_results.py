"""The folder of a run: order, torn lines, full disks, and names no folder can have."""

from __future__ import annotations

import errno
import itertools
import json
import os
import signal
import threading
from pathlib import Path

import pytest

from kr210_sim.config import RunConfig
from kr210_sim.exceptions import BadInput
from kr210_sim.interrupts import no_interrupt, one_interrupt
from kr210_sim.results import Journal, check_same, new_folder, read_lines, take_up

SIZE = 3


def lines_of(episode: int, count: int = SIZE) -> list[dict]:
    return [{"cycle": SIZE * episode + i, "episode": episode, "x": 0.1 * i} for i in range(count)]


def size_of(cycles: int):
    return lambda index: min(SIZE, cycles - SIZE * index)


def written(out: Path) -> list[int]:
    return [line["cycle"] for line in read_lines(out)]


def journal_with(out: Path, *episodes: int) -> Journal:
    journal = Journal(out)
    for episode in episodes:
        journal.add(episode, lines_of(episode))
    journal.close()
    return journal


# ---- order ----------------------------------------------------------------------------------


@pytest.mark.parametrize("order", list(itertools.permutations(range(4))), ids=str)
def test_cycles_are_written_in_order_whatever_is_finished_first(tmp_path, order):
    journal = Journal(tmp_path)
    for count, episode in enumerate(order, start=1):
        journal.add(episode, lines_of(episode))
        contiguous = next(n for n in range(5) if n not in order[:count])
        assert written(tmp_path) == list(range(SIZE * contiguous))
    assert written(tmp_path) == list(range(4 * SIZE))


def test_what_waits_for_an_earlier_episode_is_kept_at_the_end(tmp_path):
    journal_with(tmp_path, 3, 0, 2)
    assert written(tmp_path) == [0, 1, 2, 6, 7, 8, 9, 10, 11]


# ---- taking up ------------------------------------------------------------------------------


def test_finished_episodes_stay_as_they_are_and_the_others_are_dropped(tmp_path):
    journal_with(tmp_path, 0, 1)
    text = (tmp_path / "cycles.jsonl").read_bytes()
    Journal(tmp_path, first=2).add(2, lines_of(2, 2))
    journal = take_up(tmp_path, 12, size_of(12))
    assert (tmp_path / "cycles.jsonl").read_bytes() == text
    assert [journal.finished(episode) for episode in range(4)] == [True, True, False, False]


@pytest.mark.parametrize("keep", [0.0, 0.3, 0.62, 0.9, 0.999])
def test_a_file_that_is_torn_anywhere_goes_on_to_the_same_bits(tmp_path, keep):
    whole, torn = tmp_path / "whole", tmp_path / "torn"
    whole.mkdir()
    torn.mkdir()
    journal_with(whole, 0, 1, 2, 3)
    content = (whole / "cycles.jsonl").read_bytes()
    (torn / "cycles.jsonl").write_bytes(content[: int(keep * len(content))])
    journal = take_up(torn, 12, size_of(12))
    for episode in range(4):
        if not journal.finished(episode):
            journal.add(episode, lines_of(episode))
    assert (torn / "cycles.jsonl").read_bytes() == content
    assert {path.name for path in torn.iterdir()} == {"cycles.jsonl"}


def test_an_episode_behind_a_gap_is_not_run_again(tmp_path):
    journal_with(tmp_path, 0, 2)
    journal = take_up(tmp_path, 12, size_of(12))
    assert [journal.finished(episode) for episode in range(4)] == [True, False, True, False]
    journal.add(1, lines_of(1))
    assert written(tmp_path) == list(range(9))


def test_a_run_grows_from_its_last_episode(tmp_path):
    journal = Journal(tmp_path)
    journal.add(0, lines_of(0))
    journal.add(1, lines_of(1, 1))
    journal = take_up(tmp_path, 4, size_of(4))
    assert journal.finished(1)
    journal = take_up(tmp_path, 6, size_of(6))
    assert not journal.finished(1)
    assert written(tmp_path) == [0, 1, 2]


def test_a_run_does_not_shrink(tmp_path):
    journal_with(tmp_path, 0, 1)
    before = (tmp_path / "cycles.jsonl").read_bytes()
    with pytest.raises(BadInput, match="--cycles"):
        take_up(tmp_path, 5, size_of(5))
    assert (tmp_path / "cycles.jsonl").read_bytes() == before
    assert len(list(tmp_path.iterdir())) == 1


@pytest.mark.parametrize("line", ["{", "[1]", '{"cycle": 1}', "7", "null"])
def test_a_line_that_is_no_cycle_in_the_middle_is_refused(tmp_path, line):
    good = json.dumps(lines_of(0, 1)[0])
    (tmp_path / "cycles.jsonl").write_text(f"{line}\n{good}\n")
    with pytest.raises(BadInput, match="line 1"):
        take_up(tmp_path, 12, size_of(12))


def test_what_differs_is_named(tmp_path):
    (tmp_path / "config.json").write_text('{"options": {"mass": 1, "cycles": 5}, "v": {"a": "1"}}')
    check_same(tmp_path, {"options": {"mass": 1, "cycles": 9}, "v": {"a": "1"}})
    for other in ({"mass": 2, "cycles": 5}, {"mass": 1, "cycles": 5, "new": 3}):
        with pytest.raises(BadInput, match=r"--(mass|new) "):
            check_same(tmp_path, {"options": other, "v": {"a": "1"}})
    with pytest.raises(BadInput, match=r"v\.a"):
        check_same(tmp_path, {"options": {"mass": 1}, "v": {"a": "2"}})


@pytest.mark.parametrize("text", ["", "{", "[]", "3"])
def test_a_folder_whose_configuration_is_no_run_is_refused(tmp_path, text):
    (tmp_path / "config.json").write_text(text)
    with pytest.raises(BadInput, match="--resume"):
        check_same(tmp_path, {})


# ---- a full disk and interrupts -------------------------------------------------------------


def test_a_full_disk_leaves_whole_lines(tmp_path, monkeypatch):
    journal = Journal(tmp_path)
    journal.add(0, lines_of(0))
    real = Path.open

    class Full:
        def __init__(self, file):
            self._file, self._left = file, 1

        def __enter__(self):
            return self

        def __exit__(self, *_):
            self._file.close()

        def __getattr__(self, name):
            return getattr(self._file, name)

        def write(self, content):
            if not self._left:
                raise OSError(errno.ENOSPC, "No space left on device")
            self._left -= 1
            return self._file.write(bytes(content[:10]))  # a part of a line still fits

    monkeypatch.setattr(Path, "open", lambda *args, **named: Full(real(*args, **named)))
    with pytest.raises(OSError, match="No space left") as failed:
        journal.add(1, lines_of(1))
    monkeypatch.undo()
    assert failed.value.filename == str(tmp_path / "cycles.jsonl")
    assert written(tmp_path) == [0, 1, 2]


def test_an_interrupt_waits_until_what_is_written_is_whole():
    done = []

    def write() -> None:
        with no_interrupt():
            os.kill(os.getpid(), signal.SIGINT)
            done.append(1)

    before = signal.signal(signal.SIGINT, signal.default_int_handler)  # ignored in the background
    try:
        with pytest.raises(KeyboardInterrupt):
            write()
    finally:
        signal.signal(signal.SIGINT, before)
    assert done == [1]


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_second_interrupt_does_nothing(number):
    before = {each: signal.getsignal(each) for each in (signal.SIGINT, signal.SIGTERM)}
    done = []
    try:
        with one_interrupt():
            try:
                os.kill(os.getpid(), number)
            except KeyboardInterrupt:
                os.kill(os.getpid(), number)
                done.append(1)
        os.kill(os.getpid(), number)
    finally:
        for each, handler in before.items():
            signal.signal(each, handler)
    assert done == [1]


def test_without_an_interrupt_the_handlers_are_those_from_before():
    before = signal.getsignal(signal.SIGTERM)
    with one_interrupt():
        assert signal.getsignal(signal.SIGTERM) != before
    assert signal.getsignal(signal.SIGTERM) == before


@pytest.mark.parametrize("guard", [one_interrupt, no_interrupt])
def test_threads_leave_interrupts_to_the_main_one(guard):
    def handlers() -> list:
        return [signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)]

    seen = []

    def work() -> None:
        with guard():
            seen.append(handlers())

    thread = threading.Thread(target=work)
    thread.start()
    thread.join()
    assert seen == [handlers()]


# ---- names ----------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "name",
    [
        "n" * 300,
        "a/b/" + "n" * 300,
        "a/" * 2050 + "b",
        "a/" * 2020 + "b",
        "file",
        "file/below",
        "file/further/below",
        "nul\0",
    ],
    ids=lambda name: f"{name[:8]}{len(name)}",
)
def test_a_folder_that_cannot_be_made_leaves_nothing_behind(tmp_path, monkeypatch, name):
    monkeypatch.chdir(tmp_path)
    Path("file").write_text("precious")
    with pytest.raises(BadInput, match="--out") as refused:
        new_folder(RunConfig(out=Path(name)))
    assert len(str(refused.value)) < 300
    assert [path.name for path in tmp_path.iterdir()] == ["file"]
    assert Path("file").read_text() == "precious"


def test_a_folder_is_made_with_its_parents(tmp_path):
    out = new_folder(RunConfig(out=tmp_path / "a" / "b"))
    assert (out / "cycles").is_dir()
    assert new_folder(RunConfig(out=out)) == out  # a run that broke off before it began
