"""Futures other than the true one: what copies share with the present, and what is drawn again."""

import pytest
import torch

import bsk_torch
from bsk_torch import obs, scene
from bsk_torch.lab.planners import Rollout
from bsk_torch.presets.nadir_scan import ScanningSatellite, scanning_args
from bsk_torch.rand import Key
from bsk_torch.scene import overlaid
from tests.lab.planners.conftest import same, scanning

pytestmark = pytest.mark.compiled


@pytest.fixture(scope="module")
def cloudy():
    """Three episodes under clouds."""
    return bsk_torch.make("CloudyAEOS-v1", num_envs=3, env_ids=[0] * 3, n_targets=400, time_limit=600.0)


def planted(env, rows, base, **options):
    """Copies of episodes ``rows`` in two futures each."""
    planner = Rollout(env, base, horizon=200.0, futures=2, **options)
    store = env.like(2 * len(rows))
    planner._plant(store, torch.arange(2 * len(rows)), torch.tensor(rows))
    return store


def test_futures_have_seeds_of_their_own_and_share_the_present():
    env = scanning(3)
    env.reseed([0, 1, 2])
    env.reset()
    store = planted(env, [0, 2], base="rule")
    seeds = store.state.seed
    assert len(set(seeds.tolist())) == 4
    assert not set(seeds.tolist()) & set(env.state.seed.tolist())
    store.state.seed = env.state.seed[torch.tensor([0, 0, 2, 2])]
    assert same(store.get_state(), env.get_state()[torch.tensor([0, 0, 2, 2])])


def test_futures_do_not_depend_on_other_rows_but_on_the_planner():
    env = scanning(3)
    env.reseed([0, 1, 2])
    env.reset()
    both, one = planted(env, [0, 2], base="rule"), planted(env, [2], base="rule")
    assert both.state.seed[2:].tolist() == one.state.seed.tolist()
    other = planted(env, [2], base="rule", seed=1)
    assert not set(other.state.seed.tolist()) & set(one.state.seed.tolist())


def test_noise_follows_from_the_future():
    """The true copy observes what the environment will; a drawn one does not."""

    class Blurred(ScanningSatellite):
        observation_spec = tuple(
            obs.Noisy(entry, 0.01) if isinstance(entry, obs.SatProperties) else entry
            for entry in ScanningSatellite.observation_spec
        )

    env = bsk_torch.SatelliteTasking(
        Blurred("S", scanning_args()), scene.UniformNadirScanning(), num_envs=1, time_limit=400.0, seed=0
    )
    env.reset()
    true, drawn = env.like(1), env.like(2)
    true.restore(env, [0], [0])
    planner = Rollout(env, "random", horizon=100.0, futures=2)
    planner._plant(drawn, torch.arange(2), torch.zeros(1, dtype=torch.int64))
    now = env.observe()["observation"][0]
    assert torch.equal(true.observe()["observation"][0], now)
    futures = drawn.observe()["observation"]
    assert not torch.equal(futures[0], now)
    assert not torch.equal(futures[0], futures[1])
    assert torch.allclose(futures, now, atol=0.2)


def test_planning_in_drawn_futures(cloudy):
    cloudy.set_seed(4)
    now = cloudy.reset()
    before = cloudy.get_state()
    planner = Rollout(cloudy, "hasty", horizon=120.0, budget=3, futures=2)
    first, again = planner(now.clone()), planner(now.clone())
    assert torch.equal(first["action"], again["action"])
    assert same(cloudy.get_state(), before)
    assert first["simulated_seconds"].tolist() == pytest.approx([3 * 2 * 120.0] * 3)


def test_clouds_that_are_drawn_again_agree_with_their_forecast(cloudy, monkeypatch):
    cloudy.set_seed(0)
    cloudy.reset()
    n = 60
    store = cloudy.like(n)
    store.restore(cloudy, torch.arange(n), torch.zeros(n, dtype=torch.int64))
    zeros = torch.zeros(n, dtype=torch.int64)
    monkeypatch.setattr(overlaid, "CANDIDATES", 256)
    store.scenario.draw_again(torch.arange(n), Key(torch.arange(n), zeros, zeros), store.fleet.sim_time)
    forecast, sigma = cloudy.scenario.cloud_forecast[0], cloudy.scenario.cloud_forecast_sigma[0]
    cover = store.scenario.cloud_cover
    assert bool(((cover >= 0.0) & (cover <= 1.0)).all())
    inner = (forecast > 0.2) & (forecast < 0.8)  # far from both ends: the posterior is normal about the forecast
    z = ((cover - forecast) / sigma)[:, inner]
    # 60 x about 170 values: standard errors 0.01; of 256 candidates about 5 lie within a standard deviation of 0.03
    assert (float(z.mean()), float(z.std())) == (pytest.approx(0.0, abs=0.1), pytest.approx(1.0, abs=0.15))
    assert float((cover[:, inner].std(0) == 0.0).double().mean()) < 0.05  # no single cover for all futures
    assert torch.equal(store.scenario.cloud_forecast[5], forecast)


def failing(n, seconds, **options):
    """Copies of one episode of FaultyScan-v1 with a fault of each kind, after some time."""
    env = bsk_torch.make("FaultyScan-v1", num_envs=n, env_ids=[0] * n, seed=2, chance=1.0, **options)
    td, rule = env.reset(), bsk_torch.rule("cautious", env)
    while float(env.fleet.sim_time.min()) < seconds:
        td = env.step(rule(td))["next"]
    return env


def fault_arguments(env):
    """Arguments of all faults, [N, ...], and whether those of a fault have happened, [N], by name."""
    [simulator] = env.fleet.simulators
    begun = {name.split(".")[0]: simulator.argument(name) <= simulator.sim_time for name in arguments_of(simulator, ".at")}
    values = {name: simulator.argument(name) for name in arguments_of(simulator, ".")}
    return values, {name: begun[name.split(".")[0]] for name in values}


def arguments_of(simulator, part):
    return [name for name in simulator.state.arguments if part in name]


def test_faults_that_have_happened_remain_and_those_to_come_differ_between_futures():
    env = failing(1, 8000.0)
    store = planted(env, [0], base="cautious")
    (true, happened), (drawn, _) = fault_arguments(env), fault_arguments(store)
    assert any(map(bool, happened.values()))
    assert not all(map(bool, happened.values()))
    for name, value in drawn.items():
        if happened[name]:
            assert torch.equal(value, true[name].expand_as(value)), name
        elif name.endswith(".at"):
            assert bool((value > env.fleet.sim_time).all()), name
    differ = {name for name, value in drawn.items() if not torch.equal(value[0], value[1])}
    assert {"panel.at", "panel.panelEfficiency", "battery.at", "battery.batteryStorageCapacity"} <= differ


def test_a_planner_with_futures_does_not_know_the_true_one():
    """Two episodes with the same past, of which only one has the faults that were drawn for it, are planned in the same way."""
    env = failing(2, 4000.0, time_limit=9000.0)
    key = Key(torch.tensor([77]), torch.zeros(1, dtype=torch.int64), env.episode[1:])
    env.fleet.simulators[0].draw_faults_again(torch.tensor([1]), key)
    values, _ = fault_arguments(env)
    assert not torch.equal(values["panel.at"][0], values["panel.at"][1])
    store = planted(env, [0, 1], base="cautious")
    state = store.get_state()
    assert same(state[:2], state[2:])


def test_without_faults_futures_change_no_decision():
    env = scanning(3)
    env.reseed([0, 1, 2])
    now = env.reset()
    options = {"horizon": 400.0, "gamma": 1.0}
    one, several = Rollout(env, "rule", **options)(now.clone()), Rollout(env, "rule", futures=2, **options)(now.clone())
    assert torch.equal(one["action"], several["action"])
    assert torch.equal(2.0 * one["simulated_seconds"], several["simulated_seconds"])


def test_arrivals_are_planned_for_without_knowing_them():
    """Episodes with the same past, of which the targets to come differ, are planned alike, also with a long look-ahead."""

    class Orders(scene.ChangingTargets, scene.UniformTargets):
        def draw(self, key):
            return super().draw(key) | {"arrival": 60.0 + 200.0 * key.named("arrival").uniform(self.most_targets)}

        def at(self, time):
            return self.drawn("target_priority"), self.drawn("arrival") <= time.unsqueeze(-1)

        def redraw(self, rows, key, time):
            return {"arrival": 60.0 + 200.0 * key.named("arrival").uniform(self.most_targets)}

    env = bsk_torch.make("AEOS-v1", num_envs=2, env_ids=[0] * 2, scenario=Orders(300), time_limit=400.0)
    env.reseed([5, 5])
    env.reset()
    env.fleet.scenario_state["arrival"][1] += 37.0
    env.scenario.begin_episodes(torch.tensor([1]))
    store = planted(env, [0, 1], base="hasty")
    assert torch.equal(store.scenario.drawn("arrival")[:2], store.scenario.drawn("arrival")[2:])
    assert not torch.equal(store.scenario.drawn("arrival")[0], store.scenario.drawn("arrival")[1])
