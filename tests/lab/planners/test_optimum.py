"""Searches against all sequences of actions, and returns against the arithmetic of semi-Markov decision processes."""

import itertools

import pytest
import torch
from tensordict.nn import TensorDictModule

from bsk_torch.lab.planners import BeamSearch, Rollout, TreeSearch
from bsk_torch.lab.planners.branches import Discounting
from bsk_torch.rl.evaluation.evaluate import evaluate, start_episodes
from tests.lab.planners.conftest import ENDLESS, always, scanning

pytestmark = pytest.mark.compiled

LIMIT = 300.0
"""Length of the episodes, s: five actions of a minute at most."""

DESATURATE = 3


@pytest.fixture(scope="module")
def optimum():
    """The best return of all sequences of actions of the episode of seed 2."""
    sequences = torch.tensor(list(itertools.product(range(4), repeat=5)))
    env = scanning(len(sequences), LIMIT)
    now = start_episodes(env, [2])
    for action in sequences.unbind(1):
        now = env.play(action, ~now["done"].squeeze(-1))
    assert bool(now["done"].all())
    returns = env.returns
    assert len(returns.unique()) > 10
    return float(returns.max())


@pytest.mark.parametrize("leaves", [1, 8])
def test_a_tree_with_enough_budget_finds_the_optimum(leaves, optimum):
    env = scanning(1, LIMIT)
    plain = evaluate(always(DESATURATE), env, seeds=[2])
    assert float(plain.returns) < optimum - 1e-3
    tree = TreeSearch(env, always(DESATURATE), budget=400, leaves=leaves, actions=None, **ENDLESS)
    assert float(evaluate(tree, env, seeds=[2]).returns) == pytest.approx(optimum, abs=1e-12)


def test_a_solved_tree_needs_no_more_flights(optimum):
    env = scanning(1, LIMIT)
    now = start_episodes(env, [2])
    few, many = (
        TreeSearch(env, always(DESATURATE), budget=budget, actions=None, **ENDLESS)(now.clone())["simulated_seconds"]
        for budget in (400, 800)
    )
    assert torch.equal(few, many)


def test_a_wide_beam_finds_the_optimum(optimum):
    env = scanning(1, LIMIT)
    beam = BeamSearch(env, always(DESATURATE), budget=5 * 300, width=300, depth=5, **ENDLESS)
    assert float(evaluate(beam, env, seeds=[2]).returns) == pytest.approx(optimum, abs=1e-12)


def test_a_beam_of_depth_one_is_a_rollout():
    env = scanning(3, 900.0)
    options = {"base": "rule", "horizon": 400.0}
    one, other = (
        evaluate(made, env, seeds=range(3)) for made in (BeamSearch(env, budget=4, depth=1, **options), Rollout(env, **options))
    )
    assert torch.equal(one.returns, other.returns)


@pytest.mark.parametrize("at_end", [True, False])
def test_returns_are_those_of_a_semi_markov_decision_process(at_end):
    gamma, env = 0.998, scanning(1, LIMIT)
    now = start_episodes(env, [2])
    base, first = always(0), 1
    made = Rollout(env, base, horizon=1e9, gamma=gamma, reward_time="end" if at_end else "start")
    action, slot = torch.tensor([[first]]), torch.zeros(1, dtype=torch.int64)
    memory = now.select()
    base(now)
    flown = made.branches.fly(env, made._jobs(now, memory, slot, slot, action, slot))
    total = float(Discounting(gamma, at_end).before(flown.reward, flown.seconds, flown.rest))
    wanted, time = 0.0, 0.0
    now, done, following = env.play(torch.tensor([first])), False, []
    while True:
        following.append((float(now["reward"]), float(now["duration"])))
        if bool(now["done"]):
            break
        now = env.play(torch.tensor([0]))
    for reward, seconds in following:
        wanted += gamma ** (time + seconds if at_end else time) * reward
        time += seconds
    assert not done
    assert [seconds for _, seconds in following] == [120.0, 180.0]
    assert total == pytest.approx(wanted, rel=1e-6)  # rewards of tensordicts are float32
    assert float(flown.simulated) == 300.0


def test_a_value_network_stands_for_what_lies_beyond():
    env = scanning(2, 1500.0)
    judge = TensorDictModule(lambda seen: torch.full((len(seen), 1), 7.0), in_keys=["observation"], out_keys=["state_value"])
    made = Rollout(env, always(1), horizon=200.0, gamma=0.999, value=judge)
    env.set_seed(0)
    now = env.reset()
    memory = now.select()
    made.base(now)
    rows = torch.arange(2)
    flown = made.branches.fly(env, made._jobs(now, memory, rows, rows * 0, torch.ones(2, 1, dtype=torch.int64), rows))
    assert flown.simulated.tolist() == [240.0, 240.0]  # two of 120 s: the first that reach 200 s; nothing is earned
    assert flown.rest.tolist() == pytest.approx([7.0 * 0.999**120] * 2, abs=1e-12)
    for leaves in (1, 4):
        tree = TreeSearch(env, "rule", horizon=400.0, budget=8, leaves=leaves, value=judge)
        found = tree(env.observe())
        assert bool((found["simulated_seconds"] <= 8 * 180.0).all())  # a step each


def test_a_value_network_leads_the_search():
    env = scanning(2, 1500.0)
    env.set_seed(0)
    now = env.reset()
    facing = env.satellite.observation_description.index("sat_props.solar_pointing_error_normd")
    value = TensorDictModule(
        lambda seen: -100.0 * seen[:, facing : facing + 1], in_keys=["observation"], out_keys=["state_value"]
    )
    made = TreeSearch(env, "rule", horizon=1.0, budget=8, gamma=1.0, value=value)
    assert made.base(now.clone())["action"].tolist() == [0, 0]
    assert made(now)["action"].tolist() == [1, 1]  # each action once; charging turns the panel to the Sun


@pytest.mark.parametrize("kind", [Rollout, BeamSearch])
def test_a_price_is_added_where_a_branch_is_cut_and_nowhere_else(kind):
    """An episode that ends at the horizon has no state there to be judged; a longer one has, discounted to the decision."""
    gamma, horizon = 0.999, 240.0
    long, short = scanning(2, 1500.0), scanning(2, horizon)
    one = lambda env: torch.ones(env.num_envs)
    for env, expected in ((long, gamma**horizon), (short, 0.0)):
        now = start_episodes(env, [0, 1])
        with_price, without = (
            kind(env, "rule", horizon=horizon, gamma=gamma, price=price)(now.clone())["action_value"] for price in (one, None)
        )
        assert torch.allclose(with_price - without, torch.full_like(without, expected), atol=1e-12, equal_nan=True)


def test_a_price_by_name_is_that_of_the_state():
    env = scanning(2, 1500.0)
    now = start_episodes(env, [0, 1])
    charge = lambda model: 0.5 * model.satellite.dynamics.battery_charge_fraction
    named, function = (
        Rollout(env, "rule", horizon=300.0, price=price)(now.clone())["action_value"]
        for price in ({"battery_charge_fraction": 0.5}, charge)
    )
    assert torch.allclose(named, function, atol=1e-6)  # observations are float32
    assert float((named[..., 1] - named[..., 0]).abs().max()) > 1e-4
