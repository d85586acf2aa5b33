"""Proximal policy optimisation of one environment, with a discount that depends on how long a step took.

Decisions last different times, so the problem is a semi-Markov decision process: with gamma per second and a step of t seconds,
the value of a state is the expectation of gamma^t (reward + value of the next state): the reward is discounted over its interval
too, as bsk_rl's ``TimeDiscountedGAE`` does, unless it is said to come at the start, as TorchRL has it: reward + gamma^t value.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import torch
from tensordict import TensorDictBase
from torch import Tensor, nn
from torchrl.data import LazyTensorStorage, ReplayBuffer, SamplerWithoutReplacement
from torchrl.modules import ValueOperator, set_recurrent_mode
from torchrl.objectives import ClipPPOLoss
from torchrl.objectives.value import GAE

from bsk_torch.env import SatelliteTasking
from bsk_torch.rl.config import SCHEDULES, PPOConfig
from bsk_torch.rl.networks import INIT, MEMORY, PLANS, Networks

REPORTED = ("entropy", "kl_approx", "clip_fraction", "explained_variance", "loss_critic")
"""What the log takes from the loss."""

CHUNK = 2048
"""Decisions whose values are computed at once: attention over more would leave the processor's cache."""

LEARNED_FROM = ("seen", "action_mask", "action", "action_log_prob", "advantage", "value_target")
"""Keys of a batch that gradient steps need."""


def timed(reward: Tensor, seconds: Tensor, gamma: float, reward_time: str) -> Tensor:
    """Rewards, worth less by ``gamma`` per second where they come at the ``"end"`` of their steps; in full at the ``"start"``."""
    return (reward.double() * gamma ** seconds.double()).to(reward.dtype) if reward_time == "end" else reward


def estimate_advantages(
    batch: TensorDictBase, critic: ValueOperator, gamma: float, lmbda: float, reward_time: str = "end"
) -> None:
    """Write ``advantage`` and ``value_target`` of a batch [N, T], in semi-Markov time.

    Args:
        batch: Decisions in order of time, with ``reward`` and ``duration`` [N, T, 1] of each under ``next``.
        critic: Judges what is seen, here and under ``next``.
        gamma: Discount per second.
        lmbda: Decay of the estimator, per decision.
        reward_time: See :func:`timed`.
    """
    reward, seconds = batch["next", "reward"], batch["next", "duration"]
    estimator = GAE(
        gamma=torch.tensor(gamma, dtype=torch.float64, device=reward.device),
        lmbda=lmbda,
        value_network=None,
        device=reward.device,
    )
    estimator.set_keys(steps_to_next_obs=("next", "duration"))
    judged = batch.select("next").clone(recurse=False)
    judged["state_value"], judged["next", "state_value"] = values(batch, critic)
    judged["next", "reward"] = timed(reward, seconds, gamma, reward_time)
    estimator(judged)
    for key in ("advantage", "value_target"):
        batch[key] = judged[key].to(reward.dtype)


@torch.no_grad()
def values(batch: TensorDictBase, critic: ValueOperator) -> tuple[Tensor, Tensor]:
    """Values [N, T, 1] of the situations of a batch [N, T], and of those that follow."""
    value = _judge(batch.reshape(-1), critic).view(batch["next", "reward"].shape)
    following = value.roll(-1, 1)
    last = batch["next", "done"].squeeze(-1).clone()
    last[:, -1] = True  # what follows is not the next decision of the batch
    following[last] = _judge(batch["next"][last], critic)
    return value, following


def _judge(situations: TensorDictBase, critic: ValueOperator) -> Tensor:
    """Values [n, 1] of ``situations`` [n]."""
    seen = situations.select("seen")
    return torch.cat([critic(part)["state_value"] for part in seen.split(CHUNK)])


class Learner:
    """Actor, critic and their optimiser."""

    def __init__(self, config: PPOConfig, env: SatelliteTasking) -> None:
        """Fresh networks for an environment; ValueError if it does not fit them."""
        self.config = config
        self.plan = PLANS[config.network].of(env, config.hidden)
        self.networks: Networks = self.plan.build().to(env.device)
        self.loss = ClipPPOLoss(
            self.networks.actor,
            self.networks.critic,
            clip_epsilon=config.clip,
            entropy_coeff=config.entropy,
            normalize_advantage=True,
            loss_critic_type="l2",
        )
        self.optimiser = torch.optim.Adam(self.loss.parameters(), config.learning_rate, eps=1e-5)
        self.recurrent = self.networks.unit is not None
        self.buffer = ReplayBuffer(
            storage=LazyTensorStorage(config.batch // self._length, device=env.device),
            sampler=SamplerWithoutReplacement(),
            batch_size=self._minibatch // self._length,
        )

    @property
    def _length(self) -> int:
        """Decisions that stay together: the whole rollout of an environment for networks that remember."""
        return self.config.rollout if self.recurrent else 1

    @property
    def _minibatch(self) -> int:
        return max(min(self.config.minibatch, self.config.batch), self._length)

    @property
    def learning_rate(self) -> float:
        """Present step of the optimiser."""
        return float(self.optimiser.param_groups[0]["lr"])

    def anneal(self, fraction: float) -> None:
        """Set learning rate and weight of the entropy for a used ``fraction`` of the budget."""
        config = self.config
        self.optimiser.param_groups[0]["lr"] = config.learning_rate * SCHEDULES[config.learning_rate_schedule](fraction)
        self.loss.entropy_coeff.fill_(config.entropy * SCHEDULES[config.entropy_schedule](fraction))

    def state_dict(self) -> dict[str, Any]:
        """Networks, normaliser and optimiser."""
        return {name: getattr(self, name).state_dict() for name in ("loss", "optimiser")} | {
            "sight": self.networks.sight.state_dict()
        }

    def load_state_dict(self, state: Mapping[str, Any]) -> None:
        """Go on from what :meth:`state_dict` gave."""
        self.loss.load_state_dict(state["loss"])
        self.optimiser.load_state_dict(state["optimiser"])
        self.networks.sight.load_state_dict(state["sight"])

    def learn(self, batch: TensorDictBase) -> dict[str, float]:
        """Several passes over a batch [N, T]; means of what the loss reports."""
        config = self.config
        for situations in (batch, batch["next"]):
            self.networks.sight(situations)
        estimate_advantages(batch, self.networks.critic, config.gamma, config.lmbda, config.reward_time)
        self.buffer.empty()
        learned = batch.select(*LEARNED_FROM, *((MEMORY, INIT) if self.recurrent else ()))
        self.buffer.extend(learned if self.recurrent else learned.reshape(-1))
        steps = config.epochs * (config.batch // self._minibatch)
        with set_recurrent_mode(self.recurrent):
            reports = [self._descend(self.buffer.sample()) for _ in range(steps)]
        self.networks.sight.update(batch)  # afterwards: networks learn from what they saw when they decided
        means = torch.stack(reports).mean(0)
        return dict(zip(REPORTED, means.tolist(), strict=True))

    def _descend(self, sample: TensorDictBase) -> Tensor:
        """One gradient step; what the loss reports, [R]."""
        losses = self.loss(sample)
        self.optimiser.zero_grad()
        (losses["loss_objective"] + losses["loss_critic"] + losses["loss_entropy"]).backward()
        nn.utils.clip_grad_norm_(self.loss.parameters(), self.config.gradient_norm)
        self.optimiser.step()
        return torch.stack([losses[name].detach().mean().float() for name in REPORTED])
