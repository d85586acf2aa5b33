"""The learning curve of a run."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import pairwise
from math import isfinite
from pathlib import Path

from matplotlib.axes import Axes
from matplotlib.ticker import PercentFormatter

from bsk_torch.viz.style import INK, PALETTE, headline, label, panels, save

LABEL_HEIGHT = 0.055
"""Height of a line's name, fraction of the panel's."""

Level = tuple[float, float]
"""Mean return and half width of its confidence interval."""


def learning_curve(log: Mapping[str, Sequence[float]], path: Path, levels: Mapping[str, Level], title: str) -> Path:
    """Draw return and survival over training time.

    Args:
        log: Columns of a training log: ``seconds``, ``return``, ``survival`` and ``simulated_days``.
        path: The PNG file to write.
        levels: Returns of policies to compare with, by name, as horizontal lines.
        title: Headline.
    """
    figure, (returns, survival) = panels((3.4, 1.4))
    returns.plot(log["seconds"], log["return"], color=PALETTE[0], linewidth=1.8)
    lines = {name: (mean, color) for color, (name, (mean, _)) in zip(PALETTE[1:], levels.items(), strict=False)}
    for name, (mean, color) in lines.items():
        returns.axhline(mean, color=color, linewidth=1.2, linestyle=(0, (4, 2)))
        returns.axhspan(mean - levels[name][1], mean + levels[name][1], color=color, alpha=0.15, linewidth=0)
    _name_lines(returns, {**lines, "while training": (log["return"][-1], PALETTE[0])})
    label(returns, "return of an episode")
    survival.fill_between(log["seconds"], log["survival"], color=PALETTE[0], alpha=0.15, linewidth=0)
    survival.plot(log["seconds"], log["survival"], color=PALETTE[0], linewidth=1.8)
    survival.set_ylim(0.0, 1.03)
    survival.yaxis.set_major_formatter(PercentFormatter(1.0))
    label(survival, "survival")
    survival.set_xlabel(f"training time, s ({log['simulated_days'][-1]:,.0f} days of flight in all)", color=INK, fontsize=9.5)
    survival.set_xlim(0.0, max(log["seconds"]))
    headline(figure, title)
    return save(figure, path)


def _name_lines(panel: Axes, lines: Mapping[str, tuple[float, str]]) -> None:
    """Names at the right of lines that end at given heights, in the lines' colours."""
    bottom, top = panel.get_ylim()
    finite = {name: (height, color) for name, (height, color) in lines.items() if isfinite(height)}
    heights = spread([height for height, _ in finite.values()], LABEL_HEIGHT * (top - bottom))
    for height, (name, (_, color)) in zip(heights, finite.items(), strict=True):
        panel.text(1.01, height, name, transform=panel.get_yaxis_transform(), color=color, fontsize=9, va="center")


def spread(heights: Sequence[float], gap: float) -> list[float]:
    """Heights moved up or down in their order until neighbours are at least ``gap`` apart."""
    order = sorted(range(len(heights)), key=heights.__getitem__)
    moved = list(heights)
    for _ in range(100):
        for low, high in pairwise(order):
            excess = 0.5 * max(0.0, gap - (moved[high] - moved[low]))
            moved[low], moved[high] = moved[low] - excess, moved[high] + excess
    return moved
