"""Text alongside the globe: time, modes, resources, return and counts."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable

import numpy as np

from bsk_torch.viz.figures.style import FAINT, INK, PALETTE
from bsk_torch.viz.render.closeup import INSPECTED, LIT, POINT_COLORS, UNLIT, CloseUp
from bsk_torch.viz.render.marks import DONE, NEW, TRIANGLE, Pen, color_of, shade
from bsk_torch.viz.render.moment import LOW, Moment

SOFT = PALETTE[7]
"""Color of text that explains."""

LISTED = 4
"""Inspectors up to which the fuel of each is written."""


class _Column:
    """Entries below each other; lengths in pixels of a frame of 480 lines."""

    def __init__(self, pen: Pen, left: float, width: float) -> None:
        self.pen, self.left, self.width, self.y = pen, left, width, 26.0 * pen.unit

    def gap(self, lines: float) -> None:
        self.y += lines * self.pen.unit

    def text(self, text: str, size: float, color: str = INK) -> None:
        self.pen.text((self.left, self.y), text, size, color, anchor="lm")
        self.gap(size + 7.0)

    def pair(self, name: str, value: str) -> None:
        self.pen.text((self.left, self.y), name, 12.0, SOFT, anchor="lm")
        self.pen.text((self.left + self.width, self.y), value, 12.0, anchor="rm")
        self.gap(18.0)

    def entry(self, color: str, name: str, value: str = "", sides: int = 0, outlined: bool = False) -> None:
        unit = self.pen.unit
        at = self.left + 5.0 * unit, self.y
        if outlined:
            self.pen.circle(at, 4.5, fill=color, outline=INK)
        else:
            self.pen.mark(at, 4.5, color, sides)
        self.pen.text((self.left + 16.0 * unit, self.y), name, 13.0, anchor="lm")
        self.pen.text((self.left + self.width, self.y), value, 13.0, anchor="rm")
        self.gap(19.0)

    def note(self, color: str, name: str) -> None:
        """What a line means."""
        unit = self.pen.unit
        start, end = np.array([self.left, self.y]), np.array([self.left + 11.0 * unit, self.y])
        self.pen.line(start, end, 2.0, shade(color, 255))
        self.pen.text((self.left + 16.0 * unit, self.y), name, 12.0, anchor="lm")
        self.gap(18.0)

    def bar(self, share: float) -> None:
        box = [self.left, self.y - 4.0 * self.pen.unit, self.left + self.width, self.y + 3.0 * self.pen.unit]
        self.pen.draw.rectangle(box, fill=FAINT)
        box[2] = self.left + self.width * min(1.0, max(0.0, share))
        self.pen.draw.rectangle(box, fill=PALETTE[0])
        self.gap(20.0)


def write_panel(pen: Pen, moment: Moment, left: float, width: float) -> None:
    """Write all of a moment into a column of pixels."""
    margin, several = 12.0 * pen.unit, len(moment.names) > 1
    column = _Column(pen, left + 0.5 * margin, width - 1.5 * margin)
    column.text(f"{len(moment.names)} satellites" if several else moment.names[0], 17.0)
    column.text(_clock(moment), 13.0, SOFT)
    column.gap(8.0)
    _activities(column, moment, range(len(moment.names)))
    for name, share in moment.levels.items():
        column.pair(f"{name}, {'min' if name == LOW else 'max'}" if several else name, f"{share:.0%}")
        column.bar(share)
    _totals(column, moment)
    if len(moment.targets_P):
        what = "object" if moment.in_orbit else "target"
        column.entry(DONE, f"imaged {what}")
        column.entry(NEW, f"{what}, by priority" if np.ptp(moment.worth) > 0.0 else what)
    if len(moment.stations_P):
        column.entry(INK, "ground station", sides=TRIANGLE)


def write_inspection_panel(pen: Pen, moment: Moment, close: CloseUp, left: float, width: float) -> None:
    """Write what is known of an inspection into a column of pixels: inspectors, points, fuel, return and counts."""
    margin = 12.0 * pen.unit
    column = _Column(pen, left + 0.5 * margin, width - 1.5 * margin)
    column.text(f"inspection of {moment.names[close.rso]}", 15.0)
    column.text(_clock(moment), 13.0, SOFT)
    column.gap(8.0)
    _activities(column, moment, close.inspectors)
    counted = np.bincount(close.states, minlength=len(POINT_COLORS))
    column.pair("inspected", f"{counted[INSPECTED]} of {len(close.states)}")
    column.bar(counted[INSPECTED] / len(close.states))
    for kind, name in ((INSPECTED, "inspected"), (LIT, "lit, not inspected"), (UNLIT, "not lit yet")):
        column.entry(POINT_COLORS[kind], name, str(counted[kind]), outlined=True)
    column.gap(8.0)
    tanks = [(k, fuel) for k, fuel in zip(close.inspectors, close.fuel.tolist(), strict=True) if math.isfinite(fuel)]
    if len(tanks) <= LISTED:
        for k, fuel in tanks:
            column.pair("fuel" if len(tanks) == 1 else f"{moment.names[k]}, fuel", f"{fuel:.1f} m/s")
    _totals(column, moment)
    if math.isfinite(close.reach):
        column.note(DONE, f"reach, {close.reach:,.0f} m")
    column.note(SOFT, "drift, half an orbit")


def _activities(column: _Column, moment: Moment, satellites: Iterable[int]) -> None:
    several = len(moment.names) > 1
    done = Counter((moment.modes[k], moment.causes[k]) for k in satellites)
    for (mode, cause), number in sorted(done.items()):
        name = mode.replace("_", " ") + (f": {cause}" if cause else "")
        column.entry(color_of(mode), name, str(number) if several else "")
    column.gap(8.0)


def _totals(column: _Column, moment: Moment) -> None:
    column.gap(4.0)
    column.pair("return", f"{moment.total:.3f}")
    for name, count in moment.counts.items():
        column.pair(name, str(count))
    column.gap(8.0)


def _clock(moment: Moment) -> str:
    now, limit = (f"{int(t // 3600)}:{int(t % 3600 // 60):02d}" if t < 1e9 else "" for t in (moment.time, moment.limit))
    return f"{now}:{int(moment.time % 60):02d} of {limit} h" if limit else f"{now}:{int(moment.time % 60):02d} h"
