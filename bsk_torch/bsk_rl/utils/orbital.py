"""Orbits of one episode; counterpart of ``bsk_rl.utils.orbital``; random ones come from NumPy's global generator.

Angles of arguments are in degrees and lengths in km, as in bsk_rl; elements are in rad and m.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np

from bsk_torch.astro import relative
from bsk_torch.astro.relative import cd2hill, elevation, fibonacci_sphere, hill2cd, rv2HN, rv2omega
from bsk_torch.bsk_rl.sim.trajectory import TrajectorySimulator
from bsk_torch.bsk_rl.utils import orbital_motion as orbitalMotion  # noqa: N812  (the name that programs import)
from bsk_torch.bsk_rl.utils.orbital_motion import ClassicElements, elem2rv, rv2elem
from bsk_torch.rand import MONTHS

if TYPE_CHECKING:
    from bsk_torch.bsk_rl.sats.satellite import Satellite


__all__ = [
    "TrajectorySimulator",
    "cd2hill",
    "elevation",
    "fibonacci_sphere",
    "hill2cd",
    "lla2ecef",
    "orbitalMotion",
    "random_circular_orbit",
    "random_epoch",
    "random_orbit",
    "relative_to_chief",
    "rv2HN",
    "rv2elem",
    "rv2omega",
    "walker_delta",
    "walker_delta_args",
]

logger = logging.getLogger(__name__)

R_ALTITUDE = 6371
"""Radius above which altitudes are counted, km: the Earth's mean radius."""

Randomizer: TypeAlias = "Callable[[Sequence[Satellite]], dict[Satellite, dict[str, object]]]"
"""Returns arguments by satellite, for ``sat_arg_randomizer`` of an environment."""


def lla2ecef(lat: Any, long: Any, radius: Any) -> Any:
    """Return Earth-fixed positions of places on a sphere, [3, ...] in the unit of ``radius``; components are first, as in bsk_rl.

    Args:
        lat: Latitude, degrees [...].
        long: Longitude, degrees [...].
        radius: Distance from the center [...].
    """
    return np.moveaxis(relative.lla2ecef(lat, long, radius), -1, 0)


# -- random orbits ---------------------------------------------------------------------------------------------------------------


def random_unit_vector() -> np.ndarray:
    """Return a random direction [3]."""
    vector = np.random.randn(3)
    return vector / np.linalg.norm(vector)


def random_orbit(
    i: float | None = None,
    a: float = R_ALTITUDE + 500,
    e: float = 0,
    Omega: float | None = None,
    omega: float | None = None,
    f: float | None = None,
    alt: float | None = None,
    r_body: float = R_ALTITUDE,
) -> ClassicElements:
    """Return elements of an orbit; angles that are None are drawn, in the order of ``i``, ``Omega``, ``omega`` and ``f``.

    Args:
        i: Inclination, degrees; drawn from [-180, 180).
        a: Semi-major axis, km.
        e: Eccentricity.
        Omega: Right ascension of the ascending node, degrees.
        omega: Argument of periapsis, degrees.
        f: True anomaly, degrees.
        alt: Deprecated: altitude of a circular orbit above ``r_body``, km, in place of ``a``, ``e`` and ``omega``.
        r_body: Deprecated: radius, km.
    """
    if alt is not None:
        logger.warning("random_orbit(alt=) is deprecated and ignores a, e and omega; write random_circular_orbit(alt=)")
        return random_circular_orbit(i=i, alt=alt, r_body=r_body, Omega=Omega, f=f)
    inclination = np.random.uniform(-np.pi, np.pi) if i is None else np.radians(i)
    return ClassicElements(a * 1e3, e, inclination, *(_angle(degrees) for degrees in (Omega, omega, f)))


def _angle(degrees: float | None) -> float:
    return np.random.uniform(0, 2 * np.pi) if degrees is None else np.radians(degrees)


def random_circular_orbit(
    i: float | None = None,
    alt: float = 500,
    r_body: float = R_ALTITUDE,
    Omega: float | None = None,
    f: float | None = None,
) -> ClassicElements:
    """Return elements of a circular orbit at an altitude ``alt`` above ``r_body``, km; see :func:`random_orbit`."""
    return random_orbit(i=i, a=r_body + alt, e=0, Omega=Omega, omega=0, f=f)


def random_epoch(start: int = 2000, end: int = 2022) -> str:
    """Return an epoch such as ``"2012 MAR 05 09:12:05.830 (UTC)"`` in the years from ``start`` to before ``end``."""
    year = np.random.randint(start, end)
    month = np.random.choice(MONTHS)
    day, hour, minute, second, millisecond = (np.random.randint(low, high) for low, high in EPOCH_PARTS)
    return f"{year} {month} {day:02d} {hour:02d}:{minute:02d}:{second:02d}.{millisecond:03d} (UTC)"


EPOCH_PARTS = (1, 28), (0, 23), (0, 59), (0, 59), (0, 999)
"""Ranges of day, hour, minute, second and millisecond; the ends are exclusive, as in bsk_rl."""


# -- several satellites ----------------------------------------------------------------------------------------------------------


def walker_delta(
    n_spacecraft: int,
    n_planes: int,
    rel_phasing: float,
    altitude: float,
    inc: float,
    clustersize: int = 1,
    clusterspacing: float = 0,
) -> list[ClassicElements]:
    """Return elements of a Walker delta pattern; see :func:`bsk_torch.formations.walker_delta` for the equations.

    Args:
        n_spacecraft: Number of satellites; those of the first plane come first.
        n_planes: Number of planes.
        rel_phasing: Lead of a plane over the one before, in units of ``360 / n_planes`` degrees.
        altitude: Altitude above 6371 km, m.
        inc: Inclination, degrees.
        clustersize: Number of satellites in a cluster.
        clusterspacing: Angle between neighbors in a cluster, degrees.
    """
    in_plane = n_spacecraft / n_planes
    spacing = 360.0 / (in_plane / clustersize)
    pattern = []
    for k in range(n_spacecraft):
        plane = int(k / in_plane)
        anomaly = int((k % in_plane) / clustersize) * spacing + clusterspacing * (k % clustersize)
        node, phase = plane * 360.0 / n_planes % 360, plane * rel_phasing * 360.0 / n_planes
        angles = (float(np.radians(angle)) for angle in (inc, node, phase, anomaly))
        pattern.append(ClassicElements(R_ALTITUDE * 1e3 + altitude, 0.0, *angles))
    return pattern


def walker_delta_args(
    n_planes: int,
    rel_phasing: float = 0.0,
    altitude: float = 500,
    inc: float = 45.0,
    randomize_true_anomaly: bool = True,
    randomize_lan: bool = True,
    **walker_delta_kwargs: Any,
) -> Randomizer:
    """Return a function for ``sat_arg_randomizer`` that arranges all satellites in a Walker delta pattern.

    Args:
        n_planes: Number of planes.
        rel_phasing: See :func:`walker_delta`.
        altitude: Altitude above 6371 km, km.
        inc: Inclination, degrees.
        randomize_true_anomaly: Whether all true anomalies are shifted by one random angle.
        randomize_lan: Whether all ascending nodes are shifted by one random angle.
        walker_delta_kwargs: Further arguments of :func:`walker_delta`.
    """

    def arranged(satellites: Sequence[Satellite]) -> dict[Satellite, dict[str, object]]:
        pattern = walker_delta(
            n_spacecraft=len(satellites),
            n_planes=n_planes,
            rel_phasing=rel_phasing,
            altitude=altitude * 1e3,
            inc=inc,
            **walker_delta_kwargs,
        )
        for name, drawn in (("f", randomize_true_anomaly), ("Omega", randomize_lan)):
            if drawn:
                shift = np.random.uniform(0, 2 * np.pi)
                for oe in pattern:
                    setattr(oe, name, np.mod(getattr(oe, name) + shift, 2 * np.pi))
        return {satellite: {"oe": oe} for satellite, oe in zip(satellites, pattern, strict=True)}

    return arranged


def relative_to_chief(
    chief_name: str,
    chief_orbit: ClassicElements | Callable[[], ClassicElements],
    deputy_relative_state: Mapping[str, object],
) -> Randomizer:
    """Return a function for ``sat_arg_randomizer`` that places satellites relative to another one.

    Args:
        chief_name: Name of the chief.
        chief_orbit: Its elements, or a function that draws them.
        deputy_relative_state: By name of each deputy, its position, m, and velocity, m/s, in the chief's Hill frame, [6]; or a
            function that draws them.
    """

    def placed(satellites: Sequence[Any]) -> dict[Any, dict[str, Any]]:
        named = {satellite.name: satellite for satellite in satellites}
        if missing := {chief_name, *deputy_relative_state} - named.keys():
            raise IndexError(f"relative_to_chief names {sorted(missing)}, which are not among the satellites {list(named)}")
        chief = named[chief_name]
        mu = chief.sat_args_generator["mu"]
        oe = chief_orbit() if callable(chief_orbit) else chief_orbit
        args: dict[object, dict[str, object]] = {satellite: {} for satellite in satellites}
        args[chief]["oe"] = oe
        rc_N, vc_N = elem2rv(mu, oe)
        for name, value in deputy_relative_state.items():
            state = np.asarray(value() if callable(value) else value, dtype=float)
            args[named[name]]["oe"] = rv2elem(mu, *hill2cd(rc_N, vc_N, state[:3], state[3:6]))
        return args

    return placed
