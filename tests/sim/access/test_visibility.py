"""Kernels and tensors see the same from the same planned arcs."""

import math

import pytest
import torch

from bsk_torch.astro.eclipse import illumination
from bsk_torch.astro.ephemeris import earth_orientation, sun_position
from bsk_torch.astro.frames import lla_to_fixed
from bsk_torch.astro.sight import elevation_clearance
from bsk_torch.codegen.kernel import Samples
from bsk_torch.constants import R_EARTH
from bsk_torch.sim.access.passes.passes import GroundTrack
from bsk_torch.sim.access.visibility.geometry import (
    ABOVE_LIMIT,
    CLASSIFIED_SAMPLES,
    CULMINATION_TOLERANCE,
    RISE,
    SAMPLES_PER_CELL,
    SET,
    SHORT_PASS,
    SearchCells,
    classify,
    event_code,
)
from bsk_torch.sim.access.visibility.interface import CULMINATION_ITERATIONS, Brackets, PlacePairs, Visibility
from bsk_torch.sim.access.visibility.kernels import KernelVisibility, make_visibility
from bsk_torch.sim.access.visibility.planned import PlannedOrbits, position_between, sample_planned, take_rows
from bsk_torch.sim.access.visibility.tensors import TensorVisibility
from bsk_torch.sim.environment.ephemeris import ephemeris_records
from bsk_torch.sim.orbit.grid import PLAN_STEP
from bsk_torch.vec3 import Vec3
from tests.sim.orbit.arcs import above, at, orbits, sine_of_elevation, sines_of_elevation

CPU = torch.device("cpu")
HOURS = 4
SAMPLES = round(HOURS * 3600.0 / PLAN_STEP) + 1

ORBITS = [above(5e5, 0.0, 0.9, 2.0), above(4e5, 0.01, 1.7, 0.0), above(3.5e5, 0.2, 1.0, 3.0), above(1.2e6, 0.05, 2.5, 1.0)]
CIRCULAR = [0, 1, 3]
"""Those that are nearly so."""

BOTH: tuple[Visibility, Visibility] = (TensorVisibility(), KernelVisibility())


@pytest.fixture(scope="module")
def sky_full_of_satellites(solve_arcs):
    """Arcs and view of eleven orbits; the number is no multiple of a register's lanes."""
    torch.manual_seed(7)
    return solve_arcs([*ORBITS, *orbits(7)], HOURS)


@pytest.fixture(scope="module")
def view(sky_full_of_satellites) -> PlannedOrbits:
    return sky_full_of_satellites[1]


@pytest.fixture(scope="module")
def path(view) -> Samples:
    """Earth-fixed samples of all satellites."""
    return Samples(TensorVisibility().ground_track(view, epoch(view), SAMPLES), epoch(view))


def numbers(*values: float) -> torch.Tensor:
    return torch.tensor(values, dtype=torch.float64)


def sites(count: int = 7) -> torch.Tensor:
    """Positions [count, 3] all around the Earth, at different heights."""
    generator = torch.Generator().manual_seed(3)
    latitude, longitude = (torch.rand(2, count, dtype=torch.float64, generator=generator) - 0.5) * torch.tensor([[2.4], [6.2]])
    return lla_to_fixed(latitude, longitude, torch.linspace(-400.0, 8000.0, count, dtype=torch.float64))


def all_pairs(path: Samples, elevation: float = 10.0, count: int = 7) -> PlacePairs:
    """Every satellite over every place, [n * count]."""
    n = len(path.start)
    row, place = torch.arange(n).repeat_interleave(count), torch.arange(count).repeat(n)
    return PlacePairs(
        take_rows(path, row), sites(count)[place], torch.full((n * count,), math.sin(math.radians(elevation))).double()
    )


def epoch(view: PlannedOrbits) -> torch.Tensor:
    return torch.zeros_like(view.samples.start)


def later(view: PlannedOrbits) -> torch.Tensor:
    """A separate start for each row, on the grid."""
    return PLAN_STEP * torch.arange(len(view.samples.start), dtype=torch.float64)


# -- samples -------------------------------------------------------------------------------------------------------------------


def test_samples_lie_on_the_planned_arcs(view, sky_full_of_satellites):
    """Exactly; positions between nodes a minute apart agree to a tenth of a millimetre; the ephemeris is the ephemeris'."""
    arcs, _ = sky_full_of_satellites
    r, ephemeris = sample_planned(view, epoch(view), SAMPLES)
    r = r.stack().view(len(arcs.et), SAMPLES, 3)
    assert torch.equal(r, view.samples.table)
    every = view.take(torch.arange(len(arcs.et)).repeat_interleave(SAMPLES))
    nodes = every.samples._replace(table=view.samples.table[:, ::2])
    between, _ = position_between(nodes, every.ephemeris, PLAN_STEP * torch.arange(SAMPLES).double().repeat(len(arcs.et)))
    error = (r - between.stack().view(r.shape)).norm(dim=-1)
    assert error.amax() < 2e-4  # measured 8e-5, in the first and last minutes
    assert error[:, 10:-12].amax() < 2e-5  # measured 1e-5, at the eccentric orbit's perigee
    et = (arcs.et.unsqueeze(-1) + PLAN_STEP * torch.arange(SAMPLES)).flatten()
    torch.testing.assert_close(ephemeris.r_SN_N.stack(), sun_position(et), rtol=0, atol=4e-4)


@pytest.mark.compiled
@pytest.mark.parametrize("start", [epoch, later])
def test_both_see_the_same_umbra_and_ground(start, view):
    count = SAMPLES - 11
    tensor, kernel = (sight.umbra(view, start(view), count) for sight in BOTH)
    assert torch.equal(tensor > 0.0, kernel > 0.0)
    torch.testing.assert_close(tensor, kernel, rtol=0, atol=1e-14)
    assert 0.1 < (tensor > 0.0).double().mean() < 0.5
    tensor, kernel = (sight.ground_track(view, start(view), SAMPLES - 11) for sight in BOTH)
    assert tensor.shape == (len(view.samples.start), SAMPLES - 11, 3)
    torch.testing.assert_close(tensor, kernel, rtol=0, atol=1e-7)  # m; measured 1e-8, rounding of seven megametres


def test_umbra_and_ground_by_definition(view, sky_full_of_satellites):
    arcs, _ = sky_full_of_satellites
    et = (arcs.et.unsqueeze(-1) + PLAN_STEP * torch.arange(SAMPLES)).flatten()
    expected = illumination(Vec3.of(view.samples.table.flatten(0, 1)), Vec3.of(sun_position(et))) <= 0.0
    assert torch.equal(TensorVisibility().umbra(view, epoch(view), SAMPLES).flatten() > 0.0, expected)
    # The orientation of the ephemeris, times the planned position.
    arcs, _ = sky_full_of_satellites
    start = later(view)
    et = arcs.et.unsqueeze(-1) + start.unsqueeze(-1) + PLAN_STEP * torch.arange(SAMPLES - 11)
    r_N = torch.stack([view.samples.table[row, row : row + SAMPLES - 11] for row in range(len(start))])
    expected = (earth_orientation(et) @ r_N.unsqueeze(-1)).squeeze(-1)
    # m; the meridian's angle is rounded to 3e-11 rad, which the ephemeris does once an hour and the ephemeris every time
    torch.testing.assert_close(TensorVisibility().ground_track(view, start, SAMPLES - 11), expected, rtol=0, atol=2e-3)


@pytest.mark.parametrize("visibility", BOTH, ids=["tensors", "kernels"])
def test_samples_after_a_year_are_those_of_their_times(visibility):
    """From 2^25 s on, every second sample's time is no float32 number."""
    count, last = 1_140_000, 200
    et, start = torch.tensor([7.0e8], dtype=torch.float64), torch.tensor([PLAN_STEP * (count - last)], dtype=torch.float64)
    angle = (2.0 * math.pi / 5700.0) * PLAN_STEP * torch.arange(count + 2, dtype=torch.float64)
    r_BN_N = 6.9e6 * torch.stack([torch.cos(angle), 0.8 * torch.sin(angle), 0.6 * torch.sin(angle)], -1).unsqueeze(0)
    ephemeris = ephemeris_records(et, math.ceil(count * PLAN_STEP / 3600.0) + 2)
    begin = torch.full_like(start, -0.5 * PLAN_STEP)  # so that rounding does not lead to the sample before
    orbits = PlannedOrbits(Samples(r_BN_N, begin), Samples(ephemeris, torch.zeros_like(start)))
    whole, end = (visibility.ground_track(orbits, first, n) for first, n in ((torch.zeros_like(start), count), (start, last)))
    torch.testing.assert_close(whole[:, -last:], end, rtol=0, atol=1e-6)
    distance = whole.norm(dim=-1)
    torch.testing.assert_close(distance, r_BN_N[:, :count].norm(dim=-1), rtol=1e-12, atol=0)
    assert bool((whole.diff(dim=1).norm(dim=-1) > 1e4).all())


# -- clearance -----------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("ratio", [1.03, 1.2, 2.0, 6.6, 60.0])
def test_clearance_is_zero_where_the_elevation_is_the_limit(ratio):
    """Places on, above and below the ground, limits of -20 to 89 degrees, and a hair to both sides of these."""
    limit = torch.deg2rad(torch.linspace(-20.0, 89.0, 110, dtype=torch.float64)).repeat(3)
    radius = numbers(R_EARTH - 1e4, R_EARTH, R_EARTH + 9e3).repeat_interleave(110)
    zero = torch.zeros_like(radius)
    for apart in (-1e-6, 0.0, 1e-6):
        elevation = limit + apart
        angle = torch.acos(radius / (ratio * R_EARTH) * torch.cos(elevation)) - elevation
        site, r_P = Vec3(zero, zero, radius), Vec3(torch.sin(angle), zero, torch.cos(angle)) * (ratio * R_EARTH)
        torch.testing.assert_close(sine_of_elevation(r_P.stack(), site.stack()), torch.sin(elevation), rtol=0, atol=1e-13)
        found = elevation_clearance(r_P, site, torch.sin(limit))
        assert (found.abs() < 1e-15).all() if apart == 0.0 else (found * apart > 0.0).all()


@pytest.mark.parametrize("elevation", [-5.0, 0.0, 10.0, 45.0, 85.0])
def test_clearance_is_positive_where_the_satellite_is_above_the_limit(elevation, path):
    """At every sample of every orbit."""
    r_P, site = path.table.unsqueeze(2), sites(40)
    least = torch.full((40,), math.sin(math.radians(elevation)), dtype=torch.float64)
    found = elevation_clearance(Vec3.of(r_P), Vec3.of(site), least)
    up = sine_of_elevation(r_P, site) > least
    assert torch.equal(found > 0.0, up)
    assert up.any()


@pytest.mark.compiled
@pytest.mark.parametrize("elevation", [-20.0, 10.0, 89.0])
def test_both_see_the_same_clearance(elevation, path):
    pairs = all_pairs(path, elevation)
    time = torch.linspace(0.0, (SAMPLES - 1) * PLAN_STEP, len(pairs.r_LP_P), dtype=torch.float64)
    tensor, kernel = (sight.clearance(pairs, time) for sight in BOTH)
    torch.testing.assert_close(tensor, kernel, rtol=0, atol=1e-13)


def test_clearance_at_samples_is_that_of_the_samples(path):
    """Interpolation goes through them, also at the ends of the path."""
    pairs = all_pairs(path)
    for k in (0, 1, 5, 77, SAMPLES - 2, SAMPLES - 1):
        r_P = Vec3.of(path.table[pairs.track.owner, k])
        expected = elevation_clearance(r_P, Vec3.of(pairs.r_LP_P), pairs.sin_min_elevation)
        found = TensorVisibility().clearance(pairs, torch.full_like(pairs.sin_min_elevation, PLAN_STEP * k))
        torch.testing.assert_close(found, expected, rtol=0, atol=1e-13)


def test_three_clearances_tell_how_high_a_pass_rises(view, path):
    """Tops of parabolas are as good as :data:`CULMINATION_TOLERANCE`, and a hundred times better for low circular orbits."""
    for rows, most in ((range(len(ORBITS)), CULMINATION_TOLERANCE), (CIRCULAR, 0.01 * CULMINATION_TOLERANCE)):
        pairs, a, top = culminations(path, [-10.0, 10.0, 45.0, 80.0], rows)
        before, here, after = (TensorVisibility().clearance(pairs, a + k * PLAN_STEP) for k in range(3))
        bend, slope = 2.0 * here - before - after, after - before
        assert len(a) > 40
        assert (here + slope * slope / (8.0 * bend) - top).abs().amax() < most


# -- what happens between samples ----------------------------------------------------------------------------------------------

MIDST, FIRST, LAST = (False, False), (True, False), (False, True)
NONE = ""


@pytest.mark.parametrize(
    ("clearances", "where", "expected"),
    [
        ((-0.3, -0.2, -0.1), MIDST, NONE),
        ((-0.2, -0.1, 0.1), MIDST, "rises"),
        ((math.nan, -0.1, 0.1), MIDST, "rises"),
        ((math.nan, math.nan, 0.1), FIRST, NONE),  # the first sample: nothing is known of what was before
        ((math.nan, math.nan, -0.001), FIRST, NONE),
        ((math.nan, -0.001, -0.1), FIRST, NONE),
        ((0.2, 0.1, -0.1), MIDST, "sets"),
        ((0.1, 0.0, 0.1), MIDST, "rises"),  # zero is not above the limit
        ((0.1, 0.1, 0.0), MIDST, "sets"),
        ((0.1, 0.2, 0.1), MIDST, NONE),
        ((-0.1, 0.1, -0.1), MIDST, "sets"),  # a sample that sees it: no glimpse
        ((-0.1, -0.00009, -0.1), MIDST, "glimpsed"),  # a top near the middle, below the limit by less than the tolerance
        ((-0.1, -0.00011, -0.1), MIDST, NONE),  # by more
        ((-0.004, -0.0003, -0.001), MIDST, "glimpsed"),  # a top between the middle and the last, 0.00026 above the former
        ((-0.001, -0.0003, -0.004), MIDST, "glimpsed"),
        ((-0.00005, -0.00005, -0.00005), MIDST, "glimpsed"),  # as good as at rest
        ((-0.0001, -0.001, -0.0045), MIDST, NONE),  # it belongs to the triple before
        ((-0.0001, -0.001, -0.0045), FIRST, "glimpsed"),  # which does not exist here: a top between the first two
        ((-0.0001, -0.001, -0.0045), LAST, NONE),
        ((-0.0045, -0.001, -0.0001), MIDST, NONE),  # it belongs to the triple after
        ((-0.0045, -0.001, -0.0001), LAST, "glimpsed"),
        ((-0.0045, -0.001, -0.0001), FIRST, NONE),
        ((-0.01, -0.1, -0.2), FIRST, NONE),  # a top before the search
        ((-0.2, -0.1, -0.01), LAST, NONE),  # one after it
        ((-0.01, -0.05, -0.11), FIRST, NONE),  # as well: two and a half steps before the middle
        ((-0.5, -0.6, -1.2), FIRST, NONE),  # between the first two, but far below
        ((0.1, -0.001, -0.2), FIRST, NONE),  # it has set
    ],
)
def test_rising_and_setting_follow_from_three_clearances(clearances, where, expected):
    found = classify(*numbers(*clearances), *(torch.tensor(x) for x in where))
    assert [name for name, x in zip(("rises", "sets", "glimpsed"), found, strict=True) if x] == expected.split()


def test_many_parabolas_are_glimpsed():
    """Wherever their top is between the samples of a search of five, one triple tells, if no sample is above the limit."""
    vertex = torch.linspace(0.0, 4.0, 401, dtype=torch.float64)
    height = 1e-3 * torch.rand_like(vertex)
    k = torch.arange(5, dtype=torch.float64)
    samples = height.unsqueeze(-1) - 0.01 * (k - vertex.unsqueeze(-1)) ** 2
    hidden = (samples <= 0.0).all(-1)
    found = torch.zeros_like(hidden)
    for last in (2, 3, 4):
        here = samples[:, last - 2 : last + 1].unbind(-1)
        found |= classify(*here, torch.tensor(last == 2), torch.tensor(last == 4))[2]
    assert torch.equal(found, hidden)
    assert hidden.sum() > 100


def test_codes_of_a_cell():
    """Of samples behind the end of a cell only a glimpse around its last one is told; at the ends of a search, who is up."""
    up, down = numbers(1.0), numbers(-1.0)

    def told(before: torch.Tensor, here: torch.Tensor, after: torch.Tensor, time: float) -> int:
        cells = SearchCells(*numbers(240.0, 480.0, 240.0, 900.0).unsqueeze(-1))
        return int(event_code(before, here, after, numbers(time), cells))

    nan, top = numbers(math.nan), numbers(-1e-5)
    assert (told(nan, nan, up, 240.0), told(nan, nan, down, 240.0)) == (ABOVE_LIMIT, 0)
    assert (told(nan, down, up, 270.0), told(up, up, down, 480.0)) == (RISE, SET)
    assert told(up, up, up, 480.0) == 0  # in the midst of the search
    assert told(down, down, up, 510.0) == told(up, up, down, 510.0) == 0  # in the next cell
    assert told(down, top, down, 510.0) == SHORT_PASS
    assert told(nan, nan, nan, 240.0) == 0  # no such place

    def at_the_end(before: torch.Tensor, here: torch.Tensor, after: torch.Tensor, time: float) -> int:
        cells = SearchCells(*numbers(720.0, 900.0, 240.0, 900.0).unsqueeze(-1))
        return int(event_code(before, here, after, numbers(time), cells))

    assert at_the_end(down, down, up, 900.0) == RISE + ABOVE_LIMIT
    assert (at_the_end(up, up, up, 900.0), at_the_end(down, top, down, 900.0)) == (ABOVE_LIMIT, SHORT_PASS)
    assert at_the_end(down, top, down, 930.0) == at_the_end(down, down, up, 930.0) == 0  # behind the end


def cells_of(path: Samples, pairs: PlacePairs, samples: int) -> tuple[PlacePairs, SearchCells]:
    """All cells of a search of so many samples of every pair, [pairs * cells]."""
    count, begin = math.ceil((samples - 1) / SAMPLES_PER_CELL), pairs.track.start[pairs.track.owner]
    every = torch.arange(len(begin)).repeat_interleave(count)
    first = begin[every] + PLAN_STEP * SAMPLES_PER_CELL * torch.arange(count).repeat(len(begin))
    end = begin[every] + PLAN_STEP * (samples - 1)
    return pairs.take(every), SearchCells(first, torch.minimum(first + PLAN_STEP * SAMPLES_PER_CELL, end), begin[every], end)


@pytest.mark.compiled
@pytest.mark.parametrize("samples", [SAMPLES, SAMPLES - 1, SAMPLES - 7, 10])
def test_both_see_the_same_happenings(samples, path, view):
    shifted = path._replace(start=later(view))
    pairs, cells = cells_of(shifted, all_pairs(shifted, 5.0), samples)
    tensor, kernel = (sight.events(pairs, cells) for sight in BOTH)
    assert tensor.shape == (len(cells.first), CLASSIFIED_SAMPLES)
    assert torch.equal(tensor, kernel)


def test_happenings_by_definition(path):
    """Every change of what is above the limit is told once, at the sample after it, and the ends of the search are."""
    samples, pairs = SAMPLES - 3, all_pairs(path, 5.0)
    many, cells = cells_of(path, pairs, samples)
    found = TensorVisibility().events(many, cells).long().view(len(pairs.r_LP_P), -1, CLASSIFIED_SAMPLES)
    told = torch.zeros(3, len(pairs.r_LP_P), samples + CLASSIFIED_SAMPLES, dtype=torch.long)
    for cell in range(found.shape[1]):
        for bit, which in enumerate((RISE, SET, ABOVE_LIMIT)):
            first = SAMPLES_PER_CELL * cell
            told[bit, :, first : first + CLASSIFIED_SAMPLES] += (found[:, cell] & which) // which
    up = (sines_of_elevation(path.table[:, :samples], sites().expand(len(path.start), -1, -1)) > math.sin(math.radians(5.0))).mT
    up = up.flatten(0, 1)
    change = torch.diff(up.long(), prepend=up[:, :1].long())
    assert torch.equal(told[0, :, :samples], (change == 1).long())
    assert torch.equal(told[1, :, :samples], (change == -1).long())
    assert torch.equal(told[2, :, 0], up[:, 0].long())
    assert torch.equal(told[2, :, samples - 1], up[:, -1].long())
    assert not told[2, :, 1 : samples - 1].any()
    assert not told[:, :, samples:].any()
    assert (change != 0).sum() > 80


# -- crossings and peaks -------------------------------------------------------------------------------------------------------


def crossings_of(path: Samples, elevation: float) -> tuple[PlacePairs, Brackets]:
    """Brackets around all crossings."""
    pairs = all_pairs(path, elevation)
    found = elevation_clearance(
        Vec3.of(path.table[pairs.track.owner]), Vec3.of(pairs.r_LP_P.unsqueeze(1)), pairs.sin_min_elevation.unsqueeze(1)
    )
    pair, k = torch.nonzero((found[:, 1:] > 0.0) != (found[:, :-1] > 0.0), as_tuple=True)
    a = PLAN_STEP * k.double()
    return pairs.take(pair), Brackets(a, a + PLAN_STEP, found[pair, k], found[pair, k + 1])


@pytest.mark.compiled
@pytest.mark.parametrize("elevation", [-10.0, 5.0, 60.0])
def test_both_find_the_same_crossings(elevation, path):
    pairs, brackets = crossings_of(path, elevation)
    assert len(brackets.a) > 10
    tensor, kernel = (sight.crossings(pairs, brackets) for sight in BOTH)
    torch.testing.assert_close(tensor, kernel, rtol=0, atol=1e-7)  # s; measured 2e-8
    assert ((tensor >= brackets.a) & (tensor <= brackets.b)).all()
    for sight in BOTH:
        assert sight.clearance(pairs, tensor).abs().amax() < 1e-11  # which moves by 1e-4 per second


def culminations(
    path: Samples, elevations: list[float], rows: range | list[int]
) -> tuple[PlacePairs, torch.Tensor, torch.Tensor]:
    """Passes with a top between the first and the last of three samples, the middle one highest: pairs, first time, clearance."""
    parts = []
    for elevation in elevations:
        pairs = all_pairs(path, elevation, 40)
        pairs = pairs.take(torch.nonzero(torch.isin(pairs.track.owner, torch.tensor(list(rows)))).squeeze(-1))
        site, least = Vec3.of(pairs.r_LP_P.unsqueeze(1)), pairs.sin_min_elevation.unsqueeze(1)
        found = elevation_clearance(Vec3.of(path.table[pairs.track.owner]), site, least)
        inner = found[:, 1:-1]
        high = (inner > found[:, :-2]) & (inner > found[:, 2:]) & (inner > -0.01) & (inner < 0.01)
        pair, k = torch.nonzero(high, as_tuple=True)
        pairs, a = pairs.take(pair), PLAN_STEP * k.double()
        time = a.unsqueeze(-1) + torch.linspace(0.0, 2.0 * PLAN_STEP, 601, dtype=torch.float64)
        fine = TensorVisibility().clearance(pairs.take(torch.arange(len(a)).repeat_interleave(601)), time.flatten()).view(-1, 601)
        parts.append((pairs, a, fine.amax(1)))
    pairs, a, top = zip(*parts, strict=True)
    owner = torch.cat([one.track.owner for one in pairs])
    joined = PlacePairs(path._replace(owner=owner), *(torch.cat([one[k] for one in pairs]) for k in (1, 2)))
    return joined, torch.cat(a), torch.cat(top)


@pytest.mark.compiled
def test_both_find_the_tops_of_passes(path):
    """The section ends 0.4 ms wide; a top is as flat as 1e-6 per square second."""
    pairs, a, top = culminations(path, [0.0, 30.0], range(11))
    assert len(a) > 40
    peaks = [sight.culminations(pairs, a, a + 2.0 * PLAN_STEP) for sight in BOTH]
    torch.testing.assert_close(*peaks, rtol=0, atol=1e-3)
    for peak in peaks:
        assert ((peak >= a) & (peak <= a + 2.0 * PLAN_STEP)).all()
        found = TensorVisibility().clearance(pairs, peak)
        assert (found > top - 1e-13).all()
        assert (found < top + 1e-8).all()  # of points 0.1 s apart
    assert 2.0 * PLAN_STEP * 0.618**CULMINATION_ITERATIONS < 1e-3


@pytest.mark.compiled
def test_glimpses_are_the_same(path):
    """Limits between the top of a pass and its best sample: windows of seconds that no sample sees."""
    pairs, a, _ = culminations(path, [0.0, 30.0], range(11))
    middle, b = a + PLAN_STEP, a + 2.0 * PLAN_STEP
    ground = GroundTrack(path.table, path.start)

    def sine(time: torch.Tensor) -> torch.Tensor:
        return sine_of_elevation(at(ground, pairs.track.owner, time), pairs.r_LP_P)

    peak = TensorVisibility().culminations(pairs, a, b)
    limited = pairs._replace(
        sin_min_elevation=0.3 * sine(peak) + 0.7 * torch.maximum(sine(middle), torch.maximum(sine(a), sine(b)))
    )
    edges = []
    for sight in BOTH:
        peak = sight.culminations(limited, a, b)
        for outer in (a, b):
            ends = (sight.clearance(limited, time) for time in (outer, peak))
            edges.append(sight.crossings(limited, Brackets(outer, peak, *ends)))
    long = edges[1] - edges[0] > 0.1  # bsk_rl drops shorter ones; the ends of those depend on rounding
    assert long.sum() > 40
    for tensor, kernel in zip(edges[:2], edges[2:], strict=True):
        torch.testing.assert_close(tensor[long], kernel[long], rtol=0, atol=1e-6)
        assert (TensorVisibility().clearance(limited, tensor)[long].abs() < 1e-11).all()
    assert (edges[1] - edges[0])[long].amax() < 2.0 * PLAN_STEP


# -- views ---------------------------------------------------------------------------------------------------------------------


def test_views_of_rows(view):
    """Rows may repeat, and be taken of rows that have been taken."""
    rows, time = torch.tensor([3, 0, 3, 10]), numbers(90.0, 210.0, 300.0, 420.0)
    some = view.take(torch.tensor([10, 3, 0])).take(torch.tensor([1, 2, 1, 0]))
    r, _ = sample_planned(some, time, 1)
    expected, _ = sample_planned(view.take(rows), time, 1)
    assert torch.equal(r.stack(), expected.stack())
    for k, row in enumerate(rows.tolist()):
        alone, _ = sample_planned(view.take(torch.tensor([row])), time[k : k + 1], 1)
        assert torch.equal(alone.stack()[0], r.stack()[k])


@pytest.mark.compiled
def test_views_of_rows_are_seen_alike(view):
    """By kernels too, which look rows up themselves."""
    rows = torch.tensor([10, 3, 3, 0])
    start = later(view)
    for sight in BOTH:
        dark, ground = sight.umbra(view, start, 50), sight.ground_track(view, start, 50)
        assert torch.equal(sight.umbra(view.take(rows), start[rows], 50), dark[rows])
        assert torch.equal(sight.ground_track(view.take(rows), start[rows], 50), ground[rows])


@pytest.mark.compiled
def test_pairs_are_seen_one_by_one(path):
    """What is found of a pair does not depend on the others, nor on their number."""
    pairs, brackets = crossings_of(path, 5.0)
    some = torch.tensor([17, 3, 3, 40, 8])
    for sight in BOTH:
        times = sight.crossings(pairs, brackets)
        assert torch.equal(sight.crossings(pairs.take(some), Brackets(*(x[some] for x in brackets))), times[some])
        heights = sight.clearance(pairs, brackets.a)
        assert torch.equal(sight.clearance(pairs.take(some), brackets.a[some]), heights[some])


@pytest.mark.compiled
def test_nothing_to_look_at(view, path):
    nobody, empty = torch.zeros(0, dtype=torch.int64), numbers()
    none, pairs = view.take(nobody), all_pairs(path).take(nobody)
    for sight in BOTH:
        assert sight.umbra(none, empty, 12).shape == (0, 12)
        assert sight.ground_track(none, empty, 12).shape == (0, 12, 3)
        assert sight.events(pairs, SearchCells(empty, empty, empty, empty)).shape == (0, CLASSIFIED_SAMPLES)
        assert sight.clearance(pairs, empty).shape == (0,)
        assert sight.crossings(pairs, Brackets(empty, empty, empty, empty)).shape == (0,)
        assert sight.culminations(pairs, empty, empty).shape == (0,)


def test_back_ends_choose_their_visibility():
    assert isinstance(make_visibility("compiled", CPU), KernelVisibility)
    assert isinstance(make_visibility("eager", CPU), TensorVisibility)
    assert isinstance(make_visibility("compiled", torch.device("cuda")), TensorVisibility)
