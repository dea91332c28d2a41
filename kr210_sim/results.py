"""The folder of a run: what is written when, and how a run that broke off is taken up again."""

from __future__ import annotations

import errno
import json
import os
import shutil
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from kr210_sim.config import FREE, RunConfig
from kr210_sim.exceptions import BadInput
from kr210_sim.interrupts import no_interrupt

CYCLES = "cycles.jsonl"
CONFIG = "config.json"
SUMMARY = "summary.json"
RECORDS = "cycles"
WORLDS = "episodes"
_PART = ".part"
"""Ending of a file that takes the name of another once it is complete."""

_LONGEST_NAME = "episodes/0000/assets/" + "m" * 60
"""A name of about the length of the longest that a run writes."""


@contextmanager
def named(path: Path) -> Iterator[None]:
    """Let an OSError that does not say which file it means say so."""
    try:
        yield
    except OSError as error:
        if error.filename is not None:
            raise
        raise OSError(error.errno or errno.EIO, error.strerror or str(error), str(path)) from error


def write_json(path: Path, content: Mapping[str, Any]) -> None:
    """Write a JSON file whole or not at all."""
    write_text(path, json.dumps(content, indent=2, allow_nan=False) + "\n")


def write_text(path: Path, text: str) -> None:
    """Write a text file whole or not at all; of a file name that is no text, the escaped bytes."""
    part = path.with_name(path.name + _PART)
    with named(path), no_interrupt():
        try:
            part.write_text(text, encoding="utf-8", errors="backslashreplace")
            part.replace(path)
        except OSError:
            part.unlink(missing_ok=True)
            raise


def read_lines(out: Path) -> Iterator[dict[str, Any]]:
    """Yield the cycles of a run; none if it has no cycles yet."""
    path = out / CYCLES
    if path.exists():
        with path.open(encoding="utf-8") as lines:
            yield from map(json.loads, lines)


def finished_cycles(out: Path, cycle: int | None = None) -> list[dict[str, Any]]:
    """Return the cycles of a finished run, of which there is at least one.

    Args:
        out: folder of the run.
        cycle: one that must be among them.

    Raises:
        BadInput: naming what is missing or damaged.
    """
    try:
        lines = list(read_lines(out))
        cycles = [int(line["cycle"]) for line in lines]
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise BadInput(f"{out}: {CYCLES} is damaged; run the cycles again") from error
    if not cycles:
        raise BadInput(f"{out} is no folder of a run; name one with a {CYCLES}")
    if cycle is not None and cycle not in cycles:
        raise BadInput(f"--cycle: {out} has no cycle {cycle}; give {cycles[0]} to {cycles[-1]}")
    return lines


def record_path(out: Path, cycle: int) -> Path:
    """Return the file of a cycle's record."""
    return out / RECORDS / f"{cycle:04d}.npz"


def world_path(out: Path, episode: int) -> Path:
    """Return the file of an episode's world."""
    return out / WORLDS / f"{episode:04d}" / "scene.xml"


def drop_files(out: Path, *, episode: int, cycle: int) -> None:
    """Remove records and worlds from an episode and its first cycle on; nobody needs them."""
    for path in (out / RECORDS).glob("*.npz"):
        if int(path.stem) >= cycle:
            path.unlink()
    for folder in (out / WORLDS).glob("*"):
        if int(folder.name) >= episode:
            shutil.rmtree(folder)


class Journal:
    """`cycles.jsonl`, appended an episode at a time in cycle order, whatever finishes first.

    Args:
        out: folder of the run.
        first: index of the first episode that is not written yet.
        waiting: lines of later episodes that are finished, by index.

    Attributes:
        next: index of the first episode that is not written.
        enough: asked, with the cycles of each episode as it is written, whether none is needed
            after it.
        ended: whether that was so; nothing is written any more then.
    """

    def __init__(
        self, out: Path, *, first: int = 0, waiting: dict[int, list[str]] | None = None
    ) -> None:
        self._path = out / CYCLES
        self.next = first
        self._waiting = waiting or {}
        self.enough: Callable[[list[dict[str, Any]]], bool] = lambda lines: False
        self.ended = False

    def finished(self, episode: int) -> bool:
        """Tell whether an episode needs not be run."""
        return self.ended or episode < self.next or episode in self._waiting

    def add(self, episode: int, lines: Sequence[Mapping[str, Any]]) -> list[dict[str, Any]]:
        """Take the cycles of an episode; return those that are written now.

        Raises:
            OSError: if they cannot be written; the file ends with whole lines all the same.
        """
        if not lines:
            return []
        self._waiting[episode] = [json.dumps(line, allow_nan=False) + "\n" for line in lines]
        written: list[dict[str, Any]] = []
        with no_interrupt():
            while self.next in self._waiting and not self.ended:
                self._append(self._waiting[self.next])
                fresh = [json.loads(line) for line in self._waiting.pop(self.next)]
                written += fresh
                self.next += 1
                self.ended = self.enough(fresh)
        return written

    def close(self) -> None:
        """Write what waits for an episode that will not be finished now, if it is needed."""
        with no_interrupt():
            for episode in sorted(self._waiting) if not self.ended else ():
                self._append(self._waiting.pop(episode))

    def _append(self, lines: Sequence[str]) -> None:
        with named(self._path), self._path.open("ab", buffering=0) as file:
            size = os.fstat(file.fileno()).st_size
            content = memoryview("".join(lines).encode())
            try:
                while content:
                    content = content[file.write(content) :]
            except OSError:
                file.truncate(size)
                raise


# ---- a new run ------------------------------------------------------------------------------


def new_folder(config: RunConfig) -> Path:
    """Return the folder of the results, empty.

    Raises:
        BadInput: if it is not empty or cannot be written; nothing is left behind then.
    """
    stamp = time.strftime("%Y%m%d-%H%M%S")
    out = config.out or _unused(Path("runs") / f"{stamp}-seed{config.seed}")
    made: list[Path] = []
    try:
        if out.exists() and (not out.is_dir() or not is_unused(out)):
            raise BadInput(
                f"--out: {out} is no empty folder; name one that does not exist yet, or go on "
                "with the run in it by --resume"
            )
        with suppress(FileNotFoundError):
            (out / _LONGEST_NAME).stat()  # raises where the names of a run would be too long
        for folder in (*reversed(out.parents), out, out / RECORDS):
            if not folder.exists():
                folder.mkdir()
                made.append(folder)
        if not os.access(out / RECORDS, os.W_OK):
            raise PermissionError(errno.EACCES, "permission denied")
    except (OSError, ValueError) as error:
        for folder in reversed(made):
            folder.rmdir()
        reason = error.strerror if isinstance(error, OSError) else error
        raise BadInput(
            f"--out: {_short(out)} cannot be written ({reason}); name another"
        ) from error
    return out


def is_unused(out: Path) -> bool:
    """Tell whether a folder holds nothing of a run, or a run that broke off before it began."""
    unused = {RECORDS, CONFIG + _PART}
    return all(path.name in unused for path in out.iterdir()) and not any(out.glob("cycles/*"))


def _short(path: Path) -> str:
    text = str(path)
    return text if len(text) <= 120 else f"{text[:50]}...{text[-50:]}"


def _unused(folder: Path) -> Path:
    """Return the folder, or the first of its numbered namesakes that does not exist."""
    path, number = folder, 2
    while path.exists():
        path, number = folder.with_name(f"{folder.name}-{number}"), number + 1
    return path


# ---- a run that is taken up again -----------------------------------------------------------


def check_same(out: Path, provenance: Mapping[str, Any]) -> None:
    """Refuse to go on with a run that another configuration, world or version began.

    Raises:
        BadInput: naming what differs.
    """
    try:
        before = json.loads((out / CONFIG).read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise BadInput(f"--resume: {out / CONFIG} cannot be read: {error}") from error
    if not isinstance(before, dict):
        raise BadInput(f"--resume: {out / CONFIG} is not the configuration of a run")
    now = json.loads(json.dumps(provenance))
    for name in sorted(_flat(before).keys() | _flat(now).keys()):
        was, is_ = _flat(before).get(name), _flat(now).get(name)
        if was != is_ and name.removeprefix("options.") not in FREE:
            raise BadInput(
                f"--resume: {out} began with {_called(name)} {was}, now it is {is_}; give what it "
                f"began with, as by --config {out / CONFIG}, or another --out"
            )


def _called(name: str) -> str:
    """Return what the user calls an entry of the configuration."""
    option = name.removeprefix("options.")
    return name if option == name else "--" + option.replace("_", "-")


def _flat(content: Mapping[str, Any], prefix: str = "") -> dict[str, Any]:
    found: dict[str, Any] = {}
    for name, value in content.items():
        if isinstance(value, dict):
            found |= _flat(value, f"{prefix}{name}.")
        else:
            found[prefix + name] = value
    return found


def take_up(out: Path, cycles: int, size_of: Callable[[int], int]) -> Journal:
    """Keep the finished episodes of `cycles.jsonl`, drop the rest, and return what goes on.

    Args:
        out: folder of the run.
        cycles: number of cycles it shall have.
        size_of: number of cycles of an episode, by index.

    Raises:
        BadInput: if the file is not that of a run, or has more cycles.
    """
    path, part = out / CYCLES, out / (CYCLES + _PART)
    if not path.exists():
        return Journal(out)
    waiting: dict[int, list[str]] = {}
    first, current = 0, list[str]()
    with no_interrupt(), named(part), part.open("w", encoding="utf-8") as kept:
        try:
            for line, text in _whole_lines(path):
                if line["cycle"] >= cycles:
                    raise BadInput(f"--cycles: {out} has more already; give the number it has")
                current = waiting.setdefault(line["episode"], [])
                current.append(text)
                while len(waiting.get(first, ())) == size_of(first) > 0:
                    kept.writelines(waiting.pop(first))
                    first += 1
        except BaseException:
            part.unlink()
            raise
    part.replace(path)
    complete = {index: kept for index, kept in waiting.items() if len(kept) == size_of(index)}
    return Journal(out, first=first, waiting=complete)


def _whole_lines(path: Path) -> Iterator[tuple[dict[str, Any], str]]:
    """Yield the lines as objects and as they stand; a torn last one is left out."""
    with path.open("rb") as lines:
        torn = None
        for number, raw in enumerate(lines, start=1):
            if torn is not None:
                raise BadInput(f"--resume: {path}: line {torn} is not that of a cycle")
            try:
                text = raw.decode()
                line = json.loads(text)
                whole = text.endswith("\n") and isinstance(line, dict)
                whole = whole and {"cycle", "episode"} <= line.keys()
            except ValueError:
                whole = False
            if whole:
                yield line, text
            else:
                torn = number
