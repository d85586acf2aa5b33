"""Draws the steps of a constellation: tasks of four satellites, and the steps that end with the first of them."""

from __future__ import annotations

from style import BLUE, GREEN, GREY, INK, ORANGE, arrow, canvas, save

figure, panel = canvas(9.0, 3.1)
TASKS = {
    "EO1": [(0, 60, "image"), (60, 135, "image"), (135, 200, "image")],
    "EO2": [(0, 120, "charge"), (120, 200, "image")],
    "EO3": [(0, 95, "image"), (95, 200, "charge")],
    "EO4": [(0, 150, "downlink"), (150, 200, "image")],
}
COLORS = {"image": BLUE, "charge": ORANGE, "downlink": GREEN}
LEFT, SCALE = 0.9, 0.037
ends = sorted({end for tasks in TASKS.values() for _, end, _ in tasks if end < 200})
for end in ends:
    panel.plot([LEFT + SCALE * end] * 2, [0.55, 2.75], color=INK, lw=0.9, ls="--")
for number, (start, end) in enumerate(zip([0, *ends], [*ends, 200], strict=True), 1):
    panel.text(LEFT + SCALE * (start + end) / 2, 2.82, f"step {number}", ha="center", fontsize=8.5)
for row, (name, tasks) in enumerate(TASKS.items()):
    y = 2.4 - 0.5 * row
    panel.text(LEFT - 0.15, y, name, ha="right", va="center", weight="bold")
    for start, end, task in tasks:
        panel.barh(y, SCALE * (end - start) - 0.03, left=LEFT + SCALE * start, height=0.3, color=COLORS[task], alpha=0.85)
        panel.text(LEFT + SCALE * start + 0.07, y, task, va="center", color="white", fontsize=8.5)
        if start:
            panel.scatter([LEFT + SCALE * start], [y], color=INK, s=22, zorder=4)
arrow(panel, (LEFT, 0.5), (LEFT + SCALE * 205, 0.5), GREY)
panel.text(LEFT, 0.3, "time", color=GREY, fontsize=8.5, va="top")
panel.text(
    LEFT + SCALE * 100,
    0.3,
    "a dot is a decision: finished satellites get a new task, the others continue",
    ha="center",
    va="top",
    fontsize=9,
)
save(figure, __file__)
