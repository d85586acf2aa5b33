"""Evaluation of policies in fresh episodes, the same for every policy."""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, fields
from typing import Any

import torch
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModuleBase
from torch import Tensor

from bsk_torch.env import ConstellationTasking, SatelliteTasking, Tasking
from bsk_torch.env.rollout import Policy, play_episodes
from bsk_torch.rand import Key
from bsk_torch.rl.evaluation.statistics import Estimate, confidence, mean, wilson
from bsk_torch.rl.policies.shared_policy import TRAINED_WITH, check_reads
from bsk_torch.rl.rules.baselines import LOT

FRESH = 1_000_003
"""Added to the seed of training to get the seed of evaluation, whose episodes are new to the policy."""

SUITE_SEEDS = range(2**60, 2**60 + 2**20)
"""Seeds of the episodes of suites (:mod:`bsk_torch.rl.evaluation.suite`), not allowed in training."""

SHARE = "shared(policy, env) lets a policy of one satellite decide for those of a constellation"
"""What to do about a policy that reads what a constellation shows for its groups only."""

SIMULATED = "simulated_seconds"
"""Key under which planners write what they have simulated for a decision, [N] s."""


@dataclass(frozen=True)
class Evaluation:
    """Results of n episodes, each a tensor [n].

    ``returns`` are sums of rewards (float64), ``collected`` the same without the penalty for dying, ``decisions`` and ``seconds``
    the lengths, ``deaths`` says for every aliveness check whether it failed at the end, ``counts`` is what the environment has
    counted, such as ``imaged``, and ``fill`` the level of the store at the end, a fraction; None without a store. ``simulated``
    are seconds that a planner has simulated for all decisions of the episode; None for policies that do not plan.
    """

    returns: Tensor
    collected: Tensor
    survived: Tensor
    decisions: Tensor
    seconds: Tensor
    deaths: dict[str, Tensor]
    counts: dict[str, Tensor] = field(default_factory=dict)
    fill: Tensor | None = None
    simulated: Tensor | None = None

    @classmethod
    def joined(cls, parts: Sequence[Evaluation]) -> Evaluation:
        """The episodes of all ``parts``, in order."""
        return cls(**{part.name: _joined([getattr(p, part.name) for p in parts]) for part in fields(cls)})

    @property
    def mean_return(self) -> Estimate:
        """Mean return with its 95 % confidence interval."""
        return confidence(self.returns)

    def gain_over(self, other: Evaluation) -> Estimate:
        """Mean difference of the returns to those of ``other`` in the same episodes, with its 95 % confidence interval."""
        return confidence(self.returns - other.returns)

    @property
    def survival(self) -> float:
        """Fraction of episodes that the satellite survived."""
        return mean(self.survived)

    @property
    def survival_interval(self) -> tuple[float, float]:
        """95 % confidence interval of the survival."""
        return wilson(int(self.survived.sum()), len(self.survived))

    @property
    def simulated_per_decision(self) -> float | None:
        """Mean of the seconds that a planner has simulated for a decision; None for policies that do not plan."""
        return None if self.simulated is None else float(self.simulated.sum() / self.decisions.sum())

    @property
    def causes(self) -> dict[str, int]:
        """Number of deaths by the aliveness check that failed, without those that never failed."""
        counts = {name: int(failed.sum()) for name, failed in self.deaths.items()}
        return {name: count for name, count in counts.items() if count}

    def summary(self, others: Mapping[str, Evaluation] | None = None) -> dict[str, Any]:
        """Plain numbers for a file, all of them means or counts; with the paired gain over each of the ``others`` by name."""
        return {
            "episodes": len(self.returns),
            "return": asdict(self.mean_return),
            "survival": self.survival,
            "survival_interval": list(self.survival_interval),
            "collected": mean(self.collected),
            "fill": None if self.fill is None else mean(self.fill),
            "decisions": mean(self.decisions),
            **({} if self.simulated is None else {"simulated_per_decision": self.simulated_per_decision}),
            "deaths": self.causes,
            "counts": {name: mean(count) for name, count in self.counts.items()},
            "gain": {name: asdict(self.gain_over(other)) for name, other in (others or {}).items()},
        }


def evaluate(
    policy: TensorDictModuleBase, env: Tasking, *, seed: int | None = None, seeds: Sequence[int] | None = None
) -> Evaluation:
    """Play fresh episodes to their ends, with the most probable actions, and sum up each of them.

    Give ``seed`` or ``seeds``; the same ones give every policy the same episodes.

    Args:
        policy: Writes the actions of one satellite, or of all agents of a constellation, into what the environment returns.
            Entries that it writes under ``next``, such as a recurrent state, are given back to it at the next decision.
        env: The environment, of one satellite or of many; its episodes are reset.
        seed: One episode in each of the environment's N rows: those that start after ``env.set_seed(seed)``.
        seeds: One episode for each seed, N at a time: those that ``gymnasium.make(...).reset(seed=...)`` starts. The environment
            needs ``env_ids=[0] * N`` for that.

    Returns:
        Results of the episodes. Those of a constellation are sums over its satellites; ``survived`` is True if all survived.

    Raises:
        ValueError: Without seeds, with both kinds of them, with ``seeds`` where the environment has other ``env_ids``, or for a
            policy that reads observations which the environment does not have.
    """
    check_reads(policy, env.observation_spec, TRAINED_WITH if isinstance(env, SatelliteTasking) else SHARE)
    if (seed is None) == (seeds is None) or (seeds is not None and len(seeds) == 0):
        raise ValueError(f"seed={seed} and seeds={seeds}: evaluation needs one of them, and an episode at least")
    if seeds is None:
        env.set_seed(seed)
        return _evaluated(policy, env, env.reset(), env.batch_size[0])
    n = env.batch_size[0]
    batches = [seeds[k : k + n] for k in range(0, len(seeds), n)]
    return Evaluation.joined([_evaluated(policy, env, start_episodes(env, batch), len(batch)) for batch in batches])


def start_episodes(env: Tasking, seeds: Sequence[int]) -> TensorDictBase:
    """Start the first episode of each of n seeds, at most N, in the first n rows, and that of the last seed in the others.

    They are the episodes that ``reset(seed=...)`` starts in one Gymnasium environment; ValueError unless ``env_ids`` are all 0.
    """
    n = env.batch_size[0]
    if bool(env.env_ids.any()):
        raise ValueError("seeds name episodes of environment 0; make the environment with env_ids=[0] * num_envs")
    env.reseed([*seeds, *[seeds[-1]] * (n - len(seeds))])
    return env.reset()


def _evaluated(policy: TensorDictModuleBase, env: Tasking, start: TensorDictBase, n: int) -> Evaluation:
    """Results of the first ``n`` rows, played from ``start`` to their ends."""
    player = with_lots(policy, env) if LOT in policy.in_keys else policy
    rows = torch.arange(env.batch_size[0], device=env.device) < n
    decisions = torch.zeros_like(rows, dtype=torch.int64)
    simulated = torch.zeros_like(env.returns)
    for playing, step in play_episodes(env, player, start, rows):
        decisions += torch.where(playing, _asked(env, step), 0)
        if SIMULATED in policy.out_keys:
            simulated += torch.where(playing, step[SIMULATED], 0.0)
    returns, dead = env.returns[:n].clone(), env.dead[:n].view(n, -1)
    level = getattr(env.satellite.dynamics, "storage_level_fraction", None) if isinstance(env, SatelliteTasking) else None
    return Evaluation(
        returns=returns,
        collected=returns - env.failure_penalty * dead.sum(1).to(returns.dtype),
        survived=~dead.any(1),
        decisions=decisions[:n],
        seconds=env.fleet.sim_time[:n].clone(),
        deaths={name: _of_team(failed)[:n] for name, failed in _failed_checks(env).items()},
        counts={name: _of_team(count)[:n].clone() for name, count in env.counts().items()},
        fill=None if level is None else level[:n].clone(),
        simulated=simulated[:n] if SIMULATED in policy.out_keys else None,
    )


def with_lots(policy: Policy, env: Tasking) -> Policy:
    """The policy with :data:`LOT` at each decision: a uniform number that depends on the episode and not on its row."""
    steps = itertools.count()

    def draw(tensordict: TensorDictBase) -> TensorDictBase:
        episode = Key(env.state.seed.cpu(), env.env_ids.cpu(), env.episode.cpu())
        tensordict[LOT] = episode.named(f"decision {next(steps)}").uniform(1).squeeze(-1).to(env.device)
        return policy(tensordict)

    return draw


def _asked(env: Tasking, step: TensorDictBase) -> Tensor:
    """Number of agents that had to decide in each episode, [N]."""
    if not isinstance(env, ConstellationTasking):
        return torch.ones(env.batch_size, dtype=torch.int64, device=env.device)
    keys: list[Any] = ["requires_retasking"] if env.joint else [(group, "requires_retasking") for group in env.group_map]
    return torch.cat([step[key].flatten(1) for key in keys], 1).sum(1)


def _failed_checks(env: Tasking) -> dict[str, Tensor]:
    """Satellites that are present and fail an aliveness check, [N, S] booleans, by the name of the check."""
    checks = [part.aliveness() for part in env.fleet.satellites]
    passed = [torch.ones_like(rows[0], dtype=torch.bool) for rows in ([*alive.values()] for alive in checks)]
    names = dict.fromkeys(name for alive in checks for name in alive)
    return {
        name: env.present & env.fleet.joined([~alive.get(name, every) for alive, every in zip(checks, passed, strict=True)])
        for name in names
    }


def _of_team(each: Tensor) -> Tensor:
    """Values [N, 1] of one satellite without their second dimension; sums of those of many, [N, S]."""
    return each.squeeze(1) if each.shape[1] == 1 else each.sum(1)


def _joined(values: list[Any]) -> Any:
    """Tensors, or tensors by name, one after the other; None stays None."""
    if isinstance(values[0], dict):
        return {name: _joined([value[name] for value in values]) for name in values[0]}
    return None if values[0] is None else torch.cat(values)
