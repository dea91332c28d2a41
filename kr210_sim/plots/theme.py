"""The look of all plots: named colours, one size, and SVG that a page can recolour.

A plot is drawn with a stand-in for each named colour. In a page the stand-ins become CSS
variables, so that one drawing serves light, dark and paper; in a file of its own they become the
light colours.
"""

from __future__ import annotations

import html
import io
import re
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import matplotlib
from matplotlib.axes import Axes
from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.figure import Figure

from kr210_sim.record import STAGES

WIDTH = 5.0
"""Of every plot [inch]: narrow, so that the text stays readable on a phone."""

TEXT, SMALL = 10.5, 9.5
"""Sizes of text [pt]."""

_OF_STAGES = {
    "MOVE_TO_PICK": ("#6fa8dc", "#6fa8dc"),
    "APPROACH": ("#1f7a4d", "#2f9b66"),
    "CLOSE_GRIPPER": ("#f0a35e", "#f0a35e"),
    "LIFT": ("#4fae7c", "#58bd88"),
    "WITHDRAW": ("#a6d9b8", "#a6d9b8"),
    "MOVE_TO_PLACE": ("#2166ac", "#3c84cf"),
    "LOWER": ("#c79bd2", "#c79bd2"),
    "OPEN_GRIPPER": ("#c96a1b", "#d97c2f"),
    "RETREAT": ("#7d4793", "#9a62b0"),
    "MOVE_HOME": ("#4a90d0", "#4f9be0"),
    "SETTLE": ("#a5aeb8", "#7d8793"),
}
"""Moves are blue, lines in the cell green and at the place purple, the gripper is orange."""

_OTHER_STAGE = ("#c2649a", "#d07fae")  # BACK_OUT

COLOURS = {
    "paper": ("#ffffff", "#161b22"),
    "ink": ("#1f2328", "#e6edf3"),
    "soft": ("#57606a", "#a3adb8"),
    "grid": ("#d5dbe1", "#353c45"),
    "good": ("#00735c", "#3fc9a0"),
    "bad": ("#b93a00", "#ff9466"),
    "line-1": ("#0067a5", "#5ab4f0"),
    "line-2": ("#bf4d00", "#f08a4b"),
    "line-3": ("#00795a", "#2dc39a"),
    "line-4": ("#a8437f", "#e79bc6"),
    "line-5": ("#8a6700", "#e6c229"),
    "line-6": ("#4d5566", "#b6c2cf"),
    "side": ("#dfe4ea", "#2c343e"),
    "front": ("#eceff3", "#343d48"),
    "top": ("#f6f8fa", "#3d4753"),
    "edge": ("#aab4bf", "#596472"),
    **{
        f"stage-{stage.lower().replace('_', '-')}": _OF_STAGES.get(stage, _OTHER_STAGE)
        for stage in STAGES
    },
}
"""Name -> colour on light and on dark paper; told apart with any colour vision, too."""

_STAND_INS = {name: f"#0e0e{index:02x}" for index, name in enumerate(COLOURS)}
_NAMES = {stand_in: name for name, stand_in in _STAND_INS.items()}
_FONTS = ["DejaVu Sans", "sans-serif"]


def ink(name: str) -> str:
    """Return the stand-in of a named colour, to draw with."""
    return _STAND_INS[name]


def stage_ink(stage: str) -> str:
    """Return the stand-in of a stage's colour."""
    return ink(f"stage-{stage.lower().replace('_', '-')}")


@dataclass(frozen=True, kw_only=True)
class Plot:
    """A finished plot.

    Attributes:
        name: of the file, unique in a run, letters, digits and hyphens.
        title: one line.
        alt: what it shows, for those who do not see it.
        caption: one or two sentences below it.
        svg: the drawing, with stand-ins for its colours.
    """

    name: str
    title: str
    alt: str
    caption: str
    svg: str

    def inline(self) -> str:
        """Return the drawing as an element of a page, coloured by variables `--plot-NAME`."""
        body = _coloured(self.svg, lambda name: f"var(--plot-{name})")
        body = body.replace("xlink:href", "href")
        label = html.escape(self.alt, quote=True)
        return re.sub(
            r"<svg\b[^>]*?(viewBox=\"[^\"]*\")[^>]*>",
            lambda match: f'<svg {match[1]} role="img" aria-label="{label}">',
            body,
            count=1,
        )

    def file(self) -> str:
        """Return the drawing as a file of its own, in light colours."""
        head = '<?xml version="1.0" encoding="utf-8" standalone="no"?>\n'
        title = f"<title>{html.escape(self.title)}</title><desc>{html.escape(self.alt)}</desc>"
        body = _coloured(self.svg, lambda name: COLOURS[name][0])
        return head + re.sub(r"(<svg\b[^>]*>)", lambda match: match[1] + title, body, count=1)


@contextmanager
def drawing() -> Iterator[None]:
    """Within this, figures are made and rendered in the look of this module."""
    settings: Any = {
        "axes.edgecolor": ink("soft"),
        "axes.facecolor": "none",
        "axes.labelcolor": ink("ink"),
        "axes.labelsize": TEXT,
        "axes.linewidth": 0.8,
        "axes.spines.right": False,
        "axes.spines.top": False,
        "axes.titlesize": TEXT,
        "axes.unicode_minus": True,
        "figure.facecolor": ink("paper"),
        "font.family": _FONTS,
        "font.size": TEXT,
        "grid.color": ink("grid"),
        "grid.linewidth": 0.6,
        "hatch.color": ink("paper"),
        "legend.edgecolor": "none",
        "legend.facecolor": "none",
        "legend.fontsize": SMALL,
        "legend.frameon": False,
        "legend.labelcolor": ink("ink"),
        "lines.linewidth": 1.2,
        "path.simplify": True,
        "path.simplify_threshold": 0.2,
        "svg.fonttype": "none",
        "text.color": ink("ink"),
        "text.parse_math": False,  # names of joints may contain a dollar sign
        "xtick.color": ink("soft"),
        "xtick.labelcolor": ink("ink"),
        "xtick.labelsize": SMALL,
        "ytick.color": ink("soft"),
        "ytick.labelcolor": ink("ink"),
        "ytick.labelsize": SMALL,
    }
    with matplotlib.rc_context():
        matplotlib.rcdefaults()  # a user's matplotlibrc changes nothing
        matplotlib.rcParams.update(settings)
        yield


def new_figure(
    height: float, *, left: float = 0.68, right: float = 0.2, top: float = 0.1, bottom: float = 0.55
) -> Figure:
    """Return an empty figure of the common width, to use within `drawing`.

    Margins are given, as to find them would take as long as to draw.

    Args:
        height: of the figure [inch].
        left: margin beside its axes [inch].
        right: likewise.
        top: margin above them [inch].
        bottom: below them [inch].
    """
    figure = Figure(figsize=(WIDTH, height))
    figure.subplots_adjust(
        left=left / WIDTH,
        right=1 - right / WIDTH,
        top=1 - top / height,
        bottom=bottom / height,
        hspace=0.12,
    )
    FigureCanvasSVG(figure)
    return figure


def limit_line(axis: Axes, value: float, label: str = "", *, above: bool = True) -> None:
    """Draw a limit across an axis, its label at the right end, above or below the line."""
    axis.axhline(value, color=ink("bad"), linewidth=0.9, linestyle=(0, (1, 1.5)))
    beside = axis.get_yaxis_transform()
    side = "bottom" if above else "top"
    axis.text(
        0.995, value, label, color=ink("bad"), fontsize=SMALL, ha="right", va=side, transform=beside
    )


def render(figure: Figure, name: str) -> str:
    """Return a figure as an <svg> element whose ids begin with `name`; the same bits every time."""
    matplotlib.rcParams["svg.hashsalt"] = name
    buffer = io.StringIO()
    figure.savefig(buffer, format="svg", metadata={"Date": None})
    text = buffer.getvalue()
    text = text[text.index("<svg") :]
    text = re.sub(r"<metadata>.*?</metadata>\s*", "", text, flags=re.S)
    text = re.sub(r"<!--.*?-->\s*", "", text, flags=re.S)
    text = re.sub(r"<style type=\"text/css\">[^<]*</style>", "", text)
    text = text.replace("<svg ", '<svg stroke-linejoin="round" stroke-linecap="butt" ', 1)
    text = re.sub(r"<(g|svg) id=\"[^\"]*\"", r"<\1", text)
    text = re.sub(r"(\bid=\"|url\(#|xlink:href=\"#)", rf"\g<1>{name}-", text)
    text = re.sub(r"<[^>]+>", _rounded, text)
    return re.sub(r">\s+<", "><", text).strip()


def _rounded(tag: re.Match[str]) -> str:
    """Return a tag with coordinates of two decimals, 1/7200 inch."""
    return re.sub(r"-?\d+\.\d{3,}", lambda number: f"{round(float(number[0]), 2):g}", tag[0])


def _coloured(svg: str, colour: Callable[[str], str]) -> str:
    return re.sub("#0e0e[0-9a-f]{2}", lambda match: colour(_NAMES[match[0]]), svg)
