"""The loss of proximal policy optimization, directly on tensors.

It is what TorchRL's ``ClipPPOLoss`` computes. The bookkeeping of a loss module, which swaps parameters of networks and nests
tensordicts in every gradient step, took longer than the networks of a satellite.
"""

from __future__ import annotations

from typing import NamedTuple

import torch
from tensordict import TensorDictBase
from tensordict.nn import ProbabilisticTensorDictSequential, TensorDictModule, TensorDictModuleBase
from torch import Tensor
from torchrl.modules import ValueOperator

PLAIN = (TensorDictModule, ValueOperator)
"""Modules that call a network with tensors, and write what it returns."""

ILLEGAL = -1e9
"""Logit of illegal actions: finite, so that these add zero to the entropy and not nan."""


class Terms(NamedTuple):
    """Means over decisions: what is minimized, and what shows how learning proceeds."""

    objective: Tensor
    loss_critic: Tensor
    entropy: Tensor
    kl_approx: Tensor
    clip_fraction: Tensor
    explained_variance: Tensor


def log_probabilities(logits: Tensor, legal: Tensor) -> Tensor:
    """Return the logarithms of the probabilities of actions, [..., A] float32; about -1e9 for those that are not ``legal``."""
    return logits.float().masked_fill(~legal, ILLEGAL).log_softmax(-1)


def log_probability(table: Tensor, action: Tensor) -> Tensor:
    """Return the entry [...] of ``action`` [...] in a table [..., A]."""
    return table.gather(-1, action.unsqueeze(-1)).squeeze(-1)


def write(module: TensorDictModuleBase, sample: TensorDictBase) -> None:
    """Write the outputs of a module into ``sample``; a plain network is called without what surrounds it, which takes longer."""
    if type(module) not in PLAIN:
        module(sample)
        return
    outputs = module.module(*(sample[key] for key in module.in_keys))
    for key, value in zip(module.out_keys, outputs if isinstance(outputs, tuple) else (outputs,), strict=True):
        sample[key] = value


def _probability_and_entropy(actor: ProbabilisticTensorDictSequential, sample: TensorDictBase) -> tuple[Tensor, Tensor]:
    """Return the log-probability of the actions in ``sample``, and the entropy of the distributions, [...] each."""
    write(actor[0], sample)
    logits = sample.get("logits", None)
    if logits is not None:
        table = log_probabilities(logits, sample["action_mask"])
        return log_probability(table, sample["action"]), -(table.exp() * table).sum(-1)
    distribution = actor.build_dist_from_params(sample)
    sampled_action = distribution.rsample()  # a squashed normal distribution has no entropy in closed form
    return distribution.log_prob(sample["action"]), -distribution.log_prob(sampled_action)


def unjudged(actor: ProbabilisticTensorDictSequential, sample: TensorDictBase, counts: Tensor | None = None) -> Terms:
    """Return the terms that need no advantages and values, and nan for the others; arguments as for :func:`clipped_loss`."""
    log_prob, entropy = _probability_and_entropy(actor, sample)
    parts = log_prob - sample["action_log_prob"], entropy
    log_ratio, entropy = parts if counts is None else (part[counts] for part in parts)
    unknown = entropy.new_tensor(torch.nan)
    return Terms(unknown, unknown, entropy.mean(), -log_ratio.detach().mean(), unknown, unknown)


def clipped_loss(
    actor: ProbabilisticTensorDictSequential,
    critic: TensorDictModuleBase,
    sample: TensorDictBase,
    clip: float,
    counts: Tensor | None = None,
) -> Terms:
    """Return the clipped surrogate objective, and the squared error of the values, of a sample of decisions.

    See Schulman et al. 2017, arXiv:1707.06347.

    Args:
        actor: Distribution of actions.
        critic: Writes ``state_value`` [..., 1].
        sample: Decisions [...] with ``action``, ``action_log_prob`` by the policy that made them, ``advantage`` [..., 1] and
            ``value_target`` [..., 1]; logits, if the actor gives any, and values are added.
        clip: Distance from one at which ratios of probabilities are clipped.
        counts: Decisions that count, [...]; None for all.
    """
    log_prob, entropy = _probability_and_entropy(actor, sample)
    write(critic, sample)
    parts = (
        log_prob - sample["action_log_prob"],
        entropy,
        sample["advantage"].squeeze(-1),
        sample["state_value"].squeeze(-1),
        sample["value_target"].squeeze(-1),
    )
    log_ratio, entropy, advantage, value, target = parts if counts is None else (part[counts] for part in parts)
    ratio = log_ratio.exp()
    clipped = ratio.clamp(1.0 - clip, 1.0 + clip)
    error = value - target
    with torch.no_grad():
        kl_approx, clip_fraction = -log_ratio.mean(), (clipped != ratio).float().mean()
        explained = 1.0 - error.var() / target.var()
    gain = torch.minimum(ratio * advantage, clipped * advantage)
    return Terms(-gain.mean(), error.square().mean(), entropy.mean(), kl_approx, clip_fraction, explained)
