"""The learning curve of a run, and performance profiles of methods in a suite."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import PercentFormatter
from torch import Tensor

from bsk_torch.viz.figures.style import INK, PALETTE, WIDTH, finish, label, name_lines, panels, share, tidy

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
    return finish(figure, path, title, width)


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
    return finish(figure, path, title, width, names)
