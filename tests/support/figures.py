"""Figures in a column of a paper."""

import re
from contextlib import contextmanager
from itertools import combinations

from matplotlib.figure import Figure
from matplotlib.text import Text

from bsk_torch.viz.figures.style import COLUMN, LEAST, WIDTH

SLACK = 0.015
"""Inches by which the box of a text may reach over the edge of a figure or over another box: letters are smaller than boxes."""


def media_width(path):
    """Width of the page of a PDF, inches."""
    return float(re.search(rb"/MediaBox \[ *\S+ +\S+ +(\S+)", path.read_bytes())[1]) / 72.0


@contextmanager
def saved():
    """The figures that are saved meanwhile."""
    figures, savefig = [], Figure.savefig

    def keep(figure, *arguments, **options):
        figures.append(figure)
        return savefig(figure, *arguments, **options)

    Figure.savefig = keep
    try:
        yield figures
    finally:
        Figure.savefig = savefig


def figure_of(draw, drawn, path, title):
    """Draw what is ``drawn`` with a function to a PNG; its figure."""
    with saved() as figures:
        content = draw(drawn, path, title).read_bytes()
    assert content[:4] == b"\x89PNG"
    assert len(content) > 10_000
    return figures[-1]


def check_column(draw, drawn, folder, title=""):
    """Draw what is ``drawn`` with a function at both widths; in a column, texts are legible, whole, and apart from each other."""
    with saved() as figures:
        for width in (WIDTH, COLUMN):
            path = draw(*drawn, folder / f"{draw.__name__}_{width}.pdf", title=title, width=width)
            assert abs(media_width(path) - width) < 1e-3
    assert not (found := unreadable(figures[-1])), found


def unreadable(figure):
    """Sentences about texts of a figure that are too small, cut off, or overlap."""
    texts = drawn_texts(figure)
    boxes = [text.get_window_extent().padded(-SLACK * figure.dpi) for text in texts]
    named = [repr(text.get_text()) for text in texts]
    found = [
        f"{name} has {text.get_fontsize()} points" for name, text in zip(named, texts, strict=True) if text.get_fontsize() < LEAST
    ]
    width, height = figure.bbox.size
    for name, box in zip(named, boxes, strict=True):
        if min(box.x0, box.y0, width - box.x1, height - box.y1) < 0.0:
            found.append(f"{name} is cut off")
    for (name, box), (other, below) in combinations(zip(named, boxes, strict=True), 2):
        if box.overlaps(below):
            found.append(f"{name} overlaps {other}")
    return found


def drawn_texts(figure):
    """Texts that are drawn with the figure: not those of ticks outside the limits."""
    texts, draw = [], Text.draw

    def keep(self, renderer):
        texts.append(self)
        draw(self, renderer)

    Text.draw = keep
    try:
        figure.draw_without_rendering()
    finally:
        Text.draw = draw
    return [text for text in texts if text.get_visible() and text.get_text().strip()]
