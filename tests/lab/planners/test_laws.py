"""What every planner keeps to: the environment is not touched, rows do not matter, and decisions are no worse than the base's."""

import numpy as np
import pytest
import torch

import bsk_torch
from bsk_torch.lab.planners import PLANNERS, BeamSearch, Rollout, TreeSearch, planner
from bsk_torch.rl.evaluation.evaluate import SIMULATED, evaluate
from tests.lab.planners.conftest import ENDLESS, always, same, scanning

pytestmark = pytest.mark.compiled

SMALL = {"rollout": {}, "beam": {"budget": 12, "width": 2}, "mcts": {"budget": 12, "leaves": 3}}
"""Options that make planners of numbered actions fast."""


@pytest.mark.parametrize("name", SMALL)
def test_planning_leaves_the_environment_and_all_generators_alone(name, env):
    env.reseed([3, 4, 5])
    now = env.reset()
    env.play(torch.tensor([0, 1, 2]))
    now = env.observe()
    before, draws = env.get_state(), (torch.get_rng_state(), np.random.get_state()[1].copy())
    planned = planner(name, env, base="rule", horizon=400.0, **SMALL[name])
    first = planned(now.clone())
    again = planned(now.clone())
    assert same(env.get_state(), before)
    assert torch.equal(torch.get_rng_state(), draws[0])
    assert np.array_equal(np.random.get_state()[1], draws[1])
    assert torch.equal(first["action"], again["action"])  # nor does it learn from itself
    assert bool((first[SIMULATED] > 0.0).all())


@pytest.mark.parametrize("name", SMALL)
def test_decisions_do_not_depend_on_other_rows(name, env):
    seeds = [5, 1]
    alone = scanning(1)
    few, many = (
        evaluate(planner(name, e, base="rule", horizon=500.0, rows=rows, **SMALL[name]), e, seeds=seeds)
        for e, rows in ((alone, 2), (env, 64))
    )
    assert torch.equal(few.returns, many.returns)
    assert torch.equal(few.decisions, many.decisions)
    assert torch.equal(few.simulated, many.simulated)


@pytest.mark.parametrize("name", SMALL)
@pytest.mark.parametrize("base", ["rule", "random"])
def test_looking_to_the_end_is_never_worse_than_the_base(name, base, env):
    seeds = range(3)
    plain = evaluate(always(1) if base == "random" else bsk_torch.rule(base, env), env, seeds=seeds)
    planned = evaluate(
        planner(name, env, base=always(1) if base == "random" else base, **ENDLESS, **SMALL[name]), env, seeds=seeds
    )
    assert bool((planned.returns >= plain.returns - 1e-12).all())  # sums of the same rewards, in another order
    if base == "random":
        assert bool((planned.returns > plain.returns).all())  # who charges for ever scans nothing


@pytest.mark.nightly
def test_decisions_do_not_depend_on_batch_or_back_end(env):
    alone = scanning(1)
    few, many = (evaluate(Rollout(e, "random", horizon=300.0), e, seeds=[4, 6]) for e in (alone, env))
    assert torch.equal(few.returns, many.returns)
    assert torch.equal(few.simulated, many.simulated)
    for e in (scanning(2, 300.0), scanning(2, 300.0, backend="eager")):
        e.set_seed(0)
        actions = Rollout(e, "rule", horizon=70.0)(e.reset())["action"]
        if e.options.backend == "compiled":
            compiled = actions
    assert torch.equal(actions, compiled)


def test_branches_last_until_the_horizon_of_running_episodes(env):
    env.set_seed(0)
    now = env.reset()
    planned = Rollout(env, "rule", horizon=250.0)(now)
    assert planned[SIMULATED].tolist() == [4 * 250.0] * 3  # four actions; tasks of 180 s are cut
    late = Rollout(env, "rule", horizon=1e9)(env.reset())
    assert late[SIMULATED].tolist() == [4 * 1500.0] * 3  # the episode ends before
    env.set_seed(0)
    now = env.reset()
    now["done"][1] = True
    assert Rollout(env, "rule", horizon=240.0)(now)[SIMULATED].tolist() == [960.0, 0.0, 960.0]


def test_budgets_bound_what_is_simulated(env):
    env.set_seed(0)
    now = env.reset()
    assert Rollout(env, "rule", horizon=200.0, budget=2)(now.clone())[SIMULATED].tolist() == [400.0] * 3
    assert Rollout(env, "rule", horizon=200.0, budget=1)(now.clone())[SIMULATED].tolist() == [0.0] * 3  # nothing to compare
    for kind in (BeamSearch, TreeSearch):
        found = kind(env, "rule", horizon=200.0, budget=6)(now.clone())[SIMULATED]
        assert bool((found <= 6 * 200.0).all())


def test_changed_arguments_are_those_of_the_branches():
    env = scanning(1, 400.0)
    planned = Rollout(env, "rule", horizon=20.0)
    planned(env.reset())
    env.set_sat_args({"panelArea": 0.3})  # one constant of the tick so far: the make of the environment changes
    env.reset()
    assert planned(env.observe())[SIMULATED].tolist() == [80.0]
    assert torch.equal(planned.branches.model.fingerprint, env.fingerprint)


def test_all_planners_have_names():
    assert set(PLANNERS) == {"rollout", "beam", "mcts", "cem"}
