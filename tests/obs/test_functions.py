"""Functions and properties of users are batched: observed for all environments, each with its own value."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from bsk_torch import SatelliteTasking, act, dyn, obs, sats, scene
from tests.support.refusals import check_refusals, refusal

pytestmark = pytest.mark.compiled


class OwnDynModel(dyn.ImagingDynModel):
    @property
    def speed_of_all(self):
        return self.v_BN_N.norm(dim=-1)

    @property
    def altitude(self):
        return np.linalg.norm(self.r_BN_N) - 6371e3


class Own(obs.Observation):
    def get_obs(self):
        return {"speed": self.satellite.dynamics.v_BN_N.norm(dim=-1).numpy(), "list": self.simulator.sim_time}


SPEC = (
    obs.SatProperties(
        dict(prop="speed_of_all", norm=None),
        dict(fn=lambda sat: sat.dynamics.wheel_speeds_fraction**2, norm=2.0),
        dict(fn=lambda sat: sat.sat_args["wheelSpeeds"], name="speeds", norm=[1.0, 2.0, 4.0]),
        dict(prop="pair", fn=lambda sat: [sat.dynamics.battery_charge_fraction, 1.0]),
        dict(prop="battery_charge", module="dynamics", fn=lambda sat: np.sin(sat.dynamics.battery_charge)),
    ),
    obs.OpportunityProperties(
        dict(fn=lambda sat, opp: opp["object"].priority),
        dict(prop="wait", fn=lambda sat, opp: opp["window"][0] - sat.simulator.sim_time.unsqueeze(-1), norm=100.0),
        dict(prop="priority"),
        dict(prop="opportunity_open", norm=100.0),
        n_ahead_observe=2,
    ),
    Own("own"),
)


def make(num_envs, spec=SPEC, dyn_type=OwnDynModel, **options):
    satellite = type(
        "Imager", (sats.ImagingSatellite,), dict(observation_spec=spec, action_spec=(act.Image(2),), dyn_type=dyn_type)
    )
    given = dict(time_limit=600.0, seed=1, dtype=torch.float64) | options
    return SatelliteTasking(satellite("A", obs_type=dict), scene.UniformTargets(100), num_envs=num_envs, **given)


@pytest.fixture(scope="module")
def three():
    """A batch as large as vectors are wide."""
    env = make(3)
    return env, env.reset()["observation"]


def test_every_environment_has_its_own_value(three):
    env, seen = three
    dynamics, own = env.satellite.dynamics, seen["sat_props"]
    assert torch.equal(own["speed_of_all"], dynamics.v_BN_N.norm(dim=-1))
    assert torch.equal(own["prop_1_normd"], dynamics.wheel_speeds_fraction**2 / 2.0)
    assert torch.equal(own["speeds"], env.satellite.sat_args["wheelSpeeds"] / torch.tensor([1.0, 2.0, 4.0]))
    assert torch.equal(own["pair"], torch.stack([dynamics.battery_charge_fraction, torch.ones(3)], -1))
    assert torch.allclose(own["battery_charge"], torch.sin(dynamics.battery_charge))
    assert torch.allclose(seen["own", "speed"], own["speed_of_all"])
    assert seen["own", "list"].tolist() == [0.0] * 3


def test_every_opportunity_has_its_own_value(three):
    seen = three[1]
    for k in range(2):
        row = seen["target", f"target_{k}"]
        assert torch.equal(row["prop_0"], row["priority"])
        assert torch.allclose(row["wait_normd"], row["opportunity_open_normd"])


class Constant(obs.Observation):
    def get_obs(self):
        return 42


def test_rejects_functions_of_one_satellite():
    kind = dict(fn=lambda sat, opp: opp["type"] == "target")
    table = [
        (obs.SatProperties(dict(prop="unit", fn=lambda sat: np.linalg.norm(sat.dynamics.r_BN_N))), "'unit' of 'sat_props'"),
        (obs.SatProperties(dict(prop="both", fn=lambda sat: sat.dynamics.r_BN_N.astype(float))), "'both' of 'sat_props'"),
        (obs.SatProperties(dict(prop="if", fn=lambda sat: 1 if float(sat.simulator.sim_time) else 0)), "'if' of 'sat_props'"),
        (obs.SatProperties(dict(prop="altitude")), "'altitude' of 'sat_props', OwnDynModel.altitude"),
        (obs.OpportunityProperties(kind, n_ahead_observe=2), "'prop_0' of 'target'"),
        (Constant("constant"), "Constant.get_obs()"),
    ]
    check_refusals(
        refusal(lambda n=n, entry=entry: make(n, (entry,)), TypeError, name, "[", "bsk_torch.bsk_rl")
        for entry, name in table
        for n in (1, 3)
    )


def test_an_environment_alone_observes_the_same(three):
    alone = make(1).reset()["observation"]
    for name in ("speed_of_all", "speeds", "pair"):
        assert torch.equal(alone["sat_props", name][0], three[1]["sat_props", name][0])


def test_names_of_entries():
    def named(sat, opp):
        return opp["object"].priority

    entries = (dict(fn=named), dict(fn=named, norm=2.0), dict(prop="a", fn=named, norm=None), dict(prop="b", fn=named, norm=3))
    spec = obs.OpportunityProperties(*entries, n_ahead_observe=1)
    assert [entry["name"] for entry in spec.entries] == ["prop_0", "prop_1_normd", "a", "b_normd"]


def test_an_array_means_a_vector_and_a_list_too():
    satellites = [sats.Satellite("A", obs_type=kind) for kind in (np.ndarray, list, torch.Tensor, dict)]
    assert [satellite.obs_type for satellite in satellites] == [torch.Tensor] * 3 + [dict]
    with pytest.raises(ValueError, match=r"obs_type=<class 'tuple'> must be dict, or one of torch.Tensor, np.ndarray and list"):
        sats.Satellite("A", obs_type=tuple)


def test_the_norm_of_an_eclipse_may_be_the_period():
    spec = (obs.Eclipse(norm=None, name="orbits"), obs.Eclipse())
    env = make(2, spec)
    seen = env.reset()["observation"]
    a, mu = env.satellite.dynamics.semi_major_axis, env.satellite.sat_args["mu"]
    assert torch.allclose(seen["orbits"], seen["eclipse"] / (2 * torch.pi * (a**3 / mu).sqrt()).unsqueeze(-1))


def test_eclipses_of_a_high_orbit():
    """1,070 km high: right by default, as Skyfield has them; bsk_rl's search fails, and names the first second after reset."""

    class High(sats.Satellite):
        observation_spec = (obs.Eclipse(), obs.Eclipse(name="theirs", sampled=True))
        action_spec = (act.Drift(duration=6300.0),)

    args = dict(oe=None, rN=[3050019.655, -2957948.288, 6118860.057], vN=[-4133.239051, 4357.33309, 4168.573976])

    def seen(seconds=None, **options):
        world = dict(utc_init="2025-07-17T12:00:00Z")
        env = SatelliteTasking(High("A", args, obs_type=dict), world_args=world, time_limit=600.0, backend="eager", **options)
        td = env.reset()
        if seconds is not None:
            env.simulator.state.ticks = env.simulator.state.ticks + seconds
            env.simulator.state.touch()
            td = env.observe()
        return [td["observation", name][0].tolist() for name in ("eclipse", "theirs")]

    mine, theirs = seen()
    assert mine == pytest.approx([4002.0, 6037.0], abs=1.0)  # the umbra, seconds within Skyfield's 3998 and 6042
    assert theirs == [1.0, 1.0]
    assert seen(compat="bsk_rl") == [[1.0, 1.0], [4020.0, 6060.0]]  # the second query sees what the first has searched
    mine, theirs = seen(6300)
    assert mine[0] == pytest.approx(4100.0, abs=20.0)
    assert mine[1] > mine[0]
    assert theirs == [-6299.0, -6299.0]
