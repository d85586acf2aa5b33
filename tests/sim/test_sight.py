"""Kernels and tensors see the same from the same planned arcs."""

from __future__ import annotations

import math

import pytest
import torch

from bsk_torch.astro.eclipse import illumination
from bsk_torch.astro.ephemeris import earth_orientation, sun_position
from bsk_torch.astro.frames import lla_to_fixed
from bsk_torch.sim.sight import (
    GLIMPSED,
    PEAK_ITERATIONS,
    PER_PLACE,
    RISES,
    SETS,
    Brackets,
    KernelSight,
    Places,
    TensorSight,
    View,
    happening,
    make_sight,
    planned_position,
    sampled,
)
from bsk_torch.sim.span import PLAN_STEP
from bsk_torch.vec3 import Vec3
from tests.sim.arcs import above, orbits

CPU = torch.device("cpu")
HOURS = 4
SAMPLES = round(HOURS * 3600.0 / PLAN_STEP) + 1

ORBITS = [above(5e5, 0.0, 0.9, 2.0), above(4e5, 0.01, 1.7, 0.0), above(3.5e5, 0.2, 1.0, 3.0), above(1.2e6, 0.05, 2.5, 1.0)]


@pytest.fixture(scope="module")
def sky_full_of_satellites(solve_arcs):
    """Arcs and view of eleven orbits; the number is no multiple of a register's lanes."""
    torch.manual_seed(7)
    return solve_arcs([*ORBITS, *orbits(7)], HOURS)


@pytest.fixture(scope="module")
def view(sky_full_of_satellites) -> View:
    return sky_full_of_satellites[1]


def places(count: int = 7, elevation: float = 10.0) -> Places:
    """Sites all around the Earth."""
    generator = torch.Generator().manual_seed(3)
    latitude, longitude = (torch.rand(2, count, dtype=torch.float64, generator=generator) - 0.5) * torch.tensor([[2.4], [6.2]])
    r_P = lla_to_fixed(latitude, longitude, torch.zeros(count, dtype=torch.float64))
    return Places(r_P, torch.full((count,), math.sin(math.radians(elevation)), dtype=torch.float64))


def epoch(view: View) -> torch.Tensor:
    return torch.zeros_like(view.planned.start)


def later(view: View) -> torch.Tensor:
    """A start of its own for each row, on the grid."""
    return PLAN_STEP * torch.arange(len(view.planned.start), dtype=torch.float64)


VIEWS = {"samples": lambda view: view, "nodes": lambda view: view._replace(fine=None)}
"""With samples every 30 s at hand, and with positions interpolated between nodes a minute apart."""


# -- samples ----------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("kind", VIEWS)
def test_samples_lie_on_the_planned_arcs(kind, view, sky_full_of_satellites):
    """Interpolated ones agree to a tenth of a millimetre; the sky is the ephemeris'."""
    arcs, _ = sky_full_of_satellites
    r, sky = sampled(VIEWS[kind](view), epoch(view), SAMPLES)
    r = r.stack().view(len(arcs.et), SAMPLES, 3)
    assert torch.equal(view.fine.table[:, ::2], view.planned.table)
    error = (r - view.fine.table).norm(dim=-1)
    assert error.amax() < 2e-4  # measured 8e-5, in the first and last minutes
    assert error[:, 10:-12].amax() < 2e-5  # measured 1e-5, at the eccentric orbit's perigee
    et = (arcs.et.unsqueeze(-1) + PLAN_STEP * torch.arange(SAMPLES)).flatten()
    torch.testing.assert_close(sky.r_sun.stack(), sun_position(et), rtol=0, atol=4e-4)


@pytest.mark.compiled
@pytest.mark.parametrize("kind", VIEWS)
@pytest.mark.parametrize("start", [epoch, later])
def test_both_see_the_same_umbra(start, kind, view):
    view = VIEWS[kind](view)
    count = SAMPLES - 11
    tensor, kernel = (sight.dark(view, start(view), count) for sight in (TensorSight(), KernelSight()))
    assert torch.equal(tensor, kernel)
    assert 0.1 < tensor.double().mean() < 0.5


def test_umbra_by_definition(view, sky_full_of_satellites):
    arcs, _ = sky_full_of_satellites
    et = (arcs.et.unsqueeze(-1) + PLAN_STEP * torch.arange(SAMPLES)).flatten()
    expected = illumination(Vec3.of(view.fine.table.flatten(0, 1)), Vec3.of(sun_position(et))) <= 0.0
    assert torch.equal(TensorSight().dark(view, epoch(view), SAMPLES).flatten(), expected)


@pytest.mark.compiled
@pytest.mark.parametrize("kind", VIEWS)
@pytest.mark.parametrize("start", [epoch, later])
@pytest.mark.parametrize("whole", [False, True])
def test_both_see_the_same_heights_and_happenings(whole, start, kind, view):
    view, sites, count = VIEWS[kind](view), places(), SAMPLES - 11
    tensor, kernel = (sight.heights(view, start(view), count, sites, whole) for sight in (TensorSight(), KernelSight()))
    assert torch.equal(tensor.codes, kernel.codes)
    assert (tensor.codes > 0).sum() > 50
    if not whole:
        torch.testing.assert_close(tensor.above, kernel.above, rtol=0, atol=1e-13)  # measured 2e-15
        torch.testing.assert_close(tensor.radius, kernel.radius, rtol=1e-14, atol=0)


def test_heights_by_definition(view, sky_full_of_satellites):
    """The elevation is 90 degrees less the angle between the site's vertical and the line of sight."""
    arcs, _ = sky_full_of_satellites
    sites, et = places(), arcs.et.unsqueeze(-1) + PLAN_STEP * torch.arange(SAMPLES)
    found = TensorSight().heights(view, epoch(view), SAMPLES, sites, whole=False)
    r_P = (earth_orientation(et) @ view.fine.table.unsqueeze(-1)).squeeze(-1)
    line = r_P.unsqueeze(2) - sites.r_P
    zenith = torch.acos((line * sites.r_P).sum(-1) / (line.norm(dim=-1) * sites.r_P.norm(dim=-1)))
    expected = torch.sin(math.pi / 2 - zenith) - sites.sin_min_elevation
    torch.testing.assert_close(found.above, expected, rtol=0, atol=3e-10)  # the Earth's angle is rounded to 3e-11 rad
    torch.testing.assert_close(found.radius, view.fine.table.norm(dim=-1), rtol=1e-15, atol=0)


# -- what happens between samples -------------------------------------------------------------------------------------------


def codes_of(*heights: float) -> float:
    return happening(*(torch.tensor(x, dtype=torch.float64) for x in heights)).item()


@pytest.mark.parametrize(
    ("heights", "code"),
    [
        ((-0.3, -0.2, -0.1), 0),
        ((-0.2, -0.1, 0.1), RISES),
        ((math.nan, -0.1, 0.1), RISES),
        ((math.nan, math.nan, 0.1), 0),  # the first sample: nothing is known of what was before
        ((0.2, 0.1, -0.1), SETS),
        ((0.1, 0.0, 0.1), RISES),  # zero is below the limit
        ((0.1, 0.1, 0.0), SETS),
        ((-0.1, -0.001, -0.1), GLIMPSED),  # a top near the middle, just below the limit
        ((-0.1, -0.001, -0.0011), GLIMPSED),
        ((-0.1, -0.05, -0.1), 0),  # a top far below it
        ((-0.1, 0.001, -0.1), SETS),  # samples that see it are no glimpse
        ((-0.001, -0.001, 0.01), RISES),
        ((math.nan, -0.001, -0.1), 0),
        ((-0.001, -0.001, -0.001), GLIMPSED),
    ],
)
def test_what_happens(heights, code):
    assert codes_of(*heights) == code


def test_codes_of_many_places_fit_into_a_double(view):
    """The code of each place is a digit."""
    sites = places(17)
    found = TensorSight().heights(view, epoch(view), SAMPLES, sites, whole=False)
    digits = found.codes.long().unsqueeze(-1) // PER_PLACE ** torch.arange(17) % PER_PLACE
    up = found.above > 0.0
    assert torch.equal(digits[:, 1:] % 4 == RISES, up[:, 1:] & ~up[:, :-1])
    assert torch.equal(digits[:, 1:] % 4 == SETS, ~up[:, 1:] & up[:, :-1])
    assert (digits[..., 16] > 0).any()
    assert (digits[:, 0] == 0).all()


@pytest.mark.compiled
def test_both_see_seventeen_places_alike(view):
    tensor, kernel = (sight.heights(view, epoch(view), SAMPLES, places(17), True) for sight in (TensorSight(), KernelSight()))
    assert torch.equal(tensor.codes, kernel.codes)


# -- crossings and peaks ----------------------------------------------------------------------------------------------------


def crossings_of(view: View, sites: Places) -> tuple[View, Places, Brackets]:
    """Brackets around all crossings."""
    found = TensorSight().heights(view, epoch(view), SAMPLES, sites, whole=False).above
    row, sample, place = torch.nonzero((found[:, 1:] > 0.0) != (found[:, :-1] > 0.0), as_tuple=True)
    a = PLAN_STEP * sample.double()
    brackets = Brackets(a, a + PLAN_STEP, found[row, sample, place], found[row, sample + 1, place])
    return view.of(row), Places(*(part[place] for part in sites)), brackets


@pytest.mark.compiled
def test_both_find_the_same_crossings(view):
    rows, sites, brackets = crossings_of(view, places(elevation=5.0))
    assert len(brackets.a) > 50
    tensor, kernel = (sight.crossings(rows, sites, brackets) for sight in (TensorSight(), KernelSight()))
    torch.testing.assert_close(tensor, kernel, rtol=0, atol=1e-9)  # s; measured 5e-12
    assert ((tensor >= brackets.a) & (tensor <= brackets.b)).all()
    for sight in (TensorSight(), KernelSight()):
        assert sight.height(rows, sites, tensor).abs().amax() < 1e-13  # sine of elevation, which moves by 1e-3 per second


def grazing(view: View) -> tuple[View, Places, torch.Tensor, torch.Tensor, torch.Tensor]:
    """Passes whose tops lie between two samples that are just below the limit: rows, places, brackets and true tops."""
    sites = places(elevation=0.0)
    height = TensorSight().heights(view, epoch(view), SAMPLES, sites, whole=False).above
    inner = height[:, 1:-1]
    top = (inner > height[:, :-2]) & (inner > height[:, 2:]) & (inner > 0.05)
    row, sample, place = torch.nonzero(top, as_tuple=True)
    a = PLAN_STEP * sample.double()
    rows, sites = view.of(row), Places(*(part[place] for part in sites))
    time = a.unsqueeze(-1) + torch.linspace(0.0, 2.0 * PLAN_STEP, 6001, dtype=torch.float64)
    many = rows.of(torch.arange(len(a)).repeat_interleave(6001))
    spread = Places(*(part.repeat_interleave(6001, 0) for part in sites))
    fine = TensorSight().height(many, spread, time.flatten()).view(-1, 6001)
    return rows, sites, a, a + 2.0 * PLAN_STEP, time.gather(1, fine.argmax(1, keepdim=True)).squeeze(1)


@pytest.mark.compiled
def test_both_find_the_tops_of_passes(view):
    rows, sites, a, b, expected = grazing(view)
    assert len(a) > 10
    for sight in (TensorSight(), KernelSight()):
        found = sight.peaks(rows, sites, a, b)
        # the section ends 0.4 ms wide; measured 7e-5 s between the two
        torch.testing.assert_close(found, expected, rtol=0, atol=0.01)  # of points 10 ms apart
    assert 2.0 * PLAN_STEP * 0.618**PEAK_ITERATIONS < 1e-3


@pytest.mark.compiled
def test_glimpses_are_the_same(view):
    """Limits between the top of a pass and its best sample: windows of seconds that no sample sees."""
    rows, sites, a, b, top = grazing(view)
    highest = TensorSight().height(rows, sites, top)
    best = torch.stack([TensorSight().height(rows, sites, t) for t in (a, a + PLAN_STEP, b)]).amax(0)
    limited = Places(sites.r_P, 0.3 * highest + 0.7 * best)
    edges = []
    for sight in (TensorSight(), KernelSight()):
        peak = sight.peaks(rows, limited, a, b)
        for outer in (a, b):
            ends = (sight.height(rows, limited, t) for t in (outer, peak))
            edges.append(sight.crossings(rows, limited, Brackets(outer, peak, *ends)))
    long = edges[1] - edges[0] > 0.1  # bsk_rl drops shorter ones; the ends of those depend on rounding
    assert long.sum() > 10
    for tensor, kernel in zip(edges[:2], edges[2:], strict=True):
        torch.testing.assert_close(tensor[long], kernel[long], rtol=0, atol=1e-6)
    assert (edges[1] - edges[0])[long].amax() < 2.0 * PLAN_STEP


# -- views ------------------------------------------------------------------------------------------------------------------


def test_views_of_rows(view):
    """Rows may repeat, and be taken of rows that have been taken."""
    rows, time = torch.tensor([3, 0, 3, 10]), torch.tensor([100.0, 200.0, 300.0, 400.0], dtype=torch.float64)
    some = view.of(torch.tensor([10, 3, 0])).of(torch.tensor([1, 2, 1, 0]))
    r, _ = planned_position(some, time)
    expected, _ = planned_position(view.of(rows), time)
    assert torch.equal(r.stack(), expected.stack())
    for k, row in enumerate(rows.tolist()):
        alone, _ = planned_position(view.of(torch.tensor([row])), time[k : k + 1])
        assert torch.equal(alone.stack()[0], r.stack()[k])


@pytest.mark.compiled
def test_nothing_to_look_at(view):
    none = view.of(torch.zeros(0, dtype=torch.int64))
    empty, sites = torch.zeros(0, dtype=torch.float64), Places(torch.zeros(0, 3).double(), torch.zeros(0).double())
    for sight in (TensorSight(), KernelSight()):
        assert sight.crossings(none, sites, Brackets(empty, empty, empty, empty)).shape == (0,)
        assert sight.peaks(none, sites, empty, empty).shape == (0,)


def test_which_sight():
    assert isinstance(make_sight("compiled", CPU), KernelSight)
    assert isinstance(make_sight("eager", CPU), TensorSight)
