"""Style shared by all figures. Figures are created without pyplot, so no global state changes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from io import BytesIO
from itertools import pairwise
from math import isfinite
from pathlib import Path

import numpy as np
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.text import Text

from bsk_torch.files import write_file

PALETTE = ("#2f6db3", "#e8a628", "#2f9e72", "#c1476b", "#7b62b8", "#5aa9c9", "#8c6d4f", "#6b7280")
"""Colors that are distinguishable in print and for color-blind readers."""

UNDATED: dict[str, dict[str, None]] = {"svg": {"Date": None}, "pdf": {"CreationDate": None}}
"""Metadata without a date, by format."""

INK, FAINT = "#333a45", "#d9dde3"
"""Colors of text and of guide lines."""


WIDTH, COLUMN = 10.0, 3.4
"""Widths of figures, inches: of pages and reports, and of a column of a paper."""

SMALLER = 0.78
"""Size of text and lines in a column of a paper, relative to that of wide figures."""


def fit(figure: Figure, width: float) -> None:
    """Make text, lines and markers of a finished figure smaller where it is narrower than :data:`WIDTH`."""
    if width >= WIDTH:
        return
    for panel in figure.axes:
        panel.tick_params(labelsize=9 * SMALLER, length=2)
    for text in figure.findobj(Text):
        assert isinstance(text, Text)
        text.set_fontsize(text.get_fontproperties().get_size_in_points() * SMALLER)
    for line in figure.findobj(Line2D):
        assert isinstance(line, Line2D)
        line.set_linewidth(line.get_linewidth() * SMALLER)
        line.set_markersize(line.get_markersize() * SMALLER)
    for lines in figure.findobj(LineCollection):
        assert isinstance(lines, LineCollection)
        lines.set_linewidth((np.atleast_1d(lines.get_linewidth()) * SMALLER).tolist())


def legend_columns(width: float) -> int:
    """How many entries of a legend stand side by side."""
    return max(2, round(8 * width / WIDTH))


def panels(heights: Sequence[float], width: float = WIDTH) -> tuple[Figure, list[Axes]]:
    """Return a figure with stacked panels that share the abscissa, with ``heights`` in inches."""
    figure = Figure(figsize=(width, sum(heights) + 1.2), dpi=140, layout="constrained", facecolor="white")
    axes = figure.subplots(len(heights), 1, sharex=True, squeeze=False, height_ratios=list(heights))[:, 0]
    for panel in axes:
        tidy(panel)
    return figure, list(axes)


def tidy(panel: Axes) -> None:
    """Set a light grid without a box."""
    panel.spines[["top", "right"]].set_visible(False)
    panel.spines[["left", "bottom"]].set_color(FAINT)
    panel.tick_params(colors=INK, labelsize=9, length=3)
    panel.grid(axis="y", color=FAINT, linewidth=0.6)
    panel.set_axisbelow(True)


def label(panel: Axes, text: str) -> None:
    """Label the ordinate."""
    panel.set_ylabel(text, color=INK, fontsize=9.5)


def caption(panel: Axes, text: str) -> None:
    """Write the title of a panel above it."""
    panel.set_title(text, loc="left", color=INK, fontsize=9.5)


def name_lines(panel: Axes, lines: Mapping[str, tuple[float, str]], height: float) -> None:
    """Write names next to the right ends of lines, in the lines' colors; ``height`` of a name is a fraction of the panel's."""
    bottom, top = panel.get_ylim()
    finite = {name: (end, color) for name, (end, color) in lines.items() if isfinite(end)}
    ends = spread([end for end, _ in finite.values()], height * (top - bottom))
    for end, (name, (_, color)) in zip(ends, finite.items(), strict=True):
        panel.text(1.01, end, name, transform=panel.get_yaxis_transform(), color=color, fontsize=9, va="center")


def spread(heights: Sequence[float], gap: float) -> list[float]:
    """Return heights moved apart, in their order, until neighbors differ by at least ``gap``."""
    order = sorted(range(len(heights)), key=heights.__getitem__)
    moved = list(heights)
    for _ in range(100):
        for low, high in pairwise(order):
            excess = 0.5 * max(0.0, gap - (moved[high] - moved[low]))
            moved[low], moved[high] = moved[low] - excess, moved[high] + excess
    return moved


def dot(marker: str, face: str, edge: str, name: str) -> Line2D:
    """Return a legend entry for a marker."""
    return Line2D([], [], linestyle="", marker=marker, color=face, markeredgecolor=edge, markersize=6.0, label=name)


def headline(figure: Figure, text: str) -> None:
    """Write the title of the figure, aligned left."""
    figure.suptitle(text, x=0.01, ha="left", color=INK, fontsize=12.5, fontweight="bold")


def save(figure: Figure, path: Path) -> Path:
    """Write a figure in the format of the path's suffix, .png, .svg or .pdf, and return the path.

    Equal figures give equal files: SVG and PDF have no date, and an SVG has ids derived from its content. A PDF embeds its fonts
    as TrueType, since publishers reject Type 3.
    """
    with rc_context({"svg.hashsalt": "bsk_torch", "pdf.fonttype": 42}):
        drawn, kind = BytesIO(), path.suffix.removeprefix(".")
        figure.savefig(drawn, format=kind, metadata=UNDATED.get(kind))
    write_file(path, drawn.getvalue())
    return path
