"""What the tests of arcs share: orbits, and looking up positions as a tick does."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import torch

from bsk_torch.astro.interpolate import coefficients, position, velocity
from bsk_torch.astro.orbit import Elements, elements_to_rv
from bsk_torch.constants import R_EARTH
from bsk_torch.sim.component import neighbours
from bsk_torch.sim.orbit import ARC, Arcs
from bsk_torch.sim.sight import View, planned_position
from bsk_torch.sim.span import LEAD, SPACING
from bsk_torch.vec3 import Vec3


class Solved(NamedTuple):
    """Arcs, a view of the whole planned arcs, and the back end that has made them."""

    arcs: Arcs
    view: View
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
    nodes, tau = neighbours(ARC, arcs.flown, rows, time - arcs.start[rows] + LEAD * SPACING)
    path, s = coefficients([Vec3.of(node) for node in nodes.unbind(-2)]), tau / SPACING
    return position(path, s).stack(), velocity(path, s, SPACING).stack()


def planned(view: View, row: int, time: torch.Tensor) -> Vec3:
    """Planned position of one row at times [m]."""
    return planned_position(view.of(torch.full(time.shape, row)), time)[0]
