from __future__ import annotations

import math

import pytest
import torch

from bsk_torch.astro.ephemeris import earth_orientation
from bsk_torch.astro.frames import lla_to_fixed
from bsk_torch.constants import R_EARTH
from bsk_torch.sim import access as module
from bsk_torch.sim.access import AHEAD, Access, Windows
from bsk_torch.sim.orbit import spans_for
from bsk_torch.sim.search import Places
from bsk_torch.sim.sight import make_sight
from bsk_torch.sim.span import SPAN
from bsk_torch.sim.world import DEFAULT_STATIONS, station_arrays
from tests.sim.arcs import Solved, orbits, planned

MILLISECOND = 1e-3  # s; measured: 0.08 ms over windows generated at reset, 0.21 ms over look-ahead
SEGMENT = 600.0
GENERATED = 28_800.0
KIND = "station"


def number(x: float) -> torch.Tensor:
    return torch.tensor([x], dtype=torch.float64)


def stations() -> Places:
    arrays = station_arrays(
        {
            "groundStationsData": DEFAULT_STATIONS,
            "groundLocationPlanetRadius": number(R_EARTH),
            "gsMinimumElevation": number(math.radians(10.0)),
            "gsMaximumRange": number(-1.0),
        }
    )
    return Places(arrays["station_positions"].view(1, 3, -1).mT.contiguous(), arrays["station_sin_elevations"])


def table(flight: Solved, duration: float, places: Places | None = None, segment: float = SEGMENT) -> Access:
    sites = places or stations()
    access = Access(flight.arcs, make_sight(flight.backend, torch.device("cpu")), {KIND: lambda rows: sites}, segment)
    rows = torch.arange(len(flight.arcs.start))
    access.reset(rows, flight.view, torch.full((len(rows),), duration, dtype=torch.float64))
    return access


def listed(access: Access, row: int) -> list[tuple[int, float, float]]:
    """Windows of a row that a query sees: place, opening and closing time."""
    windows, until = access.windows[KIND], access.until[row]
    known = torch.isfinite(windows.close[row]) & (windows.open[row] < until)
    close = torch.minimum(windows.close[row], until)
    return list(zip(*(x[known].tolist() for x in (windows.place[row], windows.open[row], close)), strict=True))


def look_ahead(access: Access, time: torch.Tensor, count: int = 1) -> Windows:
    """Extend where windows run out, as the simulator does."""
    rows = torch.nonzero(access.next(KIND, time, count)[1] < count).squeeze(-1)
    while len(rows := access.reveal(KIND, rows, time[rows], torch.full_like(rows, count))):
        while bool((access.ready + access.ahead * access.segment > access.arcs.end)[rows].any()):
            access.arcs.grow()
        access.extend(rows, time)
    return access.next(KIND, time, count)[0]


@pytest.fixture(scope="module")
def five_orbits(recording, fly) -> Solved:
    return fly(recording("windows")["ic"], spans_for(GENERATED))


@pytest.fixture
def ahead(recording, fly) -> Solved:
    """As the simulator has them when windows run out: arcs that still have to grow."""
    return fly(recording("windows")["ic"], spans_for(GENERATED))


def test_windows_of_basilisk(recording, five_orbits):
    """Same number, order and stations; times within a millisecond."""
    recorded, access = recording("windows"), table(five_orbits, GENERATED)
    worst = 0.0
    for row in range(5):
        mine = recorded["window_orbit"] == row
        expected = list(zip(*(recorded[f"window_{key}"][mine].tolist() for key in ("station", "open", "close")), strict=True))
        found = listed(access, row)
        assert [w[0] for w in found] == [w[0] for w in expected]
        worst = max(
            [worst, *(abs(a - b) for w, x in zip(found, expected, strict=True) for a, b in zip(w[1:], x[1:], strict=True))]
        )
    assert worst < MILLISECOND
    assert access.until.tolist() == [GENERATED] * 5


def test_look_ahead_of_basilisk(recording, ahead):
    """The next window every minute from 28 020 s on, where segments of ten minutes are added as needed.

    Orbit 3 has bsk_rl's quirk: a pass that rises in a segment and is still up at its end is taken for one that sets.
    """
    recorded, access = recording("windows"), table(ahead, GENERATED)
    worst = 0.0
    for k, time in enumerate(recorded["ahead_time"]):
        found = look_ahead(access, torch.full((5,), time, dtype=torch.float64))
        for mine, name in ((found.open, "ahead_open"), (found.close, "ahead_close")):
            worst = max(worst, (mine[:, 0] - torch.tensor(recorded[name][:, k])).abs().amax().item())
    assert worst < MILLISECOND
    asked = (recorded["ahead_open"][3] == 35_400.0) & (abs(recorded["ahead_close"][3] - 35_591.7) < 0.05)
    assert asked.any()  # so the quirk is among what has just been compared


def elevations(flight: Solved, row: int, site: torch.Tensor, time: torch.Tensor) -> torch.Tensor:
    """Elevation, rad, by the definition: 90 degrees less the zenith angle at the site."""
    r = planned(flight.view, row, time).stack()
    d = (earth_orientation(flight.arcs.et[row] + time) @ r.unsqueeze(-1)).squeeze(-1) - site
    return math.pi / 2 - torch.acos((d * site).sum(-1) / (d.norm(dim=-1) * site.norm()))


def test_windows_are_where_the_elevation_is_above_the_limit(five_orbits):
    """Every second of four hours, for all stations."""
    places, span = stations(), 14_400.0
    access = table(five_orbits, span, places)
    time = torch.arange(0.0, span, 1.0, dtype=torch.float64)
    for row in (0, 4):
        windows = listed(access, row)
        assert windows
        for place in range(7):
            inside = torch.zeros_like(time, dtype=torch.bool)
            for _, opens, closes in (w for w in windows if w[0] == place):
                inside |= (time > opens) & (time < closes)
            up = elevations(five_orbits, row, places.r_P[0, place], time) > math.radians(10.0)
            assert torch.equal(up, inside)


def test_edges_are_roots(five_orbits):
    places = stations()
    for place, opens, closes in listed(table(five_orbits, GENERATED, places), 1):
        edges = torch.tensor([t for t in (opens, closes) if 0.0 < t < GENERATED], dtype=torch.float64)
        limit = elevations(five_orbits, 1, places.r_P[0, place], edges)
        assert (limit - math.radians(10.0)).abs().amax() < 1e-11  # rad; elevation moves by 1e-3 rad/s


def test_order_and_independence_of_the_batch(recording, fly, five_orbits):
    access = table(five_orbits, GENERATED)
    alone = table(fly(recording("windows")["ic"][2:3], spans_for(GENERATED)), GENERATED)
    assert listed(alone, 0) == listed(access, 2)
    for row in range(5):
        closes = [w[2] for w in listed(access, row)]
        assert closes == sorted(closes)


def test_rows_of_different_durations(five_orbits):
    """A shorter row is the beginning of a longer one, cut where its time ends."""
    access, whole = table(five_orbits, GENERATED), table(five_orbits, GENERATED)
    duration = torch.tensor([600.0, 3600.0, 0.0, GENERATED, 9000.0], dtype=torch.float64)
    access.reset(torch.arange(5), five_orbits.view, duration)
    for row, end in enumerate(duration.tolist()):
        expected = sorted((p, a, min(b, end)) for p, a, b in listed(whole, row) if a < end)
        assert sorted(listed(access, row)) == expected
    assert access.until.tolist() == duration.tolist()
    cut = [w for row in range(5) for w in listed(access, row) if w[2] == duration[row]]
    assert cut
    assert all(w[1] < w[2] for w in cut)


def test_a_window_cut_at_the_end_joins_its_rest(recording, five_orbits):
    """Generated up to the middle of a pass, with the next segment the window is whole again."""
    recorded = recording("windows")
    mine = (recorded["window_orbit"] == 0) & (recorded["window_close"] - recorded["window_open"] > 300)
    opens, closes = recorded["window_open"][mine], recorded["window_close"][mine]
    cases = [(a, b) for a, b in zip(opens, closes, strict=True) if a // SEGMENT < b // SEGMENT]
    assert cases
    for a, b in cases[:3]:
        end = (b // SEGMENT) * SEGMENT
        access = table(five_orbits, end)
        assert any(w[2] == end and abs(w[1] - a) < MILLISECOND for w in listed(access, 0))
        access.until += SEGMENT
        joined = [w for w in listed(access, 0) if abs(w[1] - a) < MILLISECOND]
        assert len(joined) == 1
        assert joined[0][2] == pytest.approx(b, abs=MILLISECOND)


def test_segments_are_searched_ahead_as_far_as_the_arcs_reach(five_orbits):
    for generated, ready in ((600.0, 600.0 + AHEAD), (27_000.0, GENERATED), (GENERATED, GENERATED)):
        access = table(five_orbits, generated)
        assert access.until.tolist() == [generated] * 5
        assert access.ready.tolist() == [ready] * 5


QUERIES = [(300.0, 1), (1300.0, 1), (1900.0, 1), (2500.0, 2), (4000.0, 1), (5000.0, 1), (5400.0, 2), (6000.0, 1)]
"""Times of queries and numbers of windows, for which arcs of five hours are enough."""


def one_by_one(access: Access, time: torch.Tensor, count: int) -> Windows:
    """What bsk_rl does, on a table that has been searched far enough: segment after segment until a row sees enough."""
    while bool((short := access.next(KIND, time, count)[1] < count).any()):
        assert (access.until < access.ready).all()
        access.until = torch.where(short, access.until + access.segment, access.until)
    return access.next(KIND, time, count)[0]


@pytest.mark.parametrize(("segments", "hours"), [(1, 5), (2, 5), (18, 7)])
def test_queries_do_not_notice_what_is_searched_ahead(segments, hours, fly, monkeypatch):
    """The same windows and the same end of what is known as with one segment after the other."""
    initials = orbits(60)
    monkeypatch.setattr(module, "AHEAD", 1000 * SEGMENT)
    searched = table(fly(initials, 9), 1200.0)
    monkeypatch.setattr(module, "AHEAD", segments * SEGMENT)
    access = table(fly(initials, hours), 1200.0)
    for time, count in QUERIES:
        times = torch.full((60,), time, dtype=torch.float64)
        expected, found = one_by_one(searched, times, count), look_ahead(access, times, count)
        assert torch.equal(access.until, searched.until)
        for one, other in zip(by_place(found), by_place(expected), strict=True):
            torch.testing.assert_close(one, other, rtol=0, atol=1e-5)  # edges of the planned arcs: 1e-8 m over 7 km/s
    assert access.arcs.length == hours * SPAN


def by_place(windows: Windows) -> Windows:
    """Windows that close at the same millisecond in the order of their places."""
    order = (windows.close * 1000.0).round().mul(17).add(windows.place).argsort(1)
    return Windows(*(table.gather(1, order) for table in windows))


def test_windows_cut_at_the_same_time_come_in_the_order_of_their_places(fly):
    """As bsk_rl's bisect.insort leaves them; neighbouring sites, so that two passes are often in progress at once."""
    latitude, longitude = (torch.deg2rad(torch.tensor(x, dtype=torch.float64)) for x in ([47.0, 46.0, 45.0], [10.0, 14.0, 12.0]))
    places = Places(lla_to_fixed(latitude, longitude, torch.zeros(3).double())[None], torch.full((1, 3), 0.1).double())
    access, cut = table(fly(orbits(60), 6), 1800.0, places, segment=1800.0), 0
    for _ in range(6):
        access.until += access.segment
        found, number = access.next(KIND, access.until - access.segment, 3)
        for row in range(60):
            seen = found.place[row, : number[row]][found.close[row, : number[row]] == access.until[row]].tolist()
            cut += len(seen) > 1
            assert seen == sorted(seen)
    assert cut


def test_windows_do_not_depend_on_how_far_the_arcs_reach(fly, recording):
    """As of a row that starts anew beside others whose arcs have grown."""
    initials, time = recording("windows")["ic"], torch.zeros(5, dtype=torch.float64)
    short, long = (look_ahead(table(fly(initials, spans), 600.0), time, 6) for spans in (3, 12))
    for one, other in zip(short, long, strict=True):
        torch.testing.assert_close(one, other, rtol=0, atol=1e-5)


def test_extension_forgets_the_past(ahead):
    access = table(ahead, GENERATED)
    for _ in range(4):
        ahead.arcs.grow()
    access.extend(torch.tensor([1]), torch.full((5,), 20_000.0, dtype=torch.float64))
    assert access.until[1] == GENERATED
    assert access.ready.tolist() == [GENERATED, GENERATED + AHEAD, *[GENERATED] * 3]
    assert all(w[2] >= 20_000.0 for w in listed(access, 1))
    assert any(w[2] < 20_000.0 for w in listed(access, 0))


def test_next_windows(five_orbits):
    """Those in progress count; the last is repeated where there are fewer."""
    access = table(five_orbits, GENERATED)
    windows = [listed(access, row) for row in range(5)]
    for time in (0.0, 3500.0, 8900.0, 20_000.0, 28_000.0):
        found, number = access.next(KIND, torch.full((5,), time, dtype=torch.float64), 4)
        for row in range(5):
            left = [w for w in windows[row] if w[2] >= time + 1e-12]
            assert number[row] == min(4, len(left))
            expected = (left + left[-1:] * 4)[: 4 * bool(left)]
            shown = [tuple(x[row, k].item() for x in (found.place, found.open, found.close)) for k in range(len(expected))]
            assert shown == expected


def test_a_window_that_closes_now_is_over(five_orbits):
    access = table(five_orbits, GENERATED)
    first, second = listed(access, 0)[:2]
    for time, expected in ((first[2] - 1e-9, first), (first[2], second)):
        assert access.next(KIND, torch.full((5,), time, dtype=torch.float64), 1)[0].close[0].item() == expected[2]


def test_rows_are_revealed_by_themselves(five_orbits):
    """What a query reveals of a row depends on the row itself only."""
    access, alone = table(five_orbits, 9000.0), table(five_orbits, 9000.0)
    time, rows = torch.full((5,), 8990.0, dtype=torch.float64), torch.tensor([0, 2, 3])
    missing = access.reveal(KIND, rows, time[rows], torch.full_like(rows, 2))
    assert set(missing.tolist()) <= {0, 2, 3}
    assert access.until[[1, 4]].tolist() == [9000.0] * 2
    for row in rows.tolist():
        assert (len(alone.reveal(KIND, torch.tensor([row]), time[:1], torch.tensor([2]))) == 1) == (row in missing)
        assert alone.until[row] == access.until[row] > 9000.0
    seen = [row for row in rows.tolist() if row not in missing]
    assert seen
    assert (access.next(KIND, time, 2)[1][seen] == 2).all()


def test_passes_between_two_samples(fly, recording):
    """A limit just below the top of a pass leaves a window of seconds that no sample of the 30 s grid sees."""
    arcs = fly(recording("windows")["ic"][:1], 2)
    site = lla_to_fixed(*(torch.deg2rad(torch.tensor(x, dtype=torch.float64)) for x in (47.8407, 11.1421)), torch.tensor(563.0))
    time = torch.arange(3300.0, 3800.0, 0.01, dtype=torch.float64)
    elevation = elevations(arcs, 0, site, time)
    top = elevation.argmax()
    samples = elevation[(time % 30.0) < 0.005].amax()
    limit = 0.5 * (elevation[top] + samples)  # between the best sample and the top
    assert limit > samples + 1e-4
    places = Places(site.view(1, 1, 3), torch.sin(limit).view(1, 1))
    inside = time[elevation > limit]
    ((place, opens, closes),) = listed(table(arcs, 7200.0, places), 0)
    assert place == 0
    assert opens == pytest.approx(inside[0].item(), abs=0.01)
    assert closes == pytest.approx(inside[-1].item(), abs=0.01)
    segmentwise = table(arcs, 3000.0, places)
    segmentwise.until += SEGMENT
    assert listed(segmentwise, 0) == [(0, pytest.approx(opens, abs=1e-6), pytest.approx(closes, abs=1e-6))]
