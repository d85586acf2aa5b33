"""Windows of eccentric orbits are those of brute force; with ``compat="bsk_rl"`` they have bsk_rl's errors."""

import math
from typing import NamedTuple

import pytest
import torch

import bsk_torch
from bsk_torch.astro.ephemeris import earth_orientation
from bsk_torch.astro.orbit import Elements
from bsk_torch.constants import R_EARTH
from bsk_torch.sim.access.visibility.kernels import make_visibility
from bsk_torch.sim.access.windows.search import AccessWindows
from bsk_torch.sim.places import Sites
from tests.sim.orbit.arcs import Solved, initial, places_of, planned, sines_of_elevation

KIND, CPU = "target", torch.device("cpu")
PERIGEE, SPAN, SEGMENT = R_EARTH + 5e5, 8 * 3600.0, 600.0
STEP = 10.0
"""Spacing, s, of the samples of brute force."""

SMALL = 1e-3
"""Seconds around an edge in which a sample may count as either, far more than edges are off."""

ECCENTRICITIES = [0.0, 0.2, 0.4, 0.5, 0.65, 0.79]
GENERATED = {"all at reset": SPAN, "one segment at reset": SEGMENT, "nothing at reset": 0.0}


class Counted(NamedTuple):
    """Samples of brute force: visible, visible outside all windows, invisible in a window."""

    visible: int
    missed: int
    offered: int


@pytest.fixture(scope="module")
def eccentric(solve_arcs) -> Solved:
    """Two orbits of each eccentricity: one starts at its perigee, one near its apogee."""
    e = torch.tensor(ECCENTRICITIES, dtype=torch.float64).repeat(2)
    n = len(e)
    f = torch.where(torch.arange(n) < n // 2, 0.1, 3.0).double()
    i = torch.linspace(0.2, 2.9, n, dtype=torch.float64)
    oe = Elements(PERIGEE / (1.0 - e), e, i, torch.linspace(0.0, 6.0, n).double(), 0.0 * e + 1.0, f)
    return Solved(*solve_arcs(initial(oe, "2024-03-01T00:00:00"), 1 + math.ceil(SPAN / 3600.0), backend="eager"), "eager")


@pytest.fixture(scope="module")
def places() -> Sites:
    """Thirty places everywhere, with limits of 0 to 60 degrees."""
    r_LP_P = R_EARTH * torch.nn.functional.normalize(torch.randn(1, 30, 3, dtype=torch.float64), dim=-1)
    return Sites(r_LP_P, torch.sin(torch.linspace(0.0, math.pi / 3.0, 30, dtype=torch.float64)).unsqueeze(0))


@pytest.fixture(scope="module")
def visible(eccentric, places) -> tuple[torch.Tensor, torch.Tensor]:
    return looked_at(eccentric, places)


def looked_at(flight: Solved, places: Sites) -> tuple[torch.Tensor, torch.Tensor]:
    """Times [T] of brute force, and whether places are above their limits then, [n, T, P]."""
    time = torch.arange(STEP, SPAN, STEP, dtype=torch.float64)
    r_BN_N = torch.stack([planned(flight.view, row, time).stack() for row in range(len(flight.arcs.start))])
    r_BP_P = (earth_orientation(flight.arcs.et.unsqueeze(-1) + time) @ r_BN_N.unsqueeze(-1)).squeeze(-1)
    return time, sines_of_elevation(r_BP_P, places.r_LP_P.expand(len(r_BP_P), -1, -1)) > places.sin_min_elevation.unsqueeze(1)


def compare(
    flight: Solved, places: Sites, visible: tuple[torch.Tensor, torch.Tensor], generated: float, compat: bool
) -> list[Counted]:
    """Count for each orbit what windows that were generated at reset and then segment by segment tell."""
    rows = torch.arange(len(flight.arcs.start))
    visibility = make_visibility(flight.backend, CPU)
    access = AccessWindows(flight.arcs, visibility, {KIND: places_of(places)}, SEGMENT, compat)
    access.generate(rows, flight.view, torch.full((len(rows),), generated, dtype=torch.float64))
    while bool((access.ready < SPAN).any()):
        access.extend(rows, torch.zeros(len(rows), dtype=torch.float64))
    time, up = visible
    windows = access.windows[KIND]
    counted = []
    for row in rows.tolist():
        some = torch.isfinite(windows.close[row])
        inside, near = torch.zeros_like(up[row]), torch.zeros_like(up[row])
        for opens, closes, place in zip(*(part[row][some] for part in windows), strict=True):
            assert closes > opens
            inside[:, place] |= (time > opens) & (time < closes)
            near[:, place] |= ((time - opens).abs() < SMALL) | ((time - closes).abs() < SMALL)
        wrong = (up[row] != inside) & ~near
        counted.append(Counted(int(up[row].sum()), int((wrong & up[row]).sum()), int((wrong & inside).sum())))
    return counted


@pytest.mark.parametrize("generated", GENERATED.values(), ids=GENERATED)
def test_windows_are_those_of_brute_force(generated, eccentric, places, visible):
    """Every ten seconds of eight hours, for 12 orbits and 30 places."""
    counted = compare(eccentric, places, visible, generated, compat=False)
    assert all(some.visible > 100 for some in counted)
    assert all(some.missed == some.offered == 0 for some in counted), counted


def test_windows_of_high_circular_orbits_are_those_of_brute_force(solve_arcs, places):
    """Where bsk_rl's maximiser leaves the searched interval: see tests/basilisk/test_lost_passes.py."""
    altitude = torch.tensor([1.2e6, 1.4e6, 2e6, 3e6, 8e6, 2e7], dtype=torch.float64)
    spread = torch.linspace(0.3, 2.8, len(altitude), dtype=torch.float64)
    oe = Elements(R_EARTH + altitude, 0.0 * spread, spread, 2.0 * spread, 0.0 * spread, spread)
    flight = Solved(*solve_arcs(initial(oe, "2024-03-01T00:00:00"), 1 + math.ceil(SPAN / 3600.0), backend="eager"), "eager")
    counted = compare(flight, places, looked_at(flight, places), SPAN, compat=False)
    assert all(some.visible > 100 for some in counted)
    assert all(some.missed == some.offered == 0 for some in counted), counted


def test_bsk_rl_misses_what_is_visible_and_offers_what_is_not(eccentric, places, visible):
    """Where it looks ahead by segments, which lie within passes over high apogees."""
    counted = compare(eccentric, places, visible, SEGMENT, compat=True)
    high = [some for some, e in zip(counted, 2 * ECCENTRICITIES, strict=True) if e >= 0.4]
    assert sum(some.missed for some in high) > 0.5 * sum(some.visible for some in high)
    assert sum(some.offered for some in high) > 1000


@pytest.mark.parametrize("compat", [None, "bsk_rl"])
def test_environments_have_the_windows_that_are_asked_for(compat):
    env = bsk_torch.make("NadirScan-v1", num_envs=1, backend="eager", compat=compat)
    assert env.satellite.simulator.access.compat == (compat == "bsk_rl")
