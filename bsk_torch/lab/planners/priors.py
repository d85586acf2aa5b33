"""Prior probabilities of actions, from the probabilities of networks or the ranking of rules."""

from __future__ import annotations

import torch
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModuleBase
from torch import Tensor

from bsk_torch.env.rollout import decide
from bsk_torch.lab.planners.agent_table import AgentTable

RANKED = 8
"""Number of rule choices ranked individually; the others are equally likely."""

DECAY = 0.5
"""Ratio of the probabilities of a rule's choice and of its next best one."""


class Prior:
    """Probabilities of the legal actions of one agent in each row, from a policy.

    Networks provide probabilities directly. A rule, or any other policy that respects masks, is queried repeatedly, each time
    without the actions already chosen. Its k-th choice gets a probability proportional to :data:`DECAY` to the power k, and each
    action not chosen that of the next one. For rules that ignore the mask, only the first choice counts.
    """

    def __init__(self, policy: TensorDictModuleBase, slots: AgentTable, ranked: int = RANKED) -> None:
        """Query ``policy``, for all agents, for at most ``ranked`` choices."""
        self.policy, self.slots, self.ranked = policy, slots, ranked

    def __call__(self, td: TensorDictBase, slot: Tensor, legal: Tensor) -> Tensor:
        """Return probabilities [n, A] of the ``legal`` actions [n, A] of the agents ``slot`` [n]; zero if none is legal."""
        asked = td.clone(recurse=False)
        decided = decide(self.policy, asked)
        if self.slots.groups == [None] and "logits" in decided.keys():  # noqa: SIM118  - a tensordict
            weight = decided["logits"].double().masked_fill(~legal, -torch.inf)
            return torch.nan_to_num(torch.softmax(weight, -1))
        return self._by_rank(td, decided, slot, legal)

    def _by_rank(self, td: TensorDictBase, decided: TensorDictBase, slot: Tensor, legal: Tensor) -> Tensor:
        numbers = torch.arange(legal.shape[1], device=legal.device)
        weight = torch.ones(legal.shape, dtype=torch.float64, device=legal.device)
        left = legal.clone()
        for _ in range(min(self.ranked, legal.shape[1])):
            choice = self.slots.at(self.slots.chosen(decided), slot)
            named = (numbers == choice.unsqueeze(1)) & left
            left = left & ~named
            weight = torch.where(left & named.any(1, keepdim=True), DECAY * weight, weight)
            if not bool(left.any()):
                break
            asked = td.clone()
            self._mask(asked, slot, left)
            decided = decide(self.policy, asked)
        weight = weight * legal
        return weight / weight.sum(1, keepdim=True).clamp(min=1e-300)

    def _mask(self, td: TensorDictBase, slot: Tensor, left: Tensor) -> None:
        """Write the mask ``left`` [n, A] of the agents ``slot``, or the original mask if no action is left."""
        some = left.any(1)
        for group, first, size, n in zip(
            self.slots.groups, self.slots.first, self.slots.sizes, self.slots.n_actions, strict=True
        ):
            if not n:
                continue
            if group is None:
                td["action_mask"] = torch.where(some.unsqueeze(1), left, td["action_mask"])
                continue
            here = (slot.unsqueeze(1) == first + torch.arange(size, device=slot.device)) & some.unsqueeze(1)
            old = td[group, "action_mask"]
            own = torch.where(here.unsqueeze(-1), left[:, :n].unsqueeze(1), old[..., :n])
            td[group, "action_mask"] = torch.cat([own, old[..., n:]], -1)
