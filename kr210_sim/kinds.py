"""A value given for an option -> what its field holds, or what is wrong with it."""

from __future__ import annotations

import os
from numbers import Integral, Real
from pathlib import Path
from typing import Any

from kr210_sim.exceptions import BadInput

_WANTED = {
    int: "a whole number",
    float: "a number",
    bool: "true or false",
    tuple: "a list of texts",
}


def of_kind(where: str, value: Any, kind: type) -> Any:
    """Return a value as the kind of its option.

    Args:
        where: the option, for messages.
        value: as given in a script or a file; a text may be given as a whole number (cell = 5).
        kind: int, float, str, bool, Path or tuple, of texts.

    Raises:
        BadInput: if the value is of another kind.
    """
    if kind is bool:
        if isinstance(value, bool):
            return value
    elif not isinstance(value, bool):
        if kind is float and isinstance(value, Real):
            return _float(where, value)
        if kind is int and isinstance(value, Integral):
            return int(value)
        if kind is str and isinstance(value, str | Integral):
            return str(value)
        if kind is Path and isinstance(value, str | os.PathLike) and "\0" not in str(value):
            return Path(value)
        if kind is tuple and isinstance(value, list | tuple):
            if all(isinstance(each, str) for each in value):
                return tuple(value)
    raise BadInput(f"{where}: {value!r:.60} is not {_WANTED.get(kind, 'a text')}")


def _float(where: str, value: Real) -> float:
    try:
        return float(value)
    except OverflowError as error:
        raise BadInput(f"{where}: the number is too large") from error
