"""Prior probabilities of actions, from the probabilities of networks or the ranking of rules, and summaries of states."""

from __future__ import annotations

import torch
from tensordict import TensorDict, TensorDictBase
from tensordict.nn import TensorDictModuleBase
from torch import Tensor

from bsk_torch.env import Tasking
from bsk_torch.env.rollout import decide
from bsk_torch.lab.planners.agent_table import NO_AGENT, AgentTable
from bsk_torch.lab.planners.branches import carried

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
        query = td.clone(recurse=False)
        decided = decide(self.policy, query)
        if self.slots.groups == [None] and "logits" in decided.keys():  # noqa: SIM118  - a tensordict
            weight = decided["logits"].double().masked_fill(~legal, -torch.inf)
            return torch.nan_to_num(torch.softmax(weight, -1))
        return self._by_rank(td, decided, slot, legal)

    def _by_rank(self, td: TensorDictBase, decided: TensorDictBase, slot: Tensor, legal: Tensor) -> Tensor:
        numbers = torch.arange(legal.shape[1], device=legal.device)
        weight = torch.ones(legal.shape, dtype=torch.float64, device=legal.device)
        remaining = legal.clone()
        for _ in range(min(self.ranked, legal.shape[1])):
            choice = self.slots.at(self.slots.chosen(decided), slot)
            top = (numbers == choice.unsqueeze(1)) & remaining
            remaining = remaining & ~top
            weight = torch.where(remaining & top.any(1, keepdim=True), DECAY * weight, weight)
            if not bool(remaining.any()):
                break
            query = td.clone()
            self._mask(query, slot, remaining)
            decided = decide(self.policy, query)
        weight = weight * legal
        return weight / weight.sum(1, keepdim=True).clamp(min=1e-300)

    def _mask(self, td: TensorDictBase, slot: Tensor, allowed: Tensor) -> None:
        """Write the mask ``allowed`` [n, A] of the agents ``slot``, or the original mask if no action is left."""
        some = allowed.any(1)
        for group, first, size, n in zip(
            self.slots.groups, self.slots.first, self.slots.sizes, self.slots.n_actions, strict=True
        ):
            if not n:
                continue
            if group is None:
                td["action_mask"] = torch.where(some.unsqueeze(1), allowed, td["action_mask"])
                continue
            agents = (slot.unsqueeze(1) == first + torch.arange(size, device=slot.device)) & some.unsqueeze(1)
            old = td[group, "action_mask"]
            new = torch.where(agents.unsqueeze(-1), allowed[:, :n].unsqueeze(1), old[..., :n])
            td[group, "action_mask"] = torch.cat([new, old[..., n:]], -1)


class StateSummary:
    """Summarizes states in which one agent chooses and the others follow the base policy.

    If several agents decide, the first one chooses. If none does, as after a step of maximum duration, the only action is 0, of
    NO_AGENT, and all continue.
    """

    def __init__(
        self, env: Tasking, slots: AgentTable, base: TensorDictModuleBase, plannable: Tensor, prior: Prior, most: int | None
    ) -> None:
        """Allow the ``most`` probable actions, or all legal ones; the agents ``plannable`` [S] choose."""
        self.env, self.slots, self.base, self.plannable, self.prior, self.most = env, slots, base, plannable, prior, most

    def __call__(self, td: TensorDictBase) -> TensorDict:
        """Return ``slot`` [n], ``legal`` [n, A], ``prior`` [n, A], ``mine`` [n] (the base policy's action) and ``memory`` [n]."""
        deciding = self.slots.deciding(td) & self.plannable
        return self.of_agent(td, torch.where(deciding.any(1), deciding.long().argmax(1), NO_AGENT))

    def of_agent(self, td: TensorDictBase, slot: Tensor) -> TensorDict:
        """Return the same for the agents ``slot`` [n]."""
        query = td.clone(recurse=False)
        memory = carried(query, self.base, self.env)
        base = self.slots.at(self.slots.chosen(decide(self.base, query)), slot)
        idle = (slot == NO_AGENT).unsqueeze(1)
        base = torch.where(idle.squeeze(1), 0, base)
        is_base = torch.nn.functional.one_hot(base, self.slots.most_actions).bool()
        legal = self.slots.at(self.slots.legal(td), slot)
        legal = torch.where(idle, is_base, legal | is_base)
        prior = self.prior(td, slot, legal)
        if self.most is not None and self.most < legal.shape[1]:
            best = prior.masked_fill(is_base, torch.inf).topk(self.most, 1).indices
            legal = legal & torch.zeros_like(legal).scatter(1, best, True)
            prior = prior * legal
            prior = prior / prior.sum(1, keepdim=True).clamp(min=1e-300)
        entries = {"slot": slot, "legal": legal, "prior": prior, "mine": base, "memory": memory}
        return TensorDict(entries, td.batch_size, device=td.device)
