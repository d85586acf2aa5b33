"""Figure of an episode of a constellation: ground tracks, images, contacts and tasks."""

from __future__ import annotations

from dataclasses import dataclass
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
from typing_extensions import Self, override

from bsk_torch._text import visible
from bsk_torch.recording.reading import Reading
from bsk_torch.recording.recording import Recording
from bsk_torch.recording.table import Columns
from bsk_torch.viz.episodes import Picture, TeamEpisode
from bsk_torch.viz.figures.style import FAINT, INK, PALETTE, SMALLER, WIDTH, caption, dot, finish, tidy
from bsk_torch.viz.figures.timeline import HOUR, hour_ticks, plain
from bsk_torch.viz.figures.world import ground, pieces, world_map

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

GREY = "#9aa3af"

TARGET: dict[str, Any] = dict(color="white", markeredgecolor=GREY, markeredgewidth=0.5)

HALO = [patheffects.withStroke(linewidth=2.2, foreground="white")]


@dataclass(frozen=True, kw_only=True)
class ConstellationEpisode(TeamEpisode):
    """One episode of S satellites, as tensors on the CPU; angles in degrees. Tracks, tasks and contacts end with a death.

    Attributes:
        latitude: Latitudes of the subsatellite points at the boundaries, [S, B].
        longitude: Longitudes, within 180 degrees, [S, B].
        groups: Index of the satellite's orbital plane, [S] int64; None for separate groups.
        links: Satellites in contact at the boundaries, [B, S, S] bool; None if they never are.
        image_times: Times of all I images, [I].
        image_satellite: Satellite of each image, [I] int64.
        image_latitude: Latitude of each image, [I].
        image_longitude: Longitude of each image, [I].
        image_paid: Whether each image was rewarded, [I] bool.
        target_latitude: Latitudes of all T targets, [T].
        target_longitude: Longitudes of all targets, [T].
    """

    latitude: Tensor
    longitude: Tensor
    groups: Tensor | None
    links: Tensor | None
    image_times: Tensor
    image_satellite: Tensor
    image_latitude: Tensor
    image_longitude: Tensor
    image_paid: Tensor
    target_latitude: Tensor
    target_longitude: Tensor

    @override
    @classmethod
    def of(cls, recording: Recording, track: int = 0) -> Self:
        reading, on_ground = Reading(recording, track), recording.places == "ground"
        longitude, latitude = ground(reading.array("step_r_P")[:, reading.columns].transpose(0, 1))
        time, who, target, kind = reading.events
        images = torch.nonzero((kind <= 1) & on_ground).flatten()
        east, north = ground(reading.of_scene("targets_P"))
        return cls(
            **cls.flown(reading),
            latitude=latitude,
            longitude=longitude,
            groups=torch.tensor(reading.scene.planes)[reading.columns] if reading.scene.planes else None,
            links=reading.links,
            image_times=time[images],
            image_satellite=who[images],
            image_latitude=north[target[images]],
            image_longitude=east[target[images]],
            image_paid=kind[images] == 0,
            target_latitude=north[torch.isfinite(north) & on_ground],
            target_longitude=east[torch.isfinite(east) & on_ground],
        )

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
        return self.names[group] if self.groups is None else f"plane {group + 1}"

    @property
    def ends(self) -> Tensor:
        """Time at which each satellite died or the episode ended, [S]."""
        return self.deaths.clamp(max=float(self.times[-1]))

    @property
    def died(self) -> Tensor:
        """Mask of satellites that died within the episode, [S]."""
        return self.deaths <= self.times[-1]

    @property
    @override
    def outcome(self) -> str:
        images, dead = len(self.image_times), int(self.died.sum())
        survived = f", {dead} of {self.size} satellites died" if dead else ""
        return f"{images} image{'s' * (images != 1)} by {self.size} satellite{'s' * (self.size != 1)}{survived}"

    def to_numpy(self) -> Columns:
        """Return the episode as a table: a row for each satellite at each decision boundary of any of them, in the order of time.

        ``time`` is in seconds since reset and ``satellite`` the name. ``action`` is the task on which the satellite works from
        then on, empty without one, and ``decided`` whether it began there. ``reward`` is that of the step that begins there, nan
        in the last one. ``latitude`` and ``longitude`` are in degrees. Quantities of several numbers have a column for each.
        """
        return self.table({**self.series, "latitude": self.latitude, "longitude": self.longitude})

    @override
    def pictures(self) -> list[Picture]:
        text = "Ground tracks and images of all satellites, contacts at the moment of most contacts, and tasks over time."
        return [Picture(partial(constellation_figure, self), text, "World map with ground tracks", "constellation")]

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
    return finish(figure, path, title and f"{title}: {episode.outcome}", width, handles)


def _clock(seconds: float) -> str:
    return f"{int(seconds // 3600)}:{int(seconds % 3600 // 60):02d} h"


# -- the world -------------------------------------------------------------------------------------------------------------------


def _world(panel: Axes, episode: ConstellationEpisode, width: float) -> list[Artist]:
    world_map(panel, width)
    panel.set_anchor("C")
    panel.plot(episode.target_longitude, episode.target_latitude, "o", markersize=1.8, zorder=1.5, **TARGET)
    now = float(episode.times[episode.moment])
    for k, color in enumerate(episode.colors):
        _track(panel, episode, k, color, now)
    _images_on_map(panel, episode)
    _links(panel, episode)
    _satellites(panel, episode, CLOSE if width >= WIDTH else CLOSE * SMALLER * WIDTH / width)
    contents = ", images" * bool(len(episode.image_times)) + ", and contacts" * (episode.links is not None)
    caption(
        panel,
        f"ground tracks{contents}; satellites at {_clock(now)}, bold is where they flew in the {TAIL / 60.0:.0f} minutes before",
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
    for rows, paid in ((~episode.image_paid, False), (episode.image_paid, True)):
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
    k, places = episode.moment, list[tuple[float, float]]()
    for s in torch.nonzero(episode.ends >= episode.times[k]).flatten().tolist():
        x, y = float(episode.longitude[s, k]), float(episode.latitude[s, k])
        panel.plot(x, y, "o", color="white", markeredgecolor=episode.colors[s], markeredgewidth=2.0, markersize=6.5, zorder=6)
        if all((x - u) ** 2 + (y - v) ** 2 > close**2 for u, v in places):
            places.append((x, y))
            text = panel.annotate(
                episode.names[s], (x, y), (0, 5), textcoords="offset points", ha="center", color=INK, fontsize=7.5
            )
            text.set(path_effects=HALO, zorder=7)


def _world_legend(episode: ConstellationEpisode) -> list[Artist]:
    """Groups, unless there are so many that colors repeat, and markers that are on the map."""
    groups = sorted(set(episode.group))
    lines = [Line2D([], [], color=PALETTE[g % len(PALETTE)], linewidth=2.2, label=episode.group_name(g)) for g in groups]
    markers = [
        (bool(episode.image_paid.any()), dot("o", INK, "white", "image taken")),
        (bool((~episode.image_paid).any()), dot("o", "white", INK, "image without reward")),
        (len(episode.target_latitude) > 0, Line2D([], [], linestyle="", marker="o", markersize=2.5, label="target", **TARGET)),
        (bool(episode.contacts[episode.moment].any()), Line2D([], [], color=INK, linewidth=0.8, alpha=0.7, label="contact")),
    ]
    return [*(lines if len(groups) <= len(PALETTE) else []), *(handle for present, handle in markers if present)]


# -- over time -------------------------------------------------------------------------------------------------------------------


def _rows(panel: Axes, episode: ConstellationEpisode) -> list[Artist]:
    hours = (episode.times / HOUR).tolist()
    panel.set(xlim=(hours[0], hours[-1]), ylim=(episode.size - 0.5, -0.5))
    panel.grid(False)
    panel.set_yticks(range(episode.size), [visible(name) for name in episode.names], fontsize=8.5 if episode.size <= 24 else 6.5)
    panel.tick_params(axis="y", length=0)
    for text, color in zip(panel.get_yticklabels(), episode.colors, strict=True):
        text.set_color(color)
    panel.axvline(hours[episode.moment], color=INK, linewidth=0.9, linestyle=(0, (2, 2)), zorder=5)
    _images_over_time(panel, episode)
    images, unpaid = len(episode.image_times) > 0, not bool(episode.image_paid.all())
    ticks = ", ticks are images" * images + " (short ones without reward)" * unpaid
    caption(panel, f"tasks of each satellite{ticks}; dashed is the moment of the map")
    return [*_tasks(panel, episode), *_contacts(panel, episode), *_deaths(panel, episode)]


def _tasks(panel: Axes, episode: ConstellationEpisode) -> list[Artist]:
    colors, handles = cycle(OTHER_TASKS), list[Artist]()
    for kind, name in enumerate(episode.tasks.names):
        color, done = TASKS.get(plain(name)) or next(colors), episode.tasks.kind == kind
        for s in episode.tasks.satellite[done].unique().tolist():
            spans = episode.tasks.spans[done & (episode.tasks.satellite == s)].clamp(max=float(episode.ends[s])) / HOUR
            bars = torch.stack([spans[:, 0], spans.diff().squeeze(-1)], -1).tolist()
            panel.broken_barh(bars, (s + BAR[0], BAR[1] - BAR[0]), facecolors=color, linewidth=0)
        if bool(done.any()):
            handles.append(Patch(color=color, label=plain(name)))
    return handles


def _images_over_time(panel: Axes, episode: ConstellationEpisode) -> None:
    """A tick for every image, short and gray for those without reward."""
    for rows, paid in ((~episode.image_paid, False), (episode.image_paid, True)):
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
        strip = contacts[:-1, s : s + 1].mT.tolist()
        panel.pcolormesh((episode.times / HOUR).tolist(), [s + STRIP[0], s + STRIP[1]], strip, cmap=shades, vmin=0, vmax=most)
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
