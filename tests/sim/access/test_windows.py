import math
from itertools import product
from time import perf_counter
from typing import Any, NamedTuple

import pytest
import torch

from bsk_torch.astro.ephemeris import earth_orientation
from bsk_torch.astro.frames import lla_to_fixed
from bsk_torch.constants import R_EARTH
from bsk_torch.sim.access.visibility.kernels import make_visibility
from bsk_torch.sim.access.windows import search as module
from bsk_torch.sim.access.windows import table as window_table
from bsk_torch.sim.access.windows.next_windows import next_windows
from bsk_torch.sim.access.windows.search import BEFORE_SEARCH, BEHIND_SEARCH, SEARCH_AHEAD, AccessWindows
from bsk_torch.sim.access.windows.table import Windows, next_to_close
from bsk_torch.sim.environment.world import DEFAULT_STATIONS, station_arrays
from bsk_torch.sim.orbit.arcs import segments_for
from bsk_torch.sim.orbit.grid import ARC_SEGMENT
from bsk_torch.sim.places import Sites
from tests.sim.orbit.arcs import Solved, orbits, places_of, planned
from tests.support.refusals import check_refusals, refusal

MILLISECOND = 1e-3  # s; measured: 0.08 ms over windows generated at reset, 0.21 ms over look-ahead
SEGMENT = 600.0
GENERATED = 28_800.0
KIND = "station"
CPU = torch.device("cpu")


def number(x: float) -> torch.Tensor:
    return torch.tensor([x], dtype=torch.float64)


def stations() -> Sites:
    arrays = station_arrays(
        {
            "groundStationsData": DEFAULT_STATIONS,
            "groundLocationPlanetRadius": number(R_EARTH),
            "gsMinimumElevation": number(math.radians(10.0)),
            "gsMaximumRange": number(-1.0),
        }
    )
    return Sites(arrays["station_positions_P"].view(1, 3, -1).mT.contiguous(), arrays["station_sin_elevations"])


def table(
    flight: Solved, duration: float, places: Sites | None = None, segment: float = SEGMENT, compat: bool = False
) -> AccessWindows:
    sites = places or stations()
    access = AccessWindows(flight.arcs, make_visibility(flight.backend, CPU), {KIND: places_of(sites)}, segment, compat)
    rows = torch.arange(len(flight.arcs.start))
    access.generate(rows, flight.view, torch.full((len(rows),), duration, dtype=torch.float64))
    return access


def listed(access: AccessWindows, row: int) -> list[tuple[int, float, float]]:
    """Windows of a row that a query sees: place, opening and closing time."""
    windows, until = access.windows[KIND], access.until[row]
    known = torch.isfinite(windows.close[row]) & (windows.open[row] < until)
    close = torch.minimum(windows.close[row], until)
    return list(zip(*(x[known].tolist() for x in (windows.place[row], windows.open[row], close)), strict=True))


def look_ahead(access: AccessWindows, time: torch.Tensor, count: int = 1) -> Windows:
    """Extend where windows run out, as the simulator does."""
    rows = torch.nonzero(access.next(KIND, time, count)[1] < count).squeeze(-1)
    while len(rows := access.reveal(KIND, rows, time[rows], torch.full_like(rows, count))):
        while bool((access.ready + access.ahead * access.segment > access.arcs.end)[rows].any()):
            access.arcs.grow()
        access.extend(rows, time)
    return access.next(KIND, time, count)[0]


@pytest.fixture(scope="module")
def five_orbits(recording, fly) -> Solved:
    return fly(recording("windows")["ic"], segments_for(GENERATED))


@pytest.fixture
def ahead(recording, fly) -> Solved:
    """As the simulator has them when windows run out: arcs that still have to grow."""
    return fly(recording("windows")["ic"], segments_for(GENERATED))


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
    recorded, access = recording("windows"), table(ahead, GENERATED, compat=True)
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
            up = elevations(five_orbits, row, places.r_LP_P[0, place], time) > math.radians(10.0)
            assert torch.equal(up, inside)


def test_edges_are_roots(five_orbits):
    places = stations()
    windows = listed(table(five_orbits, GENERATED, places), 1)
    assert len(windows) > 10
    for place, opens, closes in windows:
        edges = torch.tensor([t for t in (opens, closes) if 0.0 < t < GENERATED], dtype=torch.float64)
        limit = elevations(five_orbits, 1, places.r_LP_P[0, place], edges)
        assert (limit - math.radians(10.0)).abs().amax() < 1e-11  # rad; elevation moves by 1e-3 rad/s


@pytest.mark.nightly("eager")
def test_windows_are_in_order_and_do_not_depend_on_the_batch_or_the_length_of_arcs(recording, fly, five_orbits):
    access = table(five_orbits, GENERATED)
    alone = table(fly(recording("windows")["ic"][2:3], segments_for(GENERATED)), GENERATED)
    assert listed(alone, 0) == listed(access, 2)
    for row in range(5):
        closes = [w[2] for w in listed(access, row)]
        assert closes == sorted(closes)
    # Bit for bit, as of a row that starts again next to others whose arcs have grown.
    initials, time = recording("windows")["ic"], torch.zeros(5, dtype=torch.float64)
    short, long = (look_ahead(table(fly(initials, spans), 600.0), time, 6) for spans in (3, 12))
    assert short[0].numel() > 0
    for one, other in zip(short, long, strict=True):
        assert torch.equal(one, other)


def test_rows_of_different_durations(five_orbits):
    """A shorter row is the beginning of a longer one, cut where its time ends."""
    access, whole = table(five_orbits, GENERATED), table(five_orbits, GENERATED)
    duration = torch.tensor([600.0, 3600.0, 0.0, GENERATED, 9000.0], dtype=torch.float64)
    access.generate(torch.arange(5), five_orbits.view, duration)
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
        assert (len(joined), joined[0][2]) == (1, pytest.approx(b, abs=MILLISECOND))


def test_windows_in_progress_where_the_arcs_end_are_joined_when_they_grow(recording, fly):
    """Of two places below each satellite at the end of two hours, and of one that it does not see."""
    initials, end = recording("windows")["ic"], 2.0 * ARC_SEGMENT
    flight, longer = fly(initials, 2), fly(initials, 5)
    below = planned_ground(longer, end)
    places = Sites(torch.stack([below, below + 2e5, -below], 1), torch.full((5, 3), 0.5, dtype=torch.float64))
    access, whole = (
        AccessWindows(one.arcs, make_visibility(one.backend, CPU), {KIND: places_of(places)}, SEGMENT) for one in (flight, longer)
    )
    rows = torch.arange(5)
    access.generate(rows, flight.view, torch.full((5,), end, dtype=torch.float64))
    assert (access.ready == end).all()
    assert all([w[2] for w in listed(access, row)[-2:]] == [end, end] for row in range(5))
    for _ in range(3):
        flight.arcs.grow()
    access.extend(rows, torch.full((5,), 1000.0, dtype=torch.float64))
    whole.generate(rows, longer.view, access.ready)
    access.until = access.ready.clone()
    for row in range(5):
        expected = [w for w in listed(whole, row) if w[2] >= 1000.0]
        found = listed(access, row)
        assert [w[0] for w in found] == [w[0] for w in expected]
        for one, other in zip(found, expected, strict=True):
            assert one[1:] == pytest.approx(other[1:], abs=1e-4)
        assert sum(w[1] < end < w[2] for w in found) == 2


def planned_ground(flight: Solved, time: float) -> torch.Tensor:
    """Points on the ground below all satellites, [n, 3]."""
    sight, start = make_visibility(flight.backend, CPU), torch.full_like(flight.arcs.start, time)
    return torch.nn.functional.normalize(sight.ground_track(flight.view, start, 10)[:, 0], dim=-1) * R_EARTH


def test_segments_are_searched_ahead_as_far_as_the_arcs_reach(five_orbits):
    for generated, ready in ((600.0, 600.0 + SEARCH_AHEAD), (27_000.0, GENERATED - SEGMENT), (GENERATED, GENERATED)):
        access = table(five_orbits, generated)
        assert (access.until.tolist(), access.ready.tolist()) == ([generated] * 5, [ready] * 5)


QUERIES = [(300.0, 1), (1300.0, 1), (1900.0, 1), (2500.0, 2), (4000.0, 1), (5000.0, 1), (5400.0, 2), (6000.0, 1)]
"""Times of queries and numbers of windows, for which arcs of five hours are enough."""


def one_by_one(access: AccessWindows, time: torch.Tensor, count: int) -> Windows:
    """What bsk_rl does, on a table that has been searched far enough: segment after segment until a row sees enough."""
    while bool((short := access.next(KIND, time, count)[1] < count).any()):
        assert (access.until < access.ready).all()
        access.until = torch.where(short, access.until + access.segment, access.until)
    return access.next(KIND, time, count)[0]


def flown(solve_arcs, initials: list[dict[str, Any]], hours: int, backend: str) -> Solved:
    """Arcs under one of the back ends, where the other takes too long."""
    return Solved(*solve_arcs(initials, hours, backend=backend), backend)


@pytest.mark.parametrize(
    ("segments", "hours", "backend"),
    [
        pytest.param(1, 5, "compiled", marks=pytest.mark.compiled),
        pytest.param(2, 5, "compiled", marks=pytest.mark.compiled),
        pytest.param(18, 7, "compiled", marks=pytest.mark.compiled),
        (18, 7, "eager"),
    ],
)
def test_queries_do_not_notice_what_is_searched_ahead(segments, hours, backend, solve_arcs, monkeypatch):
    """The same windows bit for bit and the same end of what is known as with one segment after the other."""
    initials = orbits(60)
    monkeypatch.setattr(module, "SEARCH_AHEAD", 1000 * SEGMENT)
    searched = table(flown(solve_arcs, initials, 9, backend), 1200.0)
    monkeypatch.setattr(module, "SEARCH_AHEAD", segments * SEGMENT)
    access = table(flown(solve_arcs, initials, hours, backend), 1200.0)
    for time, count in QUERIES:
        times = torch.full((60,), time, dtype=torch.float64)
        expected, found = one_by_one(searched, times, count), look_ahead(access, times, count)
        assert torch.equal(access.until, searched.until)
        for one, other in zip(by_place(found), by_place(expected), strict=True):
            assert torch.equal(one, other)
    assert access.arcs.length == hours * ARC_SEGMENT


def by_place(windows: Windows) -> Windows:
    """Windows that close at the same millisecond in the order of their places."""
    order = (windows.close * 1000.0).round().mul(17).add(windows.place).argsort(1)
    return Windows(*(table.gather(1, order) for table in windows))


def test_windows_cut_at_the_same_time_come_in_the_order_of_their_places(fly):
    """As bsk_rl's bisect.insort leaves them; neighbouring sites, so that two passes are often in progress at once."""
    latitude, longitude = (torch.deg2rad(torch.tensor(x, dtype=torch.float64)) for x in ([47.0, 46.0, 45.0], [10.0, 14.0, 12.0]))
    places = Sites(lla_to_fixed(latitude, longitude, torch.zeros(3).double())[None], torch.full((1, 3), 0.1).double())
    access, cut = table(fly(orbits(60), 6), 1800.0, places, segment=1800.0), 0
    for _ in range(6):
        access.until += access.segment
        found, number = access.next(KIND, access.until - access.segment, 3)
        for row in range(60):
            seen = found.place[row, : number[row]][found.close[row, : number[row]] == access.until[row]].tolist()
            cut += len(seen) > 1
            assert seen == sorted(seen)
    assert cut


def test_extension_forgets_the_past(ahead):
    access = table(ahead, GENERATED)
    for _ in range(4):
        ahead.arcs.grow()
    access.extend(torch.tensor([1]), torch.full((5,), 20_000.0, dtype=torch.float64))
    assert access.until[1] == GENERATED
    assert access.ready.tolist() == [GENERATED, GENERATED + SEARCH_AHEAD, *[GENERATED] * 3]
    assert all(w[2] >= 20_000.0 for w in listed(access, 1))
    assert any(w[2] < 20_000.0 for w in listed(access, 0))


def test_next_windows_are_those_that_close_later(five_orbits):
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
    places = Sites(site.view(1, 1, 3), torch.sin(limit).view(1, 1))
    inside = time[elevation > limit]
    ((place, opens, closes),) = listed(table(arcs, 7200.0, places), 0)
    assert (place, opens) == (0, pytest.approx(inside[0].item(), abs=0.01))
    assert closes == pytest.approx(inside[-1].item(), abs=0.01)
    segmentwise = table(arcs, 3000.0, places)
    segmentwise.until += SEGMENT
    assert listed(segmentwise, 0) == [(0, pytest.approx(opens, abs=1e-6), pytest.approx(closes, abs=1e-6))]


# -- the next windows ----------------------------------------------------------------------------------------------------------


class Listed(NamedTuple):
    """A window as a query sees it, and where it stands in its table."""

    close: float
    cut: bool
    place: int
    number: int
    open: float


def naive(row: list[tuple[float, float, int]], time: float, until: float, width: int, allowed: list[bool] | None) -> list[Listed]:
    """Windows (opening, closing time and place) of a row that a query sees: by closing time, those that are cut by place."""
    found = []
    for k, (opens, closes, place) in enumerate(row):
        seen = math.isfinite(closes) and opens < until and min(closes, until) >= time + 1e-12
        if seen and (allowed is None or allowed[place]):
            found.append(Listed(min(closes, until), closes >= until, place, k, opens))
    found.sort(key=lambda w: (w.close, w.cut, w.place if w.cut else w.number))
    return found[:width]


def random_table(n: int, most: int, places: int) -> Windows:
    """Windows whose times are whole minutes, so that many close at once; rows of different lengths."""
    close = 60.0 * torch.randint(0, 90, (n, most)).double().sort(1).values
    opens = close - 60.0 * torch.randint(1, 15, (n, most)).double()
    missing = torch.arange(most) >= torch.randint(0, most + 1, (n, 1))
    missing[: n // 2] = False
    place = torch.randint(places, (n, most)).masked_fill(missing, 0)
    return Windows(*(x.masked_fill(missing, math.inf) for x in (opens, close)), place)


@pytest.mark.parametrize("filtered", [False, True])
@pytest.mark.parametrize("width", [1, 3, 10])
@pytest.mark.parametrize(
    ("query", "most", "spare"),
    [*((next_to_close, *sizes) for sizes in [(5, 16), (40, 16), (300, 16), (300, 0), (300, 100)]), (next_windows, 300, 16)],
)
def test_next_windows_of_random_tables(query, most, spare, width, filtered, monkeypatch):
    """Against lists; long tables, of which a block is looked at first, and short ones, and rows for which no block is enough."""
    n, places = 60, 12
    monkeypatch.setattr(window_table, "BLOCK_MARGIN", spare)
    windows = random_table(n, most, places)
    time = 30.0 * torch.randint(0, 200, (n,)).double()
    until = torch.where(torch.arange(n) % 3 == 0, math.inf, 60.0 * (time / 60.0).round() + 60.0 * torch.randint(-1, 8, (n,)))
    allowed = torch.rand(n, places) < 0.3 if filtered else None
    found, number = query(windows, time, until, width, allowed)
    assert found.open.shape == (n, width)
    cut = 0
    for row in range(n):
        every = list(zip(*(x[row].tolist() for x in windows), strict=True))
        expected = naive(every, time[row].item(), until[row].item(), width, None if allowed is None else allowed[row].tolist())
        assert number[row] == len(expected)
        padded = (expected + expected[-1:] * width)[: width * bool(expected)]
        shown = [tuple(x[row, k].item() for x in found) for k in range(len(padded))]
        assert shown == [(w.open, w.close, w.place) for w in padded]
        cut += any(w.cut for w in expected)
    assert cut or width == 1  # the next one of many is rarely cut


def test_the_kernel_of_next_windows_agrees_with_torch():
    """Bit for bit: in rows with many windows, few and none, whose padding is the same, too; for all rows and for some."""
    sizes, steps = [(1, 5), (1, 300), (60, 40), (60, 300), (1200, 150)], (60.0, 1e-7)  # s; also of the tie break
    failures = []
    for (n, most), step, width, filtered in product(sizes, steps, (1, 4, 32), (False, True)):
        minutes = random_table(n, most, 12)
        begin = 4e8 if step < 1.0 else 0.0  # s; so late, sums with tie breaks are rounded to each other
        windows = Windows(*(begin + x / 60.0 * step for x in minutes[:2]), minutes.place)
        time = begin + step * torch.randint(-5, 100, (n,)).double()
        until = torch.where(torch.arange(n) % 4 == 3, math.inf, time + step * torch.randint(-3, 40, (n,)).double())
        allowed = torch.rand(n, 24)[:, ::2] < 0.3 if filtered else None
        rows = torch.randint(n, (7,))
        expected, number = next_to_close(windows, time, until, width, allowed)
        found, again = next_windows(windows, time, until, width, allowed)
        some, few = next_windows(windows, time, until, width, allowed, rows)
        same = torch.equal(again, number) and torch.equal(few, number[rows])
        same &= all(torch.equal(*pair) for pair in zip(found, expected, strict=True))
        same &= all(torch.equal(one, other[rows]) for one, other in zip(some, expected, strict=True))
        if not same or (n > 1 and not (bool((number == 0).any()) and bool((number > 0).any()))):
            failures.append((n, most, step, width, filtered))
    assert not failures


def test_rejects_tables_that_kernels_of_next_windows_would_misread(five_orbits):
    access, time = table(five_orbits, GENERATED), torch.full((5,), 9000.0, dtype=torch.float64)
    windows, until, allowed = access.windows[KIND], access.until, torch.ones(5, 6, dtype=torch.bool)
    words = "time", "[5]", "torch.float32", "torch.float64"
    check_refusals(
        refusal(lambda: access.next(KIND, time, 3, allowed), TypeError, "filters", "'station'", "[5, 6]", "[5, 7]", "bool"),
        refusal(lambda: next_windows(windows, time.float(), until, 3, None), TypeError, *words),
        refusal(lambda: next_windows(windows, time, until[:4], 3, None), TypeError, "until", "[4]"),
    )


def test_next_windows_do_not_depend_on_the_batch(monkeypatch):
    """Nor on how much of a table is looked at first, nor on rows with longer tables beside."""
    windows, time = random_table(40, 200, 8), 60.0 * torch.randint(0, 90, (40,)).double()
    until, allowed = 5000.0 * torch.rand(40).double(), torch.rand(40, 8) < 0.5
    whole, number = next_to_close(windows, time, until, 4, allowed)
    for few, spare in ((0, 0), (0, 1000), (10**6, 0)):
        monkeypatch.setattr(window_table, "FULL_SORT_MARGIN", few)
        monkeypatch.setattr(window_table, "BLOCK_MARGIN", spare)
        found, again = next_to_close(windows, time, until, 4, allowed)
        assert torch.equal(again, number)
        some = number > 0
        assert all(torch.equal(one[some], other[some]) for one, other in zip(found, whole, strict=True))
    for row in torch.nonzero(number).squeeze(-1).tolist():
        mine = slice(row, row + 1)
        shorter = Windows(*(x[mine, : int(torch.isfinite(windows.close[row]).sum())] for x in windows))
        found, again = next_to_close(shorter, time[mine], until[mine], 4, allowed[mine])
        assert again == number[mine]
        assert all(torch.equal(one, other[mine]) for one, other in zip(found, whole, strict=True))


def test_next_windows_of_some_rows(five_orbits):
    access, time = table(five_orbits, GENERATED), torch.full((5,), 9000.0, dtype=torch.float64)
    allowed, rows = torch.rand(5, 7) < 0.7, torch.tensor([3, 0])
    every, number = access.next(KIND, time, 3, allowed)
    some, few = access.next(KIND, time, 3, allowed, rows)
    assert torch.equal(few, number[rows])
    assert all(torch.equal(one, other[rows]) for one, other in zip(some, every, strict=True))


# -- what queries reveal -------------------------------------------------------------------------------------------------------


def test_filters_hide_places(five_orbits):
    """What a filtered query sees are the windows of the places that remain, as if there were no others."""
    access, time = table(five_orbits, GENERATED), torch.full((5,), 4000.0, dtype=torch.float64)
    for hidden in ([], [0], [2, 3, 4, 6], [1, 2, 3, 4, 5, 6]):
        allowed = torch.ones(5, 7, dtype=torch.bool)
        allowed[:, hidden] = False
        found, number = access.next(KIND, time, 5, allowed)
        for row in range(5):
            expected = [w for w in listed(access, row) if w[2] >= 4000.0 and w[0] not in hidden][:5]
            shown = [tuple(x[row, k].item() for x in (found.place, found.open, found.close)) for k in range(int(number[row]))]
            assert shown == expected
    assert access.next(KIND, time, 5, torch.zeros(5, 7, dtype=torch.bool))[1].tolist() == [0] * 5


def test_filtered_queries_reveal_as_much_as_they_need(five_orbits):
    """Segment after segment until enough of the places that remain are seen, and no further."""
    rows, time = torch.arange(5), torch.full((5,), 2000.0, dtype=torch.float64)
    allowed = torch.rand(5, 7) < 0.5
    access, stepwise = table(five_orbits, 1200.0), table(five_orbits, 1200.0)
    missing = access.reveal(KIND, rows, time, torch.full_like(rows, 2), allowed=allowed)
    for row in rows.tolist():
        while stepwise.next(KIND, time, 2, allowed)[1][row] < 2 and stepwise.until[row] < stepwise.ready[row]:
            stepwise.until[row] += SEGMENT
        assert access.until[row] == stepwise.until[row]
        assert (row in missing) == bool(stepwise.next(KIND, time, 2, allowed)[1][row] < 2)
    assert len(missing) < 5
    assert access.until.unique().numel() > 1


def test_rows_that_ask_for_fewer_reveal_less(five_orbits):
    """Each as much as it would alone."""
    rows, time = torch.arange(5), torch.full((5,), 2000.0, dtype=torch.float64)
    count = torch.tensor([1, 3, 2, 1, 4])
    access, most = table(five_orbits, 1200.0), table(five_orbits, 1200.0)
    access.reveal(KIND, rows, time, count)
    most.reveal(KIND, rows, time, torch.full_like(rows, 4))
    assert (access.until <= most.until).all()
    assert (access.until < most.until).any()
    assert access.until[4] == most.until[4]
    for row in rows.tolist():
        alone = table(five_orbits, 1200.0)
        alone.reveal(KIND, rows[[row]], time[:1], count[[row]])
        assert access.until[row] == alone.until[row]
        assert (alone.until[rows != row] == 1200.0).all()


@pytest.mark.parametrize("last", [0.0, 1200.0, 1201.0, 1800.0, 3000.0])
def test_no_segment_begins_after_the_last(last, five_orbits):
    """Those that have been revealed stay."""
    rows, time = torch.arange(5), torch.full((5,), 1300.0, dtype=torch.float64)
    access, free = table(five_orbits, 1200.0), table(five_orbits, 1200.0)
    count = torch.full_like(rows, 3)
    free.reveal(KIND, rows, time, count)
    missing = access.reveal(KIND, rows, time, count, torch.full((5,), last, dtype=torch.float64))
    bound = max(1200.0, math.ceil(last / SEGMENT) * SEGMENT)
    assert torch.equal(access.until, free.until.clamp(max=bound))
    assert (free.until > bound).any()
    assert not len(missing)  # none of them may be given more


def test_kinds_share_what_is_known(recording, fly):
    """A query for one kind of places reveals the windows of all of them; each has its own table."""
    flight = fly(recording("windows")["ic"], segments_for(GENERATED))
    targets = near_stations()
    both = AccessWindows(
        flight.arcs, make_visibility(flight.backend, CPU), {"target": places_of(targets), KIND: places_of(stations())}, SEGMENT
    )
    rows, time = torch.arange(5), torch.full((5,), 1300.0, dtype=torch.float64)
    both.generate(rows, flight.view, torch.full((5,), 1200.0, dtype=torch.float64))
    assert both.windows["target"].close.shape != both.windows[KIND].close.shape
    before = [listed(both, row) for row in range(5)]
    both.reveal("target", rows, time, torch.full_like(rows, 8))
    assert (both.until > 1200.0).all()
    alone = table(flight, 1200.0)
    alone.until = both.until.clone()
    after = [listed(both, row) for row in range(5)]
    assert after == [listed(alone, row) for row in range(5)]
    assert after != before
    for _ in range(4):
        flight.arcs.grow()
    both.extend(rows, time)
    alone.extend(rows, time)
    both.until, alone.until = both.ready.clone(), alone.ready.clone()
    assert [listed(both, row) for row in range(5)] == [listed(alone, row) for row in range(5)]


# -- places of each environment's own ------------------------------------------------------------------------------------------


def near_stations(n: int = 1, count: int = 40) -> Sites:
    """Targets [n, count] all around the Earth, with limits of 20 to 60 degrees."""
    unit = torch.nn.functional.normalize(torch.randn(n, count, 3, dtype=torch.float64), dim=-1)
    limit = torch.deg2rad(20.0 + 40.0 * torch.rand(n, count, dtype=torch.float64))
    return Sites(unit * (R_EARTH + 1000.0), torch.sin(limit))


@pytest.mark.nightly("eager")
def test_each_environment_has_places_of_its_own(recording, fly):
    """Where one has fewer than others the rest are NaN; it sees what it would see alone, also in look-ahead."""
    initials, numbers = recording("windows")["ic"], [40, 3, 25, 1, 0]
    places = near_stations(5)
    for row, number in enumerate(numbers):
        places.r_LP_P[row, number:] = math.nan

    def access(flight: Solved, mine: Sites) -> AccessWindows:
        made = AccessWindows(flight.arcs, make_visibility(flight.backend, CPU), {KIND: places_of(mine)}, SEGMENT)
        rows = torch.arange(len(flight.arcs.start))
        made.generate(rows, flight.view, torch.full((len(rows),), 6000.0, dtype=torch.float64))
        for _ in range(2):
            flight.arcs.grow()
        made.extend(rows, torch.zeros(len(rows), dtype=torch.float64))
        made.until = made.ready.clone()
        return made

    together = access(fly(initials, 6), places)
    for row, number in enumerate(numbers):
        seen = listed(together, row)
        assert all(place < number for place, _, _ in seen)
        if number:
            alone = access(fly(initials[row : row + 1], 6), Sites(*(x[row : row + 1, :number] for x in places[:2])))
            assert [w[0] for w in listed(alone, 0)] == [w[0] for w in seen]
            for one, other in zip(listed(alone, 0), seen, strict=True):
                assert one[1:] == pytest.approx(other[1:], abs=1e-6)
    assert len(listed(together, 0)) > 10


def test_some_rows_are_reset_and_extended_with_their_own_places(recording, fly):
    """The places of rows are asked for by their numbers, whatever these are."""
    flight = fly(recording("windows")["ic"], 6)
    first, second = near_stations(5), near_stations(5)
    access = AccessWindows(flight.arcs, make_visibility(flight.backend, CPU), {KIND: places_of(first)}, SEGMENT)
    every, duration = torch.arange(5), torch.full((5,), 6000.0, dtype=torch.float64)
    access.generate(every, flight.view, duration)
    before = [listed(access, row) for row in range(5)]
    rows = torch.tensor([3, 1])
    access.kinds[KIND] = places_of(second)
    access.generate(rows, flight.view.take(rows), duration[rows])
    other = AccessWindows(flight.arcs, make_visibility(flight.backend, CPU), {KIND: places_of(second)}, SEGMENT)
    other.generate(every, flight.view, duration)
    for row in range(5):
        assert listed(access, row) == (listed(other, row) if row in (1, 3) else before[row])


# -- for long, and for many ----------------------------------------------------------------------------------------------------


@pytest.mark.compiled
def test_tables_do_not_grow_without_end(solve_arcs):
    """Forty times windows run out, over forty hours; arcs move on, and what has closed is forgotten."""
    flight = flown(solve_arcs, orbits(6), 6, "compiled")
    access, rows, time = table(flight, 600.0), torch.arange(6), torch.zeros(6, dtype=torch.float64)
    columns, seen = [], 0
    for _ in range(40):
        time = time + ARC_SEGMENT
        while bool((access.arcs.end < time + 3.0 * ARC_SEGMENT).any()):
            access.catch_up(rows)
            access.arcs.extend(rows)
        found = look_ahead_of_moving_arcs(access, time)
        seen += int((found.open > time.unsqueeze(-1)).sum())
        columns.append(access.windows[KIND].close.shape[1])
        known = torch.isfinite(access.windows[KIND].close)
        assert (access.windows[KIND].close[known] > (time - 6.0 * ARC_SEGMENT).amin()).all()
    assert seen > 100
    # a table never gets narrower, so its columns are the most that any row has had; seven stations have some two passes an hour
    assert columns[-1] <= 60
    assert columns[-1] <= columns[15] + 5


def look_ahead_of_moving_arcs(access: AccessWindows, time: torch.Tensor) -> Windows:
    """The next window of every row."""
    rows = torch.nonzero(access.next(KIND, time, 1)[1] < 1).squeeze(-1)
    while len(rows := access.reveal(KIND, rows, time[rows], torch.ones_like(rows))):
        needed = access.segment + BEFORE_SEARCH + BEHIND_SEARCH
        if bool((access.arcs.end[rows] - access.ready[rows] < needed).any()):
            access.catch_up(torch.arange(len(time)))
            access.arcs.extend(rows)
        access.extend(rows, time)
    return access.next(KIND, time, 1)[0]


@pytest.mark.compiled
def test_thousands_of_targets(recording, solve_arcs):
    """Five thousand places for each of five satellites over eight hours: half a second on one core."""
    flight = flown(solve_arcs, recording("windows")["ic"], segments_for(GENERATED), "compiled")
    places = near_stations(5, 5000)
    started = perf_counter()
    access = table(flight, GENERATED, places)
    elapsed = perf_counter() - started
    counts = torch.isfinite(access.windows[KIND].close).sum(1)
    assert (counts > 1500).all()
    assert elapsed < 10.0  # twenty times what has been measured; one place after another would take minutes
    alone = table(flight, GENERATED, Sites(*(x[:, 4990:] for x in places[:2])))
    for row in range(5):
        mine = [(place - 4990, *times) for place, *times in listed(access, row) if place >= 4990]
        expected = listed(alone, row)
        assert [w[0] for w in mine] == [w[0] for w in expected]
        for one, other in zip(mine, expected, strict=True):
            assert one[1:] == pytest.approx(other[1:], abs=1e-9)
