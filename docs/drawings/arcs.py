"""Draws the arcs of a satellite: nodes, the interpolating polynomial, and how far windows have been searched."""

from __future__ import annotations

import numpy as np
from style import BLUE, GREEN, GREY, INK, ORANGE, arrow, canvas, save

figure, panel = canvas(9.0, 3.6)
LEFT, MINUTE = 1.5, 0.105
HEIGHTS = {"flown": 2.75, "planned": 1.85, "windows": 0.95}


def at(minutes: float) -> float:
    """Return the place of a time."""
    return LEFT + MINUTE * (minutes + 4)


for hour in range(2):
    panel.plot([at(60 * hour)] * 2, [0.55, 3.15], color=GREY, lw=0.7, ls=":")
    panel.text(at(60 * hour), 3.2, f"{hour} h", ha="center", color=GREY)
for name, y in HEIGHTS.items():
    panel.text(
        LEFT - 0.2,
        y,
        {"flown": "flown arc", "planned": "planned arc", "windows": "windows"}[name],
        ha="right",
        va="center",
        weight="bold",
    )
minutes = np.arange(-4, 66)
panel.plot([at(-4), at(65)], [HEIGHTS["flown"]] * 2, color=BLUE, lw=1)
panel.scatter(
    [at(m) for m in minutes], [HEIGHTS["flown"]] * len(minutes), s=9, color=[ORANGE if m < 0 else BLUE for m in minutes], zorder=3
)
panel.text(at(-4.5), HEIGHTS["flown"] - 0.22, "4 nodes before", ha="left", color=ORANGE, fontsize=8.5)
used = np.arange(26, 36)
panel.plot([at(used[0]), at(used[-1])], [HEIGHTS["flown"] + 0.2] * 2, color=INK, lw=1)
panel.text(at(30.5), HEIGHTS["flown"] + 0.27, "10 nodes make the polynomial of this minute", ha="center", fontsize=8.5)
panel.barh(HEIGHTS["flown"], MINUTE, left=at(30), height=0.24, color=INK, alpha=0.25)
panel.plot([at(0), at(65)], [HEIGHTS["planned"]] * 2, color=GREEN, lw=1)
fine = np.arange(0, 65.25, 0.5)
panel.scatter([at(m) for m in fine], [HEIGHTS["planned"]] * len(fine), s=5, color=GREEN, zorder=3)
panel.text(
    at(30.5),
    HEIGHTS["planned"] - 0.24,
    "samples every 30 s, with the error of a Runge-Kutta step of 30 s as bsk_rl makes it",
    ha="center",
    fontsize=8.5,
    color=GREEN,
)
for start, end in ((6, 12), (20, 25), (38, 43), (52, 57)):
    panel.plot(
        [at(start), at(end)],
        [HEIGHTS["windows"]] * 2,
        color=INK if end < 45 else GREY,
        lw=5,
        solid_capstyle="butt",
        alpha=1.0 if end < 45 else 0.45,
    )
for minute, text, color in ((45, "until: queries see so far", INK), (61, "ready: searched so far", GREY)):
    panel.plot([at(minute)] * 2, [HEIGHTS["windows"] - 0.2, HEIGHTS["windows"] + 0.25], color=color, lw=1.2)
    panel.text(at(minute), HEIGHTS["windows"] - 0.25, text, ha="right", va="top", fontsize=8.5, color=color)
arrow(panel, (at(-4), 0.42), (at(67), 0.42), GREY)
panel.text(at(-4), 0.2, "time since reset", color=GREY, fontsize=8.5)
save(figure, __file__)
