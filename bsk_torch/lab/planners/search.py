"""Planner with trees of copied states."""

from __future__ import annotations

from typing import ClassVar

import torch
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModuleBase
from torch import Tensor
from typing_extensions import Unpack, override

from bsk_torch._checks import number, whole
from bsk_torch.env import Tasking
from bsk_torch.lab.planners.base_policies import Base
from bsk_torch.lab.planners.branches import Jobs
from bsk_torch.lab.planners.planner import DiscountOptions, Planner
from bsk_torch.lab.planners.priors import Prior, StateSummary
from bsk_torch.lab.planners.tree import Leaves, Trees

LONGEST = 64
"""Number of actions of a sequence kept until the next decision."""


class TreeSearch(Planner):
    """Planner by Monte Carlo tree search; see :mod:`bsk_torch.lab.planners.tree`.

    Each simulation follows one edge for the first time. The new node is evaluated by the return of the base policy up to the
    horizon, or by a value network. With the base policy and a single future, returns are exact. The search then maximizes over
    returns, and keeps the base policy's action unless another one is better; with enough budget, it tries all sequences of
    actions up to the horizon. Otherwise, returns are averaged, and the most visited action is taken.
    """

    name: ClassVar[str] = "mcts"

    def __init__(
        self,
        env: Tasking,
        base: Base = None,
        *,
        horizon: float = 240.0,
        budget: int = 96,
        actions: int | None = 8,
        leaves: int = 8,
        exploration: float = 1.25,
        prior: TensorDictModuleBase | None = None,
        **options: Unpack[DiscountOptions],
    ) -> None:
        """See :class:`~bsk_torch.lab.planners.planner.Planner` for the other arguments, and for errors.

        Args:
            env: The environment in which the planner acts.
            base: The base policy.
            horizon: Time from the decision in which returns count, s; with ``value``, the time beyond which nodes are not
                extended.
            budget: Number of simulations for a decision of one agent, and of nodes in its tree.
            actions: Number of actions tried at each node, the most probable ones; None for all legal actions.
            leaves: Number of simultaneous simulations in each tree.
            exploration: Weight of the prior.
            prior: Policy for all agents that provides the probabilities (default: the base policy).
            **options: Further arguments of :class:`~bsk_torch.lab.planners.planner.Planner`.
        """
        self.budget, self.leaves = whole("budget", budget, 1), whole("leaves", leaves, 1)
        self.exploration = number("exploration", exploration, 0.0)
        self.actions = None if actions is None else whole("actions", actions, 1)
        super().__init__(env, base, horizon=horizon, **options)
        chosen = Prior(self.base if prior is None else prior, self.slots)
        self._summary = StateSummary(env, self.slots, self.base, self._plannable, chosen, self.actions)

    def _branching(self) -> int:
        return min(self.leaves, self.budget)

    @override
    def _judged(self, elapsed: Tensor) -> Tensor | None:
        return None if self._value is None else torch.zeros_like(elapsed)

    @override
    def _improved(self, td: TensorDictBase, memory: TensorDictBase, rows: Tensor, slot: Tensor) -> tuple[Tensor, Tensor]:
        real, most = rows.repeat_interleave(self._copies), self.budget + 1
        roots = torch.arange(len(real), device=rows.device)
        store = self._store(len(roots) * most)
        self._plant(store, roots * most, rows)
        now = td[real].clone()
        now.update(memory[real])
        summary = self._summary.of_agent(now, slot.repeat_interleave(self._copies))
        exact = self._value is None and self.futures is None
        trees = Trees(summary, most, self._discounting, exact, self.exploration)
        simulated = torch.zeros(len(roots), dtype=torch.float64, device=rows.device)
        base = self.slots.at(self.slots.chosen(td)[rows], slot)
        first = summary["mine"]  # the base policy's action
        trees.visits[trees.all_trees, 0, first] += 1
        wave = [Leaves(torch.zeros_like(first), first, torch.ones_like(first, dtype=torch.bool))]
        while wave:
            for leaves, seconds in self._grown(trees, wave, store, td, memory, real):
                simulated = simulated.index_add(0, leaves, seconds)
            trees.guess_roots()
            remaining = self.budget - int(trees.count.min()) + 1
            wave = [
                trees.select(trees.count + trees.waiting.flatten(1).sum(1) <= self.budget)
                for _ in range(min(self.leaves, remaining))
            ]
            wave = [leaves for leaves in wave if bool(leaves.exists.any())]
        q = trees.returns()
        self._note(rows, slot, q)
        if not exact:
            q = self._by_visits(trees, q)
        action, seconds = self._preferred(q, base), simulated.view(len(rows), -1).sum(1)
        if not self._keeps_plans:
            return action, seconds
        worth = q.gather(1, action.unsqueeze(1)).squeeze(1)
        action, more = self._no_worse(td, memory, rows, slot, action, worth, trees.plan(action, min(self.budget, LONGEST)))
        return action, seconds + more

    def _grown(
        self, trees: Trees, wave: list[Leaves], store: Tasking, td: TensorDictBase, memory: TensorDictBase, real: Tensor
    ) -> list[tuple[Tensor, Tensor]]:
        """Simulate a wave of leaves, at the roots with the actions in ``td``, and extend the trees; return seconds per tree."""
        most, flights = self.budget + 1, []
        indices = [torch.nonzero(leaves.exists).squeeze(1) for leaves in wave]
        number = torch.stack([leaves.exists.long() for leaves in wave]).cumsum(0) - 1
        root = torch.cat(indices)
        node = torch.cat([leaves.node[rows] for leaves, rows in zip(wave, indices, strict=True)])
        action = torch.cat([leaves.action[rows] for leaves, rows in zip(wave, indices, strict=True)])
        new = torch.cat([(trees.count + number[k])[rows] for k, rows in enumerate(indices)])
        jobs = self._from_nodes(trees, td, memory, real, root, node, action)
        flown = self.branches.fly(store, jobs, (store, root * most + new), self._summary)
        first = 0
        for leaves, rows in zip(wave, indices, strict=True):
            part = flown.take(first, first + len(rows))
            if self._value is not None:  # too far ahead to be extended
                late = trees.elapsed[rows, leaves.node[rows]] + part.seconds >= self.horizon
                part = part._replace(done=part.done | late)
            trees.grow(leaves, rows, part)
            flights.append((rows, part.simulated))
            first += len(rows)
        return flights

    def _from_nodes(
        self, trees: Trees, td: TensorDictBase, memory: TensorDictBase, real: Tensor, root: Tensor, node: Tensor, action: Tensor
    ) -> Jobs:
        """Return the flights of actions [J] at nodes [J] of trees [J]; other agents act as decided at roots, else by the base."""
        jobs = self._jobs(
            td, memory, real[root], trees.nodes["slot"][root, node], action.unsqueeze(1), root * (self.budget + 1) + node
        )
        state = trees.nodes["memory"][root, node]
        return jobs._replace(carried=state if len(state.keys()) else None, decided=node == 0)

    def _by_visits(self, trees: Trees, q: Tensor) -> Tensor:
        """Return numbers that order actions by visits and, for equal visits, by returns, [R, A]."""
        tried = torch.isfinite(q)
        low, high = q.masked_fill(~tried, torch.inf).amin(1, keepdim=True), q.amax(1, keepdim=True)
        tie = torch.where(high > low, (q - low) / (high - low).clamp(min=1e-300), 0.0).clamp(max=1.0) * 0.5
        return (trees.visits[:, 0] + tie).masked_fill(~tried, -torch.inf)
