"""Orbits carried along step by step."""

import pytest
import torch

from bsk_torch import rand
from bsk_torch.astro.interpolate import BEFORE, COUNT, coefficients, position, velocity
from bsk_torch.astro.orbit import Elements, elements_to_rv
from bsk_torch.codegen.kernel import Samples
from bsk_torch.rand import first_key
from bsk_torch.sim.environment.ephemeris import ephemeris_records
from bsk_torch.sim.orbit.arcs import Arcs
from bsk_torch.sim.orbit.flights import FIRST_STEP, KernelFlights, TensorFlights, make_flights, positions, velocities
from bsk_torch.sim.orbit.grid import LEAD_NODES
from bsk_torch.sim.orbit.kernel_solver import make_solver
from bsk_torch.vec3 import Vec3

pytestmark = pytest.mark.compiled

CPU = torch.device("cpu")
TIMES = (0.0, 1.0, 29.0, 59.5, 120.0, 130.0, 1000.0, 3605.0, 5431.0)


def start(n):
    oe = rand.random_orbit(a=7200.0, e=0.02).draw(first_key(n))
    r, v = (part.stack() for part in elements_to_rv(Elements(*oe.unbind(-1))))
    return torch.full((n,), 3e8, dtype=torch.float64), r, v


def around(et):
    return Samples(ephemeris_records(et, 4), torch.zeros_like(et))


def test_flights_are_where_arcs_are():
    """Both are the same method; between steps polynomials of other degrees."""
    et, r, v = start(20)
    arcs = Arcs(20, 2, make_solver(1.0, "compiled", CPU))
    arcs.solve(torch.arange(20), et, r, v)
    flights = make_flights(1.0, "compiled", CPU)
    flight, step = flights.start(r, v, around(et)), FIRST_STEP
    for time in TIMES:
        goal = max(FIRST_STEP, -int(-time // 30))
        if goal > step:
            flights.advance(flight, torch.full((20,), step), torch.full((20,), goal - step), around(et))
        step = goal
        since = torch.full((20,), time / 30.0 - step, dtype=torch.float64)
        node = int(time // 60)
        path = coefficients([Vec3.of(arcs.flown[:, LEAD_NODES + node - BEFORE + k]) for k in range(COUNT)])
        s = torch.full((20,), time / 60.0 - node, dtype=torch.float64)
        assert (positions(flight, since).mT - position(path, s).stack()).abs().max() < 2e-5
        assert (velocities(flight, since).mT - velocity(path, s, 60.0).stack()).abs().max() < 2e-7


def test_tensors_and_kernels_agree():
    et, r, v = start(3)
    step, counts = torch.full((3,), FIRST_STEP), torch.tensor([0, 7, 4])
    found = []
    for flights in (KernelFlights(1.0, 10), TensorFlights(1.0, CPU, 10)):
        flight = flights.start(r, v, around(et))
        flights.advance(flight, step, counts, around(et))
        flown = flights.fly(flight, step + counts, 3, around(et))
        found.append((flight, flown))
    assert (found[0][0] - found[1][0]).abs().max() < 1e-7
    assert (found[0][1] - found[1][1]).abs().max() < 1e-7


def test_rows_do_not_depend_on_each_other():
    et, r, v = start(9)
    flights = make_flights(1.0, "compiled", CPU)
    every = flights.start(r, v, around(et))
    few = flights.start(r[4:5], v[4:5], around(et[4:5]))
    assert torch.equal(every[:, 4:5], few)
    flights.advance(every, torch.full((9,), FIRST_STEP), torch.arange(9), around(et))
    flights.advance(few, torch.full((1,), FIRST_STEP), torch.tensor([4]), around(et[4:5]))
    assert torch.equal(every[:, 4:5], few)
