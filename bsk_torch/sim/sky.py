"""Where Sun and Earth will be: records an hour apart, for as long as the arcs reach."""

from __future__ import annotations

from collections.abc import Sequence
from types import SimpleNamespace
from typing import Any

import torch
from torch import Tensor

from bsk_torch.astro.ephemeris import EARTH_ROTATION_RATE, earth_angles, sun_state
from bsk_torch.astro.frames import rotate_z
from bsk_torch.sim.component import Bus, Field, Layout, Track, vec
from bsk_torch.sim.span import SPAN, pole_matrix, pole_rate
from bsk_torch.vec3 import Mat3, Vec3

SKY = Track(
    name="sky",
    spacing=SPAN,
    fields=(
        vec("r_sun", "m", "Sun relative to Earth", exact=True),
        vec("v_sun", "m/s", exact=True),
        Field("earth_angle", 1, "rad", "prime meridian", exact=True),
        Field("pole_rows", 9, "-", "DCM from N to axes with z along the Earth's pole", exact=True),
    ),
)
"""What every tick needs to know of Sun and Earth."""


def sky_records(et: Tensor, hours: int) -> Tensor:
    """Records [n, hours, 16] of :data:`SKY`, one an hour from ET [n] on."""
    times = et.unsqueeze(-1) + SKY.spacing * torch.arange(hours, device=et.device)
    parts = [*sun_state(times), earth_angles(times)[2].unsqueeze(-1), pole_matrix(times).stack().flatten(-2)]
    return torch.cat(parts, -1)


def orient_pole(bus: Bus) -> None:
    """DCM from N to the axes whose z is the Earth's pole, moved on by its small drift since the last record of the sky."""
    rows = bus.sky[0].pole_rows
    x, y, z = Vec3(*rows[:3]), Vec3(*rows[3:6]), Vec3(*rows[6:])
    drift = pole_rate(Mat3(x, y, z)) * bus.sky_tau
    bus.pole = Mat3(x - z * drift.y + y * drift.z, y - x * drift.z + z * drift.x, z - y * drift.x + x * drift.y)


def move_sun_and_earth(bus: Bus) -> None:
    """Sun and Earth's orientation at the end of the tick; the Sun on the cubic through two records of the sky."""
    start, end = bus.sky
    s = bus.sky_tau * (1.0 / SKY.spacing)
    step = (end.r_sun - start.r_sun) - start.v_sun * SKY.spacing
    turn = (end.v_sun - start.v_sun) * SKY.spacing
    c2, c3 = step * 3.0 - turn, turn - step * 2.0
    bus.r_sun = start.r_sun + (start.v_sun * SKY.spacing + (c2 + c3 * s) * s) * s
    bus.v_sun = start.v_sun + (c2 * 2.0 + c3 * (3.0 * s)) * (s * (1.0 / SKY.spacing))
    bus.cos_earth, bus.sin_earth = turned(start.earth_angle, bus.sky_tau)


def turned(angle: Any, tau: Any) -> tuple[Any, Any]:
    """Cosine and sine of the meridian's ``angle`` tau seconds on; by series, which are exact to 1e-15 for two hours."""
    x = EARTH_ROTATION_RATE * tau
    x2 = x * x
    cos = sin = torch.ones_like(x2)
    for k in range(12, 0, -2):
        cos, sin = 1.0 - cos * x2 * (1.0 / (k * (k - 1))), 1.0 - sin * x2 * (1.0 / (k * (k + 1)))
    sin = sin * x
    cos_start, sin_start = torch.cos(angle), torch.sin(angle)
    return cos_start * cos - sin_start * sin, sin_start * cos + cos_start * sin


def put_track(bus: Bus, track: Track, planes: Sequence[Any], tau: Any) -> None:
    """Write to the bus the records of a track, from all their planes, and the seconds since the last one that has passed."""
    layout, records = Layout(track.fields), [SimpleNamespace() for _ in range(track.count)]
    for k, record in enumerate(records):
        layout.put(record, planes[k * track.width : (k + 1) * track.width])
    setattr(bus, track.name, records)
    setattr(bus, f"{track.name}_tau", tau)


def sky_at(planes: Sequence[Any], tau: Any) -> Bus:
    """Sun and Earth on a bus of their own, from the planes of the records and the seconds since the first."""
    bus = Bus(0)
    put_track(bus, SKY, planes, tau)
    orient_pole(bus)
    move_sun_and_earth(bus)
    return bus


def fixed(sky: Bus, r: Vec3) -> Vec3:
    """Earth-fixed components of r in N."""
    return rotate_z(sky.pole @ r, sky.cos_earth, sky.sin_earth)
