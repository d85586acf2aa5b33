"""Figures of imaging in orbit: the sky of an imager with the objects of its catalog, and images and downlinks over time."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import torch
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.patheffects import withStroke
from matplotlib.text import Annotation, Text
from torch import Tensor

from bsk_torch.viz.figures.style import (
    FAINT,
    INK,
    PALETTE,
    SMALLER,
    WIDTH,
    caption,
    dot,
    fit,
    headline,
    label,
    legend,
    panels,
    save,
    share,
)
from bsk_torch.viz.figures.timeline import HOUR, NIGHT, hour_ticks
from bsk_torch.viz.table import Columns, Tabular, Tasks, satellite_columns

__all__ = ["RSOImagingEpisode", "Sky", "services_figure", "sky_figure"]

MINUTE = 60.0

SUNLIT, DARK, EARTH = PALETTE[1], "#6b7280", "#eef1f4"
"""Colors of objects in the light and in the dark, and of the Earth below the horizon."""

PENDING, IMAGED = PALETTE[0], PALETTE[2]
"""Colors of rings around objects with images on board, and around others that have been imaged."""

LIGHT = 0.5
"""Visible fraction of the Sun from which an object is shown in the light."""

SMALL, LARGE = 22.0, 95.0
"""Areas of the marks of objects of no priority and of the largest one, square points."""

NAMES_AT = math.radians(45.0)
"""Elevation of the names of directions, rad."""

NUMBERED = 10
"""Largest number of candidates whose places are written next to them."""

SIDES = ((10.0, 6.0), (-10.0, 6.0), (10.0, -12.0), (-10.0, -12.0), (0.0, 9.0), (0.0, -16.0))
"""Where these may stand, points from the middle of a mark, in the order of preference."""

ROW = 0.2
"""Height of the row of an object, inches."""

WIDE, NARROW = 0.76, 0.34
"""Heights of the bars of images on board, and of dark time, over that of a row."""


@dataclass(frozen=True, kw_only=True)
class Sky:
    """The G objects of a catalog as an imager sees them at a time, as plain tensors on the CPU.

    Attributes:
        imager: Name of the imager.
        time: Time since reset, s.
        ids: Ids of the objects.
        azimuth: Angles in the local horizontal plane from ahead to the right, degrees, [G]. Ahead is along the track.
        elevation: Angles above the local horizontal plane, degrees, [G].
        limb: Elevation of the Earth's limb, degrees.
        light: Visible fraction of the Sun at each, [G].
        in_sight: Which the imager sees past the Earth, [G].
        priority: Priorities, [G].
        pending: Images of each that wait for their downlink, [G].
        imaged: Those imaged in the episode, [G].
        candidates: Numbers of the candidates, in their order, [C].
    """

    imager: str
    time: float
    ids: Sequence[str]
    azimuth: Tensor
    elevation: Tensor
    limb: float
    light: Tensor
    in_sight: Tensor
    priority: Tensor
    pending: Tensor
    imaged: Tensor
    candidates: Tensor

    def __post_init__(self) -> None:
        """ValueError for tensors whose shapes do not fit each other."""
        for name in ("azimuth", "elevation", "light", "in_sight", "priority", "pending", "imaged"):
            _check_shape(name, getattr(self, name), (len(self.ids),))

    @property
    def outcome(self) -> str:
        """Summary of the sky as text."""
        lit = self.in_sight & (self.light >= LIGHT)
        return f"{int(self.in_sight.sum())} of {len(self.ids)} objects in sight, {int(lit.sum())} of them lit"


@dataclass(frozen=True, kw_only=True)
class RSOImagingEpisode(Tabular):
    """One episode of I imagers and a catalog of G objects, as plain tensors on the CPU; times in seconds since the reset.

    Attributes:
        names: Names of the imagers.
        ids: Ids of the objects.
        decisions: Times at which steps began and ended, ascending, [B].
        light: Visible fraction of the Sun at each object then, [G, B].
        priority: Priorities of the objects then, [G, B].
        taken: Times of the images, ascending, [M].
        delivered: End of the step in which the last bit of each was downlinked, infinite for never, [M].
        imager: Number of the imager of each, [M].
        target: Number of the object of each, [M].
        quality: Quality of each, [M].
        rewards: Reward of each imager in the steps, [I, B - 1].
        deaths: When each imager died, infinite for survivors, [I].
        tasks: Tasks of the imagers.
        series: Other quantities of the imagers by name, [I, B, width] each.
    """

    names: Sequence[str]
    ids: Sequence[str]
    decisions: Tensor
    light: Tensor
    priority: Tensor
    taken: Tensor
    delivered: Tensor
    imager: Tensor
    target: Tensor
    quality: Tensor
    rewards: Tensor
    deaths: Tensor
    tasks: Tasks
    series: dict[str, Tensor]

    def __post_init__(self) -> None:
        """ValueError for tensors whose shapes do not fit each other."""
        i, g, b, m = len(self.names), len(self.ids), len(self.decisions), len(self.taken)
        needed: dict[str, tuple[int, ...]] = {"light": (g, b), "priority": (g, b), "rewards": (i, b - 1), "deaths": (i,)}
        needed |= dict.fromkeys(("delivered", "imager", "target", "quality"), (m,))
        for name, shape in needed.items():
            _check_shape(name, getattr(self, name), shape)
        if b < 2:
            raise ValueError(f"decisions has {b} entries; an episode needs at least 2")

    @property
    def outcome(self) -> str:
        """Summary of an episode as text: images, deliveries, return and deaths."""
        images, arrived = len(self.taken), int(torch.isfinite(self.delivered).sum())
        different, dead = len(self.target.unique()), int(torch.isfinite(self.deaths).sum())
        died = "" if not dead else ", died" if len(self.names) == 1 else f", {dead} of {len(self.names)} died"
        of = f"{images} images of {different} of {len(self.ids)} objects"
        return f"{of}, {arrived} delivered, return {float(self.rewards.nan_to_num().sum()):.2f}{died}"

    @property
    def colors(self) -> list[str]:
        """Color of each imager."""
        return [PALETTE[(0, 3, 4, 5, 6)[k % 5]] for k in range(len(self.names))]

    def on_board(self) -> Tensor:
        """Return the number of images on board of each imager at each decision boundary, [I, B]."""
        there = (self.taken.unsqueeze(1) <= self.decisions) & (self.decisions < self.delivered.unsqueeze(1))
        return torch.zeros(len(self.names), len(self.decisions), dtype=torch.float64).index_add(0, self.imager, there.double())

    def to_numpy(self) -> Columns:
        """Return the episode as a table: a row for each imager at each decision boundary, in the order of time.

        ``time`` is in seconds since reset and ``satellite`` the name. ``action`` is the task from then on, ``decided`` whether it
        began there, and ``reward`` that of the step that begins there. ``images`` and ``delivered`` count until then.
        """
        counts = {}
        for name, when in (("images", self.taken), ("delivered", self.delivered)):
            done = (when.unsqueeze(1) <= self.decisions).double()
            counts[name] = torch.zeros(len(self.names), len(self.decisions), dtype=torch.float64).index_add(0, self.imager, done)
        numbers = {"reward": self.rewards, **counts, **self.series}
        return satellite_columns(self.names, self.decisions, self.deaths, self.tasks, numbers)


def _check_shape(name: str, value: Tensor, shape: tuple[int, ...]) -> None:
    if tuple(value.shape) != shape:
        raise ValueError(f"{name} has shape {list(value.shape)}; it must be {list(shape)}")


# -- sky -------------------------------------------------------------------------------------------------------------------------


def sky_figure(sky: Sky, path: Path, title: str = "", width: float = WIDTH) -> Path:
    """Draw a sky to the file ``path``, .png, .svg or .pdf, with headline ``title`` unless that is empty.

    It is an equal-area map of directions in the imager's Hill frame: ahead is in the middle, behind at both edges, the zenith
    above and the Earth below. Marks are larger for higher priorities. The first candidates have the numbers of their actions.
    ``width`` is in inches, such as :data:`~bsk_torch.viz.figures.style.COLUMN`.
    """
    figure = Figure(figsize=(width, 0.58 * width), dpi=140, layout="constrained", facecolor="white")
    panel = figure.add_subplot(projection="mollweide")
    _horizon(panel, sky)
    x, y = torch.deg2rad(sky.azimuth), torch.deg2rad(sky.elevation)
    area = SMALL + (LARGE - SMALL) * (sky.priority / sky.priority.max().clamp(min=1e-12)).clamp(min=0.0)
    lit = sky.light >= LIGHT
    for rows, color in ((lit, SUNLIT), (~lit, DARK)):
        for seen, face in ((sky.in_sight, color), (~sky.in_sight, "white")):
            now = rows & seen
            panel.scatter(x[now], y[now], area[now], color=face, edgecolors=color, linewidths=1.1, zorder=3, clip_on=False)
    for rows, color in ((sky.imaged & (sky.pending == 0), IMAGED), (sky.pending > 0, PENDING)):
        panel.scatter(
            x[rows],
            y[rows],
            1.5 * area[rows] + 45.0,
            facecolors="none",
            edgecolors=color,
            linewidths=1.6,
            zorder=4,
            clip_on=False,
        )
    names, numbers = list(panel.texts), list[Annotation]()
    look: dict[str, Any] = dict(textcoords="offset points", ha="center", color=INK, fontsize=9, zorder=5)
    look["path_effects"] = [withStroke(linewidth=2.5, foreground="white")]
    for k, number in enumerate(sky.candidates[:NUMBERED].tolist()):
        numbers.append(panel.annotate(str(k), (float(x[number]), float(y[number])), SIDES[0], **look))
    if title:
        headline(figure, f"{title}: {sky.outcome}")
    caption(panel, f"sky of {sky.imager} after {sky.time / MINUTE:.0f} min")
    fit(figure, width)
    legend(figure, _sky_legend(sky), width, 4)
    figure.draw_without_rendering()  # arranges the panel
    _keep_apart(numbers, names, SMALLER if width < WIDTH else 1.0)
    return save(figure, path)


def _keep_apart(numbers: Sequence[Annotation], names: Sequence[Text], scale: float) -> None:
    """Write each number at the first of the :data:`SIDES` of its mark, times ``scale``, at which it overlaps no other text."""
    taken = [name.get_window_extent() for name in names]
    for number in numbers:
        for x, y in SIDES:
            number.xyann = (scale * x, scale * y)
            box = number.get_window_extent()
            if not any(box.overlaps(other) for other in taken):
                break
        else:
            number.xyann = (scale * SIDES[0][0], scale * SIDES[0][1])
        taken.append(number.get_window_extent())


def _horizon(panel: Axes, sky: Sky) -> None:
    """Draw the Earth, the local horizontal and the names of directions."""
    around = torch.linspace(-math.pi, math.pi, 181, dtype=torch.float64)
    panel.fill_between(around, -0.5 * math.pi, math.radians(sky.limb), color=EARTH, linewidth=0, zorder=0)
    panel.plot(around, torch.full_like(around, math.radians(sky.limb)), color=INK, linewidth=1.0, zorder=1)
    panel.set_xticks([math.radians(degrees) for degrees in (-90, 0, 90)], [])
    for degrees, name in ((-90, "left"), (0, "ahead"), (90, "right")):
        panel.text(math.radians(degrees), NAMES_AT, name, color=DARK, fontsize=9, ha="center", va="center")
    panel.set_yticks([math.radians(degrees) for degrees in (-60, -30, 0, 30, 60)])
    panel.tick_params(colors=INK, labelsize=8.5)
    panel.grid(color=FAINT, linewidth=0.6, zorder=0)
    for spine in panel.spines.values():
        spine.set_color(FAINT)


def _sky_legend(sky: Sky) -> list[Artist]:
    lit, numbered = sky.light >= LIGHT, min(NUMBERED, len(sky.candidates))
    there: list[tuple[bool, Artist]] = [
        (bool((lit & sky.in_sight).any()), dot("o", SUNLIT, SUNLIT, "lit")),
        (bool((~lit & sky.in_sight).any()), dot("o", DARK, DARK, "in eclipse")),
        (bool((lit & ~sky.in_sight).any()), dot("o", "white", SUNLIT, "lit, hidden by the Earth")),
        (bool((~lit & ~sky.in_sight).any()), dot("o", "white", DARK, "in eclipse, hidden by the Earth")),
        (bool((sky.pending > 0).any()), _ring(PENDING, "image on board")),
        (bool((sky.imaged & (sky.pending == 0)).any()), _ring(IMAGED, "image delivered")),
        (True, Patch(facecolor=EARTH, edgecolor=INK, linewidth=1.0, label="Earth")),
        (
            numbered > 0,
            Line2D(
                [],
                [],
                linestyle="",
                marker=f"${0}$",
                color=INK,
                markeredgewidth=0.0,
                markersize=6.0,
                label="number of the action",
            ),
        ),
    ]
    return [handle for shown, handle in there if shown]


def _ring(color: str, name: str) -> Line2D:
    """Return a legend entry for a ring."""
    return Line2D([], [], linestyle="", marker="o", markersize=9.0, markerfacecolor="none", markeredgecolor=color, label=name)


# -- services --------------------------------------------------------------------------------------------------------------------


def services_figure(episode: RSOImagingEpisode, path: Path, title: str = "", width: float = WIDTH) -> Path:
    """Draw an episode to the file ``path``, .png, .svg or .pdf, with headline ``title`` unless that is empty.

    Above is a row for each object that was imaged, in the order of their first images: bars from images to their deliveries, and
    when the object was in eclipse. Below are the images on board of each imager, and the return. ``width`` is in inches, such as
    :data:`~bsk_torch.viz.figures.style.COLUMN`.
    """
    shown = list(dict.fromkeys(episode.target.tolist()))
    above = max(1.0, 0.5 + (ROW if width >= WIDTH else SMALLER * ROW) * len(shown))
    figure, (rows, board, value) = panels((above, 0.9 * share(width), 0.9 * share(width)), width)
    _services(rows, episode, shown)
    hours = (episode.decisions / HOUR).tolist()
    for k, color in enumerate(episode.colors):
        board.step(hours, episode.on_board()[k].tolist(), where="post", color=color, linewidth=1.6)
        total = torch.cat([torch.zeros(1, dtype=torch.float64), episode.rewards[k].nan_to_num().double().cumsum(0)])
        value.step(hours, total.tolist(), where="post", color=color, linewidth=1.6)
    board.set_ylim(bottom=0.0)
    label(board, "on board")
    label(value, "return")
    value.set_xlim(0.0, hours[-1])
    hour_ticks(value, hours[-1], width)
    if title:
        headline(figure, f"{title}: {episode.outcome}")
    fit(figure, width)
    legend(figure, _legend(episode), width, 6)
    return save(figure, path)


def _services(panel: Axes, episode: RSOImagingEpisode, shown: Sequence[int]) -> None:
    """Draw the rows of the objects ``shown``, the first one on top."""
    row, last = {target: k for k, target in enumerate(shown)}, float(episode.decisions[-1])
    hours = (episode.decisions / HOUR).tolist()
    for target, k in row.items():
        dark = (episode.light[target] < LIGHT).tolist()
        spans = [(a, b - a) for (a, b), night in zip(pairwise(hours), dark, strict=False) if night]
        panel.broken_barh(spans, (k - 0.5 * NARROW, NARROW), facecolors=NIGHT, alpha=0.2, linewidth=0)
    images = zip(*(getattr(episode, name).tolist() for name in ("taken", "delivered", "imager", "target")), strict=True)
    for taken, delivered, imager, target in images:
        color, k = episode.colors[imager], row[target]
        begin, end = taken / HOUR, min(delivered, last) / HOUR
        panel.broken_barh([(begin, end - begin)], (k - 0.5 * WIDE, WIDE), facecolors=color, alpha=0.3, linewidth=0)
        panel.plot(begin, k, "o", color=color, markeredgecolor="white", markersize=6.0, zorder=4)
        if math.isfinite(delivered):
            panel.plot(end, k, "v", color=color, markeredgecolor="white", markersize=7.0, zorder=4)
    size = 9.0 if len(shown) <= 30 else 6.0
    panel.set_yticks(range(len(shown)), [str(episode.ids[target]) for target in shown], fontsize=size)
    panel.set_ylim(max(len(shown), 1) - 0.4, -0.6)
    panel.grid(axis="y", color=FAINT, linewidth=0.6)


def _legend(episode: RSOImagingEpisode) -> list[Artist]:
    names = [Line2D([], [], color=c, linewidth=2.0, label=name) for c, name in zip(episode.colors, episode.names, strict=True)]
    first = episode.colors[0] if len(names) == 1 else INK
    dark = bool((episode.light[episode.target.unique()] < LIGHT).any())
    there: list[tuple[bool, Artist]] = [
        (len(episode.taken) > 0, dot("o", first, "white", "image")),
        (len(episode.taken) > 0, Patch(color=first, alpha=0.3, label="on board")),
        (bool(torch.isfinite(episode.delivered).any()), dot("v", first, "white", "delivered")),
        (dark, Patch(color=NIGHT, alpha=0.2, label="object in eclipse")),
    ]
    return [*names, *(handle for shown, handle in there if shown)]
