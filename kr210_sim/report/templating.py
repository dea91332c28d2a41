"""Templates of pages -> HTML, and how numbers and words look in them."""

from __future__ import annotations

from functools import lru_cache
from typing import Any

from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup, escape

from kr210_sim.plots.theme import COLOURS
from kr210_sim.record import stage_label
from kr210_sim.stats import in_percent

DASH = "\N{EN DASH}"
"""Stands where there is no value."""


def render(template: str, **values: Any) -> str:
    """Return a page.

    Args:
        template: name of a file in `templates/`.
        values: what it shows; the colours of plots and the dash are there always.
    """
    return _environment().get_template(template).render(colours=COLOURS, dash=DASH, **values)


@lru_cache(maxsize=1)
def _environment() -> Environment:
    environment = Environment(
        loader=PackageLoader("kr210_sim.report"),
        autoescape=True,
        trim_blocks=True,
        lstrip_blocks=True,
        undefined=StrictUndefined,
    )
    environment.filters |= {
        "number": number,
        "percent": percent,
        "bounds": lambda pair: in_percent(*pair),
        "stage": stage_words,
        "with_code": with_code,
    }
    return environment


def number(value: float | None, scale: float = 1.0, unit: str = "") -> str:
    """Return a number with three significant digits and its unit, or a dash."""
    if value is None:
        return DASH
    scaled = value * scale
    text = f"{scaled:.1e}" if scaled and not 1e-3 <= abs(scaled) < 1e5 else _plain(scaled)
    return f"{text} {unit}".rstrip()


def _plain(value: float) -> str:
    """Return three significant digits, all of them, without an exponent."""
    size = abs(value)
    digits = 0 if value == 0 or size >= 100 else 1 if size >= 10 else 2 if size >= 1 else 3
    return f"{value:.{digits}f}".replace("-", "\N{MINUS SIGN}")


def percent(share: float) -> str:
    """Return a share in percent, at most one decimal; 0 and 100 only if it is so."""
    rounded = round(100 * share, 1)
    return f"{min(max(rounded, 0.1), 99.9) if 0 < share < 1 else rounded:g} %"


def stage_words(stage: str | None) -> str:
    """Return a stage's name as people write it."""
    return DASH if stage is None else stage_label(stage)


def with_code(text: str) -> Markup:
    """Return text as HTML, with what stands between backticks as code."""
    parts = [escape(part) for part in text.split("`")]
    if len(parts) % 2 == 0:
        return escape(text)
    return Markup("").join(
        Markup("<code>{}</code>").format(part) if index % 2 else part
        for index, part in enumerate(parts)
    )
