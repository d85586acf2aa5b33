"""Figure of an episode of an imaging policy: ground track, images, and decisions over time."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from itertools import cycle
from pathlib import Path

import numpy as np
import torch
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.colors import LinearSegmentedColormap
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.ticker import FuncFormatter, MultipleLocator, PercentFormatter
from torch import Tensor
from typing_extensions import Self, override

from bsk_torch.constants import R_EARTH
from bsk_torch.recording.reading import Reading
from bsk_torch.recording.recording import Recording
from bsk_torch.viz.episodes import Picture
from bsk_torch.viz.figures.style import (
    INK,
    PALETTE,
    WIDTH,
    caption,
    dot,
    fit,
    headline,
    label,
    legend,
    name_lines,
    save,
    share,
    tidy,
)
from bsk_torch.viz.figures.timeline import HOUR, TrackEpisode, bars, plain, shade, shade_legend, time_axis
from bsk_torch.viz.figures.world import ground, pieces, world_map

__all__ = ["ImagingEpisode", "ground_track"]

NONE = -1
"""Target of a decision that does something else."""

OPEN, LOST, UNPAID, IMAGED = range(4)
"""Outcomes of a target: not chosen; chosen, but not imaged; imaged without reward; imaged."""

CLOSE_UP = 600.0
"""Seconds of flight drawn large."""

SHOULDER = 30.0
"""Seconds of these before the first image and after the last."""

KM = R_EARTH / 1e3
"""Kilometers on the ground for a radian at the Earth's center."""

HEIGHTS = 4.35, 2.0, 1.6
"""Heights of the panels, inches."""

GAP = 0.06
"""Half of the space between panels, inches."""

CROWD = 1000
"""Number of targets from which on dots become smaller."""

SIZES = 2.5, 17.0
"""Area of a target's dot, points^2: least, and what is added for the highest priority."""

LARGER = 2.2
"""Factor on the size of dots in the close-up."""

LOOKS = {
    OPEN: ("none", "#9aa3af", "not chosen"),
    LOST: ("none", PALETTE[3], "chosen, not imaged"),
    UNPAID: (PALETTE[1], PALETTE[1], "imaged, no reward"),
    IMAGED: (PALETTE[2], PALETTE[2], "imaged"),
}
"""Face, edge and name of targets by what became of them."""

BELOW: dict[str, object] = dict(loc="upper center", handletextpad=0.5, columnspacing=1.4, borderaxespad=0.0)
"""Place of the legend of the map."""

DAY = LinearSegmentedColormap.from_list("day", ("#b9d3ee", PALETTE[0], "#12305a"))
"""Colors of the track from start to end."""

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

RESOURCES = {
    "battery_charge_fraction": "battery",
    "wheel_speeds_fraction": "fastest wheel",
    "storage_level_fraction": "data buffer",
}
"""Resources drawn where the satellite has them, and what they are called."""


@dataclass(frozen=True, kw_only=True)
class ImagingEpisode(TrackEpisode):
    """A :class:`~bsk_torch.viz.figures.timeline.TrackEpisode` of T decisions with K targets; positions are Earth-fixed, m.

    Images are counted at the ends of decisions, which are the times of the images unless ``variable_interval`` is off.

    Attributes:
        r_LP_P: Positions of the targets, including padding, [K, 3].
        exists: Targets other than padding, [K].
        priority: Highest priority of each target at any decision, [K].
        chosen: Target of each decision, [T]; :data:`NONE` for other actions.
        worth: Priority of the chosen target at its decision, [T].
        imaged: Decisions that led to an image, [T].
        least_elevation: Least elevation, rad, of a satellite that images a target.
    """

    r_LP_P: Tensor
    exists: Tensor
    priority: Tensor
    chosen: Tensor
    worth: Tensor
    imaged: Tensor
    least_elevation: float

    @override
    @classmethod
    def of(cls, recording: Recording, track: int = 0) -> Self:
        reading = Reading(recording, track)
        flown, r_LP_P = TrackEpisode.of(recording, track), reading.of_scene("targets_P")
        time, _, _, kind = reading.events
        highest = "highest_priority" if "highest_priority" in reading.scene.arrays else "priority"
        least = recording.satellites[0].least_elevation
        assert least is not None, "an imager has a least elevation"
        return cls(
            **vars(flown),
            r_LP_P=r_LP_P,
            exists=torch.isfinite(r_LP_P).all(-1),
            priority=reading.of_scene(highest),
            chosen=reading.array("decision_target"),
            worth=reading.array("decision_priority").nan_to_num(),
            imaged=torch.isin(flown.times[1:], time[kind <= 1]),
            least_elevation=least,
        )

    @property
    def reach(self) -> float:
        """Angle, rad, at the Earth's center between the satellite and the farthest target that it can image.

        ``acos(q cos e) - e`` at elevation e, with q the Earth's radius over the satellite's.
        """
        e = torch.tensor(self.least_elevation, dtype=torch.float64)
        return float(torch.acos(R_EARTH / self.track.norm(dim=-1).mean() * torch.cos(e)) - e)

    @property
    @override
    def outcome(self) -> str:
        images = int(self.imaged.sum())
        return f"{images} image{'s' * (images != 1)}, {super().outcome}"

    @property
    def outcomes(self) -> Tensor:
        """Outcome of the target of every decision, [T]; :data:`OPEN` for decisions without a target.

        Decisions for the same target in a row are one: they have the outcome of the last one.
        """
        now = torch.where(self.imaged, torch.where(self.rewards > 0.0, IMAGED, UNPAID), LOST)
        goes_on = (self.chosen[1:] == self.chosen[:-1]) & ~self.imaged[:-1]
        number = torch.cat([torch.zeros(1, dtype=torch.int64), (~goes_on).cumsum(0)])
        last = torch.bincount(number).cumsum(0) - 1
        return torch.where(self.chosen >= 0, now[last[number]], OPEN)

    @property
    def fate(self) -> Tensor:
        """Best outcome of every target, [K]."""
        rows = self.chosen >= 0
        none = torch.full((len(self.r_LP_P),), OPEN)
        return none.scatter_reduce(0, self.chosen[rows], self.outcomes[rows], "amax")

    @override
    def pictures(self) -> list[Picture]:
        text = (
            "Where the satellite flew, what it imaged, ten minutes of that large, and decisions, reward and resources over time."
        )
        return [Picture(partial(ground_track, self), text, "World map with ground track and targets")]


def ground_track(episode: ImagingEpisode, path: Path, title: str = "", width: float = WIDTH) -> Path:
    """Draw an episode to the file ``path``, .png, .svg or .pdf, with headline ``title`` unless that is empty.

    From above: the world with the ground track and all targets; ten minutes of it large, with lines from the satellite to what
    it imaged; decisions and reward over time; and battery, wheels and store where the satellite can do something for them.
    ``width`` is in inches, such as :data:`~bsk_torch.viz.figures.style.COLUMN`.
    """
    world, close_up, lower = HEIGHTS
    heights = [
        world * width / WIDTH,
        close_up * width / WIDTH,
        *(share(width) * h for h in (lower, *([1.1] if len(episode.names) > 1 else []))),
    ]
    figure = Figure(figsize=(width, sum(heights) + (2.6 if width >= WIDTH else 1.7)), dpi=140, facecolor="white")
    figure.set_layout_engine("constrained", h_pad=GAP)
    panels = figure.subplots(len(heights), 1, height_ratios=heights).tolist()
    for panel in panels:
        tidy(panel)
    span = busiest(episode)
    _world(panels[0], episode, span, width)
    _close_up(panels[1], episode, span)
    handles = decisions(panels[2], episode, span)
    for panel in panels[3:]:
        handles += resources(panel, episode, width)
    for panel in panels[2:]:
        time_axis(panel, episode, labeled=panel is panels[-1], width=width)
    if title:
        headline(figure, f"{title}: {episode.outcome}")
    fit(figure, width)
    legend(panels[0], _world_legend(episode), width, 8, bbox_to_anchor=(0.5, -0.06 * WIDTH / width), **BELOW)
    legend(figure, handles, width)
    return save(figure, path)


def busiest(episode: ImagingEpisode) -> tuple[float, float]:
    """Start and end, s, of the :data:`CLOSE_UP` seconds with the most images, within the episode."""
    last, images = float(episode.times[-1]), episode.times[1:][episode.imaged]
    start = 0.5 * (last - CLOSE_UP)
    if len(images):
        until = torch.searchsorted(images, images + CLOSE_UP - 2.0 * SHOULDER, right=True)
        start = float(images[int((until - torch.arange(len(images))).argmax())]) - SHOULDER
    start = max(0.0, min(start, last - CLOSE_UP))
    return start, min(start + CLOSE_UP, last)


# -- the world -------------------------------------------------------------------------------------------------------------------


def _world(panel: Axes, episode: ImagingEpisode, span: tuple[float, float], width: float) -> None:
    world_map(panel, width)
    _targets(panel, episode, ground(episode.r_LP_P), episode.exists)
    lines, hours = pieces(*ground(episode.track)), episode.track_times / HOUR
    large = (episode.track_times[1:] > span[0]) & (episode.track_times[:-1] < span[1])
    panel.add_collection(LineCollection(lines[large].tolist(), color=INK, linewidth=7.0, alpha=0.2, zorder=2.5))
    track = LineCollection(lines.tolist(), array=hours[1:].numpy(), cmap=DAY, linewidth=1.6, zorder=3)
    track.set_clim(0.0, float(hours[-1]))
    panel.add_collection(track)
    panel.plot(*ground(episode.stations), "^", color=INK, markeredgecolor="white", markersize=7.5, zorder=5)
    for k, marker in ((0, "o"), (-1, "s")):
        panel.plot(*ground(episode.track[k]), marker, color="white", markeredgecolor=INK, markersize=6.5, zorder=6)
    bar = panel.figure.colorbar(track, cax=panel.inset_axes((1.012, 0.1, 0.014, 0.8)))
    bar.outline.set_visible(False)
    bar.ax.tick_params(colors=INK, labelsize=9, length=3)
    label(bar.ax, "hours since the start")
    caption(panel, "ground track and targets; the larger a dot, the higher its priority")


def _targets(panel: Axes, episode: ImagingEpisode, at: tuple[Tensor, Tensor], shown: Tensor, scale: float = 1.0) -> None:
    """The targets that are ``shown`` [K], as dots."""
    share = episode.priority / episode.priority.max().clamp(min=1e-12)
    crowd = max(1.0, int(episode.exists.sum()) / CROWD) ** 0.5
    area, fate = scale / crowd * (SIZES[0] + SIZES[1] * share), episode.fate
    for kind, (face, edge, _) in LOOKS.items():
        rows, (width, layer) = shown & (fate == kind), (0.6, 2) if kind == OPEN else (1.2, 4)
        where = (x[rows].tolist() for x in (*at, area))
        panel.scatter(*where, facecolors=face, edgecolors=edge, linewidths=width, zorder=layer, rasterized=True)


def _world_legend(episode: ImagingEpisode) -> list[Line2D]:
    present = set(episode.fate[episode.exists].tolist())
    markers = [("o", *look) for kind, look in LOOKS.items() if kind in present][::-1]
    markers += [("o", "white", INK, "start"), ("s", "white", INK, "end")]
    markers += [("^", INK, INK, "ground station")] if len(episode.stations) else []
    return [
        *(dot(*marker) for marker in markers),
        Line2D([], [], color=INK, alpha=0.2, linewidth=7.0, solid_capstyle="butt", label="shown below"),
    ]


# -- ten minutes -----------------------------------------------------------------------------------------------------------------


def along_and_across(r_P: Tensor, path: Tensor) -> tuple[Tensor, Tensor]:
    """Distances on the ground, km, along a short path and to its left, of Earth-fixed positions [n, 3].

    They are arcs from the middle of the path [m, 3] along the great circle that fits it best, and from that circle.
    """
    normal = torch.linalg.cross(path[:-1], path[1:]).mean(0)
    normal = normal / normal.norm()
    middle = path[len(path) // 2]
    middle = middle - normal * (normal @ middle)
    middle = middle / middle.norm()
    along = torch.atan2(r_P @ torch.linalg.cross(normal, middle), r_P @ middle)
    return along * KM, torch.asin(r_P @ normal / r_P.norm(dim=-1)) * KM


def _close_up(panel: Axes, episode: ImagingEpisode, span: tuple[float, float]) -> None:
    during = (episode.track_times >= span[0]) & (episode.track_times <= span[1])
    path = episode.track[during]
    x, y = along_and_across(path, path)
    reach = episode.reach * KM
    panel.fill_between(x, y - reach, y + reach, color=PALETTE[0], alpha=0.08, linewidth=0)
    panel.plot(x, y, color=PALETTE[0], linewidth=2.2)
    minutes = np.arange(span[0], span[1] + 1e-6, 60.0)
    panel.plot(*(np.interp(minutes, episode.track_times[during], q) for q in (x, y)), "|", color=PALETTE[0], markersize=8.0)
    panel.set(aspect="equal", anchor="W", xlim=(float(x[0]) - reach, float(x[-1]) + reach), ylim=(-1.15 * reach, 1.15 * reach))
    places = along_and_across(episode.r_LP_P, path)
    near = (places[0] > x[0] - reach) & (places[0] < x[-1] + reach) & (places[1].abs() < 1.15 * reach)
    _targets(panel, episode, places, episode.exists & near, LARGER)
    rows = episode.imaged & (episode.times[1:] >= span[0]) & (episode.times[1:] <= span[1])
    eyes, targets = along_and_across(episode.r_BN_P[1:][rows], path), [q[episode.chosen[rows]] for q in places]
    lines = torch.stack([torch.stack(eyes, -1), torch.stack(targets, -1)], 1)
    panel.add_collection(LineCollection(lines.tolist(), color=INK, linewidth=1.0, zorder=3))
    panel.plot(*eyes, "o", color=INK, markersize=3.2, zorder=5)
    panel.set_xlabel("along the track, km", color=INK, fontsize=9.5)
    label(panel, "across, km")
    start, end = (f"{int(t // 3600)}:{int(t % 3600 // 60):02d}" for t in span)
    caption(panel, f"{start} to {end} h, a tick a minute: lines lead from the satellite to what it images, shaded is its reach")


# -- decisions over time ---------------------------------------------------------------------------------------------------------


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
    for color, (name, called) in zip((INK, PALETTE[1], PALETTE[4]), RESOURCES.items(), strict=True):
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
