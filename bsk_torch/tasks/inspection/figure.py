"""Figure of an inspection episode: paths around the RSO, its points, and inspected points and fuel over time."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from itertools import pairwise
from math import inf, isfinite
from pathlib import Path

import numpy as np
import torch
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Circle, Patch
from torch import Tensor
from typing_extensions import Self, override

from bsk_torch.astro.relative import rv2HN
from bsk_torch.recording.reading import Reading
from bsk_torch.recording.recording import Recording
from bsk_torch.recording.table import Columns
from bsk_torch.viz.episodes import Picture, TeamEpisode
from bsk_torch.viz.figures.style import FAINT, INK, PALETTE, WIDTH, caption, dot, finish, label, tidy
from bsk_torch.viz.figures.timeline import HOUR, NIGHT, hour_ticks
from bsk_torch.viz.render.closeup import DARK

__all__ = ["InspectionEpisode", "inspection_figure"]

HEIGHTS = (3.5, 3.2)
"""Heights of the paths, and of what is below them, inches."""

COLUMN_HEIGHTS = (3.5, 1.9)
"""These in a column of a paper."""

AXES = ("radial", "along the track", "orbit normal")
"""Axes of the Hill frame."""

VIEWS = ((1, 0, False), (1, 0, True), (1, 2, True))
"""Abscissa and ordinate of each projection of the paths, and whether it shows what is near the RSO."""

MARGIN = 1.08
"""Half the width of the projections, over the largest coordinate that they show."""

NEAR = 0.9
"""Part of the time that inspectors spend within the projections of what is near."""

SMALL, LARGE = 18.0, 90.0
"""Areas of the marks of the smallest and the largest maneuver, square points."""

COLORS = "viridis"
"""Colors of points by time."""

LIT, BLANK = "#9aa3af", "#ffffff"
"""Colors of points that were lit but not inspected, and of those that were never lit."""

ROUNDING = 1e-6
"""Difference, s, of times that are the same."""


@dataclass(frozen=True, kw_only=True)
class InspectionEpisode(TeamEpisode):
    """One episode of I inspectors and an RSO with P points, as tensors on the CPU; times in seconds since the reset.

    Attributes:
        path_times: Times of the paths' samples, ascending, [K].
        rho_H: Positions of the inspectors in the RSO's Hill frame then, m [I, K, 3]: radial, along the track, orbit normal.
        illumination: Fraction of the Sun that the RSO sees then, [K].
        fuel: Changes of velocity that the tanks were good for at the boundaries, before any maneuver, m/s [I, B].
        points: Directions of the points in the RSO's axes, [P, 3].
        lit_at: End of the step in which each was first lit, infinite for never, [P].
        inspected_at: End of the step in which each was first inspected, infinite for never, [P].
        completed: When the inspection was complete, infinite for never.
        reach: Largest distance, m, from which points are inspected; infinite without a limit.
    """

    path_times: Tensor
    rho_H: Tensor
    illumination: Tensor
    fuel: Tensor
    points: Tensor
    lit_at: Tensor
    inspected_at: Tensor
    completed: float
    reach: float

    @override
    @classmethod
    def of(cls, recording: Recording, track: int = 0) -> Self:
        reading = Reading(recording, track, viewers=True)
        flight, scene = reading.track, reading.scene
        assert scene.points_of is not None, "an inspection has an RSO"
        path_times = flight.attitude_start + flight.attitude_step * torch.arange(len(flight.arrays["sigma"])).double()
        fuel, marks = reading.values("fuel"), dict(zip(flight.marks, reading.array("mark_time").mT, strict=True))
        sunlit = [entry.name for entry in flight.series].index("sunlit")
        light = reading.array("series")[:, scene.points_of, sunlit]
        return cls(
            **cls.flown(reading),
            path_times=path_times,
            rho_H=_paths(reading.r_N(path_times, [scene.points_of, *reading.columns])),
            illumination=torch.from_numpy(np.interp(path_times, reading.array("series_times"), light)),
            fuel=torch.zeros(len(reading.names), len(reading.times), dtype=torch.float64)
            if fuel is None
            else fuel.squeeze(-1).nan_to_num(),
            points=torch.nn.functional.normalize(reading.of_scene("targets_P"), dim=1),
            lit_at=marks["lit"],
            inspected_at=marks["done"],
            completed=inf if flight.completed is None else flight.completed,
            reach=inf if scene.reach is None else scene.reach,
        )

    @property
    def colors(self) -> list[str]:
        """Color of each inspector."""
        return [PALETTE[k % len(PALETTE)] for k in range(len(self.names))]

    @property
    def samples(self) -> Tensor:
        """Sample of the paths at each of the decisions, [B]."""
        return torch.searchsorted(self.path_times, self.times - ROUNDING).clamp(max=len(self.path_times) - 1)

    @property
    def spent(self) -> Tensor:
        """Maneuver of each inspector at the beginning of each step, m/s [I, B - 1]."""
        return -self.fuel.diff()

    @property
    @override
    def outcome(self) -> str:
        inspected, lit = (int(torch.isfinite(at).sum()) for at in (self.inspected_at, self.lit_at))
        done = f"{inspected} of {lit} lit points inspected"
        end = f", complete after {self.completed / HOUR:.1f} h" if isfinite(self.completed) else ""
        dead = int(torch.isfinite(self.deaths).sum())
        died = "" if not dead else ", died" if len(self.names) == 1 else f", {dead} of {len(self.names)} died"
        return f"{done}{end}, {float(self.spent.sum()):.2f} m/s{died}"

    def to_numpy(self) -> Columns:
        """Return the episode as a table: a row for each inspector at each decision boundary, in the order of time.

        ``time`` is in seconds since reset and ``satellite`` the name. ``action`` is the task from then on, empty without one, and
        ``decided`` whether it began there; ``action_0`` and so on are its numbers. ``reward`` is that of the step that begins
        there. ``rho_H_0`` to ``rho_H_2`` are the position in the RSO's Hill frame, m, ``fuel`` is in m/s, ``illumination`` the
        fraction of the Sun that the RSO sees, and ``lit`` and ``inspected`` count its points. Numbers that belong to a step are
        nan in the last rows.
        """
        everyone, at = torch.ones(len(self.names), 1, dtype=torch.float64), self.samples
        lit, inspected = ((when.unsqueeze(1) <= self.times).sum(0) for when in (self.lit_at, self.inspected_at))
        numbers = {"rho_H": self.rho_H[:, at], "fuel": self.fuel, "illumination": everyone * self.illumination[at]}
        return self.table(numbers | {"lit": everyone * lit, "inspected": everyone * inspected})

    def extent(self, near: bool) -> float:
        """Return the largest coordinate of the paths while inspectors lived, or for :data:`NEAR` of that time."""
        alive = self.path_times <= self.deaths.unsqueeze(1)
        return float(torch.quantile(self.rho_H[alive].abs().amax(1), NEAR if near else 1.0))

    @override
    def pictures(self) -> list[Picture]:
        text = "Paths about the RSO with maneuvers, its points and when they were inspected, and points and fuel over time."
        return [Picture(partial(inspection_figure, self), text, "Paths about an RSO and a map of its points")]


def _paths(r_N: Tensor) -> Tensor:
    """Positions [I, K, 3] m relative to the first of I + 1 satellites at K times in N, [I + 1, K, 3] m, in its Hill frame."""
    r_C = r_N[0]
    # two positions span the plane of the orbit as position and velocity do
    ahead = torch.cat([r_C[1:] - r_C[:-1], r_C[-1:] - r_C[-2:-1]])
    return (rv2HN(r_C, ahead) @ (r_N[1:] - r_C).unsqueeze(-1)).squeeze(-1)


def inspection_figure(episode: InspectionEpisode, path: Path, title: str = "", width: float = WIDTH) -> Path:
    """Draw an episode to the file ``path``, .png, .svg or .pdf, with headline ``title`` unless that is empty.

    From top to bottom: the paths around the RSO in projections of its Hill frame, complete and near the RSO, with maneuvers; a
    map of its points, colored by the time of inspection; the numbers of lit and inspected points and the fuel over time.
    ``width`` is in inches, such as :data:`~bsk_torch.viz.figures.style.COLUMN`.
    """
    figure, paths, surface, (counts, fuel) = _arrange(width)
    for panel, (x, y, near) in zip(paths, VIEWS, strict=True):
        tidy(panel)
        draw_paths(panel, episode, x, y, near)
        caption(panel, "near the RSO" if near else "paths around the RSO")
        panel.set_xlabel(f"{AXES[x]}, m", color=INK, fontsize=9.5)
        panel.set_ylabel(f"{AXES[y]}, m", color=INK, fontsize=9.5, labelpad=0.0)
    _map(surface, episode, "inspected at, hours" + " since the start" * (width >= WIDTH))
    for panel in (counts, fuel):
        tidy(panel)
        _night(panel, episode)
    _counts(counts, episode)
    _fuel(fuel, episode)
    hour_ticks(fuel, float(episode.times[-1]) / HOUR, width)
    return finish(figure, path, title and f"{title}: {episode.outcome}", width, _legend(episode))


def _arrange(width: float) -> tuple[Figure, list[Axes], Axes, list[Axes]]:
    """Return a figure, and its panels of the projections, of the points, and of what changes over time.

    In a column of a paper, the points are next to the last projection, and what changes over time is below all.
    """
    narrow, heights = width < WIDTH, HEIGHTS if width >= WIDTH else COLUMN_HEIGHTS
    figure = Figure(figsize=(width, sum(heights) + (0.0 if narrow else 1.0)), dpi=140, layout="constrained", facecolor="white")
    above, below = figure.subfigures(2, 1, height_ratios=heights)  # type: ignore[misc]
    if narrow:
        paths = [above.add_subplot(2, 2, k) for k in (1, 2, 3)]
        surface, right = above.add_subplot(2, 2, 4, projection="mollweide"), below
    else:
        paths = list(above.subplots(1, 3))
        left, right = below.subfigures(1, 2)
        surface = left.add_subplot(projection="mollweide")
    return figure, paths, surface, list(right.subplots(2, 1, sharex=True, height_ratios=(1.5, 1.0)))


# -- paths -----------------------------------------------------------------------------------------------------------------------


def draw_paths(panel: Axes, episode: InspectionEpisode, x: int, y: int, near: bool) -> None:
    """Draw the paths around the RSO, with maneuvers, into a panel.

    Args:
        panel: The panel.
        episode: The episode.
        x: Axis of the Hill frame to the right: 0 radial, 1 along the track, 2 orbit normal.
        y: Axis upwards.
        near: Whether only what is near the RSO is shown.
    """
    most = MARGIN * max(1e-3, episode.extent(near))
    panel.set(xlim=(-most, most), ylim=(-most, most), aspect="equal")
    panel.grid(axis="both", color=FAINT, linewidth=0.6)
    if isfinite(episode.reach):
        panel.add_patch(Circle((0.0, 0.0), episode.reach, fill=False, edgecolor=INK, linewidth=0.8, linestyle=(0, (4, 3))))
    panel.plot(0.0, 0.0, "+", color=INK, markersize=9.0, zorder=6)
    largest = max(float(episode.spent.max()), 1e-12)
    for k, color in enumerate(episode.colors):
        alive = episode.path_times <= episode.deaths[k]
        rho = episode.rho_H[k, alive]
        panel.plot(rho[:, x], rho[:, y], color=color, linewidth=1.1, zorder=3)
        panel.plot(rho[0, x], rho[0, y], "o", color="white", markeredgecolor=color, markersize=6.0, zorder=5)
        marker, size = ("X", 9.0) if isfinite(float(episode.deaths[k])) else ("s", 6.0)
        panel.plot(rho[-1, x], rho[-1, y], marker, color=color, markeredgecolor="white", markersize=size, zorder=6)
        thrusts = episode.spent[k] > 0.0
        where = episode.rho_H[k, episode.samples[:-1][thrusts]]
        area = SMALL + (LARGE - SMALL) * episode.spent[k, thrusts] / largest
        panel.scatter(where[:, x], where[:, y], area, marker="^", color=color, edgecolors="white", linewidths=0.6, zorder=4)


# -- points ----------------------------------------------------------------------------------------------------------------------


def _map(panel: Axes, episode: InspectionEpisode, colors: str) -> None:
    """Draw the surface of the RSO as an equal-area map of directions in its axes, with a name for its ``colors``."""
    x, y, z = torch.nn.functional.normalize(episode.points, dim=1).unbind(1)
    longitude, latitude = torch.atan2(y, x), torch.asin(z.clamp(-1.0, 1.0))
    inspected = torch.isfinite(episode.inspected_at)
    lit = torch.isfinite(episode.lit_at) & ~inspected
    for rows, color in ((~inspected & ~lit, BLANK), (lit, LIT)):
        panel.scatter(longitude[rows], latitude[rows], 26.0, color=color, edgecolors=LIT, linewidths=0.7, zorder=3)
    hours = episode.inspected_at[inspected] / HOUR
    last = float(episode.path_times[-1]) / HOUR
    shown = panel.scatter(longitude[inspected], latitude[inspected], 34.0, c=hours, cmap=COLORS, vmin=0.0, vmax=last, zorder=4)
    panel.set_xticks([])
    panel.set_yticks([])
    panel.grid(False)
    for spine in panel.spines.values():
        spine.set_color(FAINT)
    bar = panel.figure.colorbar(shown, ax=panel, orientation="horizontal", shrink=0.7, aspect=30, pad=0.03)
    bar.outline.set_visible(False)
    bar.ax.tick_params(colors=INK, labelsize=8.5, length=3)
    bar.set_label(colors, color=INK, fontsize=9)
    caption(panel, "points of the RSO, in its axes")


# -- over time -------------------------------------------------------------------------------------------------------------------


def _night(panel: Axes, episode: InspectionEpisode) -> None:
    hours = (episode.path_times / HOUR).tolist()
    dark = (episode.illumination < DARK).tolist()
    edges = [0, *(k for k in range(1, len(dark)) if dark[k] != dark[k - 1]), len(dark) - 1]
    for begin, end in pairwise(edges):
        if dark[begin] and begin < end:
            panel.axvspan(hours[begin], hours[end], color=NIGHT, alpha=0.12, linewidth=0)


def _counts(panel: Axes, episode: InspectionEpisode) -> None:
    hours, last = (episode.times / HOUR).tolist(), len(episode.points)
    for at, color, width in ((episode.lit_at, LIT, 1.5), (episode.inspected_at, INK, 1.8)):
        count = (at <= episode.times.unsqueeze(1)).sum(1).tolist()
        panel.step(hours, count, where="post", color=color, linewidth=width)
    if isfinite(episode.completed):
        panel.axvline(episode.completed / HOUR, color=PALETTE[2], linewidth=1.2, linestyle=(0, (2, 2)))
    panel.set_ylim(0.0, 1.05 * last)
    label(panel, "points")


def _fuel(panel: Axes, episode: InspectionEpisode) -> None:
    hours = (episode.times / HOUR).tolist()
    for k, color in enumerate(episode.colors):
        # maneuvers are made at the beginning of a step
        panel.step(hours, episode.fuel[k].tolist(), where="pre", color=color, linewidth=1.6)
        if isfinite(death := float(episode.deaths[k])):
            where = int(torch.searchsorted(episode.times, episode.deaths[k]).clamp(max=len(hours) - 1))
            panel.plot(death / HOUR, float(episode.fuel[k, where]), "X", color=color, markeredgecolor="white", markersize=9.0)
    panel.set_ylim(0.0, 1.08 * max(float(episode.fuel.max()), 1e-9))
    panel.set_xlim(0.0, 1.01 * hours[-1])
    label(panel, "fuel, m/s")


def _legend(episode: InspectionEpisode) -> list[Artist]:
    names = [Line2D([], [], color=c, linewidth=2.0, label=name) for c, name in zip(episode.colors, episode.names, strict=True)]
    first = episode.colors[0] if len(names) == 1 else INK
    dead = torch.isfinite(episode.deaths)
    entries: list[tuple[bool, Artist]] = [
        (True, dot("o", "white", first, "start")),
        (not bool(dead.all()), dot("s", first, "white", "end")),
        (bool(dead.any()), dot("X", first, "white", "died")),
        (bool((episode.spent > 0.0).any()), dot("^", first, "white", "maneuver")),
        (
            isfinite(episode.reach),
            Line2D([], [], color=INK, linewidth=0.8, linestyle=(0, (4, 3)), label="reach of the instrument"),
        ),
        (True, Line2D([], [], color=INK, linewidth=1.8, label="points inspected")),
        (True, Line2D([], [], color=LIT, linewidth=1.5, marker="o", markersize=5.0, label="points lit")),
        (isfinite(episode.completed), Line2D([], [], color=PALETTE[2], linewidth=1.2, linestyle=(0, (2, 2)), label="complete")),
        (bool((episode.illumination < DARK).any()), Patch(color=NIGHT, alpha=0.12, label="eclipse")),
    ]
    return [*names, *(handle for shown, handle in entries if shown)]
