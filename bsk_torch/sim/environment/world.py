"""The world around the spacecraft: Sun, Earth's orientation, ground stations, atmosphere, eclipse, magnetic field.

World modules run first in a tick, so they use the position of the spacecraft one tick ago.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping, Sequence

import torch
from torch import Tensor

from bsk_torch.astro.atmosphere import exponential_density
from bsk_torch.astro.eclipse import illumination
from bsk_torch.astro.frames import lla_to_fixed, rotate_z
from bsk_torch.astro.geodetic import Vertical, axis_shift, geodetic_to_fixed
from bsk_torch.astro.magnetic import dipole_field
from bsk_torch.constants import R_EARTH
from bsk_torch.rand import random_epoch
from bsk_torch.sim.component import Arg, Bus, Component, Field, UserArguments, Values, vec
from bsk_torch.sim.environment.ephemeris import move_sun_and_earth, orient_pole, turned
from bsk_torch.sim.places import STATION_KIND, FixedPlaces, Places, PlaceTables
from bsk_torch.vec3 import Vec3

DEFAULT_STATIONS: tuple[dict[str, object], ...] = tuple(
    {"name": name, "lat": lat, "long": long, "elev": elev}
    for name, lat, long, elev in (
        ("Boulder", 40.009971, -105.243895, 1624.0),
        ("Merritt", 28.3181, -80.6660, 0.9144),
        ("Singapore", 1.3521, 103.8198, 15.0),
        ("Weilheim", 47.8407, 11.1421, 563.0),
        ("Santiago", -33.4489, -70.6693, 570.0),
        ("Dongara", -29.2452, 114.9326, 34.0),
        ("Hawaii", 19.8968, -155.5828, 9.0),
    )
)
"""Default ground stations, on a sphere as in bsk_rl: latitude and longitude in degrees, elevation in meters."""


def on_ellipsoid(args: UserArguments) -> bool:
    """Return whether stations lie on the ellipsoid of WGS84: those of a user, unless there is a radius; for values as given."""
    stations = args["groundStationsData"]
    return args["groundLocationPlanetRadius"] is None and isinstance(stations, list | tuple) and stations is not DEFAULT_STATIONS


def station_arrays(args: Values) -> dict[str, Tensor]:
    """Return Earth-fixed positions [1, 3 S], m (all x, all y, all z), sines of minimum elevations [1, S], ranges [1, S], m.

    Stations :func:`on_ellipsoid` have their shift along the axis [1, S], m, too; others lie on a sphere.
    """
    stations, geodetic = args["groundStationsData"], on_ellipsoid(args)

    def numbers(key: str, default: Tensor) -> Tensor:
        # a falsy value of a station is an unset one
        return torch.tensor([s.get(key) or default.item() for s in stations], dtype=torch.float64)

    latitude, longitude = (torch.tensor([math.radians(s[key]) for s in stations], dtype=torch.float64) for key in ("lat", "long"))
    height = numbers("elev", torch.zeros((), dtype=torch.float64))
    if geodetic:
        r_P = geodetic_to_fixed(latitude, longitude, height)
        shift = {"station_shifts": axis_shift(Vec3.of(r_P))[None]}
    else:
        radius, shift = args["groundLocationPlanetRadius"], {}
        default = torch.tensor(R_EARTH, dtype=torch.float64) if radius is None else radius
        r_P = lla_to_fixed(latitude, longitude, height, numbers("groundLocationPlanetRadius", default))
    return shift | {
        "station_positions_P": r_P.mT.reshape(1, -1),
        "station_sin_elevations": numbers("gsMinimumElevation", args["gsMinimumElevation"]).sin()[None],
        "station_ranges": numbers("gsMaximumRange", args["gsMaximumRange"])[None],
    }


def station_names(stations: Sequence[Mapping[str, object]]) -> tuple[str, ...]:
    """Return the names of ground stations, in the order of their indices."""
    return tuple(f"GroundStation{station.get('name', k)}" for k, station in enumerate(stations))


def station_places(tables: PlaceTables) -> dict[str, Places]:
    """Return the ground stations as a kind of places, at the same points in all environments."""
    arrays, device = station_arrays(tables.world), tables.arguments.device
    r_LP_P = arrays["station_positions_P"].view(1, 3, -1).mT.contiguous().to(device)
    advice = "add stations to world_args['groundStationsData'], lower gsMinimumElevation"
    names = station_names(tables.world["groundStationsData"])
    sines = arrays["station_sin_elevations"].to(device)
    vertical: Vertical = "wgs84" if on_ellipsoid(tables.world) else "radius"
    return {STATION_KIND: FixedPlaces(r_LP_P, lambda rows: sines, advice=advice, names=names, vertical=vertical)}


ANTENNA_TICK = "antenna_tick"
"""Field with the tick after which each station serves the satellite, where stations have a number of ``antennas``."""


def see_stations(bus: Bus) -> None:
    """Write 1 where any station has access to the spacecraft, both as they were one tick ago, else 0 (Basilisk's groundLocation).

    A station at p has access to ``r = [PN] r_BN``, m in P, where ``sin(el) = v . (r - p) / (|v| |r - p|)`` is at least the sine
    of its minimum elevation and ``|r - p|`` at most its maximum range, unless that is negative. The vertical v is p, or on the
    ellipsoid p with its shift along the axis. Sines are compared as signed squares, without roots. Where satellites contend for
    antennas, stations have access from the satellite's turn on.
    """
    r = rotate_z(bus.EN @ bus.r_BN_N, *turned(bus.ephemeris[0].earth_angle, bus.ephemeris_tau - bus.h))
    n, r2 = len(bus.station_ranges), r.dot(r)
    access = torch.zeros_like(r2)
    for i in range(n):
        p = Vec3(*(bus.station_positions_P[i + axis * n] for axis in range(3)))
        p2, least, reach = p.dot(p), bus.station_sin_elevations[i], bus.station_ranges[i]
        along = p.dot(r)
        up = along - p2
        range2 = r2 - along - up
        if bus.has("station_shifts"):
            shift = bus.station_shifts[i]
            up, p2 = up + shift * (r.z - p.z), p2 + shift * (2.0 * p.z + shift)
        sees = (up * torch.abs(up) >= least * torch.abs(least) * p2 * range2) & ((range2 <= reach * reach) | (reach < 0.0))
        if bus.has(ANTENNA_TICK):
            sees = sees & (bus.ticks > bus.antenna_tick[i])
        access = torch.where(sees, 1.0, access)
    bus.station_access = access


def sample_density(bus: Bus) -> None:
    """Write the density, kg/m^3, at the position of one tick ago; see :func:`bsk_torch.astro.atmosphere.exponential_density`."""
    base = bus.atmosphere_radius, bus.atmosphere_density, bus.atmosphere_scale_height
    bus.density_message = exponential_density(bus.r_BN_N, *base)


def cast_shadow(bus: Bus) -> None:
    """Write the illumination at the position of one tick ago under the Sun of this tick; see :mod:`bsk_torch.astro.eclipse`."""
    bus.illumination = illumination(bus.r_BN_N, bus.r_SN_N).to(bus.dtype)


def sample_magnetic_field(bus: Bus) -> None:
    """Write the magnetic field, T in N, at the position of one tick ago, turned as the Earth is in this tick.

    See :func:`bsk_torch.astro.magnetic.dipole_field`.
    """
    r_P = rotate_z(bus.EN @ bus.r_BN_N, bus.cos_earth, bus.sin_earth)
    B_P = dipole_field(r_P, bus.magnetic_dipole_P, bus.magnetic_radius)
    bus.magnetic_field_N = (bus.EN.mT @ rotate_z(B_P, bus.cos_earth, -bus.sin_earth)).to(bus.dtype)


STATION_ARGS = (
    Arg("groundStationsData", DEFAULT_STATIONS, "deg, m", "list of dictionaries lat, long, elev, name", "stations"),
    Arg("groundLocationPlanetRadius", None, "m", "radius of a sphere of stations; None: WGS84", low=1e-9, high=1e9, shared=True),
    Arg("gsMinimumElevation", math.radians(10.0), "rad", "least elevation", low=-math.pi / 2, high=math.pi / 2, shared=True),
    Arg("gsMaximumRange", -1.0, "m", "longest range; no limit where negative", shared=True, endless=True),
)


def ground_stations(count: int, geodetic: bool = False, contended: bool = False) -> Component:
    """Return the component for ``count`` stations, on the ellipsoid if ``geodetic``, with antennas for which satellites contend.

    All are fixed when the tick is built.
    """
    widths = {"station_positions_P": 3 * count, "station_sin_elevations": count, "station_ranges": count}
    widths |= {"station_shifts": count} if geodetic else {}
    turns = Field(ANTENNA_TICK, count, "-", "tick after which each station serves the satellite", many=True, exact=True)
    return Component(
        slot="ground_stations",
        update=see_stations,
        args=STATION_ARGS,
        state=(Field("station_access", 1, "-", "whether any station sees the spacecraft"), *((turns,) if contended else ())),
        params=tuple(Field(name, width, many=True, exact=True) for name, width in widths.items()),
        overwrites=(("station_access", "it follows from orbit and stations"),),
        initial=(lambda args: {ANTENNA_TICK: torch.full((1, count), -1.0, dtype=torch.float64)}) if contended else None,
        prepare=station_arrays,
        places=station_places,
    )


def _fitted_stations(arguments: Mapping[str, object]) -> Component:
    """Return as many stations as are given, on the world's own sphere: satellites have an argument of the same name."""
    stations = arguments["groundStationsData"]
    listed = stations if isinstance(stations, list | tuple) and stations else DEFAULT_STATIONS
    contended = any(isinstance(station, Mapping) and station.get("antennas") for station in listed)

    def prepare(args: Values) -> dict[str, Tensor]:
        radius = arguments["groundLocationPlanetRadius"]
        radius = None if radius is None else torch.as_tensor(radius, dtype=torch.float64)
        return station_arrays({**args, "groundLocationPlanetRadius": radius})

    return dataclasses.replace(ground_stations(len(listed), on_ellipsoid(arguments), contended), prepare=prepare)


GROUND_STATIONS = dataclasses.replace(ground_stations(len(DEFAULT_STATIONS)), fit=_fitted_stations)

EARTH_POLE = Component(slot="earth_pole", update=orient_pole)

EPHEMERIS = Component(
    slot="ephemeris",
    update=move_sun_and_earth,
    args=(
        Arg("utc_init", random_epoch(), "-", "epoch, such as '2021 FEB 05 09:12:05.830 (UTC)'", kind="utc"),
        Arg(
            "earthRotation",
            "IAU_EARTH",
            "-",
            "Basilisk's IAU_EARTH, or ITRF, to a meter: the default for satellites from files of orbits",
            "constant",
            choices=("IAU_EARTH", "ITRF"),
        ),
    ),
)

ATMOSPHERE = Component(
    slot="atmosphere",
    update=sample_density,
    args=(
        Arg("planetRadius", R_EARTH, "m", "radius at which the base density holds", low=0.0, high=1e9),
        Arg("baseDensity", 1.22, "kg/m^3", "density at that radius", low=0.0, high=1e6),
        Arg("scaleHeight", 8000.0, "m", "height over which density falls by e", low=1e-6, high=1e9),
    ),
    params=tuple(Field(name, exact=True) for name in ("atmosphere_radius", "atmosphere_density", "atmosphere_scale_height")),
    prepare=lambda args: {
        "atmosphere_radius": args["planetRadius"],
        "atmosphere_density": args["baseDensity"],
        "atmosphere_scale_height": args["scaleHeight"],
    },
    integrated_only=True,
)

ECLIPSE = Component(
    slot="eclipse",
    update=cast_shadow,
    state=(Field("illumination", 1, "-", "visible fraction of the solar disc"),),
    initial=lambda args: {"illumination": torch.ones(1, dtype=torch.float64)},
    overwrites=(("illumination", "it follows from orbit and Sun"),),
)

MAGNETIC_ARGS = (
    Arg("magneticG10", -30926.0, "nT", "coefficient g of degree 1 and order 0", low=-1e9, high=1e9),
    Arg("magneticG11", -2318.0, "nT", "coefficient g of degree 1 and order 1", low=-1e9, high=1e9),
    Arg("magneticH11", 5817.0, "nT", "coefficient h of degree 1 and order 1", low=-1e9, high=1e9),
    Arg("magneticRadius", 6371200.0, "m", "radius to which they apply", low=1e-6, high=1e9),
)
"""A centered dipole; the defaults are those that Basilisk's simSetPlanetEnvironment sets for the Earth."""


def _dipole(args: Values) -> dict[str, Tensor]:
    parts = torch.broadcast_tensors(*(args[name] * 1e-9 for name in ("magneticG11", "magneticH11", "magneticG10")))
    return {"magnetic_dipole_P": torch.stack(parts, -1), "magnetic_radius": args["magneticRadius"]}


MAGNETIC_FIELD = Component(
    slot="magnetic_field",
    after="eclipse",
    update=sample_magnetic_field,
    args=MAGNETIC_ARGS,
    state=(vec("magnetic_field_N", "T", "magnetic field at the position of one tick ago"),),
    params=(vec("magnetic_dipole_P", "T", exact=True), Field("magnetic_radius", 1, "m", exact=True)),
    overwrites=(("magnetic_field_N", "it follows from the orbit"),),
    prepare=_dipole,
)
