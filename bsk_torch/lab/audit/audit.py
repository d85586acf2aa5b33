"""Audits of policies: at every decision, the return of the chosen action next to that of all others.

The *regret* of a decision is the best value among the legal actions minus that of the chosen one, where the value of an action
is the return of a branch that takes it and then follows the policy (:class:`~bsk_torch.lab.planners.ActionValues`). It tells
where a policy loses, one decision at a time: since later decisions of the branches are those of the policy, the sum of all
regrets is not what a better policy would gain.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import torch
from tensordict import TensorDictBase
from torch import Tensor
from typing_extensions import Unpack

from bsk_torch.env import ConstellationTasking, Tasking
from bsk_torch.env.rollout import play_episodes
from bsk_torch.files import finite
from bsk_torch.lab.planners.agent_table import AgentTable
from bsk_torch.lab.planners.base_policies import Base
from bsk_torch.lab.planners.planner import check_no_planner
from bsk_torch.lab.planners.rollout import ACTION_VALUES, ActionValues, JudgeOptions
from bsk_torch.rl.evaluation.evaluate import start_episodes, with_lots
from bsk_torch.rl.evaluation.statistics import Estimate, confidence
from bsk_torch.rl.policies.shared_policy import member_views
from bsk_torch.rl.rules.baselines import LOT

LEVELS = {
    "battery_charge_fraction": "battery",
    "storage_level_fraction": "data store",
    "wheel_speeds_fraction": "fastest wheel",
}
"""Properties of the dynamics model that describe a situation, as fractions, and what they are called."""

WORST = 0.05
"""Share of the decisions that are called the worst."""


class OfAction(NamedTuple):
    """Regret of the decisions for one kind of action.

    Attributes:
        chosen: Name of the kind.
        decisions: Number of decisions.
        regret: Mean regret.
        share: Share of the regret of all decisions.
        better: Kind that is the best one most often in the decisions with a regret; empty without any.
    """

    chosen: str
    decisions: int
    regret: float
    share: float
    better: str


class OfSituation(NamedTuple):
    """Regret by the value of a quantity at the decision: the limits of the thirds, [2], and the mean regret in each, [3]."""

    quantity: str
    limits: tuple[float, float]
    regret: tuple[float, float, float]


@dataclass(frozen=True)
class Audit:
    """D decisions in the episodes of some seeds, with at most A actions and F futures.

    Attributes:
        seeds: Seeds of the episodes, [E].
        returns: Their returns, [E].
        episode: Index of the episode of each decision, [D].
        time: Time of the decision, [D] s since reset.
        agent: Index of the agent, [D].
        action: Chosen action, [D].
        values: Returns of the actions in each future, from the decision on, [D, F, A]; NaN for illegal actions.
        situation: Quantities at the decision by name, [D] each; NaN for satellites without it.
        kinds: Kinds of the actions of each agent, A names or fewer.
    """

    seeds: Sequence[int]
    returns: Tensor
    episode: Tensor
    time: Tensor
    agent: Tensor
    action: Tensor
    values: Tensor
    situation: dict[str, Tensor]
    kinds: Sequence[Sequence[str]]

    @property
    def best(self) -> Tensor:
        """The action with the largest mean value, [D]; the chosen one unless another one is better."""
        return _best(self.values.mean(1), self.action)

    @property
    def regret(self) -> Tensor:
        """Regret of the decisions, [D].

        With several futures, the best action is chosen by one half of them and valued by the other, and the other way around:
        the mean of the largest of several estimates would be too high. Such a regret can be negative.
        """
        if self.values.shape[1] == 1:
            return self._loss(self.values.mean(1), self.best)
        halves = self.values[:, ::2].mean(1), self.values[:, 1::2].mean(1)
        return 0.5 * sum(
            (self._loss(other, _best(one, self.action)) for one, other in (halves, halves[::-1])),
            start=torch.zeros_like(self.time),
        )

    def _loss(self, value: Tensor, action: Tensor) -> Tensor:
        """Return how much more an ``action`` [D] returns than the chosen one, by its ``value`` [D, A]."""
        return _at(value, action) - _at(value, self.action)

    @property
    def regret_of_episodes(self) -> Estimate:
        """Mean over episodes of the sum of their regrets, with its 95 % confidence interval."""
        return confidence(torch.zeros_like(self.returns).index_add(0, self.episode, self.regret))

    def share_of_worst(self, fraction: float = WORST) -> float:
        """Return the share of all regret in the ``fraction`` of the decisions with the largest regrets; NaN without regret."""
        regret = self.regret.clamp(min=0.0).sort(descending=True).values
        return float(regret[: max(1, round(fraction * len(regret)))].sum() / regret.sum())

    def kind(self, action: Tensor) -> list[str]:
        """Return the kinds of actions [D] of the agents that decide."""
        return [self.kinds[agent][number] for agent, number in zip(self.agent.tolist(), action.tolist(), strict=True)]

    def by_action(self) -> list[OfAction]:
        """Return the regret by the kind of the chosen action, that with the largest share first."""
        regret, kinds, best = self.regret, self.kind(self.action), self.kind(self.best)
        total, rows = float(regret.sum()), []
        for name in dict.fromkeys(kinds):
            mask = torch.tensor([kind == name for kind in kinds])
            better = Counter(best[k] for k in torch.nonzero(mask & (self.best != self.action)).flatten().tolist())
            loss = float(regret[mask].sum())
            share = loss / total if total else 0.0
            most = max(better, key=lambda kind: better[kind], default="")
            rows.append(OfAction(name, int(mask.sum()), loss / int(mask.sum()), share, most))
        return sorted(rows, key=lambda row: -row.share)

    def by_situation(self) -> list[OfSituation]:
        """Return the regret in the lowest, middle and highest third of each quantity, the most unequal quantity first."""
        regret, rows = self.regret, []
        for name, value in self.situation.items():
            valid = ~value.isnan()
            if not bool(valid.any()):
                continue
            low, high = torch.quantile(value[valid], torch.tensor([1.0 / 3.0, 2.0 / 3.0], dtype=value.dtype)).tolist()
            parts = (value <= low, (value > low) & (value <= high), value > high)
            means = [float(regret[part].mean()) if bool(part.any()) else float("nan") for part in parts]
            rows.append(OfSituation(name, (low, high), (means[0], means[1], means[2])))
        finite = {row.quantity: [mean for mean in row.regret if mean == mean] for row in rows}
        return sorted(rows, key=lambda row: min(finite[row.quantity]) - max(finite[row.quantity]))

    def worst(self, count: int) -> Tensor:
        """Return the indices of the ``count`` decisions with the largest regrets, the largest first."""
        return self.regret.topk(min(count, len(self.time))).indices

    def to_dict(self) -> dict[str, object]:
        """Return all decisions as lists, for JSON; NaN becomes None."""
        decisions = {
            "seed": [self.seeds[k] for k in self.episode.tolist()],
            "time": self.time.tolist(),
            "agent": self.agent.tolist(),
            "action": self.action.tolist(),
            "kind": self.kind(self.action),
            "regret": self.regret.tolist(),
            "values": [finite(row) for row in self.values.mean(1).tolist()],
        }
        situation = {name: finite(value.tolist()) for name, value in self.situation.items()}
        return {
            "seeds": list(self.seeds),
            "returns": self.returns.tolist(),
            "futures": self.values.shape[1],
            "kinds": [list(kinds) for kinds in self.kinds],
            "decisions": decisions | {"situation": situation},
        }


def audit(env: Tasking, policy: Base = None, *, seeds: Sequence[int], **options: Unpack[JudgeOptions]) -> Audit:
    """Play the episodes of ``seeds`` with a policy, and value all legal actions at each decision.

    Args:
        env: The environment, with ``env_ids=[0] * num_envs``; it plays ``num_envs`` episodes at a time.
        policy: The policy; see :func:`bsk_torch.lab.planners.base_of`.
        seeds: Seeds of the episodes.
        **options: Arguments of :class:`~bsk_torch.lab.planners.ActionValues`, such as ``horizon``, ``gamma`` and ``futures``.

    Raises:
        ValueError: For no seeds, or one number of futures, which cannot be divided; see also
            :class:`~bsk_torch.lab.planners.planner.Planner`, for example for environments that cannot be copied.
    """
    if len(seeds) == 0:
        raise ValueError("seeds=() names no episode to audit")
    if options.get("futures") == 1:
        raise ValueError(
            "futures=1: an audit chooses by one half of the futures and values by the other; give 2 or more, or None"
        )
    check_no_planner(policy)
    judge = ActionValues(env, policy, **options)
    n, parts, returns = env.num_envs, [], []
    for first in range(0, len(seeds), n):
        batch = seeds[first : first + n]
        parts += list(_decisions(env, judge, batch, first))
        returns.append(env.returns[: len(batch)].clone().cpu())
    columns = {name: torch.cat([part[name] for part in parts]) for name in parts[0]}
    order = torch.argsort(columns["episode"], stable=True)
    columns = {name: column[order] for name, column in columns.items()}
    levels = {name: columns.pop(name) for name in list(columns) if name not in ("episode", "time", "agent", "action", "values")}
    return Audit(list(seeds), torch.cat(returns), situation=levels, kinds=_kinds(env, judge.slots), **columns)


def _decisions(env: Tasking, judge: ActionValues, seeds: Sequence[int], first: int) -> Iterator[dict[str, Tensor]]:
    """Play the episodes of ``seeds``, and yield the decisions of each step; ``first`` is the index of the first episode."""
    rows = torch.arange(env.num_envs, device=env.device) < len(seeds)
    slots, satellites = judge.slots, _satellites(env, judge.slots)
    before: dict[str, Tensor] = {}

    def noted(td: TensorDictBase) -> TensorDictBase:
        legal = slots.legal(td).sum(2).double()
        before.clear()
        before.update({"time": env.fleet.sim_time.clone(), "legal actions": legal})
        before.update({label: value[:, satellites] for label, value in _levels(env).items()})
        return judge(td)

    player = with_lots(noted, env) if LOT in judge.in_keys else noted
    for playing, step in play_episodes(env, player, start_episodes(env, seeds), rows):
        values = step[ACTION_VALUES]
        judged = playing.unsqueeze(1) & (~values.isnan()).any(3).any(2)
        row, agent = torch.nonzero(judged, as_tuple=True)
        time = before["time"][row]
        of_agents = {name: value[row, agent].cpu() for name, value in before.items() if name != "time"}
        yield {
            "episode": (row + first).cpu(),
            "time": time.cpu(),
            "agent": agent.cpu(),
            "action": slots.chosen(step)[row, agent].cpu(),
            "values": values[row, agent].cpu(),
            "seconds since reset": time.cpu(),
        } | of_agents


def _levels(env: Tasking) -> dict[str, Tensor]:
    """Return the :data:`LEVELS` of all satellites by label, [N, S]; NaN for satellites without."""
    levels = {}
    for name, label in LEVELS.items():
        parts = []
        for part in env.fleet.satellites:
            none = torch.full_like(part.dynamics.r_BN_N[:, 0], torch.nan)
            value = getattr(part.dynamics, name) if hasattr(type(part.dynamics), name) else none
            parts.append((value if value.ndim == 1 else value.amax(1)).double())
        levels[label] = env.fleet.joined(parts)
    return levels


def _satellites(env: Tasking, slots: AgentTable) -> Tensor:
    """Return the first satellite of each agent, [S]."""
    if not isinstance(env, ConstellationTasking):
        return torch.zeros(1, dtype=torch.int64, device=env.device)
    members = {group.name: group.members[:, 0] for group in env.groups}
    return torch.cat([members[str(name)] for name in slots.groups])


def _kinds(env: Tasking, slots: AgentTable) -> list[list[str]]:
    kinds = []
    for view, size in zip(member_views(env).values(), slots.sizes, strict=True):
        actions = view.satellite.actions
        kinds += [[actions.entries[actions.entry_of(number)].name for number in range(actions.n_actions)]] * size
    return kinds


def _best(value: Tensor, chosen: Tensor) -> Tensor:
    """Return the action with the largest ``value`` [D, A]: the ``chosen`` one [D] unless another one is better."""
    most, action = value.nan_to_num(nan=-torch.inf).max(1)
    return torch.where(most > _at(value, chosen), action, chosen)


def _at(value: Tensor, action: Tensor) -> Tensor:
    return value.gather(1, action.unsqueeze(1)).squeeze(1)
