"""Warnings about settings with which learning is hard, by what the first batch shows."""

from __future__ import annotations

import math
from collections.abc import Iterator

from torch import Tensor

from bsk_torch.env.base import Tasking
from bsk_torch.obs import Time
from bsk_torch.rl.training.config import PPOConfig

LEAST_LEFT = 0.5
"""Discount over a mean decision below which hardly anything later counts."""

HEAVIEST_PENALTY = 100.0
"""Failure penalty, in rewards of an episode by random actions, above which these are lost in the noise of the values."""


def hardships(config: PPOConfig, env: Tasking, reward: Tensor, seconds: Tensor) -> Iterator[str]:
    """Yield what makes learning hard, one sentence each.

    Args:
        config: Settings of the training.
        env: Its environment.
        reward: Rewards of the first batch, [N, T].
        seconds: Durations of its decisions, s, [N, T].
    """
    limit, mean = float(env.time_limit.median()), float(seconds.double().mean())
    if not config.evaluate_every:
        yield "evaluate_every=0: the last policy is kept, not the best; evaluate_every=250000 keeps the best"
    yield from _discounts(config, env, limit, mean)
    decisions = math.inf if config.frames is None else config.frames / config.num_envs
    if decisions * mean < limit < math.inf:
        yield (
            f"frames={config.frames} are {decisions:.3g} decisions in each of num_envs={config.num_envs} environments, about "
            f"{decisions * mean:.3g} s of an episode of {limit:.3g} s: no episode ends; give more frames or a smaller num_envs"
        )
    earned = float(reward.double().clamp(min=0.0).sum() / seconds.double().sum()) * limit
    if not bool(reward.any()) and not config.imitate:
        yield (
            f"the first {reward.numel()} decisions brought no reward: there is nothing to learn from until one does; imitate a "
            f"rule first (imitate=...), or reward what leads there"
        )
    elif 0.0 < HEAVIEST_PENALTY * earned < abs(env.failure_penalty):
        yield (
            f"failure_penalty={env.failure_penalty:g} is {abs(env.failure_penalty) / earned:.2g} times what random actions earn "
            f"in an episode ({earned:.2g}), which deaths then hide; give a penalty of the order of what is earned"
        )


def _discounts(config: PPOConfig, env: Tasking, limit: float, mean: float) -> Iterator[str]:
    discount = config.gamma**mean
    if discount < LEAST_LEFT:
        yield (
            f"gamma={config.gamma:g} is a discount per second: a mean decision takes {mean:.3g} s, after which {discount:.1g} is "
            f"left; gamma={config.gamma ** (1.0 / mean):.6g} is {config.gamma:g} per decision"
        )
    if not config.beyond_limit or env.terminate_on_time_limit or math.isinf(limit):
        return
    horizon = math.inf if config.gamma == 1.0 else -1.0 / math.log(config.gamma)
    if horizon > limit:
        yield (
            f"beyond_limit=True with gamma={config.gamma:g}, which looks {horizon:.3g} s ahead: most of the value lies beyond "
            f"the time limit of {limit:.3g} s, where nothing is tried; gamma={math.exp(-3.0 / limit):.6g} looks "
            f"{limit / 3.0:.3g} s ahead, or leave out beyond_limit"
        )
    timed = [s.name for s in env.satellites if any(isinstance(entry, Time) for entry in s.observations.entries)]
    if timed:
        yield (
            f"beyond_limit=True, and {timed[0]} observes the time: no decision is ever made at the limit, so that values there "
            f"are guesses; leave out obs.Time() or beyond_limit"
        )
