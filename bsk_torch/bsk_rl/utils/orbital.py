"""Orbits of one episode, at the place of ``bsk_rl.utils.orbital``; random ones come from NumPy's global generator.

Angles of arguments are in degrees and lengths in km, as in bsk_rl; elements are in rad and m.
"""

from __future__ import annotations

import functools
import logging
import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
import torch

from bsk_torch.astro.eclipse import in_umbra
from bsk_torch.astro.ephemeris import parse_utc
from bsk_torch.astro.relative import cd2hill, elevation, fibonacci_sphere, hill2cd, lla2ecef, rv2HN, rv2omega
from bsk_torch.bsk_rl.utils import orbital_motion as orbitalMotion  # noqa: N812  (the name that programs import)
from bsk_torch.bsk_rl.utils.orbital_motion import ClassicElements, elem2rv, rv2elem
from bsk_torch.sim.access.visibility.planned import PlannedOrbits, position_between, sample_planned, take_rows
from bsk_torch.sim.environment.ephemeris import EPHEMERIS_TRACK, fixed
from bsk_torch.sim.orbit.arcs import REACH_AROUND, Arcs
from bsk_torch.sim.orbit.builder import ARC
from bsk_torch.sim.orbit.grid import PLAN_STEP
from bsk_torch.sim.orbit.solvers import make_solver

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

MONTHS = ["JAN", "FEB", "MAR", "APR", "MAY", "JUN", "JUL", "AUG", "SEP", "OCT", "NOV", "DEC"]

Randomizer = Callable[[Sequence[Any]], dict[Any, dict[str, Any]]]
"""Returns arguments by satellite, for ``sat_arg_randomizer`` of an environment."""


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
    """Return an angle in rad; a random one where it is None."""
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
        clusterspacing: Angle between neighbours in a cluster, degrees.
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

    def arranged(satellites: Sequence[Any]) -> dict[Any, dict[str, Any]]:
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
    deputy_relative_state: Mapping[str, Any],
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
        args: dict[Any, dict[str, Any]] = {satellite: {} for satellite in satellites}
        args[chief]["oe"] = oe
        rc_N, vc_N = elem2rv(mu, oe)
        for name, given in deputy_relative_state.items():
            state = np.asarray(given() if callable(given) else given, dtype=float)
            args[named[name]]["oe"] = rv2elem(mu, *hill2cd(rc_N, vc_N, state[:3], state[3:6]))
        return args

    return placed


# -- look-ahead ------------------------------------------------------------------------------------------------------------------


class TrajectorySimulator:
    """The orbit of a satellite without drag and manoeuvres, in steps from the epoch on, as far as it is asked for.

    In steps of 30 s, positions are those of the planned arcs (:mod:`bsk_torch.sim.orbit.planned_arc`), on which satellites look
    ahead too and which have the error of Basilisk's Runge-Kutta method; in others, they are those of the exact orbit.
    """

    def __init__(
        self,
        utc_init: str,
        rN: Any = None,
        vN: Any = None,
        oe: ClassicElements | None = None,
        mu: float | None = None,
        dt: float = PLAN_STEP,
    ) -> None:
        """Take an orbit, as ``rN`` and ``vN`` or as ``oe`` and ``mu``.

        Args:
            utc_init: Epoch.
            rN: Initial position, m [3].
            vN: Initial velocity, m/s [3].
            oe: Initial elements.
            mu: Gravitational parameter to which the elements refer, m^3/s^2.
            dt: Step, s.

        Raises:
            ValueError: For both or none of the two, or a step that is not positive.
        """
        if not dt > 0.0:
            raise ValueError(f"dt={dt!r} must be positive, s")
        if oe is None and rN is not None and vN is not None:
            self.rN_init, self.vN_init = np.asarray(rN, dtype=float), np.asarray(vN, dtype=float)
        elif oe is not None and mu is not None and rN is None and vN is None:
            self.rN_init, self.vN_init = elem2rv(mu, oe)
        else:
            raise ValueError("give the orbit as (rN, vN), or as (oe, mu)")
        self.utc_init, self.dt = utc_init, dt
        self._count = 0
        self._eclipse_starts: list[float] = []
        self._eclipse_ends: list[float] = []
        self._searched = 0.0
        self._tables: tuple[np.ndarray, np.ndarray, np.ndarray] = (np.zeros((0, 3)), np.zeros((0, 3)), np.zeros(0, dtype=bool))

    @functools.cached_property
    def _arcs(self) -> Arcs:
        """The solved orbit; many programs never ask for it."""
        arcs = Arcs(1, 1, make_solver(1.0, "eager", torch.device("cpu")), kept=2**30)
        et = torch.tensor([parse_utc(self.utc_init)], dtype=torch.float64)
        r, v = (torch.as_tensor(x, dtype=torch.float64).unsqueeze(0) for x in (self.rN_init, self.vN_init))
        arcs.solve(torch.zeros(1, dtype=torch.long), et, r, v)
        return arcs

    @property
    def sim_time(self) -> float:
        """Time of the last step that has been asked for, s."""
        return max(self._count - 1, 0) * self.dt

    @property
    def times(self) -> np.ndarray:
        """Times of the steps so far, s [K]."""
        return self.dt * np.arange(self._count)

    def extend_to(self, t: float) -> None:
        """Continue the orbit up to ``t``, s."""
        if t < self.sim_time:
            return
        self._count = math.floor(t / self.dt) + 1
        needed = (self._count - 1) * self.dt + (0.0 if self.dt == PLAN_STEP else REACH_AROUND)
        while self._arcs.length < needed:
            self._arcs.grow()
        if self._count > len(self._tables[0]):
            self._tables = tuple(map(np.concatenate, zip(self._tables, self._sampled(), strict=True)))  # type: ignore[assignment]

    def _sampled(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return positions in N and P, m [n, 3], and whether the Sun is hidden, [n], at steps that are not in the tables yet."""
        first, arcs = len(self._tables[0]), self._arcs
        times = self.dt * torch.arange(first, self._count, dtype=torch.float64)
        if self.dt == PLAN_STEP:
            planned = PlannedOrbits(arcs.planned_samples, arcs.ephemeris_samples)
            r_BN_N, sky = sample_planned(planned, times[:1], len(times))
        else:
            owner = torch.zeros(len(times), dtype=torch.long)
            nodes, ephemeris = (take_rows(track, owner) for track in arcs.tracks((ARC, EPHEMERIS_TRACK)))
            r_BN_N, sky = position_between(nodes, ephemeris, times)
        tables = r_BN_N.stack(), fixed(sky, r_BN_N).stack(), in_umbra(r_BN_N, sky.r_SN_N)
        return tables[0].numpy(), tables[1].numpy(), tables[2].numpy()

    def next_eclipse(self, t: float, max_tries: int = 2) -> tuple[float, float]:
        """Return the times of the next start and of the next end of an eclipse after ``t``, s; within one, they are of two.

        Args:
            t: Time, s.
            max_tries: Number of times that the orbit is continued by 6000 s to find them; ``(1.0, 1.0)`` where that fails.
        """
        for k in range(max_tries + 1):
            starts = [start for start in self._eclipse_starts if start > t]
            ends = [end for end in self._eclipse_ends if end > t]
            if starts and ends:
                return min(starts), min(ends)
            self._search_eclipses(t + 6000 * k)
        logger.warning("no eclipse begins and ends within %.1f s after %.1f s", self._searched - t, t)
        return 1.0, 1.0

    def _search_eclipses(self, t: float) -> None:
        """Note the transitions of the steps after those that have been searched, up to ``t``, s."""
        self.extend_to(t + self.dt)
        # the eclipse of a step is that of the position before it
        dark = np.concatenate([[False], self._tables[2]])[: self._count].astype(int)
        times = self.times
        after = times > self._searched
        change, times = np.diff(dark[after]), times[after]
        self._eclipse_starts += [float(time) for time in times[:-1][change == 1]]
        self._eclipse_ends += [float(time) for time in times[:-1][change == -1]]
        self._searched = t

    @property
    def r_BN_N(self) -> Any:
        """Position in N, m: a function of time, s; a cubic spline through the steps."""
        return self._interpolator(0)

    @property
    def r_BP_P(self) -> Any:
        """Position in the Earth-fixed frame P, m: a function of time, s; a cubic spline through the steps."""
        return self._interpolator(1)

    def _interpolator(self, table: int) -> Any:
        try:
            from scipy.interpolate import interp1d
        except ImportError as error:
            raise ImportError("TrajectorySimulator interpolates with SciPy: pip install bsk_torch[plan]") from error
        if self.sim_time < self.dt * 3:
            self.extend_to(self.dt * 3)
        values = self._tables[table][: self._count]
        return interp1d(self.times, values, kind="cubic", axis=0, fill_value="extrapolate")
