"""xacro -> URDF text, in a process of its own, so that no file can use more than is allowed.

A xacro holds Python expressions: one of them may loop, or fill the memory, inside a single call
that no signal interrupts. The parent therefore waits for a limited time, and the child limits its
own memory and processor time.
"""

from __future__ import annotations

import builtins
import contextlib
import importlib
import json
import os
import signal
import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from kr210_sim.exceptions import BadInput
from kr210_sim.packages import Packages
from kr210_sim.safe_xml import MAX_XML_BYTES, check_xml

TIME_LIMIT = 6
"""Longest expansion [s of the processor, where the system can limit it]; large public descriptions
take a few tenths."""

WAIT_LIMIT = 60.0
"""Longest wait for it on a busy machine [s]."""

MEMORY_LIMIT = 1 << 30
"""Address space of the expanding process [bytes], where the system can limit it."""


def expand_xacro(path: Path, packages: Packages, arguments: Mapping[str, str]) -> str:
    """Return the URDF text of a xacro file.

    Args:
        path: the file.
        packages: answers `$(find NAME)`, and which files may be included.
        arguments: values of `<xacro:arg>` by name.

    Raises:
        BadInput: if it does not expand, or not within the limits.
    """
    request = {
        "file": str(path),
        "named": {name: str(folder) for name, folder in packages.named.items()},
        "search": [str(folder) for folder in packages.search],
        "arguments": dict(arguments),
    }
    try:
        done = subprocess.run(
            [sys.executable, "-m", "kr210_sim.expand"],
            input=json.dumps(request).encode(),
            capture_output=True,
            timeout=WAIT_LIMIT,
            env=os.environ | {"PYTHONPATH": os.pathsep.join(sys.path)},
            check=False,
        )
        if done.returncode == -getattr(signal, "SIGXCPU", 0):
            raise subprocess.TimeoutExpired(done.args, TIME_LIMIT)
        answer: dict[str, str] = json.loads(done.stdout)
    except subprocess.TimeoutExpired as error:
        raise BadInput(
            f"{path}: xacro does not come to an end within {error.timeout:g} s; correct the file"
        ) from error
    except ValueError as error:  # no answer: the system ended the process
        raise BadInput(
            f"{path}: xacro needs more than {MEMORY_LIMIT >> 20} MB of memory or nests too deep; "
            "correct the file"
        ) from error
    if "error" in answer:
        raise BadInput(
            f"{path}: xacro cannot expand it ({answer['error']}); correct the file, or give a "
            "missing argument by --xacro-arg NAME=VALUE"
        )
    return answer["text"]


def _main() -> None:
    """Answer one request from stdin on stdout."""
    with contextlib.suppress(ImportError, OSError, ValueError):
        resource = importlib.import_module("resource")  # absent on Windows
        resource.setrlimit(resource.RLIMIT_AS, (MEMORY_LIMIT, MEMORY_LIMIT))
        resource.setrlimit(resource.RLIMIT_CPU, (TIME_LIMIT, TIME_LIMIT + 1))
    request = json.load(sys.stdin)
    with contextlib.redirect_stdout(None):  # xacro's own messages
        try:
            answer = {"text": _expand(request)}
        except Exception as error:  # expressions may raise anything
            answer = {"error": _reason(error)}
    json.dump(answer, sys.stdout)


def _reason(error: BaseException) -> str:
    """Say what went wrong in one line; xacro wraps what an expression raises."""
    inner: BaseException | None = error
    while inner is not None:
        if isinstance(inner, MemoryError):
            return f"it needs more than {MEMORY_LIMIT >> 20} MB of memory"
        inner = getattr(inner, "exc", None) or inner.__cause__ or inner.__context__
    return " ".join(str(error).split()) or type(error).__name__


def _expand(request: dict[str, Any]) -> str:
    import xacro
    from xacro import substitution_args

    packages = Packages(
        Path(request["file"]),
        {name: Path(folder) for name, folder in request["named"].items()},
        tuple(Path(folder) for folder in request["search"]),
    )

    def guarded_open(filename: str, *_: object) -> Any:
        path = packages.inside(Path(os.path.abspath(filename)), filename, where="include")
        if path.stat().st_size > MAX_XML_BYTES:
            raise BadInput(f"include '{filename}' is larger than {MAX_XML_BYTES / 1e6:.0f} MB")
        if path.suffix not in (".yaml", ".yml"):
            check_xml(path.read_bytes(), path.name)
        return builtins.open(path, encoding="utf-8")

    def find(name: str) -> str:
        return str(packages.find(name))

    xacro.open = guarded_open  # what xacro reads files with
    substitution_args._eval_find = find
    substitution_args._eval_dict["find"] = find
    document = xacro.process_file(request["file"], mappings=request["arguments"])
    text = str(document.toprettyxml(indent="  "))
    if len(text) > MAX_XML_BYTES:
        raise BadInput(f"the result is larger than {MAX_XML_BYTES / 1e6:.0f} MB")
    return text


if __name__ == "__main__":
    _main()
