"""Figure of an episode over time: modes, battery, data buffer, wheels, eclipses and station passes."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import torch
from matplotlib.axes import Axes
from matplotlib.patches import Patch
from matplotlib.ticker import MultipleLocator, PercentFormatter
from torch import Tensor

from bsk_torch.viz.figures.style import INK, PALETTE, WIDTH, fit, headline, label, legend, panels, save, share
from bsk_torch.viz.recorders.episode import QUANTITIES, Episode, record_episode

__all__ = ["record_episode", "timeline"]

HOUR = 3600.0

GRAYS, DASHES = (INK, "#6b7280", "#9aa3af"), ("-", (0, (5, 1.5)), (0, (1.5, 1)))
"""Looks of several lines in a panel, such as of wheels: colors are those of modes."""

NIGHT, PASS = "#3b4252", PALETTE[2]


def timeline(
    episode: Episode, path: Path, title: str = "", marks: Sequence[tuple[float, str]] = (), width: float = WIDTH
) -> Path:
    """Draw an episode to the file ``path``, .png, .svg or .pdf.

    Args:
        episode: The recorded episode.
        path: The file.
        title: Headline; no headline if empty.
        marks: Times, s since reset, with a text for each, drawn as lines through all panels.
        width: Width, inches, such as :data:`~bsk_torch.viz.figures.style.COLUMN` for a paper.

    Returns:
        The path.
    """
    figure, axes = panels((0.5 * share(width), *(1.35 * share(width) for _ in episode.series)), width)
    _modes(axes[0], episode)
    for panel, name in zip(axes[1:], episode.series, strict=True):
        _series(panel, episode, name)
    for panel in axes:
        shade(panel, episode)
    time_axis(axes[-1], episode, width=width)
    for k, (time, text) in enumerate(sorted(marks)):
        mark(axes, time / HOUR, text, row=k)
    if title:
        headline(figure, f"{title}: {episode.outcome}")
    fit(figure, width)
    legend(figure, _legend(episode), width, 8)
    return save(figure, path)


def time_axis(panel: Axes, episode: Episode, named: bool = True, width: float = WIDTH) -> None:
    """Ticks of an abscissa in hours, and their numbers and its name where it is ``named``."""
    hours = float(episode.times[-1]) / HOUR
    hour_ticks(panel, hours, width)
    panel.tick_params(labelbottom=named)
    panel.set_xlim(0.0, hours)
    if not named:
        panel.set_xlabel("")


def hour_ticks(panel: Axes, hours: float, width: float = WIDTH) -> None:
    """Set the ticks and the name of an abscissa of so many hours."""
    most = round(12 * share(width))
    steps = (0.01, 0.02, 0.05, 0.1, 0.25, 0.5, 1.0, 2.0, 6.0, 24.0, 1e9)
    panel.xaxis.set_major_locator(MultipleLocator(next(step for step in steps if hours / step <= most)))
    panel.set_xlabel("hours since the start", color=INK, fontsize=9.5)


def bars(panel: Axes, episode: Episode, rows: Tensor, base: float = 0.0, height: float = 1.0, **look: Any) -> None:
    """Bars over the decisions where ``rows`` [T] is true, one for all in a row: seams between bars would show."""
    edge = torch.zeros(1, dtype=torch.bool)
    before, after = torch.cat([edge, rows[:-1]]), torch.cat([rows[1:], edge])
    start, end = episode.times[:-1][rows & ~before] / HOUR, episode.times[1:][rows & ~after] / HOUR
    panel.broken_barh(torch.stack([start, end - start], -1).tolist(), (base, height), linewidth=0, **look)


def _modes(panel: Axes, episode: Episode) -> None:
    for action in sorted(set(episode.actions.tolist())):
        bars(panel, episode, episode.actions == action, facecolors=mode_color(action))
    panel.set_ylim(0.0, 1.0)
    panel.set_yticks([])
    panel.grid(False)
    label(panel, "mode")


def _series(panel: Axes, episode: Episode, name: str) -> None:
    hours, columns = (episode.times / HOUR).tolist(), episode.series[name].mT.tolist()
    for k, column in enumerate(columns):
        panel.plot(hours, column, color=GRAYS[k % len(GRAYS)], linestyle=DASHES[k % len(DASHES)], linewidth=1.5)
    if len(columns) == 1:
        panel.fill_between(hours, columns[0], color=INK, alpha=0.12, linewidth=0)
    panel.set_ylim(0.0 if len(columns) == 1 else -1.05, 1.05)
    panel.yaxis.set_major_formatter(PercentFormatter(1.0))
    label(panel, QUANTITIES[name])


def shade(panel: Axes, episode: Episode) -> None:
    """Backgrounds where the satellite is in the dark or in view of a station."""
    for intervals, color, alpha in ((episode.eclipses, NIGHT, 0.16), (episode.passes, PASS, 0.35)):
        for start, end in (intervals / HOUR).tolist():
            panel.axvspan(start, end, color=color, alpha=alpha, linewidth=0, zorder=0)


def mark(axes: Sequence[Axes], hour: float, text: str, row: int = 0) -> None:
    """Draw a line through all panels at an hour, and write the text above the first panel, ``row`` lines of text higher."""
    for panel in axes:
        panel.axvline(hour, color=INK, linewidth=1.6, linestyle=(0, (4, 2)))
    late = hour > 0.5 * axes[0].get_xlim()[1]
    axes[0].annotate(
        text,
        (hour, 1.0),
        xytext=(-4 if late else 4, 4 + 12 * row),
        xycoords=axes[0].get_xaxis_transform(),
        textcoords="offset points",
        ha="right" if late else "left",
        color=INK,
        fontsize=9.5,
    )


def mode_color(action: int) -> str:
    """Color of an entry of the ``action_spec``."""
    return PALETTE[action % len(PALETTE)]


def _legend(episode: Episode) -> list[Patch]:
    modes = [Patch(color=mode_color(k), label=plain(name)) for k, name in enumerate(episode.names)]
    return [*modes, *shade_legend()]


def shade_legend() -> list[Patch]:
    """Entries for what :func:`shade` draws."""
    return [Patch(color=NIGHT, alpha=0.16, label="eclipse"), Patch(color=PASS, alpha=0.35, label="station pass")]


def plain(action: str) -> str:
    """Name of an action as people say it."""
    return action.removeprefix("action_").replace("_", " ")
