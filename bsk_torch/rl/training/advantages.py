"""Advantages in semi-Markov decision processes, in which decisions last different times.

With a discount gamma per second and a step of t seconds, the value of a state is

    V = E[gamma^t (r + V')],

where r is the reward of the step and V' the value of the next state: the reward is discounted over its interval, as bsk_rl's
``TimeDiscountedGAE`` does. If rewards come at the start of their steps, as in TorchRL, it is V = E[r + gamma^t V'].
"""

from __future__ import annotations

import torch
from tensordict import TensorDictBase
from torch import Tensor
from torchrl.modules import ValueOperator
from torchrl.objectives.value import GAE

CHUNK = 2048
"""Decisions whose values are computed at once: attention over more would leave the processor's cache."""


def timed(reward: Tensor, seconds: Tensor, gamma: float, reward_time: str) -> Tensor:
    """Return rewards as of the start of their steps: gamma^t r if they come at the ``"end"``, r if at the ``"start"``."""
    return (reward.double() * gamma ** seconds.double()).to(reward.dtype) if reward_time == "end" else reward


def estimate_advantages(
    batch: TensorDictBase,
    critic: ValueOperator,
    gamma: float,
    lmbda: float,
    reward_time: str = "end",
    *,
    estimator: type[GAE] = GAE,
    done: str = "done",
    terminated: str = "terminated",
) -> None:
    """Write ``advantage`` and ``value_target`` of a batch [N, T] in semi-Markov time.

    With g = gamma^t and rewards at the end of steps, A = g (r + V') - V + g lambda A', where V' and A' are zero after the end
    of an episode; the target of the value is A + V. See Schulman et al. 2016, arXiv:1506.02438, for equal steps.

    Args:
        batch: Decisions in order of time, with ``reward`` and ``duration`` [N, T, ..., 1] of each under ``next``.
        critic: Computes values of observations, at the root and under ``next``.
        gamma: Discount per second.
        lmbda: Decay of the estimator, per decision.
        reward_time: ``"end"`` or ``"start"``; see :func:`timed`.
        estimator: TorchRL's estimator: ``GAE``, or ``MultiAgentGAE`` for batches [N, T, S] of satellites.
        done: Key, under ``next``, of ends after which another episode begins.
        terminated: Key, under ``next``, of ends after which nothing is expected.
    """
    reward, seconds = batch["next", "reward"], batch["next", "duration"]
    discount = torch.tensor(gamma, dtype=torch.float64, device=reward.device)
    advantages = estimator(gamma=discount, lmbda=lmbda, value_network=None, device=reward.device)
    advantages.set_keys(steps_to_next_obs=("next", "duration"), done=done, terminated=terminated)
    judged = batch.select("next").clone(recurse=False)
    judged["state_value"], judged["next", "state_value"] = values(batch, critic)
    judged["next", "reward"] = timed(reward, seconds, gamma, reward_time)
    advantages(judged)
    for key in ("advantage", "value_target"):
        batch[key] = judged[key].to(reward.dtype)


@torch.no_grad()
def values(batch: TensorDictBase, critic: ValueOperator) -> tuple[Tensor, Tensor]:
    """Return the values [N, T, ..., 1] of the states of a batch [N, T], and of the states that follow them."""
    value = _judge(batch.reshape(-1), critic).view(batch["next", "reward"].shape)
    following = value.roll(-1, 1)
    last = batch["next", "done"].squeeze(-1).clone()
    last[:, -1] = True  # the state that follows is not that of the next decision in the batch
    following[last] = _judge(batch["next"][last], critic)
    return value, following


def _judge(states: TensorDictBase, critic: ValueOperator) -> Tensor:
    """Return the values [n, ..., 1] of states [n]."""
    return torch.cat([critic(part)["state_value"] for part in states.select("seen").split(CHUNK)])
