"""Summary of a state for tree search: the deciding agent, legal actions, and preferences of a policy."""

from __future__ import annotations

import torch
from tensordict import TensorDict, TensorDictBase
from tensordict.nn import TensorDictModuleBase
from torch import Tensor

from bsk_torch.env import Tasking
from bsk_torch.env.rollout import decide
from bsk_torch.lab.planners.agent_table import NO_AGENT, AgentTable
from bsk_torch.lab.planners.branches import carried
from bsk_torch.lab.planners.priors import Prior


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
        asked = td.clone(recurse=False)
        memory = carried(asked, self.base, self.env)
        mine = self.slots.at(self.slots.chosen(decide(self.base, asked)), slot)
        idle = (slot == NO_AGENT).unsqueeze(1)
        mine = torch.where(idle.squeeze(1), 0, mine)
        own = torch.nn.functional.one_hot(mine, self.slots.most_actions).bool()
        legal = self.slots.at(self.slots.legal(td), slot)
        legal = torch.where(idle, own, legal | own)
        prior = self.prior(td, slot, legal)
        if self.most is not None and self.most < legal.shape[1]:
            best = prior.masked_fill(own, torch.inf).topk(self.most, 1).indices
            legal = legal & torch.zeros_like(legal).scatter(1, best, True)
            prior = prior * legal
            prior = prior / prior.sum(1, keepdim=True).clamp(min=1e-300)
        found = {"slot": slot, "legal": legal, "prior": prior, "mine": mine, "memory": memory}
        return TensorDict(found, td.batch_size, device=td.device)
