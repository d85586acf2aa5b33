"""The world map that tracks and targets are drawn on."""

from __future__ import annotations

import functools
import json
from importlib.resources import files

import torch
from matplotlib.axes import Axes
from matplotlib.patches import PathPatch
from matplotlib.path import Path
from torch import Tensor

from bsk_torch.astro.frames import fixed_to_lla
from bsk_torch.viz.figures.style import FAINT, WIDTH

GROUND, COAST = "#eceff3", "#b4bcc8"
"""Colors of land and of its coasts."""


@functools.cache
def land() -> Path:
    """Coasts of all land, degrees of longitude and latitude, as closed lines; inland seas run the other way round.

    Source: Natural Earth at 1:110 million, public domain; ``scripts/tools/make_coastlines.py`` made the file.
    """
    text = files("bsk_torch.viz.figures").joinpath("land_110m.geojson").read_text()
    rings = [ring for polygon in json.loads(text)["coordinates"] for ring in polygon]
    return Path.make_compound_path(*(Path(ring, closed=True) for ring in rings))


def ground(r_P: Tensor) -> tuple[Tensor, Tensor]:
    """Longitude and latitude, degrees, below Earth-fixed positions [..., 3]."""
    latitude, longitude, _ = fixed_to_lla(r_P)
    return torch.rad2deg(longitude), torch.rad2deg(latitude)


def world_map(panel: Axes, width: float = WIDTH) -> None:
    """Equirectangular (plate carree) map of the world, degrees, in a figure of a ``width``, inches."""
    meridians = range(-180, 181, 60 if width >= WIDTH else 90)
    panel.set(xlim=(-180.0, 180.0), ylim=(-90.0, 90.0), aspect="equal", anchor="W")
    panel.set_xticks(meridians, [_degrees(angle, "W", "E") for angle in meridians])
    panel.set_yticks(range(-90, 91, 30), [_degrees(angle, "S", "N") for angle in range(-90, 91, 30)])
    panel.grid(axis="both", color=FAINT, linewidth=0.6)
    panel.add_patch(PathPatch(land(), facecolor=GROUND, edgecolor=COAST, linewidth=0.5, zorder=0.4))


def _degrees(angle: int, below: str, above: str) -> str:
    return f"{abs(angle)}°{below if angle < 0 else above if angle > 0 else ''}"


def pieces(x: Tensor, y: Tensor) -> Tensor:
    """Pieces of a line of M points, [M - 1, 5, 2]: from one point to the next, nothing, and once more where the map is left.

    A piece that leaves the map at one side and comes back at the other is drawn over both edges; all else of the second line is
    nan, as what parts the two.
    """
    points = torch.stack([x, y], -1)
    begin, end = points[:-1], points[1:]
    turns = torch.stack([torch.round(x.diff() / 360.0) * 360.0, torch.zeros_like(y[1:])], -1)
    nowhere = torch.full_like(begin, torch.nan)
    torn = turns[:, :1] != 0.0
    again = (torch.where(torn, point, nowhere) for point in (begin + turns, end))
    return torch.stack([begin, end - turns, nowhere, *again], 1)
