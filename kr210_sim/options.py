"""Options of a run in other forms: read from the file of --config, written as a command."""

from __future__ import annotations

import json
import tomllib
from collections.abc import Collection, Mapping
from pathlib import Path
from typing import Any

from kr210_sim.config import RunConfig
from kr210_sim.exceptions import BadInput

_OF_ITS_RUN = ("out", "resume")
"""What the config.json of a run says of that run alone."""


def is_default(name: str, value: Any) -> bool:
    """Return whether a value, a plain JSON one, is the default of an option of run."""
    default = RunConfig.metadata()[name][0]
    return bool(value == default or (isinstance(value, list) and tuple(value) == default))


def command_words(options: Mapping[str, Any], left_out: Collection[str]) -> list[str]:
    """Return the words of the command that runs with some options; defaults are not written.

    Args:
        options: values by field name of RunConfig, plain JSON ones; others are left out.
        left_out: names of those that shall not be written.
    """
    words = ["kr210-sim", "run"]
    for name in RunConfig.metadata():
        value = options.get(name)
        if name not in options or name in left_out or is_default(name, value):
            continue
        option = "--" + name.replace("_", "-")
        if isinstance(value, bool):
            words.append(option)
            continue
        for each in value if isinstance(value, list | tuple) else (value,):
            text = str(each)
            words += [f"{option}={text}"] if text.startswith("-") else [option, text]
    return words


def read_options(path: Path) -> dict[str, Any]:
    """Return the options that a file gives, by field name of RunConfig.

    The file is JSON, or TOML if its name ends so; the `config.json` of a run is one, too.

    Raises:
        BadInput: if it cannot be read, or naming the key that is no option or has a wrong value.
    """
    content = _parse(path)
    if isinstance(content.get("options"), dict) and "schema_version" in content:
        content = {
            name: value for name, value in content["options"].items() if name not in _OF_ITS_RUN
        }
    known = RunConfig.metadata()
    found: dict[str, Any] = {}
    for key, value in content.items():
        name = key.replace("-", "_")
        if name not in known:
            raise BadInput(f"--config: {path}: '{key}' is no option of run; see run --help")
        if name in found:
            raise BadInput(f"--config: {path}: '{key}' stands there twice")
        if value is not None:
            found[name] = _value(path, key, value, known[name][1]["kind"])
    return found


def _parse(path: Path) -> dict[str, Any]:
    try:
        text = path.read_text(encoding="utf-8")
        content = tomllib.loads(text) if path.suffix == ".toml" else json.loads(text)
    except OSError as error:
        raise BadInput(f"--config: {path} cannot be read ({error.strerror})") from error
    except (ValueError, RecursionError) as error:
        form = "TOML" if path.suffix == ".toml" else "JSON"
        raise BadInput(f"--config: {path} is not {form}: {error}") from error
    if not isinstance(content, dict):
        raise BadInput(f"--config: {path}: give an object of option names and values")
    return content


def _value(path: Path, key: str, value: Any, kind: type) -> Any:
    """Return a value as the kind of its option, which a file must give as it is."""
    wanted = {int: "a whole number", float: "a number", bool: "true or false", tuple: "a list"}
    if kind is bool and isinstance(value, bool):
        return value
    if not isinstance(value, bool):
        if kind is float and isinstance(value, int | float):
            return _float(path, key, value)
        if kind is int and isinstance(value, int):
            return value
        if kind is str and isinstance(value, str | int):  # cell = 5
            return str(value)
        if kind is Path and isinstance(value, str) and "\0" not in value:
            return Path(value)
        if kind is tuple and isinstance(value, list) and all(isinstance(x, str) for x in value):
            return tuple(value)
    raise BadInput(f"--config: {path}: {key}: {value!r:.60} is not {wanted.get(kind, 'a text')}")


def _float(path: Path, key: str, value: float) -> float:
    try:
        return float(value)
    except OverflowError as error:
        raise BadInput(f"--config: {path}: {key}: the number is too large") from error
