"""Sun and Earth in the future: records an hour apart, for as long as the arcs reach, and their interpolation.

E are the axes of the Earth's equator: z along the pole, x toward the ascending node of the equator. Earth-fixed axes P follow
from them by the angle W of the prime meridian, ``[PN] = R3(W) [EN]``.
"""

from __future__ import annotations

from collections.abc import Sequence
from types import SimpleNamespace

import torch
from torch import Tensor

from bsk_torch.astro.earth_rotation import IAU_EARTH, Earth
from bsk_torch.astro.ephemeris import (
    EARTH_ROTATION_RATE,
    POLE_DECLINATION_RATE,
    POLE_RIGHT_ASCENSION_RATE,
    coverage,
    sun_state,
)
from bsk_torch.astro.frames import rotate_z
from bsk_torch.sim.component import Bus, Field, Layout, Track, vec
from bsk_torch.vec3 import Mat3, Vec3

RECORD_SPACING = 3600.0  # seconds between two records

EPHEMERIS_TRACK = Track(
    name="ephemeris",
    spacing=RECORD_SPACING,
    fields=(
        vec("r_SN_N", "m", "Sun relative to the Earth", exact=True),
        vec("v_SN_N", "m/s", exact=True),
        Field("earth_angle", 1, "rad", "prime meridian", exact=True),
        Field("EN_rows", 9, "-", "DCM from N to axes with z along the Earth's pole", exact=True),
    ),
)
"""Records of Sun and Earth, from which every tick interpolates."""


def pole_rate(pole: Mat3) -> Vec3:
    """Return the angular rate omega_EN_E, rad/s, of the axes of :func:`~bsk_torch.astro.earth_rotation.pole_matrix`.

    ``-delta' e_x + alpha' [EN] n_z``.
    """
    ascension = POLE_RIGHT_ASCENSION_RATE
    return Vec3(torch.full_like(pole.z.z, -POLE_DECLINATION_RATE), pole.y.z * ascension, pole.z.z * ascension)


def ephemeris_records(et: Tensor, hours: int, start: Tensor | float = 0.0, earth: Earth = IAU_EARTH) -> Tensor:
    """Return records [n, hours, 16] of :data:`EPHEMERIS_TRACK`, one an hour from ``start``, [n] s after ET [n], s, on.

    ``earth`` is the model of the Earth's rotation.

    No episode reaches the end of the Sun's table, but look-ahead may: there the Sun stays where it is at the end.
    """
    elapsed = EPHEMERIS_TRACK.spacing * torch.arange(hours, dtype=et.dtype, device=et.device)
    elapsed = elapsed + (start.unsqueeze(-1) if isinstance(start, Tensor) else start)
    times = et.unsqueeze(-1) + elapsed  # rounded once: a record does not depend on where its table starts
    parts = [
        *sun_state(times.clamp(max=coverage()[1])),
        earth.meridian(times).unsqueeze(-1),
        earth.pole(times).stack().flatten(-2),
    ]
    return torch.cat(parts, -1)


def orient_pole(bus: Bus) -> None:
    """Write [EN], moved on by its small drift since the last record: ``[EN] = (I - [omega_EN tau]x) [EN](record)``."""
    rows = bus.ephemeris[0].EN_rows
    x, y, z = Vec3(*rows[:3]), Vec3(*rows[3:6]), Vec3(*rows[6:])
    drift = pole_rate(Mat3(x, y, z)) * bus.ephemeris_tau
    bus.EN = Mat3(x - z * drift.y + y * drift.z, y - x * drift.z + z * drift.x, z - y * drift.x + x * drift.y)


def sun_at(bus: Bus, tau: Tensor) -> tuple[Vec3, Vec3]:
    """Return the Sun's position, m, and velocity, m/s, tau seconds after the first of the two records on the bus.

    The Sun is on the cubic through position and velocity of two records T = 3600 s apart (Hermite), with ``s = tau / T``::

        r = r0 + v0 T s + c2 s^2 + c3 s^3,  c2 = 3 d - u,  c3 = u - 2 d,  d = r1 - r0 - v0 T,  u = (v1 - v0) T
    """
    start, end = bus.ephemeris
    s = tau * (1.0 / EPHEMERIS_TRACK.spacing)
    step = (end.r_SN_N - start.r_SN_N) - start.v_SN_N * EPHEMERIS_TRACK.spacing
    turn = (end.v_SN_N - start.v_SN_N) * EPHEMERIS_TRACK.spacing
    c2, c3 = step * 3.0 - turn, turn - step * 2.0
    r_SN_N = start.r_SN_N + (start.v_SN_N * EPHEMERIS_TRACK.spacing + (c2 + c3 * s) * s) * s
    return r_SN_N, start.v_SN_N + (c2 * 2.0 + c3 * (3.0 * s)) * (s * (1.0 / EPHEMERIS_TRACK.spacing))


def move_sun_and_earth(bus: Bus) -> None:
    """Write r_SN_N, m, and v_SN_N, m/s, of the Sun, and cosine and sine of the prime meridian, at the end of the tick."""
    bus.r_SN_N, bus.v_SN_N = sun_at(bus, bus.ephemeris_tau)
    bus.cos_earth, bus.sin_earth = turned(bus.ephemeris[0].earth_angle, bus.ephemeris_tau)


def turned(angle: Tensor, tau: Tensor) -> tuple[Tensor, Tensor]:
    """Return cosine and sine of the prime meridian ``W = angle + w tau``, tau seconds after it was at ``angle``, rad.

    Those of ``w tau`` are power series to the order 13, exact to 1e-15 for two hours; addition theorems give those of the sum.
    """
    x = EARTH_ROTATION_RATE * tau
    x2 = x * x
    cos = sin = torch.ones_like(x2)
    for k in range(12, 0, -2):
        cos, sin = 1.0 - cos * x2 * (1.0 / (k * (k - 1))), 1.0 - sin * x2 * (1.0 / (k * (k + 1)))
    sin = sin * x
    cos_start, sin_start = torch.cos(angle), torch.sin(angle)
    return cos_start * cos - sin_start * sin, sin_start * cos + cos_start * sin


def put_track(bus: Bus, track: Track, planes: Sequence[object], tau: object) -> None:
    """Write to the bus the records of a track, from all their planes, and the seconds tau since the last one that has passed."""
    layout, records = Layout(track.fields), [SimpleNamespace() for _ in range(track.count)]
    for k, record in enumerate(records):
        layout.put(record, planes[k * track.width : (k + 1) * track.width])
    setattr(bus, track.name, records)
    setattr(bus, f"{track.name}_tau", tau)


def ephemeris_at(planes: Sequence[object], tau: object) -> Bus:
    """Return a bus with Sun and Earth alone, from the planes of the records and the seconds since the first."""
    bus = Bus(0)
    put_track(bus, EPHEMERIS_TRACK, planes, tau)
    orient_pole(bus)
    move_sun_and_earth(bus)
    return bus


def fixed(ephemeris: Bus, r: Vec3) -> Vec3:
    """Return the Earth-fixed components of r in N: ``r_P = R3(W) [EN] r_N``."""
    return rotate_z(ephemeris.EN @ r, ephemeris.cos_earth, ephemeris.sin_earth)
