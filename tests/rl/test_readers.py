"""Observations read by name and in units."""

import pytest
import torch

import bsk_torch
from bsk_torch import obs
from bsk_torch.presets.nadir_scan import ScanningSatellite, scanning_args
from tests.support.refusals import check_refusals, refusal

pytestmark = pytest.mark.compiled


def same(a, b):
    return torch.allclose(a.double(), b.double(), rtol=1e-5, atol=1e-6)  # observations are float32


@pytest.mark.parametrize("options", [{}, {"as_set": True}])
def test_reads_the_quantities_of_an_imager(options):
    env = bsk_torch.make("AEOSPower-v1", num_envs=3, n_targets=100, **options)
    now, satellite, see = env.reset()["observation"], env.satellite, bsk_torch.reader(env)
    assert same(see(now, "omega_BH_H"), satellite.dynamics.omega_BH_H)
    assert same(see(now, "battery_charge_fraction"), satellite.dynamics.battery_charge_fraction)
    targets = satellite.find_next_opportunities(32, "target")
    assert same(see(now, "target.opportunity_close"), targets.close)  # at the reset, the time is 0
    assert same(see(now, "priority"), env.scenario.priority.gather(1, targets.place))
    assert see(now, "r_LB_H").shape == (3, 32, 3)
    passes = satellite.find_next_opportunities(1, "ground_station")
    assert same(see(now, "ground_station.opportunity_open"), passes.open.squeeze(1))
    start, _ = satellite.next_eclipse(sampled=True)  # as this preset observes it
    assert same(see(now, "eclipse")[:, 0], start)
    if options:
        assert torch.equal(see(now, "target.mask").bool(), targets.mask)
    with pytest.raises(KeyError, match=r"target.opportunity_open, ground_station.opportunity_open"):
        see(now, "opportunity_open")


def test_named_observations_vectors_and_noise_read_alike():
    class Noisy(ScanningSatellite):
        observation_spec = (obs.Noisy(ScanningSatellite.observation_spec[0], 0.0), *ScanningSatellite.observation_spec[1:])

    def made(kind, **options):
        return bsk_torch.SatelliteTasking(kind("S", scanning_args(), **options), num_envs=2, time_limit=400.0, seed=0)

    one, other = made(ScanningSatellite), made(Noisy, obs_type=dict)
    vector, named = one.reset()["observation"], other.reset()["observation"]
    see, look = bsk_torch.reader(one), bsk_torch.reader(other)
    assert see.quantities.keys() == look.quantities.keys()
    for name in see.quantities:
        assert torch.equal(see(vector, name), look(named, name))
        assert torch.equal(see(vector, name), look(named.to_dict(), name))
    assert float(see(vector, "solar_pointing_error").max()) > 1.0  # radians, not fractions of half a turn
    assert same(see(vector, "solar_pointing_error"), one.satellite.dynamics.solar_pointing_error)


def test_satellites_of_a_constellation_are_read_together():
    env = bsk_torch.make("AEOSConstellation-v1", num_envs=2, n_targets=100)
    see = bsk_torch.reader(env)
    now = env.reset()["agents", "observation"]
    assert see(now, "priority").shape == (2, 3, 32)
    check_refusals(
        refusal(lambda: see(now, "prioriti"), KeyError, "'prioriti'", "'priority'"),
        refusal(lambda: bsk_torch.reader(bsk_torch.make("RelayConstellation-v1", n_targets=50)), ValueError, "alike"),
    )
