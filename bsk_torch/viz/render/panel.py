"""Text alongside the globe: time, modes, resources, return and counts."""

from __future__ import annotations

from collections import Counter

from bsk_torch.viz.figures.style import FAINT, INK, PALETTE
from bsk_torch.viz.render.marks import DONE, NEW, TRIANGLE, Pen, color_of
from bsk_torch.viz.render.moment import LOW, Moment

SOFT = PALETTE[7]
"""Color of text that explains."""


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

    def entry(self, color: str, name: str, value: str = "", sides: int = 0) -> None:
        unit = self.pen.unit
        at = self.left + 5.0 * unit, self.y
        self.pen.mark(at, 4.5, color, sides)
        self.pen.text((self.left + 16.0 * unit, self.y), name, 13.0, anchor="lm")
        self.pen.text((self.left + self.width, self.y), value, 13.0, anchor="rm")
        self.gap(19.0)

    def bar(self, share: float) -> None:
        box = [self.left, self.y - 4.0 * self.pen.unit, self.left + self.width, self.y + 3.0 * self.pen.unit]
        self.pen.draw.rectangle(box, fill=FAINT)
        box[2] = self.left + self.width * min(1.0, max(0.0, share))
        self.pen.draw.rectangle(box, fill=PALETTE[0])
        self.gap(20.0)


def write_panel(pen: Pen, moment: Moment, left: float, width: float) -> None:
    """Write all known of a moment into a column of pixels."""
    margin, several = 12.0 * pen.unit, len(moment.names) > 1
    column = _Column(pen, left + 0.5 * margin, width - 1.5 * margin)
    column.text(f"{len(moment.names)} satellites" if several else moment.names[0], 17.0)
    column.text(_clock(moment), 13.0, SOFT)
    column.gap(8.0)
    for mode, number in sorted(Counter(moment.modes).items()):
        column.entry(color_of(mode), mode.replace("_", " "), str(number) if several else "")
    column.gap(8.0)
    for name, share in moment.levels.items():
        column.pair(f"{name}, {'min' if name == LOW else 'max'}" if several else name, f"{share:.0%}")
        column.bar(share)
    column.gap(4.0)
    column.pair("return", f"{moment.total:.3f}")
    for name, count in moment.counts.items():
        column.pair(name, str(count))
    column.gap(8.0)
    if len(moment.targets_P):
        column.entry(DONE, "imaged target")
        column.entry(NEW, "target")
    if len(moment.stations_P):
        column.entry(INK, "ground station", sides=TRIANGLE)


def _clock(moment: Moment) -> str:
    """Time since reset, and of how much."""
    now, limit = (f"{int(t // 3600)}:{int(t % 3600 // 60):02d}" if t < 1e9 else "" for t in (moment.time, moment.limit))
    return f"{now}:{int(moment.time % 60):02d} of {limit} h" if limit else f"{now}:{int(moment.time % 60):02d} h"
