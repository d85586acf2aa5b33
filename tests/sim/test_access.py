from __future__ import annotations

import math

import pytest
import torch

from bsk_torch.astro.ephemeris import earth_orientation
from bsk_torch.astro.frames import lla_to_fixed
from bsk_torch.constants import R_EARTH
from bsk_torch.sim.access import AccessTable, Places
from bsk_torch.sim.orbit import Arcs, spans_for
from bsk_torch.sim.world import DEFAULT_STATIONS, station_arrays

MILLISECOND = 1e-3  # s; measured: 0.08 ms over windows generated at reset, 0.21 ms over look-ahead
SEGMENT = 600.0
GENERATED = 28_800.0


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
    return Places(arrays["station_positions"].view(3, -1).mT.contiguous(), arrays["station_sin_elevations"][0])


def table(arcs: Arcs, duration: float, places: Places | None = None, segment: float = SEGMENT) -> AccessTable:
    access = AccessTable(arcs, places or stations(), segment)
    rows = torch.arange(len(arcs.start))
    access.reset(rows, torch.full((len(rows),), duration, dtype=torch.float64))
    return access


def listed(access: AccessTable, row: int) -> list[tuple[int, float, float]]:
    """Windows of a row: place, opening and closing time."""
    windows = access.windows
    finite = torch.isfinite(windows.close[row])
    return list(zip(*(x[row][finite].tolist() for x in (windows.place, windows.open, windows.close)), strict=True))


def look_ahead(access: AccessTable, time: torch.Tensor, count: int = 1):
    """Extend where windows run out, as the simulator does."""
    rows = torch.arange(len(time))
    for _ in range(100):
        short = torch.nonzero(access.short(rows, time, count)).squeeze(-1)
        if not len(short):
            break
        while bool((access.until[short] + access.segment > access.arcs.end[short]).any()):
            access.arcs.grow()
        access.extend(short, time[short])
    return access.next(rows, time, count)


@pytest.fixture(scope="module")
def five_orbits(recording, make_arcs) -> Arcs:
    return make_arcs(recording("windows")["ic"], spans_for(41_000.0))


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


def test_look_ahead_of_basilisk(recording, five_orbits):
    """The next window every minute from 28 020 s on, where segments of ten minutes are added as needed.

    Orbit 3 has bsk_rl's quirk: a pass that rises in a segment and is still up at its end is taken for one that sets.
    """
    recorded, access = recording("windows"), table(five_orbits, GENERATED)
    worst = 0.0
    for k, time in enumerate(recorded["ahead_time"]):
        found = look_ahead(access, torch.full((5,), time, dtype=torch.float64))
        for mine, name in ((found.open, "ahead_open"), (found.close, "ahead_close")):
            worst = max(worst, (mine[:, 0] - torch.tensor(recorded[name][:, k])).abs().amax().item())
    assert worst < MILLISECOND
    asked = (recorded["ahead_open"][3] == 35_400.0) & (abs(recorded["ahead_close"][3] - 35_591.7) < 0.05)
    assert asked.any()  # so the quirk is among what has just been compared


def elevations(arcs: Arcs, row: int, site: torch.Tensor, time: torch.Tensor) -> torch.Tensor:
    """Elevation, rad, by the definition: 90 degrees less the zenith angle at the site."""
    r = arcs.planned_position(torch.full(time.shape, row), time).stack()
    d = (earth_orientation(arcs.et[row] + time) @ r.unsqueeze(-1)).squeeze(-1) - site
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
            up = elevations(five_orbits, row, places.r_P[place], time) > math.radians(10.0)
            assert torch.equal(up, inside)


def test_edges_are_roots(five_orbits):
    places = stations()
    for place, opens, closes in listed(table(five_orbits, GENERATED, places), 1):
        edges = torch.tensor([t for t in (opens, closes) if 0.0 < t < GENERATED], dtype=torch.float64)
        limit = elevations(five_orbits, 1, places.r_P[place], edges)
        assert (limit - math.radians(10.0)).abs().amax() < 1e-11  # rad; elevation moves by 1e-3 rad/s


def test_order_and_independence_of_the_batch(recording, make_arcs, five_orbits):
    access = table(five_orbits, GENERATED)
    alone = table(make_arcs(recording("windows")["ic"][2:3], spans_for(GENERATED)), GENERATED)
    assert listed(alone, 0) == listed(access, 2)
    for row in range(5):
        closes = [w[2] for w in listed(access, row)]
        assert closes == sorted(closes)


def test_rows_of_different_durations(five_orbits):
    """A shorter row is the beginning of a longer one, cut where its time ends."""
    access, whole = table(five_orbits, GENERATED), table(five_orbits, GENERATED)
    duration = torch.tensor([600.0, 3600.0, 0.0, GENERATED, 9000.0], dtype=torch.float64)
    access.reset(torch.arange(5), duration)
    for row, end in enumerate(duration.tolist()):
        expected = sorted((p, a, min(b, end)) for p, a, b in listed(whole, row) if a < end)
        assert sorted(listed(access, row)) == expected
    assert access.until.tolist() == duration.tolist()
    cut = [w for row in range(5) for w in listed(access, row) if w[2] == duration[row]]
    assert cut
    assert all(w[1] < w[2] for w in cut)


def test_a_window_cut_at_the_end_joins_its_rest(recording, five_orbits):
    """Generated up to the middle of a pass, extended by a segment, the window is whole again."""
    recorded = recording("windows")
    mine = (recorded["window_orbit"] == 0) & (recorded["window_close"] - recorded["window_open"] > 300)
    opens, closes = recorded["window_open"][mine], recorded["window_close"][mine]
    cases = [(a, b) for a, b in zip(opens, closes, strict=True) if a // SEGMENT < b // SEGMENT]
    assert cases
    for a, b in cases[:3]:
        end = (b // SEGMENT) * SEGMENT
        access = table(five_orbits, end)
        assert any(w[2] == end and abs(w[1] - a) < MILLISECOND for w in listed(access, 0))
        access.extend(torch.tensor([0]), torch.tensor([0.0], dtype=torch.float64))
        joined = [w for w in listed(access, 0) if abs(w[1] - a) < MILLISECOND]
        assert len(joined) == 1
        assert joined[0][2] == pytest.approx(b, abs=MILLISECOND)
        assert access.until[0] == end + SEGMENT


def test_extension_forgets_the_past(five_orbits):
    access = table(five_orbits, GENERATED)
    row = torch.tensor([1])
    access.extend(row, torch.tensor([20_000.0], dtype=torch.float64))
    assert all(w[2] >= 20_000.0 for w in listed(access, 1))
    assert any(w[2] < 20_000.0 for w in listed(access, 0))


def test_next_windows(five_orbits):
    """Those in progress count; the last is repeated where there are fewer."""
    access = table(five_orbits, GENERATED)
    rows, windows = torch.arange(5), [listed(access, row) for row in range(5)]
    for time in (0.0, 3500.0, 8900.0, 20_000.0):
        found = access.next(rows, torch.full((5,), time, dtype=torch.float64), 4)
        for row in range(5):
            left = [w for w in windows[row] if w[2] >= time + 1e-12]
            expected = (left + left[-1:] * 4)[:4]
            assert [tuple(x[row, k].item() for x in (found.place, found.open, found.close)) for k in range(4)] == expected


def test_a_window_that_closes_now_is_over(five_orbits):
    access, row = table(five_orbits, GENERATED), torch.tensor([0])
    first, second = listed(access, 0)[:2]
    for time, expected in ((first[2] - 1e-9, first), (first[2], second)):
        assert access.next(row, torch.tensor([time], dtype=torch.float64), 1).close.item() == expected[2]


def test_short(five_orbits):
    access, rows = table(five_orbits, GENERATED), torch.arange(5)
    for row in range(5):
        windows = listed(access, row)
        before = torch.full((5,), windows[-2][2] - 1.0, dtype=torch.float64)
        assert access.short(rows, before, 2)[row] == (len([w for w in windows if w[2] >= before[0]]) < 2)
        assert access.short(rows, torch.full((5,), windows[-1][2] + 1e-9, dtype=torch.float64), 1)[row]


def test_passes_between_two_samples(make_arcs, recording):
    """A limit just below the top of a pass leaves a window of seconds that no sample of the 30 s grid sees."""
    arcs = make_arcs(recording("windows")["ic"][:1], 2)
    site = lla_to_fixed(*(torch.deg2rad(torch.tensor(x, dtype=torch.float64)) for x in (47.8407, 11.1421)), torch.tensor(563.0))
    time = torch.arange(3300.0, 3800.0, 0.01, dtype=torch.float64)
    elevation = elevations(arcs, 0, site, time)
    top = elevation.argmax()
    samples = elevation[(time % 30.0) < 0.005].amax()
    limit = 0.5 * (elevation[top] + samples)  # between the best sample and the top
    assert limit > samples + 1e-4
    places = Places(site.unsqueeze(0), torch.sin(limit).unsqueeze(0))
    inside = time[elevation > limit]
    ((place, opens, closes),) = listed(table(arcs, 7200.0, places), 0)
    assert place == 0
    assert opens == pytest.approx(inside[0].item(), abs=0.01)
    assert closes == pytest.approx(inside[-1].item(), abs=0.01)
    segmentwise = table(arcs, 3000.0, places)
    segmentwise.extend(torch.tensor([0]), torch.tensor([0.0], dtype=torch.float64))
    assert listed(segmentwise, 0) == [(0, pytest.approx(opens, abs=1e-6), pytest.approx(closes, abs=1e-6))]
