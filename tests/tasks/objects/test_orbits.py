"""Orbits of the objects of a catalog."""

import pytest
import torch

from bsk_torch.astro.interpolate import BEFORE, COUNT, positions
from bsk_torch.sim.component import neighbours
from bsk_torch.sim.orbit.flights import make_flights
from bsk_torch.tasks.objects.dyn import RSO_TRACK
from bsk_torch.tasks.objects.orbits import CatalogOrbits
from tests.sim.orbit.test_flights import CPU, start

pytestmark = pytest.mark.compiled


def orbits(episodes, objects):
    et, r, v = start(40)

    def states(envs):
        rows = envs.unsqueeze(-1) * objects + torch.arange(objects)
        return r[rows], v[rows]

    return CatalogOrbits(episodes, objects, make_flights(1.0, "compiled", CPU), lambda envs: et[envs], states)


def test_episodes_have_clocks_of_their_own():
    together, alone = orbits(3, 4), orbits(3, 4)
    together.catch_up(torch.tensor([0.0, 500.0, 90.0]).double())
    time = torch.tensor([0.0, 1000.0, 91.0]).double()
    together.catch_up(time)
    alone.catch_up(time)
    assert torch.equal(together.steps, alone.steps)
    # sums of steps that are made at once, or in two calls, are the same
    assert torch.equal(together.positions(time), alone.positions(time))


def test_a_reset_episode_begins_at_its_epoch():
    some = orbits(2, 4)
    some.catch_up(torch.full((2,), 700.0).double())
    some.reset(torch.tensor([1]))
    time = torch.tensor([700.0, 0.0]).double()
    some.catch_up(time)
    r_N, v_N = some.beginning(torch.tensor([1]))
    r, v, _ = some.states(torch.tensor([1]), torch.arange(4).unsqueeze(0), time, time)
    assert (r - r_N).abs().max() < 1e-6
    assert (v - v_N).abs().max() < 1e-6


@pytest.mark.parametrize("now", [0.0, 15.0, 30.0, 45.0, 60.0, 629.0, 660.0])
def test_nodes_of_a_run_are_on_the_orbits(now):
    """At both ends of a run, and one tick before it, as ticks interpolate."""
    some, later = orbits(2, 4), orbits(2, 4)
    some.catch_up(torch.full((2,), now).double())
    envs, place = torch.tensor([0, 1, 1]), torch.tensor([3, 0, 2])
    track = some.nodes(envs, place, torch.full((3,), now + 300.0).double())
    for time in (max(now - 1.0, 0.0), now, now + 100.0, now + 300.0):
        records, tau = neighbours(RSO_TRACK, track.table, torch.arange(3), torch.full((3,), time).double() - track.start)
        assert (RSO_TRACK.count, RSO_TRACK.before) == (COUNT, BEFORE)
        found = positions(records, tau / RSO_TRACK.spacing)
        whole = torch.full((2,), max(time, now)).double()
        later.catch_up(whole)
        wanted = later.states(envs, place.unsqueeze(-1), whole, torch.full((2,), time).double())[2]
        assert (found - wanted[:, 0]).abs().max() < 1e-4
