from types import SimpleNamespace

import pytest
import torch

from bsk_torch.astro.earth_rotation import pole_matrix
from bsk_torch.astro.ephemeris import EARTH_ROTATION_RATE, earth_orientation, earth_orientation_rate, sun_position, sun_state
from bsk_torch.astro.gravity import DEGREE, field, field_weights, third_body
from bsk_torch.astro.integrate import rk4_step
from bsk_torch.constants import MU_EARTH
from bsk_torch.sim.environment.ephemeris import EPHEMERIS_TRACK, ephemeris_records
from bsk_torch.sim.orbit.arcs import ARC, PLANNED_SEGMENTS, Arcs, follow_arc, segments_for
from bsk_torch.sim.orbit.equations import frame_stretch
from bsk_torch.sim.orbit.grid import ARC_SEGMENT, LEAD_NODES, NODE_SPACING, PLAN_STEP, SAMPLES_PER_SEGMENT
from bsk_torch.vec3 import Mat3, Vec3
from tests.astro.test_gravity import disturbing_potential
from tests.sim.orbit.arcs import above, flown, orbits, planned

BASILISK = 1e-3  # m; measured: 1.1e-4 over five orbits (nominal), 2e-5 over two (eccentric)
BASILISK_SPEED = 1e-6  # m/s; measured: 1.8e-7


def deviations(arcs: Arcs, row: int, state: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
    """Distance and difference of speed [m] from recorded time, position and velocity [m, 7]."""
    r, v = flown(arcs, row, state[:, 0])
    return (r - state[:, 1:4]).norm(dim=-1), (v - state[:, 4:7]).norm(dim=-1)


@pytest.mark.parametrize("name", ["nominal", "eccentric"])
def test_flown_arcs_against_basilisk(name, recording, make_arcs, backend):
    episodes = recording(name)
    arcs = make_arcs(episodes["ic"], segments_for(episodes["env"]["time_limit"]), backend=backend)
    states = torch.tensor(episodes["state"]).split([n + 1 for n in episodes["length"].tolist()])
    assert states
    for row, state in enumerate(states):
        distance, speed = deviations(arcs, row, state)
        assert distance.amax() < BASILISK
        assert speed.amax() < BASILISK_SPEED


def ticks(recording, make_arcs, backend: str) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    """Time, distance and difference of speed [1500] of every tick of a recording."""
    recorded = recording("ticks_seed11")
    arcs = make_arcs([recorded["init"]], 1, backend=backend)
    time, r, v = (torch.tensor(recorded[name]) for name in ("t", "r", "v"))
    return time, *deviations(arcs, 0, torch.cat([time.unsqueeze(-1), r, v], -1))


def test_every_tick_against_basilisk(recording, make_arcs, backend):
    """Between nodes, too. Measured 3e-6 m and 2.9e-7 m/s."""
    _, distance, speed = ticks(recording, make_arcs, backend)
    assert distance.amax() < 1e-5
    assert speed.amax() < BASILISK_SPEED


@pytest.mark.parametrize(("name", "step"), [("half_second", 0.5), ("two_seconds", 2.0)])
def test_ticks_of_other_lengths(name, step, recording, make_arcs, backend):
    """Basilisk's frame stretch depends on the step: 2 s flown as 1 s would be 0.2 m off."""
    episodes = recording(name)
    state = torch.tensor(episodes["state"])
    assert deviations(make_arcs(episodes["ic"], 2, step, backend), 0, state)[0].amax() < BASILISK
    assert deviations(make_arcs(episodes["ic"], 2, 4.0 * step, backend), 0, state)[0].amax() > BASILISK


def test_planned_arc_against_a_runge_kutta_of_thirty_seconds(recording, solve_arcs, backend):
    """The propagation that bsk_rl looks ahead on: the Earth's orientation at the start of a step, extrapolated linearly."""
    initials, weights = recording("windows")["ic"], field_weights(DEGREE)
    arcs, view = solve_arcs(initials, 1, backend=backend)
    y = tuple(Vec3.of(torch.tensor([initial[k] for initial in initials], dtype=torch.float64)) for k in ("rN", "vN"))
    for k in range(round(ARC_SEGMENT / PLAN_STEP)):
        et = arcs.et + k * PLAN_STEP
        C, C_rate = earth_orientation(et), earth_orientation_rate(et)
        sun = [Vec3.of(x) for x in sun_state(et)]

        def rates(stage, offset, y, C=C, C_rate=C_rate, sun=sun):
            PN = Mat3.of(C + C_rate * offset)
            return y[1], PN.mT @ field(PN @ y[0], weights) + third_body(y[0], sun[0] + sun[1] * offset)

        y = rk4_step(rates, y, PLAN_STEP)
    end = torch.full((1,), ARC_SEGMENT, dtype=torch.float64)
    found = torch.cat([planned(view, row, end).stack() for row in range(len(initials))])
    # measured 0.024 m, which is 3 us of motion; the truncation error that the plan reproduces is 8 to 52 m
    assert (found - y[0].stack()).norm(dim=-1).amax() < 0.05
    assert (arcs.flown[:, -1] - y[0].stack()).norm(dim=-1).amin() > 5.0


def second_differences(r: torch.Tensor) -> torch.Tensor:
    """Acceleration at nodes 4 to -4 of positions [n, Q, 3], of eighth order."""
    centre = torch.arange(4, r.shape[1] - 4)
    weights = ((1, 8 / 5), (2, -1 / 5), (3, 8 / 315), (4, -1 / 560))
    return sum(w * (r[:, centre + k] + r[:, centre - k] - 2.0 * r[:, centre]) for k, w in weights) / NODE_SPACING**2


def test_flown_arcs_obey_the_equations_of_motion(make_arcs, backend):
    """Earth, with the mean stretch of its frame, and Sun, evaluated with the ephemeris instead of the ephemeris."""
    arcs = make_arcs(orbits(10), 1, backend=backend)
    r = arcs.flown[:, 4:-4]
    et = arcs.et.unsqueeze(-1) + NODE_SPACING * (torch.arange(4, arcs.flown.shape[1] - 4) - LEAD_NODES)
    PN = earth_orientation(et)
    stretch = 1.0 + torch.tensor([1.0, 1.0, 0.0], dtype=torch.float64) * frame_stretch(1.0)
    r_P = stretch * (PN @ r.unsqueeze(-1)).squeeze(-1)
    earth = (PN.mT @ (stretch * field(Vec3.of(r_P), field_weights(DEGREE)).stack()).unsqueeze(-1)).squeeze(-1)
    sun = third_body(Vec3.of(r), Vec3.of(sun_position(et))).stack()
    found = second_differences(arcs.flown)
    # truncation of the differences, some (10 n 60 s)^8 / 3150 of the 1e-5 m/s^2 of degree ten; measured 8e-10
    torch.testing.assert_close(found, earth + sun, rtol=0, atol=2e-9)
    assert ((found - earth).norm(dim=-1) > 1e-7).any()  # so that the Sun is seen


def test_jacobi_integral_and_momentum_of_a_long_flight(make_arcs, backend):
    """In the turning field ``v^2 / 2 - U - omega h_z`` is constant; the Sun changes it by some 1e-7."""
    arcs = make_arcs(orbits(20), 4, backend=backend)
    times = NODE_SPACING * torch.arange(5, arcs.flown.shape[1] - LEAD_NODES - 5, dtype=torch.float64)
    PN, pole = earth_orientation(arcs.et.unsqueeze(-1) + times), pole_matrix(arcs.et + 2 * ARC_SEGMENT)
    r, v = (torch.stack(parts) for parts in zip(*(flown(arcs, row, times) for row in range(20)), strict=True))
    r_P, radius = (PN @ r.unsqueeze(-1)).squeeze(-1), r.norm(dim=-1)
    potential = MU_EARTH / radius + disturbing_potential(r_P)
    h_z = (torch.linalg.cross(r, v) * pole.z.stack().unsqueeze(1)).sum(-1)
    kinetic = 0.5 * (v**2).sum(-1)
    jacobi = kinetic - potential - EARTH_ROTATION_RATE * h_z
    assert ((jacobi / jacobi[:, :1]) - 1.0).abs().amax() < 5e-7  # measured 1e-7
    # what is not conserved: energy (tesserals), the two-body energy (J2) and, a little, the momentum about the pole
    energy, two_body = kinetic - potential, kinetic - MU_EARTH / radius
    assert 1e-6 < ((energy / energy[:, :1]) - 1.0).abs().amax() < 1e-4
    assert 1e-3 < ((two_body / two_body[:, :1]) - 1.0).abs().amax() < 1e-2
    assert ((h_z - h_z[:, :1]) / torch.linalg.cross(r, v).norm(dim=-1)).abs().amax() < 1e-4


def assert_same_arcs(arcs: Arcs, row: int, long: Arcs, whole: torch.Tensor) -> None:
    """One row against a longer solve from time zero, whose whole plan is given: the same bit for bit."""
    begin, end = round(arcs.start[row].item() / NODE_SPACING), round(arcs.end[row].item() / NODE_SPACING) + 1
    assert torch.equal(arcs.flown[row], long.flown[row, begin : LEAD_NODES + end])
    last = round(arcs.end[row].item() / PLAN_STEP) + 1
    assert torch.equal(arcs.planned[row], whole[row, last - arcs.planned.shape[1] : last])


def test_extend_and_grow_give_the_nodes_of_a_longer_solve(recording, solve_arcs, make_arcs, backend):
    initials = recording("windows")["ic"]
    long, view = solve_arcs(initials, 6, backend=backend)
    moved, grown = (make_arcs(initials, 3, backend=backend) for _ in range(2))
    rows = torch.tensor([0, 3])
    for _ in range(2):
        moved.extend(rows)
        grown.grow()
    assert moved.start.tolist() == [2 * ARC_SEGMENT, 0.0, 0.0, 2 * ARC_SEGMENT, 0.0]
    assert grown.length == 5 * ARC_SEGMENT
    for row in range(5):
        assert_same_arcs(moved, row, long, view.samples.table)
        assert_same_arcs(grown, row, long, view.samples.table)


def test_arcs_that_start_at_different_times_grow_together(recording, solve_arcs, make_arcs, backend):
    initials = recording("windows")["ic"]
    long, view = solve_arcs(initials, 5, backend=backend)
    arcs = make_arcs(initials, 2, backend=backend)
    arcs.extend(torch.tensor([1, 4]))
    arcs.extend(torch.tensor([4]))
    arcs.grow()
    assert arcs.end.tolist() == [hours * ARC_SEGMENT for hours in (3, 4, 3, 3, 5)]
    for row in range(5):
        assert_same_arcs(arcs, row, long, view.samples.table)


@pytest.mark.parametrize("part", [[0], [4, 2], [0, 1, 2]], ids=str)
def test_rows_are_extended_as_if_alone(part, recording, make_arcs, backend):
    """Bit for bit, whichever others move on with them."""
    initials = recording("windows")["ic"]
    together, arcs = (make_arcs(initials, 2, backend=backend) for _ in range(2))
    together.extend(torch.arange(5))
    arcs.extend(torch.tensor(part))
    assert list(arcs)
    for name in arcs:
        assert torch.equal(getattr(arcs, name)[part], getattr(together, name)[part])


def test_plans_are_kept_up_to_their_length(recording, solve_arcs, backend, make_arcs):
    initials = recording("windows")["ic"]
    arcs, view = solve_arcs(initials, PLANNED_SEGMENTS + 2, backend=backend)
    assert view.samples.table.shape[1] == 2 * (arcs.flown.shape[1] - LEAD_NODES) - 1
    kept = arcs.planned
    assert kept.shape[1] == PLANNED_SEGMENTS * SAMPLES_PER_SEGMENT + 1
    assert arcs.planned_from.tolist() == [2 * ARC_SEGMENT] * 5
    assert torch.equal(kept, view.samples.table[:, 2 * SAMPLES_PER_SEGMENT :])
    arcs.grow()  # and those that grow keep what they have
    assert arcs.planned_from.tolist() == [2 * ARC_SEGMENT] * 5
    assert torch.equal(arcs.planned[:, :-SAMPLES_PER_SEGMENT], kept)
    arcs.extend(torch.arange(5))
    assert arcs.planned_from.tolist() == [3 * ARC_SEGMENT] * 5
    assert torch.equal(arcs.planned[:, : -2 * SAMPLES_PER_SEGMENT], kept[:, SAMPLES_PER_SEGMENT:])
    arcs = make_arcs(recording("windows")["ic"][:1], PLANNED_SEGMENTS - 1, backend=backend)
    assert arcs.planned.shape[1] == (PLANNED_SEGMENTS - 1) * SAMPLES_PER_SEGMENT + 1


def test_both_arcs_start_where_the_satellite_is(recording, solve_arcs, backend):
    initials = recording("windows")["ic"]
    arcs, view = solve_arcs(initials, 1, backend=backend)
    r = torch.tensor([initial["rN"] for initial in initials], dtype=torch.float64)
    assert torch.equal(arcs.flown[:, LEAD_NODES], r)
    assert torch.equal(view.samples.table[:, 0], r)


def test_the_sky_covers_the_arcs(recording, make_arcs):
    arcs = make_arcs(recording("windows")["ic"], 2)
    arcs.extend(torch.tensor([1, 4]))
    arcs.grow()
    assert arcs.ephemeris.shape == (5, 5, EPHEMERIS_TRACK.width)
    assert torch.equal(arcs.ephemeris, ephemeris_records(arcs.et + arcs.start, 5))
    samples = dict(zip(("ephemeris", "arc"), arcs.tracks((EPHEMERIS_TRACK, ARC)), strict=True))
    assert samples["ephemeris"].table is arcs.ephemeris
    assert samples["arc"].table is arcs.flown
    assert torch.equal(samples["ephemeris"].start, arcs.start)
    assert torch.equal(samples["arc"].start, arcs.start - LEAD_NODES * NODE_SPACING)
    assert arcs.end.tolist() == [3 * ARC_SEGMENT, 4 * ARC_SEGMENT, 3 * ARC_SEGMENT, 3 * ARC_SEGMENT, 4 * ARC_SEGMENT]


def test_rows_are_reset_and_adopted_by_themselves(recording, make_arcs, backend):
    initials = recording("windows")["ic"]
    arcs, other = make_arcs(initials, 2, backend=backend), make_arcs(initials[::-1], 2, backend=backend)
    other.extend(torch.tensor([1]))
    before = {name: getattr(arcs, name).clone() for name in arcs}
    arcs.copy_rows(torch.tensor([1, 3]), other, torch.tensor([1, 3]))
    assert before
    for name in arcs:
        assert torch.equal(getattr(arcs, name)[[1, 3]], getattr(other, name)[[1, 3]])
        assert torch.equal(getattr(arcs, name)[[0, 2, 4]], before[name][[0, 2, 4]])
    r, v = (torch.tensor([initials[k][name] for k in (1, 3)], dtype=torch.float64) for name in ("rN", "vN"))
    arcs.solve(torch.tensor([1, 3]), before["et"][[1, 3]], r, v)
    for name in arcs:
        assert torch.equal(getattr(arcs, name), before[name])


@pytest.mark.parametrize("part", [[0], [3, 11], list(range(9)), list(range(47)), list(range(60, 1, -1))], ids=len)
def test_rows_do_not_depend_on_the_batch(part, solve_arcs, backend):
    """Bit for bit, for batches on both sides of the block of the matrix product and of the lanes of a kernel."""
    initials = orbits(100)
    (whole, _), (some, _) = (solve_arcs(batch, 1, backend=backend) for batch in (initials, [initials[k] for k in part]))
    for name in ("flown", "planned", "tail"):
        assert torch.equal(getattr(some, name), getattr(whole, name)[part])


@pytest.mark.parametrize(("seconds", "spans"), [(0.0, 1), (1.0, 1), (3600.0, 1), (3600.1, 2), (28800.0, 8)])
def test_spans(seconds, spans):
    assert segments_for(seconds) == spans


def test_nodes_are_met(make_arcs, backend):
    arcs = make_arcs(orbits(2), 1, backend=backend)
    for row in range(2):
        r, _ = flown(arcs, row, NODE_SPACING * torch.arange(61, dtype=torch.float64))
        torch.testing.assert_close(r, arcs.flown[row, LEAD_NODES:], rtol=0, atol=2e-6)  # rounding at the edges; measured 3e-7


@pytest.mark.parametrize("initial", [above(5e5, 0.0, 0.9, 2.0), above(3.5e5, 0.2, 1.0, 0.0)], ids=["low", "eccentric"])
def test_no_jump_between_nodes(initial, make_arcs, backend):
    """Neighbouring polynomials meet within a micrometre and a tenth of the bound against Basilisk."""
    arcs = make_arcs([initial], 1, backend=backend)
    nodes = NODE_SPACING * torch.arange(5, 55, dtype=torch.float64)
    before, after = flown(arcs, 0, nodes - 1e-6), flown(arcs, 0, nodes + 1e-6)
    moved = 0.5 * (before[1] + after[1]) * 2e-6
    # rounding: clocks of 3600 s to 5e-13 s, positions of 7e6 m to 1e-9 m
    torch.testing.assert_close(after[0] - before[0], moved, rtol=0, atol=1e-6)
    torch.testing.assert_close(after[1], before[1], rtol=0, atol=2e-5 + 1e-7)  # 9 m/s^2 for two microseconds


def test_ticks_follow_the_arc(make_arcs):
    """follow_arc on a bus is what the lookups above do."""
    arcs = make_arcs(orbits(1), 1)
    bus = SimpleNamespace(arc=[SimpleNamespace(r_BN_N=Vec3.of(node)) for node in arcs.flown[0, 7:17].unsqueeze(1)])
    bus.arc_tau = torch.tensor([23.5], dtype=torch.float64)
    follow_arc(bus)
    r, v = flown(arcs, 0, torch.tensor([(7 + ARC.before - LEAD_NODES) * NODE_SPACING + 23.5], dtype=torch.float64))
    assert torch.equal(bus.r_BN_N.stack(), r)
    assert torch.equal(bus.v_BN_N.stack(), v)
