"""Distributions of the orbits of several satellites: constellations and formations, drawn anew in every episode.

What one satellite is given (its ``sat_args``) is drawn for each satellite on its own; a :class:`Formation` draws what belongs
together. ``walker_delta``, ``walker_delta_args`` and ``relative_to_chief`` mean what bsk_rl's mean.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor

from bsk_torch.astro.orbit import Elements, elements_to_rv, hill_to_inertial, rv_to_elements
from bsk_torch.constants import MU_EARTH
from bsk_torch.rand import Distribution, Key, first_key
from bsk_torch.sim.component import Arg, Component
from bsk_torch.sim.params import Arguments, nearest
from bsk_torch.vec3 import Vec3

__all__ = [
    "Formation",
    "relative_to_chief",
    "together",
    "train_args",
    "walker_delta",
    "walker_delta_args",
    "walker_star",
    "walker_star_args",
]

R_ALTITUDE = 6371.0e3
"""Radius, m, from which altitudes are counted: the Earth's mean radius, as in bsk_rl."""

DELTA, STAR = 360.0, 180.0
"""Angle, degrees, over which the ascending nodes of a Walker pattern are spread."""

ROUND = 1e-14
"""Eccentricity below which a deputy's orbit is a circle: this moves it by less than a micrometre."""

ORBIT = (
    Arg("altitude", 500.0, "km", "altitude above 6371 km", low=0.0),
    Arg("inc", 45.0, "deg", "inclination", low=-180.0, high=180.0),
)

Settings = dict[str, tuple[Sequence[int], Tensor]]
"""Name of an argument of satellites -> which satellites it is set for, and float64 values [n, number of these, ...]."""

Number = float | Distribution


class Formation:
    """What several satellites are given together, instead of their ``sat_args``, at each reset. Subclasses implement draw."""

    def check(self, names: Sequence[str]) -> None:
        """Before anything runs: ValueError if satellites of these ``names`` cannot be arranged; draws once for trial."""
        self.draw(first_key(1), names)

    def draw(self, key: Key, names: Sequence[str]) -> Settings:
        """Values of arguments in the key's n environments.

        They must not depend on n: take random numbers from ``key.named("...")``.

        Returns:
            For every argument that is set, by its name in ``sat_args``: the indices into ``names`` of the satellites that it is
            set for, and its values, float64 [n, number of these satellites, ...]. Elements ``oe`` are a in m, e, and
            i, Omega, omega, f in rad.
        """
        raise TypeError(f"{type(self).__name__} does not say how to draw: implement draw(key, names)")


# -- Walker patterns -------------------------------------------------------------------------------------------------------------


def walker_delta(
    n_spacecraft: int,
    n_planes: int,
    rel_phasing: float,
    altitude: float,
    inc: float,
    clustersize: int = 1,
    clusterspacing: float = 0.0,
) -> Tensor:
    """Elements [n_spacecraft, 6] (a in m, e, and i, Omega, omega, f in rad) of a Walker delta pattern: nodes over 360 degrees.

    Circular orbits at one altitude and inclination lie in planes whose ascending nodes are equally spaced, with equally spaced
    satellites in each; satellites of a plane follow each other in the order of flight (Walker, "Satellite constellations",
    Journal of the British Interplanetary Society 37, 1984).

    Args:
        n_spacecraft: Number of satellites T, a multiple of ``n_planes``; those of the first plane come first.
        n_planes: Number of planes P.
        rel_phasing: How far the satellites of a plane are ahead of those of the plane before, in units of ``360 / P`` degrees.
            Walker's i:T/P/F has ``rel_phasing = F P / T``. (bsk_rl's documentation says degrees, but it multiplies 360 / P, too.)
        altitude: Altitude above 6371 km, m.
        inc: Inclination, degrees.
        clustersize: Satellites in a cluster, which stands for one satellite of the pattern.
        clusterspacing: Angle between neighbours in a cluster, degrees.

    Raises:
        ValueError: If satellites do not fill planes, or clusters do not.
    """
    return _walker(_filled(n_spacecraft, n_planes, clustersize), rel_phasing, altitude, inc, clusterspacing, DELTA)


def walker_star(
    n_spacecraft: int,
    n_planes: int,
    rel_phasing: float,
    altitude: float,
    inc: float,
    clustersize: int = 1,
    clusterspacing: float = 0.0,
) -> Tensor:
    """Elements [n_spacecraft, 6] of a Walker star pattern: as :func:`walker_delta`, but with nodes spread over 180 degrees.

    Near-polar planes then meet at the poles like the lines of a star, and satellites of neighbouring planes fly side by side
    except at the seam between the last and the first (Walker 1984; Wertz, Mission geometry, 2001, section 13.1).
    """
    return _walker(_filled(n_spacecraft, n_planes, clustersize), rel_phasing, altitude, inc, clusterspacing, STAR)


def walker_delta_args(
    n_planes: int,
    rel_phasing: float = 0.0,
    altitude: Number = 500.0,
    inc: Number = 45.0,
    randomize_true_anomaly: bool = True,
    randomize_lan: bool = True,
    clustersize: int = 1,
    clusterspacing: float = 0.0,
    phasing: int | None = None,
) -> Formation:
    """Formation of all satellites in a :func:`walker_delta` pattern, turned at random as a whole.

    ``walker_delta_args(n_planes=3, phasing=1, inc=60)`` puts twelve satellites into Walker's 60:12/3/1.

    Args:
        n_planes: Number of planes; the number of satellites must be a multiple.
        rel_phasing: See :func:`walker_delta`.
        altitude: Altitude above 6371 km, km (not m); a number or a distribution, which is drawn once for all satellites.
        inc: Inclination, degrees; a number or a distribution, as ``altitude``.
        randomize_true_anomaly: Shift all satellites along their orbits by the same angle, uniform in 360 degrees.
        randomize_lan: Turn all planes about the Earth's axis by the same angle, uniform in 360 degrees.
        clustersize: See :func:`walker_delta`.
        clusterspacing: See :func:`walker_delta`, degrees.
        phasing: Walker's F, instead of ``rel_phasing``: neighbours in adjacent planes are F 360 / T degrees apart, where T counts
            clusters; an integer from 0 to ``n_planes - 1``.

    Raises:
        ValueError: For a wrong number.
    """
    return _Walker(
        title="walker_delta_args",
        nodes=DELTA,
        n_planes=n_planes,
        rel_phasing=rel_phasing,
        altitude=altitude,
        inc=inc,
        randomize_true_anomaly=randomize_true_anomaly,
        randomize_lan=randomize_lan,
        clustersize=clustersize,
        clusterspacing=clusterspacing,
        phasing=phasing,
    )


def walker_star_args(
    n_planes: int,
    rel_phasing: float = 0.0,
    altitude: Number = 500.0,
    inc: Number = 90.0,
    randomize_true_anomaly: bool = True,
    randomize_lan: bool = True,
    clustersize: int = 1,
    clusterspacing: float = 0.0,
    phasing: int | None = None,
) -> Formation:
    """Formation of all satellites in a :func:`walker_star` pattern, turned at random as a whole.

    Arguments and errors are those of :func:`walker_delta_args`.
    """
    return _Walker(
        title="walker_star_args",
        nodes=STAR,
        n_planes=n_planes,
        rel_phasing=rel_phasing,
        altitude=altitude,
        inc=inc,
        randomize_true_anomaly=randomize_true_anomaly,
        randomize_lan=randomize_lan,
        clustersize=clustersize,
        clusterspacing=clusterspacing,
        phasing=phasing,
    )


def _check_counts(**counts: Any) -> None:
    for name, value in counts.items():
        if not isinstance(value, int) or isinstance(value, bool) or value < 1:
            raise ValueError(f"{name}={value!r} must be a positive integer")


def _filled(n_spacecraft: int, n_planes: int, clustersize: int) -> tuple[int, int, int]:
    """The three numbers; ValueError unless clusters fill planes, and planes the pattern."""
    _check_counts(n_spacecraft=n_spacecraft, n_planes=n_planes, clustersize=clustersize)
    if n_spacecraft % n_planes:
        raise ValueError(
            f"{n_spacecraft} satellites do not fill n_planes={n_planes} equally; "
            f"their number must be a multiple of it, or n_planes one of {_divisors(n_spacecraft)}"
        )
    per_plane = n_spacecraft // n_planes
    if per_plane % clustersize:
        raise ValueError(
            f"clustersize={clustersize} does not divide the {per_plane} satellites of a plane; "
            f"allowed is one of {_divisors(per_plane)}"
        )
    return n_spacecraft, n_planes, clustersize


def _divisors(n: int) -> list[int]:
    return [k for k in range(1, n + 1) if n % k == 0]


def _walker(
    counts: tuple[int, int, int],
    rel_phasing: float,
    altitude: Tensor | float,
    inc: Tensor | float,
    clusterspacing: float,
    nodes: float,
) -> Tensor:
    """Elements [..., S, 6] for altitudes, m, and inclinations, degrees, [...]."""
    n_spacecraft, n_planes, clustersize = counts
    per_plane = n_spacecraft // n_planes
    index = torch.arange(n_spacecraft, dtype=torch.float64)
    plane, place = index // per_plane, index % per_plane
    Omega, omega = plane * (nodes / n_planes), plane * (rel_phasing * 360.0 / n_planes)
    f = place // clustersize * (360.0 * clustersize / per_plane) + place % clustersize * clusterspacing
    return _circular(altitude, inc, Omega, omega, f)


def _circular(altitude: Tensor | float, inc: Tensor | float, Omega: Tensor, omega: Tensor, f: Tensor) -> Tensor:
    """Elements [..., S, 6] of circular orbits at altitudes, m, and inclinations, degrees, [...], with angles [..., S] degrees."""
    altitude, inc = (torch.as_tensor(x, dtype=torch.float64).unsqueeze(-1) for x in (altitude, inc))
    angles = torch.broadcast_tensors(inc, Omega, omega, f, altitude)[:4]
    i, Omega, omega, f = (torch.deg2rad(angle) for angle in angles)
    return torch.stack([(R_ALTITUDE + altitude).expand_as(i), torch.zeros_like(i), i, Omega, omega, f], -1)


def _turned(angle: Tensor, key: Key) -> Tensor:
    """Angles [n or 1, S] rad plus one in [0, 2 pi) for each of the key's environments, in [0, 2 pi)."""
    return torch.remainder(angle + 2.0 * math.pi * key.uniform(1), 2.0 * math.pi)


def _arguments(title: str, args: Sequence[Arg], given: Mapping[str, Any]) -> Arguments:
    return Arguments([Component(slot="formation", order=0, args=tuple(args))], given, title)


@dataclass(eq=False, kw_only=True)
class _Walker(Formation):
    title: str
    nodes: float
    n_planes: int
    rel_phasing: float
    altitude: Number
    inc: Number
    randomize_true_anomaly: bool
    randomize_lan: bool
    clustersize: int
    clusterspacing: float
    phasing: int | None

    def __post_init__(self) -> None:
        """Check what does not depend on the satellites."""
        _check_counts(n_planes=self.n_planes, clustersize=self.clustersize)
        if self.phasing is not None and self.rel_phasing != 0.0:
            raise ValueError(f"give phasing={self.phasing!r} or rel_phasing={self.rel_phasing!r}, not both")
        if self.phasing not in (None, *range(self.n_planes)):
            raise ValueError(f"phasing={self.phasing!r} must be an integer from 0 to n_planes - 1 = {self.n_planes - 1}")
        self.args = _arguments(self.title, ORBIT, {"altitude": self.altitude, "inc": self.inc})

    def draw(self, key: Key, names: Sequence[str]) -> Settings:
        """See :meth:`Formation.draw`."""
        counts, drawn = _filled(len(names), self.n_planes, self.clustersize), self.args.draw(key)
        fraction = self.n_planes * self.clustersize / len(names)
        ahead = self.rel_phasing if self.phasing is None else self.phasing * fraction
        oe = _walker(counts, ahead, 1e3 * drawn["altitude"], drawn["inc"], self.clusterspacing, self.nodes)
        oe = oe.expand(len(key), -1, -1).clone()
        if self.randomize_true_anomaly:
            oe[..., 5] = _turned(oe[..., 5], key.named("formation f"))
        if self.randomize_lan:
            oe[..., 3] = _turned(oe[..., 3], key.named("formation Omega"))
        return {"oe": (range(len(names)), oe)}


# -- One behind the other --------------------------------------------------------------------------------------------------------


def train_args(
    spacing: float | Sequence[float] | Distribution,
    altitude: Number = 500.0,
    inc: Number = 45.0,
    Omega: Number | None = None,
    f: Number | None = None,
) -> Formation:
    """Formation of all satellites as a string of pearls: one behind the other on one circular orbit, the first one leading.

    Args:
        spacing: Angle at the Earth's centre from a satellite to the next, degrees: a number, a sequence with one for each gap, or
            a distribution of either. A degree is 1/360 of the period.
        altitude: Altitude above 6371 km, km; a number or a distribution.
        inc: Inclination, degrees; a number or a distribution.
        Omega: Right ascension of the ascending node, degrees; a number, a distribution, or None for uniform in 360 degrees.
        f: Angle of the first satellite from the node, degrees; as ``Omega``.

    Raises:
        ValueError: For a wrong number; at :meth:`Formation.check`, if ``spacing`` does not fit the number of satellites.
    """
    return _Train(spacing, altitude, inc, Omega, f)


@dataclass(eq=False)
class _Train(Formation):
    spacing: float | Sequence[float] | Distribution
    altitude: Number
    inc: Number
    Omega: Number | None
    f: Number | None

    def __post_init__(self) -> None:
        """Make the table of numbers."""
        angles = (
            Arg("Omega", None, "deg", "ascending node"),
            Arg("f", None, "deg", "angle of the first satellite from the node"),
        )
        given = {name: getattr(self, name) for name in ("altitude", "inc", "Omega", "f")}
        self.args = _arguments("train_args", (*ORBIT, *angles), given)

    def draw(self, key: Key, names: Sequence[str]) -> Settings:
        """See :meth:`Formation.draw`."""
        drawn, gaps = self.args.draw(key), self._gaps(key, len(names) - 1)
        Omega, f = (self._angle(drawn[name], key.named(f"formation {name}")) for name in ("Omega", "f"))
        behind = torch.cat([torch.zeros_like(f), gaps.cumsum(-1).expand(len(f), -1)], -1)
        oe = _circular(1e3 * drawn["altitude"], drawn["inc"], Omega, torch.zeros_like(f), f - behind)
        oe[..., 5] = torch.remainder(oe[..., 5], 2.0 * math.pi)
        return {"oe": (range(len(names)), oe)}

    @staticmethod
    def _angle(given: Tensor | None, key: Key) -> Tensor:
        """Degrees [n, 1]."""
        return 360.0 * key.uniform(1) if given is None else given.unsqueeze(-1).expand(len(key), 1)

    def _gaps(self, key: Key, count: int) -> Tensor:
        """Angles [n or 1, count], degrees."""
        try:
            if isinstance(self.spacing, Distribution):
                gaps = torch.as_tensor(self.spacing.draw(key.named("spacing")), dtype=torch.float64)
            else:
                gaps = torch.as_tensor(self.spacing, dtype=torch.float64).unsqueeze(0)
            gaps = gaps if gaps.ndim > 1 else gaps.unsqueeze(-1).expand(-1, count)
            fits = gaps.shape[1:] == (count,) and bool(torch.isfinite(gaps).all())
        except (TypeError, ValueError, RuntimeError):
            fits = False
        if not fits:
            raise ValueError(
                f"train_args: spacing={self.spacing!r} must be a number of degrees, or {count} of them for {count + 1} satellites"
            )
        return gaps


# -- About a chief ---------------------------------------------------------------------------------------------------------------


def relative_to_chief(
    chief_name: str, chief_orbit: Any, deputy_relative_state: Mapping[str, Any], mu: float = MU_EARTH
) -> Formation:
    """Formation of deputies about a chief; satellites that are named nowhere keep their own ``sat_args``.

    The chief is given its elements, the deputies those of the orbits that lead through their states relative to the chief.

    Args:
        chief_name: Name of the chief.
        chief_orbit: Elements of the chief as in ``sat_args["oe"]``: a in m, e, and i, Omega, omega, f in rad, as six numbers, as
            an object with these attributes, as a distribution such as :func:`bsk_torch.rand.random_orbit`, or as a callable.
        deputy_relative_state: Name of a deputy -> position, m, and velocity, m/s, relative to the chief, both in the chief's
            rotating Hill frame (radial, along-track, normal); six numbers, a distribution of [n, 6], or a callable.
        mu: Gravitational parameter, m^3/s^2, that the satellites' elements are converted with.

    Raises:
        ValueError: For wrong numbers; at :meth:`Formation.check`, for an unknown name or a deputy that is not bound to the Earth.
    """
    return _Relative(chief_name, chief_orbit, deputy_relative_state, mu)


@dataclass(eq=False)
class _Relative(Formation):
    chief_name: str
    chief_orbit: Any
    deputy_relative_state: Mapping[str, Any]
    mu: float

    def __post_init__(self) -> None:
        """Make the table of numbers."""
        if self.chief_name in self.deputy_relative_state:
            raise ValueError(f"deputy_relative_state[{self.chief_name!r}] is the chief; a deputy is another satellite")
        self.states = {f"deputy_relative_state[{name!r}]": state for name, state in self.deputy_relative_state.items()}
        given = {"chief_orbit": self.chief_orbit, **self.states}
        units = dict.fromkeys(given, "m, m/s") | {"chief_orbit": "m, -, rad"}
        args = [Arg(name, None, units[name], "six numbers", kind="orbit") for name in given]
        for name, value in given.items():
            if value is None:
                raise ValueError(f"relative_to_chief: {name}=None is not allowed; give six numbers ({units[name]})")
        self.args = _arguments("relative_to_chief", args, given)

    def check(self, names: Sequence[str]) -> None:
        """See :meth:`Formation.check`."""
        for what, name in (
            ("chief_name", self.chief_name),
            *(("deputy_relative_state", name) for name in self.deputy_relative_state),
        ):
            if name not in names:
                raise ValueError(f"relative_to_chief: {what} has {name!r}, which is no satellite; {nearest(name, names)}")
        super().check(names)

    def draw(self, key: Key, names: Sequence[str]) -> Settings:
        """See :meth:`Formation.draw`."""
        drawn = self.args.draw(key)
        columns = [names.index(name) for name in (self.chief_name, *self.deputy_relative_state)]
        chief = drawn["chief_orbit"].expand(len(key), 6).unsqueeze(1)
        if not self.states:
            return {"oe": (columns, chief)}
        states = torch.stack([drawn[name].expand(len(key), 6) for name in self.states], 1)
        return {"oe": (columns, torch.cat([chief, self._elements(chief, states)], 1))}

    def _elements(self, chief: Tensor, states: Tensor) -> Tensor:
        """Elements [n, D, 6] of deputies with relative states [n, D, 6], for elements [n, 1, 6] of the chief."""
        r, v = elements_to_rv(Elements(*chief.unbind(-1)), self.mu)
        r, v = hill_to_inertial(r, v, Vec3.of(states[..., :3]), Vec3.of(states[..., 3:]))
        oe = torch.stack(rv_to_elements(r, v, self.mu, ROUND), -1)
        unbound = ~((oe[..., 0] > 0.0) & (oe[..., 1] < 1.0))
        if bool(unbound.any()):
            where = int(unbound.any(0).nonzero()[0])
            raise ValueError(
                f"relative_to_chief: {list(self.states)[where]} puts the deputy on an orbit with a={oe[unbound][0, 0]:g} m and "
                f"e={oe[unbound][0, 1]:g}; an orbit around the Earth needs a > 0 and 0 <= e < 1"
            )
        return oe


def together(formations: Mapping[Sequence[str], Formation]) -> Formation:
    """Several formations side by side, drawn independently: by the names of the satellites that each of them arranges.

    Raises:
        ValueError: At :meth:`Formation.check`, for an unknown name or one that belongs to two formations.
    """
    return _Together(dict(formations))


@dataclass(eq=False)
class _Together(Formation):
    formations: dict[Sequence[str], Formation]

    def check(self, names: Sequence[str]) -> None:
        """See :meth:`Formation.check`."""
        listed = [name for members in self.formations for name in members]
        for name in listed:
            if name not in names:
                raise ValueError(f"together: {name!r} is no satellite; {nearest(name, names)}")
        if twice := sorted({name for name in listed if listed.count(name) > 1}):
            raise ValueError(f"together: {twice} belong to more than one formation")
        for members, formation in self.formations.items():
            formation.check(members)

    def draw(self, key: Key, names: Sequence[str]) -> Settings:
        """See :meth:`Formation.draw`."""
        parts: dict[str, list[tuple[list[int], Tensor]]] = {}
        for members, formation in self.formations.items():
            columns = [names.index(name) for name in members]
            own = key.of_satellites(torch.tensor(columns[:1]))  # numbers of its own
            for name, (within, values) in formation.draw(own, members).items():
                parts.setdefault(name, []).append(([columns[k] for k in within], values))
        return {
            name: ([column for columns, _ in found for column in columns], torch.cat([values for _, values in found], 1))
            for name, found in parts.items()
        }
