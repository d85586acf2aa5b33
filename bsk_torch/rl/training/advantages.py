"""Advantages of batches that the trainer collected, by :mod:`bsk_torch.rl.durations`.

Where an episode ends at its time limit, V' is that of a state in which no decision is ever made, so that no reward corrects it.
With a discount that looks far beyond the limit, the policy then maximizes what the critic imagines. Returns therefore end with
the episode, as they are reported, unless ``beyond_limit`` asks for V'; see :func:`final`.
"""

from __future__ import annotations

import torch
from tensordict import TensorDictBase
from torch import Tensor
from torchrl.modules import PopArtValueNorm, ValueOperator
from torchrl.modules.value_norm import ValueNorm

from bsk_torch.rl.durations import estimate_advantages

CHUNK = 2048
"""Decisions whose values are computed at once: attention over more would leave the processor's cache."""

CUT = "cut"
"""Key, under ``next``, of ends [N, T, 1] that training makes, not the environment; none without it."""

FINAL = "final"
"""Key, under ``next``, of ends after which nothing is expected; see :func:`final`."""

LEAST_ADVANTAGE, LEAST_VALUE = 1e-9, 1e-12
"""Least divisors of advantages and of values. Before the first reward, values are that small and give no
advantage; rewards of 1e-6 already do."""

MEMORY_OF_VALUES = 0.9
"""Share of the running mean and variance of value targets that is left after another batch."""


def final(batch: TensorDictBase, beyond_limit: bool) -> Tensor:
    """Return after which steps of a batch [N, T] nothing is expected, [N, T, 1].

    Args:
        batch: Decisions, with the flags ``done``, ``terminated`` and, unless none was cut, :data:`CUT` under ``next``.
        beyond_limit: Whether only ``terminated`` episodes are over. False: those that the environment truncates are over, too;
            those that training cuts are not.
    """
    following = batch["next"]
    if beyond_limit:
        return following["terminated"]
    cut = following.get(CUT, None)
    return following["done"] if cut is None else following["done"] & ~cut


def make_value_norm() -> PopArtValueNorm:
    """Return a running mean and deviation of value targets, in which critics give their values; so rewards may have any scale."""
    return PopArtValueNorm(shape=1, beta=MEMORY_OF_VALUES, epsilon=LEAST_VALUE**2).double()


def write_advantages(
    batch: TensorDictBase,
    critic: ValueOperator,
    gamma: float,
    lmbda: float,
    reward_time: str = "end",
    *,
    done: str = "done",
    terminated: str = "terminated",
    value_norm: ValueNorm | None = None,
) -> None:
    """Write ``advantage`` and ``value_target`` of a batch [N, T] by :func:`~bsk_torch.rl.durations.estimate_advantages`.

    Args:
        batch: Decisions in order of time, with ``reward`` and ``duration`` [N, T, ..., 1] of each under ``next``.
        critic: Computes values of observations, at the root and under ``next``.
        gamma: Discount per second.
        lmbda: Decay of the estimator, per decision.
        reward_time: ``"end"`` or ``"start"``.
        done: Key, under ``next``, of ends after which another episode begins.
        terminated: Key, under ``next``, of ends after which nothing is expected.
        value_norm: The values of ``critic`` are deviations from a mean that it knows; None for values without a unit.
    """
    value, following = (
        value if value_norm is None else value_norm.denormalize(value.double()).to(value.dtype) for value in values(batch, critic)
    )
    batch["advantage"], batch["value_target"] = estimate_advantages(
        batch["next", "reward"],
        batch["next", "duration"],
        value,
        following,
        batch["next", done],
        batch["next", terminated],
        gamma=gamma,
        lmbda=lmbda,
        reward_time=reward_time,
    )


def standardize(batch: TensorDictBase, value_norm: ValueNorm, counts: Tensor | None = None) -> None:
    """Express ``advantage`` and ``value_target`` [..., 1] of a batch in deviations, so that learning does not see their scale.

    Args:
        batch: What :func:`write_advantages` wrote to.
        value_norm: Running mean and deviation of targets, which takes those of the batch into account first.
        counts: Decisions to learn from, [...]; None for all.
    """
    advantage, target = batch["advantage"], batch["value_target"].double()
    samples = (advantage, target) if counts is None else (advantage[counts], target[counts])
    deviation, mean = torch.std_mean(samples[0])
    batch["advantage"] = (advantage - mean) / deviation.clamp(min=LEAST_ADVANTAGE)
    value_norm.update(samples[1])
    batch["value_target"] = value_norm.normalize(target).to(advantage.dtype)


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
