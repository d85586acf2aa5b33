"""Draws where the random numbers of an argument come from."""

from __future__ import annotations

from style import BLUE, GREY, ORANGE, arrow, box, canvas, save

figure, panel = canvas(9.0, 2.5)
box(panel, 0.2, 1.75, 2.3, 0.45, "seed", "#fdf0e3")
for k, text in enumerate(("satellite and block", "episode", "environment", "CRC-32 of the name")):
    box(panel, 0.2, 1.2 - 0.37 * k, 2.3, 0.33, text, "#e3eefb", fontsize=9)
box(panel, 3.6, 0.55, 1.9, 1.2, "Philox 4x32,\n10 rounds")
box(panel, 6.4, 0.55, 2.4, 1.2, "uniform numbers\nwith 53 random bits")
arrow(panel, (2.55, 1.97), (3.55, 1.5), ORANGE)
arrow(panel, (2.55, 0.82), (3.55, 0.95), BLUE)
arrow(panel, (5.55, 1.15), (6.35, 1.15))
panel.text(2.95, 1.95, "key", color=ORANGE, fontsize=9)
panel.text(2.62, 0.55, "counter", color=BLUE, fontsize=9)
panel.text(7.6, 0.4, "then distributions", ha="center", va="top", fontsize=9, color=GREY)
save(figure, __file__)
