"""Beam search: the best few sequences of actions, each judged by the base policy that flies on after it.

Source: the beam search of scheduling with the pilot method as its judge: S. Voss, A. Fink, C. Duin, "Looking ahead with the pilot
method", Annals of Operations Research 136, 2005. As all sequences are judged over the same time, those whose actions take longer
are comparable with others.
"""

from __future__ import annotations

from typing import Any, ClassVar

import torch
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModuleBase
from torch import Tensor

from bsk_torch._checks import whole
from bsk_torch.env import Tasking
from bsk_torch.plan.bases import Base
from bsk_torch.plan.branches import Jobs
from bsk_torch.plan.nodes import Lookout
from bsk_torch.plan.planner import Planner
from bsk_torch.plan.priors import Prior


class BeamSearch(Planner):
    """Extends the best ``width`` sequences of actions by one action after the other, and takes the first action of the best.

    A sequence is worth what it earns and what the base policy earns after it, up to the horizon. With ``depth=1`` this is
    :class:`~bsk_torch.plan.Rollout`. The base policy's own action is kept unless another one is better.
    """

    name: ClassVar[str] = "beam"

    def __init__(
        self,
        env: Tasking,
        base: Base = None,
        *,
        horizon: float = 240.0,
        budget: int = 96,
        width: int = 4,
        depth: int = 3,
        prior: TensorDictModuleBase | None = None,
        **options: Any,
    ) -> None:
        """See :class:`~bsk_torch.plan.planner.Planner` for the other arguments, and for errors.

        Args:
            env: The environment in which the planner acts.
            base: The base policy.
            horizon: Seconds that branches last.
            budget: Branches that are flown for a decision of one agent, an equal share of them in each depth, at least ``depth``:
                the extensions that the prior prefers.
            width: Sequences that are extended.
            depth: Length of the longest sequences, actions.
            prior: Policy of all agents that says which actions are tried; the base policy unless given.
            **options: Further arguments of :class:`~bsk_torch.plan.planner.Planner`.
        """
        self.width, self.depth = whole("width", width, 1), whole("depth", depth, 1)
        self.budget = whole("budget", budget, 1)
        if self.budget < self.depth:
            raise ValueError(f"budget={budget} must be at least depth={depth}: a branch for each action of a sequence")
        super().__init__(env, base, horizon=horizon, **options)
        chosen = Prior(self.base if prior is None else prior, self.slots)
        self._lookout = Lookout(env, self.slots, self.base, self._plannable, chosen, None)

    def _branching(self) -> int:
        return self.budget // self.depth

    def _improved(self, td: TensorDictBase, memory: TensorDictBase, rows: Tensor, slot: Tensor) -> tuple[Tensor, Tensor]:
        """See :meth:`Planner._improved`."""
        on = {"device": rows.device}
        share, w, real = self._branching(), self.width, rows.repeat_interleave(self._copies)
        roots = torch.arange(len(real), **on)
        store = self._store(len(roots) * (w + share))
        place = roots.unsqueeze(1) * (w + share) + torch.arange(w, **on)  # rows of the store, those of children behind them
        self._plant(store, place[:, 0], rows)
        now = td[real].clone()
        now.update(memory[real])
        node = self._lookout.of_agent(now, slot.repeat_interleave(self._copies)).unsqueeze(1).expand(len(real), w).clone()
        mine = self.slots.at(self.slots.chosen(td)[rows], slot)
        zeros = torch.zeros(len(roots), w, dtype=torch.float64, **on)
        gained, elapsed = zeros, zeros
        path = torch.full((len(roots), w, self.depth), -1, **on)
        best_path, best_worth = path[:, 0], torch.full_like(zeros[:, 0], -torch.inf)
        valid = torch.zeros_like(zeros, dtype=torch.bool)
        valid[:, 0] = True
        q = torch.full((len(roots), self.slots.most_actions), -torch.inf, dtype=torch.float64, **on)
        simulated = zeros[:, 0]
        for level in range(self.depth):
            tried = self._tried(node, valid, share)
            r, b, action = torch.nonzero(tried).unbind(1)
            if not len(r):
                break
            number = (tried.flatten(1).cumsum(1) - 1).view_as(tried)[r, b, action]
            child = place[r, 0] + w + number
            if level == 0:
                jobs = self._jobs(td, memory, real[r], node["slot"][r, b], action.unsqueeze(1), place[r, b])
            else:
                env_ids, kept = self.env.env_ids[real[r]], node["memory"][r, b]
                kept = kept if len(kept.keys()) else None
                judged = self._judged(elapsed[r, b])
                jobs = Jobs(place[r, b], env_ids, node["slot"][r, b], action.unsqueeze(1), None, None, kept, judged)
            flown = self.branches.fly(store, jobs, (store, child), self._lookout)
            simulated = simulated.index_add(0, r, flown.simulated)
            weight = self._discounting.after(elapsed[r, b])
            total = gained[r, b] + weight * self._discounting.before(flown.reward, flown.seconds, flown.rest)
            steps = path[r, b]
            steps[:, level] = action
            q = q.view(-1).scatter_reduce(0, r * q.shape[1] + steps[:, 0], total, "amax").view_as(q)
            table = torch.full((len(roots), share), -torch.inf, dtype=torch.float64, **on)
            job = torch.zeros(len(roots), share, dtype=torch.int64, **on)
            table[r, number], job[r, number] = total, torch.arange(len(r), **on)
            top, which = table.max(1)
            better = top > best_worth
            best_path = torch.where(better.unsqueeze(1), steps[job.gather(1, which.unsqueeze(1)).squeeze(1)], best_path)
            best_worth = torch.maximum(top, best_worth)
            if level + 1 == self.depth:
                break
            none = torch.zeros_like(total)
            gain = gained[r, b] + weight * self._discounting.before(flown.reward, flown.seconds, none)
            table[r, number] = total.masked_fill(flown.done, -torch.inf)
            best, which = torch.nn.functional.pad(table, (0, max(0, w - share)), value=-torch.inf).topk(w, 1)
            valid = best > -torch.inf
            chosen = job.gather(1, which.clamp(max=share - 1))
            gained, elapsed, path = gain[chosen], (elapsed[r, b] + flown.seconds)[chosen], steps[chosen]
            assert flown.seen is not None
            node = flown.seen[chosen]
            store.restore(store, place[valid], child[chosen][valid])
        action, seconds = self._preferred(q, mine), simulated.view(len(rows), -1).sum(1)
        if not self._keeps_promises:
            return action, seconds
        worth = q.gather(1, action.unsqueeze(1)).squeeze(1)
        plan = torch.where((best_path[:, 0] == action).unsqueeze(1), best_path, -1)
        plan[:, 0] = action
        action, more = self._promised(td, memory, rows, slot, action, worth, plan)
        return action, seconds + more

    def _tried(self, node: TensorDictBase, valid: Tensor, share: int) -> Tensor:
        """Return the extensions that are tried, [R, W, A]: at most ``share`` of each root; those of the base policy first."""
        legal = node["legal"] & valid.unsqueeze(-1)
        own = torch.nn.functional.one_hot(node["mine"], legal.shape[-1]).bool()
        weight = torch.where(own, 1.0 + node["prior"], node["prior"]).masked_fill(~legal, -1.0).flatten(1)
        best = weight.topk(min(share, weight.shape[1]), 1).indices
        return legal & torch.zeros_like(legal.flatten(1)).scatter(1, best, True).view_as(legal)
