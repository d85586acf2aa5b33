"""Beam search over sequences of actions, each evaluated by continuing with the base policy.

Source: beam search of scheduling, evaluated by the pilot method: S. Voss, A. Fink, C. Duin, "Looking ahead with the pilot
method", Annals of Operations Research 136, 2005. All sequences are evaluated over the same time, so actions of
different durations are comparable.
"""

from __future__ import annotations

from typing import ClassVar

import torch
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModuleBase
from torch import Tensor
from typing_extensions import Unpack, override

from bsk_torch._checks import whole
from bsk_torch.env import Tasking
from bsk_torch.lab.planners.base_policies import Base
from bsk_torch.lab.planners.branches import Discounting, Flown, Jobs
from bsk_torch.lab.planners.planner import DiscountOptions, Planner
from bsk_torch.lab.planners.priors import Prior, StateSummary


class Beam:
    """The sequences of R roots, at most W for each.

    Attributes:
        node: :class:`~bsk_torch.lab.planners.priors.StateSummary` of their last states, [R, W].
        place: Rows of the storing environment with their states, [R, W], followed by the rows of extensions.
        valid: Existing sequences, [R, W].
        gained: Return of their steps, [R, W].
        elapsed: Duration of these steps, [R, W] s.
        path: Actions, [R, W, depth]; -1 after the last one.
        q: Best return of the sequences starting with each action, including the base policy's return after them, [R, A].
        best_path: Actions of the best sequence, [R, depth].
        best_worth: Return of the best sequence, [R].
        simulated: Simulated time, [R] s.
    """

    def __init__(self, root: TensorDictBase, width: int, share: int, depth: int, n_actions: int) -> None:
        """Start with ``root`` [R], with space for ``share`` extensions of each."""
        roots, device = len(root), root.device
        index = torch.arange(roots, device=device)
        self.share = share
        self.node: TensorDictBase = root.unsqueeze(1).expand(roots, width).clone()
        self.place = index.unsqueeze(1) * (width + share) + torch.arange(width, device=device)
        self.valid = torch.arange(width, device=device).expand(roots, -1) == 0
        self.gained, self.elapsed = (torch.zeros(roots, width, dtype=torch.float64, device=device) for _ in range(2))
        self.path = torch.full((roots, width, depth), -1, device=device)
        self.q = torch.full((roots, n_actions), -torch.inf, dtype=torch.float64, device=device)
        self.best_path, self.best_worth = self.path[:, 0], torch.full_like(self.gained[:, 0], -torch.inf)
        self.simulated = torch.zeros_like(self.best_worth)

    def number(self, r: Tensor) -> Tensor:
        """Return the index of each extension [J] among those of its root ``r`` [J], in ascending order."""
        first = torch.searchsorted(r, r)
        return torch.arange(len(r), device=r.device) - first

    def extend(
        self, level: int, edge: tuple[Tensor, Tensor, Tensor], number: Tensor, flown: Flown, discounting: Discounting
    ) -> tuple[Tensor, Tensor]:
        """Continue with the best extensions; return their new and their current rows in the storing environment, [k] each.

        Args:
            level: Number of actions of the sequences before the extension.
            edge: Root, sequence and action of each extension, [J].
            number: See :meth:`number`.
            flown: Simulated branches, [J].
            discounting: Discounting of rewards.
        """
        r, b, action = edge
        weight, none = discounting.after(self.elapsed[r, b]), torch.zeros_like(flown.rest)
        total = self.gained[r, b] + weight * discounting.before(flown.reward, flown.seconds, flown.rest)
        gain = self.gained[r, b] + weight * discounting.before(flown.reward, flown.seconds, none)
        path = self.path[r, b]
        path[:, level] = action
        self.simulated = self.simulated.index_add(0, r, flown.simulated)
        self.q = self.q.view(-1).scatter_reduce(0, r * self.q.shape[1] + path[:, 0], total, "amax").view_as(self.q)
        job = torch.zeros(len(self.q), self.share, dtype=torch.int64, device=r.device)
        job[r, number] = torch.arange(len(r), device=r.device)
        top, which = self._table(r, number, total).max(1)
        best = path[job.gather(1, which.unsqueeze(1)).squeeze(1)]
        self.best_path = torch.where((top > self.best_worth).unsqueeze(1), best, self.best_path)
        self.best_worth = torch.maximum(top, self.best_worth)
        width = self.valid.shape[1]
        table = self._table(r, number, total.masked_fill(flown.done, -torch.inf))
        best, which = torch.nn.functional.pad(table, (0, max(0, width - self.share)), value=-torch.inf).topk(width, 1)
        self.valid = best > -torch.inf
        parents = job.gather(1, which.clamp(max=self.share - 1))
        self.elapsed = (self.elapsed[r, b] + flown.seconds)[parents]
        self.gained, self.path = gain[parents], path[parents]
        assert flown.summary is not None
        self.node = flown.summary[parents]
        child = (self.place[r, 0] + width + number)[parents]
        return self.place[self.valid], child[self.valid]

    def _table(self, r: Tensor, number: Tensor, value: Tensor) -> Tensor:
        table = torch.full((len(self.q), self.share), -torch.inf, dtype=torch.float64, device=r.device)
        table[r, number] = value
        return table


class BeamSearch(Planner):
    """Planner that extends the best ``width`` sequences of actions step by step, and takes the first action of the best one.

    The value of a sequence is its return plus the return of the base policy after it, up to the horizon. With ``depth=1`` and a
    budget for all actions, decisions are those of :class:`~bsk_torch.lab.planners.Rollout`, which takes less than half the time.
    The base policy's action is kept unless another one is better.
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
        **options: Unpack[DiscountOptions],
    ) -> None:
        """See :class:`~bsk_torch.lab.planners.planner.Planner` for the other arguments, and for errors.

        Args:
            env: The environment in which the planner acts.
            base: The base policy.
            horizon: Length of branches, s.
            budget: Number of branches simulated for a decision of one agent, divided equally among the depths, at least
                ``depth``. The prior selects the extensions.
            width: Number of extended sequences.
            depth: Maximum number of actions in a sequence.
            prior: Policy for all agents that selects the actions to try (default: the base policy).
            **options: Further arguments of :class:`~bsk_torch.lab.planners.planner.Planner`.
        """
        self.width, self.depth = whole("width", width, 1), whole("depth", depth, 1)
        self.budget = whole("budget", budget, 1)
        if self.budget < self.depth:
            raise ValueError(f"budget={budget} must be at least depth={depth}: a branch for each action of a sequence")
        super().__init__(env, base, horizon=horizon, **options)
        chosen = Prior(self.base if prior is None else prior, self.slots)
        self._summary = StateSummary(env, self.slots, self.base, self._plannable, chosen, None)

    def _branching(self) -> int:
        return self.budget // self.depth

    @override
    def _improved(self, td: TensorDictBase, memory: TensorDictBase, rows: Tensor, slot: Tensor) -> tuple[Tensor, Tensor]:
        share, w, real = self._branching(), self.width, rows.repeat_interleave(self._copies)
        store = self._store(len(real) * (w + share))
        now = td[real].clone()
        now.update(memory[real])
        node = self._summary.of_agent(now, slot.repeat_interleave(self._copies))
        beam = Beam(node, w, share, self.depth, self.slots.most_actions)
        self._plant(store, beam.place[:, 0], rows)
        for level in range(self.depth):
            r, b, action = torch.nonzero(self._tried(beam, share)).unbind(1)
            if not len(r):
                break
            jobs = self._extensions(beam, level, td, memory, real[r], (r, b, action))
            number = beam.number(r)
            flown = self.branches.fly(store, jobs, (store, beam.place[r, 0] + w + number), self._summary)
            place, child = beam.extend(level, (r, b, action), number, flown, self._discounting)
            store.restore(store, place, child)
        base = self.slots.at(self.slots.chosen(td)[rows], slot)
        self._note(rows, slot, beam.q)
        action, seconds = self._preferred(beam.q, base), beam.simulated.view(len(rows), -1).sum(1)
        if not self._keeps_plans:
            return action, seconds
        worth = beam.q.gather(1, action.unsqueeze(1)).squeeze(1)
        plan = torch.where((beam.best_path[:, 0] == action).unsqueeze(1), beam.best_path, -1)
        plan[:, 0] = action
        action, more = self._no_worse(td, memory, rows, slot, action, worth, plan)
        return action, seconds + more

    def _extensions(
        self,
        beam: Beam,
        level: int,
        td: TensorDictBase,
        memory: TensorDictBase,
        real: Tensor,
        edge: tuple[Tensor, Tensor, Tensor],
    ) -> Jobs:
        """Return the flights of extensions [J]: root, sequence and action of each; ``real`` [J] are their episodes."""
        r, b, action = edge
        jobs = self._jobs(td, memory, real, beam.node["slot"][r, b], action.unsqueeze(1), beam.place[r, b])
        if level == 0:
            return jobs
        state = beam.node["memory"][r, b]
        state = state if len(state.keys()) else None
        return jobs._replace(first=None, limit=None, carried=state, judged=self._judged(beam.elapsed[r, b]))

    def _tried(self, beam: Beam, share: int) -> Tensor:
        """Return the extensions to try, [R, W, A], at most ``share`` per root, including those of the base policy."""
        legal, prior = beam.node["legal"] & beam.valid.unsqueeze(-1), beam.node["prior"]
        base = torch.nn.functional.one_hot(beam.node["mine"], legal.shape[-1]).bool()
        weight = torch.where(base, 1.0 + prior, prior).masked_fill(~legal, -1.0).flatten(1)
        best = weight.topk(min(share, weight.shape[1]), 1).indices
        return legal & torch.zeros_like(legal.flatten(1)).scatter(1, best, True).view_as(legal)
