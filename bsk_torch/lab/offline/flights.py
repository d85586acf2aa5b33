"""Episodes of a behavior as transitions, with the returns of all actions at a sample of decisions."""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import torch
from tensordict import TensorDict, TensorDictBase
from tensordict.nn import TensorDictModuleBase
from torch import Tensor

from bsk_torch.env import SatelliteTasking
from bsk_torch.env.rollout import play_episodes
from bsk_torch.lab.offline.behaviors import Behavior
from bsk_torch.lab.offline.layout import DECISION, EPISODE, ERROR, LOG_PROB, TARGET_ACTION, VALUE
from bsk_torch.lab.planners.branches import Discounting
from bsk_torch.lab.planners.rollout import ACTION_VALUES, ActionValues
from bsk_torch.rand import Key
from bsk_torch.rl.evaluation.evaluate import start_episodes, with_lots


class Flown(NamedTuple):
    """Episodes of n seeds.

    Attributes:
        transitions: All T decisions in TorchRL's TED layout, [T], one episode after the other.
        counterfactuals: The D sampled decisions, [D], in the same order.
        returns: Sums of the rewards of the episodes, [n] float64.
        decisions: Their numbers of decisions, [n].
        seconds: Their lengths, [n] s.
    """

    transitions: TensorDict
    counterfactuals: TensorDict
    returns: Tensor
    decisions: Tensor
    seconds: Tensor


def play(
    env: SatelliteTasking,
    behavior: Behavior,
    seeds: Sequence[int],
    values: Mapping[str, ActionValues],
    share: float,
    first: int = 0,
) -> Flown:
    """Play the episodes of at most N seeds.

    Args:
        env: The environment, N episodes with ``env_ids=[0] * N``.
        behavior: The policy that acts.
        seeds: Seeds of the episodes.
        values: Planners that value actions, by the name of their policy.
        share: Probability that a decision is sampled for its counterfactual returns.
        first: Number of the first episode in the dataset.
    """
    start = start_episodes(env, seeds)
    rows = torch.arange(env.num_envs, device=env.device) < len(seeds)
    key = Key(env.state.seed.cpu(), env.env_ids.cpu(), env.episode.cpu())
    observed = list(env.observation_spec.keys(True, True))
    policy, sampled, numbers = behavior.module(), [], itertools.count()

    def acting(td: TensorDictBase) -> TensorDictBase:
        number = next(numbers)
        lot = key.named(f"counterfactual {number}").uniform(1).squeeze(1).to(env.device)
        lucky = rows & ~td["done"].squeeze(-1) & (lot < share)
        judged = _judged(td, lucky, values)
        td = policy(td)
        if bool(lucky.any()):
            part = td.select(*observed, "action", LOG_PROB).update(judged)
            part[EPISODE] = torch.arange(env.num_envs, device=env.device) + first
            part[DECISION] = torch.full_like(part[EPISODE], number)
            sampled.append(part[lucky].to("cpu"))
        return td

    ends = ("done", "terminated", "truncated")
    after = [("next", *(key if isinstance(key, tuple) else (key,))) for key in (*observed, *ends, "reward")]
    steps, played = [], []
    for playing, step in play_episodes(env, with_lots(acting, env), start, rows):
        steps.append(step.select(*observed, *ends, "action", LOG_PROB, *after).cpu())
        played.append(playing.cpu())
    mask = torch.stack(played, 1)
    transitions: TensorDictBase = torch.stack(steps, 1)
    transitions[EPISODE] = (torch.arange(len(mask)) + first).unsqueeze(1).expand(mask.shape)
    count = len(seeds)
    return Flown(
        transitions[mask],
        _ordered(sampled),
        env.returns[:count].double().cpu().clone(),
        mask.sum(1)[:count],
        env.fleet.sim_time[:count].cpu().clone(),
    )


def target_returns(env: SatelliteTasking, target: TensorDictModuleBase, seeds: Sequence[int], gamma: float) -> Tensor:
    """Return the discounted returns of a policy in the episodes of at most N seeds, [n] float64."""
    rows = torch.arange(env.num_envs, device=env.device) < len(seeds)
    discounting = Discounting(gamma)
    start = start_episodes(env, seeds)
    total, earlier = torch.zeros_like(env.returns), env.returns.clone()
    for playing, _ in play_episodes(env, target, start, rows):
        gain = discounting.after(env.fleet.sim_time) * (env.returns - earlier)
        total, earlier = total + torch.where(playing, gain, 0.0), env.returns.clone()
    return total[: len(seeds)].cpu()


def _judged(td: TensorDictBase, rows: Tensor, values: Mapping[str, ActionValues]) -> TensorDictBase:
    """Return the returns of all actions in the ``rows`` [N], and the actions of the targets, [N]."""
    judgments = TensorDict({}, td.batch_size, device=td.device)
    if not bool(rows.any()):
        return judgments
    for name, judge in values.items():
        masked = td.clone(recurse=False).set("done", ~rows.unsqueeze(-1))  # a planner decides where an episode has not ended
        judged = judge(masked)
        returns = judged[ACTION_VALUES].squeeze(1)
        judgments[VALUE, name] = returns.mean(1)
        if judge.futures is not None and judge.futures > 1:
            judgments[ERROR, name] = returns.std(1) / judge.futures**0.5
        judgments[TARGET_ACTION, name] = judged["action"]
    return judgments


def _ordered(sampled: list[TensorDictBase]) -> TensorDict:
    if not sampled:
        return TensorDict({}, [0])
    joined: TensorDictBase = torch.cat(sampled)
    return joined[torch.argsort(joined[EPISODE], stable=True)]
