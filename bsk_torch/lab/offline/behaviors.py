"""Behavior policies of offline data, whose action probabilities are known."""

from __future__ import annotations

import re
from dataclasses import dataclass

import torch
from tensordict import TensorDict, TensorDictBase
from tensordict.nn import TensorDictModuleBase
from torch import Tensor

from bsk_torch._checks import number
from bsk_torch.lab.offline.layout import LOG_PROB
from bsk_torch.rl.rules.baselines import LOT, RandomPolicy

BELOW_ONE = 1.0 - 2.0**-53
"""Largest float64 below 1."""


@dataclass(frozen=True)
class Behavior:
    """A policy that acts in a dataset: the most probable actions of a policy, replaced by random ones with some probability.

    Attributes:
        name: Name in the dataset.
        policy: Writes the actions of one satellite; None for random actions only.
        random: Probability of a random legal action instead, drawn with equal probability; 1 without a policy.
    """

    name: str
    policy: TensorDictModuleBase | None
    random: float = 0.0

    def __post_init__(self) -> None:
        share = number("random", self.random, 0.0, 1.0)
        if self.policy is None and share < 1.0:
            raise ValueError(f"behavior {self.name!r}: random={share:g} must be 1 without a policy")
        if self.policy is not None and LOT in self.policy.in_keys:
            raise ValueError(
                f"behavior {self.name!r}: the policy draws its actions, with unknown probabilities; use policy=None, random=1"
            )

    def module(self) -> PartlyRandom:
        """Return the behavior as a policy, which also writes probabilities."""
        return PartlyRandom(self.policy, float(self.random))


class PartlyRandom(TensorDictModuleBase):
    """Takes the actions of a policy, or with some probability random legal ones, and writes the probability of the result."""

    def __init__(self, policy: TensorDictModuleBase | None, share: float) -> None:
        """Replace the actions of ``policy`` with probability ``share``."""
        super().__init__()
        self.policy, self.share = policy, share
        self._uniform = RandomPolicy(torch.Generator())
        keys = [] if policy is None else policy.in_keys
        self.in_keys = [*dict.fromkeys([*keys, "action_mask", LOT])]
        self.out_keys = ["action", LOG_PROB]

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Write ``action`` and ``action_log_prob`` [N], from the uniform numbers ``lot`` [N]."""
        mask, lot = tensordict["action_mask"], tensordict[LOT]
        action = self._draw(mask, lot) if self.share > 0.0 else torch.zeros_like(lot, dtype=torch.int64)
        probability = torch.full_like(lot, self.share) / mask.sum(-1).clamp(min=1)
        if self.policy is not None:
            preferred = self.policy(tensordict)["action"]
            action = torch.where(lot < self.share, action, preferred)
            probability = probability + (1.0 - self.share) * (action == preferred)
        return tensordict.update({"action": action, LOG_PROB: probability.log().float()})

    def _draw(self, mask: Tensor, lot: Tensor) -> Tensor:
        """Return random legal actions, [N], for the part of ``lot`` below the share; the others are not used."""
        scaled = (lot / self.share).clamp(max=BELOW_ONE)
        return self._uniform(TensorDict({"action_mask": mask, LOT: scaled}, mask.shape[:-1]))["action"]


def slug(name: str) -> str:
    """Return a name of a folder: ``pretrained,random=0.2`` becomes ``pretrained-random-0-2``."""
    return re.sub(r"[^A-Za-z0-9_]+", "-", name).strip("-")
