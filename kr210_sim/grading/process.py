"""The host's side of a solver's process: start it, ask it in time, end it and all that is its."""

from __future__ import annotations

import contextlib
import json
import os
import re
import selectors
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

import kr210_sim
from kr210_sim.arrays import Array
from kr210_sim.grading.findings import Finding, Refused, Source
from kr210_sim.grading.python2 import read_source
from kr210_sim.grading.source import SolverLimits, SolverSource

KEPT_OUTPUT = 1 << 14
"""Bytes of what a solver prints that are kept; the rest is counted."""

_PROGRAM = "from kr210_sim.grading.child import main; main()"
_LONGEST_LINE = 1 << 20
_CHUNK = 1 << 16

_LOOK = 0.5  # the scratch folder is measured this often [s]
_LOAD_POSES = 10  # loading may take as long as this many poses
_TRACE = re.compile(r'^  File "(?P<file>.*)", line (?P<line>\d+) in', re.MULTILINE)
_PASSED_ON = ("PATH", "LANG", "LC_ALL", "LD_LIBRARY_PATH", "DYLD_LIBRARY_PATH", "SYSTEMROOT")
"""Variables of the environment that a solver sees; tokens and passwords are not among them."""


@dataclass(kw_only=True)
class Answer:
    """What a solver answered to some poses.

    Attributes:
        q: (n, 6) the first n answers [rad], a row of NaN for none.
        seconds: (n,) of each [s].
        finding: why there are no more, or None.
    """

    q: Array
    seconds: Array
    finding: Finding | None = None


class SolverProcess:
    """A solver in a process of its own.

    Attributes:
        form: of the solver, one of `forms.FORMS`, once it is loaded.
        language: "Python 2" or "Python 3".
        kept: what is kept away from it -> by what.
        output: the beginning of what it printed.
        output_bytes: how much it printed.
    """

    given_form = ""  # which it has whatever its signature says

    def __init__(
        self,
        source: SolverSource,
        limits: SolverLimits,
        *,
        joints: Sequence[str] = (),
        time_limit: float | None = None,
    ) -> None:
        """Start it and wait until it is loaded.

        Args:
            source: the file or module.
            limits: what it may use.
            joints: names of the arm's joints, and then of others that stay at zero.
            time_limit: that is left of the limit for all [s].

        Raises:
            Refused: if it cannot be loaded; the process is gone then.
        """
        self.form, self.language, self.kept = "", "", dict[str, str]()
        self.output, self.output_bytes = b"", 0
        self._source, self._limits = source, limits
        self.seconds_left = limits.time_limit if time_limit is None else time_limit
        self._scratch = Path(tempfile.mkdtemp(prefix="kr210-solver-")).resolve()
        self._file = self._copied()
        self._buffer = b""
        self._begin()
        try:
            self._load(joints)
        except BaseException:
            self.close()
            raise

    def ask(self, T: Array, q_start: Array) -> Answer:
        """Ask for the configurations of poses (N, 4, 4), the arm standing at q_start (6,)."""
        rows: list[list[float]] = []
        seconds: list[float] = []
        finding: Finding | None = None
        quaternions = Rotation.from_matrix(T[:, :3, :3]).as_quat(canonical=True)
        request = {
            "T": np.asarray(T, dtype=float).reshape(-1).tolist(),
            "quaternions": quaternions.reshape(-1).tolist(),
            "q_start": np.asarray(q_start, dtype=float).tolist(),
        }
        self._send(request)
        try:
            while True:
                allowed = self._limits.pose_timeout
                allowed *= 1 if self.form == "pose" else max(1, len(T))
                what = f"pose {len(rows)}" if self.form == "pose" else f"{len(T)} poses"
                message = self._receive(allowed, what)
                if message.get("event") != "rows":
                    break
                if (found := _rows(message, len(T) - len(rows))) is None:
                    raise self._lost("its answer is not of the agreed form")
                q, each = found
                rows, seconds = rows + q, seconds + [each] * len(q)
            if message.get("event") == "finding":
                finding = Finding.from_json(message)
            elif len(rows) != len(T):
                raise self._lost("its answer is not of the agreed form")
        except Refused as refused:
            finding = refused.finding
        self._drain_now()
        q_found = np.array(rows, dtype=float).reshape(-1, 6)
        return Answer(q=q_found, seconds=np.array(seconds), finding=finding)

    @property
    def alive(self) -> bool:
        """Whether it can be asked."""
        return self._process.returncode is None

    def close(self) -> None:
        """End the process and all that is its, and remove its folder."""
        self._kill()
        for stream in (self._requests, self._answers, self._traces, self._output):
            with contextlib.suppress(OSError):
                os.close(stream)
        shutil.rmtree(self._scratch, ignore_errors=True)

    # ---- start and end ------------------------------------------------------------------------

    def _copied(self) -> Path | None:
        """Copy the file to the scratch folder: what runs there can not change the user's."""
        if self._source.file is None:
            return None
        copy = self._scratch / self._source.file.name
        shutil.copyfile(self._source.file, copy)
        return copy

    def _begin(self) -> None:
        to_child, self._requests = os.pipe()
        self._answers, from_child = os.pipe()
        self._traces, trace = os.pipe()
        self._output, out = os.pipe()
        theirs = (to_child, from_child, trace)
        try:
            self._process = subprocess.Popen(
                [sys.executable, "-P", "-c", _PROGRAM, *map(str, theirs)],
                stdin=subprocess.DEVNULL,
                stdout=out,
                stderr=out,
                pass_fds=theirs,
                env=self._environment(),
                start_new_session=True,
            )
        finally:
            for descriptor in (*theirs, out):
                os.close(descriptor)
        for descriptor in (self._requests, self._answers, self._traces, self._output):
            os.set_blocking(descriptor, False)

    def _environment(self) -> dict[str, str]:
        ours = str(Path(kr210_sim.__file__).parents[1])
        theirs = os.environ.get("PYTHONPATH", "")
        threads = {f"{name}_NUM_THREADS": "1" for name in ("OPENBLAS", "OMP", "MKL")}
        return (
            {name: os.environ[name] for name in _PASSED_ON if name in os.environ}
            | threads
            | {
                "HOME": str(self._scratch),
                "TMPDIR": str(self._scratch),
                "MPLCONFIGDIR": str(self._scratch),
                "MPLBACKEND": "Agg",
                "PYTHONHASHSEED": "0",
                "PYTHONDONTWRITEBYTECODE": "1",
                "PYTHONPATH": os.pathsep.join(filter(None, (ours, theirs))),
            }
        )

    def _load(self, joints: Sequence[str]) -> None:
        source, limits = self._source, self._limits
        folder = source.file.parent if source.file is not None else Path.cwd()
        self._send(
            {
                "scratch": str(self._scratch),
                "file": str(self._file),
                "module": source.module,
                "function": source.function,
                "form": self.given_form,
                "folders": [str(self._scratch), str(folder)],
                "joints": list(joints),
                "limits": {
                    "memory": limits.memory,
                    "file_size": limits.file_size,
                    "cpu_seconds": int(4 * limits.time_limit) + 60,
                },
            }
        )
        message = self._receive(_LOAD_POSES * limits.pose_timeout, "its own beginning")
        if message.get("event") != "loaded":
            raise Refused(Finding.from_json(message))
        self.form, self.language = str(message.get("form")), str(message.get("language"))
        kept = message.get("kept")
        self.kept = {str(k): str(v) for k, v in kept.items()} if isinstance(kept, dict) else {}

    def _kill(self) -> None:
        if self._process.returncode is None:
            # its session, for systems on which it can start further processes
            with contextlib.suppress(OSError):
                os.killpg(self._process.pid, signal.SIGKILL)
            self._process.kill()
            self._process.wait()

    # ---- messages -----------------------------------------------------------------------------

    def _send(self, message: Any) -> None:
        self._unsent = memoryview(json.dumps(message).encode() + b"\n")

    def _receive(self, allowed: float, what: str) -> dict[str, Any]:
        """Return the next message.

        Args:
            allowed: time for it [s].
            what: it is, for the finding that it did not come.

        Raises:
            Refused: if none comes in time, or the process is gone; it is gone then in any case.
        """
        begun = time.monotonic()
        share = min(allowed, self.seconds_left)
        try:
            for _ in self._pump(begun + share):
                line, newline, rest = self._buffer.partition(b"\n")
                if newline:
                    self._buffer = rest
                    return self._parsed(line)
                if len(self._buffer) > _LONGEST_LINE:
                    raise self._lost("its answer is far too long")
        finally:
            self.seconds_left -= time.monotonic() - begun
        line_number = self._where()
        limit = "pose-timeout" if share == allowed else "time-limit"
        detail = f"no answer to {what} within {max(0.0, share):.3g} s (--{limit})"
        raise self._lost(detail, kind="timeout", line=line_number)

    def _parsed(self, line: bytes) -> dict[str, Any]:
        try:
            message = json.loads(line)
        except (ValueError, RecursionError):
            message = None
        if not isinstance(message, dict):
            raise self._lost("its answer is not of the agreed form")
        return message

    def _pump(self, deadline: float) -> Iterator[None]:
        """Move bytes until a deadline; yield whenever some arrived on the channel."""
        yield
        measured = time.monotonic()
        with selectors.DefaultSelector() as ready:
            ready.register(self._answers, selectors.EVENT_READ)
            ready.register(self._output, selectors.EVENT_READ)
            if self._unsent:
                ready.register(self._requests, selectors.EVENT_WRITE)
            while (now := time.monotonic()) < deadline:
                if now - measured > _LOOK:
                    measured = now
                    if _size(self._scratch) > self._limits.scratch_size:
                        raise self._lost("it wrote more to its folder than it may")
                for key, _ in ready.select(min(_LOOK, deadline - now)):
                    if key.fd == self._requests:
                        if self._write():
                            ready.unregister(self._requests)
                    elif key.fd == self._output:
                        if not self._drain():
                            ready.unregister(self._output)
                    else:
                        content = os.read(self._answers, _CHUNK)
                        if not content:
                            raise self._ended()
                        self._buffer += content
                        yield

    def _write(self) -> bool:
        """Write what fits; tell whether nothing is left."""
        try:
            self._unsent = self._unsent[os.write(self._requests, self._unsent) :]
        except BrokenPipeError:
            self._unsent = memoryview(b"")
        return not self._unsent

    def _drain(self) -> bool:
        """Take what was printed and keep its beginning; tell whether there may be more."""
        content = os.read(self._output, _CHUNK)
        self.output_bytes += len(content)
        self.output += content[: max(0, KEPT_OUTPUT - len(self.output))]
        return bool(content)

    def _drain_now(self) -> None:
        """Take what was printed by now, up to a bound."""
        with contextlib.suppress(BlockingIOError):
            for _ in range(64):
                if not self._drain():
                    return

    # ---- what became of it --------------------------------------------------------------------

    def _lost(self, detail: str, *, kind: str = "died", line: int | None = None) -> Refused:
        self._kill()
        source = None if line is None else self._line(line)
        return Refused(Finding(kind=kind, detail=detail, line=line, source=source))

    def _ended(self) -> Refused:
        """Return the finding for a process that closed its channel."""
        with contextlib.suppress(subprocess.TimeoutExpired):
            self._process.wait(timeout=1.0)
        code = self._process.returncode
        if code is None:
            how = "it closed the channel to its judge"
        elif code < 0:
            how = f"its process was ended by signal {-code} ({_signal_name(-code)})"
        else:
            how = f"its process ended itself with status {code}"
        return self._lost(how, line=self._last_trace())

    def _where(self) -> int | None:
        """Ask a process that hangs where it is."""
        with contextlib.suppress(OSError):
            self._process.send_signal(signal.SIGUSR1)
            with selectors.DefaultSelector() as ready:
                ready.register(self._traces, selectors.EVENT_READ)
                if ready.select(1.0):
                    time.sleep(0.05)  # the trace comes in several pieces
        return self._last_trace()

    def _last_trace(self) -> int | None:
        try:
            text = os.read(self._traces, _CHUNK).decode("utf-8", "replace")
        except OSError:
            return None
        for found in _TRACE.finditer(text):  # the innermost comes first
            if self._file is not None and found["file"] == str(self._file):
                return int(found["line"])
        return None

    def _line(self, number: int) -> str | None:
        file = self._source.file
        return Source(file, read_source(file.read_bytes())).line(number) if file else None


def _rows(message: dict[str, Any], most: int) -> tuple[list[list[float]], float] | None:
    """Return the rows of a message that is not trusted, and the time of each; None without."""
    rows, seconds = message.get("q"), message.get("seconds")
    if not (isinstance(rows, list) and len(rows) <= most and isinstance(seconds, int | float)):
        return None
    if not all(isinstance(row, list) and len(row) == 6 for row in rows):
        return None
    if not all(isinstance(value, int | float) for row in rows for value in row):
        return None
    try:
        return [[float(value) for value in row] for row in rows], float(seconds)
    except OverflowError:
        return None


def _size(folder: Path) -> int:
    total = 0
    for root, _, names in os.walk(folder):
        for name in names:
            with contextlib.suppress(OSError):
                total += os.lstat(os.path.join(root, name)).st_size
    return total


def _signal_name(number: int) -> str:
    try:
        return signal.Signals(number).name
    except ValueError:
        return "unknown"
