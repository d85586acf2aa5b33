"""Random geometries: the batched search finds the passes that a comparison of elevations every 0.1 s finds, and no others."""

import math
from collections import Counter
from collections.abc import Callable
from typing import NamedTuple

import pytest
import torch
from hypothesis import HealthCheck, Phase, given, settings
from hypothesis import strategies as st

from bsk_torch.astro.interpolate import COUNT
from bsk_torch.astro.orbit import Elements
from bsk_torch.astro.sight import max_central_angle
from bsk_torch.constants import R_EARTH
from bsk_torch.sim.access.passes.passes import GroundTrack, PassSearch
from bsk_torch.sim.access.visibility.kernels import make_visibility
from bsk_torch.sim.orbit.grid import PLAN_STEP
from bsk_torch.sim.places import Sites
from tests.sim.orbit.arcs import at, every, fixed_samples, sine_of_elevation, sines_of_elevation

STEP = 0.1
"""Spacing, s, of the samples of brute force; windows that last no longer may be missed."""

SMALL = 1e-6
"""Seconds by which an edge may lie on the wrong side of a sample of brute force."""

EDGE = 1e-9
"""Elevation, rad, by which it may be off the limit at an edge: microseconds, as it moves by some 1e-3 rad/s."""

SPANS = 3
"""Hours of arc, within which searches begin and end."""

ORBITS, PLACES = 12, 16
"""Geometries are the product."""

LOWEST, HIGHEST = math.radians(5.0), math.radians(85.0)

BACKENDS = ["eager", pytest.param("compiled", marks=pytest.mark.compiled)]


class Orbit(NamedTuple):
    """Perigee altitude, m, eccentricity, inclination, argument of perigee and true anomaly, rad, and ET, s."""

    perigee: float
    e: float
    i: float
    omega: float
    f: float
    et: float


ANGLES = st.floats(0.0, 2.0 * math.pi)
EPOCHS = st.floats(-3e8, 6e8)
INCLINATIONS = st.floats(0.0, math.pi)

LOW = st.builds(Orbit, st.floats(2e5, 1.5e6), st.just(0.0) | st.floats(0.0, 0.05), INCLINATIONS, ANGLES, ANGLES, EPOCHS)
ECCENTRIC = st.builds(Orbit, st.floats(2e5, 1e6), st.floats(0.05, 0.75), INCLINATIONS, ANGLES, ANGLES, EPOCHS)
HIGH = st.builds(Orbit, st.floats(1.5e6, 3.7e7), st.floats(0.0, 0.1), INCLINATIONS, ANGLES, ANGLES, EPOCHS)
GEOSTATIONARY = st.builds(Orbit, st.just(42164e3 - R_EARTH), st.just(0.0), st.floats(0.0, 0.1), st.just(0.0), ANGLES, EPOCHS)


class Searches(NamedTuple):
    """Searches of several orbits: each begins so many samples after its epoch and takes as many samples as the others."""

    orbits: list[Orbit]
    begin: list[int]
    samples: int
    seed: int


def searches(orbit: st.SearchStrategy[Orbit]) -> st.SearchStrategy[Searches]:
    """Searches of 4.5 minutes to two hours."""
    rows = dict(min_size=ORBITS, max_size=ORBITS)
    samples = st.integers(COUNT, 60) | st.integers(COUNT, 241)
    return st.builds(Searches, st.lists(orbit, **rows), st.lists(st.integers(0, 60), **rows), samples, st.integers(0, 2**32 - 1))


def ground_of(drawn: Searches, backend: str) -> GroundTrack:
    """What the satellites fly over."""
    perigee, e, i, omega, f, et = torch.tensor(drawn.orbits, dtype=torch.float64).unbind(-1)
    whole = fixed_samples(Elements((R_EARTH + perigee) / (1.0 - e), e, i, 0.0 * e, omega, f), et, SPANS, backend)
    index = torch.tensor(drawn.begin).unsqueeze(-1) + torch.arange(drawn.samples)
    return GroundTrack(
        whole[torch.arange(len(et)).unsqueeze(-1), index], PLAN_STEP * torch.tensor(drawn.begin, dtype=torch.float64)
    )


def length(ground: GroundTrack) -> float:
    return PLAN_STEP * (ground.r_BP_P.shape[1] - 1)


class Random:
    """Numbers [n, PLACES] of a seed."""

    def __init__(self, n: int, seed: int) -> None:
        self.n, self.generator = n, torch.Generator().manual_seed(seed)

    def __call__(self, low: float, high: float) -> torch.Tensor:
        return low + (high - low) * torch.rand(self.n, PLACES, dtype=torch.float64, generator=self.generator)


def beside(ground: GroundTrack, time: torch.Tensor, random: Random, across: bool) -> tuple[torch.Tensor, torch.Tensor]:
    """Sites [n, PLACES, 3] some way from where the satellites are at times [n, PLACES], and limits, rad.

    Up to 1.2 times as far as the limit allows; ``across``: at right angles to the ground track, so that a pass culminates then.
    """
    rows, limit = torch.arange(len(time)).repeat_interleave(PLACES), random(LOWEST, HIGHEST)
    r, ahead = (at(ground, rows, t.flatten()).view(*time.shape, 3) for t in (time, time + 1e-2))
    radius = random(R_EARTH - 500.0, R_EARTH + 9000.0)
    up = r / r.norm(dim=-1, keepdim=True)
    along = torch.nn.functional.normalize(ahead - r - ((ahead - r) * up).sum(-1, keepdim=True) * up, dim=-1)
    azimuth = random(0.0, 2.0 * math.pi)
    azimuth = ((azimuth > math.pi) * math.pi if across else azimuth).unsqueeze(-1)
    away = torch.cos(azimuth) * torch.linalg.cross(up, along) + torch.sin(azimuth) * along
    far = (random(0.0, 1.2) * max_central_angle(radius / r.norm(dim=-1), torch.sin(limit))).unsqueeze(-1)
    return radius.unsqueeze(-1) * (torch.cos(far) * up + torch.sin(far) * away), limit


def some_time(ground: GroundTrack, random: Random, low: float, high: float) -> torch.Tensor:
    return ground.start.unsqueeze(-1) + random(low, high)


def near_the_track(ground: GroundTrack, seed: int) -> Sites:
    """Places near points that the satellites fly over during the search; a few are missing."""
    random = Random(len(ground.start), seed)
    r_P, limit = beside(ground, some_time(ground, random, 0.0, length(ground)), random, across=False)
    r_P[random(0.0, 1.0) < 0.05] = torch.nan
    return Sites(r_P, torch.sin(limit))


def tops(ground: GroundTrack, r_P: torch.Tensor) -> torch.Tensor:
    """Highest elevations [n, P], rad: of a parabola through the highest three of brute force's samples."""
    elevation = torch.asin(sines_of_elevation(every(ground, STEP), r_P))
    k = elevation.argmax(1, keepdim=True).clamp(1, elevation.shape[1] - 2)
    before, here, after = (elevation.gather(1, k + j).squeeze(1) for j in (-1, 0, 1))
    bend, slope = 2.0 * here - before - after, after - before
    inside = (here > before) & (here > after)
    return torch.where(inside, here + slope * slope / (8.0 * bend), torch.maximum(before, after))


def grazing(ground: GroundTrack, seed: int, low: float, high: float) -> Sites:
    """Places whose limits lie 1e-6 to 1e-2 rad below the top of a pass that culminates ``low`` to ``high`` s after the start."""
    random = Random(len(ground.start), seed)
    r_P, _ = beside(ground, some_time(ground, random, low, high), random, across=True)
    return Sites(r_P, torch.sin((tops(ground, r_P) - 10.0 ** random(-6.0, -2.0)).clamp(LOWEST, HIGHEST)))


def close_calls(ground: GroundTrack, seed: int) -> Sites:
    """Places whose limits lie 1e-10 to 1e-4 rad below or above the elevation at a sample, mostly near the top of a pass."""
    random = Random(len(ground.start), seed)
    time = PLAN_STEP * (some_time(ground, random, 0.0, length(ground)) / PLAN_STEP).round()
    r_P, _ = beside(ground, time + random(-2.0, 2.0), random, across=True)
    rows = torch.arange(len(time)).repeat_interleave(PLACES)
    elevation = torch.asin(sine_of_elevation(at(ground, rows, time.flatten()).view(r_P.shape), r_P))
    apart = 10.0 ** random(-10.0, -4.0) * (random(-1.0, 3.0) > 0.0).double().mul(2.0).sub(1.0)
    return Sites(r_P, torch.sin((elevation - apart).clamp(LOWEST, HIGHEST)))


class Window(NamedTuple):
    """A window of brute force: first and last sample at which the satellite is up; one found: opening and closing time."""

    first: float
    last: float


Listed = dict[tuple[int, int], list[Window]]
"""Windows of each row and place."""


def brute(ground: GroundTrack, places: Sites) -> Listed:
    """Windows where the elevation is above the limit, every :data:`STEP`."""
    up = (sines_of_elevation(every(ground, STEP), places.r_LP_P) > places.sin_min_elevation.unsqueeze(1)).transpose(1, 2)
    change = torch.diff(torch.nn.functional.pad(up.to(torch.int8), (1, 1)))
    row, place, first = torch.nonzero(change == 1, as_tuple=True)
    last = torch.nonzero(change == -1)[:, 2] - 1
    found: Listed = {}
    times = (ground.start[row] + k.double() / round(1.0 / STEP) for k in (first, last))
    for i, j, a, b in zip(*(x.tolist() for x in (row, place, *times)), strict=True):
        found.setdefault((i, j), []).append(Window(a, b))
    return found


def searched(ground: GroundTrack, places: Sites, backend: str) -> Listed:
    """Windows of the batched search without those that fall between two samples of brute force; edges are crossings."""
    passes = PassSearch(make_visibility(backend, torch.device("cpu")), ground, places).passes()
    for inner, time in (
        (passes.open > ground.start[passes.row], passes.open),
        (passes.close < ground.end[passes.row], passes.close),
    ):
        row, place = passes.row[inner], passes.place[inner]
        elevation = torch.asin(sine_of_elevation(at(ground, row, time[inner]), places.r_LP_P[row, place]))
        off = (elevation - torch.asin(places.sin_min_elevation[row, place])).abs().tolist()
        worst = max(off, default=0.0)
        assert worst < EDGE, f"{sum(x >= EDGE for x in off)} of {len(off)} edges are off their limits, by up to {worst:.1e} rad"
    found: Listed = {}
    for row, place, opens, closes in sorted(zip(*(x.tolist() for x in passes), strict=True)):
        start = ground.start[row].item()
        if closes - opens > STEP or math.ceil((opens - start) / STEP) <= math.floor((closes - start) / STEP):
            found.setdefault((row, place), []).append(Window(opens, closes))
    return found


def agree(expected: Window, found: Window) -> bool:
    return -SMALL < expected.first - found.first < STEP + SMALL and -SMALL < found.last - expected.last < STEP + SMALL


def compare(drawn: Searches, ground: GroundTrack, places: Sites, backend: str, counted: Counter[str]) -> None:
    """Fail unless brute force and search agree in number and times; count what windows there are."""
    expected, found = brute(ground, places), searched(ground, places, backend)
    for row, place in expected.keys() | found.keys():
        begin, end = ground.start[row].item(), ground.end[row].item()
        mine, theirs = found.get((row, place), []), expected.get((row, place), [])
        if len(mine) < len(theirs):  # those that only one sample sees, in the midst of the search, may have been too short
            theirs = [w for w in theirs if w.first < w.last or not begin < w.first < end or any(agree(w, x) for x in mine)]
        same = len(mine) == len(theirs) and all(agree(w, x) for w, x in zip(theirs, mine, strict=True))
        assert same, (
            f"found {mine} instead of {theirs} in [{begin}, {end}] for {drawn.orbits[row]} over"
            f" {places.r_LP_P[row, place].tolist()} with asin({places.sin_min_elevation[row, place].item()!r}) as limit"
        )
        for w in theirs:
            counted["windows"] += 1
            counted["open at the start"] += w.first == begin
            counted["cut by the end"] += w.last == end
            counted["between two samples"] += w.first // PLAN_STEP == w.last // PLAN_STEP and begin < w.first and w.last < end
            counted["in the first half minute"] += begin < w.first and w.last < begin + PLAN_STEP
            counted["in the last half minute"] += end - PLAN_STEP < w.first and w.last < end
    counted["geometries"] += places.sin_min_elevation.numel()
    counted["without a window"] += places.sin_min_elevation.numel() - len(expected)


def compared(
    orbit: st.SearchStrategy[Orbit], examples: int, backend: str, places: Callable[[GroundTrack, int], Sites]
) -> Counter[str]:
    """Compare examples, a third of them where the search is slow, and count."""
    counted: Counter[str] = Counter()

    @settings(
        max_examples=examples if backend == "compiled" else examples // 3,
        derandomize=True,  # the same examples for the same code
        database=None,
        deadline=None,
        phases=[Phase.generate],  # a message names one geometry; shrinking would take minutes
        suppress_health_check=[HealthCheck.too_slow, HealthCheck.data_too_large],
    )
    @given(searches(orbit))
    def run(drawn: Searches) -> None:
        ground = ground_of(drawn, backend)
        compare(drawn, ground, places(ground, drawn.seed), backend, counted)

    run()
    return counted


@pytest.mark.parametrize("backend", BACKENDS)
@pytest.mark.parametrize(
    ("orbit", "examples"),
    [(LOW, 9), (ECCENTRIC, 6), (HIGH, 6), (GEOSTATIONARY, 3)],
    ids=["low", "eccentric", "high", "geostationary"],
)
@pytest.mark.nightly("eager")
def test_passes_are_those_of_brute_force(orbit, examples, backend):
    counted = compared(orbit, examples, backend, near_the_track)
    for kind in ("open at the start", "cut by the end", "without a window"):
        assert counted[kind] > 0.05 * counted["geometries"]


WHEN = {
    "anywhere": lambda ground: (0.0, length(ground)),
    "early": lambda ground: (0.0, PLAN_STEP),
    "late": lambda ground: (length(ground) - PLAN_STEP, length(ground)),
}


@pytest.mark.parametrize("backend", BACKENDS)
@pytest.mark.parametrize("when", WHEN)
@pytest.mark.nightly("eager")
def test_grazing_passes_are_those_of_brute_force(when, backend):
    counted = compared(LOW | ECCENTRIC, 6, backend, lambda ground, seed: grazing(ground, seed, *WHEN[when](ground)))
    kind = {"anywhere": "between two samples", "early": "in the first half minute", "late": "in the last half minute"}[when]
    assert counted[kind] > 0.2 * counted["geometries"]


@pytest.mark.parametrize("backend", BACKENDS)
@pytest.mark.nightly("eager")
def test_close_calls_are_those_of_brute_force(backend):
    counted = compared(LOW | ECCENTRIC, 6, backend, close_calls)
    assert counted["windows"] > 0.3 * counted["geometries"]
