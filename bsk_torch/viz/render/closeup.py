"""An inspection from nearby: where inspectors are about the RSO, where they drift to, and which of its points they have seen."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import torch
from PIL import Image

from bsk_torch.astro.clohessy_wiltshire import propagate
from bsk_torch.astro.relative import cd2hill
from bsk_torch.recording.scenes import targets_of
from bsk_torch.viz.figures.style import INK, PALETTE
from bsk_torch.viz.render.marks import DONE, NAMED, Pen, color_of, shade
from bsk_torch.viz.render.moment import DEAD, Array, Moment, array, of_satellites

if TYPE_CHECKING:
    from bsk_torch.env.base import Tasking

UNLIT, LIT, INSPECTED = range(3)
"""What is known of a point: it has not been lit yet, it has, or it has been inspected while it was lit."""

POINT_COLORS = "#ffffff", PALETTE[1], DONE
"""Colors of points by what is known of them."""

AHEAD, SAMPLES = 0.5, 61
"""Part of a revolution for which the drift of inspectors is shown, and points of its line."""

SCALES = tuple(digit * 10.0**power for power in range(1, 6) for digit in (1.0, 2.0, 3.0, 5.0))
"""Distances that rings are drawn at, m."""

ROOM, PLACE = 0.62, (1.16, 0.82)
"""Radius of the outer ring, and pixels of the RSO from left and top, over half the height of the picture."""

EYE_H = (0.45, -0.5, 0.74)
"""Direction from which the RSO is seen, in its Hill frame: above the orbit, a little from outside and behind."""

BODY, USUAL = 66.0, 480
"""Radius of the enlarged RSO, in pixels of a frame of so many lines."""

DAY, NIGHT, TWILIGHT = (222, 226, 232), (92, 98, 110), 0.1
"""Colors of the RSO in sunlight and in the dark, and the sine of the Sun's height at which one becomes the other."""

DARK = 0.5
"""Visible fraction of the Sun below which the RSO is in the dark."""


@dataclass(frozen=True, kw_only=True)
class CloseUp:
    """An inspection with I inspectors and P points, in the RSO's Hill frame: radial, along the track, orbit normal.

    Attributes:
        rso: Number of the RSO among the satellites of the moment.
        inspectors: Numbers of the inspectors there, [I].
        rho_H: Positions of the inspectors, m [I, 3].
        drifts_H: Positions during half a revolution without maneuvers, m [I, M, 3].
        normals_H: Directions of the points, [P, 3].
        states: What is known of each, :data:`UNLIT`, :data:`LIT` or :data:`INSPECTED`, [P].
        sun_H: Direction to the Sun, [3].
        illumination: Fraction of the Sun that the RSO sees.
        fuel: What the tanks are good for, m/s [I]; not a number without a tank.
        reach: Largest distance from which points are inspected, m; infinite without a limit.
    """

    rso: int
    inspectors: list[int]
    rho_H: Array
    drifts_H: Array
    normals_H: Array
    states: Array
    sun_H: Array
    illumination: float
    fuel: Array
    reach: float


@torch.no_grad()
def look_closely(env: Tasking, row: int, moment: Moment) -> CloseUp | None:
    """The inspection of episode ``row``, of which ``moment`` shows the satellites; nothing for other problems."""
    progress, targets = env.rewarder.recorded(row), targets_of(env, row)
    if progress.kind != "inspection" or targets.owner is None:
        return None
    rso = moment.names.index(env.fleet.names[targets.owner])
    inspectors = [moment.names.index(env.fleet.names[column]) for column in targets.viewers]
    r_N, v_N, HN, BN = (of_satellites(env, row, name) for name in ("r_BN_N", "v_BN_N", "HN", "BN"))
    rho, velocity = cd2hill(r_N[rso], v_N[rso], r_N[inspectors], v_N[inspectors])
    rate = torch.linalg.cross(r_N[rso], v_N[rso]).norm() / r_N[rso].square().sum()
    times = torch.linspace(0.0, AHEAD * 2.0 * math.pi, SAMPLES, dtype=rho.dtype, device=rho.device) / rate
    drifts, _ = propagate(rho.unsqueeze(1), velocity.unsqueeze(1), rate, times)
    normals_B = torch.nn.functional.normalize(targets.r.to(rho.device), dim=1)
    states = torch.where(progress.marks["done"], INSPECTED, torch.where(progress.marks["lit"], LIT, UNLIT))
    tanks = any(simulator.has_tank for simulator in env.fleet.simulators)
    fuel = of_satellites(env, row, "dv_available", "fsw") if tanks else torch.full_like(r_N[:, 0], torch.nan)
    return CloseUp(
        rso=rso,
        inspectors=inspectors,
        rho_H=array(rho),
        drifts_H=array(drifts),
        normals_H=array(normals_B @ BN[rso] @ HN[rso].mT),
        states=array(states),
        sun_H=array(HN[rso]) @ moment.sun_N,
        illumination=float(of_satellites(env, row, "illumination")[rso]),
        fuel=array(fuel[inspectors]),
        reach=math.inf if targets.reach is None else targets.reach,
    )


# -- drawing -------------------------------------------------------------------------------------------------------


def draw_closeup(pen: Pen, moment: Moment, close: CloseUp) -> None:
    """Draw everything that has no letters: rings of distance, inspectors with their drift, and the enlarged RSO."""
    axes, middle = view(), pen.eye.centre * np.array(PLACE)
    pixel = _pixels_per_meter(pen, close)

    def at(r_H: Array) -> Array:
        return middle + pixel * (r_H @ axes[:2].T) * (1.0, -1.0)

    for radius in rings(close):
        turn = np.linspace(0.0, 2.0 * np.pi, 181)
        ring = at(radius * np.stack([np.cos(turn), np.sin(turn), 0.0 * turn], -1))
        _path(pen, ring, 1.0, shade(INK, 70))
    if math.isfinite(close.reach):
        pen.circle(
            tuple(middle.tolist()), close.reach * pixel / pen.unit, outline=shade(DONE, 170), width=max(1, round(1.2 * pen.unit))
        )
    pen.circle(tuple(middle.tolist()), 4.5, fill=shade(INK, 255))
    for rho in close.rho_H:
        foot = at(rho * (1.0, 1.0, 0.0))
        pen.line(foot, at(rho), 1.0, shade(INK, 90))
        pen.circle(tuple(foot.tolist()), 1.6, fill=shade(INK, 110))
    for k, drift in zip(close.inspectors, close.drifts_H, strict=True):
        color = color_of(moment.modes[k])
        if moment.modes[k] != DEAD:
            _path(pen, at(drift), 1.6, shade(color, 150))
    for k, rho in zip(close.inspectors, close.rho_H, strict=True):
        where = tuple(at(rho).tolist())
        pen.circle(where, 7.5, fill="white")
        pen.circle(where, 6.0, fill=color_of(moment.modes[k]))
    _points(pen, close)


def write_closeup_names(pen: Pen, moment: Moment, close: CloseUp) -> None:
    """Distances of the rings, names of the inspectors, and what the enlarged RSO is."""
    axes, middle, unit = view(), pen.eye.centre * np.array(PLACE), pen.unit
    pixel = _pixels_per_meter(pen, close)
    for radius in rings(close):
        x, y = middle + pixel * radius * axes[:2, 1] * (1.0, -1.0)
        pen.text((x, y), f"{radius:,.0f} m", 11.0, anchor="mm", stroke_width=round(2.0 * unit), stroke_fill="white")
    if len(close.inspectors) <= NAMED:
        for k, rho in zip(close.inspectors, close.rho_H, strict=True):
            x, y = middle + pixel * (axes[:2] @ rho) * (1.0, -1.0)
            side, anchor = (10.0, "lm") if x < 1.6 * pen.eye.centre else (-10.0, "rm")
            place = (x + side * unit, y)
            pen.text(place, moment.names[k], 11.0, anchor=anchor, stroke_width=round(1.5 * unit), stroke_fill="white")
    x, y = _corner(2.0 * pen.eye.centre)
    night = ", in eclipse" if close.illumination < DARK else ""
    title = f"{moment.names[close.rso]}, enlarged{night}"
    pen.text((x, y - (BODY + 30.0) * unit), title, 12.0, anchor="mm", stroke_width=round(2.0 * unit), stroke_fill="white")
    for name, direction in (("Sun", close.sun_H), ("Earth", EARTH_H)):
        tip, length = _arrow(direction)
        if length > SHORT:
            pen.text((x + tip[0] * (BODY + 22.0) * unit, y - tip[1] * (BODY + 22.0) * unit), name, 10.0, anchor="mm")


EARTH_H = np.array([-1.0, 0.0, 0.0])
"""Direction to the Earth in a Hill frame."""

SHORT = 0.15
"""Length of a projected unit vector below which no arrow is drawn."""


def view() -> Array:
    """Right, up and toward the eye, rows in the Hill frame, [3, 3]; away from the Earth is up."""
    towards = np.array(EYE_H) / np.linalg.norm(EYE_H)
    right = np.cross(-EARTH_H, towards)
    right = right / np.linalg.norm(right)
    return np.stack([right, np.cross(towards, right), towards])


def rings(close: CloseUp) -> tuple[float, float]:
    """Distances of two rings in the plane of the orbit, of which the outer one encloses the inspectors and their reach."""
    far = max(np.linalg.norm(close.rho_H, axis=-1).max(), close.reach if math.isfinite(close.reach) else 0.0)
    outer = next((scale for scale in SCALES if scale >= far), SCALES[-1])
    return 0.5 * outer, outer


def _pixels_per_meter(pen: Pen, close: CloseUp) -> float:
    return ROOM * pen.eye.centre / rings(close)[1]


def _path(pen: Pen, pixels: Array, width: float, color: tuple[int, ...]) -> None:
    pen.draw.line([tuple(at) for at in pixels.tolist()], fill=color, width=max(1, round(width * pen.unit)), joint="curve")


def _corner(height: float) -> tuple[float, float]:
    """Pixels of the middle of the enlarged RSO in a picture of a height: below at the left."""
    away = (BODY + 34.0) * height / USUAL
    return away, height - away


def _arrow(direction_H: Array) -> tuple[Array, float]:
    """A direction in the picture [2], and how much of it the eye sees."""
    visible = view()[:2] @ direction_H
    length = float(np.linalg.norm(visible))
    return visible / max(length, 1e-12), length


def _points(pen: Pen, close: CloseUp) -> None:
    """The points of the enlarged RSO on the side of the eye, and where Sun and Earth are."""
    (x, y), radius = _corner(2.0 * pen.eye.centre), BODY * pen.unit
    n = close.normals_H @ view().T
    for kind in (UNLIT, LIT, INSPECTED):
        for a, b, _ in n[(close.states == kind) & (n[:, 2] > 0.0)].tolist():
            pen.circle((x + a * radius, y - b * radius), 3.4, fill=POINT_COLORS[kind], outline=INK)
    for direction, color in ((close.sun_H, PALETTE[1]), (EARTH_H, PALETTE[0])):
        tip, length = _arrow(direction)
        if length > SHORT:
            start, end = (np.array([x, y]) + r * pen.unit * tip * (1.0, -1.0) for r in (BODY + 3.0, BODY + 13.0))
            pen.line(start, end, 3.0, shade(color, 255))


def body(close: CloseUp, height: int) -> tuple[Image.Image, tuple[int, int]]:
    """The enlarged RSO by day and night, for a picture of ``height`` pixels, and the pixel of its left upper corner."""
    radius, middle = BODY * height / USUAL, _corner(height)
    size = 2 * math.ceil(radius) + 1
    place = (np.arange(size) - size // 2) / radius
    x, y = np.meshgrid(place, -place)
    away = np.hypot(x, y)
    normals = np.stack([x, y, np.sqrt(np.clip(1.0 - away**2, 0.0, None))], -1)
    light = np.clip(0.5 + normals @ (view() @ close.sun_H) / (2.0 * TWILIGHT), 0.0, 1.0)[..., None] * (close.illumination >= DARK)
    color = light * DAY + (1.0 - light) * NIGHT
    cover = 255.0 * np.clip((1.0 - away) * radius + 0.5, 0.0, 1.0)
    picture = Image.fromarray(np.concatenate([color, cover[..., None]], -1).astype(np.uint8), "RGBA")
    return picture, (round(middle[0]) - size // 2, round(middle[1]) - size // 2)
