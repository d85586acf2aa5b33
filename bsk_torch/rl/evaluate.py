"""How good is a policy: fresh episodes, the same for every policy, side by side."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, fields
from typing import Any

import torch
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModuleBase
from torch import Tensor
from torchrl.envs.utils import ExplorationType, set_exploration_type

from bsk_torch.env import SatelliteTasking
from bsk_torch.rand import Key
from bsk_torch.rl.baselines import LOT
from bsk_torch.rl.statistics import Estimate, confidence, mean, wilson
from bsk_torch.wrappers.gymnasium import reseed

LONGEST = 1_000_000
"""Steps after which an evaluation is given up."""

FRESH = 1_000_003
"""Added to the seed of training to get the seed of evaluation, whose episodes are then new to the policy."""


@dataclass(frozen=True)
class Evaluation:
    """Results of n episodes, each a tensor [n].

    ``returns`` are sums of rewards (float64), ``collected`` the same without the penalty for dying, ``decisions`` and ``seconds``
    the lengths, ``deaths`` says for every aliveness check whether it failed at the end, ``counts`` is what the environment has
    counted, such as ``imaged``, and ``fill`` the level of the store at the end, a fraction; None without a store.
    """

    returns: Tensor
    collected: Tensor
    survived: Tensor
    decisions: Tensor
    seconds: Tensor
    deaths: dict[str, Tensor]
    counts: dict[str, Tensor] = field(default_factory=dict)
    fill: Tensor | None = None

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
            "deaths": self.causes,
            "counts": {name: mean(count) for name, count in self.counts.items()},
            "gain": {name: asdict(self.gain_over(other)) for name, other in (others or {}).items()},
        }


def evaluate(
    policy: TensorDictModuleBase, env: SatelliteTasking, *, seed: int | None = None, seeds: Sequence[int] | None = None
) -> Evaluation:
    """Play fresh episodes to their ends; the most probable action is taken. Only sums are kept of the steps.

    Give ``seed`` or ``seeds``; the same ones give every policy the same episodes.

    Args:
        policy: Writes ``action`` into a tensordict with ``observation`` and ``action_mask``. What it writes under ``next``, such
            as a memory, it finds at the next decision.
        env: The environment; its episodes start anew.
        seed: One episode in each of the environment's N rows, those that ``env.set_seed(seed)`` starts.
        seeds: One episode for each seed, N at a time: those that ``gymnasium.make(...).reset(seed=...)`` starts. The environment
            needs ``env_ids=[0] * N`` for that.

    Raises:
        ValueError: Without seeds, with both kinds of them, or with ``seeds`` where the environment has other ``env_ids``.
    """
    if (seed is None) == (seeds is None) or (seeds is not None and len(seeds) == 0):
        raise ValueError(f"seed={seed} and seeds={seeds}: evaluation needs one of them, and an episode at least")
    n = env.batch_size[0]
    with torch.no_grad(), set_exploration_type(ExplorationType.DETERMINISTIC):
        if seeds is None:
            env.set_seed(seed)
            return _episodes(policy, env, n)
        if bool(env.env_ids.any()):
            raise ValueError("seeds name episodes of environment 0; make the environment with env_ids=[0] * num_envs")
        return Evaluation.joined([_seeded(policy, env, seeds[k : k + n]) for k in range(0, len(seeds), n)])


def _seeded(policy: TensorDictModuleBase, env: SatelliteTasking, seeds: Sequence[int]) -> Evaluation:
    """The episodes of ``seeds``, at most as many as there are rows."""
    spare = env.batch_size[0] - len(seeds)
    reseed(env, [*seeds, *[seeds[-1]] * spare], torch.ones_like(env.dead))
    return _episodes(policy, env, len(seeds))


def _episodes(policy: TensorDictModuleBase, env: SatelliteTasking, n: int) -> Evaluation:
    """New episodes in the first ``n`` rows, from their starts to their ends."""
    now = env.reset()
    over = torch.arange(env.batch_size[0], device=env.device) >= n
    decisions = torch.zeros_like(over, dtype=torch.int64)
    for step in range(LONGEST):
        if bool(over.all()):
            break
        if LOT in policy.in_keys:
            now[LOT] = _lots(env, step)
        told = policy(now)
        now = env.play(told["action"], ~over).update(told.get("next", {}))
        decisions += ~over
        over = over | now["done"].squeeze(-1)
    return _summary(env, n, decisions, now.get("counts", None))


def _lots(env: SatelliteTasking, step: int) -> Tensor:
    """A uniform number for the decision ``step`` of each episode, [N], that depends on the episode and not on its row."""
    episode = Key(env.seed_rows.cpu(), env.env_ids.cpu(), env.episode.cpu())
    return episode.named(f"decision {step}").uniform(1).squeeze(-1).to(env.device)


def _summary(env: SatelliteTasking, n: int, decisions: Tensor, counts: TensorDictBase | None) -> Evaluation:
    """Results of the first ``n`` rows, which have been played to their ends."""
    returns, dead = env.returns[:n].clone(), env.dead[:n]
    level = getattr(env.satellite.dynamics, "storage_level_fraction", None)
    return Evaluation(
        returns=returns,
        collected=returns - env.failure_penalty * dead,
        survived=~dead,
        decisions=decisions[:n],
        seconds=env.fleet.sim_time[:n].clone(),
        deaths={name: ~alive[:n] for name, alive in env.satellite.aliveness().items()},
        counts={} if counts is None else {str(name): count[:n].squeeze(-1).clone() for name, count in counts.items()},
        fill=None if level is None else level[:n].clone(),
    )


def _joined(values: list[Any]) -> Any:
    """Tensors, or tensors by name, one after the other; None stays None."""
    if isinstance(values[0], dict):
        return {name: _joined([value[name] for value in values]) for name in values[0]}
    return None if values[0] is None else torch.cat(values)
