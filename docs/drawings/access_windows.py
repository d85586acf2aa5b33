"""Draws the search for windows: the clearance of a satellite over two places, its samples, and what is found."""

from __future__ import annotations

import matplotlib.pyplot as plt
import numpy as np
from style import BLUE, GREEN, GREY, INK, ORANGE, save

from bsk_torch.constants import MU_EARTH, R_EARTH

RADIUS, ELEVATION = R_EARTH + 600e3, np.deg2rad(40.0)
RATE = np.sqrt(MU_EARTH / RADIUS**3)
q = R_EARTH / RADIUS
THETA_MAX = np.arccos(q * np.cos(ELEVATION)) - ELEVATION


def clearance(time: np.ndarray, offset: float, middle: float) -> np.ndarray:
    """Return cos(theta) - cos(theta_max) of a circular orbit that passes a place at an angle ``offset``."""
    return np.cos(offset) * np.cos(RATE * (time - middle)) - np.cos(THETA_MAX)


figure, panel = plt.subplots(figsize=(9.0, 3.6), layout="constrained")
time, samples = np.linspace(0, 600, 1201), np.arange(0, 601, 30)
for offset, middle, color, name in ((0.3 * THETA_MAX, 190.0, BLUE, "place A"), (0.994 * THETA_MAX, 434.0, ORANGE, "place B")):
    f = clearance(time, offset, middle)
    shown = np.abs(time - middle) < 165
    panel.plot(time[shown], 1e3 * f[shown], color=color, label=name)
    near = samples[np.abs(samples - middle) < 165]
    panel.scatter(near, 1e3 * clearance(near, offset, middle), s=22, color=color, zorder=3)
panel.axhline(0, color=INK, lw=0.8)
rise, fall = (190.0 + sign * np.arccos(np.cos(THETA_MAX) / np.cos(0.3 * THETA_MAX)) / RATE for sign in (-1, 1))
for moment, text, x in ((rise, "rise", 15), (fall, "set", fall + 12)):
    panel.scatter([moment], [0], marker="|", s=260, color=INK, zorder=4)
    panel.text(x, 1.2, f"{text}: a root\nbetween two\nsamples", fontsize=9)
panel.plot([rise, fall], [-0.28, -0.28], color=GREEN, lw=5, solid_capstyle="butt")
panel.text((rise + fall) / 2, -0.62, "window of A", ha="center", va="top", color=GREEN, fontsize=9)
panel.annotate(
    "short pass: all samples lie below the limit, but the\nparabola through three of them reaches above it",
    (434, 0.02),
    (395, 2.3),
    fontsize=9,
    arrowprops={"arrowstyle": "-", "color": GREY},
)
panel.set(xlabel="time, s", ylabel=r"$10^3\,(\cos\theta - \cos\theta_{\max})$", xlim=(0, 600), ylim=(-5, 4.6))
panel.legend(frameon=False, loc="lower center", bbox_to_anchor=(0.32, 0.0))
panel.spines[["top", "right"]].set_visible(False)
save(figure, __file__)
