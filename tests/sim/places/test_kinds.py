"""Passes over places that move, on the Earth and in orbit, against dense sampling and against places that rest."""

import math
from typing import NamedTuple

import pytest
import torch

from bsk_torch.astro.eclipse import illumination
from bsk_torch.astro.ephemeris import earth_orientation, sun_position
from bsk_torch.astro.mean_orbit import mean_elements, mean_position
from bsk_torch.astro.orbit import Elements, elements_to_rv
from bsk_torch.constants import R_EARTH
from bsk_torch.sim.access.light.light import in_light
from bsk_torch.sim.access.passes.passes import GroundTrack, Passes, PassSearch
from bsk_torch.sim.access.passes.sampled_passes import find_passes
from bsk_torch.sim.access.visibility.tensors import TensorVisibility
from bsk_torch.sim.draw_table import DrawTable
from bsk_torch.sim.orbit.grid import PLAN_STEP
from bsk_torch.sim.places import (
    AboveElevation,
    Clearance,
    ClearOfEarth,
    FixedPlaces,
    GreatCirclePlaces,
    Lit,
    OrbitingPlaces,
    Places,
    PlaceTables,
    Sites,
    SunElevation,
    WithinRange,
)
from bsk_torch.sim.state import StateTable
from bsk_torch.vec3 import Vec3
from tests.sim.orbit.arcs import at, every, fixed_samples, sine_of_elevation

CPU = torch.device("cpu")
SATELLITES, COUNT, SAMPLES = 4, 25, 241
"""Satellites, places of each, and samples of the search: two hours."""

STEP = 1.0
"""Seconds between the samples of the brute force."""

EDGE = 2.0
"""Windows and brute force may differ for so many seconds around an edge that the latter sees, or miss so short ones."""


def uniform(*shape: int, low: float, high: float) -> torch.Tensor:
    return low + (high - low) * torch.rand(*shape, dtype=torch.float64)


def low_orbits(*shape: int) -> Elements:
    u = torch.rand(5, *shape, dtype=torch.float64)
    perigee, e = R_EARTH + 3e5 + 9e5 * u[0], 0.02 * u[1]
    return Elements(perigee / (1.0 - e), e, math.pi * u[2], 6.28 * u[3], 6.28 * u[4], uniform(*shape, low=0.0, high=6.28))


class World(NamedTuple):
    """Satellites over tables of draws."""

    track: GroundTrack
    tables: PlaceTables
    et: torch.Tensor


@pytest.fixture(scope="module")
def world() -> World:
    torch.manual_seed(7)
    et = uniform(SATELLITES, low=5e8, high=6e8)
    samples = fixed_samples(low_orbits(SATELLITES), et, 3, "eager")[:, :SAMPLES]
    track = GroundTrack(samples, torch.zeros(SATELLITES, dtype=torch.float64))
    start = R_EARTH * torch.nn.functional.normalize(torch.randn(SATELLITES, COUNT, 3, dtype=torch.float64), dim=-1)
    below = samples[:, torch.linspace(0, SAMPLES - 1, COUNT // 2).long()]
    start[:, : COUNT // 2] = R_EARTH * torch.nn.functional.normalize(below, dim=-1)
    r, v = elements_to_rv(low_orbits(SATELLITES, COUNT))
    drawn = {
        "start": start,
        "fast": 300.0 * torch.randn(SATELLITES, COUNT, 3, dtype=torch.float64),
        "rest": torch.zeros(SATELLITES, COUNT, 3, dtype=torch.float64),
        "debris": mean_elements(r.stack(), v.stack()),
        "exists": (torch.rand(SATELLITES, COUNT) < 0.8).double(),
    }
    tables = [table(SATELLITES, 1, CPU) for table in (DrawTable, StateTable)]
    for name, value in drawn.items():
        tables[0].declare(name, None, *value.shape[1:])
        tables[0][name] = value
    tables[1].declare("utc_init", None)
    tables[1]["utc_init"] = et
    return World(track, PlaceTables(tables[0], tables[1], {}), et)


def listed(passes: Passes) -> dict[tuple[int, int], list[tuple[float, float]]]:
    """Windows by satellite and place, in the order of time."""
    found: dict[tuple[int, int], list[tuple[float, float]]] = {}
    for row, place, opens, closes in sorted(zip(*(part.tolist() for part in passes), strict=True)):
        found.setdefault((row, place), []).append((opens, closes))
    return found


def seen(passes: Passes, time: torch.Tensor) -> torch.Tensor:
    """Whether each place is in a window at each time, [satellites, times, places]."""
    flags = torch.zeros(SATELLITES, len(time), COUNT, dtype=torch.bool)
    for (row, place), windows in listed(passes).items():
        for opens, closes in windows:
            flags[row, (time >= opens) & (time <= closes), place] = True
    return flags


def check(passes: Passes, expected: torch.Tensor) -> None:
    """Compare windows with what dense samples [satellites, times, places] say, but for samples next to an edge."""
    time = STEP * torch.arange(expected.shape[1], dtype=torch.float64)
    wide = torch.nn.functional.max_pool1d
    width = 2 * round(EDGE / STEP) + 1
    flat = expected.double().movedim(1, 2).flatten(0, 1)
    clearly_in = -wide(-flat, width, 1, width // 2) > 0.5
    clearly_out = wide(flat, width, 1, width // 2) < 0.5
    found = seen(passes, time).movedim(1, 2).flatten(0, 1)
    assert not (clearly_in & ~found).any()
    assert not (clearly_out & found).any()
    assert clearly_in.any()
    assert clearly_out.any()


def rotated(start: torch.Tensor, velocity: torch.Tensor, time: torch.Tensor) -> torch.Tensor:
    """Rodrigues' rotation of positions [..., 1, 3] about the axis of their motion."""
    axis = torch.linalg.cross(start, velocity)
    rate = axis.norm(dim=-1, keepdim=True) / (start * start).sum(-1, keepdim=True)
    axis = torch.nn.functional.normalize(axis, dim=-1)
    angle = rate * time.unsqueeze(-1)
    across = torch.linalg.cross(axis.expand(*angle.shape[:-1], 3), start.expand(*angle.shape[:-1], 3))
    return start * torch.cos(angle) + across * torch.sin(angle)


def test_places_that_stand_still_are_seen_as_fixed_ones(world):
    limit = 0.17
    still = GreatCirclePlaces(world.tables, "start", "rest", [AboveElevation(limit)])
    found = listed(find_passes(still, torch.arange(SATELLITES), world.track))
    sites = Sites(world.tables.drawn["start"], torch.full((SATELLITES, COUNT), limit, dtype=torch.float64))
    expected = listed(PassSearch(TensorVisibility(), world.track, sites).passes())
    assert found.keys() == expected.keys()
    assert len(found) > 20
    for pair, windows in expected.items():
        assert torch.allclose(torch.tensor(found[pair]), torch.tensor(windows), rtol=0, atol=1e-6)


@pytest.mark.parametrize(
    "light",
    [
        [SunElevation(0.1)],
        [SunElevation(-0.3, below=True)],
        [SunElevation(-0.2), SunElevation(lambda rows: 0.1 * rows, below=True)],
    ],
)
def test_light_clips_passes_as_a_search_of_all_samples_does(world, light):
    """Passes over places at rest are found first, and then clipped; over places in motion, both are sampled together."""
    rows, limit = torch.arange(SATELLITES), 0.17
    still = GreatCirclePlaces(world.tables, "start", "rest", [AboveElevation(limit), *light])
    expected = listed(find_passes(still, rows, world.track))
    start = world.tables.drawn["start"]
    places = FixedPlaces(lambda: start, limit, light=light, tables=world.tables)
    passes = PassSearch(TensorVisibility(), world.track, places.sites(rows)).passes()
    found = listed(in_light(places, rows, passes))
    assert found.keys() == expected.keys()
    assert 5 < len(found) < len(listed(passes))
    for pair, windows in expected.items():
        assert torch.allclose(torch.tensor(found[pair]), torch.tensor(windows), rtol=0, atol=1e-5)


def test_passes_over_ships_and_aircraft_are_those_of_dense_samples(world):
    limit = math.sin(math.radians(12.0))
    moving = GreatCirclePlaces(world.tables, "start", "fast", [AboveElevation(limit)], exists="exists")
    passes = find_passes(moving, torch.arange(SATELLITES), world.track)
    r_P = every(world.track, STEP).unsqueeze(2)
    time = STEP * torch.arange(r_P.shape[1], dtype=torch.float64)
    start, velocity = (world.tables.drawn[name].unsqueeze(1) for name in ("start", "fast"))
    r_L = rotated(start, velocity, time.view(1, -1, 1).expand(SATELLITES, -1, COUNT))
    exists = world.tables.drawn["exists"].unsqueeze(1) > 0.5
    check(passes, (sine_of_elevation(r_P, r_L) > limit) & exists)


def test_motion_matters(world):
    """Aircraft are not seen when places at their starting points are."""
    limit = [AboveElevation(0.2)]
    windows = [
        listed(find_passes(GreatCirclePlaces(world.tables, "start", name, limit), torch.arange(SATELLITES), world.track))
        for name in ("rest", "fast")
    ]
    assert windows[0] != windows[1]


CLEARANCES: dict[str, list[Clearance]] = {
    "range": [WithinRange(3e6)],
    "short range": [WithinRange(4e5)],
    "line of sight": [ClearOfEarth(1e5)],
    "light": [Lit()],
    "all": [WithinRange(4e6), ClearOfEarth(5e4), Lit(0.5)],
}


def by_definition(clearance: Clearance, r_B: torch.Tensor, r_L: torch.Tensor, r_S: torch.Tensor) -> torch.Tensor:
    """Whether a condition holds at positions [..., 3], by another way than the package's."""
    if isinstance(clearance, WithinRange):
        return (r_L - r_B).norm(dim=-1) < clearance.max_range
    if isinstance(clearance, Lit):
        least = max(1e-12, clearance.visible)
        return illumination(Vec3.of(r_L), Vec3.of(r_S.expand_as(r_L))) >= least
    assert isinstance(clearance, ClearOfEarth)
    squash = torch.tensor([1.0, 1.0, 1.0 / 0.98], dtype=torch.float64)
    b, q = r_B * squash, r_L * squash
    lowest = torch.full(r_L.shape[:-1], torch.inf, dtype=torch.float64)
    for part in torch.linspace(0.0, 1.0, 201, dtype=torch.float64):
        lowest = torch.minimum(lowest, (b + (q - b) * part).norm(dim=-1))
    return lowest > R_EARTH + clearance.altitude


@pytest.mark.parametrize("name", CLEARANCES)
@pytest.mark.nightly("line of sight")
def test_windows_of_places_in_orbit_are_those_of_dense_samples(world, name):
    places = OrbitingPlaces(world.tables, "debris", CLEARANCES[name])
    passes = find_passes(places, torch.arange(SATELLITES), world.track)
    r_B = every(world.track, STEP).unsqueeze(2)
    time = STEP * torch.arange(r_B.shape[1], dtype=torch.float64)
    et = world.et.unsqueeze(-1) + time
    r_N = mean_position(world.tables.drawn["debris"].unsqueeze(1), time.view(1, -1, 1)).stack()
    PN = earth_orientation(et).unsqueeze(2)
    r_L = (PN @ r_N.unsqueeze(-1)).squeeze(-1)
    r_S = (PN @ sun_position(et).unsqueeze(2).unsqueeze(-1)).squeeze(-1)
    expected = torch.ones(r_L.shape[:-1], dtype=torch.bool)
    for clearance in CLEARANCES[name]:
        expected &= by_definition(clearance, r_B, r_L, r_S)
    check(passes, expected)


def test_the_edges_of_windows_are_where_a_condition_begins_to_hold(world):
    places = OrbitingPlaces(world.tables, "debris", [WithinRange(2e6)])
    passes = find_passes(places, torch.arange(SATELLITES), world.track)
    inner = (passes.open > 0.0) & (passes.close < PLAN_STEP * (SAMPLES - 1))
    row, place = passes.row[inner], passes.place[inner].unsqueeze(-1)
    own = OrbitingPlaces(world.tables, "debris", [])
    assert len(row) > 10
    for time in (passes.open[inner], passes.close[inner]):
        r_L = own.position(row, place, time.unsqueeze(-1)).squeeze(1)
        samples = world.track.r_BP_P[row]
        r_B = torch.stack([_between(one, t) for one, t in zip(samples, time.tolist(), strict=True)])
        assert ((r_L - r_B).norm(dim=-1) - 2e6).abs().max() < 0.01


def _between(samples: torch.Tensor, time: float) -> torch.Tensor:
    ground = GroundTrack(samples.unsqueeze(0), torch.zeros(1, dtype=torch.float64))
    return at(ground, torch.zeros(1, dtype=torch.long), torch.tensor([time], dtype=torch.float64))[0]


@pytest.mark.parametrize("kind", ["debris", "ships"])
def test_windows_of_a_row_do_not_depend_on_others(world, kind, monkeypatch):
    def places() -> Places:
        if kind == "debris":
            return OrbitingPlaces(world.tables, "debris", CLEARANCES["all"])
        return GreatCirclePlaces(world.tables, "start", "fast", [AboveElevation(0.1)])

    whole = listed(find_passes(places(), torch.arange(SATELLITES), world.track))
    one = GroundTrack(*(part[2:3] for part in world.track))
    alone = listed(find_passes(places(), torch.tensor([2]), one))
    assert {pair[1]: windows for pair, windows in whole.items() if pair[0] == 2} == {k[1]: w for k, w in alone.items()}
    monkeypatch.setattr("bsk_torch.sim.access.passes.sampled_passes.SCREENED", 1)
    assert listed(find_passes(places(), torch.arange(SATELLITES), world.track)) == whole
