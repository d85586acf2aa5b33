"""Style shared by all figures. Figures are created without pyplot, so no global state changes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from io import BytesIO
from itertools import pairwise
from math import isfinite
from pathlib import Path

import numpy as np
from matplotlib import rc_context
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection, PathCollection
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.text import Text

from bsk_torch._text import visible
from bsk_torch.files import write_file

PALETTE = ("#2f6db3", "#e8a628", "#0fa783", "#a52b5b", "#797ae3", "#6ea8bf", "#9a7750", "#6b7280")
"""Colors that are distinguishable in print and for color-blind readers: any two differ by at least 11 in CIELAB, also as seen by
protanopes, deuteranopes and tritanopes (Machado, Oliveira and Fernandes, 2009)."""

UNDATED: dict[str, dict[str, None]] = {"svg": {"Date": None}, "pdf": {"CreationDate": None}}
"""Metadata without a date, by format."""

INK, FAINT = "#333a45", "#d9dde3"
"""Colors of text and of guide lines."""

WIDTH, COLUMN = 10.0, 3.4
"""Widths of figures, inches: of pages and reports, and of a column of a paper."""

SMALLER = 0.78
"""Size of text and lines in a column of a paper, relative to that of wide figures."""

LEAST = 6.5
"""Smallest text in a column of a paper, points."""

PRINT = 300
"""Resolution of narrow figures, dots per inch: of PNG files, and of pixels within other files."""


def fit(figure: Figure, width: float) -> None:
    """Make text, lines and markers of a figure smaller where it is narrower than :data:`WIDTH`, and add room for its headline."""
    if width >= WIDTH:
        return
    figure.set_dpi(PRINT)
    _shrink(figure, width)
    for axis in (axis for panel in figure.axes for axis in (panel.xaxis, panel.yaxis)):
        size = next((text.get_fontsize() for text in axis.get_ticklabels()), 9 * SMALLER)
        axis.set_tick_params(length=2 if axis.get_tick_params().get("length") != 0 else 0, labelsize=size)
    _heighten(figure, figure.texts)


def _shrink(artist: Artist, width: float) -> None:
    for text in artist.findobj(Text):
        assert isinstance(text, Text)
        size = text.get_fontproperties().get_size_in_points()
        text.set_fontsize(min(size, max(LEAST, size * SMALLER)))
    for line in artist.findobj(Line2D):
        assert isinstance(line, Line2D)
        line.set_linewidth(line.get_linewidth() * SMALLER)
        line.set_markersize(line.get_markersize() * SMALLER)
    for lines in artist.findobj(LineCollection):
        assert isinstance(lines, LineCollection)
        lines.set_linewidth((np.atleast_1d(lines.get_linewidth()) * SMALLER).tolist())
    for marks in artist.findobj(PathCollection):
        assert isinstance(marks, PathCollection)
        marks.set_sizes(marks.get_sizes() * width / WIDTH)
        marks.set_linewidth((np.atleast_1d(marks.get_linewidth()) * SMALLER).tolist())


def _literal(artist: Artist) -> None:
    """Draw texts unchanged: a name with dollar signs is no formula, and hidden characters are shown."""
    for text in artist.findobj(Text):
        assert isinstance(text, Text)
        text.set_parse_math(False)
        text.set_text(visible(text.get_text()))


def _heighten(figure: Figure, added: Sequence[Artist]) -> None:
    """Make a figure higher by the heights of artists above or below its panels."""
    _literal(figure)
    height = sum(artist.get_window_extent().height for artist in added) / figure.dpi
    figure.set_figheight(figure.get_figheight() + height)


def legend(owner: Figure | Axes, handles: Sequence[Artist], width: float, columns: int = 5, **place: object) -> None:
    """Write a legend below the panels of a figure that is otherwise finished, or at a ``place`` of a panel.

    At most so many ``columns`` stand side by side, fewer where they do not fit into the ``width``, inches. Figures narrower than
    :data:`WIDTH` become higher by the legend.
    """
    narrow, figure = width < WIDTH, owner.get_figure(root=True)
    assert isinstance(figure, Figure)
    for handle in handles if narrow else ():
        _shrink(handle, width)
    look = {"loc": "outside lower center", "frameon": False, "fontsize": 9 * (SMALLER if narrow else 1.0), "labelcolor": INK}
    if narrow:
        look["columnspacing"] = 1.2
    for count in range(max(1, min(columns, len(handles))), 0, -1):
        entries = owner.legend(handles=handles, ncols=count, **(look | place))
        _literal(entries)
        if count == 1 or entries.get_window_extent().width <= 0.95 * figure.bbox.width:
            break
        entries.remove()
    if narrow:
        _heighten(figure, [entries])


def share(width: float) -> float:
    """Return the height of panels relative to that in wide figures: narrow ones are also lower, but less so."""
    return float((width / WIDTH) ** 0.5)


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
    panel.set_title(text, loc="left", color=INK, fontsize=9.5, wrap=True, parse_math=False)


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
    figure.suptitle(text, x=0.01, ha="left", color=INK, fontsize=12.5, fontweight="bold", wrap=True, parse_math=False)


def finish(
    figure: Figure, path: Path, title: str, width: float, handles: Sequence[Artist] | None = None, columns: int = 5
) -> Path:
    """Write a headline and a legend, if there are any, fit a figure to its ``width``, inches, and :func:`save` it."""
    if title:
        headline(figure, title)
    fit(figure, width)
    if handles is not None:
        legend(figure, handles, width, columns)
    return save(figure, path)


def save(figure: Figure, path: Path) -> Path:
    """Write a figure in the format of the path's suffix, .png, .svg or .pdf, and return the path.

    Equal figures give equal files: SVG and PDF have no date, and an SVG has ids derived from its content. A PDF embeds its fonts
    as TrueType, since publishers reject Type 3.
    """
    _literal(figure)
    with rc_context({"svg.hashsalt": "bsk_torch", "pdf.fonttype": 42, "text.parse_math": False}):
        drawn, kind = BytesIO(), path.suffix.removeprefix(".")
        figure.savefig(drawn, format=kind, dpi=figure.dpi, metadata=UNDATED.get(kind))
    write_file(path, drawn.getvalue())
    return path
