"""Orbits in closed form against arcs, which Basilisk's integrator solves with the whole field."""

import math

import pytest
import torch

from bsk_torch.astro.mean_orbit import mean_elements, mean_position
from bsk_torch.astro.orbit import Elements, elements_to_rv
from bsk_torch.sim.orbit.arcs import Arcs
from bsk_torch.sim.orbit.grid import LEAD_NODES, NODE_SPACING
from bsk_torch.sim.orbit.kernel_solver import make_solver

ORBITS = 60


@pytest.fixture(scope="module", params=[0.001, 0.02])
def errors(request) -> torch.Tensor:
    """Distances, m, between both, [orbits, minutes], over two hours of orbits with eccentricities up to the parameter."""
    torch.manual_seed(3)
    u = torch.rand(6, ORBITS, dtype=torch.float64)
    angle = 2.0 * math.pi
    r, v = elements_to_rv(
        Elements(6.78e6 + 8e5 * u[0], request.param * u[1], 0.5 * angle * u[2], angle * u[3], angle * u[4], angle * u[5])
    )
    arcs = Arcs(ORBITS, 2, make_solver(1.0, "eager", torch.device("cpu")))
    arcs.solve(torch.arange(ORBITS), 5.5e8 + 1e7 * u[0], r.stack(), v.stack())
    flown = arcs.flown[:, LEAD_NODES:]
    time = NODE_SPACING * torch.arange(flown.shape[1], dtype=torch.float64)
    oe = mean_elements(r.stack(), v.stack())
    return (mean_position(oe.unsqueeze(1), time).stack() - flown).norm(dim=-1)


def test_positions_are_good_to_half_a_kilometre_in_two_hours(errors):
    assert errors[:, -1].median() < 600.0
    assert errors[:, 95].median() < 550.0
    assert errors.max() < 3500.0
    assert errors[:, 0].median() < 120.0
    assert errors[:, 0].max() < 1000.0


def test_mean_elements_of_a_circular_equatorial_orbit_are_finite():
    r = torch.tensor([7e6, 0.0, 0.0], dtype=torch.float64)
    v = torch.tensor([0.0, 7546.0, 0.0], dtype=torch.float64)
    oe = mean_elements(r, v)
    assert torch.isfinite(oe).all()
    found = mean_position(oe, torch.zeros((), dtype=torch.float64)).stack()
    assert (found - r).norm() < 300.0
