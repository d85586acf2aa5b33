"""Every hook of a rewarder runs, also as a part of a sum; what would not run, and results that do not fit, are refused."""

from __future__ import annotations

import copy
import math

import pytest
import torch
from tensordict import TensorDict

import bsk_torch
from bsk_torch import ConstellationTasking, comm, data, rand, scene
from bsk_torch.presets.nadir_scan import ScanningSatellite, scanning_args
from bsk_torch.rl.evaluation.evaluate import evaluate
from bsk_torch.rl.evaluation.statistics import known
from bsk_torch.rl.policies.shared_policy import rule

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


def test_a_subclass_of_the_sum_stays_one():
    """Environments copy rewarders; the copy of a subclass used to be a plain sum."""
    env = make(Doubled(Full(), data.NoReward()))
    assert isinstance(env.rewarder, Doubled)
    assert (step(env)["agents", "reward"] == 360.0).all()


def test_copies_of_a_sum_share_no_parts():
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
    with pytest.raises(AttributeError, match="'reward_weight' belongs to a part of the sum"):
        both.reward_weight = 0.5
    both.mine = 3
    assert both.mine == 3


@pytest.mark.parametrize("composed", [False, True])
@pytest.mark.parametrize(
    ("results", "words"),
    [
        (dict(link=False), r"Full\.link\(scenario, fleet\) must call super\(\)\.link\(scenario, fleet\)"),
        (
            dict(calculate_reward=torch.ones(1)),
            r"calculate_reward\(\) is a tensor of shape \[1\] .* must be a tensor of shape \[3, 2\]",
        ),
        (dict(calculate_reward=torch.ones(N)), r"calculate_reward\(\) is a tensor of shape \[3\]"),
        (dict(calculate_reward=torch.ones(N, 1)), r"calculate_reward\(\) is a tensor of shape \[3, 1\]"),
        (dict(calculate_reward=1.0), r"calculate_reward\(\) is 1\.0"),
        (dict(calculate_reward=torch.ones(N, S).long()), r"dtype torch\.int64; .* dtype torch\.float64 or torch\.float32"),
        (dict(is_terminated=torch.ones(N, dtype=torch.bool)), r"is_terminated\(\) is a tensor of shape \[3\]"),
        (dict(is_terminated=torch.ones(N, S)), r"is_terminated\(\) .* dtype torch\.float32; .* dtype torch\.bool"),
        (dict(is_truncated=False), r"is_truncated\(\) is False"),
        (dict(is_truncated=lambda self: self.flags()[:, :1]), r"is_truncated\(\) is a tensor of shape \[\d, 1\]"),
        (dict(counts={"hits": torch.ones(N, S)}), r"counts\(\)\['hits'\] .* dtype torch\.int64"),
        (dict(counts={"hits": torch.ones(N, dtype=torch.int64)}), r"counts\(\)\['hits'\] is a tensor of shape \[3\]"),
        (dict(share=torch.ones(1)), r"share\(links\) must return None"),
        (dict(read_log={"level": torch.ones(N)}), r"read_log\(\)\['level'\] is a tensor of shape \[3\]"),
        (dict(read_log={"level": 1.0}), r"read_log\(\)\['level'\] is 1\.0"),
        (dict(read_log=[1.0]), r"read_log\(\) returns \[1\.0\]; it must return a dictionary"),
    ],
)
def test_results_that_do_not_fit_are_named(composed, results, words):
    rewarder = Full(**results)
    with pytest.raises(TypeError, match=words):
        step(make(data.ComposedReward(rewarder, data.NoReward()) if composed else rewarder))


def test_counters_have_names_of_their_own():
    class Twice(data.UniqueImageReward):
        def counts(self):
            return super().counts() | {"imaged": self.memory["duplicates"]}

    with pytest.raises(ValueError, match="has 'imaged', which the satellites count, too"):
        bsk_torch.make("AEOS-v1", n_targets=300, time_limit=600.0, backend="eager", rewarder=Twice())


class Measured(data.NoReward):
    """Has a measure."""

    def __init__(self, value):
        self.value = value

    def measures(self):
        return {"share": self.value}


def test_measures_of_parts_are_numbered_and_shown_in_evaluations():
    half = torch.full((N,), 0.5, dtype=torch.float64)
    env = make([Measured(half), Measured(2.0 * half), data.NoReward()], env_ids=[0] * N, backend="eager")
    result = evaluate(rule("random", env), env, seeds=[0, 1, 2, 3])
    assert {name: value.tolist() for name, value in result.measures.items()} == {"share": [0.5] * 4, "share_2": [1.0] * 4}
    assert result.summary()["measures"]["share_2"]["mean"] == 1.0


@pytest.mark.parametrize(
    ("value", "words"),
    [
        (torch.ones(N), r"Measured.measures\(\)\['share'\] .* dtype torch\.float64"),
        (torch.ones(N, S, dtype=torch.float64), r"Measured.measures\(\)\['share'\] is a tensor of shape \[3, 2\]"),
        (1.0, r"Measured.measures\(\)\['share'\] is 1\.0"),
    ],
)
def test_measures_that_do_not_fit_are_named(value, words):
    env = make(Measured(value), env_ids=[0] * N, backend="eager")
    with pytest.raises(TypeError, match=words):
        evaluate(rule("random", env), env, seeds=[0])


def test_measures_without_a_value_do_not_count():
    known_values = torch.tensor([1.0, math.nan, 3.0], dtype=torch.float64)
    assert known(known_values).mean == 2.0
    assert math.isnan(known(known_values[1:2]).mean)


def test_choices_of_wrong_shape_are_named():
    class All(data.UniqueImageReward):
        def selectable(self):
            return self.scenario.available

    with pytest.raises(TypeError, match=r"All\.selectable\(\) is a tensor of shape \[1, 300\] .* shape \[1, 1, 300\]"):
        bsk_torch.make("AEOS-v1", n_targets=300, time_limit=600.0, backend="eager", rewarder=All())


@pytest.mark.parametrize(
    ("base", "members", "words"),
    [
        (
            data.GlobalReward,
            dict(calculate_reward=lambda self, before, after, time: None),
            r"called as calculate_reward\(before, after\)",
        ),
        (data.GlobalReward, dict(is_terminated=lambda self, satellite, time: None), r"cannot be called as is_terminated\(\)"),
        (data.GlobalReward, dict(compare_log_states=lambda self, old, new: None), r"define read_log\(\)"),
        (data.GlobalReward, dict(get_log_state=lambda self: None), r"define read_log\(\)"),
        (data.GlobalReward, dict(update_from_logs=lambda self: None), r"define read_log\(\)"),
        (data.GlobalReward, dict(reset_pre_sim_init=lambda self: None), r"fleet\.memory"),
        (data.GlobalReward, dict(link_scenario=lambda self, scenario: None), r"define link\(scenario, fleet\)"),
        (data.GlobalReward, dict(calc_reward=lambda self, before, after: None), "did you mean 'calculate_reward'"),
        (data.GlobalReward, dict(is_terminate=lambda self: None), "did you mean 'is_terminated'"),
        (data.GlobalReward, dict(read_logs=lambda self: None), "did you mean 'read_log'"),
        (data.UniqueImageReward, dict(selectible=lambda self: None), "did you mean 'selectable'"),
        (data.UniqueImageReward, dict(value=lambda self, target: None), r"called as value\(target, taken\)"),
    ],
)
def test_what_would_not_run_is_refused_at_the_definition(base, members, words):
    with pytest.raises(TypeError, match=words):
        type("Mine", (base,), members)
