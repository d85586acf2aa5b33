"""Map of an episode: ground track and modes of one satellite."""

from __future__ import annotations

from math import isfinite
from pathlib import Path
from typing import Any

import torch
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from torch import Tensor

from bsk_torch.viz.figures.style import INK, WIDTH, caption, dot, fit, headline, legend, save, tidy
from bsk_torch.viz.figures.timeline import NIGHT, TrackEpisode, mode_color, plain
from bsk_torch.viz.figures.world import ground, pieces, world_map

THIN, THICK, SHADE = 1.5, 3.4, 7.5
"""Widths of the track where nothing is earned, where something is, and of the shade under it in the dark, points."""

SHADE_ALPHA = 0.22


def track_map(episode: TrackEpisode, path: Path, title: str = "", width: float = WIDTH) -> Path:
    """Draw an episode to the file ``path``, .png, .svg or .pdf, with headline ``title`` unless that is empty.

    The ground track has the colors of the timeline's modes. It is thick for decisions that earned a reward and shaded in eclipse.
    Ground stations, start and end are marked. ``width`` is in inches, such as :data:`~bsk_torch.viz.figures.style.COLUMN`.
    """
    extra = 0.8 if title else 0.35  # of height, for text
    figure = Figure(figsize=(width, 0.5 * width + extra), dpi=140, layout="constrained", facecolor="white")
    panel = figure.subplots()
    tidy(panel)
    world_map(panel, width)
    panel.set_anchor("C")
    _track(panel, episode)
    _stations(panel, episode)
    for k, marker in ((0, "o"), (-1, "s")):
        panel.plot(*ground(episode.track[k]), marker, color="white", markeredgecolor=INK, markersize=6.5, zorder=6)
    if title:
        caption(panel, "ground track by mode; thick where a reward was earned, shaded in eclipse")
        headline(figure, f"{title}: {episode.outcome}")
    fit(figure, width)
    legend(figure, _legend(episode), width, 8)
    return save(figure, path)


def decision_of(episode: TrackEpisode) -> Tensor:
    """The decision that each piece between two samples of the track belongs to, [M - 1]."""
    middle = 0.5 * (episode.track_times[1:] + episode.track_times[:-1])
    return torch.searchsorted(episode.times, middle, right=True) - 1


def within(times: Tensor, intervals: Tensor) -> Tensor:
    """Return a mask of the ``times`` [M] that lie in any of the ``intervals`` [n, 2]."""
    return ((times.unsqueeze(-1) >= intervals[:, 0]) & (times.unsqueeze(-1) < intervals[:, 1])).any(-1)


def _track(panel: Axes, episode: TrackEpisode) -> None:
    lines, decision = pieces(*ground(episode.track)), decision_of(episode)
    dark = within(0.5 * (episode.track_times[1:] + episode.track_times[:-1]), episode.eclipses)
    look: dict[str, Any] = dict(color=NIGHT, alpha=SHADE_ALPHA, zorder=2.0, capstyle="butt")
    panel.add_collection(LineCollection(runs(lines[dark]), linewidth=SHADE, **look))
    paid = episode.rewards[decision] > 0.0
    for action in sorted(set(episode.actions.tolist())):
        for rows, width in ((~paid, THIN), (paid, THICK)):
            chosen = lines[rows & (episode.actions[decision] == action)]
            panel.add_collection(
                LineCollection(runs(chosen), color=mode_color(action), linewidth=width, zorder=3.0, capstyle="butt")
            )


def runs(lines: Tensor) -> list[list[list[float]]]:
    """Lines of many points, made of :func:`bsk_torch.viz.figures.world.pieces` [n, 5, 2] in the order of flight."""
    joined: list[list[list[float]]] = []
    for begin, end, _, left, right in lines.tolist():
        if joined and joined[-1][-1] == begin:
            joined[-1].append(end)
        else:
            joined.append([begin, end])
        if isfinite(left[0]):
            joined.append([left, right])
    return joined


def _stations(panel: Axes, episode: TrackEpisode) -> None:
    panel.plot(*ground(episode.stations), "^", color=INK, markeredgecolor="white", markersize=8.0, zorder=5)


def _legend(episode: TrackEpisode) -> list[Artist]:
    modes = [
        Line2D([], [], color=mode_color(k), linewidth=THICK, label=plain(name))
        for k, name in enumerate(episode.names)
        if bool((episode.actions == k).any())
    ]
    shade = Patch(color=NIGHT, alpha=SHADE_ALPHA, label="eclipse")
    markers = [dot("^", INK, INK, "ground station")] if len(episode.stations) else []
    return [*modes, shade, *markers, dot("o", "white", INK, "start"), dot("s", "white", INK, "end")]
