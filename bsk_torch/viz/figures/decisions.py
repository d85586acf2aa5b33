"""Decisions of an imaging policy over time, what they earned, and what they did to battery, wheels and store."""

from __future__ import annotations

from itertools import cycle

import torch
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.ticker import FuncFormatter, MultipleLocator, PercentFormatter

from bsk_torch.viz.figures.ground_track import IMAGED, LOST, UNPAID, ImagingEpisode
from bsk_torch.viz.figures.style import INK, PALETTE, WIDTH, caption, label, name_lines, share, tidy
from bsk_torch.viz.figures.timeline import HOUR, bars, plain, shade, shade_legend

OUTCOMES = {
    IMAGED: (PALETTE[2], "imaged"),
    UNPAID: (PALETTE[1], "imaged, no reward"),
    LOST: (PALETTE[3], "not imaged (downwards)"),
}
"""Color and name of the outcome of an imaging decision."""

MODES = tuple(color for color in PALETTE if color not in {color for color, _ in OUTCOMES.values()})
"""Colors of what else is done."""

NAME_HEIGHT = 0.14
"""Height of a line's name, fraction of the panel's."""

QUANTITIES = {
    "battery_charge_fraction": "battery",
    "wheel_speeds_fraction": "fastest wheel",
    "storage_level_fraction": "data buffer",
}
"""Resources drawn where the satellite has them, and what they are called."""


def decisions(panel: Axes, episode: ImagingEpisode, span: tuple[float, float]) -> list[Artist]:
    """Draw decisions and rewards, and mark a ``span`` of seconds; entries for the legend."""
    panel.axvspan(span[0] / HOUR, span[1] / HOUR, color=INK, alpha=0.1, linewidth=0, zorder=0)
    handles = [*_images(panel, episode), *_others(panel, episode)]
    panel.axhline(0.0, color=INK, linewidth=0.8)
    panel.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{abs(value):g}"))
    label(panel, "priority")
    caption(panel, "decisions, as high as the target's priority")
    return [*handles, _rewards(panel.twinx(), episode, panel.get_ylim()), Patch(color=INK, alpha=0.1, label="shown above")]


def _images(panel: Axes, episode: ImagingEpisode) -> list[Patch]:
    """Bars up for images, down for what was chosen in vain."""
    start, width, handles = episode.times[:-1] / HOUR, episode.times.diff() / HOUR, []
    for kind, (color, name) in OUTCOMES.items():
        rows = episode.outcomes == kind
        if bool(rows.any()):
            height = episode.worth[rows] * (-1.0 if kind == LOST else 1.0)
            panel.bar(start[rows].tolist(), height.tolist(), width[rows].tolist(), align="edge", color=color, linewidth=0)
            handles.append(Patch(color=color, label=name))
    most = max(float(episode.worth.max()), 1e-9)
    lost = float((episode.worth * (episode.outcomes == LOST)).max())
    panel.set_ylim(-1.04 * max(lost, 0.03 * most), 1.04 * most)
    return handles


def _others(panel: Axes, episode: ImagingEpisode) -> list[Patch]:
    """Bars over the whole height for what is no image."""
    (low, high), handles = panel.get_ylim(), []
    for color, action in zip(cycle(MODES), sorted(set(episode.actions[episode.chosen < 0].tolist())), strict=False):
        bars(panel, episode, episode.actions == action, low, high - low, facecolors=color, alpha=0.45)
        handles.append(Patch(color=color, alpha=0.45, label=plain(episode.names[action])))
    return handles


def _rewards(panel: Axes, episode: ImagingEpisode, limits: tuple[float, float]) -> Line2D:
    """The sum of rewards on its own axis, with zero if it is within ``limits`` unless rewards were negative."""
    total = torch.nn.functional.pad(episode.rewards.cumsum(0), (1, 0)).tolist()
    for color, width in (("white", 3.2), (INK, 1.7)):
        panel.step((episode.times / HOUR).tolist(), total, where="post", color=color, linewidth=width)
    tidy(panel)
    panel.grid(False)
    worst, best = min(total), max(*total, 1e-9)
    panel.set_yticks([tick for tick in panel.get_yticks() if worst <= tick <= best])
    scale = best / limits[1]
    panel.set_ylim(1.04 * scale * limits[0] if worst >= 0.0 else 1.04 * worst, 1.04 * best)
    label(panel, "sum of rewards")
    return Line2D([], [], color=INK, linewidth=1.7, label="sum of rewards")


def resources(panel: Axes, episode: ImagingEpisode, width: float = WIDTH) -> list[Artist]:
    """Draw battery, fastest wheel and store in a figure of a ``width``, inches; entries for the legend."""
    hours, ends = (episode.times / HOUR).tolist(), {}
    for color, (name, called) in zip((INK, PALETTE[1], PALETTE[4]), QUANTITIES.items(), strict=True):
        if name in episode.series:
            height = episode.series[name].abs().amax(-1).tolist()
            panel.plot(hours, height, color=color, linewidth=1.6)
            ends[called] = height[-1], color
    shade(panel, episode)
    panel.set_ylim(0.0, 1.03)
    panel.yaxis.set_major_locator(MultipleLocator(0.5))
    panel.yaxis.set_major_formatter(PercentFormatter(1.0))
    label(panel, "share of limit")
    name_lines(panel, ends, NAME_HEIGHT / share(width))
    return [*shade_legend()]
