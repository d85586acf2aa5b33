"""Flags of points: against every tick of a recording of Basilisk, textbook geometry, and one back end against the other."""

import math

import pytest
import torch

from bsk_torch.astro.ephemeris import earth_orientation, parse_utc, sun_position
from bsk_torch.constants import R_EARTH
from bsk_torch.sim.component import Field, vec
from bsk_torch.sim.tick.trace import Trace
from bsk_torch.tasks.inspection.flags import GROUP, Records, find_flags
from bsk_torch.tasks.inspection.points import Point, faces, point_columns
from bsk_torch.vec3 import Vec3

CHIEF = vec("sun_N"), vec("r_BN_N"), Field("other"), vec("sigma_BN"), Field("illumination"), vec("pole_N")
INSPECTOR = Field("storage"), vec("r_BN_N")

SUN = torch.tensor([0.0, 0.0, 1.5e11], dtype=torch.float64)
POLE = torch.tensor([0.0, 1.0, 0.0], dtype=torch.float64)


def sphere(n: int, theta_max=0.5, range_max=250.0, theta_solar_max=1.0, least=0.1, radius=1.0) -> torch.Tensor:
    """Columns of n points on a sphere: golden angles, equal heights."""
    k = torch.arange(n, dtype=torch.float64)
    turn, z = (3.0 - math.sqrt(5.0)) * math.pi * k, torch.linspace(1.0 / n - 1.0, 1.0 - 1.0 / n, n, dtype=torch.float64)
    normal = torch.stack([turn.cos() * (1 - z * z).sqrt(), turn.sin() * (1 - z * z).sqrt(), z], -1)
    limits = (torch.full((n,), float(x), dtype=torch.float64) for x in (theta_max, range_max, theta_solar_max, least))
    return point_columns(radius * normal, normal, *limits)


def chief_trace(r, sigma, light, sun, pole) -> Trace:
    """A trace of [N, K, 3] or [N, K, 1] each; the order of its fields does not matter."""
    trace = Trace.room(CHIEF, torch.zeros(len(r), dtype=torch.int64), r.shape[1])
    trace.table[:, :-1] = torch.cat([sun, r, light, sigma, light, pole], -1)
    return trace


def inspector_trace(r, level) -> Trace:
    """A trace of [N, K, 3] and [N, K]."""
    trace = Trace.room(INSPECTOR, torch.zeros(len(r), dtype=torch.int64), r.shape[1] - 1)
    trace.table[:] = torch.cat([level.unsqueeze(-1), r], -1)
    return trace


def drawn(n: int, ticks: int, low: bool = False) -> Records:
    """Random runs of different length: near the ground where ``low``, so that the Earth is in the way."""
    r = torch.randn(n, 1, 3, dtype=torch.float64)
    r = r / r.norm(dim=-1, keepdim=True) * (R_EARTH + (5e3 if low else 6e5)) + 10.0 * torch.randn(
        n, ticks, 3, dtype=torch.float64
    )
    sigma, light = torch.randn(n, ticks, 3, dtype=torch.float64), torch.rand(n, ticks, 1, dtype=torch.float64)
    chief = chief_trace(r, sigma, light, SUN.expand_as(r), POLE.expand_as(r))
    way = torch.randn(n, 2, ticks + 1, 3, dtype=torch.float64) * (2e5 if low else 100.0)
    inspectors = (torch.cat([r, r[:, -1:]], 1).unsqueeze(1) + way).flatten(0, 1)
    level = torch.randint(0, 2, (2 * n, ticks + 1)).double().cumsum(1)
    row = torch.arange(2 * n)
    return Records(chief, row // 2, inspector_trace(inspectors, level), row, row // 2 % (ticks + 1), row // 2 % 2, row // 2 % 3)


def test_every_flag_of_a_recording(recording, backend):
    """All flags of 100 points in 1000 ticks are those that Basilisk wrote; chief, inspector and Sun are what it had then."""
    file = recording("inspection_fine")
    given, chief, inspector = file["ic"][0], torch.tensor(file["tick_rso"]), torch.tensor(file["tick_sat"])
    et = parse_utc(given["utc_init"]) + torch.tensor(file["tick_time"])
    parts = chief[:, :3], chief[:, 6:9], chief[:, 12:], sun_position(et), earth_orientation(et)[:, 2]
    n, points = len(et), given["scenario"]
    columns = sphere(
        points["n_points"],
        points["theta_max"],
        points["range_max"],
        points["theta_solar_max"],
        points["min_illumination_factor"],
        points["radius"],
    )
    # each tick is a run of two equal records in which the store grows
    level, zero, row = torch.tensor([0.0, 1.0, 2.0], dtype=torch.float64), torch.zeros(n, dtype=torch.int64), torch.arange(n)
    records = Records(
        chief_trace(*(part.unsqueeze(1).expand(-1, 2, -1) for part in parts)),
        row,
        inspector_trace(inspector[:, None, :3].expand(-1, 3, -1), level.expand(n, -1)),
        row,
        zero + 2,
        zero,
        zero,
    )
    inspected, lit = find_flags(columns, records, backend == "compiled")
    assert torch.equal(inspected, torch.tensor(file["tick_access"]))
    assert torch.equal(lit, torch.tensor(file["tick_lit"]))
    assert inspected.sum() > 150
    assert lit.sum() > 1500


@pytest.mark.compiled
@pytest.mark.parametrize("low", [False, True])
@pytest.mark.parametrize("points", [1, GROUP + 3])
def test_kernels_and_tensors_agree(points, low):
    """Runs of any length, several inspectors, points that differ between episodes; low orbits need the test of the Earth."""
    records = drawn(13, 6, low)
    columns = sphere(points, theta_max=1.2, range_max=-1.0, theta_solar_max=2.0)
    own = torch.stack([columns.roll(k // 2, -1) for k in range(26)], 1)
    for given in (columns, own):
        plain, compiled = (find_flags(given, records, kernels) for kernels in (False, True))
        assert torch.equal(plain[0], compiled[0])
        assert torch.equal(plain[1], compiled[1])
    assert plain[0].any()
    assert not plain[0].all()


def test_runs_do_not_depend_on_each_other(backend):
    """A batch gives what its rows give alone, and rows without ticks have no flags."""
    records, columns = drawn(7, 5), sphere(9, theta_max=1.5, range_max=0.0)
    inspected, lit = find_flags(columns, records, backend == "compiled")
    assert not inspected[:2].any()
    chief, chief_rows, inspectors, inspector_rows, *starts = records
    alone = Records(chief, chief_rows[6:8], inspectors, inspector_rows[6:8], *(part[6:8] for part in starts))
    found = find_flags(columns, alone, backend == "compiled")
    assert torch.equal(found[0], inspected[6:8])
    assert torch.equal(found[1], lit[6:8])


def still(levels: list[float], seen_from: int = 0, lit_from: int = 0) -> Records:
    """A chief at rest in the Sun, an inspector 100 m towards it, and the levels of the store."""
    n = len(levels) - 1
    r = torch.tensor([7e6, 0.0, 0.0], dtype=torch.float64).expand(1, n, 3)
    one = torch.ones(1, n, 1, dtype=torch.float64)
    chief = chief_trace(r, torch.zeros_like(r), one, SUN.expand_as(r), POLE.expand_as(r))
    inspector = torch.tensor([7e6, 0.0, 100.0], dtype=torch.float64).expand(1, n + 1, 3)
    inspectors, row = inspector_trace(inspector, torch.tensor([levels], dtype=torch.float64)), torch.zeros(1, dtype=torch.int64)
    return Records(chief, row, inspectors, row, row + n, row + seen_from, row + lit_from)


def facing(*, theta_max=0.1) -> torch.Tensor:
    normal = torch.tensor([[0.0, 0.0, 3.0]], dtype=torch.float64)  # of any length
    angle = torch.tensor([theta_max], dtype=torch.float64)
    return point_columns(normal / 3.0, normal, angle, 2500.0 * angle, angle, angle)


@pytest.mark.parametrize(
    ("levels", "inspected"),
    [
        ([0, 1, 1, 1], True),
        ([5, 4, 4, 4], True),  # a store that is emptied counts as well
        ([0, 0, 0, 0], False),
        ([0, 0, 0, 1], False),  # the last change is not looked at ...
        ([0, 0, 1, 1], True),  # ... and the one before counts for the last two
        ([0, 1], False),  # a single tick inspects nothing
    ],
)
def test_a_change_of_the_store_makes_access_count(levels, inspected, backend):
    found, lit = find_flags(facing(), still(levels), backend == "compiled")
    assert found.item() is inspected
    assert lit.item() is True


@pytest.mark.parametrize(("first", "counts"), [(2, True), (3, False)])
def test_records_count_from_one_on(first, counts, backend):
    """What comes before does not count as lit, or as inspected; neither depends on the other."""
    for starts, expected in (((0, first), [True, counts]), ((first, 0), [counts, True])):
        found = find_flags(facing(), still([0, 1, 2, 3], *starts), backend == "compiled")
        assert [flag.item() for flag in found] == expected


def test_cones_and_ranges():
    """A point at (1, 0, 0) that looks along x: positions on both sides of the limits, and limits that are off."""
    normal = torch.tensor([[1.0, 0.0, 0.0]], dtype=torch.float64).expand(4, -1)
    column = lambda *values: torch.tensor(values, dtype=torch.float64)
    angles, ranges = column(0.5, 2.0, 0.0, 4.0), column(10.0, 10.0, -1.0, 0.0)
    points = Point.of(point_columns(normal, normal, angles, ranges, column(0.0, 0, 0, 0), column(0.0, 0, 0, 0)))

    def at(angle: float, distance: float) -> list[bool]:
        rho = Vec3(*column(1.0 + distance * math.cos(angle), distance * math.sin(angle), 0.0))
        return faces(points, rho).tolist()

    assert (at(0.499, 9.9), at(0.501, 9.9)) == ([True, True, True, True], [False, True, True, True])
    assert (at(1.999, 9.9), at(2.001, 9.9)) == ([False, True, True, True], [False, False, True, True])
    assert (at(0.0, 10.1), at(math.pi, 1e9)) == ([False, False, True, True], [False, False, True, True])


@pytest.mark.parametrize(("height", "visible"), [(-2.0, False), (2.0, True)])
def test_the_earth_is_an_ellipsoid(height, visible, backend):
    """Spacecraft and inspector are level over a pole, where the radius is 0.98 of the equatorial one, and see past it or not."""
    half, r = 2e5, 0.98 * R_EARTH + height
    chief = torch.tensor([[half, 0.0, r]], dtype=torch.float64)
    n = 2
    z = torch.tensor([0.0, 0.0, 1.0], dtype=torch.float64)
    one = torch.ones(1, n, 1, dtype=torch.float64)
    r_N = chief.expand(1, n, 3)
    there = chief_trace(r_N, torch.zeros_like(r_N), one, SUN.expand_as(r_N), z.expand_as(r_N))
    inspector = torch.tensor([-half, 0.0, r], dtype=torch.float64).expand(1, n + 1, 3)
    row = torch.zeros(1, dtype=torch.int64)
    run = Records(there, row, inspector_trace(inspector, torch.arange(3.0).double().unsqueeze(0)), row, row + n, row, row)
    zero, off = torch.zeros(1, 3, dtype=torch.float64), torch.full((1,), -1.0, dtype=torch.float64)
    inspected, _ = find_flags(point_columns(zero, zero + z, off, off, off, off), run, backend == "compiled")
    assert inspected.item() is visible
