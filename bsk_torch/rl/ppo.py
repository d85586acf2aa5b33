"""Proximal policy optimisation of one environment, with a discount that depends on how long a step took.

Decisions last different times, so the problem is a semi-Markov decision process: with gamma per second and a step of t seconds,
the value of a state is the expectation of gamma^t (reward + value of the next state). The reward is discounted over its interval
too, as bsk_rl's ``TimeDiscountedGAE`` does.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import Any

import torch
from tensordict import TensorDictBase
from torch import Tensor, nn
from torchrl.data import LazyTensorStorage, ReplayBuffer, SamplerWithoutReplacement
from torchrl.modules import ValueOperator
from torchrl.objectives import ClipPPOLoss
from torchrl.objectives.value import GAE

from bsk_torch.env import SatelliteTasking
from bsk_torch.presets import make
from bsk_torch.rl.policies import PLANS, Networks, check_network

REPORTED = ("entropy", "kl_approx", "clip_fraction", "explained_variance", "loss_critic")
"""What the log takes from the loss."""

LEAST = 0.05
"""Fraction of learning rate and entropy weight that is left at the end."""

CHUNK = 2048
"""Decisions whose values are computed at once: attention over more would leave the processor's cache."""

LEARNED_FROM = ("seen", "action_mask", "action", "action_log_prob", "advantage", "value_target")
"""Keys of a batch that gradient steps need."""


@dataclass(frozen=True)
class PPOConfig:
    """What to train, for how long, and how.

    Args:
        preset: Name of the environment; see :func:`bsk_torch.make`.
        network: ``"mlp"`` for observation vectors, ``"attention"`` for targets observed as a set.
        seconds: Training time after compilation, s; None for no limit.
        frames: Number of decisions; None for no limit. One of the two limits is needed.
        num_envs: Episodes at once.
        rollout: Decisions of each between two updates.
        seed: Seed of networks, actions and episodes.
        hidden: Width of every hidden layer, or of every block of attention.
        learning_rate: Adam's step at the start; it falls linearly to :data:`LEAST` of that.
        gamma: Discount per second.
        lmbda: Decay of the advantage estimator, per decision.
        clip: Largest change of an action's probability, as a ratio's distance from one.
        entropy: Weight of the entropy at the start; it falls as the learning rate does.
        epochs: Passes over a batch.
        minibatch: Decisions in a gradient step.
        gradient_norm: Gradients are scaled down to this norm.
        options: Arguments of the environment that differ from the preset's.
    """

    preset: str = "NadirScan-v1"
    network: str = "mlp"
    seconds: float | None = 180.0
    frames: int | None = None
    num_envs: int = 1024
    rollout: int = 16
    seed: int = 0
    hidden: tuple[int, ...] = (64, 64)
    learning_rate: float = 2.5e-3
    gamma: float = 0.99999
    lmbda: float = 0.95
    clip: float = 0.2
    entropy: float = 0.01
    epochs: int = 8
    minibatch: int = 2048
    gradient_norm: float = 0.5
    options: dict[str, Any] = dataclasses.field(default_factory=dict)

    def __post_init__(self) -> None:
        """Refuse training without end, unknown networks, and discounts that are none."""
        check_network(self.network)
        limits = [limit for limit in (self.seconds, self.frames) if limit is not None]
        if not limits or min(limits) <= 0:
            raise ValueError(f"seconds={self.seconds} and frames={self.frames}: training needs a limit, and a positive one")
        if not 0.0 < self.gamma <= 1.0:
            raise ValueError(f"gamma={self.gamma} per second must lie in (0, 1]")

    @property
    def batch(self) -> int:
        """Decisions between two updates."""
        return self.num_envs * self.rollout

    def make_env(self) -> SatelliteTasking:
        """The environment to train in."""
        return make(self.preset, num_envs=self.num_envs, seed=self.seed, **self.options)


def estimate_advantages(batch: TensorDictBase, critic: ValueOperator, gamma: float, lmbda: float) -> None:
    """Write ``advantage`` and ``value_target`` of a batch [N, T], in semi-Markov time.

    Args:
        batch: Decisions in order of time, with ``reward`` and ``duration`` [N, T, 1] of each under ``next``.
        critic: Judges what is seen, here and under ``next``.
        gamma: Discount per second.
        lmbda: Decay of the estimator, per decision.
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
    judged["next", "reward"] = (reward.double() * gamma ** seconds.double()).to(reward.dtype)
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
        self.buffer = ReplayBuffer(
            storage=LazyTensorStorage(config.batch, device=env.device),
            sampler=SamplerWithoutReplacement(),
            batch_size=self._minibatch,
        )

    @property
    def _minibatch(self) -> int:
        return min(self.config.minibatch, self.config.batch)

    @property
    def learning_rate(self) -> float:
        """Present step of the optimiser."""
        return float(self.optimiser.param_groups[0]["lr"])

    def anneal(self, fraction: float) -> None:
        """Set learning rate and weight of the entropy for a used ``fraction`` of the budget."""
        left = max(LEAST, 1.0 - fraction)
        self.optimiser.param_groups[0]["lr"] = self.config.learning_rate * left
        self.loss.entropy_coeff.fill_(self.config.entropy * left)

    def learn(self, batch: TensorDictBase) -> dict[str, float]:
        """Several passes over a batch [N, T]; means of what the loss reports."""
        self.networks.sight.update(batch)
        for situations in (batch, batch["next"]):
            self.networks.sight(situations)
        estimate_advantages(batch, self.networks.critic, self.config.gamma, self.config.lmbda)
        self.buffer.empty()
        self.buffer.extend(batch.select(*LEARNED_FROM).reshape(-1))
        steps = self.config.epochs * (self.config.batch // self._minibatch)
        reports = [self._descend(self.buffer.sample()) for _ in range(steps)]
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
