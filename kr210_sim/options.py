"""Options of a run in other forms: read from the file of --config, written as a command."""

from __future__ import annotations

import json
import tomllib
from collections.abc import Collection, Mapping
from pathlib import Path
from typing import Any

from kr210_sim.config import RunConfig
from kr210_sim.exceptions import BadInput
from kr210_sim.kinds import of_kind

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
            found[name] = of_kind(f"--config: {path}: {key}", value, known[name][1]["kind"])
    return found


def _parse(path: Path) -> dict[str, Any]:
    try:
        text = path.read_text(encoding="utf-8")
        content = tomllib.loads(text) if path.suffix == ".toml" else json.loads(text)
    except OSError as error:
        why = f"cannot be read ({error.strerror})"
        raise BadInput(f"--config: {path} {why}; give a .toml or .json file") from error
    except (ValueError, RecursionError) as error:
        form = "TOML" if path.suffix == ".toml" else "JSON"
        raise BadInput(
            f"--config: {path} is not {form} ({error}); correct it, or give a .toml or .json file"
        ) from error
    if not isinstance(content, dict):
        raise BadInput(f"--config: {path}: give an object of option names and values")
    return content
