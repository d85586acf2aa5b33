"""Figures of imaging in orbit: the sky of an imager with the objects of its catalog, and images and downlinks over time."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import torch
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.patheffects import withStroke
from matplotlib.text import Annotation, Text
from torch import Tensor
from typing_extensions import Self, override

from bsk_torch._checks import whole
from bsk_torch.astro.eclipse import illumination
from bsk_torch.constants import R_EARTH
from bsk_torch.data import ComposedReward
from bsk_torch.recording.reading import Reading, hermite
from bsk_torch.recording.recording import Recording
from bsk_torch.recording.table import Columns
from bsk_torch.sim.names import one_of
from bsk_torch.tasks.objects.reward import RSOImageReward
from bsk_torch.tasks.objects.scene import RSOTargets
from bsk_torch.vec3 import Vec3
from bsk_torch.viz.episodes import Picture, TeamEpisode
from bsk_torch.viz.figures.style import (
    FAINT,
    INK,
    PALETTE,
    SMALLER,
    WIDTH,
    caption,
    dot,
    finish,
    fit,
    headline,
    label,
    legend,
    panels,
    save,
    share,
)
from bsk_torch.viz.figures.timeline import HOUR, NIGHT, hour_ticks

if TYPE_CHECKING:
    from bsk_torch.env.base import Tasking

__all__ = ["RSOImagingEpisode", "Sky", "services_figure", "sky_figure", "sky_of"]

AU = 149_597_870_700.0
"""Distance of the Sun, m, where only its direction was recorded."""

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

    @property
    def outcome(self) -> str:
        """Summary of the sky as text."""
        lit = self.in_sight & (self.light >= LIGHT)
        return f"{int(self.in_sight.sum())} of {len(self.ids)} objects in sight, {int(lit.sum())} of them lit"


@dataclass(frozen=True, kw_only=True)
class RSOImagingEpisode(TeamEpisode):
    """One episode of I imagers and a catalog of G objects, as tensors on the CPU; times in seconds since the reset.

    Attributes:
        ids: Ids of the objects.
        light: Visible fraction of the Sun at each object at the boundaries, [G, B].
        taken: Times of the images, ascending, [M].
        delivered: End of the step in which the last bit of each was downlinked, infinite for never, [M].
        imager: Number of the imager of each, [M].
        target: Number of the object of each, [M].
    """

    ids: Sequence[str]
    light: Tensor
    taken: Tensor
    delivered: Tensor
    imager: Tensor
    target: Tensor

    @override
    @classmethod
    def of(cls, recording: Recording, track: int = 0) -> Self:
        reading = Reading(recording, track, viewers=True)
        times = reading.times
        time, who, target, kind = reading.events
        images, arrivals = torch.nonzero(kind == 0).flatten().tolist(), torch.nonzero(kind == 2).flatten().tolist()
        delivered = torch.full((len(images),), torch.inf, dtype=torch.float64)
        for k, image in enumerate(images):  # the first downlink of each that belongs to no earlier image
            same = (n for n in arrivals if (who[n], target[n]) == (who[image], target[image]) and time[n] > time[image])
            if (arrival := next(same, None)) is not None:
                delivered[k] = time[arrival]
                arrivals.remove(arrival)
        r, v = reading.array("object_r_N"), reading.array("object_v_N")
        r_TN_N = hermite(reading.array("object_times"), r, v, times)
        keys, sun_N = reading.array("key_times"), reading.array("sun_N")
        sun_N = torch.stack([torch.from_numpy(np.interp(times, keys, axis)) for axis in sun_N.mT], -1)
        return cls(
            **cls.flown(reading),
            ids=reading.scene.target_names,
            light=illumination(Vec3.of(r_TN_N), Vec3.of(AU * sun_N.unsqueeze(1))).mT,
            taken=time[images],
            delivered=delivered,
            imager=who[images],
            target=target[images],
        )

    @property
    @override
    def outcome(self) -> str:
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
        aboard = (self.taken.unsqueeze(1) <= self.times) & (self.times < self.delivered.unsqueeze(1))
        return torch.zeros(len(self.names), len(self.times), dtype=torch.float64).index_add(0, self.imager, aboard.double())

    def to_numpy(self) -> Columns:
        """Return the episode as a table: a row for each imager at each decision boundary, in the order of time.

        ``time`` is in seconds since reset and ``satellite`` the name. ``action`` is the task from then on, ``decided`` whether it
        began there, and ``reward`` that of the step that begins there. ``images`` and ``delivered`` count until then.
        """
        counts = {}
        for name, when in (("images", self.taken), ("delivered", self.delivered)):
            done = (when.unsqueeze(1) <= self.times).double()
            counts[name] = torch.zeros(len(self.names), len(self.times), dtype=torch.float64).index_add(0, self.imager, done)
        return self.table({**counts, **self.series})

    @override
    def pictures(self) -> list[Picture]:
        text = "Images of objects in orbit and their downlinks, eclipses of the objects, images on board and return over time."
        return [Picture(partial(services_figure, self), text, "Images of objects in orbit over time")]


# -- sky -------------------------------------------------------------------------------------------------------------------------


def sky_of(env: Tasking, imager: str | None = None, env_row: int = 0) -> Sky:
    """Return the current sky of an imager.

    Args:
        env: The environment, after a reset.
        imager: Name of the imager (default: the first one).
        env_row: Which of its episodes.

    Raises:
        ValueError: For an environment without imaging in orbit, an unknown imager, or an episode that does not exist.
    """
    scenario = env.scenario
    parts = env.rewarder.rewarders if isinstance(env.rewarder, ComposedReward) else [env.rewarder]
    rewarder = next((part for part in parts if isinstance(part, RSOImageReward)), None)
    if rewarder is None or not isinstance(scenario, RSOTargets):
        raise ValueError(f"env has the scenario {scenario!r}; imaging in orbit needs RSOTargets and an RSOImageReward")
    name = scenario.imager_names[0] if imager is None else one_of("imager", imager, scenario.imager_names)
    whole("env_row", env_row, 0, env.batch_size[0] - 1)
    kind, number = env.fleet.place_of(name)
    satellite = env.fleet.satellites[kind]
    row = env_row * satellite.simulator.count + number
    everything = scenario.all_targets(satellite)
    views = scenario.views(satellite, everything)
    candidates = scenario.candidates(satellite, scenario.n_targets)
    _, ahead, normal = views.rel_pos_vector_r_BR_H[row].cpu().unbind(-1)
    height = float(satellite.dynamics.r_BN_N[row].norm())
    return Sky(
        imager=name,
        time=float(env.fleet.sim_time[env_row]),
        ids=scenario.ids,
        azimuth=torch.rad2deg(torch.atan2(-normal, ahead)),
        elevation=views.target_elevation_angle[row].cpu(),
        limb=-float(torch.rad2deg(torch.acos(torch.tensor(R_EARTH / height)))),
        light=views.target_illumination_factor[row].cpu(),
        in_sight=scenario.in_sight(satellite, everything)[row].cpu(),
        priority=scenario.priority[env_row].cpu(),
        pending=scenario.pending[env_row].cpu(),
        imaged=rewarder.imaged[env_row].cpu(),
        candidates=candidates.place[row][candidates.exists[row]].cpu(),
    )


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
        for sight, face in ((sky.in_sight, color), (~sky.in_sight, "white")):
            now = rows & sight
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
    entries: list[tuple[bool, Artist]] = [
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
    return [handle for shown, handle in entries if shown]


def _ring(color: str, name: str) -> Line2D:
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
    hours = (episode.times / HOUR).tolist()
    for k, color in enumerate(episode.colors):
        board.step(hours, episode.on_board()[k].tolist(), where="post", color=color, linewidth=1.6)
        total = torch.cat([torch.zeros(1, dtype=torch.float64), episode.rewards[k].nan_to_num().double().cumsum(0)])
        value.step(hours, total.tolist(), where="post", color=color, linewidth=1.6)
    board.set_ylim(bottom=0.0)
    label(board, "on board")
    label(value, "return")
    value.set_xlim(0.0, hours[-1])
    hour_ticks(value, hours[-1], width)
    return finish(figure, path, title and f"{title}: {episode.outcome}", width, _legend(episode), 6)


def _services(panel: Axes, episode: RSOImagingEpisode, shown: Sequence[int]) -> None:
    """Draw the rows of the objects ``shown``, the first one on top."""
    row, last = {target: k for k, target in enumerate(shown)}, float(episode.times[-1])
    hours = (episode.times / HOUR).tolist()
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
    entries: list[tuple[bool, Artist]] = [
        (len(episode.taken) > 0, dot("o", first, "white", "image")),
        (len(episode.taken) > 0, Patch(color=first, alpha=0.3, label="on board")),
        (bool(torch.isfinite(episode.delivered).any()), dot("v", first, "white", "delivered")),
        (dark, Patch(color=NIGHT, alpha=0.2, label="object in eclipse")),
    ]
    return [*names, *(handle for shown, handle in entries if shown)]
