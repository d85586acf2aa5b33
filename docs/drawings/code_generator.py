"""Draws the way from Python to a kernel, and the blocks of rows that a kernel works on."""

from __future__ import annotations

from style import BLUE, GREY, INK, ORANGE, arrow, box, canvas, save

figure, panel = canvas(9.0, 3.6)
STAGES = (
    ("updates of\nthe components", "Python"),
    ("graph of values", "trace.py, ir.py"),
    ("statements of\na loop", "passes.py"),
    ("C++", "cpp.py, simd.h, x86.h"),
    ("shared library\nin the cache", "build.py"),
)
for k, (text, by) in enumerate(STAGES):
    x = 0.25 + 1.75 * k
    box(panel, x, 2.45, 1.4, 0.75, text)
    panel.text(x + 0.7, 2.36, by, ha="center", va="top", fontsize=8.5, color=GREY)
    if k:
        arrow(panel, (x - 0.33, 2.825), (x - 0.02, 2.825))
panel.text(0.25, 1.55, "rows, sorted by duration and mode, in blocks as wide as a vector register:", va="center")
DURATIONS = (60, 60, 60, 60, 120, 120, 120, 120, 180, 180, 180, 180)
for k, duration in enumerate(DURATIONS):
    block, lane = divmod(k, 4)
    color = (BLUE, ORANGE, GREY)[block]
    panel.barh(1.2 - 0.29 * block - 0.065 * lane, duration * 0.026, left=1.7, height=0.055, color=color)
for block in range(3):
    panel.text(1.6, 1.1 - 0.29 * block, f"block {block}", ha="right", va="center", fontsize=9)
arrow(panel, (1.7, 0.22), (6.9, 0.22), INK)
panel.text(6.95, 0.22, "ticks", va="center")
panel.text(6.75, 0.5, "a block keeps its state in\nregisters over the whole step", va="bottom", fontsize=8.5, color=GREY)
save(figure, __file__)
