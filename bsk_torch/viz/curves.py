"""The learning curve of a run."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

from matplotlib.axes import Axes
from matplotlib.ticker import PercentFormatter

from bsk_torch.viz.style import INK, PALETTE, headline, label, panels, save

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
    returns.annotate("training episodes", (log["seconds"][-1], log["return"][-1]), **_beside(PALETTE[0]))
    _levels(returns, levels)
    label(returns, "return of an episode")
    survival.fill_between(log["seconds"], log["survival"], color=PALETTE[2], alpha=0.25, linewidth=0)
    survival.plot(log["seconds"], log["survival"], color=PALETTE[2], linewidth=1.6)
    survival.set_ylim(0.0, 1.03)
    survival.yaxis.set_major_formatter(PercentFormatter(1.0))
    label(survival, "survival")
    survival.set_xlabel(f"training time, s ({log['simulated_days'][-1]:,.0f} days of flight in all)", color=INK, fontsize=9.5)
    survival.set_xlim(0.0, max(log["seconds"]))
    headline(figure, title)
    return save(figure, path)


def _beside(color: str) -> dict[str, object]:
    return {
        "xytext": (6, 0),
        "textcoords": "offset points",
        "color": color,
        "fontsize": 9,
        "va": "center",
        "annotation_clip": False,
    }


def _levels(panel: Axes, levels: Mapping[str, Level]) -> None:
    """A line and a band for every level, named at the right."""
    for color, (name, (mean, half_width)) in zip(PALETTE[1:], levels.items(), strict=False):
        panel.axhline(mean, color=color, linewidth=1.2, linestyle=(0, (4, 2)))
        panel.axhspan(mean - half_width, mean + half_width, color=color, alpha=0.15, linewidth=0)
        panel.annotate(name, (1.0, mean), xycoords=("axes fraction", "data"), **_beside(color))
