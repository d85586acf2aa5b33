"""What the drawings of the documentation have in common."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import matplotlib.pyplot as plt
from matplotlib.axes import Axes
from matplotlib.figure import Figure

INK, GREY, PALE, BLUE, ORANGE, GREEN = "#14171c", "#667085", "#eef2f7", "#2a6ebb", "#d9730d", "#12956a"

plt.rcParams.update({"font.size": 10, "svg.hashsalt": "bsk_torch", "text.color": INK, "axes.edgecolor": GREY})


def canvas(width: float, height: float) -> tuple[Figure, Axes]:
    """Return an empty drawing in inches, whose coordinates are inches, too."""
    figure = plt.figure(figsize=(width, height))
    panel = figure.add_axes((0, 0, 1, 1))
    panel.set(xlim=(0, width), ylim=(0, height))
    panel.axis("off")
    return figure, panel


def box(panel: Axes, x: float, y: float, width: float, height: float, text: str, face: str = PALE, **look: object) -> None:
    """Draw a box with a text in its middle, from the lower left corner."""
    panel.add_patch(plt.Rectangle((x, y), width, height, facecolor=face, edgecolor=GREY, linewidth=0.8))
    panel.text(x + width / 2, y + height / 2, text, ha="center", va="center", **{"fontsize": 9.5, **look})


def arrow(
    panel: Axes, start: Sequence[float], end: Sequence[float], color: str = INK, curve: float = 0.0, **look: object
) -> None:
    """Draw an arrow."""
    style = {"arrowstyle": "-|>", "color": color, "linewidth": 1.1, "shrinkA": 0, "shrinkB": 0, **look}
    panel.annotate("", end, start, arrowprops={**style, "connectionstyle": f"arc3,rad={curve}"})


def save(figure: Figure, script: str) -> None:
    """Write the drawing alongside its script, as SVG."""
    path = Path(script).with_suffix(".svg")
    figure.savefig(path, metadata={"Date": None})
    plt.close(figure)
