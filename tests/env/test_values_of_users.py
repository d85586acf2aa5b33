"""What users' functions and classes return is checked where it enters: shapes, kinds, NaN, and draws without a key."""

from __future__ import annotations

import pytest
import torch

from bsk_torch import ConstellationTasking, SatelliteTasking, act, data, obs, rand, sats, scene


def satellite(name: str = "A", args=None, **members) -> sats.Satellite:
    entries = dict(observation_spec=[obs.Time()], action_spec=[act.Drift(duration=10.0)])
    return type("Mine", (sats.Satellite,), entries | members)(name, args)


def environment(num_envs: int = 2, scenario=None, rewarder=None, args=None, **members) -> SatelliteTasking:
    options = dict(num_envs=num_envs, time_limit=60.0, seed=0, backend="eager")
    return SatelliteTasking(satellite(args=args, **members), scenario, rewarder, **options)


def observing(function) -> list[obs.Observation]:
    return [obs.SatProperties(dict(prop="x", fn=function))]


def late(sat) -> bool:
    return bool((sat.simulator.sim_time > 5.0).any())


@pytest.mark.parametrize(
    ("function", "error", "words"),
    [
        (
            lambda sat: torch.full_like(sat.simulator.sim_time, torch.nan),
            FloatingPointError,
            r"'sat_props\.x' in the observation of",
        ),
        (lambda sat: sat.dynamics.r_BN_N[:, : 2 if late(sat) else 3], TypeError, "has 2 numbers, but had 3 before"),
        (lambda sat: sat.dynamics.r_BN_N.to(torch.complex128), TypeError, "is complex; it must be real"),
    ],
)
def test_observations(function, error, words):
    with pytest.raises(error, match=words):
        environment(observation_spec=observing(function)).rollout(2)


@pytest.mark.parametrize(
    ("members", "words"),
    [
        (dict(observation_spec=obs.Time()), r"Mine\.observation_spec = .*; it must be a list"),
        (dict(action_spec=act.Drift(duration=1.0)), r"Mine\.action_spec = .*; it must be a list"),
        (dict(counts=lambda self: {"a": 3}), r"Mine\.counts\(\)\['a'\] is 3; it must be a tensor"),
        (dict(is_alive=lambda self: True), r"Mine\.is_alive\(\) is True; it must be a tensor"),
    ],
)
def test_members_of_satellites(members, words):
    with pytest.raises((TypeError, ValueError), match=words):
        environment(**members).reset()


def test_entries_without_properties():
    for make in (obs.SatProperties, lambda: obs.OpportunityProperties(n_ahead_observe=2)):
        with pytest.raises(ValueError, match="has no properties; give a dictionary for each"):
            make()
    with pytest.raises(ValueError, match="prop=3 must be the name of a property"):
        obs.SatProperties(dict(prop=3))


def rewarder(**hooks) -> data.GlobalReward:
    paid = dict(calculate_reward=lambda self, before, after: torch.ones(self.fleet.shape, dtype=torch.float64))
    return type("Paid", (data.GlobalReward,), paid | hooks)()


def growing(self, before, after):
    self.paid = getattr(self, "paid", 0.0) + torch.ones(self.fleet.shape, dtype=torch.float64)
    return self.paid


@pytest.mark.parametrize(
    ("hooks", "error", "words"),
    [
        (
            dict(calculate_reward=lambda self, before, after: torch.full(self.fleet.shape, torch.nan)),
            FloatingPointError,
            r"Paid\.calculate_reward\(\) is NaN or infinite for environments \[0, 1\]",
        ),
        (dict(calculate_reward=growing), TypeError, r"Paid\.paid is a tensor that has changed during an episode"),
        (dict(counts=lambda self: [3]), TypeError, r"Paid\.counts\(\) returns \[3\]"),
    ],
)
def test_rewarders(hooks, error, words):
    with pytest.raises(error, match=words):
        environment(rewarder=rewarder(**hooks)).rollout(3)


@pytest.mark.parametrize(
    ("draw", "words"),
    [
        (lambda self, key: None, "returns None; it must return a dictionary of tensors"),
        (lambda self, key: {"q": 1.0}, r"draw\(key\)\['q'\] is 1\.0; it must be a tensor"),
        (lambda self, key: {"q": torch.ones(7, 1)}, r"is of shape \[7, 1\]; it needs a row for each environment"),
        (lambda self, key: {"q": torch.tensor(1.0)}, r"is of shape \[\]; it needs a row for each environment"),
        (lambda self, key: {"q": torch.full((len(key), 1), torch.nan)}, "is NaN in 1 of 1 numbers"),
        (lambda self, key: {"q": torch.rand(len(key), 1)}, "used torch's global generator"),
        (lambda self, key: {"q": key.named(3).uniform(1)}, r"name of key\.named=3 must be a string"),
        (lambda self, key: {"q": key.named("q").uniform(1.5)}, r"count=1\.5 must be a whole number"),
    ],
)
def test_draws_of_scenarios(draw, words):
    with pytest.raises((TypeError, ValueError), match=words):
        environment(scenario=type("Drawn", (scene.Scenario,), dict(draw=draw))())


def test_the_same_values_laid_over_targets_twice():
    clouds = scene.CloudyTargets(scene.UniformTargets(5))
    for targets in (clouds, scene.UncertainTargets(clouds, sigma=10.0)):
        with pytest.raises(ValueError, match="has a CloudyTargets already"):
            scene.CloudyTargets(targets)
    scene.UncertainTargets(clouds, sigma=10.0)


@pytest.mark.parametrize(
    ("declare", "words"),
    [
        (lambda memory: memory.declare("p", "a"), "initial must be a number"),
        (lambda memory: memory.declare("p", 0.0, (2, 3)), r"a size in shape=\(2, 3\) must be a whole number"),
        (lambda memory: memory.declare("p", 0.0) or memory.__setitem__("p", 1.0), r"'p' of the state cannot become 1\.0"),
    ],
)
def test_memory(declare, words):
    def link(self, scenario, fleet):
        data.GlobalReward.link(self, scenario, fleet)
        declare(fleet.memory)

    with pytest.raises((TypeError, ValueError), match=words):
        environment(rewarder=rewarder(link=link))


def test_a_class_of_distributions_in_place_of_a_distribution():
    with pytest.raises(ValueError, match="mass=Uniform is a class; write an object of it, with parentheses"):
        satellite(args=dict(mass=rand.Uniform)) and environment(args=dict(mass=rand.Uniform))


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (dict(group_map={"next": ["A", "B"]}), r"group_map\['next'\].*its name is one of"),
        (dict(group_map={"_reset": ["A", "B"]}), "begins with an underscore"),
        (dict(group_map={1: ["A", "B"]}), "must be a dictionary, such as"),
        (dict(meta_agent_groupings=[["A", "B"]]), "must be a dictionary, such as"),
    ],
)
def test_names_of_groups(options, words):
    with pytest.raises(ValueError, match=words):
        ConstellationTasking([satellite("A"), satellite("B")], num_envs=2, time_limit=60.0, backend="eager", **options)
