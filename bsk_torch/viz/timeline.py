"""What a policy does in one episode: modes, battery, store, wheels, eclipses and station passes over time."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import torch
from matplotlib.axes import Axes
from matplotlib.patches import Patch
from matplotlib.ticker import MultipleLocator, PercentFormatter
from tensordict.nn import TensorDictModuleBase
from torchrl.envs.utils import ExplorationType, set_exploration_type, step_mdp

from bsk_torch.env import SatelliteTasking
from bsk_torch.viz.style import INK, PALETTE, headline, label, panels, save

HOUR = 3600.0

QUANTITIES = {
    "battery_charge_fraction": "battery",
    "storage_level_fraction": "data store",
    "wheel_speeds_fraction": "wheel speeds",
}
"""Properties of the dynamics that are drawn where the satellite has them, and what they are called."""

PASSES_AHEAD = 3
"""Passes noted at every decision; more would have to fit into one step to be missed."""

NIGHT, PASS = "#3b4252", "#2f9e72"


@dataclass
class Episode:
    """One recorded episode.

    ``times`` are the seconds since reset of the T + 1 decision boundaries, ``actions`` the T actions between them; ``series``
    holds T + 1 lists of numbers for each drawn quantity. ``eclipses`` and ``passes`` map the end of an interval to its start.
    """

    names: list[str]
    times: list[float] = field(default_factory=list)
    actions: list[int] = field(default_factory=list)
    series: dict[str, list[list[float]]] = field(default_factory=dict)
    eclipses: dict[int, float] = field(default_factory=dict)
    passes: dict[int, float] = field(default_factory=dict)
    total: float = 0.0
    died: bool = False

    def note(self, env: SatelliteTasking) -> None:
        """Add what row 0 of ``env`` shows now."""
        satellite = env.satellite
        now = float(env.simulator.sim_time[0])
        self.times.append(now)
        for name in QUANTITIES:
            if hasattr(type(satellite.dynamics), name):
                value = getattr(satellite.dynamics, name)[0]
                self.series.setdefault(name, []).append(value.reshape(-1).tolist())
        start, end = (float(x[0]) for x in satellite.next_eclipse())
        _add(self.eclipses, start if start < end else now, end, now)
        if "ground_station" in satellite.opportunity_types:
            ahead = satellite.find_next_opportunities(PASSES_AHEAD)  # type: ignore[attr-defined]
            for start, end in zip(ahead.open[0].tolist(), ahead.close[0].tolist(), strict=True):
                _add(self.passes, start, end, now)


def _add(intervals: dict[int, float], start: float, end: float, now: float) -> None:
    """Note an interval that is not over; the earliest start seen for an end counts."""
    if end > now:
        intervals[round(end)] = min(start, intervals.get(round(end), start))


def record_episode(policy: TensorDictModuleBase, env: SatelliteTasking, *, seed: int) -> Episode:
    """Play the first episode of ``seed`` in row 0 of ``env``, with the most probable actions."""
    env.set_seed(seed)
    episode = Episode(env.satellite.action_description)
    with torch.no_grad(), set_exploration_type(ExplorationType.DETERMINISTIC):
        now = env.reset()
        episode.note(env)
        while not bool(now["done"][0]):
            now = env.step(policy(now))
            episode.actions.append(int(now["action"][0]))
            episode.total += float(now["next", "reward"][0])
            episode.note(env)
            now = step_mdp(now)
    episode.died = bool(env.dead[0])
    return episode


def timeline(episode: Episode, path: Path, title: str) -> Path:
    """Draw an episode to the PNG file ``path``, with headline ``title``."""
    figure, axes = panels((0.5, *(1.35 for _ in episode.series)))
    _modes(axes[0], episode)
    for panel, (name, rows) in zip(axes[1:], episode.series.items(), strict=True):
        _series(panel, episode, name, rows)
    for panel in axes:
        _shade(panel, episode)
    axes[-1].set_xlabel("hours since the start", color=INK, fontsize=9.5)
    axes[-1].set_xlim(0.0, episode.times[-1] / HOUR)
    axes[-1].xaxis.set_major_locator(MultipleLocator(_spacing(episode.times[-1] / HOUR)))
    end = "died" if episode.died else "survived"
    headline(figure, f"{title}: return {episode.total:.3f}, {end}")
    figure.legend(handles=_legend(episode), loc="outside lower center", ncols=8, frameon=False, fontsize=9, labelcolor=INK)
    return save(figure, path)


def _spacing(hours: float) -> float:
    """Distance of the ticks, hours."""
    return next(step for step in (0.25, 0.5, 1.0, 2.0, 6.0, 24.0, 1e9) if hours / step <= 12)


def _modes(panel: Axes, episode: Episode) -> None:
    spans = list(zip(episode.times[:-1], episode.times[1:], strict=True))
    for action in sorted(set(episode.actions)):
        bars = [(a / HOUR, (b - a) / HOUR) for (a, b), taken in zip(spans, episode.actions, strict=True) if taken == action]
        panel.broken_barh(bars, (0.0, 1.0), facecolors=_color(action), linewidth=0)
    panel.set_ylim(0.0, 1.0)
    panel.set_yticks([])
    panel.grid(False)
    label(panel, "mode")


def _series(panel: Axes, episode: Episode, name: str, rows: Sequence[Sequence[float]]) -> None:
    hours = [t / HOUR for t in episode.times]
    columns = list(zip(*rows, strict=True))
    for color, column in zip(PALETTE if len(columns) > 1 else (INK,), columns, strict=False):
        panel.plot(hours, column, color=color, linewidth=1.5)
    if len(columns) == 1:
        panel.fill_between(hours, columns[0], color=INK, alpha=0.12, linewidth=0)
    panel.set_ylim(0.0 if len(columns) == 1 else -1.05, 1.05)
    panel.yaxis.set_major_formatter(PercentFormatter(1.0))
    label(panel, QUANTITIES[name])


def _shade(panel: Axes, episode: Episode) -> None:
    last = episode.times[-1]
    for intervals, color, alpha in ((episode.eclipses, NIGHT, 0.16), (episode.passes, PASS, 0.35)):
        for end, start in intervals.items():
            if start < last:
                panel.axvspan(start / HOUR, min(end, last) / HOUR, color=color, alpha=alpha, linewidth=0, zorder=0)


def _color(action: int) -> str:
    return PALETTE[action % len(PALETTE)]


def _legend(episode: Episode) -> list[Patch]:
    modes = [Patch(color=_color(k), label=_plain(name)) for k, name in enumerate(episode.names)]
    return [*modes, Patch(color=NIGHT, alpha=0.16, label="eclipse"), Patch(color=PASS, alpha=0.35, label="station pass")]


def _plain(action: str) -> str:
    return action.removeprefix("action_").replace("_", " ")
