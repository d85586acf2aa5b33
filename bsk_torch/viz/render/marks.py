"""Marks on the globe: targets, ground stations, orbits, contacts and satellites."""

from __future__ import annotations

from functools import lru_cache
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
from PIL import ImageColor, ImageFont
from PIL.ImageDraw import ImageDraw

from bsk_torch import _text
from bsk_torch.viz.figures.style import INK, PALETTE
from bsk_torch.viz.render.globe import Camera
from bsk_torch.viz.render.moment import DEAD, Array, Moment

COLORS = {
    "image": PALETTE[0],
    "image_rso": PALETTE[0],
    "nadir_scan": PALETTE[0],
    "charge": PALETTE[1],
    "downlink": PALETTE[2],
    "desat": PALETTE[3],
    "nadir_point": PALETTE[4],
    "drift": PALETTE[5],
    "idle": PALETTE[7],
    DEAD: "#14171c",
}
"""Colors of what satellites do."""

OTHER = PALETTE[6]
"""Color of whatever else they do."""

NEW, DONE = "#3f4856", "#12b76a"
"""Colors of targets, and of imaged targets."""

LEAST, MOST = 0.6, 1.5
"""Sizes of targets of no priority and of the largest one, over the usual size."""

TRIANGLE = 3
"""Sides of the marks of ground stations."""

TRAIL = 0.3
"""Part of the last orbit that fades behind a satellite."""

FRESH, FAINT = 235, 70
"""Opacity of the orbit right behind a satellite, and of the rest, of 255."""

NAMED = 16
"""Maximum number of satellites with names."""

EDGE = 0.88
"""Part of the picture's width from which on names are written to the left."""


class Pen(NamedTuple):
    """Canvas and camera, and the length of a pixel of a frame of 480 lines."""

    draw: ImageDraw
    eye: Camera
    unit: float

    def circle(self, at: tuple[float, float], radius: float, **look: Any) -> None:
        """A circle around a pixel, its radius in units."""
        self.draw.circle(at, radius * self.unit, **look)

    def mark(self, at: tuple[float, float], radius: float, color: str, sides: int = 0) -> None:
        """A filled circle, or a regular polygon with some sides."""
        if sides:
            self.draw.regular_polygon((*at, 1.2 * radius * self.unit), sides, fill=color, outline="white")
        else:
            self.circle(at, radius, fill=color)

    def line(self, start: Array, end: Array, width: float, color: tuple[int, ...]) -> None:
        """A line between pixels, its width in units."""
        self.draw.line((*start, *end), fill=color, width=max(1, round(width * self.unit)))

    def text(self, at: tuple[float, float], text: str, size: float, color: str = INK, **look: Any) -> None:
        """A text of a size in units."""
        self.draw.text(at, _text.visible(text), fill=color, font=font(size * self.unit), **look)


@lru_cache(maxsize=32)
def font(size: float) -> ImageFont.FreeTypeFont | ImageFont.ImageFont:
    """The font that Pillow carries."""
    return ImageFont.load_default(size)


def color_of(mode: str) -> str:
    """Color of what a satellite does."""
    return COLORS.get(mode, OTHER)


def shade(color: str, opacity: int) -> tuple[int, ...]:
    """A color with an opacity of 0 to 255."""
    return (*ImageColor.getrgb(color)[:3], opacity)


def draw_marks(pen: Pen, moment: Moment) -> None:
    """Draw everything that has no letters."""
    _targets(pen, moment)
    _stations(pen, moment)
    _orbits(pen, moment)
    _lines(pen, moment)
    _satellites(pen, moment)


def _targets(pen: Pen, moment: Moment) -> None:
    pixels, visible = pen.eye.project(moment.targets_P @ moment.PN)
    size = 0.8 + 1.4 * min(1.0, (300 / max(1, len(pixels))) ** 0.5)
    radius = np.where(moment.imaged, size + 0.8, size * (LEAST + (MOST - LEAST) * moment.worth))
    for rows, color in ((~moment.imaged, NEW), (moment.imaged, DONE)):
        drawn = rows & visible
        for at, wide in zip(pixels[drawn].tolist(), radius[drawn].tolist(), strict=True):
            pen.circle(at, wide, fill=shade(color, 255))


def _stations(pen: Pen, moment: Moment) -> None:
    pixels, visible = pen.eye.project(moment.stations_P @ moment.PN)
    for at in pixels[visible].tolist():
        pen.mark(at, 4.2, INK, TRIANGLE)


def _orbits(pen: Pen, moment: Moment) -> None:
    """One revolution of each, from where the satellite is backwards."""
    pixels, visible = pen.eye.project(moment.orbits_N)
    fresh = TRAIL * (pixels.shape[1] - 1)
    for path, shown, mode in zip(pixels.tolist(), (visible[:, 1:] & visible[:, :-1]).tolist(), moment.modes, strict=True):
        for k, (start, end) in enumerate(pairwise(path)):
            age = min(1.0, k / fresh)
            if shown[k] and (mode != DEAD or age == 1.0):
                pen.line(start, end, 2.6 - 1.6 * age, shade(INK, round(FRESH + (FAINT - FRESH) * age)))


def _lines(pen: Pen, moment: Moment) -> None:
    """Between satellites that have talked, and from satellites to the targets that they look at, once these have risen."""
    pixels, visible = pen.eye.project(moment.r_N)
    for a, b in np.argwhere(np.triu(moment.links | moment.links.T, 1)).tolist():
        if visible[a] and visible[b]:
            pen.line(pixels[a], pixels[b], 1.0, shade(PALETTE[4], 150))
    aims_N = moment.aims_P @ moment.PN
    aims, _ = pen.eye.project(aims_N)
    height = ((moment.r_N - aims_N) * aims_N).sum(-1)
    risen = np.isfinite(height) if moment.in_orbit else height > 0.0  # false where there is no target
    for k in np.flatnonzero(visible & risen).tolist():
        pen.line(pixels[k], aims[k], 2.0, shade(color_of(moment.modes[k]), 255))


def _satellites(pen: Pen, moment: Moment) -> None:
    pixels, visible = pen.eye.project(moment.r_N)
    size = 6.5 if len(pixels) == 1 else 5.0 if len(pixels) <= NAMED else 3.5
    for at, is_front, mode in zip(pixels.tolist(), visible.tolist(), moment.modes, strict=True):
        if is_front:
            pen.circle(at, size + 1.5, fill="white")
            pen.circle(at, size, fill=color_of(mode))
        else:
            pen.circle(at, 0.6 * size, outline=shade(color_of(mode), 150), width=round(1.5 * pen.unit))


def write_names(pen: Pen, moment: Moment) -> None:
    """Names next to the satellites of a small constellation."""
    pixels, visible = pen.eye.project(moment.r_N)
    if 1 < len(pixels) <= NAMED:
        for at, is_front, name in zip(pixels.tolist(), visible.tolist(), moment.names, strict=True):
            if is_front:
                side, anchor = (9.0, "lm") if at[0] < EDGE * 2.0 * pen.eye.centre else (-9.0, "rm")
                where = at[0] + side * pen.unit, at[1]
                pen.text(where, name, 11.0, anchor=anchor, stroke_width=round(1.5 * pen.unit), stroke_fill="white")
