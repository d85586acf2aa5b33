"""The learning curve of a run."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

from matplotlib.ticker import PercentFormatter

from bsk_torch.viz.figures.style import INK, PALETTE, WIDTH, fit, headline, label, name_lines, panels, save, share

NAME_HEIGHT = 0.055
"""Height of a line's name, fraction of the panel's."""

Level = tuple[float, float]
"""Mean return and half width of its confidence interval."""


def learning_curve(
    log: Mapping[str, Sequence[float]], path: Path, levels: Mapping[str, Level], title: str, width: float = WIDTH
) -> Path:
    """Draw return and survival over training time.

    Args:
        log: Columns of a training log: ``seconds``, ``return``, ``survival`` and ``simulated_days``.
        path: The file to write, .png, .svg or .pdf.
        levels: Returns of policies to compare with, by name, as horizontal lines.
        title: Headline; no headline if empty.
        width: Width, inches, such as :data:`~bsk_torch.viz.figures.style.COLUMN` for a paper.
    """
    figure, (returns, survival) = panels((3.4 * share(width), 1.4 * share(width)), width)
    returns.plot(log["seconds"], log["return"], color=PALETTE[0], linewidth=1.8)
    lines = {name: (mean, color) for color, (name, (mean, _)) in zip(PALETTE[1:], levels.items(), strict=False)}
    for name, (mean, color) in lines.items():
        returns.axhline(mean, color=color, linewidth=1.2, linestyle=(0, (4, 2)))
        returns.axhspan(mean - levels[name][1], mean + levels[name][1], color=color, alpha=0.15, linewidth=0)
    name_lines(returns, {**lines, "while training": (log["return"][-1], PALETTE[0])}, NAME_HEIGHT / share(width))
    label(returns, "return of an episode")
    survival.fill_between(log["seconds"], log["survival"], color=PALETTE[0], alpha=0.15, linewidth=0)
    survival.plot(log["seconds"], log["survival"], color=PALETTE[0], linewidth=1.8)
    survival.set_ylim(0.0, 1.03)
    survival.yaxis.set_major_formatter(PercentFormatter(1.0))
    label(survival, "survival")
    survival.set_xlabel(f"training time, s ({log['simulated_days'][-1]:,.0f} days of flight in all)", color=INK, fontsize=9.5)
    survival.set_xlim(0.0, max(log["seconds"]))
    if title:
        headline(figure, title)
    fit(figure, width)
    return save(figure, path)
