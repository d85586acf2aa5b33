"""Evaluation of policies in unseen episodes, the same for every policy."""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, fields
from typing import Any

import torch
from tensordict import NestedKey, TensorDictBase
from tensordict.nn import TensorDictModuleBase
from torch import Tensor

from bsk_torch.env import ConstellationTasking, SatelliteTasking, Tasking
from bsk_torch.env.rollout import Policy, play_episodes
from bsk_torch.rand import Key
from bsk_torch.rl.evaluation.statistics import Estimate, confidence, mean, nan_confidence, wilson
from bsk_torch.rl.policies.shared_policy import TRAINED_WITH, as_policy, check_reads
from bsk_torch.rl.rules.baselines import LOT
from bsk_torch.wrappers.policies import Actor

FRESH = 1_000_003
"""Added to the training seed to obtain the evaluation seed, whose episodes the policy has not seen."""

SHARE = "shared(policy, env) lets a policy of one satellite decide for those of a constellation"
"""Advice for a single-satellite policy in a constellation, whose observations are under the names of its groups."""

SIMULATED = "simulated_seconds"
"""Key under which planners write the simulated time of a decision, [N] s."""


@dataclass(frozen=True)
class Evaluation:
    """Results of n episodes, each a tensor [n].

    ``returns`` are sums of rewards (float64), ``collected`` the same without failure penalties, and ``decisions`` and ``seconds``
    the lengths. ``deaths`` contains for each aliveness check whether it failed at the end, and ``counts`` the counters of the
    environment, such as ``imaged``. ``fill`` is the fill level of the data buffer at the end, as a fraction; None without a
    buffer. ``measures`` are those of the rewarder, such as the completion rate ``CR`` of AEOS-Bench; NaN where there is none.
    ``simulated`` is the time simulated by a planner for all decisions of the episode, s; None for other policies.
    """

    returns: Tensor
    collected: Tensor
    survived: Tensor
    decisions: Tensor
    seconds: Tensor
    deaths: dict[str, Tensor]
    counts: dict[str, Tensor] = field(default_factory=dict)
    fill: Tensor | None = None
    measures: dict[str, Tensor] = field(default_factory=dict)
    simulated: Tensor | None = None

    @classmethod
    def joined(cls, parts: Sequence[Evaluation]) -> Evaluation:
        """Return the episodes of all ``parts``, in order."""
        return cls(**{part.name: _joined([getattr(p, part.name) for p in parts]) for part in fields(cls)})

    @property
    def mean_return(self) -> Estimate:
        """Mean return with its 95 % confidence interval."""
        return confidence(self.returns)

    def gain_over(self, other: Evaluation) -> Estimate:
        """Return the mean difference from the returns of ``other`` in the same episodes, with its 95 % confidence interval."""
        return confidence(self.returns - other.returns)

    @property
    def survival(self) -> float:
        """Fraction of episodes survived by the satellite."""
        return mean(self.survived)

    @property
    def survival_interval(self) -> tuple[float, float]:
        """95 % confidence interval of the survival."""
        return wilson(int(self.survived.sum()), len(self.survived))

    @property
    def simulated_per_decision(self) -> float | None:
        """Mean time simulated by a planner for a decision, s; None for other policies."""
        return None if self.simulated is None else float(self.simulated.sum() / self.decisions.sum())

    @property
    def causes(self) -> dict[str, int]:
        """Number of deaths by failed aliveness check, without checks that never failed."""
        counts = {name: int(failed.sum()) for name, failed in self.deaths.items()}
        return {name: count for name, count in counts.items() if count}

    def summary(self, baselines: Mapping[str, Evaluation] | None = None) -> dict[str, Any]:
        """Return means and counts as plain numbers, with the paired gain over each of the ``baselines`` by name."""
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
            **(
                {"measures": {name: asdict(nan_confidence(value)) for name, value in self.measures.items()}}
                if self.measures
                else {}
            ),
            "gain": {name: asdict(self.gain_over(other)) for name, other in (baselines or {}).items()},
        }


def evaluate(policy: Actor, env: Tasking, *, seed: int | None = None, seeds: Sequence[int] | None = None) -> Evaluation:
    """Play whole episodes with the most probable actions, and return the results of each.

    With the same seeds, every policy plays the same episodes: by default unseen ones, of the seed :data:`FRESH`.

    Args:
        policy: A module that writes the actions of one satellite, or of all agents of a constellation, into the environment's
            tensordict; or a torch module or function of the observation, or a model of Stable-Baselines3, as
            :func:`~bsk_torch.wrappers.policies.policy_of_one` describes; or the name of a rule, policy file or run folder.
            Entries written under ``next``, such as a recurrent state, are passed to the policy at the next decision.
        env: The environment, with one satellite or several; its episodes are reset.
        seed: Play one episode in each of the environment's N rows: the episodes started after ``env.set_seed(seed)``.
        seeds: Play one episode for each seed, N at a time: the episodes started by ``gymnasium.make(...).reset(seed=...)``. The
            environment must have ``env_ids=[0] * N``.

    Returns:
        Results of the episodes. In a constellation, they are sums over its satellites; ``survived`` is True if all survived.

    Raises:
        TypeError: For anything else, with what to write.
        ValueError: For empty ``seeds``, both ``seed`` and ``seeds``, ``seeds`` in an environment with other ``env_ids``, or a
            policy that reads observations missing in the environment.
    """
    policy = as_policy(policy, env)
    check_reads(policy, env.observation_spec, TRAINED_WITH if isinstance(env, SatelliteTasking) else SHARE)
    if seeds is not None and (seed is not None or len(seeds) == 0):
        raise ValueError(f"seed={seed} and seeds={seeds}: give one of them at most, and an episode at least")
    if seeds is None:
        env.set_seed(FRESH if seed is None else seed)
        return _evaluated(policy, env, env.reset(), env.batch_size[0])
    n = env.batch_size[0]
    batches = [seeds[k : k + n] for k in range(0, len(seeds), n)]
    return Evaluation.joined([_evaluated(policy, env, start_episodes(env, batch), len(batch)) for batch in batches])


def start_episodes(env: Tasking, seeds: Sequence[int]) -> TensorDictBase:
    """Start the first episode of each of n seeds, at most N, in the first n rows; other rows play the last seed's episode.

    They are the episodes started by ``reset(seed=...)`` in one Gymnasium environment. ValueError unless all ``env_ids`` are 0.
    """
    n = env.batch_size[0]
    if bool(env.env_ids.any()):
        raise ValueError("seeds name episodes of environment 0; make the environment with env_ids=[0] * num_envs")
    env.reseed([*seeds, *[seeds[-1]] * (n - len(seeds))])
    return env.reset()


def _evaluated(policy: TensorDictModuleBase, env: Tasking, start: TensorDictBase, n: int) -> Evaluation:
    """Play the first ``n`` rows from ``start`` to their ends, and return their results."""
    player = with_lots(policy, env)
    rows = torch.arange(env.batch_size[0], device=env.device) < n
    decisions = torch.zeros_like(rows, dtype=torch.int64)
    simulated = torch.zeros_like(env.returns)
    for playing, step in play_episodes(env, player, start, rows):
        decisions += torch.where(playing, _deciding_agents(env, step), 0)
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
        deaths={name: of_team(failed)[:n] for name, failed in failed_checks(env).items()},
        counts={name: of_team(count)[:n].clone() for name, count in env.counts().items()},
        fill=None if level is None else level[:n].clone(),
        measures={name: value[:n].clone() for name, value in env.checked.measures().items()},
        simulated=simulated[:n] if SIMULATED in policy.out_keys else None,
    )


def with_lots(policy: Policy, env: Tasking) -> Policy:
    """Return a policy with a :data:`LOT` at each decision, a uniform number that depends on the episode but not on its row.

    Policies whose ``in_keys`` do not have it are returned unchanged.
    """
    if LOT not in getattr(policy, "in_keys", (LOT,)):
        return policy
    steps = itertools.count()

    def draw(tensordict: TensorDictBase) -> TensorDictBase:
        episode = Key(env.state.seed.cpu(), env.env_ids.cpu(), env.episode.cpu())
        tensordict[LOT] = episode.named(f"decision {next(steps)}").uniform(1).squeeze(-1).to(env.device)
        return policy(tensordict)

    return draw


def _deciding_agents(env: Tasking, step: TensorDictBase) -> Tensor:
    """Return the number of deciding agents in each episode, [N]."""
    if not isinstance(env, ConstellationTasking):
        return torch.ones(env.batch_size, dtype=torch.int64, device=env.device)
    keys: list[NestedKey] = ["requires_retasking"] if env.joint else [(group, "requires_retasking") for group in env.group_map]
    return torch.cat([step[key].flatten(1) for key in keys], 1).sum(1)


def failed_checks(env: Tasking) -> dict[str, Tensor]:
    """Return the present satellites that fail each aliveness check, [N, S] booleans by the name of the check."""
    checks = [part.aliveness() for part in env.fleet.satellites]
    ones = [torch.ones_like(rows[0], dtype=torch.bool) for rows in ([*alive.values()] for alive in checks)]
    names = dict.fromkeys(name for alive in checks for name in alive)
    return {
        name: env.present & env.fleet.joined([~alive.get(name, every) for alive, every in zip(checks, ones, strict=True)])
        for name in names
    }


def of_team(each: Tensor) -> Tensor:
    """Return values [N, S] summed over the satellites, [N]."""
    return each.squeeze(1) if each.shape[1] == 1 else each.sum(1)


def _joined(values: list[Any]) -> Any:
    if isinstance(values[0], dict):
        return {name: _joined([value[name] for value in values]) for name in values[0]}
    return None if values[0] is None else torch.cat(values)
