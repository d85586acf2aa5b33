from __future__ import annotations

import math

import pytest
import torch

from bsk_torch.astro.ephemeris import (
    EARTH_ROTATION_RATE,
    earth_orientation,
    earth_orientation_rate,
    sun_position,
    sun_state,
)
from bsk_torch.astro.gravity import DEGREE, field, field_weights, third_body
from bsk_torch.astro.integrate import rk4_step
from bsk_torch.astro.orbit import Elements, elements_to_rv, hill_frame
from bsk_torch.constants import MU_EARTH
from bsk_torch.sim.orbit import position_on_arc, spans_for
from bsk_torch.sim.span import PLAN_STEP, SPACING, SPAN, first_node, padded, pole_matrix
from bsk_torch.vec3 import Mat3, Vec3
from tests.astro.test_gravity import disturbing_potential

BASILISK = 1e-3  # m; measured: 1.0e-4 over five orbits (nominal), 2e-5 over two (eccentric)
BASILISK_SPEED = 1e-6  # m/s; measured: 1.1e-7


def flown(arcs, row: int, time: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
    """Position and velocity of one row at times [m], each looked up as a tick does."""
    nodes, first = arcs.nodes(torch.full(time.shape, row), time, 3)
    r, v = position_on_arc(nodes.flatten(1).unbind(1), first - time, torch.zeros((), dtype=torch.float64))
    return r.stack(), v.stack()


@pytest.mark.parametrize("name", ["nominal", "eccentric"])
def test_flown_arcs_against_basilisk(name, recording, make_arcs):
    episodes = recording(name)
    arcs = make_arcs(episodes["ic"], spans_for(episodes["env"]["time_limit"]))
    states = torch.tensor(episodes["state"]).split([n + 1 for n in episodes["length"].tolist()])
    for row, state in enumerate(states):
        r, v = flown(arcs, row, state[:, 0])
        assert (r - state[:, 1:4]).norm(dim=-1).amax() < BASILISK
        assert (v - state[:, 4:7]).norm(dim=-1).amax() < BASILISK_SPEED


@pytest.mark.parametrize(("name", "step"), [("half_second", 0.5), ("two_seconds", 2.0)])
def test_ticks_of_other_lengths(name, step, recording, make_arcs):
    """Basilisk's frame stretch depends on the step: 2 s flown as 1 s would be 0.2 m off."""
    episodes = recording(name)
    state = torch.tensor(episodes["state"])
    r, _ = flown(make_arcs(episodes["ic"], 2, step), 0, state[:, 0])
    assert (r - state[:, 1:4]).norm(dim=-1).amax() < BASILISK
    other, _ = flown(make_arcs(episodes["ic"], 2, 4.0 * step), 0, state[:, 0])
    assert (other - state[:, 1:4]).norm(dim=-1).amax() > BASILISK


def test_planned_arc_against_a_runge_kutta_of_thirty_seconds(recording, make_arcs):
    """The propagation that bsk_rl looks ahead on: the Earth's orientation at the start of a step, extrapolated linearly."""
    initials, weights = recording("windows")["ic"], field_weights(DEGREE)
    arcs = make_arcs(initials, 1)
    y = tuple(Vec3.of(torch.tensor([initial[k] for initial in initials], dtype=torch.float64)) for k in ("rN", "vN"))
    for k in range(round(SPAN / PLAN_STEP)):
        et = arcs.et + k * PLAN_STEP
        C, C_rate = earth_orientation(et), earth_orientation_rate(et)
        sun = [Vec3.of(x) for x in sun_state(et)]

        def rates(stage, offset, y, C=C, C_rate=C_rate, sun=sun):
            PN = Mat3.of(C + C_rate * offset)
            return y[1], PN.mT @ field(PN @ y[0], weights) + third_body(y[0], sun[0] + sun[1] * offset)

        y = rk4_step(rates, y, PLAN_STEP)
    end = torch.full((len(initials),), SPAN, dtype=torch.float64)
    planned = arcs.planned_position(torch.arange(len(initials)), end)
    # measured 0.024 m, which is 3 us of motion; the truncation error that the plan reproduces is 8 to 52 m
    assert (planned - y[0]).norm().amax() < 0.05
    assert (Vec3.of(arcs.flown[:, -1, :3]) - y[0]).norm().amin() > 5.0


def test_extend_and_grow_give_the_nodes_of_a_longer_solve(recording, make_arcs):
    initials = recording("windows")["ic"]
    long, short, grown = make_arcs(initials, 5), make_arcs(initials, 3), make_arcs(initials, 3)
    rows = torch.tensor([0, 3])
    short.extend(rows, 2)
    begin = round(2 * SPAN / SPACING)
    assert torch.equal(short.flown[rows], long.flown[rows, begin:])
    assert torch.equal(short.planned[rows], long.planned[rows, begin:])
    assert short.start.tolist() == [2 * SPAN, 0.0, 0.0, 2 * SPAN, 0.0]
    others = torch.tensor([1, 2, 4])
    assert torch.equal(short.flown[others], long.flown[others, : short.flown.shape[1]])
    grown.grow()
    grown.grow()
    assert torch.equal(grown.flown, long.flown)
    assert torch.equal(grown.planned, long.planned)
    assert grown.length == long.length == 5 * SPAN


def test_arcs_that_start_at_different_times_grow_together(recording, make_arcs):
    initials = recording("windows")["ic"]
    arcs, long = make_arcs(initials, 2), make_arcs(initials, 5)
    arcs.extend(torch.tensor([1, 4]), 1)
    arcs.extend(torch.tensor([4]), 1)
    arcs.grow()
    for row, spans in enumerate((0, 1, 0, 0, 2)):
        begin = round(spans * SPAN / SPACING)
        assert torch.equal(arcs.flown[row], long.flown[row, begin : begin + arcs.flown.shape[1]])


def orbits(n: int) -> list[dict]:
    u = torch.rand(5, n, dtype=torch.float64)
    zero = torch.zeros(n, dtype=torch.float64)
    oe = Elements(6.8e6 + 1e6 * u[0], 0.02 * u[1], math.pi * u[2], 6 * u[3], zero, 6 * u[4])
    r, v = (x.stack().tolist() for x in elements_to_rv(oe))
    epochs = [f"20{k % 20:02d} JAN 01 00:00:00" for k in range(n)]
    return [{"utc_init": epoch, "rN": a, "vN": b} for epoch, a, b in zip(epochs, r, v, strict=True)]


@pytest.mark.parametrize("part", [[0], [3, 11], list(range(47)), list(range(60, 1, -1))])
def test_rows_do_not_depend_on_the_batch(part, make_arcs):
    """Bit for bit, for batches on both sides of the block of the matrix product."""
    initials = orbits(100)
    whole, some = make_arcs(initials, 1), make_arcs([initials[k] for k in part], 1)
    assert torch.equal(some.flown, whole.flown[part])
    assert torch.equal(some.planned, whole.planned[part])


@pytest.mark.parametrize("count", [1, 47, 48, 49, 100])
def test_padding(count):
    rows = padded(count, torch.device("cpu"))
    assert len(rows) % 48 == 0
    assert len(rows) - count < 48
    assert rows[:count].tolist() == list(range(count))
    assert (rows[count:] == count - 1).all()


def test_jacobi_integral_and_momentum_of_a_long_flight(make_arcs):
    """In the turning field ``v^2 / 2 - U - omega h_z`` is constant; the Sun changes it by some 1e-7."""
    arcs = make_arcs(orbits(20), 4)
    times = SPACING * torch.arange(arcs.flown.shape[1])
    PN, pole = earth_orientation(arcs.et.unsqueeze(-1) + times), pole_matrix(arcs.et + 2 * SPAN)
    r, v = arcs.flown[..., :3], arcs.flown[..., 3:6]
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


def test_first_node_has_the_acceleration_of_earth_and_sun(recording, make_arcs):
    arcs = make_arcs(recording("windows")["ic"], 1)
    node = arcs.flown[:, 0]
    assert torch.equal(node, first_node(arcs.et, node[:, :3], node[:, 3:6]))
    downward = (node[:, :3] * node[:, 6:]).sum(-1) / node[:, :3].norm(dim=-1)
    assert downward == pytest.approx([-8.4] * 5, abs=0.15)
    HN = hill_frame(Vec3.of(node[:, :3]), Vec3.of(node[:, 3:6]))
    assert (HN @ Vec3.of(node[:, 6:])).z.abs().amax() < 0.02  # J2 out of the plane
    sun = third_body(Vec3.of(node[:, :3]), Vec3.of(sun_position(arcs.et))).norm()
    assert (sun > 1e-7).all()


def test_nodes_and_velocities_are_consistent(make_arcs):
    """The stored accelerations are the derivative of the stored velocities (eighth-order differences of a minute)."""
    arcs = make_arcs(orbits(10), 1)
    v, a = arcs.flown[..., 3:6], arcs.flown[..., 6:]
    centre = torch.arange(4, v.shape[1] - 4)
    weights = ((1, 4 / 5), (2, -1 / 5), (3, 4 / 105), (4, -1 / 280))
    measured = sum(w * (v[:, centre + k] - v[:, centre - k]) for k, w in weights) / SPACING
    torch.testing.assert_close(measured, a[:, centre], rtol=0, atol=1e-6)  # (n 60 s)^8 / 630 of 9 m/s^2, and the tesserals'


@pytest.mark.parametrize(("seconds", "spans"), [(0.0, 1), (1.0, 1), (3600.0, 1), (3600.1, 2), (28800.0, 8)])
def test_spans(seconds, spans):
    assert spans_for(seconds) == spans


def test_nodes_around_a_time(make_arcs):
    arcs = make_arcs(orbits(1), 1)
    for time, first in ((0.0, 0.0), (59.999, 0.0), (60.0, 60.0), (3599.0, 3480.0), (3600.0, 3480.0)):
        nodes, at = arcs.nodes(torch.tensor([0]), torch.tensor([time], dtype=torch.float64), 3)
        assert at.item() == first
        index = round(first / SPACING)
        assert torch.equal(nodes[0], arcs.flown[0, index : index + 3])


def test_no_jump_between_nodes(make_arcs):
    """A segment uses three nodes; the second interval continues the first."""
    arcs = make_arcs(orbits(1), 1)
    nodes, first = arcs.nodes(torch.tensor([0]), torch.tensor([10.0], dtype=torch.float64), 3)
    planes = nodes.flatten(1).unbind(1)
    at = [position_on_arc(planes, first - 10.0, torch.tensor(tau, dtype=torch.float64)) for tau in (50.0 - 1e-9, 50.0)]
    torch.testing.assert_close(at[0][0].stack(), at[1][0].stack(), rtol=0, atol=1e-4)  # 8 km/s for a nanosecond
    assert torch.equal(at[1][0].stack(), arcs.flown[:, 1, :3])
    end = position_on_arc(planes, first - 10.0, torch.tensor(110.0, dtype=torch.float64))
    torch.testing.assert_close(end[0].stack(), arcs.flown[:, 2, :3], rtol=0, atol=1e-8)
