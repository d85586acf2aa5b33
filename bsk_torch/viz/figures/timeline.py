"""Figures of an episode of one satellite: modes and resources over time, and the ground track on a map."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from math import isfinite
from pathlib import Path
from typing import Any

import numpy as np
import torch
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.ticker import MultipleLocator, PercentFormatter
from torch import Tensor
from typing_extensions import Self, override

from bsk_torch.recording.reading import Reading
from bsk_torch.recording.recording import Recording
from bsk_torch.recording.scenes import QUANTITIES
from bsk_torch.recording.table import Columns, number_columns
from bsk_torch.viz.episodes import Episode, Picture
from bsk_torch.viz.figures.style import INK, PALETTE, WIDTH, caption, dot, finish, label, panels, share, tidy
from bsk_torch.viz.figures.world import ground, pieces, world_map

__all__ = ["TrackEpisode", "timeline", "track_map"]

SAMPLE = 30.0
"""Seconds between the samples of a ground track."""

HOUR = 3600.0

GRAYS, DASHES = (INK, "#6b7280", "#9aa3af"), ("-", (0, (5, 1.5)), (0, (1.5, 1)))
"""Looks of several lines in a panel, such as of wheels: colors are those of modes."""

NIGHT, PASS = "#3b4252", PALETTE[2]

THIN, THICK, SHADE = 1.5, 3.4, 7.5
"""Widths of the track where nothing is earned, where something is, and of the shade under it in the dark, points."""

SHADE_ALPHA = 0.22


@dataclass(frozen=True, kw_only=True)
class TrackEpisode(Episode):
    """One episode of T decisions of one satellite; times are seconds since reset, positions Earth-fixed, m.

    Attributes:
        names: Names of the entries of the satellite's ``action_spec``.
        times: Times of the decisions, and of the end, [T + 1].
        actions: Index into ``names`` of each decision, [T].
        rewards: Reward of each decision, [T].
        series: Quantities at these times by name, [T + 1, width] each; see :data:`bsk_torch.recording.scenes.QUANTITIES`.
        eclipses: Start and end of every eclipse, [n, 2].
        passes: Start and end of every period in view of a ground station, [n, 2].
        died: Whether the satellite died.
        r_BN_P: The satellite at the decision boundaries, [T + 1, 3].
        track_times: Times of the track, [M] s: every :data:`SAMPLE` seconds from each decision on, and the end.
        track: The satellite then, [M, 3].
        stations: Ground stations, [K, 3].
    """

    names: list[str]
    times: Tensor
    actions: Tensor
    rewards: Tensor
    series: dict[str, Tensor]
    eclipses: Tensor
    passes: Tensor
    died: bool
    r_BN_P: Tensor
    track_times: Tensor
    track: Tensor
    stations: Tensor

    @override
    @classmethod
    def of(cls, recording: Recording, track: int = 0) -> Self:
        reading = Reading(recording, track)
        times, series = reading.times, {name: reading.values(name) for name in QUANTITIES}
        counts = torch.ceil(times.diff() / SAMPLE).long()
        row = torch.repeat_interleave(torch.arange(len(counts)), counts)
        elapsed = SAMPLE * (torch.arange(len(row)) - (counts.cumsum(0) - counts)[row]).double()
        track_times = torch.cat([times[row] + elapsed, times[-1:]])
        on_map = "step_r_P" in reading.track.arrays  # satellites in relative motion are on no map
        return cls(
            names=recording.satellites[0].tasks,
            times=times,
            actions=reading.array("decision_task"),
            rewards=reading.rewards[0],
            series={name: values[0] for name, values in series.items() if values is not None},
            eclipses=reading.intervals("eclipses", 0),
            passes=reading.intervals("passes", 0),
            died=bool(reading.track.deaths),
            r_BN_P=reading.array("step_r_P")[:, 0] if on_map else times.new_full((len(times), 3), torch.nan),
            track_times=track_times,
            track=reading.r_P(track_times)[0] if on_map else times.new_full((len(track_times), 3), torch.nan),
            stations=reading.of_scene("stations_P"),
        )

    @property
    def total(self) -> float:
        """Return of the episode."""
        return float(self.rewards.sum())

    @property
    @override
    def outcome(self) -> str:
        return f"return {self.total:.3f}, {'died' if self.died else 'survived'}"

    def to_numpy(self) -> Columns:
        """Return the episode as a table: columns by name, [T + 1] each, a row for each decision boundary.

        ``time`` is in seconds since reset; ``action`` and ``reward`` belong to the decision that begins there, empty and nan in
        the last row. Quantities of several numbers have a column for each, such as ``wheel_speeds_fraction_0``.
        """
        decisions: Columns = {
            "time": self.times.double().numpy(),
            "action": np.array([*(self.names[k] for k in self.actions.tolist()), ""]),
            "reward": np.append(self.rewards.double().numpy(), np.nan),
        }
        return decisions | number_columns({**self.series, "r_BN_P": self.r_BN_P})

    @override
    def pictures(self) -> list[Picture]:
        return [
            Picture(
                partial(track_map, self),
                "Where the satellite flew: colored by mode, thick where a reward was earned, shaded in eclipse.",
                "World map with the ground track",
            ),
            Picture(
                partial(timeline, self),
                "What the satellite did and what became of its resources, with eclipses in gray and station passes in green.",
                "Modes and resources over time",
            ),
        ]


def timeline(
    episode: TrackEpisode, path: Path, title: str = "", marks: Sequence[tuple[float, str]] = (), width: float = WIDTH
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
    return finish(figure, path, title and f"{title}: {episode.outcome}", width, _legend(episode), 8)


def time_axis(panel: Axes, episode: TrackEpisode, labeled: bool = True, width: float = WIDTH) -> None:
    """Ticks of an abscissa in hours, and their numbers and its name where it is ``labeled``."""
    hours = float(episode.times[-1]) / HOUR
    hour_ticks(panel, hours, width)
    panel.tick_params(labelbottom=labeled)
    panel.set_xlim(0.0, hours)
    if not labeled:
        panel.set_xlabel("")


def hour_ticks(panel: Axes, hours: float, width: float = WIDTH) -> None:
    """Set the ticks and the name of an abscissa of so many hours."""
    most = round(12 * share(width))
    steps = (0.01, 0.02, 0.05, 0.1, 0.25, 0.5, 1.0, 2.0, 6.0, 24.0, 1e9)
    panel.xaxis.set_major_locator(MultipleLocator(next(step for step in steps if hours / step <= most)))
    panel.set_xlabel("hours since the start", color=INK, fontsize=9.5)


def bars(panel: Axes, episode: TrackEpisode, rows: Tensor, base: float = 0.0, height: float = 1.0, **look: Any) -> None:
    """Bars over the decisions where ``rows`` [T] is true, one for all in a row: seams between bars would show."""
    edge = torch.zeros(1, dtype=torch.bool)
    before, after = torch.cat([edge, rows[:-1]]), torch.cat([rows[1:], edge])
    start, end = episode.times[:-1][rows & ~before] / HOUR, episode.times[1:][rows & ~after] / HOUR
    panel.broken_barh(torch.stack([start, end - start], -1).tolist(), (base, height), linewidth=0, **look)


def _modes(panel: Axes, episode: TrackEpisode) -> None:
    for action in sorted(set(episode.actions.tolist())):
        bars(panel, episode, episode.actions == action, facecolors=mode_color(action))
    panel.set_ylim(0.0, 1.0)
    panel.set_yticks([])
    panel.grid(False)
    label(panel, "mode")


def _series(panel: Axes, episode: TrackEpisode, name: str) -> None:
    hours, columns = (episode.times / HOUR).tolist(), episode.series[name].mT.tolist()
    for k, column in enumerate(columns):
        panel.plot(hours, column, color=GRAYS[k % len(GRAYS)], linestyle=DASHES[k % len(DASHES)], linewidth=1.5)
    if len(columns) == 1:
        panel.fill_between(hours, columns[0], color=INK, alpha=0.12, linewidth=0)
    panel.set_ylim(0.0 if len(columns) == 1 else -1.05, 1.05)
    panel.yaxis.set_major_formatter(PercentFormatter(1.0))
    label(panel, QUANTITIES[name])


def shade(panel: Axes, episode: TrackEpisode) -> None:
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


def _legend(episode: TrackEpisode) -> list[Patch]:
    modes = [Patch(color=mode_color(k), label=plain(name)) for k, name in enumerate(episode.names)]
    return [*modes, *shade_legend()]


def shade_legend() -> list[Patch]:
    """Entries for what :func:`shade` draws."""
    return [Patch(color=NIGHT, alpha=0.16, label="eclipse"), Patch(color=PASS, alpha=0.35, label="station pass")]


def plain(action: str) -> str:
    """Name of an action as people say it."""
    return action.removeprefix("action_").replace("_", " ")


# -- the map --------------------------------------------------------------------------------------------------------------------


def track_map(
    episode: TrackEpisode, path: Path, title: str = "", width: float = WIDTH, places: Sequence[tuple[str, str, Tensor]] = ()
) -> Path:
    """Draw an episode to the file ``path``, .png, .svg or .pdf, with headline ``title`` unless that is empty.

    The ground track has the colors of the timeline's modes. It is thick for decisions that earned a reward and shaded in eclipse.
    Ground stations, start and end are marked. ``width`` is in inches, such as :data:`~bsk_torch.viz.figures.style.COLUMN`.
    ``places`` are dots below the track: name, color, and Earth-fixed positions [K, 3] m.
    """
    text = 0.8 if title else 0.35  # height, inches
    figure = Figure(figsize=(width, 0.5 * width + text), dpi=140, layout="constrained", facecolor="white")
    panel = figure.subplots()
    tidy(panel)
    world_map(panel, width)
    panel.set_anchor("C")
    for _, color, r_P in places:
        panel.scatter(*ground(r_P), s=3.0, color=color, linewidths=0, zorder=1.5, rasterized=True)
    _track(panel, episode)
    panel.plot(*ground(episode.stations), "^", color=INK, markeredgecolor="white", markersize=8.0, zorder=5)
    for k, marker in ((0, "o"), (-1, "s")):
        panel.plot(*ground(episode.track[k]), marker, color="white", markeredgecolor=INK, markersize=6.5, zorder=6)
    if title:
        caption(panel, "ground track by mode; thick where a reward was earned, shaded in eclipse")
    handles = [*_map_legend(episode), *(dot("o", color, color, name) for name, color, _ in places)]
    return finish(figure, path, title and f"{title}: {episode.outcome}", width, handles, 8)


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
    for begin, end, _, leaving, coming in lines.tolist():
        if joined and joined[-1][-1] == begin:
            joined[-1].append(end)
        else:
            joined.append([begin, end])
        if isfinite(leaving[0]):
            joined.append([leaving, coming])
    return joined


def _map_legend(episode: TrackEpisode) -> list[Artist]:
    modes = [
        Line2D([], [], color=mode_color(k), linewidth=THICK, label=plain(name))
        for k, name in enumerate(episode.names)
        if bool((episode.actions == k).any())
    ]
    shade = Patch(color=NIGHT, alpha=SHADE_ALPHA, label="eclipse")
    markers = [dot("^", INK, INK, "ground station")] if len(episode.stations) else []
    return [*modes, shade, *markers, dot("o", "white", INK, "start"), dot("s", "white", INK, "end")]
