"""Values of all actions: what flights that take them return."""

import pytest
import torch

import bsk_torch
from bsk_torch.env.rollout import decide, play_episodes
from bsk_torch.lab.planners import ActionValues, Rollout
from bsk_torch.lab.planners.rollout import ACTION_VALUE, ACTION_VALUES
from bsk_torch.rl.evaluation.evaluate import start_episodes
from tests.lab.planners.conftest import same, scanning

pytestmark = pytest.mark.compiled


def test_the_value_of_the_chosen_action_is_the_rest_of_the_return(env):
    values, before, actions = [], [], []
    for _, step in play_episodes(env, ActionValues(env, "rule"), start_episodes(env, range(3))):
        values.append(step[ACTION_VALUE][:, 0])
        actions.append(step["action"])
        before.append(step["next", "reward"].squeeze(-1).double())
    earned = torch.stack(before)
    rest = earned.flip(0).cumsum(0).flip(0)
    chosen = torch.stack(values).gather(2, torch.stack(actions).unsqueeze(-1)).squeeze(-1)
    assert bool((earned != 0.0).any())
    assert torch.allclose(chosen, rest, rtol=0.0, atol=1e-6)  # rewards reach the learner as float32


def test_the_value_of_another_action_is_the_return_of_the_flight_that_takes_it(env):
    policy = bsk_torch.rule("rule", env)
    start = start_episodes(env, range(3))
    values = ActionValues(env, policy)(start.clone())[ACTION_VALUE][:, 0]
    flown = []
    for action in range(values.shape[1]):
        now = start_episodes(env, range(3))
        now["action"] = torch.full((3,), action)
        now = env.step(now)["next"]
        for _ in play_episodes(env, policy, now):
            pass
        flown.append(env.returns.clone())
    assert torch.equal(values, torch.stack(flown, 1))


def test_the_flight_is_that_of_the_policy(env):
    ends = []
    for policy in (bsk_torch.rule("rule", env), ActionValues(env, "rule", horizon=200.0)):
        for _ in play_episodes(env, policy, start_episodes(env, range(3))):
            pass
        ends.append(env.get_state())
    assert same(*ends)


def test_agents_of_a_team_are_judged_one_at_a_time():
    crew = bsk_torch.make("AEOSConstellation-v1", num_envs=2, env_ids=[0, 0], time_limit=500.0, n_targets=(5000, 5001))
    crew.set_seed(0)
    now = crew.reset()
    base = bsk_torch.rule("greedy", crew)
    judged = ActionValues(crew, base, horizon=100.0, budget=2)(now.clone())
    value, legal = judged[ACTION_VALUE], now["agents", "action_mask"]
    chosen = decide(base, now.clone())["agents", "action"]
    assert value.shape == (2, 3, legal.shape[-1] - 1)  # without "continue"
    assert (~value.isnan()).sum(-1).tolist() == [[2] * 3] * 2
    assert bool(legal[..., :-1][~value.isnan()].all())
    assert not bool(value.gather(-1, chosen.unsqueeze(-1)).isnan().any())


def test_the_mean_over_futures_is_the_value():
    clouds = bsk_torch.make("CloudyAEOS-v1", num_envs=2, env_ids=[0] * 2, n_targets=400, time_limit=600.0)
    now = start_episodes(clouds, [0, 1])
    judged = ActionValues(clouds, "hasty", horizon=100.0, futures=3, budget=2)(now)
    assert judged[ACTION_VALUES].shape[:3] == (2, 1, 3)
    assert torch.equal(judged[ACTION_VALUE].nan_to_num(), judged[ACTION_VALUES].mean(2).nan_to_num())
    assert (~judged[ACTION_VALUE].isnan()).sum(-1).flatten().tolist() == [2, 2]


def test_rollout_takes_the_action_of_the_largest_value():
    env = scanning(2)
    env.reseed([1, 2])
    now = env.reset()
    values = ActionValues(env, "rule", horizon=600.0)(now.clone())[ACTION_VALUE][:, 0]
    planned = Rollout(env, "rule", horizon=600.0, gamma=1.0)(now.clone())["action"]
    assert torch.equal(values.gather(1, planned.unsqueeze(1)).squeeze(1), values.amax(1))
