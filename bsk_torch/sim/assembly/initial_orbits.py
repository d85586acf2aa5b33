"""Checks of initial orbits: whether they are orbits around the Earth, and whether drag can be left out."""

from __future__ import annotations

from collections.abc import Mapping

import torch
from torch import Tensor

from bsk_torch.astro.atmosphere import exponential_density, top_radius
from bsk_torch.astro.orbit import periapsis_radius
from bsk_torch.constants import MU_EARTH
from bsk_torch.sim.component import Values
from bsk_torch.sim.dyn import hub
from bsk_torch.vec3 import Vec3

LOWEST_PERIAPSIS, HIGHEST_APOAPSIS = 6.35e6, 1e9
"""Bounds of the radii of initial orbits, m: the Earth's polar radius is 6.357e6, and the Moon, which is not modeled, at 4e8."""

FARTHEST = 1e12  # largest initial distance from the Earth's center of a satellite that is not in orbit, m
DENSEST_AIR = 10.0  # largest density, kg/m^3, at an initial position


def check_orbits(values: Values, orbit: str) -> None:
    """Check the initial orbits of drawn arguments.

    ``orbit`` is ``"arc"`` for orbits solved in advance, without drag; ``"integrated"``; or ``"free"`` for satellites that may
    be at rest, fall, or leave. ValueError for positions and velocities without an orbit around the Earth, or an orbit that
    needs another value of ``orbit``.
    """
    r, v = (Vec3.of(x) for x in hub.initial_orbit(values))
    if orbit == "free":
        _check_start(values, r)
        return
    lowest = _lowest_periapsis(values, r, v)
    if "baseDensity" not in values:
        return
    names = ("planetRadius", "baseDensity", "scaleHeight")
    if orbit == "arc":
        top = top_radius(*(float(values[name].max()) for name in names))
        if lowest < top:
            raise ValueError(
                f"sat_args: an orbit comes down to {lowest / 1e3:.0f} km from the Earth's center, but drag is felt below "
                f"{top / 1e3:.6g} km (by {', '.join(names)}) and the orbit is computed without it; pass "
                "orbit='integrated' to the environment, or leave drag out by world_args={'baseDensity': 0.0}, as communication "
                "along lines of sight needs"
            )
    elif not bool((exponential_density(r, *(values[name] for name in names)) <= DENSEST_AIR).all()):
        raise ValueError(f"world_args: by {', '.join(names)} the air has more than {DENSEST_AIR:g} kg/m^3 at an initial position")


def _check_start(values: Mapping[str, object], r: Vec3) -> None:
    """Raise ValueError for an initial position, m, below the surface or too far away."""
    radius = r.norm()
    wrong = ~((radius >= LOWEST_PERIAPSIS) & (radius <= FARTHEST))
    if bool(wrong.any()):
        source = "rN is" if values["oe"] is None else "oe is a position"
        raise ValueError(
            f"sat_args: {source} {_first(radius, wrong) / 1e3:.6g} km from the Earth's center; allowed are "
            f"{LOWEST_PERIAPSIS / 1e3:g} km, its surface, to {FARTHEST / 1e3:g} km"
        )


def _lowest_periapsis(values: Values, r: Vec3, v: Vec3) -> float:
    """Return the lowest periapsis, m, of initial positions, m, and velocities, m/s; ValueError for others."""
    source = "rN and vN are" if values["oe"] is None else "oe is"
    mu = torch.clamp(values["mu"], max=MU_EARTH)  # observed elements are those under the smaller one
    radius, speed2 = r.norm(), v.dot(v)
    a = 1.0 / (2.0 / radius - speed2 / mu)
    bound = (radius > 0.0) & (a > 0.0)
    if not bool(bound.all()):
        given_mu, from_oe = float(values["mu"].max()), values["oe"] is not None
        converted = f" (sat_args['mu']={given_mu:g} has converted oe)" if from_oe and given_mu != MU_EARTH else ""
        raise ValueError(
            f"sat_args: {source} no orbit around the Earth: {_first(radius, ~bound) / 1e3:g} km from its center at "
            f"{_first(speed2.sqrt(), ~bound):g} m/s, with mu={_first(mu, ~bound):g} m^3/s^2; an orbit's energy is negative"
            f"{converted}"
        )
    periapsis = periapsis_radius(r, v)
    wrong = ~((periapsis >= LOWEST_PERIAPSIS) & (2.0 * a - periapsis <= HIGHEST_APOAPSIS))
    if bool(wrong.any()):
        low, high = _first(periapsis, wrong), _first(2.0 * a - periapsis, wrong)
        raise ValueError(
            f"sat_args: {source} an orbit from {low / 1e3:.6g} to {high / 1e3:.6g} km from the Earth's center; allowed are "
            f"{LOWEST_PERIAPSIS / 1e3:g} km, its surface, to {HIGHEST_APOAPSIS / 1e3:g} km (oe: a(1 - e) and a(1 + e); rN "
            "and vN: not parallel)"
        )
    return float(periapsis.min())


def _first(values: Tensor, where: Tensor) -> float:
    return float(values.expand_as(where)[where][0])
