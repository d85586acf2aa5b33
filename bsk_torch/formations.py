"""Distributions of the orbits of several satellites: constellations and formations, drawn in every episode.

Values of ``sat_args`` are drawn for each satellite on its own; a :class:`Formation` draws values of several satellites that
belong together. ``walker_delta``, ``walker_delta_args`` and ``relative_to_chief`` are those of ``bsk_torch.bsk_rl.utils``.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import torch
from torch import Tensor
from typing_extensions import final, override

from bsk_torch._checks import number, switch, text, whole
from bsk_torch.astro.orbit import Elements, elements_to_rv, hill_to_inertial, rv_to_elements
from bsk_torch.constants import MU_EARTH
from bsk_torch.rand import MOST_SATELLITES, Distribution, Key, first_key
from bsk_torch.sim.arguments.values import Arguments, nearest
from bsk_torch.sim.component import Arg, Component
from bsk_torch.sim.hooks import check_class
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
"""Radius, m, above which altitudes are counted: the Earth's mean radius."""

MOST_TURNS = 1e6
"""Bound of angles, and of shares of a turn."""

DELTA_NODES, STAR_NODES = 360.0, 180.0
"""Angle, degrees, over which the ascending nodes of a Walker delta or star pattern are spread."""

CIRCULAR_BELOW = 1e-14
"""Eccentricity below which a deputy's orbit is taken for a circle; this moves it by less than a micrometer."""

ORBIT_ARGS = (
    Arg("altitude", 500.0, "km", "altitude above 6371 km", low=0.0, high=1e6),
    Arg("inc", 45.0, "deg", "inclination", low=-180.0, high=180.0),
)

Settings = dict[str, tuple[Sequence[int], Tensor]]
"""Name of an argument -> indices of the satellites that it is set for, and float64 values [n, number of these, ...]."""

Number = float | Distribution
"""A number, or a distribution drawn once for all satellites of an environment."""


class Formation:
    """Arguments of several satellites drawn together at each reset, in place of their ``sat_args``.

    Subclasses define :meth:`draw`. Formations keep no values of episodes: all that they return follows from the key.
    """

    def __init_subclass__(cls, **options: object) -> None:
        super().__init_subclass__(**options)
        check_class(cls, Formation, ("check", "draw"))

    def check(self, names: Sequence[str]) -> None:
        """Raise ValueError if satellites of these ``names`` cannot be arranged; called once, when an environment is built."""
        self.draw_checked(first_key(1), names)

    def draw(self, key: Key, names: Sequence[str]) -> Settings:
        """Draw arguments of satellites for the n environments of ``key``.

        Use random numbers of ``key.named("...")`` only, so that an environment's values do not depend on the others.

        Args:
            key: Key of the environments.
            names: Names of the satellites of one environment.

        Returns:
            For every argument set, by its name in ``sat_args``: the indices into ``names`` of its satellites, and its values,
            float64 [n, number of these satellites, ...]. Elements ``oe`` are a in m, e, and i, Omega, omega, f in rad.
        """
        raise TypeError(f"{type(self).__name__} must implement draw(key, names)")

    @final
    def draw_checked(self, key: Key, names: Sequence[str]) -> Settings:
        """Call :meth:`draw` and check its result; not to be overridden."""
        drawn = self.draw(key, names)
        for name, (satellites, values) in drawn.items():
            indices = [int(k) for k in satellites]
            if len(set(indices)) < len(indices) or not all(0 <= k < len(names) for k in indices):
                raise ValueError(
                    f"{type(self).__name__}.draw(key, names) sets {name!r} of satellites {indices}; these must be different "
                    f"indices into names, from 0 to {len(names) - 1}"
                )
            shape = values.shape[:2] if isinstance(values, Tensor) else ()
            if tuple(shape) != (len(key), len(indices)):
                description = f"a tensor of shape {list(values.shape)}" if isinstance(values, Tensor) else repr(values)
                raise ValueError(
                    f"{type(self).__name__}.draw(key, names) sets {name!r} to {description}; it must be a tensor "
                    f"[{len(key)}, {len(indices)}, ...]: by environment and satellite"
                )
        return drawn


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
    """Return the elements of a Walker delta pattern, [n_spacecraft, 6]: a in m, e, and i, Omega, omega, f in rad.

    T satellites fly on circular orbits of one altitude and inclination in P planes (Walker, "Satellite constellations", Journal
    of the British Interplanetary Society 37, 1984). Satellite s of plane p has, in degrees and without clusters::

        Omega = 360 p / P        omega = rel_phasing 360 p / P        f = 360 s P / T

    Args:
        n_spacecraft: Number of satellites T, a multiple of ``n_planes``; those of the first plane come first.
        n_planes: Number of planes P.
        rel_phasing: Lead of the satellites of a plane over those of the plane before, in units of ``360 / P`` degrees.
            Walker's i:T/P/F has ``rel_phasing = F P / T``. (BSK-RL's documentation says degrees, but it multiplies 360 / P, too.)
        altitude: Altitude above 6371 km, m.
        inc: Inclination, degrees.
        clustersize: Number of satellites in a cluster, which takes the place of one satellite of the pattern.
        clusterspacing: Angle between neighbors in a cluster, degrees.

    Raises:
        ValueError: If the satellites do not fill the planes equally, or clusters do not fill a plane.
    """
    return _pattern(_filled(n_spacecraft, n_planes, clustersize), rel_phasing, altitude, inc, clusterspacing, DELTA_NODES)


def walker_star(
    n_spacecraft: int,
    n_planes: int,
    rel_phasing: float,
    altitude: float,
    inc: float,
    clustersize: int = 1,
    clusterspacing: float = 0.0,
) -> Tensor:
    """Return the elements of a Walker star pattern, as :func:`walker_delta`, but with ``Omega = 180 p / P`` degrees.

    Near-polar planes then meet at the poles like the lines of a star, and satellites of neighboring planes fly side by side
    except at the seam between the last and the first (Walker 1984; Wertz, Mission geometry, 2001, section 13.1).
    """
    return _pattern(_filled(n_spacecraft, n_planes, clustersize), rel_phasing, altitude, inc, clusterspacing, STAR_NODES)


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
    """Return the formation of all satellites in a :func:`walker_delta` pattern, turned at random as a whole.

    ``walker_delta_args(n_planes=3, phasing=1, inc=60)`` puts twelve satellites into Walker's 60:12/3/1.

    Args:
        n_planes: Number of planes; the number of satellites must be a multiple.
        rel_phasing: See :func:`walker_delta`.
        altitude: Altitude above 6371 km, km (not m); a number or a distribution, drawn once for all satellites.
        inc: Inclination, degrees; a number or a distribution, as ``altitude``.
        randomize_true_anomaly: Shift all satellites along their orbits by the same angle, uniform in 360 degrees.
        randomize_lan: Turn all planes about the Earth's axis by the same angle, uniform in 360 degrees.
        clustersize: See :func:`walker_delta`.
        clusterspacing: See :func:`walker_delta`, degrees.
        phasing: Walker's F, instead of ``rel_phasing``: neighbors in adjacent planes are F 360 / T degrees apart, where T counts
            clusters; an integer from 0 to ``n_planes - 1``.
    """
    turned = randomize_true_anomaly, randomize_lan
    clusters = clustersize, clusterspacing
    return _Walker("walker_delta_args", DELTA_NODES, n_planes, rel_phasing, altitude, inc, *turned, *clusters, phasing)


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
    """Return the formation of all satellites in a :func:`walker_star` pattern, turned at random as a whole.

    Arguments and errors are those of :func:`walker_delta_args`.
    """
    turned = randomize_true_anomaly, randomize_lan
    clusters = clustersize, clusterspacing
    return _Walker("walker_star_args", STAR_NODES, n_planes, rel_phasing, altitude, inc, *turned, *clusters, phasing)


def _filled(n_spacecraft: int, n_planes: int, clustersize: int) -> tuple[int, int, int]:
    for name, value in (("n_spacecraft", n_spacecraft), ("n_planes", n_planes), ("clustersize", clustersize)):
        whole(name, value, 1, MOST_SATELLITES)
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


def _pattern(
    counts: tuple[int, int, int], rel_phasing: float, altitude: float, inc: float, clusterspacing: float, nodes: float
) -> Tensor:
    ahead, spacing = _checked_angles(rel_phasing, clusterspacing)
    altitude, inc = number("altitude", altitude, 0.0, 1e9, unit="m"), number("inc", inc, -180.0, 180.0, unit="degrees")
    return _walker(counts, ahead, altitude, inc, spacing, nodes)


def _checked_angles(rel_phasing: object, clusterspacing: object) -> tuple[float, float]:
    return (
        number("rel_phasing", rel_phasing, -MOST_TURNS, MOST_TURNS),
        number("clusterspacing", clusterspacing, -MOST_TURNS, MOST_TURNS, unit="degrees"),
    )


def _walker(
    counts: tuple[int, int, int],
    rel_phasing: float,
    altitude: Tensor | float,
    inc: Tensor | float,
    clusterspacing: float,
    nodes: float,
) -> Tensor:
    """Return elements [..., S, 6] for altitudes, m, and inclinations, degrees, [...]; see :func:`walker_delta`."""
    n_spacecraft, n_planes, clustersize = counts
    per_plane = n_spacecraft // n_planes
    index = torch.arange(n_spacecraft, dtype=torch.float64)
    plane, place = index // per_plane, index % per_plane
    Omega, omega = plane * (nodes / n_planes), plane * (rel_phasing * 360.0 / n_planes)
    f = place // clustersize * (360.0 * clustersize / per_plane) + place % clustersize * clusterspacing
    return _circular(altitude, inc, Omega, omega, f)


def _circular(altitude: Tensor | float, inc: Tensor | float, Omega: Tensor, omega: Tensor, f: Tensor) -> Tensor:
    """Return elements [..., S, 6] of circular orbits: altitudes [...] m, inclinations [...] and angles [..., S] degrees."""
    altitude, inc = (torch.as_tensor(x, dtype=torch.float64).unsqueeze(-1) for x in (altitude, inc))
    angles = torch.broadcast_tensors(inc, Omega, omega, f, altitude)[:4]
    i, Omega, omega, f = (torch.deg2rad(angle) for angle in angles)
    return torch.stack([(R_ALTITUDE + altitude).expand_as(i), torch.zeros_like(i), i, Omega, omega, f], -1)


def _turned(angle: Tensor, key: Key) -> Tensor:
    """Return angles [n or 1, S] rad plus a random one for each of the key's environments, all in [0, 2 pi)."""
    return torch.remainder(angle + 2.0 * math.pi * key.uniform(1), 2.0 * math.pi)


def _arguments(title: str, args: Sequence[Arg], values: Mapping[str, object]) -> Arguments:
    return Arguments([Component(slot="formation", args=tuple(args))], values, title)


@dataclass(eq=False)
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
        whole("n_planes", self.n_planes, 1, MOST_SATELLITES)
        whole("clustersize", self.clustersize, 1, MOST_SATELLITES)
        self.rel_phasing, self.clusterspacing = _checked_angles(self.rel_phasing, self.clusterspacing)
        for name in ("randomize_true_anomaly", "randomize_lan"):
            setattr(self, name, switch(name, getattr(self, name)))
        if self.phasing is not None:
            whole("phasing", self.phasing, 0)
        if self.phasing is not None and self.rel_phasing != 0.0:
            raise ValueError(f"give phasing={self.phasing!r} or rel_phasing={self.rel_phasing!r}, not both")
        if self.phasing not in (None, *range(self.n_planes)):
            raise ValueError(f"phasing={self.phasing!r} must be an integer from 0 to n_planes - 1 = {self.n_planes - 1}")
        self.args = _arguments(self.title, ORBIT_ARGS, {"altitude": self.altitude, "inc": self.inc})

    @override
    def draw(self, key: Key, names: Sequence[str]) -> Settings:
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


# -- trains ----------------------------------------------------------------------------------------------------------------------


def train_args(
    spacing: float | Sequence[float] | Distribution,
    altitude: Number = 500.0,
    inc: Number = 45.0,
    Omega: Number | None = None,
    f: Number | None = None,
) -> Formation:
    """Return the formation of all satellites one behind the other on one circular orbit, the first one leading.

    Args:
        spacing: Angle at the Earth's center from a satellite to the next, degrees: a number, a sequence with one for each gap, or
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
        angles = (
            Arg("Omega", None, "deg", "ascending node", low=-MOST_TURNS, high=MOST_TURNS),
            Arg("f", None, "deg", "angle of the first satellite from the node", low=-MOST_TURNS, high=MOST_TURNS),
        )
        values = {name: getattr(self, name) for name in ("altitude", "inc", "Omega", "f")}
        self.args = _arguments("train_args", (*ORBIT_ARGS, *angles), values)

    @override
    def draw(self, key: Key, names: Sequence[str]) -> Settings:
        drawn, gaps = self.args.draw(key), self._gaps(key, len(names) - 1)
        Omega, f = (self._angle(drawn[name], key.named(f"formation {name}")) for name in ("Omega", "f"))
        behind = torch.cat([torch.zeros_like(f), gaps.cumsum(-1).expand(len(f), -1)], -1)
        oe = _circular(1e3 * drawn["altitude"], drawn["inc"], Omega, torch.zeros_like(f), f - behind)
        oe[..., 5] = torch.remainder(oe[..., 5], 2.0 * math.pi)
        return {"oe": (range(len(names)), oe)}

    @staticmethod
    def _angle(angle: Tensor | None, key: Key) -> Tensor:
        """Return a drawn angle, or a uniform one where none is given, [n, 1] degrees."""
        return 360.0 * key.uniform(1) if angle is None else angle.unsqueeze(-1).expand(len(key), 1)

    def _gaps(self, key: Key, count: int) -> Tensor:
        """Return the angles between neighbors, [n or 1, count] degrees."""
        try:
            if isinstance(self.spacing, Distribution):
                gaps = torch.as_tensor(self.spacing.draw(key.named("spacing")), dtype=torch.float64)
            else:
                gaps = torch.as_tensor(self.spacing, dtype=torch.float64).unsqueeze(0)
            gaps = gaps if gaps.ndim > 1 else gaps.unsqueeze(-1).expand(-1, count)
            fits = gaps.shape[1:] == (count,) and bool(torch.isfinite(gaps).all())
        except (TypeError, ValueError, RuntimeError, OverflowError):
            fits = False
        if not fits:
            raise ValueError(
                f"train_args: spacing={self.spacing!r} must be a number of degrees, or {count} of them for {count + 1} satellites"
            )
        return gaps


# -- about a chief ---------------------------------------------------------------------------------------------------------------


def relative_to_chief(
    chief_name: str, chief_orbit: object, deputy_relative_state: Mapping[str, object], mu: float = MU_EARTH
) -> Formation:
    """Return the formation of deputies about a chief; satellites that are not named keep their own ``sat_args``.

    A deputy gets the elements of the orbit through its inertial state, which follows from the chief's state (r_CN, v_CN) and the
    relative state (rho, rho') in the chief's Hill frame H, which turns with omega_HN = r_CN x v_CN / r_CN^2::

        r_DN = r_CN + [NH] rho        v_DN = v_CN + [NH] rho' + omega_HN x [NH] rho

    (Schaub and Junkins, Analytical Mechanics of Space Systems, section 14.2).

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
    chief_orbit: object
    deputy_relative_state: Mapping[str, object]
    mu: float

    def __post_init__(self) -> None:
        text("chief_name", self.chief_name)
        if not isinstance(self.deputy_relative_state, Mapping):
            raise ValueError(
                f"deputy_relative_state={self.deputy_relative_state!r} must be a dictionary {{name of a deputy: six numbers}}"
            )
        self.mu = number("mu", self.mu, 1.0, 1e20, unit="m^3/s^2")
        if self.chief_name in self.deputy_relative_state:
            raise ValueError(f"deputy_relative_state[{self.chief_name!r}] is the chief; a deputy is another satellite")
        self.states = {f"deputy_relative_state[{name!r}]": state for name, state in self.deputy_relative_state.items()}
        values = {"chief_orbit": self.chief_orbit, **self.states}
        units = dict.fromkeys(values, "m, m/s") | {"chief_orbit": "m, -, rad"}
        args = [Arg(name, None, units[name], "six numbers", kind="orbit") for name in values]
        for name, value in values.items():
            if value is None:
                raise ValueError(f"relative_to_chief: {name}=None is not allowed; give six numbers ({units[name]})")
        self.args = _arguments("relative_to_chief", args, values)

    @override
    def check(self, names: Sequence[str]) -> None:
        for name in (self.chief_name, *self.deputy_relative_state):
            if name not in names:
                what = "chief_name" if name == self.chief_name else "deputy_relative_state"
                raise ValueError(f"relative_to_chief: {what} has {name!r}, which is not a satellite; {nearest(name, names)}")
        super().check(names)

    @override
    def draw(self, key: Key, names: Sequence[str]) -> Settings:
        drawn = self.args.draw(key)
        columns = [names.index(name) for name in (self.chief_name, *self.deputy_relative_state)]
        chief = drawn["chief_orbit"].expand(len(key), 6).unsqueeze(1)
        if not self.states:
            return {"oe": (columns, chief)}
        states = torch.stack([drawn[name].expand(len(key), 6) for name in self.states], 1)
        return {"oe": (columns, torch.cat([chief, self._elements(chief, states)], 1))}

    def _elements(self, chief: Tensor, states: Tensor) -> Tensor:
        """Return elements [n, D, 6] of deputies with relative states [n, D, 6], for elements [n, 1, 6] of the chief."""
        r, v = elements_to_rv(Elements(*chief.unbind(-1)), self.mu)
        r, v = hill_to_inertial(r, v, Vec3.of(states[..., :3]), Vec3.of(states[..., 3:]))
        oe = torch.stack(rv_to_elements(r, v, self.mu, CIRCULAR_BELOW), -1)
        unbound = ~((oe[..., 0] > 0.0) & (oe[..., 1] < 1.0))
        if bool(unbound.any()):
            where = int(unbound.any(0).nonzero()[0])
            raise ValueError(
                f"relative_to_chief: {list(self.states)[where]} puts the deputy on an orbit with a={oe[unbound][0, 0]:g} m and "
                f"e={oe[unbound][0, 1]:g}; an orbit around the Earth needs a > 0 and 0 <= e < 1"
            )
        return oe


def together(formations: Mapping[Sequence[str], Formation]) -> Formation:
    """Return several formations side by side, drawn independently; keys are the names of the satellites that each arranges."""
    if not isinstance(formations, Mapping):
        raise ValueError(f"formations={formations!r} must be a dictionary {{names of satellites: their formation}}")
    for members, formation in formations.items():
        if not isinstance(formation, Formation) or isinstance(members, str):
            raise ValueError(f"formations has {members!r}: {formation!r}; it must be a tuple of names, and their formation")
    return _Together(dict(formations))


@dataclass(eq=False)
class _Together(Formation):
    formations: dict[Sequence[str], Formation]

    @override
    def check(self, names: Sequence[str]) -> None:
        listed = [name for members in self.formations for name in members]
        for name in listed:
            if name not in names:
                raise ValueError(f"together: {name!r} is no satellite; {nearest(name, names)}")
        if twice := sorted({name for name in listed if listed.count(name) > 1}):
            raise ValueError(f"together: {twice} belong to more than one formation")
        for members, formation in self.formations.items():
            formation.check(members)

    @override
    def draw(self, key: Key, names: Sequence[str]) -> Settings:
        parts: dict[str, list[tuple[list[int], Tensor]]] = {}
        for members, formation in self.formations.items():
            columns = [names.index(name) for name in members]
            part_key = key.of_satellites(torch.tensor(columns[:1]))  # so that equal formations draw different numbers
            for name, (within, values) in formation.draw_checked(part_key, members).items():
                parts.setdefault(name, []).append(([columns[k] for k in within], values))
        return {
            name: ([column for columns, _ in entries for column in columns], torch.cat([values for _, values in entries], 1))
            for name, entries in parts.items()
        }
