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

OBSERVATION, MASK, MEMORY = ("observation",), ("action_mask",), ("memory",)


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


class Recurrent(nn.Module):
    """Layers, a gated recurrent unit, and a last layer."""

    def __init__(self, layers: nn.Module, unit: nn.GRU, head: nn.Linear) -> None:
        """Take the parts of the actor of a :class:`~bsk_torch.rl.networks.plans.GRUPlan`."""
        super().__init__()
        self.layers, self.unit, self.head = layers, unit, head

    def forward(self, x: Tensor, memory: Tensor) -> tuple[Tensor, Tensor]:
        """Return the outputs [N, A], and the memory after this decision, [N, 1, H], of features [N, D] and the memory before."""
        remembered, memory = self.unit(self.layers(x).unsqueeze(1), memory.transpose(0, 1).contiguous())
        return self.head(remembered.squeeze(1)), memory.transpose(0, 1)


class PolicyGraph(nn.Module):
    """A policy for one satellite as a function of tensors, whose first dimension is the batch.

    Inputs are, in this order, the parts of the observation, the memory of a recurrent policy, [N, 1, H], and for numbered actions
    the mask. Outputs are ``action`` [N] int64 and ``logits`` [N, A], the network's numbers before the mask; or ``action`` [N, k]
    float32 of a continuous policy; and the memory for the next decision. The action is the most probable one, as in
    :func:`bsk_torch.rl.evaluation.evaluate`.

    Attributes:
        plan: Sizes of the networks.
        paths: Keys of the inputs.
        own: Normalizer of the vector, or of the parts other than the set.
        rows: Normalizer of the set; None for a vector.
        network: The actor's network.
        only: Conditions of a shield, which narrows the mask; empty without one.
    """

    def __init__(self, plan: Plan, policy: TensorDictModuleBase) -> None:
        """Take the networks of a policy."""
        super().__init__()
        *_, normaliser, actor = cast(TensorDictSequential, policy).module
        self.plan = plan
        self.only: Sequence[Only] = ()
        self.own = Standard(normaliser.own)
        self.rows = Standard(normaliser.rows) if isinstance(normaliser, SetNormaliser) else None
        first = actor.module[0]
        *before, last = first.module if isinstance(plan, GRUPlan) else [first]
        head = last.module.network if isinstance(last.module, NormalParameters) else last.module
        self.network: nn.Module = Recurrent(before[0].module, before[1].gru, cast(nn.Linear, head)) if before else head
        if isinstance(plan, AttentionPlan):
            paths = (*map(tuple, plan.own_keys), (*plan.set_key, "rows"), (*plan.set_key, "mask"))
        else:
            paths = (OBSERVATION, *([MEMORY] if isinstance(plan, GRUPlan) else []))
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
        after = ("next.memory",) if MEMORY in self.paths else ()
        return ("action", *after) if self.is_real else ("action", "logits", *after)

    def limits(self) -> Tensor:
        """Return the ranges outside which numbers of the vector, and of a set's first row after it, are clipped, [2, D]."""
        return torch.cat([self.own.limits(), *([] if self.rows is None else [self.rows.limits()])], -1)

    def forward(self, *inputs: Tensor) -> tuple[Tensor, ...]:
        """Return the outputs for inputs [N, ...] each."""
        entries = dict(zip(self.paths, inputs, strict=True))
        parts = [value for path, value in entries.items() if path[:1] == OBSERVATION]
        after: list[Tensor] = []
        if self.rows is not None:
            *own, rows, exists = parts
            out = self.network(self.own(flat(own)), self.rows(rows), exists.bool(), entries[MASK])
        elif MEMORY in entries:
            out, *after = self.network(self.own(parts[0]), entries[MEMORY])
        else:
            out = self.network(self.own(parts[0]))
        if self.is_real:
            return (out.tanh().clamp(-EDGE, EDGE) * self.reach + self.middle, *after)
        legal = narrowed(self.only, flat(parts), entries[MASK]) if self.only else entries[MASK]
        return (out.masked_fill(~legal, -torch.inf).argmax(-1), out, *after)
