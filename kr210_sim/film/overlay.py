"""The overlay: which cycle, stage, time and offset this is, and how it ended."""

from __future__ import annotations

from collections.abc import Mapping
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from kr210_sim.film.take import Take

Box = tuple[int, int, int, int]
Color = tuple[int, int, int, int]

INK, FAINT, PANEL = (255, 255, 255, 255), (255, 255, 255, 175), (16, 22, 32, 200)
PAST, AHEAD = (0, 170, 230, 255), (255, 255, 255, 80)
GOOD, BAD = (18, 138, 66, 240), (196, 26, 34, 245)
CLEAR = (0, 0, 0, 0)

TICK = ((-0.9, 0.05), (-0.3, 0.65), (0.95, -0.7))
CROSS = ((-0.7, -0.7), (0.7, 0.7)), ((-0.7, 0.7), (0.7, -0.7))
"""Strokes of the signs, y down, in halves of their size."""

_MARGIN, _STRIP, _CARD, _RADIUS = 20, 84, 74, 12  # [pixels] of a picture 1280 x 720
_BIG, _MEDIUM, _SMALL = 26, 20, 15  # [pixels], heights of letters


class Overlay:
    """Paints over pictures.

    Args:
        size: of the pictures, width and height [pixels].
        tiles: camera -> (left, top, width, height) of its part; labelled if there are several.
    """

    def __init__(self, size: tuple[int, int], tiles: Mapping[str, Box]) -> None:
        self._width, self._height = size
        self._scale = min(size[0] / 1280, size[1] / 720)
        self._tiles = tiles
        self._labels = [_Layer(*label) for label in self._camera_labels()]
        self._take: Take | None = None

    def paint(self, picture: NDArray[np.uint8], take: Take, time: float) -> None:
        """Paint over a picture (height, width, 3) of a take at a time [s]."""
        if self._take is not take:
            self._take = take
            self._card = _Layer(self._draw_card(take), self._px(_MARGIN), self._px(_MARGIN))
            pill = self._draw_verdict(take)
            left = self._width - self._px(_MARGIN) - pill.width
            self._pill = _Layer(pill, left, self._px(_MARGIN))
            self._strip = self._draw_strip(take)
        strip = self._strip.copy()
        self._draw_moment(strip, take, time)
        top = self._height - self._px(_MARGIN) - strip.height
        layers = [*self._labels, self._card, _Layer(strip, self._px(_MARGIN), top)]
        if time >= take.verdict_time:
            layers.append(self._pill)
        for layer in layers:
            layer.blend(picture)

    def _px(self, size: float) -> int:
        return max(1, round(size * self._scale))

    def _panel(self, width: int, height: int, fill: Color) -> Image.Image:
        """Return a rectangle with round, smooth corners."""
        large = (max(1, width) * 4, max(1, height) * 4)
        radius = min(4 * self._px(_RADIUS), *(side // 2 for side in large))
        mask = Image.new("L", large)
        ImageDraw.Draw(mask).rounded_rectangle((0, 0, large[0] - 1, large[1] - 1), radius, fill[3])
        image = Image.new("RGBA", (large[0] // 4, large[1] // 4), fill)
        image.putalpha(mask.resize(image.size, Image.Resampling.BOX))
        return image

    def _camera_labels(self) -> list[tuple[Image.Image, int, int]]:
        """Return label, left and top of every camera, and the lines between them."""
        if len(self._tiles) < 2:
            return []
        font, found = _font(self._px(_SMALL)), []
        for name, (left, top, width, height) in self._tiles.items():
            line = self._px(2)
            frame = Image.new("RGBA", (line, height), INK)
            if left:
                found.append((frame, left - line // 2, top))
            if top:
                found.append((Image.new("RGBA", (width, line), INK), left, top - line // 2))
            wide = min(round(font.getlength(name)) + self._px(24), width)
            label = self._panel(wide, self._px(28), PANEL)
            ImageDraw.Draw(label).text((wide / 2, label.height / 2), name, INK, font, anchor="mm")
            below = 0 if top else self._px(_CARD) + self._px(_MARGIN) // 2  # card and verdict
            found.append((label, left + self._px(_MARGIN), top + self._px(_MARGIN) + below))
        return found

    def _draw_card(self, take: Take) -> Image.Image:
        """Return which cycle this is."""
        score = take.score
        title = f"Cycle {take.cycle}, cell {score['cell']}"  # by its index, as --cycle takes it
        mass = f"{score['target']['mass_kg']:.3g} kg"
        facts = f"number {take.cycle + 1} of {take.cycles}, {mass}, seed {score['seed']}"
        big, small = _font(self._px(_BIG)), _font(self._px(_SMALL))
        width = round(max(big.getlength(title), small.getlength(facts))) + 2 * self._px(18)
        card = self._panel(min(width, self._width), self._px(_CARD), PANEL)
        draw = ImageDraw.Draw(card)
        draw.text((self._px(18), self._px(30)), title, INK, big, anchor="lm")
        draw.text((self._px(18), self._px(55)), facts, FAINT, small, anchor="lm")
        return card

    def _draw_verdict(self, take: Take) -> Image.Image:
        """Return how the cycle ended: a tick, or a cross with reason, stage, time and detail."""
        score, good = take.score, bool(take.score["success"])
        title, facts = "Success", f"{take.succeeded + 1} of {take.cycle + 1} so far"
        if not good:
            title = f"Failed: {_words(score['reason']).lower()}"
            facts = f"{_words(score['failed_stage'])}, {score['failed_time_s']:.2f} s"
            facts += f": {score['detail']}" if score.get("detail") else ""
        big, small = _font(self._px(_BIG)), _font(self._px(_SMALL))
        room = self._width - 2 * self._px(_MARGIN) - self._px(92)
        facts = _shortened(facts, small, 0.6 * room)
        width = round(max(big.getlength(title), small.getlength(facts))) + self._px(92)
        pill = self._panel(min(width, self._width), self._px(_CARD), GOOD if good else BAD)
        draw = ImageDraw.Draw(pill)
        middle, half = self._px(_CARD) / 2, self._px(15)
        for stroke in (TICK,) if good else CROSS:
            points = [(middle + half * x, middle + half * y) for x, y in stroke]
            draw.line(points, INK, self._px(6), joint="curve")
        draw.text((self._px(_CARD), self._px(30)), title, INK, big, anchor="lm")
        draw.text((self._px(_CARD), self._px(55)), facts, INK, small, anchor="lm")
        return pill

    def _draw_strip(self, take: Take) -> Image.Image:
        """Return the panel of stage, time and offsets, empty but for the stages to come."""
        strip = self._panel(self._width - 2 * self._px(_MARGIN), self._px(_STRIP), PANEL)
        for begin, end in self._bars(take, strip.width):
            self._bar(strip, begin, end, AHEAD)
        return strip

    def _draw_moment(self, strip: Image.Image, take: Take, time: float) -> None:
        draw = ImageDraw.Draw(strip)
        shown = min(time, take.duration)
        big, medium, small = (_font(self._px(size)) for size in (_BIG, _MEDIUM, _SMALL))
        row = self._px(34)
        draw.text((self._px(20), row), f"{shown:.2f} s", INK, big, anchor="lm")
        draw.text((self._px(120), row), _words(take.stage(shown)), INK, big, anchor="lm")
        right = strip.width - self._px(20)
        for label, value in _figures(take, shown):
            wide = self._px(132)
            draw.text((right - wide, self._px(22)), label, FAINT, small, anchor="lm")
            draw.text((right - wide, self._px(46)), value, INK, medium, anchor="lm")
            right -= wide + self._px(14)
            if right - wide < self._px(370):
                break
        now = shown / take.duration * (strip.width - 2 * self._px(20)) + self._px(20)
        failed = not take.score["success"] and time >= take.verdict_time
        for (stage, _, _), (begin, end) in zip(
            take.stages, self._bars(take, strip.width), strict=True
        ):
            at_fault = failed and stage == take.score["failed_stage"]
            if begin < now:
                self._bar(strip, begin, min(end, now), BAD if at_fault else PAST)

    def _bars(self, take: Take, width: int) -> list[tuple[float, float]]:
        """Return from where to where each stage goes on the time line [pixels]."""
        left, long = self._px(20), width - 2 * self._px(20)
        gap = self._px(2)
        ends = [
            (left + long * begin / take.duration, left + long * end / take.duration - gap)
            for _, begin, end in take.stages
        ]
        return [(begin, max(begin + 1, end)) for begin, end in ends]

    def _bar(self, strip: Image.Image, begin: float, end: float, fill: Color) -> None:
        top, high = self._px(_STRIP - 18), self._px(6)
        ImageDraw.Draw(strip).rectangle((begin, top, max(begin, end), top + high), fill=fill)


class _Layer:
    """An image with transparency at a place of the picture, prepared for blending."""

    def __init__(self, image: Image.Image, left: int, top: int) -> None:
        self._left, self._top = max(left, 0), max(top, 0)
        pixels = np.asarray(image, dtype=np.uint16)
        alpha = pixels[..., 3:] + (pixels[..., 3:] >> 7)  # 0 to 256
        self._color, self._rest = pixels[..., :3] * alpha, 256 - alpha

    def blend(self, picture: NDArray[np.uint8]) -> None:
        """Paint it over a picture; what does not fit is cut off."""
        rows = slice(self._top, self._top + self._rest.shape[0])
        columns = slice(self._left, self._left + self._rest.shape[1])
        under = picture[rows, columns]
        high, wide = under.shape[:2]
        mixed = under * self._rest[:high, :wide]
        mixed += self._color[:high, :wide]
        mixed >>= 8
        under[:] = mixed


def _figures(take: Take, time: float) -> list[tuple[str, str]]:
    """Return label and value of what is measured at a time [s], the rightmost first."""
    ik = (take.score.get("ik_offset_m") or {}).get("max")
    tracking, forces = take.at("tracking_max", time), take.at("finger_force", time)
    return [
        ("IK offset", "-" if ik is None else f"{ik:.1e} m"),
        ("tracking offset", "-" if tracking is None else f"{1000 * float(tracking):.2f} mm"),
        ("grip force", "-" if forces is None else f"{float(np.min(forces)):.0f} N"),
    ]


def _words(name: str) -> str:
    """Return a name of a stage or reason as words."""
    return str(name).replace("_", " ").lower().capitalize()


def _shortened(text: str, font: ImageFont.FreeTypeFont, room: float) -> str:
    """Return a text that is no longer than a number of pixels."""
    if font.getlength(text) <= room:
        return text
    while text and font.getlength(text + "...") > room:
        text = text[:-1]
    return text + "..."


@lru_cache
def _font(size: int) -> ImageFont.FreeTypeFont:
    font = ImageFont.load_default(size)
    assert isinstance(font, ImageFont.FreeTypeFont)  # of every build of pillow with FreeType
    return font
