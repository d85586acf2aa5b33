"""Figure of an episode of a constellation: ground tracks, images, contacts and tasks."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from itertools import cycle
from pathlib import Path
from typing import Any

import torch
from matplotlib import patheffects
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.colors import ListedColormap, to_rgba
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from torch import Tensor

from bsk_torch._text import visible
from bsk_torch.viz.figures.style import FAINT, INK, PALETTE, SMALLER, WIDTH, caption, dot, fit, headline, legend, save, tidy
from bsk_torch.viz.figures.timeline import HOUR, hour_ticks, plain
from bsk_torch.viz.figures.world import pieces, world_map
from bsk_torch.viz.table import Columns, Tabular, Tasks, satellite_columns

__all__ = ["ConstellationEpisode", "constellation_figure"]

TAIL = 900.0
"""Time before that of the map for which tracks are drawn bold, s."""

MAP_HEIGHT, ROW_HEIGHT, ALL_ROWS = 4.35, 0.27, (1.2, 9.0)
"""Heights of the map and of a satellite's row, and minimum and maximum height of all rows together, inches."""

BAR, STRIP = (-0.36, 0.22), (0.28, 0.39)
"""Positions of tasks and contacts in a row of height 1, from the top down."""

CLOSE = 7.0
"""Angle in degrees on the map below which neighboring satellites share a label."""

TASKS = {
    "image": "#dbe4f0",
    "scan": "#dbe4f0",
    "charge": "#f8dd9c",
    "downlink": "#bce3cf",
    "desat": "#dccff0",
    "drift": "#eceef1",
}
"""Colors of tasks, light enough for images to stand out."""

OTHER_TASKS = ("#cfe8ef", "#ecd9c6", "#f3cdd9", "#dfe3c4")

NONE, NO_INDEX, NO_SPANS = partial(torch.empty, 0), partial(torch.empty, 0, dtype=torch.int64), partial(torch.empty, 0, 2)

GREY = "#9aa3af"

TARGET: dict[str, Any] = dict(color="white", markeredgecolor=GREY, markeredgewidth=0.5)

HALO = [patheffects.withStroke(linewidth=2.2, foreground="white")]


@dataclass(frozen=True, kw_only=True)
class ConstellationEpisode(Tabular):
    """One episode of S satellites, as plain tensors on the CPU; angles in degrees, times in seconds since the reset.

    Attributes:
        names: Names of the satellites.
        times: Times of the tracks' samples, ascending, [K].
        latitude: Latitudes of the subsatellite points at these times, [S, K].
        longitude: Longitudes, within 180 degrees, [S, K].
        groups: Index of the satellite's group, such as its orbital plane, [S] int64; None for separate groups.
        group_names: Names of the groups; None for "plane 1" and so on, or the satellites' names.
        links: Satellites in contact at the tracks' times, [K, S, S] bool; None if they never are.
        image_times: Times of all images, [I].
        image_satellite: Satellite of each image, [I] int64.
        image_latitude: Latitude of each image, [I].
        image_longitude: Longitude of each image, [I].
        image_paid: Whether each image was rewarded, [I] bool; None for all.
        target_latitude: Latitudes of all targets, [T].
        target_longitude: Longitudes of all targets, [T].
        task_satellite: Satellite of each of M tasks, [M] int64.
        task_spans: Start and end of each task, [M, 2].
        task_kind: Kind of each task, an index into ``task_names``, [M] int64.
        task_names: Names of tasks, such as "image", "charge" and "drift"; a prefix ``action_`` is dropped.
        deaths: Time of each satellite's death, infinite for survivors, [S]; None if all survived. Tracks, tasks and contacts are
            drawn until then.
        rewards: Reward of each satellite's agent in the steps between ``times``, [S, K - 1]; nan for further satellites of the
            same agent.
        series: Quantities of the satellites at ``times`` by name, [S, K, width]; nan where a satellite has no such quantity.
        actions: Continuous actions in the steps between ``times``, [S, K - 1, A]; nan for none. None without such actions.
    """

    names: Sequence[str]
    times: Tensor
    latitude: Tensor
    longitude: Tensor
    groups: Tensor | None = None
    group_names: Sequence[str] | None = None
    links: Tensor | None = None
    image_times: Tensor = field(default_factory=NONE)
    image_satellite: Tensor = field(default_factory=NO_INDEX)
    image_latitude: Tensor = field(default_factory=NONE)
    image_longitude: Tensor = field(default_factory=NONE)
    image_paid: Tensor | None = None
    target_latitude: Tensor = field(default_factory=NONE)
    target_longitude: Tensor = field(default_factory=NONE)
    task_satellite: Tensor = field(default_factory=NO_INDEX)
    task_spans: Tensor = field(default_factory=NO_SPANS)
    task_kind: Tensor = field(default_factory=NO_INDEX)
    task_names: Sequence[str] = ()
    deaths: Tensor | None = None
    rewards: Tensor | None = None
    series: Mapping[str, Tensor] = field(default_factory=dict)
    actions: Tensor | None = None

    def __post_init__(self) -> None:
        """Raise ValueError for tensors with inconsistent shapes or indices."""
        s, k, images, targets, tasks = (
            self.size,
            len(self.times),
            len(self.image_times),
            len(self.target_latitude),
            len(self.task_kind),
        )
        needed = {
            "latitude": (s, k),
            "longitude": (s, k),
            "groups": (s,),
            "links": (k, s, s),
            "deaths": (s,),
            "rewards": (s, k - 1),
        }
        needed |= dict.fromkeys(("image_satellite", "image_latitude", "image_longitude", "image_paid"), (images,))
        needed |= {"target_longitude": (targets,), "task_satellite": (tasks,), "task_spans": (tasks, 2), "rewards": (s, k - 1)}
        for name, shape in needed.items():
            value = getattr(self, name)
            if value is not None and tuple(value.shape) != shape:
                raise ValueError(f"{name} has shape {list(value.shape)}; it must be {list(shape)}")
        if k < 2:
            raise ValueError(f"times has {k} entries; a track needs at least 2")
        below = {"image_satellite": s, "task_satellite": s, "task_kind": len(self.task_names)}
        if self.group_names is not None:
            below["groups"] = len(self.group_names)
        for name, bound in below.items():
            value = getattr(self, name)
            if value is not None and bool(((value < 0) | (value >= bound)).any()):
                raise ValueError(f"{name} has numbers from {int(value.min())} to {int(value.max())}; allowed is 0 to {bound - 1}")

    @property
    def size(self) -> int:
        """Number of satellites."""
        return len(self.names)

    @property
    def group(self) -> list[int]:
        """Group of each satellite."""
        return list(range(self.size)) if self.groups is None else self.groups.tolist()

    @property
    def colors(self) -> list[str]:
        """Color of each satellite."""
        return [PALETTE[k % len(PALETTE)] for k in self.group]

    def group_name(self, group: int) -> str:
        """Return the name of a group."""
        if self.group_names is not None:
            return self.group_names[group]
        return self.names[group] if self.groups is None else f"plane {group + 1}"

    @property
    def ends(self) -> Tensor:
        """Time at which each satellite died or the episode ended, [S]."""
        last = self.times[-1].expand(self.size)
        return last if self.deaths is None else torch.minimum(self.deaths.to(last), last)

    @property
    def died(self) -> Tensor:
        """Mask of satellites that died within the episode, [S]."""
        return torch.zeros(self.size, dtype=torch.bool) if self.deaths is None else self.deaths <= self.times[-1]

    @property
    def outcome(self) -> str:
        """Numbers of images and of dead satellites, as text."""
        images, dead = len(self.image_times), int(self.died.sum())
        survived = f", {dead} of {self.size} satellites died" if dead else ""
        return f"{images} image{'s' * (images != 1)} by {self.size} satellite{'s' * (self.size != 1)}{survived}"

    def to_numpy(self) -> Columns:
        """Return the episode as a table: a row for each satellite at each decision boundary of any of them, in the order of time.

        ``time`` is in seconds since reset and ``satellite`` the name. ``action`` is the task on which the satellite works from
        then on, empty without one, and ``decided`` whether it began there. ``reward`` is that of the step that begins there, nan
        in the last one. ``latitude`` and ``longitude`` are in degrees. Quantities of several numbers have a column for each.
        """
        numbers = {"reward": self.rewards, "action": self.actions, **self.series}
        numbers |= {"latitude": self.latitude, "longitude": self.longitude}
        there = {name: values for name, values in numbers.items() if values is not None}
        deaths = torch.full((self.size,), torch.inf) if self.deaths is None else self.deaths
        tasks = Tasks(self.task_satellite, self.task_spans, self.task_kind, self.task_names)
        return satellite_columns(self.names, self.times, deaths, tasks, there)

    @property
    def paid(self) -> Tensor:
        """Mask of rewarded images, [I]."""
        return torch.ones(len(self.image_times), dtype=torch.bool) if self.image_paid is None else self.image_paid

    @property
    def contacts(self) -> Tensor:
        """Mask of living satellites that are in contact, in either direction, [K, S, S]."""
        if self.links is None:
            return torch.zeros(len(self.times), self.size, self.size, dtype=torch.bool)
        lives = self.times.unsqueeze(-1) <= self.ends
        both = lives.unsqueeze(-1) & lives.unsqueeze(-2) & ~torch.eye(self.size, dtype=torch.bool)
        return (self.links | self.links.mT) & both

    @property
    def moment(self) -> int:
        """Index of the sample shown on the map: the last with the most contacts, or the last of all."""
        total = self.contacts.sum((-1, -2))
        return len(total) - 1 - int(total.flip(0).argmax())


def constellation_figure(episode: ConstellationEpisode, path: Path, title: str = "", width: float = WIDTH) -> Path:
    """Draw an episode to the file ``path``, .png, .svg or .pdf, with headline ``title`` unless that is empty.

    From above: the world with all ground tracks, images, and the satellites with their contacts at the moment of most contacts;
    and for each satellite a row over time with tasks, images, contacts and, where it died, when. ``width`` is in inches, such as
    :data:`~bsk_torch.viz.figures.style.COLUMN`.
    """
    narrow, height = width < WIDTH, MAP_HEIGHT * width / WIDTH
    rows = (SMALLER if narrow else 1.0) * min(max(ALL_ROWS[0], ROW_HEIGHT * episode.size), ALL_ROWS[1])
    figure = Figure(figsize=(width, height + rows + (1.2 if narrow else 2.0)), dpi=140, facecolor="white")
    figure.set_layout_engine("constrained", h_pad=0.06)
    world, rows_panel = figure.subplots(2, 1, height_ratios=(height, rows))
    for panel in (world, rows_panel):
        tidy(panel)
    handles = [*_world(world, episode, width), *_rows(rows_panel, episode)]
    hour_ticks(rows_panel, float(episode.times[-1] - episode.times[0]) / HOUR, width)
    if title:
        headline(figure, f"{title}: {episode.outcome}")
    fit(figure, width)
    legend(figure, handles, width)
    return save(figure, path)


def _clock(seconds: float) -> str:
    return f"{int(seconds // 3600)}:{int(seconds % 3600 // 60):02d} h"


# -- the world -------------------------------------------------------------------------------------------------------------------


def _world(panel: Axes, episode: ConstellationEpisode, width: float) -> list[Artist]:
    """Draw the map; entries for the legend."""
    world_map(panel, width)
    panel.set_anchor("C")
    panel.plot(episode.target_longitude, episode.target_latitude, "o", markersize=1.8, zorder=1.5, **TARGET)
    now = float(episode.times[episode.moment])
    for k, color in enumerate(episode.colors):
        _track(panel, episode, k, color, now)
    _images_on_map(panel, episode)
    _links(panel, episode)
    _satellites(panel, episode, CLOSE if width >= WIDTH else CLOSE * SMALLER * WIDTH / width)
    shown = ", images" * bool(len(episode.image_times)) + ", and contacts" * (episode.links is not None)
    caption(
        panel,
        f"ground tracks{shown}; satellites at {_clock(now)}, bold is where they flew in the {TAIL / 60.0:.0f} minutes before",
    )
    return _world_legend(episode)


def _track(panel: Axes, episode: ConstellationEpisode, k: int, color: str, now: float) -> None:
    """The track of satellite ``k`` while it lived, bold shortly before ``now``."""
    alive, end = episode.times[1:] <= episode.ends[k], episode.times[1:]
    lines = pieces(episode.longitude[k], episode.latitude[k])
    bold = alive & (end > now - TAIL) & (end <= now)
    for rows, width, alpha, layer in ((alive, 0.7, 0.4, 2), (bold, 2.2, 0.9, 3)):
        panel.add_collection(LineCollection(lines[rows].tolist(), color=color, linewidth=width, alpha=alpha, zorder=layer))


def _images_on_map(panel: Axes, episode: ConstellationEpisode) -> None:
    """Dots in the satellite's color, hollow for images without reward."""
    for rows, paid in ((~episode.paid, False), (episode.paid, True)):
        colors = [episode.colors[k] for k in episode.image_satellite[rows].tolist()]
        face, edge, width = (colors, "white", 0.5) if paid else ("white", colors, 1.0)
        where = episode.image_longitude[rows].tolist(), episode.image_latitude[rows].tolist()
        panel.scatter(*where, 15.0, facecolors=face, edgecolors=edge, linewidths=width, zorder=4)


def _links(panel: Axes, episode: ConstellationEpisode) -> None:
    """Great circles between the satellites that are in contact at the moment of the map."""
    pairs = torch.nonzero(torch.triu(episode.contacts[episode.moment]))
    latitude, longitude = episode.latitude[:, episode.moment], episode.longitude[:, episode.moment]
    alpha = 0.7 / max(1.0, 0.5 * len(pairs) / episode.size) ** 0.5  # many lines are paler
    for i, j in pairs.tolist():
        path = great_circle(latitude[[i, j]], longitude[[i, j]])
        panel.add_collection(LineCollection(pieces(*path).tolist(), color=INK, linewidth=0.8, alpha=alpha, zorder=4.5))


def great_circle(latitude: Tensor, longitude: Tensor, points: int = 90) -> tuple[Tensor, Tensor]:
    """Longitude and latitude, degrees [points], of the shorter great circle between two places, degrees [2]."""
    latitude, longitude = torch.deg2rad(latitude.double()), torch.deg2rad(longitude.double())
    c = torch.cos(latitude)
    a, b = torch.stack([c * torch.cos(longitude), c * torch.sin(longitude), torch.sin(latitude)], -1)
    share = torch.linspace(0.0, 1.0, points, dtype=torch.float64).unsqueeze(-1)
    x, y, z = ((1.0 - share) * a + share * b).unbind(-1)
    return torch.rad2deg(torch.atan2(y, x)), torch.rad2deg(torch.atan2(z, torch.hypot(x, y)))


def _satellites(panel: Axes, episode: ConstellationEpisode, close: float) -> None:
    """Dots where the satellites that live are at the moment of the map, with names of those not ``close``, degrees, to others."""
    k, named = episode.moment, list[tuple[float, float]]()
    for s in torch.nonzero(episode.ends >= episode.times[k]).flatten().tolist():
        x, y = float(episode.longitude[s, k]), float(episode.latitude[s, k])
        panel.plot(x, y, "o", color="white", markeredgecolor=episode.colors[s], markeredgewidth=2.0, markersize=6.5, zorder=6)
        if all((x - u) ** 2 + (y - v) ** 2 > close**2 for u, v in named):
            named.append((x, y))
            text = panel.annotate(
                episode.names[s], (x, y), (0, 5), textcoords="offset points", ha="center", color=INK, fontsize=7.5
            )
            text.set(path_effects=HALO, zorder=7)


def _world_legend(episode: ConstellationEpisode) -> list[Artist]:
    """Groups, unless there are so many that colors repeat, and markers that are on the map."""
    groups = sorted(set(episode.group))
    lines = [Line2D([], [], color=PALETTE[g % len(PALETTE)], linewidth=2.2, label=episode.group_name(g)) for g in groups]
    markers = [
        (bool(episode.paid.any()), dot("o", INK, "white", "image taken")),
        (bool((~episode.paid).any()), dot("o", "white", INK, "image without reward")),
        (len(episode.target_latitude) > 0, Line2D([], [], linestyle="", marker="o", markersize=2.5, label="target", **TARGET)),
        (bool(episode.contacts[episode.moment].any()), Line2D([], [], color=INK, linewidth=0.8, alpha=0.7, label="contact")),
    ]
    return [*(lines if len(groups) <= len(PALETTE) else []), *(handle for shown, handle in markers if shown)]


# -- over time -------------------------------------------------------------------------------------------------------------------


def _rows(panel: Axes, episode: ConstellationEpisode) -> list[Artist]:
    """Draw a row for each satellite; entries for the legend."""
    hours = (episode.times / HOUR).tolist()
    panel.set(xlim=(hours[0], hours[-1]), ylim=(episode.size - 0.5, -0.5))
    panel.grid(False)
    panel.set_yticks(range(episode.size), [visible(name) for name in episode.names], fontsize=8.5 if episode.size <= 24 else 6.5)
    panel.tick_params(axis="y", length=0)
    for text, color in zip(panel.get_yticklabels(), episode.colors, strict=True):
        text.set_color(color)
    panel.axvline(hours[episode.moment], color=INK, linewidth=0.9, linestyle=(0, (2, 2)), zorder=5)
    _images_over_time(panel, episode)
    caption(panel, f"tasks of each satellite{_ticks(episode)}; dashed is the moment of the map")
    return [*_tasks(panel, episode), *_contacts(panel, episode), *_deaths(panel, episode)]


def _ticks(episode: ConstellationEpisode) -> str:
    if not len(episode.image_times):
        return ""
    return ", ticks are images" if bool(episode.paid.all()) else ", ticks are images (short ones without reward)"


def _tasks(panel: Axes, episode: ConstellationEpisode) -> list[Artist]:
    others, handles = cycle(OTHER_TASKS), list[Artist]()
    for kind, name in enumerate(episode.task_names):
        color, done = TASKS.get(plain(name)) or next(others), episode.task_kind == kind
        for s in episode.task_satellite[done].unique().tolist():
            spans = episode.task_spans[done & (episode.task_satellite == s)].clamp(max=float(episode.ends[s])) / HOUR
            bars = torch.stack([spans[:, 0], spans.diff().squeeze(-1)], -1).tolist()
            panel.broken_barh(bars, (s + BAR[0], BAR[1] - BAR[0]), facecolors=color, linewidth=0)
        if bool(done.any()):
            handles.append(Patch(color=color, label=plain(name)))
    return handles


def _images_over_time(panel: Axes, episode: ConstellationEpisode) -> None:
    """A tick for every image, short and gray for those without reward."""
    for rows, paid in ((~episode.paid, False), (episode.paid, True)):
        who, hours = episode.image_satellite[rows].tolist(), (episode.image_times[rows] / HOUR).tolist()
        low = BAR[0] if paid else 0.5 * sum(BAR)
        ticks = [[(hour, s + low), (hour, s + BAR[1])] for s, hour in zip(who, hours, strict=True)]
        color = [episode.colors[s] for s in who] if paid else GREY
        panel.add_collection(LineCollection(ticks, color=color, linewidth=1.2, zorder=4))


def _contacts(panel: Axes, episode: ConstellationEpisode) -> list[Artist]:
    """A strip below the tasks, the darker the more others a satellite is in contact with."""
    contacts = episode.contacts.sum(-1)
    most = int(contacts.max())
    if most == 0:
        return []
    shades = ListedColormap([to_rgba(INK, 0.0), *(to_rgba(INK, 0.15 + 0.6 * k / most) for k in range(1, most + 1))])
    for s in range(episode.size):
        seen = contacts[:-1, s : s + 1].mT.tolist()
        panel.pcolormesh((episode.times / HOUR).tolist(), [s + STRIP[0], s + STRIP[1]], seen, cmap=shades, vmin=0, vmax=most)
    return [Patch(color=INK, alpha=0.5, linewidth=0, label=f"in contact with others (darkest: {most})")]


def _deaths(panel: Axes, episode: ConstellationEpisode) -> list[Artist]:
    dead = torch.nonzero(episode.died).flatten()
    if not len(dead):
        return []
    look: dict[str, Any] = dict(color=PALETTE[3], marker="X", markeredgecolor="white", markersize=9.0, linestyle="")
    panel.plot((episode.ends[dead] / HOUR).tolist(), dead.tolist(), zorder=6, **look)
    for s in dead.tolist():
        panel.plot([float(episode.ends[s]) / HOUR, float(episode.times[-1]) / HOUR], [s, s], ":", color=FAINT, zorder=0)
    return [Line2D([], [], label="died", **look)]
