"""The process in which foreign code runs: loads it, answers requests on a channel of its own."""

from __future__ import annotations

import faulthandler
import importlib
import json
import os
import signal
import sys
import threading
import warnings
from collections.abc import Callable
from pathlib import Path
from types import ModuleType
from typing import Any, NoReturn

import numpy as np

from kr210_sim.grading import python2
from kr210_sim.grading.confine import confine
from kr210_sim.grading.findings import Finding, Refused, Source
from kr210_sim.grading.forms import Caller, recognise
from kr210_sim.grading.stand_ins.install import install
from kr210_sim.grading.stand_ins.rospy import world

HANDLERS = ("handle_calculate_IK", "calculate_ik", "solve", "solve_ik", "inverse_kinematics")
"""Names of the function that answers, where a file offers no service; the course's comes first."""

_NO_FISSIX = "Python 2 needs fissix; python -m pip install 'kr210-sim[grade]'"


class _Channel:
    """Lines of JSON to and from the host, on descriptors that no print reaches."""

    def __init__(self, requests: int, answers: int) -> None:
        self._requests = os.fdopen(requests, "rb")
        self._answers = os.fdopen(answers, "wb", buffering=0)

    def read(self) -> Any:
        """Return the next message, None when the host has gone."""
        line = self._requests.readline()
        return json.loads(line) if line else None

    def write(self, **message: Any) -> None:
        content = memoryview(json.dumps(message).encode() + b"\n")
        while content:
            content = content[self._answers.write(content) :]


def main() -> NoReturn:
    """Serve a solver until the host has gone; arguments are the descriptors."""
    requests, answers, traces = map(int, sys.argv[1:4])
    sys.argv = ["solver"]
    channel = _Channel(requests, answers)
    task = channel.read()
    faulthandler.enable(file=traces, all_threads=False)
    faulthandler.register(signal.SIGUSR1, file=traces, all_threads=False)
    scratch = Path(task["scratch"])
    os.chdir(scratch)
    warnings.simplefilter("ignore")
    install()
    # a stack of many megabytes for the main thread's recursion is not ours to give
    sys.setrecursionlimit(3000)
    kept = confine(scratch=scratch, **task["limits"])
    server = _Server(channel, task, kept)
    world.serve = server.serve
    try:
        server.load()
        server.serve()
    except Refused as refused:
        channel.write(event="finding", **refused.finding.as_json())
    _end()


def _end() -> NoReturn:
    _flush()
    os._exit(0)


def _flush() -> None:
    for stream in (sys.stdout, sys.stderr):
        try:
            stream.flush()
        except (OSError, ValueError, AttributeError):  # foreign code may have closed it
            continue


class _Server:
    """A solver and what it is asked."""

    def __init__(self, channel: _Channel, task: Any, kept: dict[str, str]) -> None:
        self._channel, self._task, self._kept = channel, task, kept
        self._function: str | None = task["function"]
        self._module: dict[str, Any] = {}
        self._source = Source(Path("?"), "")
        self._is_python2 = False

    def load(self) -> None:
        """Run the file or import the module.

        Raises:
            Refused: if it fails.
        """
        world.joints = dict.fromkeys(self._task["joints"], 0.0)
        sys.path += self._task["folders"]
        if self._task["module"] is not None:
            self._import(self._task["module"])
        else:
            self._run(Path(self._task["file"]))

    def _import(self, name: str) -> None:
        try:
            module = importlib.import_module(name)
        except BaseException as error:
            raise Refused(self._source.raised(error)) from error
        self._module = vars(module)
        path = Path(getattr(module, "__file__", None) or "?")
        is_text = path.suffix == ".py" and path.is_file()
        text = path.read_text(encoding="utf-8", errors="replace") if is_text else ""
        self._source = Source(path, text)

    def _run(self, path: Path) -> None:
        text = python2.read_source(path.read_bytes())
        self._source = Source(path, text)
        self._is_python2 = python2.is_python2(text)
        module = ModuleType("__main__")
        self._module = vars(module)
        self._module["__file__"] = str(path)
        # A named function is taken from the file as a module; else the file is run as a program.
        if self._function is not None:
            self._module["__name__"] = path.stem
        sys.modules[self._module["__name__"]] = module
        try:
            exec(self._compile(text, str(path)), self._module)
        except Refused:
            raise
        except BaseException as error:
            raise Refused(self._source.raised(error)) from error

    def _compile(self, text: str, path: str) -> Any:
        if not self._is_python2:
            return compile(text, path, "exec", dont_inherit=True)
        try:
            converted = python2.to_python3(text)
        except ModuleNotFoundError as error:
            raise Refused(self._without_fissix(text)) from error
        self._module.update(python2.builtins2())
        for old, new in python2.MODULES.items():
            sys.modules[old] = importlib.import_module(new)
        return python2.compile_python2(converted, path)

    def _without_fissix(self, text: str) -> Finding:
        """Return the finding for a file that is Python 2, or Python 3 with a mistake in it."""
        wrong = python2.python3_error(text)
        if wrong is None:
            return Finding(kind="import", detail=_NO_FISSIX)
        detail = f"no Python 3: {wrong.msg}. If it is Python 2: {_NO_FISSIX}"
        source = self._source.line(wrong.lineno)
        return Finding(kind="import", detail=detail, line=wrong.lineno, source=source)

    def _solver(self) -> Callable[..., Any]:
        """Return the function to ask: the one named, that of the service, that of the course."""
        if self._function is None and world.services:
            ours = [entry for entry in world.services if "calculate_ik" in entry[0].lower()]
            handler = (ours or world.services)[-1][2]
            return handler
        found: Any = None
        for name in (self._function,) if self._function else HANDLERS:
            first, *parts = name.split(".")
            found = self._module.get(first)
            for part in parts:
                found = getattr(found, part, None)
            if found is not None:
                break
        else:
            offered = [
                key
                for key, value in self._module.items()
                if callable(value)
                and getattr(value, "__module__", None) == self._module.get("__name__")
            ]
            name = self._function or f"{', '.join(HANDLERS[:-1])} or {HANDLERS[-1]}"
            detail = (
                f"there is no function {name}; it has {', '.join(sorted(offered)[:8]) or 'none'}"
            )
            if offered and not self._function:
                detail += ": name the one to ask as FILE.py:FUNC"
            raise Refused(Finding(kind="not_found", detail=detail))
        return found  # type: ignore[no-any-return]

    def serve(self) -> NoReturn:
        """Answer requests until the host has gone; the solver may never see the end of this."""
        if threading.current_thread() is not threading.main_thread():
            threading.Event().wait()
        try:
            solver = self._solver()
            form = self._task["form"] or recognise(solver)
        except Refused as refused:
            self._channel.write(event="finding", **refused.finding.as_json())
            _end()
        caller = Caller(solver, form, self._source)
        language = "Python 2" if self._is_python2 else "Python 3"
        self._channel.write(event="loaded", form=form, kept=self._kept, language=language)
        while (request := self._channel.read()) is not None:
            if "arguments" in request:
                self._answer_exercise(caller, request["arguments"])
            else:
                self._answer(caller, request)
        _end()

    def _answer_exercise(self, caller: Caller, arguments: Any) -> None:
        try:
            message = {"event": "values", "values": caller.values(arguments)}
        except Refused as refused:
            message = {"event": "finding", **refused.finding.as_json()}
        _flush()  # what was printed is there before the answer
        self._channel.write(**message)

    def _answer(self, caller: Caller, request: Any) -> None:
        T = np.array(request["T"]).reshape(-1, 4, 4)
        quaternions = np.array(request["quaternions"]).reshape(-1, 4)
        q_start = np.array(request["q_start"])
        world.joints = dict(zip(self._task["joints"], request["q_start"], strict=False)) | {
            name: 0.0 for name in self._task["joints"][6:]
        }
        world.handling = True
        try:
            for answered in caller.ask(T, quaternions, q_start):
                self._channel.write(event="rows", q=answered.q, seconds=answered.seconds)
            _flush()
            self._channel.write(event="done")
        except Refused as refused:
            _flush()
            self._channel.write(event="finding", **refused.finding.as_json())
        finally:
            world.handling = False


if __name__ == "__main__":
    main()
