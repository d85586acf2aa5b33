"""Every hook of a rewarder runs, also as a part of a sum; what would not run, and results that do not fit, are refused."""

import copy
import math

import pytest
import torch
from tensordict import TensorDict

import bsk_torch
from bsk_torch import ConstellationTasking, comm, data, rand, scene
from bsk_torch.presets.nadir_scan import ScanningSatellite, scanning_args
from bsk_torch.rl.evaluation.evaluate import evaluate
from bsk_torch.rl.evaluation.statistics import nan_confidence
from bsk_torch.rl.policies.shared_policy import rule
from tests.support.refusals import check_refusals, refusal

pytestmark = pytest.mark.compiled

N, S = 3, 2


class Full(data.GlobalReward):
    """Defines every hook, and notes its calls."""

    def __init__(self, **results):
        self.calls, self.results = [], results

    def note(self, name, default):
        self.calls.append(name)
        result = self.results.get(name, default)
        return result(self) if callable(result) else result

    def flags(self, value=False):
        return torch.full((self.fleet.num_envs, self.fleet.size), value)

    def link(self, scenario, fleet):
        if self.note("link", True):
            super().link(scenario, fleet)

    def read_log(self):
        return self.note("read_log", {"time": self.fleet.sim_time.unsqueeze(1).expand(-1, self.fleet.size)})

    def calculate_reward(self, before, after):
        default = after["time"] - before["time"] if isinstance(self.results.get("read_log", {}), dict) else None
        return self.note("calculate_reward", default)

    def share(self, links):
        return self.note("share", None)

    def counts(self):
        return self.note("counts", {"visits": self.flags(True).long()})

    def is_terminated(self):
        return self.note("is_terminated", self.flags())

    def is_truncated(self):
        return self.note("is_truncated", self.flags())


HOOKS = {"link", "read_log", "calculate_reward", "share", "counts", "is_terminated", "is_truncated"}


def make(rewarder, **options):
    satellites = [ScanningSatellite(f"Scanner{k}", scanning_args() | dict(oe=rand.random_orbit())) for k in range(S)]
    nadir = scene.UniformNadirScanning()
    fixed = dict(num_envs=N, time_limit=600.0, seed=1, dtype=torch.float64)
    return ConstellationTasking(satellites, nadir, rewarder, comm.FreeCommunication(), **(fixed | options))


def step(env):
    env.reset()
    action = torch.zeros(N, S, dtype=torch.int64)
    return env.step(TensorDict({"agents": TensorDict({"action": action}, [N, S])}, [N]))["next"]


@pytest.mark.parametrize("parts", [1, 2])
def test_every_hook_is_called(parts):
    given = [Full() for _ in range(parts)]
    env = make(given[0] if parts == 1 else given)
    out = step(env)
    assert (out["agents", "reward"] == 180.0 * parts).all()
    for rewarder in [env.rewarder] if parts == 1 else env.rewarder.rewarders:
        assert set(rewarder.calls) == HOOKS
    assert set(out["counts"].keys()) == {"visits", "visits_2"} if parts == 2 else {"visits"}


class Doubled(data.ComposedReward):
    def calculate_reward(self, before, after):
        return 2.0 * super().calculate_reward(before, after)


def test_sums_stay_of_their_class_and_copies_share_no_parts():
    """Environments copy rewarders; the copy of a subclass used to be a plain sum."""
    env = make(Doubled(Full(), data.NoReward()))
    assert isinstance(env.rewarder, Doubled)
    assert (step(env)["agents", "reward"] == 360.0).all()
    first = data.ComposedReward(Full(), data.NoReward())
    second = copy.copy(first)
    assert all(a is not b for a, b in zip(first.rewarders, second.rewarders, strict=True))
    assert first.terms is not second.terms


def test_attributes_of_parts():
    """Read from the sum if there is no doubt whose they are; written where they belong."""
    drain, gain = (data.ResourceReward(weight, lambda satellite: satellite) for weight in (-1.0, 2.0))
    assert data.ComposedReward(drain, data.NoReward()).reward_weight == -1.0
    with pytest.raises(AttributeError, match=r"several rewarders have 'reward_weight'; .* rewarders\[0\]\.reward_weight"):
        _ = data.ComposedReward(drain, gain).reward_weight
    with pytest.raises(AttributeError, match="neither ComposedReward nor one of its rewarders has 'imaged'"):
        _ = data.ComposedReward(drain, gain).imaged
    both = data.ComposedReward(drain, gain)
    check_refusals(refusal(lambda: setattr(both, "reward_weight", 0.5), AttributeError, "'reward_weight'"))
    both.mine = 3
    assert both.mine == 3


def test_rejects_results_that_do_not_fit():
    hits = lambda value: dict(counts={"hits": value})
    wrong = [
        (dict(link=False), "Full.link(scenario, fleet)", "super().link(scenario, fleet)"),
        (dict(calculate_reward=torch.ones(1)), "calculate_reward()", [1], [N, S]),
        (dict(calculate_reward=torch.ones(N)), "calculate_reward()", [N]),
        (dict(calculate_reward=torch.ones(N, 1)), "calculate_reward()", [N, 1]),
        (dict(calculate_reward=1.0), "calculate_reward()", 1.0),
        (dict(calculate_reward=torch.ones(N, S).long()), "calculate_reward()", "int64", "torch.float64", "torch.float32"),
        (dict(is_terminated=torch.ones(N, dtype=torch.bool)), "is_terminated()", [N]),
        (dict(is_terminated=torch.ones(N, S)), "is_terminated()", "torch.float32", "torch.bool"),
        (dict(is_truncated=False), "is_truncated()", False),
        (dict(is_truncated=lambda self: self.flags()[:, :1]), "is_truncated()", [N, 1]),
        (hits(torch.ones(N, S)), "counts()['hits']", "torch.float32", "torch.int64"),
        (hits(torch.ones(N, dtype=torch.int64)), "counts()['hits']", [N]),
        (dict(share=torch.ones(1)), "share(links)", None),
        (dict(read_log={"level": torch.ones(N)}), "read_log()['level']", [N]),
        (dict(read_log={"level": 1.0}), "read_log()['level']", 1.0),
        (dict(read_log=[1.0]), "read_log()", [1.0], "dictionary"),
    ]
    alone, composed = lambda rewarder: rewarder, lambda rewarder: data.ComposedReward(rewarder, data.NoReward())
    check_refusals(
        refusal(lambda given=given, place=place: step(make(place(Full(**given)))), TypeError, *names)
        for place in (alone, composed)
        for given, *names in wrong
    )


class Measured(data.NoReward):
    """Has a measure."""

    def __init__(self, value):
        self.value = value

    def measures(self):
        return {"share": self.value}


def test_measures_of_parts_are_numbered_and_those_without_a_value_do_not_count():
    half = torch.full((N,), 0.5, dtype=torch.float64)
    env = make([Measured(half), Measured(2.0 * half), data.NoReward()], env_ids=[0] * N)
    result = evaluate(rule("random", env), env, seeds=[0, 1, 2, 3])
    assert {name: value.tolist() for name, value in result.measures.items()} == {"share": [0.5] * 4, "share_2": [1.0] * 4}
    assert result.summary()["measures"]["share_2"]["mean"] == 1.0
    known_values = torch.tensor([1.0, math.nan, 3.0], dtype=torch.float64)
    assert nan_confidence(known_values).mean == 2.0
    assert math.isnan(nan_confidence(known_values[1:2]).mean)


def test_rejects_measures_that_do_not_fit():
    measured = lambda value: make(Measured(value), env_ids=[0] * N, time_limit=100.0)
    run = lambda value: evaluate(rule("random", env := measured(value)), env, seeds=[0])
    each = torch.ones(N, S, dtype=torch.float64)
    check_refusals(
        refusal(lambda: run(torch.ones(N)), TypeError, "Measured.measures()['share']", "torch.float32", "torch.float64"),
        refusal(lambda: run(each), TypeError, "Measured.measures()['share']", [N, S], [N]),
        refusal(lambda: run(1.0), TypeError, "Measured.measures()['share']", 1.0),
    )


def test_rejects_choices_and_counters_that_do_not_fit():
    class All(data.UniqueImageReward):
        def selectable(self):
            return self.scenario.available

    class Twice(data.UniqueImageReward):
        def counts(self):
            return super().counts() | {"imaged": self.memory["duplicates"]}

    made = lambda rewarder: bsk_torch.make("AEOS-v1", n_targets=300, time_limit=600.0, rewarder=rewarder)
    check_refusals(
        refusal(lambda: made(All()), TypeError, "All.selectable()", [1, 300], [1, 1, 300]),
        refusal(lambda: made(Twice()), ValueError, "counts()", "'imaged'"),
    )


def test_rejects_definitions_that_would_not_run():
    define = lambda base=data.GlobalReward, **members: type("Mine", (base,), members)
    images, function = data.UniqueImageReward, lambda self: None
    check_refusals(
        refusal(lambda: define(calculate_reward=lambda self, before, after, time: None), TypeError, "reward(before, after)"),
        refusal(lambda: define(is_terminated=lambda self, satellite, time: None), TypeError, "is_terminated()"),
        refusal(lambda: define(compare_log_states=function), TypeError, "compare_log_states", "read_log", "bsk_torch.bsk_rl"),
        refusal(lambda: define(calculate_reward=lambda self, new_data_dict: None), TypeError, "reward(before, after)"),
        refusal(lambda: define(data_store_type=int), TypeError, "data_store_type", "bsk_torch.bsk_rl"),
        refusal(lambda: define(calc_reward=lambda self, before, after: None), TypeError, "calc_reward", "'calculate_reward'"),
        refusal(lambda: define(is_terminate=function), TypeError, "Mine.is_terminate", "'is_terminated'"),
        refusal(lambda: define(read_logs=function), TypeError, "Mine.read_logs", "'read_log'"),
        refusal(lambda: define(images, selectible=function), TypeError, "Mine.selectible", "'selectable'"),
        refusal(lambda: define(images, value=lambda self, target: None), TypeError, "Mine.value", "value(target, taken)"),
    )
