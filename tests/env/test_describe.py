"""The list of the state, and names of one quantity that lead to one another."""

import logging

import pytest

import bsk_torch
from bsk_torch import craft, rand, sats
from bsk_torch.sim import dyn, fsw
from bsk_torch.sim.names import SAME
from bsk_torch.sim.simulator import MANY_TICKS
from tests.support.refusals import check_refusals, refusal


@pytest.fixture(scope="module")
def env():
    env = bsk_torch.make("NadirScan-v1", num_envs=3, backend="eager", seed=0, sat_args={"batteryStorageCapacity": 7e5})
    env.reset()
    return env


def test_every_field_has_a_line_and_names_of_one_quantity_exist(env):
    lines = env.state.describe().splitlines()
    assert max(map(len, lines)) <= 80
    state = env.satellite.simulator.state
    assert {*state.layout.fields} <= {line.split()[0] for line in lines}
    charge = env.state.describe().partition("  charge ")[2].partition("  packet ")[0]
    low, high = state.read("charge").min().item(), state.read("charge").max().item()
    for word in ("W s", f"{low:.4g} to {high:.4g}", "storedCharge_Init", "battery_charge_fraction"):
        assert word in " ".join(charge.split())
    # The table has no name that is neither a field, an argument nor a property.
    state, dynamics = env.satellite.simulator.state, env.satellite.dynamics
    assert SAME
    for names in SAME:
        assert names[0] in state.layout.fields
        for name in names[1:]:
            assert name in state.arguments or name in ("rN", "vN") or hasattr(dynamics, name), name


def test_another_name_of_a_quantity_leads_to_the_right_one(env):
    def made(**sat_args):
        return bsk_torch.make("NadirScan-v1", backend="eager", sat_args=sat_args)

    class Steered(sats.Satellite):
        observation_spec, action_spec = (bsk_torch.obs.Time(),), (bsk_torch.act.Charge(),)
        dyn_type, fsw_type = dyn.ImagingDynModel, fsw.SteeringImagerFSWModel

    def steered(law):
        return bsk_torch.SatelliteTasking(Steered("A", craft.imager(law=law)), backend="eager")

    assert steered("steering").num_envs == 1
    check_refusals(
        refusal(lambda: env.record(["storedCharge_Init"]), ValueError, "'storedCharge_Init'", "did you mean 'charge'"),
        refusal(lambda: env.record(["wheelSpeeds"]), ValueError, "did you mean 'Omega_WB_B'"),
        refusal(lambda: made(charge=1.0), KeyError, "sat_args['charge']", "did you mean 'storedCharge_Init'"),
        refusal(lambda: made(storage_level=1.0), KeyError, "did you mean 'storageInit'"),
        refusal(lambda: steered("feedback"), KeyError, "sat_args['K']", "law='steering'"),
        refusal(lambda: bsk_torch.satelites, AttributeError, "'satelites'", "did you mean"),
        refusal(lambda: made(mu=1e20).reset(), ValueError, "sat_args['mu']=1e+20", "oe"),
        refusal(lambda: rand.Uniform(1.0, 0.0), ValueError, "low=1.0", "high=0.0"),
        refusal(lambda: rand.Uniform([0.0, 2.0], 1.0), ValueError, "low=[0.0, 2.0]", "high=1.0"),
    )


def test_eager_ticks_warn_once_of_their_cost(env, monkeypatch, caplog):
    simulator = env.satellite.simulator
    monkeypatch.setattr(simulator.runners.run, "ticks_run", MANY_TICKS - 1)
    with caplog.at_level(logging.WARNING):
        for _ in range(3):
            env.rand_step()
    assert [record.message.count("backend='eager'") for record in caplog.records] == [1]
