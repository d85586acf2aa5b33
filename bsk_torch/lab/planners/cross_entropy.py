"""The cross-entropy method for continuous actions.

Sources: R. Y. Rubinstein, D. P. Kroese, "The Cross-Entropy Method", Springer 2004; for planning with a model, keeping the best
sample, C. Pinneri et al., "Sample-efficient cross-entropy method for real-time planning", CoRL 2020.
"""

from __future__ import annotations

from typing import ClassVar

import torch
from tensordict import TensorDictBase
from torch import Tensor
from typing_extensions import Unpack, override

from bsk_torch._checks import number, whole
from bsk_torch.env import Tasking
from bsk_torch.lab.planners.base_policies import Base
from bsk_torch.lab.planners.planner import Planner, PlannerOptions
from bsk_torch.lab.planners.resampling import present_key


class CrossEntropy(Planner):
    """Planner that draws sequences of actions, simulates them in copies, and resamples around the best of them.

    A sequence consists of an agent's next ``depth`` actions; the base policy decides after them. The first normal distribution is
    centered on the base policy's actions. Their sequence is one of the samples, and is kept unless another one is better. Samples
    outside the bounds are clamped.
    """

    name: ClassVar[str] = "cem"
    real: ClassVar[bool] = True

    def __init__(
        self,
        env: Tasking,
        base: Base = None,
        *,
        horizon: float = 7200.0,
        budget: int = 128,
        iterations: int = 4,
        depth: int = 2,
        elites: float = 0.125,
        spread: float = 0.3,
        smoothing: float = 0.2,
        gamma: float = 1.0,
        **options: Unpack[PlannerOptions],
    ) -> None:
        """See :class:`~bsk_torch.lab.planners.planner.Planner` for the other arguments, and for errors.

        Args:
            env: The environment in which the planner acts.
            base: The base policy.
            horizon: Length of branches, s.
            budget: Number of sequences simulated for a decision of one agent, at least two per iteration.
            iterations: Number of successive distributions.
            depth: Number of actions in a sequence.
            elites: Fraction of the samples that determines the next distribution.
            spread: Standard deviation of the first distribution, divided by half the width of the bounds.
            smoothing: Weight of the previous distribution in the next one.
            gamma: Discount per second.
            **options: Further arguments of :class:`~bsk_torch.lab.planners.planner.Planner`.
        """
        self.iterations, self.depth = whole("iterations", iterations, 1), whole("depth", depth, 1)
        self.budget = whole("budget", budget, 1)
        self.samples = self.budget // self.iterations
        if self.samples < 2:
            least = 2 * self.iterations
            raise ValueError(f"budget={budget} must be at least {least}: two samples for each of iterations={iterations}")
        self.elites = max(1, round(self.samples * number("elites", elites, 0.0, 1.0, above=True)))
        self.spread = number("spread", spread, 0.0, 10.0, above=True)
        self.smoothing = number("smoothing", smoothing, 0.0, 1.0)
        super().__init__(env, base, horizon=horizon, gamma=gamma, **options)
        width = self.slots.most_numbers
        sides = [torch.tensor(bounds, dtype=torch.float64).view(-1, 2) for bounds in self.slots.bounds]
        padded = torch.stack([torch.nn.functional.pad(side, (0, 0, 0, width - len(side))) for side in sides])
        limits = padded.repeat_interleave(torch.tensor(self.slots.sizes), 0).to(env.device)
        self._low, self._high = limits.unbind(-1)  # of every agent, [S, W]

    def _branching(self) -> int:
        return self.samples

    @override
    def _improved(self, td: TensorDictBase, memory: TensorDictBase, rows: Tensor, slot: Tensor) -> tuple[Tensor, Tensor]:
        env, n, p = self.env, len(rows), self.samples
        low, high = self._low[slot].unsqueeze(1), self._high[slot].unsqueeze(1)  # [n, 1, W]
        half = 0.5 * (high - low)
        base = self.slots.at(self.slots.numbers(td)[rows], slot)
        unsaid = torch.full((n, 1, self.depth, low.shape[-1]), torch.nan, dtype=base.dtype, device=rows.device)
        best_return, simulated, acted = self._simulate(td, memory, rows, slot, unsaid)
        best_return, plan = best_return.squeeze(1), acted[:, 0].double()
        best, by_base = plan, torch.ones_like(best_return, dtype=torch.bool)
        plan_cache = self._cached_plans(torch.full_like(plan[0], torch.nan))
        cached, exists = plan_cache.look_up(env, rows, slot)
        if bool(exists.any()):
            total, seconds, acted = self._simulate(td, memory, rows, slot, cached.unsqueeze(1).to(base.dtype))
            simulated = simulated + seconds
            better = exists & (total.squeeze(1) > best_return)
            best_return = torch.where(better, total.squeeze(1), best_return)
            plan = best = torch.where(better.view(-1, 1, 1), acted[:, 0].double(), plan)
            by_base = ~better
        deviation = self.spread * half.expand_as(plan)
        key = present_key(env, rows, env.env_ids[rows], "")
        for iteration in range(self.iterations):
            noise = key.named(f"samples {self.seed} {iteration}").normal(p * plan[0].numel()).to(rows.device)
            samples = plan.unsqueeze(1) + deviation.unsqueeze(1) * noise.view(n, p, *plan.shape[1:])
            samples = torch.minimum(torch.maximum(samples, low.unsqueeze(1)), high.unsqueeze(1)).to(base.dtype)
            total, seconds, _ = self._simulate(td, memory, rows, slot, samples)
            simulated = simulated + seconds
            top, which = total.topk(self.elites, 1)
            at = torch.arange(n, device=rows.device)
            elite = samples.double()[at.unsqueeze(1), which]
            better = top[:, 0] > best_return
            best_return = torch.where(better, top[:, 0], best_return)
            best = torch.where(better.view(-1, 1, 1), elite[:, 0], best)
            by_base = by_base & ~better
            elite = torch.cat([elite, best.unsqueeze(1)], 1)  # the best sample so far remains among the samples
            mix = self.smoothing
            plan = mix * plan + (1.0 - mix) * elite.mean(1)
            deviation = mix * deviation + (1.0 - mix) * elite.std(1, correction=0)
        action = torch.where(by_base.unsqueeze(1), base, best[:, 0].to(base.dtype))
        plan_cache.keep(env, rows, slot, torch.where(by_base.view(-1, 1, 1), torch.nan, best))
        return action, simulated

    def _simulate(
        self, td: TensorDictBase, memory: TensorDictBase, rows: Tensor, slot: Tensor, plans: Tensor
    ) -> tuple[Tensor, Tensor, Tensor]:
        """Return the returns [n, P] of ``plans`` [n, P, D, W], seconds [n], and the actions of the first future, [n, P, D, W].

        NaN stands for the base policy's action.
        """
        n, p, copies = len(rows), plans.shape[1], self._copies
        which = torch.arange(n, device=rows.device).repeat_interleave(p)
        total, flown = self._flown(td, memory, rows, slot, which, plans.flatten(0, 1))
        assert flown.acted is not None
        assert flown.executed is not None
        acted, count = (part.view(n, p, copies, *part.shape[1:])[:, :, 0] for part in (flown.acted, flown.executed))
        said = torch.arange(self.depth, device=rows.device) < count.unsqueeze(-1)
        acted = torch.where(said.unsqueeze(-1), acted, acted[:, :, :1])  # sequences that the horizon cuts repeat the first action
        return total.view(n, p, copies).mean(2), flown.simulated.view(n, -1).sum(1), acted
