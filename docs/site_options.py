"""For mkdocs: RunConfig's part of the API lists its options, from their defaults and help texts."""

from __future__ import annotations

import ast
import html
from typing import Any

from griffe import AliasResolutionError, Class, ExprCall, Extension


class Options(Extension):
    """Writes what `_option(default, help, ...)` says of each field into the class's docstring."""

    def on_package(self, *, pkg: Any, **_: Any) -> None:
        """Complete RunConfig once all names that it uses are known."""
        if pkg.name == "kr210_sim":
            config = pkg["config.RunConfig"]
            first, rest = config.docstring.value.split("\n\n", 1)
            options = "\n".join(_lines(config))
            config.docstring.value = f"{first}\n\nAttributes:\n{options}\n\n{rest}"


def _lines(config: Class) -> list[str]:
    found = []
    for name, field in config.attributes.items():
        if isinstance(field.value, ExprCall) and str(field.value.function) == "_option":
            default, text = (str(argument) for argument in field.value.arguments[:2])
            said = html.escape(ast.literal_eval(text), quote=False)
            if "default" not in said and (value := _value(config, default)):
                said += f"; default `{value}`"
            found.append(f"    {name}: {said}.")
    return found


def _value(config: Class, default: str) -> str:
    """Return a default as it is written, that of a constant for its name; else nothing."""
    if default not in config.parent.members:
        return default
    try:
        return str(config.parent[default].value)
    except AliasResolutionError:  # one of several that are assigned together
        return ""
