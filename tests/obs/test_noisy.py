"""Noise is new at every decision, the same for equal environments, and nothing but observations has it."""

import pytest
import torch
from tensordict import TensorDict

from bsk_torch import ConstellationTasking, SatelliteTasking, act, obs, rand, sats, scene

TARGETS = obs.OpportunityProperties(dict(prop="priority"), n_ahead_observe=3)
SPEC = (
    obs.Noisy(obs.SatProperties(dict(prop="r_BN_N", norm=1e7), dict(prop="wheel_speeds_fraction")), 0.01),
    obs.Noisy(TARGETS, rand.Uniform(-0.1, 0.1), bias={"priority": 0.5}),
    obs.SatProperties(dict(prop="r_BN_N", norm=1e7), name="true"),
)


def imager(spec=SPEC):
    attributes = dict(observation_spec=spec, action_spec=(act.Image(2), act.Drift(duration=60.0)))
    return type("Imager", (sats.ImagingSatellite,), attributes)


def make(num_envs=4, spec=SPEC, obs_type=torch.Tensor, **options):
    given = dict(time_limit=600.0, seed=1, backend="eager", dtype=torch.float64) | options
    return SatelliteTasking(imager(spec)("A", obs_type=obs_type), scene.UniformTargets(100), num_envs=num_envs, **given)


def drift(env):
    return env.step(TensorDict({"action": torch.full((env.num_envs,), 2)}, [env.num_envs]))["next"]


@pytest.fixture(scope="module")
def env():
    return make()


@pytest.fixture
def first(env):
    return env.set_seed(1), env.reset()["observation"]


def test_noise_differs_between_environments_decisions_and_numbers(env, first):
    seen = first[1]
    noise = [seen[:, :3] - seen[:, 9:], (after := drift(env)["observation"])[:, :3] - after[:, 9:]]
    every = torch.cat([part.flatten() for part in noise])
    assert len(every.unique()) == 24
    assert 0.004 < float(every.std()) < 0.02


def test_noise_is_that_of_the_decision_whatever_the_batch(env, first):
    observations = env.satellite.observations
    assert torch.equal(observations.get_vector(torch.float64), observations.get_vector(torch.float64))
    assert torch.equal(observations.vector(observations.get_dict(), torch.float64), first[1])
    alone = make(1, env_ids=[2])
    assert torch.equal(alone.reset()["observation"][0], first[1][2])
    noisy = env.satellite.observations.entries[0]
    assert torch.equal(noisy.observation.get_obs()["r_BN_N_normd"], first[1][:, 9:])
    priority = env.scenario.priority.gather(1, env.satellite.find_next_opportunities(3).place)
    assert torch.equal(env.satellite.observations.entries[1].observation.get_vector(), priority)


def test_noise_follows_seed_and_episode(env, first):
    again = env.reset()["observation"]
    env.set_seed(1)
    assert torch.equal(env.reset()["observation"], first[1])
    assert (again[:, :3] - again[:, 9:] != first[1][:, :3] - first[1][:, 9:]).all()


def test_a_bias_stays_for_an_episode(env, first):
    def error():
        entry = env.satellite.observations.entries[1]
        return entry.get_vector() - entry.observation.get_vector()

    before = error()
    drift(env)
    assert float((error() - before).abs().max()) < 0.2  # the uniform part
    assert float(before.abs().max()) > 0.2


def test_copies_of_an_episode_share_its_noise(env, first):
    other = make(2)
    other.reset()
    other.restore(env, torch.tensor([1]), torch.tensor([3]))
    assert torch.equal(drift(other)["observation"][1], drift(env)["observation"][3])
    saved = env.get_state()
    after = drift(env)["observation"]
    env.restore(saved)
    assert torch.equal(drift(env)["observation"], after)


def test_each_satellite_and_entry_of_a_constellation_has_its_own_noise():
    spec = tuple(obs.Noisy(obs.SatProperties(dict(fn=lambda sat: 0.0 * sat.dynamics.r_BN_N, name="zero")), 1.0) for _ in range(2))
    options = dict(num_envs=2, time_limit=600.0, seed=1, backend="eager", dtype=torch.float64)
    kind = imager(spec)
    satellites = [kind(name) for name in "AB"]
    env = ConstellationTasking(satellites, scene.UniformTargets(100), **options)
    noise = env.reset()["agents", "observation"]
    assert (noise.shape, len(noise.unique())) == ((2, 2, 6), 24)


def test_noise_by_name_leaves_the_rest():
    as_set = obs.OpportunityProperties(dict(prop="priority"), n_ahead_observe=2, as_set=True)
    named = obs.SatProperties(dict(prop="r_BN_N", norm=1e7), dict(prop="wheel_speeds_fraction"))
    spec = (
        obs.Noisy(named, {"wheel_speeds_fraction": rand.Choice([-1.0, 1.0])}),
        obs.Noisy(as_set, 0.1),
        obs.Noisy(obs.Time(), 0.0),
    )
    env = make(2, spec, dict)
    seen, entries = env.reset()["observation"], env.satellite.observations.entries
    true = entries[0].observation.get_obs()
    assert torch.equal(seen["sat_props", "r_BN_N_normd"], true["r_BN_N_normd"])
    assert torch.allclose(
        (seen["sat_props", "wheel_speeds_fraction"] - true["wheel_speeds_fraction"]).abs(), torch.ones(()).double()
    )
    assert seen["target", "mask"].tolist() == [[1.0, 1.0]] * 2
    assert (seen["target", "rows"] != entries[1].observation.get_obs()["rows"]).all()
    assert seen["time"].tolist() == [0.0, 0.0]
