"""The coarse screen loses nothing, passes are found row by row, and windows are cut as bsk_rl generates them."""

import math
from itertools import pairwise
from typing import NamedTuple

import pytest
import torch

from bsk_torch.astro.orbit import Elements
from bsk_torch.astro.sight import max_central_angle
from bsk_torch.constants import R_EARTH
from bsk_torch.sim.access.passes import passes as module
from bsk_torch.sim.access.passes.passes import (
    SHORTEST_PASS,
    GroundTrack,
    Passes,
    PassSearch,
    coarse_screen,
    sorted_events,
    sorted_on_tensors,
)
from bsk_torch.sim.access.visibility.geometry import SAMPLES_PER_CELL
from bsk_torch.sim.access.visibility.kernels import KernelVisibility
from bsk_torch.sim.access.visibility.tensors import TensorVisibility
from bsk_torch.sim.access.windows.generation import GenerationIntervals, long_spans, windows_by_interval, windows_of_short_spans
from bsk_torch.sim.orbit.grid import PLAN_STEP
from bsk_torch.sim.places import Sites
from tests.sim.orbit.arcs import at, every, fixed_samples, places_of, sine_of_elevation, sines_of_elevation

SIGHTS = [TensorVisibility, pytest.param(KernelVisibility, marks=pytest.mark.compiled)]


def numbers(*values: float) -> torch.Tensor:
    return torch.tensor(values, dtype=torch.float64)


def uniform(*shape: int, low: float, high: float) -> torch.Tensor:
    return low + (high - low) * torch.rand(*shape, dtype=torch.float64)


def flown_over(perigee: torch.Tensor, e: torch.Tensor, samples: int, inclination: torch.Tensor | None = None) -> GroundTrack:
    """Random orbits with these perigee altitudes, m, and eccentricities; searches begin a minute apart."""
    n = len(perigee)
    i = uniform(n, low=0.0, high=math.pi) if inclination is None else inclination
    omega, f, node = uniform(3, n, low=0.0, high=2.0 * math.pi)
    et, begin = uniform(n, low=-3e8, high=6e8), 2 * torch.arange(n)
    oe = Elements((R_EARTH + perigee) / (1.0 - e), e, i, node, omega, f)
    whole = fixed_samples(oe, et, math.ceil((samples + 2 * n) * PLAN_STEP / 3600.0), "eager")
    index = begin.unsqueeze(-1) + torch.arange(samples)
    return GroundTrack(whole[torch.arange(n).unsqueeze(-1), index], PLAN_STEP * begin.double())


def anywhere(n: int, count: int) -> torch.Tensor:
    """Sites [n, count, 3] at different heights."""
    unit = torch.nn.functional.normalize(torch.randn(n, count, 3, dtype=torch.float64), dim=-1)
    return unit * uniform(n, count, 1, low=R_EARTH - 1e4, high=R_EARTH + 9e3)


def limits(n: int, count: int, low: float = 5.0, high: float = 85.0) -> torch.Tensor:
    return torch.sin(torch.deg2rad(uniform(n, count, low=low, high=high)))


LOW = lambda n: (uniform(n, low=2e5, high=1.5e6), uniform(n, low=0.0, high=0.05))
KINDS = {
    "low": LOW,
    "eccentric": lambda n: (uniform(n, low=2e5, high=1e6), uniform(n, low=0.1, high=0.8)),
    "high": lambda n: (uniform(n, low=1.5e6, high=6e7), uniform(n, low=0.0, high=0.1)),
    "geostationary": lambda n: (torch.full((n,), 42164e3 - R_EARTH, dtype=torch.float64), torch.zeros(n, dtype=torch.float64)),
}


def ground_of(kind: str, n: int, samples: int) -> GroundTrack:
    inclination = uniform(n, low=0.0, high=0.2) if kind == "geostationary" else None
    return flown_over(*KINDS[kind](n), samples, inclination)


def table(ground: GroundTrack, places: Sites) -> torch.Tensor:
    """Which places [n, P] the screen leaves of each cell, [n, C, P]."""
    n, samples = ground.r_BP_P.shape[:2]
    left = torch.zeros(n, math.ceil((samples - 1) / SAMPLES_PER_CELL), places.r_LP_P.shape[1], dtype=torch.long)
    row, place, cell = coarse_screen(ground, places)
    left[row, cell, place] += 1
    assert left.max() <= 1
    return left.bool()


def seen_around_cells(ground: GroundTrack, places: Sites) -> torch.Tensor:
    """Which places see the satellite from a sample before each cell to a sample after, every three seconds, [n, C, P]."""
    parts = round(PLAN_STEP / 3.0)
    r_P = every(ground, 3.0)
    up = sines_of_elevation(r_P, places.r_LP_P.expand(len(r_P), -1, -1)) > places.sin_min_elevation.unsqueeze(1)
    cells = []
    for first in range(0, ground.r_BP_P.shape[1] - 1, SAMPLES_PER_CELL):
        cells.append(up[:, max(0, (first - 1) * parts) : (first + SAMPLES_PER_CELL + 1) * parts + 1].any(1))
    return torch.stack(cells, 1)


@pytest.mark.parametrize("samples", [241, 10, 18])
@pytest.mark.parametrize("kind", KINDS)
def test_the_screen_loses_nothing(kind, samples):
    """Of all that the close look needs: a sample more than the cell on both sides."""
    n, count = 16, 120
    ground = ground_of(kind, n, samples)
    r_P = anywhere(n, count)
    below = torch.arange(40) * samples // 40  # high limits see nothing else
    r_P[:, :40] = torch.nn.functional.normalize(ground.r_BP_P[:, below], dim=-1) * R_EARTH
    deep = r_P * uniform(n, count, 1, low=0.8, high=1.0)  # exaggerated, so that all must be searched for as the lowest one
    same = limits(n, 1).expand(n, count)
    for places in (Sites(r_P, limits(n, count)), Sites(r_P, limits(n, 1, 80.0).expand(n, count)), Sites(deep, same)):
        needed, left = seen_around_cells(ground, places), table(ground, places)
        assert not (needed & ~left).any()
        assert needed.any()
        if kind == "low" and samples > 100:
            assert left.double().mean() < 0.25


def test_missing_places_are_never_left():
    """Nor do they change what is left of others."""
    ground, r_P = ground_of("low", 6, 121), anywhere(6, 30)
    least = limits(6, 30)
    whole = table(ground, Sites(r_P, least))
    missing = torch.rand(6, 30) < 0.4
    missing[2] = True
    padded = Sites(r_P.masked_fill(missing.unsqueeze(-1), math.nan), least)
    left = table(ground, padded)
    assert not left.mT[missing].any()
    needed = seen_around_cells(ground, padded)
    assert not (needed & ~left).any()
    assert (left & ~whole).sum() == 0


@pytest.mark.parametrize("shared", [True, False])
def test_the_screen_does_not_depend_on_how_many_products_are_made_at_once(shared, monkeypatch):
    ground = ground_of("low", 9, 61)
    r_P, least = (anywhere(1, 50), limits(1, 50)) if shared else (anywhere(9, 50), limits(9, 50))
    found = []
    for room in (1, 1000, 3 * 8 * 50, 1 << 20):
        monkeypatch.setattr(module, "SCREEN_PRODUCTS", room)
        found.append(coarse_screen(ground, Sites(r_P, least), kernels=False))
    found.append(coarse_screen(ground, Sites(r_P, least)))
    for other in found[1:]:
        assert all(torch.equal(a, b) for a, b in zip(found[0], other, strict=True))
    assert len(found[0][0]) > 10


def test_events_are_sorted_by_the_kernel_as_on_tensors():
    """Codes of any samples, of pairs in the order of rows and cells."""
    row, cell, place = torch.cartesian_prod(torch.arange(3), torch.arange(4), torch.randperm(7)).unbind(-1)
    codes = torch.tensor([1, 2, 4, 5, 6, 8])[torch.randint(6, (len(row), 18))] * (torch.rand(len(row), 18) < 0.2)
    for last in (16 * 3 + 15, 40):
        kernel, tensors = (list(sort(codes.double(), row, place, cell, last)) for sort in (sorted_events, sorted_on_tensors))
        assert all(len(part[0]) > 10 for part in tensors)
        assert all(torch.equal(a, b) for one, other in zip(kernel, tensors, strict=True) for a, b in zip(one, other, strict=True))


def test_places_that_all_satellites_share():
    """The same as given to each."""
    ground, r_P, least = ground_of("low", 5, 121), anywhere(1, 80), limits(1, 80)
    once = PassSearch(TensorVisibility(), ground, Sites(r_P, least)).passes()
    each = PassSearch(TensorVisibility(), ground, Sites(r_P.expand(5, -1, -1), least.expand(5, -1))).passes()
    assert all(torch.equal(a, b) for a, b in zip(once, each, strict=True))
    assert len(once.row) > 10


@pytest.mark.parametrize("sight", SIGHTS)
def test_nothing_in_sight(sight):
    """Places behind the Earth, and none at all."""
    ground = ground_of("low", 3, 10)
    behind = -torch.nn.functional.normalize(ground.r_BP_P[:, 5:6], dim=-1) * R_EARTH
    for r_P in (behind, torch.full_like(behind, math.nan)):
        search = PassSearch(sight(), ground, Sites(r_P, torch.full((3, 1), 0.1, dtype=torch.float64)))
        passes = search.passes()
        assert all(part.shape == (0,) for part in passes)
        assert all(part.shape == (0,) for part in windows_by_interval(search, passes, segments(ground, 90.0)))


def test_limit_angle():
    """A satellite at the horizon of a place is acos(q) away; one in the zenith is above it."""
    ratio = numbers(0.2, 0.9)
    torch.testing.assert_close(max_central_angle(ratio, numbers(0.0, 0.0)), torch.acos(ratio))
    torch.testing.assert_close(max_central_angle(ratio, numbers(1.0, 1.0)), numbers(0.0, 0.0), rtol=0, atol=1e-15)
    site, least = numbers(0.0, 0.0, 1.0), torch.sin(torch.deg2rad(numbers(-10.0, 10.0, 85.0)))
    angle = max_central_angle(numbers(0.7, 0.7, 0.7), least)
    r_P = torch.stack([torch.sin(angle), torch.zeros(3), torch.cos(angle)], -1) / 0.7
    torch.testing.assert_close(sine_of_elevation(r_P, site), least)


@pytest.mark.parametrize("sight", SIGHTS)
def test_passes_of_a_row_do_not_depend_on_others(sight):
    ground, places = ground_of("low", 6, 181), Sites(anywhere(6, 60), limits(6, 60))
    together = PassSearch(sight(), ground, places).passes()
    for row in range(6):
        alone = PassSearch(
            sight(), GroundTrack(*(x[row : row + 1] for x in ground)), places_of(places).sites(torch.tensor([row]))
        ).passes()
        mine = together.row == row
        assert mine.any()
        for one, other in zip(alone[1:], together[1:], strict=True):
            assert torch.equal(one, other[mine])


def test_passes_do_not_depend_on_where_a_search_ends():
    """One that ends later finds the same, and what was cut goes on."""
    ground, places = ground_of("low", 8, 181), Sites(anywhere(8, 60), limits(8, 60))
    long = listed(PassSearch(TensorVisibility(), ground, places).passes())
    for samples in (180, 97, 50, 11):
        short = GroundTrack(ground.r_BP_P[:, :samples], ground.start)
        found = listed(PassSearch(TensorVisibility(), short, places).passes())
        cut = {
            pair: [(a, min(b, short.end[pair[0]].item())) for a, b in windows if a < short.end[pair[0]]]
            for pair, windows in long.items()
        }
        assert_same(found, {pair: windows for pair, windows in cut.items() if windows}, 1e-6)


Listed = dict[tuple[int, int], list[tuple[float, float]]]
"""Opening and closing times of each row and place."""


def listed(passes: Passes) -> Listed:
    found: Listed = {}
    for row, place, opens, closes in sorted(zip(*(x.tolist() for x in passes), strict=True)):
        found.setdefault((row, place), []).append((opens, closes))
    return found


def assert_same(found: Listed, expected: Listed, tolerance: float) -> None:
    assert found.keys() == expected.keys()
    for pair, windows in expected.items():
        assert len(found[pair]) == len(windows), (pair, found[pair], windows)
        for one, other in zip(sorted(found[pair]), sorted(windows), strict=True):
            assert one == pytest.approx(other, abs=tolerance), (pair, found[pair], windows)


def segments(ground: GroundTrack, segment: float, first: float | None = None) -> GenerationIntervals:
    """As many whole segments as fit, after a first interval of ``first`` s, which is a segment unless given."""
    begin = ground.start
    lead = segment if first is None else first
    end = begin + lead + torch.floor((ground.end - begin - lead) / segment) * segment
    return GenerationIntervals(begin, begin + lead, end, segment)


class Pair(NamedTuple):
    """What bsk_rl knows of a satellite over a place: times and positions of samples, the site, and the sine of its limit."""

    times: list[float]
    r_P: torch.Tensor
    site: torch.Tensor
    least: float
    crossings: list[float]
    """Times at which the place rises or sets."""
    up_at_first: bool

    def up(self, time: float) -> bool:
        """Whether the satellite is above the limit."""
        return self.up_at_first ^ (sum(t < time for t in self.crossings) % 2 == 1)


def candidates(pair: Pair, start: float, end: float) -> list[tuple[float, float]]:
    """Where bsk_rl looks closely within an interval: runs of samples nearer than a threshold, and a sample more on each side."""
    inside = [k for k, t in enumerate(pair.times) if start <= t <= end]
    r_P = pair.r_P[inside]
    threshold = 1.1 * (r_P.norm(dim=-1).amax() - pair.site.norm()) / pair.least
    close = ((r_P - pair.site).norm(dim=-1) < threshold).tolist()
    times, found, run = [pair.times[k] for k in inside], [], []
    for k, is_close in enumerate([*close, False]):
        if is_close:
            run.append(k)
        elif run:
            found.append((times[max(0, run[0] - 1)], times[min(len(times) - 1, run[-1] + 1)]))
            run = []
    return found


def window_of(pair: Pair, near: tuple[float, float], interval: tuple[float, float]) -> tuple[float, float] | None:
    """The window, if any, that bsk_rl makes of the roots between the two ends of a candidate."""
    roots = [t for t in pair.crossings if near[0] < t < near[1]]
    ups = [pair.up(t) for t in near]
    if all(ups):
        return None
    if any(ups):
        assert len(roots) == 1, "several passes in one candidate"
        if near[0] == interval[0]:
            return interval[0], roots[0]
        return (roots[0], interval[1]) if near[1] == interval[1] else None
    assert len(roots) in (0, 2), "several passes in one candidate"
    return (roots[0], roots[1]) if roots and roots[1] - roots[0] > SHORTEST_PASS else None


def as_bsk_rl(pair: Pair, boundaries: list[float]) -> list[tuple[float, float]]:
    """Windows of a pair, interval after interval; one that opens with an interval goes on with what closed there."""
    windows: list[tuple[float, float]] = []
    for interval in pairwise(boundaries):
        for near in candidates(pair, *interval):
            new = window_of(pair, near, interval)
            if new is None:
                continue
            before = [k for k, old in enumerate(windows) if old[1] == new[0] == interval[0]]
            if before:
                windows[before[0]] = windows[before[0]][0], new[1]
            else:
                windows.append(new)
    return windows


def crossings(ground: GroundTrack, places: Sites) -> tuple[dict[tuple[int, int], list[float]], torch.Tensor]:
    """Times of all changes between samples 0.1 s apart, by bisection, and which places see the satellite first."""
    up = sines_of_elevation(every(ground, 0.1), places.r_LP_P) > places.sin_min_elevation.unsqueeze(1)
    row, k, place = torch.nonzero(up[:, 1:] != up[:, :-1], as_tuple=True)
    a = ground.start[row] + 0.1 * k.double()
    b, before = a + 0.1, up[row, k, place]
    for _ in range(40):
        middle = 0.5 * (a + b)
        same = (
            sine_of_elevation(at(ground, row, middle), places.r_LP_P[row, place]) > places.sin_min_elevation[row, place]
        ) == before
        a, b = torch.where(same, middle, a), torch.where(same, b, middle)
    found: dict[tuple[int, int], list[float]] = {}
    for i, j, t in sorted(zip(row.tolist(), place.tolist(), b.tolist(), strict=True)):
        found.setdefault((i, j), []).append(t)
    return found, up[:, 0]


def expected_windows(ground: GroundTrack, places: Sites, intervals: GenerationIntervals) -> Listed:
    """What bsk_rl generates, for all rows and places."""
    changes, first_up = crossings(ground, places)
    found: Listed = {}
    for row in range(len(ground.start)):
        begin, first, end = (x[row].item() for x in intervals[:3])
        boundaries = [begin, *(first + k * intervals.segment for k in range(round((end - first) / intervals.segment) + 1))]
        times = [ground.start[row].item() + PLAN_STEP * k for k in range(ground.r_BP_P.shape[1])]
        for place in range(places.r_LP_P.shape[1]):
            up = bool(first_up[row, place])
            if not up and (row, place) not in changes:
                continue
            least = places.sin_min_elevation[row, place].item()
            pair = Pair(times, ground.r_BP_P[row], places.r_LP_P[row, place], least, changes.get((row, place), []), up)
            if windows := as_bsk_rl(pair, boundaries):
                found[row, place] = windows
    return found


def quirks(expected: Listed, passes: Listed) -> int:
    """How many windows end with a rise."""
    rises = {(pair, round(a, 3)) for pair, windows in passes.items() for a, _ in windows}
    return sum((pair, round(b, 3)) in rises for pair, windows in expected.items() for _, b in windows)


def check_against_bsk_rl(ground: GroundTrack, low: float, high: float, intervals: GenerationIntervals) -> int:
    """Compare windows over 40 places near the track with limits between these, in degrees; how many quirks there are.

    The reference knows the roots of every span. Those of long spans are searched as in bsk_rl instead, which may lose them; see
    tests/basilisk/test_lost_passes.py.
    """
    n, samples = ground.r_BP_P.shape[:2]
    track = ground.r_BP_P[:, torch.randint(samples, (40,))]
    r_P = torch.nn.functional.normalize(track + 8e5 * torch.randn_like(track), dim=-1) * R_EARTH
    places = Sites(r_P, limits(n, 40, low, high))
    search = PassSearch(TensorVisibility(), ground, places)
    passes, expected = search.passes(), expected_windows(ground, places, intervals)
    assert_same(listed(windows_of_short_spans(search, passes, intervals)), expected, 1e-6)
    long, whole = long_spans(search, intervals), listed(windows_by_interval(search, passes, intervals))
    assert_same(*({pair: found for pair, found in some.items() if not long[pair]} for some in (whole, expected)), 1e-6)
    return quirks(expected, listed(passes))


@pytest.mark.parametrize(("segment", "number"), [(60.0, 200), (120.0, 150), (300.0, 50), (600.0, 10), (1800.0, 0)])
@pytest.mark.nightly("120.0-150", "300.0-50", "600.0-10")
def test_windows_are_those_of_bsk_rl(segment, number):
    """Segment after segment, some of them within passes; passes at both ends of the search. Short segments are full of quirks."""
    ground = flown_over(uniform(10, low=3e5, high=1.2e6), uniform(10, low=0.0, high=0.01), 241)
    assert check_against_bsk_rl(ground, 10.0, 60.0, segments(ground, segment)) >= number


@pytest.mark.parametrize(("segment", "first"), [(600.0, 3600.0), (300.0, 5400.0), (600.0, 1200.0)])
@pytest.mark.nightly("600.0-1200.0")
def test_windows_after_a_long_first_interval_are_those_of_bsk_rl(segment, first):
    """As after a reset; there are no quirks in it, as long as the place is not near all the time."""
    ground = flown_over(uniform(10, low=3e5, high=8e5), uniform(10, low=0.0, high=0.01), 241)
    assert check_against_bsk_rl(ground, 10.0, 60.0, segments(ground, segment, first)) > 0


@pytest.mark.parametrize(("segment", "first"), [(300.0, 600.0), (300.0, 900.0), (600.0, 5400.0)])
@pytest.mark.nightly("300.0-600.0", "300.0-900.0")
def test_first_intervals_have_quirks_where_the_place_is_near_all_the_time(segment, first):
    """Higher orbits, or intervals of few segments: bsk_rl does not know how many segments an interval has."""
    ground = flown_over(uniform(10, low=1.5e6, high=2.2e6), uniform(10, low=0.0, high=0.01), 241)
    assert check_against_bsk_rl(ground, 10.0, 15.0, segments(ground, segment, first)) > 0


def test_intervals_of_eccentric_and_high_orbits_are_those_of_bsk_rl():
    """How near is near depends on it, and on eccentric orbits it changes from one interval to the next."""
    ground = flown_over(uniform(10, low=3e5, high=5e5), uniform(10, low=0.05, high=0.1), 400)
    for first in (None, 3600.0):
        assert check_against_bsk_rl(ground, 10.0, 60.0, segments(ground, 600.0, first)) > 0
    # In a segment of an orbit the last pass may set as it begins and the next one rise before it ends.
    ground = flown_over(uniform(10, low=3e5, high=1.2e6), uniform(10, low=0.0, high=0.01), 400)
    check_against_bsk_rl(ground, 10.0, 60.0, segments(ground, 5400.0))


def at_rest(near: bool) -> PassSearch:
    """A search whose satellite is near its only place for an hour, or on the other side of the Earth."""
    r_P = numbers(0.0, 0.0, R_EARTH + 5e5 if near else -R_EARTH - 5e5).expand(1, 121, 3).clone()
    return PassSearch(
        TensorVisibility(),
        GroundTrack(r_P, numbers(0.0)),
        Sites(numbers(0.0, 0.0, R_EARTH).view(1, 1, 3), numbers(0.5).view(1, 1)),
    )


@pytest.mark.parametrize(
    ("near", "one_pass", "windows"),
    [
        (False, (100.0, 200.0), [(100.0, 200.0)]),
        (True, (100.0, 200.0), [(100.0, 200.0)]),
        (False, (100.0, 100.0999), []),  # too short
        (False, (100.0, 100.1001), [(100.0, 100.1001)]),
        (False, (599.98, 600.03), [(599.98, 600.03)]),  # of two intervals, which do not ask for how long
        (False, (0.0, 0.05), [(0.0, 0.05)]),
        (False, (0.0, 500.0), [(0.0, 500.0)]),
        (False, (0.0, 700.0), [(600.0, 700.0)]),  # it fills the first interval
        (False, (0.0, 1300.0), [(1200.0, 1300.0)]),
        (False, (0.0, 3000.0), []),
        (False, (500.0, 700.0), [(500.0, 700.0)]),  # joined
        (False, (500.0, 1300.0), [(500.0, 600.0), (1200.0, 1300.0)]),  # one that it fills lies between
        (False, (500.0, 3000.0), [(500.0, 600.0)]),
        (False, (2900.0, 3000.0), [(2900.0, 3000.0)]),  # cut by the end
        (False, (2900.0, 3500.0), [(2900.0, 3000.0)]),
        (False, (3100.0, 3200.0), []),  # after the last interval
        (True, (500.0, 700.0), [(0.0, 500.0), (600.0, 700.0)]),  # the quirk
        (True, (700.0, 1300.0), [(600.0, 700.0), (1200.0, 1300.0)]),
        (True, (500.0, 1300.0), [(0.0, 500.0), (1200.0, 1300.0)]),
        (True, (2900.0, 3000.0), [(2400.0, 2900.0)]),
        (True, (0.0, 700.0), [(600.0, 700.0)]),
    ],
)
def test_windows_of_one_pass(near, one_pass, windows):
    search, zero = at_rest(near), torch.zeros(1, dtype=torch.long)
    intervals = GenerationIntervals(numbers(0.0), numbers(600.0), numbers(3000.0), 600.0)
    found = windows_by_interval(search, Passes(zero, zero, *(numbers(t) for t in one_pass)), intervals)
    assert sorted(zip(found.open.tolist(), found.close.tolist(), strict=True)) == windows
