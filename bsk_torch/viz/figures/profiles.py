"""Performance profiles of methods in a suite."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import PercentFormatter
from torch import Tensor

from bsk_torch.viz.figures.style import INK, PALETTE, WIDTH, fit, headline, label, legend, save, share, tidy


def performance_profiles(
    thresholds: Tensor,
    profiles: Mapping[str, tuple[Tensor, Tensor, Tensor]],
    path: Path,
    title: str = "",
    width: float = WIDTH,
) -> Path:
    """Draw the fraction of runs and tasks with more than each score, and return the path.

    Args:
        thresholds: Scores, [K].
        profiles: By method, the fraction above each threshold and the ends of its interval, [K] each.
        path: The file to write, .png, .svg or .pdf.
        title: Headline; no headline if empty.
        width: Width, inches, such as :data:`~bsk_torch.viz.figures.style.COLUMN` for a paper.
    """
    figure = Figure(figsize=(width, 4.2 * share(width)), dpi=140, layout="constrained", facecolor="white")
    panel = figure.subplots()
    tidy(panel)
    names = []
    for k, (name, (fraction, low, high)) in enumerate(profiles.items()):
        color = PALETTE[k % len(PALETTE)]
        panel.fill_between(thresholds, low, high, color=color, alpha=0.15, linewidth=0)
        panel.plot(thresholds, fraction, color=color, linewidth=1.8)
        names.append(Line2D([], [], color=color, linewidth=1.8, label=name))
    panel.axvline(1.0, color=INK, linewidth=0.8, linestyle=(0, (4, 2)))
    panel.yaxis.set_major_formatter(PercentFormatter(1.0))
    panel.set_xlabel("score: 0 for random actions, 1 for the reference", color=INK, fontsize=9.5)
    label(panel, "runs and tasks above the score")
    if title:
        headline(figure, title)
    fit(figure, width)
    legend(figure, names, width)
    return save(figure, path)
