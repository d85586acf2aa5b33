"""Time, the Sun's position and the Earth's orientation, as the Basilisk spacecraft simulator sees them.

Epochs are ET: TDB seconds past J2000 (2000-01-01 12:00:00 TDB), float64, of any shape and on any device; functions of tensors
raise TypeError for other types. Positions are geometric (no light time, no aberration), relative to the Earth's center, along the
J2000 (ICRF) axes.

Sources:
    UTC to TDB: leap seconds and the one-term TDB - TT formula of the NAIF kernel naif0012.tls.
    Sun: Chebyshev series fitted to JPL DE440 by `scripts/tools/make_tables.py`, within 0.5 m and 1e-4 m/s of it.
    Earth: the body-fixed frame IAU_EARTH of the NAIF kernel pck00010.tpc, a uniform rotation about a slowly drifting
    pole (no nutation, no UT1).

The first call that needs the Sun on a device copies the table there; make it before capturing a CUDA graph or calling
a function compiled with `fullgraph=True`.
"""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Callable
from datetime import datetime, timedelta
from functools import cache
from importlib.resources import files
from typing import NamedTuple

import numpy as np
import torch
from numpy.polynomial import chebyshev
from numpy.typing import NDArray
from torch import Tensor

from bsk_torch.astro.epochs import read_epoch

__all__ = [
    "coverage",
    "coverage_in_words",
    "earth_angles",
    "earth_fixed_sun",
    "earth_orientation",
    "earth_orientation_rate",
    "parse_utc",
    "sun_position",
    "sun_state",
]

_Array = NDArray[np.float64]

DAY = 86400.0
"""Seconds in a day."""

CENTURY = 36525 * DAY
"""Seconds in a Julian century."""

EARTH_ROTATION_RATE = math.radians(360.9856235) / DAY
"""Rate of the Earth's prime meridian angle W, rad/s (pck00010, BODY399_PM)."""

POLE_RIGHT_ASCENSION_RATE = math.radians(-0.641) / CENTURY
"""Rate of the right ascension of the Earth's pole, rad/s (pck00010, BODY399_POLE_RA)."""

POLE_DECLINATION_RATE = math.radians(-0.557) / CENTURY
"""Rate of the declination of the Earth's pole, rad/s (pck00010, BODY399_POLE_DEC)."""

TT_MINUS_TAI = 32.184
"""Terrestrial time less atomic time, s."""

LEAP_SECONDS = (
    ((1988, 1), 24),
    ((1990, 1), 25),
    ((1991, 1), 26),
    ((1992, 7), 27),
    ((1993, 7), 28),
    ((1994, 7), 29),
    ((1996, 1), 30),
    ((1997, 7), 31),
    ((1999, 1), 32),
    ((2006, 1), 33),
    ((2009, 1), 34),
    ((2012, 7), 35),
    ((2015, 7), 36),
    ((2017, 1), 37),
)
"""TAI - UTC in s from the first day of each (year, month) on, as far back as the Sun table needs (naif0012)."""

_J2000 = datetime(2000, 1, 1, 12)


class _Series(NamedTuple):
    """Chebyshev series of the Sun's position: coefficients in m of shape (terms, 3, segments), times in s of ET."""

    start: float
    segment: float
    coefficients: _Array


class _SunTable(NamedTuple):
    """Power series of the Sun's state on one device: coefficients of shape (segments, 3, terms), times in s of ET."""

    start: float
    segment: float
    position: Tensor
    velocity: Tensor


# Not functools.cache: torch.compile ignores it and would trace into reading the file.
_TABLES: dict[torch.device, _SunTable] = {}


def parse_utc(text: str | datetime) -> float:
    """Convert an epoch to ET.

    Args:
        text: The epoch in a form that SPICE reads, such as "2021 FEB 05 09:12:05.830 (UTC)" or "2021-02-05T09:12:05.830Z" (see
            :mod:`bsk_torch.astro.epochs`); UTC unless it says TDB, TDT or TT. Second 60 is accepted where a leap second was
            inserted. Or a ``datetime``, UTC unless it has a time zone.

    Returns:
        ET in s past J2000, rounded to about 1e-7 s.

    Raises:
        ValueError: If the text has another form, names no real date or time, or lies outside the Sun table.
    """
    date, second, scale = read_epoch(text)
    try:
        _check_second(date, second, scale)
    except (ValueError, OverflowError) as error:
        raise ValueError(f"epoch {text!r} is not a valid UTC time: {error}") from error
    et = _et(date, second, scale)
    first, last = coverage()
    if not first <= et <= last:
        raise ValueError(f"epoch {text!r} lies outside the ephemeris table, which covers {coverage_in_words()} (TDB)")
    return et


def et_of_dates(dates: Tensor) -> Tensor:
    """Return the ET of dates in UTC, [n] s past J2000, as :func:`parse_utc` does one by one.

    Args:
        dates: Year, month, day, hour, minute, second (0 to 59) and millisecond of dates that exist, [n, 7] int64, on the CPU.
    """
    year, month, day, hour, minute, second, millisecond = dates.numpy().T
    months = (year - 1970) * 12 + month - 1
    days = months.astype("datetime64[M]").astype("datetime64[D]") - np.datetime64("2000-01-01") + (day - 1)
    return torch.from_numpy(
        et_of_utc((days.astype(np.int64) * 1440 + (hour - 12) * 60 + minute) * 60.0 + (second * 1000 + millisecond) / 1000.0)
    )


def et_of_utc(seconds: _Array) -> _Array:
    """Return ET, s past J2000, of seconds of UTC past 2000-01-01 12:00 UTC, days of 86,400 s, of any shape."""
    begin = np.array([(datetime(*start, 1) - _J2000).total_seconds() for start, _ in LEAP_SECONDS])
    steps = np.array([offset for _, offset in LEAP_SECONDS])
    tai_minus_utc = steps[np.maximum(np.searchsorted(begin, seconds, side="right") - 1, 0)]
    return et_of_tt(seconds + tai_minus_utc + TT_MINUS_TAI)


def et_of_tt(tt: _Array | float) -> _Array:
    """Return ET, s past J2000, of seconds of terrestrial time past 2000-01-01 12:00 TT, of any shape."""
    return np.asarray(tt + _tdb_minus_tt(tt))


def utc_seconds(et: Tensor) -> Tensor:
    """Return seconds of UTC past 2000-01-01 12:00 UTC at ET, float64 s of any shape: days of 86,400 s, without leap seconds.

    Within an inserted leap second, the last second of the day is repeated. The inverse of ``UTC + (TAI - UTC) + 32.184 s +
    (TDB - TT)``, of which the last term is evaluated at ET itself: it changes by 3e-10 s in between.
    """
    mean_anomaly = 6.239996 + 1.99096871e-7 * _checked(et)
    tai = et - 1.657e-3 * torch.sin(mean_anomaly + 1.671e-2 * torch.sin(mean_anomaly)) - TT_MINUS_TAI
    offsets = [offset for _, offset in LEAP_SECONDS]
    begin = [(datetime(*start, 1) - _J2000).total_seconds() + offset for start, offset in LEAP_SECONDS]
    since = torch.tensor(begin, dtype=torch.float64, device=et.device)
    steps = torch.tensor(offsets, dtype=torch.float64, device=et.device)
    return tai - steps[(torch.bucketize(tai, since, right=True) - 1).clamp(min=0)]


def coverage() -> tuple[float, float]:
    """First and last ET, in s past J2000, for which the Sun's position is known."""
    table = _load_series()
    return table.start, table.start + table.segment * table.coefficients.shape[-1]


def coverage_in_words() -> str:
    """The same as dates, such as ``"1989-11-30 to 2060-03-06"``."""
    begin, end = (_J2000 + timedelta(seconds=bound) for bound in coverage())
    return f"{begin:%Y-%m-%d} to {end:%Y-%m-%d}"


def utc_in_words(et: Tensor) -> list[str]:
    """Return the UTC of ET, [n] s past J2000, to the millisecond, such as ``"2026-04-13T22:18:17.006Z"``."""
    milliseconds = np.round(utc_seconds(et).cpu().numpy() * 1e3).astype("timedelta64[ms]")
    return [f"{word}Z" for word in np.datetime_as_string(np.datetime64("2000-01-01T12:00:00", "ms") + milliseconds).tolist()]


def date_in_words(et: float) -> str:
    """Return the UTC of one ET, s past J2000; see :func:`utc_in_words`."""
    return utc_in_words(torch.tensor([et], dtype=torch.float64))[0]


def sun_position(et: Tensor) -> Tensor:
    """Position of the Sun relative to the Earth, m along J2000 axes, ``(*et.shape, 3)``; NaN outside `coverage`."""
    table = _sun_table(_checked(et).device)
    index, powers = _locate(table, et)
    return _within(table, et, _evaluate(table.position, index, powers))


def sun_state(et: Tensor) -> tuple[Tensor, Tensor]:
    """Position, m, and velocity, m/s, of the Sun, ``(*et.shape, 3)`` each; see :func:`sun_position`."""
    table = _sun_table(_checked(et).device)
    index, powers = _locate(table, et)
    position = _within(table, et, _evaluate(table.position, index, powers))
    return position, _within(table, et, _evaluate(table.velocity, index, powers))


def earth_angles(et: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Angles of the frame IAU_EARTH (pck00010).

    ``alpha = -0.641 T``, ``delta = 90 - 0.557 T`` and ``W = 190.147 + 360.9856235 d``, in degrees, at d days and T Julian
    centuries of TDB past J2000.

    Returns:
        Right ascension and declination of the pole and the prime meridian angle W, in rad, each shaped like `et`. W is reduced to
        [0, 2 pi) after rounding at about 1e-11 rad.
    """
    days, centuries = _checked(et) / DAY, et / CENTURY
    alpha = torch.deg2rad(-0.641 * centuries)
    delta = torch.deg2rad(90.0 - 0.557 * centuries)
    meridian = torch.deg2rad(190.147 + 360.9856235 * days)
    return alpha, delta, torch.remainder(meridian, 2 * math.pi)


def earth_orientation(et: Tensor) -> Tensor:
    """Return the DCM [PN], ``(*et.shape, 3, 3)``: components along J2000 axes to those along axes of the frame IAU_EARTH.

    ``[PN] = R3(W) R1(90 deg - delta) R3(90 deg + alpha)`` with right ascension alpha and declination delta of the pole and the
    prime meridian W of :func:`earth_angles`; R1 and R3 are frame rotations about x and z.
    """
    node, tilt, spin = _euler_angles(et)
    return _about_z(spin) @ _about_x(tilt) @ _about_z(node)


def earth_orientation_rate(et: Tensor) -> Tensor:
    """Time derivative of `earth_orientation`, 1/s, by the product rule with constant rates of alpha, delta and W.

    ``[PN]' = W' R3'(W) R1 R3 - delta' R3 R1'(90 deg - delta) R3 + alpha' R3 R1 R3'(90 deg + alpha)``, where R1' and R3' are the
    derivatives of the rotations with respect to their angles.
    """
    node, tilt, spin = _euler_angles(et)
    r_node, r_tilt, r_spin = _about_z(node), _about_x(tilt), _about_z(spin)
    by_spin = EARTH_ROTATION_RATE * (_about_z(spin, derivative=True) @ r_tilt @ r_node)
    by_tilt = -POLE_DECLINATION_RATE * (r_spin @ _about_x(tilt, derivative=True) @ r_node)
    return by_spin + by_tilt + POLE_RIGHT_ASCENSION_RATE * (r_spin @ r_tilt @ _about_z(node, derivative=True))


def earth_fixed_sun(et: Tensor, orientation: Callable[[Tensor], Tensor] = earth_orientation) -> Tensor:
    """Position of the Sun in Earth-fixed axes, by default IAU_EARTH, m, ``(*et.shape, 3)``; NaN before `coverage`.

    Behind the end of `coverage` the Sun stays where it is at the end, as for look-ahead.
    """
    return (orientation(et) @ sun_position(et.clamp(max=coverage()[1])).unsqueeze(-1)).squeeze(-1)


def _check_second(date: datetime, second: float, scale: str) -> None:
    following = date + timedelta(minutes=1)
    length = 60 + (_tai_minus_utc(following) - _tai_minus_utc(date) if scale == "UTC" else 0)
    if second >= length:
        raise ValueError(f"second must be below {length}")


def _tai_minus_utc(date: datetime) -> int:
    """TAI - UTC in s; before the first entry of the table, that entry."""
    index = bisect_right(LEAP_SECONDS, (date.year, date.month), key=lambda entry: entry[0])
    return LEAP_SECONDS[max(index - 1, 0)][1]


def _et(date: datetime, second: float, scale: str) -> float:
    """ET in s of a minute and the second in it: ``UTC + (TAI - UTC) + 32.184 s + (TDB - TT)``, from ``scale`` on."""
    seconds = (date - _J2000) // timedelta(minutes=1) * 60.0 + second
    if scale == "TDB":
        return seconds
    tt = seconds if scale == "TT" else seconds + _tai_minus_utc(date) + TT_MINUS_TAI
    return tt + float(_tdb_minus_tt(tt))


def _tdb_minus_tt(tt: np.ndarray | float) -> np.ndarray | float:
    """TDB - TT in s: one term in the Earth's eccentric anomaly (naif0012, DELTET/K, EB and M).

    ``K sin E`` with ``E = M + e sin M``, ``M = M0 + M1 tt``, ``K = 1.657e-3 s`` and ``e = 1.671e-2``.
    """
    mean_anomaly = 6.239996 + 1.99096871e-7 * tt
    return 1.657e-3 * np.sin(mean_anomaly + 1.671e-2 * np.sin(mean_anomaly))


@cache
def _load_series() -> _Series:
    resource = files("bsk_torch.astro").joinpath("tables/sun_earth_1990_2060.npz")
    with resource.open("rb") as stream, np.load(stream) as table:
        integers = np.concatenate([table["low"], table["high"]])
        return _Series(float(table["start"]), float(table["segment"]), integers * float(table["quantum"]))


def _sun_table(device: torch.device) -> _SunTable:
    if device not in _TABLES:
        _TABLES[device] = _make_sun_table(device)
    return _TABLES[device]


def _make_sun_table(device: torch.device) -> _SunTable:
    """Put the Sun table on a device, as power series in the segment's time scaled to [-1, 1]."""
    series = _load_series()
    rate = np.zeros_like(series.coefficients)
    rate[:-1] = chebyshev.chebder(series.coefficients) * 2 / series.segment
    # Tensors made under inference mode could never take part in autograd later.
    with torch.inference_mode(False):
        position, velocity = (_power_series(array).to(device) for array in (series.coefficients, rate))
    return _SunTable(series.start, series.segment, position, velocity)


def _power_series(coefficients: _Array) -> Tensor:
    """Convert Chebyshev series (terms, 3, segments) to power series (segments, 3, terms)."""
    terms = coefficients.shape[0]
    basis = np.zeros((terms, terms))
    for degree in range(terms):
        basis[degree, : degree + 1] = chebyshev.cheb2poly(np.eye(terms)[degree])[: degree + 1]
    return torch.from_numpy(np.einsum("dxs,dp->sxp", coefficients, basis))


def _checked(et: Tensor) -> Tensor:
    """Return `et` if it is float64; single precision would round epochs to about a minute."""
    if et.dtype != torch.float64:
        raise TypeError(f"et must be a float64 tensor, got {et.dtype}")
    return et


def _locate(table: _SunTable, et: Tensor) -> tuple[Tensor, Tensor]:
    """Segment index, shape of `et`, and powers of the scaled time in it, shape (*et.shape, terms)."""
    segments, _, terms = table.position.shape
    # The clamp follows the conversion so that NaN, too, gets an index that exists.
    index = ((et - table.start) / table.segment).floor().long().clamp(0, segments - 1)
    # Subtracting the segment's middle from et is exact, so the scaled time keeps all of et's precision.
    scaled = (et - (table.start + (index.to(et.dtype) + 0.5) * table.segment)) / (0.5 * table.segment)
    exponents = torch.arange(terms, dtype=et.dtype, device=et.device)
    return index, scaled.unsqueeze(-1) ** exponents


def _evaluate(coefficients: Tensor, index: Tensor, powers: Tensor) -> Tensor:
    """Sum the power series of the indexed segments, shape (*index.shape, 3)."""
    return (coefficients[index] * powers.unsqueeze(-2)).sum(-1)


def _within(table: _SunTable, et: Tensor, value: Tensor) -> Tensor:
    """Replace by NaN what lies outside the table (no error, which would make the host wait for the device)."""
    end = table.start + table.segment * table.position.shape[0]
    inside = (et >= table.start) & (et <= end)
    return torch.where(inside.unsqueeze(-1), value, math.nan)


def _euler_angles(et: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Angles of the rotations about z, x and z, in that order, from J2000 to the Earth-fixed frame, in rad."""
    alpha, delta, meridian = earth_angles(et)
    return 0.5 * math.pi + alpha, 0.5 * math.pi - delta, meridian


def _about_z(angle: Tensor, derivative: bool = False) -> Tensor:
    """Frame rotation about the third axis, [[c, s, 0], [-s, c, 0], [0, 0, 1]], or its derivative with respect to the angle."""
    cos, sin, axis, zero = _elements(angle, derivative)
    return torch.stack([cos, sin, zero, -sin, cos, zero, zero, zero, axis], -1).reshape(*cos.shape, 3, 3)


def _about_x(angle: Tensor, derivative: bool = False) -> Tensor:
    """The same about the first axis, [[1, 0, 0], [0, c, s], [0, -s, c]]."""
    cos, sin, axis, zero = _elements(angle, derivative)
    return torch.stack([axis, zero, zero, zero, cos, sin, zero, -sin, cos], -1).reshape(*cos.shape, 3, 3)


def _elements(angle: Tensor, derivative: bool) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    zero = torch.zeros_like(angle)
    return (-angle.sin(), angle.cos(), zero, zero) if derivative else (angle.cos(), angle.sin(), torch.ones_like(angle), zero)
