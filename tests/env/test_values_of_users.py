"""What users' functions and classes return is checked where it enters: shapes, kinds, NaN, and draws without a key."""

import torch

from bsk_torch import ConstellationTasking, SatelliteTasking, act, data, obs, rand, sats, scene
from tests.support.refusals import check_refusals, refusal


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


def test_rejects_wrong_members_of_satellites():
    observed = lambda function: environment(observation_spec=observing(function)).rollout(2)
    nan = lambda sat: torch.full_like(sat.simulator.sim_time, torch.nan)
    growing = lambda sat: sat.dynamics.r_BN_N[:, : 2 if late(sat) else 3]
    check_refusals(
        refusal(lambda: observed(nan), FloatingPointError, "'sat_props.x'", "environment 0", "NaN"),
        refusal(lambda: observed(growing), TypeError, "observation of A", 2, 3),
        refusal(lambda: observed(lambda sat: sat.dynamics.r_BN_N.to(torch.complex128)), TypeError, "'x'", "complex", "real"),
        refusal(lambda: environment(observation_spec=obs.Time()), ValueError, "Mine.observation_spec", "Time", "list"),
        refusal(lambda: environment(action_spec=act.Drift(duration=1.0)), ValueError, "Mine.action_spec", "Drift", "list"),
        refusal(lambda: environment(counts=lambda self: {"a": 3}).reset(), TypeError, "Mine.counts()['a']", 3, "torch.int64"),
        refusal(lambda: environment(is_alive=lambda self: True).reset(), TypeError, "Mine.is_alive()", True, "torch.bool"),
        refusal(lambda: obs.SatProperties(), ValueError, "obs.SatProperties", "properties"),
        refusal(lambda: obs.OpportunityProperties(n_ahead_observe=2), ValueError, "obs.OpportunityProperties", "properties"),
        refusal(lambda: obs.SatProperties(dict(prop=3)), ValueError, "obs.SatProperties", "prop=3"),
        refusal(lambda: environment(args=dict(mass=rand.Uniform)), ValueError, "mass", "Uniform", "parentheses"),
    )


def test_rejects_wrong_rewarders():
    def growing(self, before, after):
        self.paid = getattr(self, "paid", 0.0) + torch.ones(self.fleet.shape, dtype=torch.float64)
        return self.paid

    def played(**hooks):
        return environment(rewarder=rewarder(**hooks)).rollout(3)

    def declared(*args, value=None):
        def link(self, scenario, fleet):
            data.GlobalReward.link(self, scenario, fleet)
            fleet.memory.declare("p", *args)
            if value is not None:
                fleet.memory["p"] = value

        return environment(rewarder=rewarder(link=link))

    nan = lambda self, before, after: torch.full(self.fleet.shape, torch.nan)
    check_refusals(
        refusal(lambda: played(calculate_reward=nan), FloatingPointError, "Paid.calculate_reward()", "NaN", [0, 1]),
        refusal(lambda: played(calculate_reward=growing), TypeError, "Paid.paid", "self.fleet.memory"),
        refusal(lambda: played(counts=lambda self: [3]), TypeError, "Paid.counts()", [3], "dictionary"),
        refusal(lambda: declared("a"), ValueError, "initial", "'a'"),
        refusal(lambda: declared(0.0, (2, 3)), ValueError, "shape", (2, 3)),
        refusal(lambda: declared(0.0, value=1.0), TypeError, "'p'", 1.0),
    )


def test_rejects_wrong_scenarios_and_groups():
    def drawing(draw):
        return environment(scenario=type("Drawn", (scene.Scenario,), dict(draw=lambda self, key: draw(key)))())

    clouds, name = scene.CloudyTargets(scene.UniformTargets(5)), "Drawn.draw(key)"
    uncertain = scene.UncertainTargets(clouds, sigma=10.0)
    check_refusals(
        refusal(lambda: drawing(lambda key: None), TypeError, name, None, "dictionary"),
        refusal(lambda: drawing(lambda key: {"q": 1.0}), TypeError, name, "'q'", 1.0, "tensor"),
        refusal(lambda: drawing(lambda key: {"q": torch.ones(7, 1)}), ValueError, name, "'q'", [7, 1], "row"),
        refusal(lambda: drawing(lambda key: {"q": torch.tensor(1.0)}), ValueError, name, "'q'", [], "row"),
        refusal(lambda: drawing(lambda key: {"q": torch.full((len(key), 1), torch.nan)}), ValueError, name, "'q'", "NaN"),
        refusal(lambda: drawing(lambda key: {"q": torch.rand(len(key), 1)}), TypeError, name, "torch's global generator"),
        refusal(lambda: drawing(lambda key: {"q": key.named(3).uniform(1)}), ValueError, "key.named", 3),
        refusal(lambda: drawing(lambda key: {"q": key.named("q").uniform(1.5)}), ValueError, "count", 1.5),
        *(refusal(lambda t=t: scene.CloudyTargets(t), ValueError, "targets", "CloudyTargets") for t in (clouds, uncertain)),
    )

    def build(**options):
        return ConstellationTasking([satellite("A"), satellite("B")], num_envs=2, time_limit=60.0, backend="eager", **options)

    check_refusals(
        refusal(lambda: build(group_map={"next": ["A", "B"]}), ValueError, "group_map['next']", "'observation'"),
        refusal(lambda: build(group_map={"_reset": ["A", "B"]}), ValueError, "group_map['_reset']", "underscore"),
        refusal(lambda: build(group_map={1: ["A", "B"]}), ValueError, "group_map", {1: ["A", "B"]}, "dictionary"),
        refusal(lambda: build(meta_agent_groupings=[["A", "B"]]), ValueError, "meta_agent_groupings", [["A", "B"]], "dictionary"),
    )


def rewarder(**hooks) -> data.GlobalReward:
    paid = dict(calculate_reward=lambda self, before, after: torch.ones(self.fleet.shape, dtype=torch.float64))
    return type("Paid", (data.GlobalReward,), paid | hooks)()


def growing(self, before, after):
    self.paid = getattr(self, "paid", 0.0) + torch.ones(self.fleet.shape, dtype=torch.float64)
    return self.paid
