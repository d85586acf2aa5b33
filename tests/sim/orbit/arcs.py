"""What the tests of arcs share: orbits, looking up positions as a tick does, and elevations by their definition."""

import math
from typing import Any, NamedTuple

import torch

from bsk_torch.astro.ephemeris import earth_orientation
from bsk_torch.astro.interpolate import coefficients, position, velocity
from bsk_torch.astro.orbit import Elements, elements_to_rv
from bsk_torch.constants import R_EARTH
from bsk_torch.sim.access.passes.passes import GroundTrack
from bsk_torch.sim.access.visibility.planned import PlannedOrbits, position_between
from bsk_torch.sim.component import neighbours
from bsk_torch.sim.orbit.arcs import ARC, Arcs
from bsk_torch.sim.orbit.grid import LEAD_NODES, NODE_SPACING, PLAN_STEP
from bsk_torch.sim.orbit.kernel_solver import make_solver
from bsk_torch.sim.places import FixedPlaces, Sites
from bsk_torch.vec3 import Vec3


class Solved(NamedTuple):
    """Arcs, a view of the whole planned arcs, and the back end that has made them."""

    arcs: Arcs
    view: PlannedOrbits
    backend: str


def initial(oe: Elements, utc: str) -> list[dict[str, Any]]:
    """Initial conditions as recordings list them, of elements [n]."""
    r, v = (x.stack().tolist() for x in elements_to_rv(oe))
    return [{"utc_init": utc, "rN": a, "vN": b} for a, b in zip(r, v, strict=True)]


def orbits(n: int) -> list[dict[str, Any]]:
    """Random low orbits at different epochs."""
    u = torch.rand(5, n, dtype=torch.float64)
    zero = torch.zeros(n, dtype=torch.float64)
    oe = Elements(6.8e6 + 1e6 * u[0], 0.02 * u[1], math.pi * u[2], 6 * u[3], zero, 6 * u[4])
    return [one | {"utc_init": f"20{k % 20:02d} JAN 01 00:00:00"} for k, one in enumerate(initial(oe, ""))]


def above(altitude: float, e: float, i: float, f: float, utc: str = "2021-05-04T00:00:00") -> dict[str, Any]:
    """An orbit with its perigee at an altitude, m."""
    elements = ((R_EARTH + altitude) / (1.0 - e), e, i, 1.0, 0.5, f)
    return initial(Elements(*(torch.tensor([x], dtype=torch.float64) for x in elements)), utc)[0]


def flown(arcs: Arcs, row: int, time: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
    """Position and velocity [m, 3] of one row at times [m], each looked up as a tick does."""
    rows = torch.full(time.shape, row)
    nodes, tau = neighbours(ARC, arcs.flown, rows, time - arcs.start[rows] + LEAD_NODES * NODE_SPACING)
    path, s = coefficients([Vec3.of(node) for node in nodes.unbind(-2)]), tau / NODE_SPACING
    return position(path, s).stack(), velocity(path, s, NODE_SPACING).stack()


def planned(view: PlannedOrbits, row: int, time: torch.Tensor) -> Vec3:
    """Planned position of one row at times [m]."""
    samples, ephemeris = view.take(torch.full(time.shape, row))
    return position_between(samples._replace(table=samples.table[:, ::2]), ephemeris, time)[0]


NODES = 10
"""Samples, 30 s apart, that the tests interpolate between: as many as a search has at least."""


def fixed_samples(oe: Elements, et: torch.Tensor, spans: int, backend: str) -> torch.Tensor:
    """Earth-fixed positions [n, K, 3] every 30 s of the planned arcs of elements and ET [n], turned by the ephemeris."""
    arcs = Arcs(len(et), spans, make_solver(1.0, backend, torch.device("cpu")))
    r, v = (x.stack() for x in elements_to_rv(oe))
    planned = arcs.solve(torch.arange(len(et)), et, r, v)
    times = et.unsqueeze(-1) + PLAN_STEP * torch.arange(planned.shape[1])
    return (earth_orientation(times) @ planned.unsqueeze(-1)).squeeze(-1)


def lagrange(tau: torch.Tensor) -> torch.Tensor:
    """Weights [..., NODES] of nodes 0, 1, 2, ... of the polynomial through them at tau [...]."""
    weights = []
    for k in range(NODES):
        others = [(tau - j) / (k - j) for j in range(NODES) if j != k]
        weights.append(torch.stack(others).prod(0))
    return torch.stack(weights, -1)


def at(ground: GroundTrack, row: torch.Tensor, time: torch.Tensor) -> torch.Tensor:
    """Earth-fixed positions [m, 3] of rows [m] at times [m]."""
    tau = (time - ground.start[row]) / PLAN_STEP
    first = (tau.floor().long() - NODES // 2 + 1).clamp(0, ground.r_BP_P.shape[1] - NODES)
    nodes = ground.r_BP_P[row.unsqueeze(-1), first.unsqueeze(-1) + torch.arange(NODES)]
    return (lagrange(tau - first).unsqueeze(1) @ nodes).squeeze(1)


def every(ground: GroundTrack, step: float) -> torch.Tensor:
    """Earth-fixed positions [n, T, 3] every ``step`` s, a part of 30 s, from the first to the last sample."""
    parts, gaps = round(PLAN_STEP / step), ground.r_BP_P.shape[1] - 1
    gap = torch.arange(gaps)
    first = (gap - NODES // 2 + 1).clamp(0, gaps + 1 - NODES)
    tau = (gap - first).unsqueeze(-1) + torch.arange(parts, dtype=torch.float64) / parts
    nodes = ground.r_BP_P[:, first.unsqueeze(-1) + torch.arange(NODES)]
    return torch.cat([(lagrange(tau) @ nodes).flatten(1, 2), ground.r_BP_P[:, -1:]], 1)


def sine_of_elevation(r_P: torch.Tensor, site: torch.Tensor) -> torch.Tensor:
    """Sine of the angle between the line of sight and the horizon's plane, Earth-fixed positions [..., 3]."""
    line = r_P - site
    return (line * site).sum(-1) / (line.norm(dim=-1) * site.norm(dim=-1))


def sines_of_elevation(r_P: torch.Tensor, site: torch.Tensor) -> torch.Tensor:
    """The same [n, T, P] of positions [n, T, 3] over sites [n, P, 3], good to 1e-12, by matrix products."""
    dot, site2 = r_P @ site.mT, (site * site).sum(-1).unsqueeze(1)
    line2 = ((r_P * r_P).sum(-1, keepdim=True) + site2).sub(dot, alpha=2.0)
    return dot.sub_(site2).div_(line2.mul_(site2).sqrt_())


def places_of(places: Sites) -> FixedPlaces:
    """The places of rows, which may be the same for all."""
    sines = places.sin_min_elevation
    return FixedPlaces(places.r_LP_P, lambda rows: sines if len(sines) == 1 else sines[rows])
