"""Charts of the report of a run: the four measures of the BSK-RL paper (figures 2 to 5) over training, and causes of death."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import isfinite
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib import patheffects
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import EngFormatter, MaxNLocator, PercentFormatter

from bsk_torch._text import visible
from bsk_torch.viz.figures.style import INK, PALETTE, save, tidy

Columns = Mapping[str, Sequence[float]]
"""Columns of a CSV file by name."""

FRESH, TRAINING, PAPER = PALETTE[0], "#8fa6c2", PALETTE[3]
"""Colors of unseen episodes, of those of the training, and of what the paper says."""

MARGIN, AFTER = 0.08, 1.015
"""Free part of the ordinate above and below what is drawn, and length of the abscissa in that of the training."""

HALO = [patheffects.withStroke(linewidth=2.5, foreground="white")]


@dataclass(frozen=True)
class Measure:
    """A column of the logs followed over training.

    Attributes:
        name: The column.
        title: What it is called.
        about: What it is, in a sentence without its full stop.
        figure: Number of the paper's figure of it.
        mark: What the text of section 4.2 of the paper says of it.
        level: The value of the measure that this is about, or None.
        frames: The frames of training that this is about, or None.
        fraction: Whether it is a fraction, shown in percent from 0 to 100.
    """

    name: str
    title: str
    about: str
    figure: int
    mark: str
    level: float | None = None
    frames: float | None = None
    fraction: bool = False


MEASURES = (
    Measure("return", "Return of an episode", "The sum of an episode's rewards", 2, "paper: trained for 50 M steps", frames=50e6),
    Measure(
        "survival",
        "Episodes survived",
        "The share of episodes in which the satellite lives to the end",
        3,
        "paper, end of training: 94.5 %",
        level=0.945,
        fraction=True,
    ),
    Measure(
        "collected", "Data collected", "The return without the penalty for dying", 4, "maximum: scanning all the time", level=1.0
    ),
    Measure(
        "fill",
        "Data store at the end",
        "The filled share of the data buffer at the end of an episode",
        5,
        "paper: downlinks better from 17 M steps on",
        frames=17e6,
        fraction=True,
    ),
)

MARKED = "NadirScan-v1"
"""The preset that the paper trains in."""

BAR = 0.34
"""Height of a policy's row, inches."""

MODEST = 0.06
"""Share of the longest bar from which on a part is wide enough for its number."""


def shown(measure: Measure, log: Columns, evaluations: Columns) -> bool:
    """Return whether there is anything to draw; ``collected`` is left out if it always equals the return."""
    columns = [(part, part.get(measure.name, ())) for part in (log, evaluations)]
    if measure.name == "collected" and all(_same(part.get("return", ()), column) for part, column in columns):
        return False
    return any(isfinite(value) for _, column in columns for value in column)


def _same(one: Sequence[float], other: Sequence[float]) -> bool:
    return np.array_equal(np.asarray(one, dtype=float), np.asarray(other, dtype=float), equal_nan=True)


def curve(measure: Measure, log: Columns, evaluations: Columns, path: Path, *, marked: bool) -> Path:
    """Draw a measure over the steps of training to the file ``path``, .png, .svg or .pdf.

    Args:
        measure: What is drawn.
        log: Columns ``frames`` and that of the measure, means over the episodes of the training that ended last.
        evaluations: The same on unseen episodes, with ``return_half_width``.
        path: The file to write.
        marked: Whether the paper's mark is drawn.
    """
    figure = Figure(figsize=(5.2, 2.9), dpi=140, layout="constrained", facecolor="white")
    panel = figure.subplots()
    tidy(panel)
    _lines(panel, measure, log, evaluations)
    _limits(panel, measure, log, evaluations, marked)
    if marked:
        _mark(panel, measure)
    panel.xaxis.set_major_formatter(EngFormatter(sep=" "))
    panel.set_xlabel("steps of training", color=INK, fontsize=9.5)
    if panel.get_legend_handles_labels()[1]:
        figure.legend(loc="outside upper left", ncols=2, frameon=False, fontsize=9, labelcolor=INK, borderaxespad=0.0)
    return save(figure, path)


def _lines(panel: Axes, measure: Measure, log: Columns, evaluations: Columns) -> None:
    """Episodes of the training thin, fresh ones thick with their confidence."""
    if measure.name in evaluations:
        frames, values = (np.asarray(evaluations[name], dtype=float) for name in ("frames", measure.name))
        panel.plot(frames, values, "o-", color=FRESH, linewidth=1.9, markersize=3.2, zorder=3, label="unseen episodes")
        if measure.name == "return":
            half = np.asarray(evaluations["return_half_width"], dtype=float)
            panel.fill_between(frames, values - half, values + half, color=FRESH, alpha=0.2, linewidth=0, zorder=2.5)
    if measure.name in log:
        panel.plot(log["frames"], log[measure.name], color=TRAINING, linewidth=0.9, zorder=2, label="while training")


def _limits(panel: Axes, measure: Measure, log: Columns, evaluations: Columns, marked: bool) -> None:
    panel.set_xlim(0.0, AFTER * max(frames for part in (log, evaluations) for frames in part.get("frames", ())))
    if measure.fraction:
        panel.set_ylim(0.0, 1.03)
        panel.yaxis.set_major_formatter(PercentFormatter(1.0))
        return
    low, high = panel.dataLim.intervaly
    if marked and measure.level is not None:
        low, high = min(low, 0.0), max(high, measure.level)
    free = MARGIN * max(high - low, 1e-9)
    panel.set_ylim(low - free, high + free)


def _mark(panel: Axes, measure: Measure) -> None:
    """A dashed line with its name, or the name and an arrow at the right where the line lies beyond what was trained."""
    look: dict[str, Any] = dict(color=PAPER, linewidth=1.1, linestyle=(0, (4, 2)), zorder=1.5)
    text: dict[str, Any] = dict(color=PAPER, fontsize=8.5, zorder=4, path_effects=HALO)
    if measure.level is not None:
        panel.axhline(measure.level, **look)
        at: dict[str, Any] = dict(xy=(1.0, measure.level), xycoords=panel.get_yaxis_transform(), textcoords="offset points")
        panel.annotate(measure.mark, xytext=(-3.0, -3.0), ha="right", va="top", **at, **text)
        return
    assert measure.frames is not None
    last = panel.get_xlim()[1]
    if measure.frames > last:
        panel.annotate(f"{measure.mark} →", (1.0, 0.03), xycoords="axes fraction", ha="right", va="bottom", **text)
        return
    panel.axvline(measure.frames, **look)
    offset, side = (-4.0, "right") if measure.frames > 0.5 * last else (4.0, "left")
    at = dict(xy=(measure.frames, 0.03), xycoords=panel.get_xaxis_transform(), textcoords="offset points")
    panel.annotate(measure.mark, xytext=(offset, 0.0), ha=side, va="bottom", **at, **text)


def deaths_chart(deaths: Mapping[str, Mapping[str, int]], path: Path) -> Path:
    """Draw a bar for each policy to the file ``path``, .png, .svg or .pdf, as long as its deaths are many, parted by what failed.

    Args:
        deaths: By policy, the number of episodes in which each aliveness check failed at the end.
        path: The file to write.
    """
    causes = sorted({cause for counts in deaths.values() for cause in counts})
    longest = max(sum(counts.values()) for counts in deaths.values())
    figure = Figure(figsize=(7.2, BAR * len(deaths) + 0.9), dpi=140, layout="constrained", facecolor="white")
    panel = figure.subplots()
    tidy(panel)
    panel.grid(axis="y", visible=False)
    ends = [0] * len(deaths)
    for color, cause in zip(PALETTE[3:] + PALETTE[:3], causes, strict=False):
        counts = [n.get(cause, 0) for n in deaths.values()]
        bars = panel.barh(range(len(ends)), counts, 0.7, ends, color=color, label=plain_cause(cause))
        panel.bar_label(
            bars, [str(n) if n > MODEST * longest else "" for n in counts], label_type="center", color="white", fontsize=9
        )
        ends = [end + n for end, n in zip(ends, counts, strict=True)]
    panel.set_yticks(range(len(ends)), [visible(name) for name in deaths])
    panel.invert_yaxis()
    panel.xaxis.set_major_locator(MaxNLocator(integer=True))
    panel.set_xlabel("episodes", color=INK, fontsize=9.5)
    figure.legend(loc="outside upper left", ncols=len(causes), frameon=False, fontsize=9, labelcolor=INK, borderaxespad=0.0)
    return save(figure, path)


def plain_cause(check: str) -> str:
    """Return the name of an aliveness check in plain words."""
    return check.removesuffix("_valid").replace("rw_", "wheel ").replace("_", " ")
