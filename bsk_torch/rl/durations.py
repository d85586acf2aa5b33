"""Discounts per second for steps of different length, as functions of tensors and as value estimators of TorchRL.

With a discount gamma per second, a step of t seconds with reward r, and g = gamma^t, values V of a state and V' of the next are

    V = E[g (r + V')]     if rewards come at the end of their steps (``reward_time="end"``, as in BSK-RL),
    V = E[r + g V']       if they come at the start (``"start"``, as in TorchRL and Gymnasium learners).

The advantages are those of Schulman et al. 2016, arXiv:1506.02438, with g for gamma and a decay lambda per decision; semi-Markov
decision processes: Sutton, Precup and Singh 1999, doi:10.1016/S0004-3702(99)00052-1. The package's own trainer uses these
functions.
"""

from __future__ import annotations

from typing import Any

import torch
from tensordict import TensorDictBase
from torch import Tensor
from torchrl.objectives.value import GAE, TD0Estimator
from torchrl.objectives.value.advantages import ValueEstimatorBase
from typing_extensions import override

__all__ = ["DurationGAE", "DurationTD0", "estimate_advantages", "rewards_at_start", "td_targets"]


def rewards_at_start(reward: Tensor, seconds: Tensor, gamma: float | Tensor, reward_time: str = "end") -> Tensor:
    """Return rewards as of the start of their steps: gamma^t r if they come at the ``"end"``, r if at the ``"start"``.

    Args:
        reward: Rewards of steps, [...].
        seconds: Durations of the steps, [...] s.
        gamma: Discount per second.
        reward_time: ``"end"`` or ``"start"``.
    """
    return (reward.double() * gamma ** seconds.double()).to(reward.dtype) if reward_time == "end" else reward


def td_targets(
    reward: Tensor, seconds: Tensor, following: Tensor, terminated: Tensor, gamma: float, reward_time: str = "end"
) -> Tensor:
    """Return targets of values after one step: g (r + V') for rewards at the ``"end"``, r + g V' for rewards at the ``"start"``.

    Args:
        reward: Rewards of steps, [...].
        seconds: Durations of the steps, [...] s.
        following: Values V' of the states after them, [...], for example the largest Q value of a legal action.
        terminated: Steps after which nothing is expected, [...] bool.
        gamma: Discount per second.
        reward_time: ``"end"`` or ``"start"``.
    """
    discount = (gamma ** seconds.double()).to(reward.dtype)
    return rewards_at_start(reward, seconds, gamma, reward_time) + discount * following * ~terminated


def estimate_advantages(
    reward: Tensor,
    seconds: Tensor,
    value: Tensor,
    following: Tensor,
    done: Tensor,
    terminated: Tensor,
    *,
    gamma: float,
    lmbda: float,
    reward_time: str = "end",
    time_dim: int = 1,
) -> tuple[Tensor, Tensor]:
    """Return advantages, and targets of the value, of decisions in order of time.

    With rewards at the end of steps, A = g (r + V') - V + g lambda A', where V' is zero after a step that terminated the episode,
    and A' after any end and after the last step; the target of the value is A + V. The batch must not be flattened before.

    All tensors are [N, T, ...], or have the time in dimension ``time_dim``, and are broadcast, so that several agents
    [N, T, S, 1] may share ends [N, T, 1, 1].

    Args:
        reward: Rewards of the steps.
        seconds: Their durations, s. Discounts have this dtype: in float32, gamma is rounded to 3e-8, which changes a horizon of
            100,000 s (gamma=0.99999) by up to 0.3 %.
        value: Values V of the states in which the decisions were made.
        following: Values V' of the states after them, which after an end is the last state of the episode.
        done: Steps after which another episode begins, bool.
        terminated: Steps after which nothing is expected, bool; ``done`` without those truncated by a time limit.
        gamma: Discount per second.
        lmbda: Decay of the estimator, per decision.
        reward_time: ``"end"`` or ``"start"``.
        time_dim: Dimension of time.
    """
    discount = gamma**seconds
    gain = rewards_at_start(reward, seconds, gamma, reward_time) + discount * (~terminated).int() * following - value
    decay = (lmbda * discount * (~done).int()).expand_as(gain).unbind(time_dim)
    advantages, later = [], torch.zeros_like(gain.select(time_dim, 0))
    for surprise, carried in zip(reversed(gain.unbind(time_dim)), reversed(decay), strict=True):
        later = surprise + later * carried
        advantages.append(later)
    advantage = torch.stack(advantages[::-1], time_dim)
    return advantage, advantage + value


class _ByDuration(ValueEstimatorBase):
    """A value estimator of TorchRL, which itself has rewards at the start of steps and takes a missing duration for one step."""

    gamma: Tensor
    reward_time: str

    def _by_duration(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Return a copy with rewards as of the start of steps, and durations in double precision."""
        reward, seconds = ("next", self.tensor_keys.reward), self.tensor_keys.steps_to_next_obs
        copy, lasted = tensordict.copy(), tensordict[seconds].double().view_as(tensordict[reward])
        copy[reward] = rewards_at_start(copy[reward], lasted, self.gamma, self.reward_time)
        return copy.set(seconds, lasted)

    @override
    def value_estimate(self, tensordict: TensorDictBase, *args: Any, **options: Any) -> Tensor:
        """Return targets of the value, [..., T, 1]; arguments as in TorchRL."""
        target: Tensor = super().value_estimate(self._by_duration(tensordict), *args, **options)
        return target.to(tensordict["next", self.tensor_keys.reward].dtype)


class DurationGAE(_ByDuration, GAE):
    """TorchRL's :class:`~torchrl.objectives.value.GAE` with a discount per second.

    ``("next", "duration")`` [..., T, 1] s is the length of each step (another key: ``set_keys(steps_to_next_obs=...)``). A batch
    without it raises a KeyError; TorchRL would take all steps for equal.

    Example:
        >>> advantages = DurationGAE(gamma=0.99999, lmbda=0.95, value_network=critic)
        >>> advantages(batch)["advantage"].shape  # a batch of a collector, before it is flattened
    """

    def __init__(self, *, gamma: float, lmbda: float, reward_time: str = "end", **options: Any) -> None:
        """Set the discount.

        Args:
            gamma: Discount per second.
            lmbda: Decay of the estimator, per decision.
            reward_time: ``"end"`` if rewards come at the end of their steps, ``"start"`` as in TorchRL.
            **options: Arguments of TorchRL's GAE; ``value_network`` is None if left out, for batches that have values.
        """
        super().__init__(gamma=gamma, lmbda=lmbda, **({"value_network": None} | options))
        self.gamma, self.reward_time = torch.tensor(gamma, dtype=torch.float64, device=self.gamma.device), reward_time
        self.set_keys(steps_to_next_obs=("next", "duration"))

    @override
    def forward(self, tensordict: TensorDictBase, **options: object) -> TensorDictBase:
        """Write ``advantage`` and ``value_target`` [..., T, 1]; arguments as in TorchRL."""
        reward, seconds = ("next", self.tensor_keys.reward), self.tensor_keys.steps_to_next_obs
        return tensordict.update(super().forward(self._by_duration(tensordict), **options).exclude(reward, seconds))


class DurationTD0(_ByDuration, TD0Estimator):
    """TorchRL's :class:`~torchrl.objectives.value.TD0Estimator` with a discount per second, for DQN, SAC and similar losses.

    Example:
        >>> loss = DQNLoss(network, action_space="categorical", double_dqn=True)
        >>> loss.make_value_estimator(DurationTD0, gamma=0.9999)
    """

    def __init__(self, *, gamma: float, reward_time: str = "end", **options: Any) -> None:
        """Set the discount; arguments as for :class:`DurationGAE`, and those of TorchRL's TD0Estimator."""
        super().__init__(gamma=gamma, **({"value_network": None} | options))
        self.gamma, self.reward_time = torch.tensor(gamma, dtype=torch.float64, device=self.gamma.device), reward_time
        self.set_keys(steps_to_next_obs=("next", "duration"))
