"""What to do about a mistake: the advice of `docs/diagnoses.md`, for reports."""

from __future__ import annotations

import re
from dataclasses import dataclass
from functools import lru_cache

from kr210_sim.resources import resource

_SECTION = re.compile(r"^## (\w+)$", re.MULTILINE)
_ADVICE = re.compile(r"\*See it:\*(?P<see>.*?)\*Do:\*(?P<do>.*)", re.DOTALL)


@dataclass(frozen=True, kw_only=True)
class Advice:
    """How a mistake shows and what to do; code stands between backticks.

    Attributes:
        see: how to see it, in sentences.
        do: what to do, in sentences.
    """

    see: str
    do: str


def advice(key: str) -> Advice | None:
    """Return the advice about a diagnosis by its key, None if there is none."""
    return _advice().get(key)


@lru_cache(maxsize=1)
def _advice() -> dict[str, Advice]:
    _, *parts = _SECTION.split(resource("docs", "diagnoses.md").read_text(encoding="utf-8"))
    found = {}
    for key, text in zip(parts[::2], parts[1::2], strict=True):
        if match := _ADVICE.search(text):
            see, do = (" ".join(match[name].split()) for name in ("see", "do"))
            found[key] = Advice(see=see[:1].upper() + see[1:], do=do[:1].upper() + do[1:])
    return found
