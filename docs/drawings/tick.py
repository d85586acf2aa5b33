"""Draws a tick: groups of components in their order, and the messages read a tick later."""

from __future__ import annotations

from style import BLUE, GREY, INK, ORANGE, PALE, arrow, box, canvas, save

from bsk_torch.sim.schedule import SCHEDULE

figure, panel = canvas(9.0, 5.0)
COLORS = {"environment": "#e3eefb", "orbit": "#e6f5ee", "dynamics": PALE, "flight software": "#fdf0e3"}
COLUMNS = {"environment": (0.4, 4.15), "orbit": (0.4, 1.45), "dynamics": (3.1, 4.15), "flight software": (6.9, 4.15)}
WIDTH, STEP = 2.0, 0.27
for group, (x, top) in COLUMNS.items():
    slots = [slot.name for slot in SCHEDULE if slot.group == group]
    wide = 2 if len(slots) > 14 else 1
    rows = -(-len(slots) // wide)
    panel.text(x, top + 0.12, group, weight="bold", va="bottom")
    for k, slot in enumerate(slots):
        column, row = divmod(k, rows)
        box(
            panel,
            x + column * 1.75,
            top - STEP * (row + 1),
            1.7 if wide > 1 else WIDTH - 0.2,
            STEP - 0.04,
            slot,
            COLORS[group],
            fontsize=8,
        )
panel.text(
    4.5,
    4.85,
    "one tick, t to t + h: components run in this order, each reads what has been written before",
    ha="center",
    va="top",
)
arrow(panel, (1.6, 2.5), (1.6, 1.75), INK, lw=1.6)
arrow(panel, (2.25, 1.3), (3.05, 2.0), INK, lw=1.6)
arrow(panel, (6.57, 2.8), (6.87, 2.8), INK, lw=1.6)
arrow(panel, (7.8, 2.1), (5.6, 1.65), ORANGE, curve=-0.25)
arrow(panel, (3.05, 2.4), (2.25, 2.75), BLUE, curve=0.25)
panel.text(6.9, 1.5, "commands of t are latched by\nwheels and thrusters at t + h", color=ORANGE, fontsize=9, va="top")
panel.text(3.1, 1.5, "the world sees the spacecraft where it was a tick ago", color=BLUE, fontsize=9, va="top", ha="left")
panel.text(0.4, 0.3, "bsk-torch schedule prints this list with its modules of Basilisk", color=GREY, fontsize=8)
save(figure, __file__)
