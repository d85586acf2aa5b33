"""The Earth as an eye far away sees it: land and sea, day and night, and what is in front of it or behind it."""

from __future__ import annotations

from functools import lru_cache
from typing import NamedTuple

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.patches import PathPatch

from bsk_torch.constants import R_EARTH
from bsk_torch.viz.figures.world import land
from bsk_torch.viz.render.moment import Array, Moment

SEA, LAND, COAST, MESH = "#cfe0f0", "#f1ecdf", "#a9a292", "#b9cde1"
"""Colors of the Earth by day, and of the graticule."""

NIGHT = 0.58, 0.62, 0.72
"""Factors on red, green and blue by night."""

TWILIGHT = 0.1
"""Sine of the Sun's elevation at which it is day, and of its depression below the horizon at which it is night."""

MAP_WIDTH = 2880
"""Pixels around the equator of the map wrapped around the globe: eight in a degree."""

MESH_WIDTH = 30
"""Degrees between the lines of the graticule."""

TILT = 0.55
"""Factor on a satellite's height above the equator in the direction of view, so that north is up."""

EAST, NORTH = np.radians(40.0), np.radians(25.0)
"""From where several satellites are looked at: angle from the Sun to the east, and latitude."""


class Camera(NamedTuple):
    """An eye infinitely far away.

    Attributes:
        axes: Right, up and toward the eye, rows in N, [3, 3].
        radius: Of the Earth, pixels.
        centre: Of the Earth in both directions, pixels.
    """

    axes: Array
    radius: float
    centre: float

    def project(self, r_N: Array) -> tuple[Array, Array]:
        """Pixels [..., 2] of positions [..., 3] m in N, and which of them the Earth does not hide, [...]."""
        x = r_N @ self.axes.T / R_EARTH
        pixels = self.centre + self.radius * x[..., :2] * (1.0, -1.0)
        return pixels, (x[..., 2] > 0.0) | (np.hypot(x[..., 0], x[..., 1]) > 1.0)

    def enlarged(self, factor: int) -> Camera:
        """The eye for a picture that is ``factor`` times as large."""
        return Camera(self.axes, factor * self.radius, factor * self.centre)


def camera(moment: Moment, size: int) -> Camera:
    """The eye for a square picture of ``size`` pixels: above a single satellite, or above the afternoon for several."""
    if len(moment.names) == 1:
        towards = moment.r_N[0] * (1.0, 1.0, TILT)
    else:
        longitude = np.arctan2(moment.sun_N[1], moment.sun_N[0]) + EAST
        towards = np.array([np.cos(longitude) * np.cos(NORTH), np.sin(longitude) * np.cos(NORTH), np.sin(NORTH)])
    towards = towards / np.linalg.norm(towards)
    right = np.array([-towards[1], towards[0], 0.0])
    right = right / np.linalg.norm(right)
    far = np.linalg.norm(moment.orbits_N, axis=-1).max() / R_EARTH
    radius = round(0.5 * size / max(1.05 * far, 1.12))  # whole, or the Earth would breathe with the osculating orbit
    return Camera(np.stack([right, np.cross(towards, right), towards]), radius, 0.5 * size)


def globe(eye: Camera, moment: Moment, size: int) -> Array:
    """The Earth on white, [size, size, 3] uint8."""
    rows, columns, n_C, cover = _disc(eye.radius, size)
    n_P = n_C @ (eye.axes @ moment.PN.T).astype(np.float32)
    day = world_texture()[_texels(n_P)]
    sun = n_C @ (eye.axes @ moment.sun_N).astype(np.float32)
    light = np.clip(0.5 + sun / (2.0 * TWILIGHT), 0.0, 1.0)[:, None]
    lit = day * (light + (1.0 - light) * np.asarray(NIGHT, dtype=np.float32))
    picture = np.full((size, size, 3), 255, dtype=np.uint8)
    picture[rows, columns] = lit * cover + 255.0 * (1.0 - cover)
    return picture


def _texels(n_P: Array) -> tuple[Array, Array]:
    """Rows and columns of the map where directions [n, 3] in P leave the Earth."""
    height, width = world_texture().shape[:2]
    row = (0.5 - np.arcsin(np.clip(n_P[:, 2], -1.0, 1.0)) / np.pi) * height
    column = (0.5 + np.arctan2(n_P[:, 1], n_P[:, 0]) / (2.0 * np.pi)) * width
    return np.minimum(row.astype(np.int32), height - 1), np.minimum(column.astype(np.int32), width - 1)


@lru_cache(maxsize=8)
def _disc(radius: float, size: int) -> tuple[Array, Array, Array, Array]:
    """Rows and columns of the pixels that show the Earth, its normals there in camera axes, and how much of a pixel it covers."""
    middle = (np.arange(size, dtype=np.float32) + 0.5 - 0.5 * size) / radius
    x, y = np.meshgrid(middle, -middle)
    cover = np.clip((1.0 - np.hypot(x, y)) * radius + 0.5, 0.0, 1.0)
    rows, columns = np.nonzero(cover)
    x, y = x[rows, columns], y[rows, columns]
    shrink = np.maximum(np.hypot(x, y), 1.0)
    x, y = x / shrink, y / shrink
    z = np.sqrt(np.clip(1.0 - x * x - y * y, 0.0, None))
    return rows, columns, np.stack([x, y, z], -1), cover[rows, columns, None]


@lru_cache(maxsize=1)
def world_texture() -> Array:
    """Equirectangular map of the world from 180 degrees west and 90 degrees north on, [height, width, 3] uint8."""
    figure = Figure(figsize=(MAP_WIDTH / 100, MAP_WIDTH / 200), dpi=100, facecolor=SEA)
    panel = figure.add_axes((0.0, 0.0, 1.0, 1.0), xlim=(-180.0, 180.0), ylim=(-90.0, 90.0))
    panel.set_axis_off()
    panel.vlines(range(-180, 181, MESH_WIDTH), -90.0, 90.0, color=MESH, linewidth=2.0)
    panel.hlines(range(-90 + MESH_WIDTH, 90, MESH_WIDTH), -180.0, 180.0, color=MESH, linewidth=2.0)
    panel.add_patch(PathPatch(land(), facecolor=LAND, edgecolor=COAST, linewidth=1.5))
    canvas = FigureCanvasAgg(figure)
    canvas.draw()
    return np.asarray(canvas.buffer_rgba())[..., :3].copy()
