"""A trained policy as one module of tensors: normalizer, network, mask and choice of the action."""

from __future__ import annotations

from collections.abc import Sequence
from typing import cast

import torch
from tensordict.nn import TensorDictModuleBase, TensorDictSequential
from torch import Tensor, nn

from bsk_torch.lab.export.shield import Only, narrowed
from bsk_torch.rl.networks.normaliser import FLOOR, LARGEST, FeatureNormaliser, SetNormaliser, symlog
from bsk_torch.rl.networks.plans import AttentionPlan, GRUPlan, NormalParameters, Plan

EDGE = 1.0 - 1e-6
"""Largest hyperbolic tangent of a continuous action, as in TorchRL's ``TanhNormal`` for float32."""

Path = tuple[str, ...]
"""Key of an input in the view of one satellite."""

OBSERVATION, MASK = ("observation",), ("action_mask",)


def flat(parts: Sequence[Tensor]) -> Tensor:
    """Return parts of observations [N, ...] side by side, [N, D]."""
    return torch.cat([part.reshape(part.shape[0], -1) for part in parts], -1)


class Standard(nn.Module):
    """What a :class:`~bsk_torch.rl.networks.normaliser.FeatureNormaliser` computes after its training, bit for bit."""

    def __init__(self, normaliser: FeatureNormaliser) -> None:
        """Take mean and standard deviation of symlog(x) in float32."""
        super().__init__()
        self.register_buffer("mean", normaliser.mean.float())
        self.register_buffer("deviation", normaliser.variance.sqrt().clamp(min=FLOOR).float())

    mean: Tensor
    deviation: Tensor

    def forward(self, x: Tensor) -> Tensor:
        """Return the standardized features, [..., F]."""
        return ((symlog(x) - self.mean) / self.deviation).clamp(-LARGEST, LARGEST)

    def limits(self) -> Tensor:
        """Return the observations below and above which features are clipped, [2, F] float64."""
        ends = self.mean.double() + torch.tensor([[-LARGEST], [LARGEST]], dtype=torch.float64) * self.deviation.double()
        return ends.sign() * torch.expm1(ends.abs())


class PolicyGraph(nn.Module):
    """A policy for one satellite as a function of tensors, whose first dimension is the batch.

    Inputs are, in this order, the parts of the observation and for numbered actions the mask. Outputs are ``action`` [N] int64
    and ``logits`` [N, A], the network's numbers before the mask; or ``action`` [N, k] float32 of a continuous policy. The action
    is the most probable one, as in :func:`bsk_torch.rl.evaluation.evaluate`.

    Attributes:
        plan: Sizes of the networks.
        paths: Keys of the inputs.
        own: Normalizer of the vector, or of the parts other than the set.
        rows: Normalizer of the set; None for a vector.
        network: The actor's network.
        only: Conditions of a shield, which narrows the mask; empty without one.
    """

    def __init__(self, plan: Plan, policy: TensorDictModuleBase) -> None:
        """Take the networks of a policy; ValueError for one with a memory."""
        super().__init__()
        if isinstance(plan, GRUPlan):
            raise ValueError("network='gru' keeps a memory between decisions; 'mlp' and 'attention' can be exported")
        normaliser, actor = cast(TensorDictSequential, policy).module
        self.plan = plan
        self.only: Sequence[Only] = ()
        self.own = Standard(normaliser.own)
        self.rows = Standard(normaliser.rows) if isinstance(normaliser, SetNormaliser) else None
        network = actor.module[0].module
        self.network: nn.Module = network.network if isinstance(network, NormalParameters) else network
        if isinstance(plan, AttentionPlan):
            paths = (*map(tuple, plan.own_keys), (*plan.set_key, "rows"), (*plan.set_key, "mask"))
        else:
            paths = (OBSERVATION,)
        self.is_real = bool(getattr(plan, "bounds", ()))
        self.paths: tuple[Path, ...] = paths if self.is_real else (*paths, MASK)
        if self.is_real:
            low, high = torch.tensor(plan.bounds, dtype=torch.float32).unbind(-1)  # type: ignore[union-attr]
            self.register_buffer("middle", (high + low) / 2)
            self.register_buffer("reach", (high - low) / 2)

    middle: Tensor
    reach: Tensor

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the inputs: their keys, with dots."""
        return tuple(".".join(path) for path in self.paths)

    @property
    def outputs(self) -> tuple[str, ...]:
        """Names of the outputs."""
        return ("action",) if self.is_real else ("action", "logits")

    def limits(self) -> Tensor:
        """Return the ranges outside which numbers of the vector, and of a set's first row after it, are clipped, [2, D]."""
        return torch.cat([self.own.limits(), *([] if self.rows is None else [self.rows.limits()])], -1)

    def forward(self, *inputs: Tensor) -> tuple[Tensor, ...]:
        """Return the outputs for inputs [N, ...] each."""
        if self.is_real:
            return (self.network(self.own(inputs[0])).tanh().clamp(-EDGE, EDGE) * self.reach + self.middle,)
        *parts, legal = inputs
        if self.rows is None:
            logits = self.network(self.own(parts[0]))
        else:
            *own, rows, exists = parts
            logits = self.network(self.own(flat(own)), self.rows(rows), exists.bool(), legal)
        if self.only:
            legal = narrowed(self.only, flat(parts), legal)
        return logits.masked_fill(~legal, -torch.inf).argmax(-1), logits
