"""Monte Carlo tree search over copies of episodes, guided by a policy prior; trees of a batch are tensors [R, nodes, A].

Sources: C. D. Rosin, "Multi-armed bandits with episode context", Annals of Mathematics and AI 61, 2011 (selection rule);
D. Silver et al., "Mastering the game of Go without human knowledge", Nature 550, 2017. Returns are normalized between the minimum
and maximum of the node's actions, as in J. Schrittwieser et al., "Mastering Atari, Go, chess and shogi by planning with a learned
model", Nature 588, 2020.
"""

from __future__ import annotations

from typing import NamedTuple

import torch
from tensordict import TensorDict, TensorDictBase
from torch import Tensor

from bsk_torch.lab.planners.branches import Discounting, Flown

NONE = -1
"""Index of a missing node."""


class Leaves(NamedTuple):
    """Edges [R] to follow for the first time: their nodes and actions, and whether they exist."""

    node: Tensor
    action: Tensor
    exists: Tensor


class Trees:
    """R trees of at most K nodes with A actions each.

    Attributes:
        nodes: :class:`~bsk_torch.lab.planners.priors.StateSummary` of every node, [R, K].
        child: Child node of an edge, :data:`NONE` before the edge is followed, [R, K, A].
        visits: Number of simulations through an edge, [R, K, A].
        total: Sum of their returns from the node, [R, K, A].
        best: Maximum of these returns, [R, K, A].
        waiting: Edges being followed for the first time, [R, K, A].
        reward: Reward of the step of an edge, [R, K, A].
        seconds: Duration of this step, [R, K, A].
        parent: Parent node, [R, K].
        by: Action from the parent, [R, K].
        leaf: Initial estimate of the return from the node, [R, K].
        elapsed: Time since the root, [R, K] s.
        solved: Exhausted nodes, below which all actions have been tried, [R, K].
        count: Number of nodes, [R].
    """

    def __init__(self, root: TensorDictBase, most: int, discounting: Discounting, exact: bool, exploration: float) -> None:
        """Create trees with ``root`` [R] and at most ``most`` nodes.

        With ``exact`` returns, the maximum counts, otherwise the mean. ``exploration`` is the weight of the prior.
        """
        self.discounting, self.exact, self.exploration = discounting, exact, exploration
        legal = root["legal"]
        r, a = legal.shape
        device = legal.device
        self.all_trees = torch.arange(r, device=device)
        edges, nodes = (r, most, a), (r, most)
        self.nodes: TensorDict = root.unsqueeze(1).expand(r, most).clone()
        self.child = torch.full(edges, NONE, device=device)
        self.visits = torch.zeros(edges, dtype=torch.int64, device=device)
        self.total, self.reward, self.seconds = (torch.zeros(edges, dtype=torch.float64, device=device) for _ in range(3))
        self.best = torch.full(edges, -torch.inf, dtype=torch.float64, device=device)
        self.waiting = torch.zeros(edges, dtype=torch.bool, device=device)
        self.parent, self.by = (torch.full(nodes, NONE, device=device) for _ in range(2))
        self.leaf, self.elapsed = (torch.zeros(nodes, dtype=torch.float64, device=device) for _ in range(2))
        self.solved = torch.zeros(nodes, dtype=torch.bool, device=device)
        self.count = torch.ones(r, dtype=torch.int64, device=device)

    # -- selection ----------------------------------------------------------------------------------------------------

    def open(self, node: Tensor) -> Tensor:
        """Return the actions of ``node`` [R] that lead to untried actions or are untried themselves, [R, A]."""
        child = self._at(self.child, node)
        solved = self.solved.gather(1, child.clamp(min=0).flatten(1)).view_as(child)
        return self._at(self.nodes["legal"], node) & ~self._at(self.waiting, node) & ~(solved & (child != NONE))

    def score(self, node: Tensor) -> Tensor:
        """Return q + c p sqrt(n) / (1 + n_a) for the actions of ``node`` [R], [R, A]; minus infinity for closed ones.

        q is the return, normalized between the minimum (0) and maximum (1) of the node. Untried actions have the initial estimate
        of the node.
        """
        visits, prior = self._at(self.visits, node), self._at(self.nodes["prior"], node)
        q = self._at(self.best, node) if self.exact else self._at(self.total, node) / visits.clamp(min=1)
        tried = torch.isfinite(self._at(self.best, node))
        guess = self.leaf.gather(1, node.unsqueeze(1))
        q = torch.where(tried, q, guess)
        low, high = q.amin(1, keepdim=True), q.amax(1, keepdim=True)
        q = torch.where(high > low, (q - low) / (high - low).clamp(min=1e-300), 0.5)
        bonus = self.exploration * prior * visits.sum(1, keepdim=True).clamp(min=1).sqrt() / (1 + visits)
        return (q + bonus).masked_fill(~self.open(node), -torch.inf)

    def select(self, active: Tensor) -> Leaves:
        """Select an edge not yet followed in each of the trees ``active`` [R], and count visits along the paths to them."""
        node = torch.zeros_like(self.count)
        walking, exists = active & ~self.solved[:, 0], torch.zeros_like(active)
        at, action = node.clone(), node.clone()
        while bool(walking.any()):
            score, a = self.score(node).max(1)
            walking = walking & (score > -torch.inf)  # all open actions below are already being followed
            following = self.child[self.all_trees, node, a]
            new = walking & (following == NONE)
            at, action, exists = torch.where(new, node, at), torch.where(new, a, action), exists | new
            walking = walking & ~new
            node = torch.where(walking, following, node)
        self.waiting[self.all_trees, at, action] |= exists
        self._visit(torch.nonzero(exists).squeeze(1), at[exists], action[exists])
        return Leaves(at, action, exists)

    def _visit(self, rows: Tensor, node: Tensor, action: Tensor) -> None:
        while len(rows):
            self.visits[rows, node, action] += 1
            up = node != 0
            rows, node = rows[up], node[up]
            node, action = self.parent[rows, node], self.by[rows, node]

    # -- growth -------------------------------------------------------------------------------------------------------

    def grow(self, leaves: Leaves, rows: Tensor, flown: Flown) -> None:
        """Add the simulated nodes of ``leaves``, ``flown`` [J] in the trees ``rows`` [J], and back up their returns."""
        node, action = leaves.node[rows], leaves.action[rows]
        new = self.count[rows]
        assert flown.summary is not None
        self.nodes[rows, new] = flown.summary
        self.child[rows, node, action] = new
        self.waiting[rows, node, action] = False
        self.reward[rows, node, action], self.seconds[rows, node, action] = flown.reward, flown.seconds
        self.parent[rows, new], self.by[rows, new] = node, action
        self.leaf[rows, new], self.solved[rows, new] = flown.rest, flown.done
        self.elapsed[rows, new] = self.elapsed[rows, node] + flown.seconds
        self.count[rows] += 1
        self._pass_up(rows, new, flown.rest)

    def _pass_up(self, rows: Tensor, node: Tensor, value: Tensor) -> None:
        """Back up returns ``value`` [J] from ``node`` [J] to all ancestors, and mark solved nodes."""
        while len(rows):
            before, action = self.parent[rows, node], self.by[rows, node]
            value = self.discounting.before(self.reward[rows, before, action], self.seconds[rows, before, action], value)
            self.total[rows, before, action] += value
            self.best[rows, before, action] = torch.maximum(self.best[rows, before, action], value)
            child, legal = self.child[rows, before], self.nodes["legal"][rows, before]
            finished = self.solved[rows.unsqueeze(1), child.clamp(min=0)] & (child != NONE)
            self.solved[rows, before] |= (finished | ~legal).all(1)
            up = before != 0
            rows, node, value = rows[up], before[up], value[up]

    def guess_roots(self) -> None:
        """Initialize the estimates of the roots with the return of the base policy's action, which is tried first."""
        base = self.child[:, 0] == 1
        first = self.total[:, 0].masked_fill(~base, 0.0).sum(1) / self.visits[:, 0].masked_fill(~base, 0).sum(1).clamp(min=1)
        self.leaf[:, 0] = self.best[:, 0].masked_fill(~base, -torch.inf).amax(1) if self.exact else first

    def returns(self) -> Tensor:
        """Return the returns of the roots' actions, [R, A]; minus infinity for untried actions."""
        mean = self.total[:, 0] / self.visits[:, 0].clamp(min=1)
        return self.best[:, 0] if self.exact else torch.where(torch.isfinite(self.best[:, 0]), mean, -torch.inf)

    def plan(self, action: Tensor, depth: int) -> Tensor:
        """Return the sequences with the largest returns that start with actions [R] at the roots, [R, depth], padded with -1."""
        node, steps = self.child[self.all_trees, 0, action], [action]
        for _ in range(depth - 1):
            exists = node != NONE
            at = node.clamp(min=0)
            best, following = self._at(self.best, at).max(1)
            exists = exists & (best >= self.leaf.gather(1, at.unsqueeze(1)).squeeze(1))  # else the base policy does better
            steps.append(torch.where(exists, following, -1))
            node = torch.where(exists, self.child[self.all_trees, at, following], NONE)
        return torch.stack(steps, 1)

    # -- tables -------------------------------------------------------------------------------------------------------

    def _at(self, table: Tensor, node: Tensor) -> Tensor:
        return table[self.all_trees, node]
