"""How good is a policy: fresh episodes, the same for every policy, side by side."""

from __future__ import annotations

from dataclasses import dataclass, field
from statistics import NormalDist

import torch
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModuleBase
from torch import Tensor
from torchrl.envs.utils import ExplorationType, set_exploration_type

from bsk_torch.env import SatelliteTasking

LONGEST = 1_000_000
"""Steps after which an evaluation is given up."""


@dataclass(frozen=True)
class Estimate:
    """A mean and the half width of its confidence interval."""

    mean: float
    half_width: float

    def __str__(self) -> str:
        """Mean and half width, to three decimals."""
        return f"{self.mean:.3f} ± {self.half_width:.3f}"

    def overlaps(self, other: Estimate) -> bool:
        """Whether the two intervals have a point in common."""
        return abs(self.mean - other.mean) <= self.half_width + other.half_width


def student_quantile(probability: float, freedom: int) -> float:
    """Quantile of Student's t distribution, by its expansion about the normal one; good to 1e-3 from six degrees on.

    Source: Abramowitz and Stegun, equation 26.7.5.
    """
    x, v = NormalDist().inv_cdf(probability), float(freedom)
    first = (x**3 + x) / 4.0
    second = (5.0 * x**5 + 16.0 * x**3 + 3.0 * x) / 96.0
    third = (3.0 * x**7 + 19.0 * x**5 + 17.0 * x**3 - 15.0 * x) / 384.0
    return x + first / v + second / v**2 + third / v**3


def confidence(samples: Tensor, level: float = 0.95) -> Estimate:
    """Mean of independent ``samples`` [n] with Student's confidence interval; the interval is infinite for one sample."""
    x, n = samples.double(), len(samples)
    if n < 2:
        return Estimate(float(x.mean()), float("inf"))
    return Estimate(float(x.mean()), student_quantile(0.5 + 0.5 * level, n - 1) * float(x.std()) / n**0.5)


@dataclass(frozen=True)
class Evaluation:
    """Results of n episodes, each a tensor [n].

    ``returns`` are sums of rewards, ``collected`` the same without the penalty for dying, ``decisions`` and ``seconds`` the
    lengths, ``deaths`` says for every aliveness check whether it failed at the end, and ``counts`` is what the environment has
    counted, such as ``imaged``.
    """

    returns: Tensor
    collected: Tensor
    survived: Tensor
    decisions: Tensor
    seconds: Tensor
    deaths: dict[str, Tensor]
    counts: dict[str, Tensor] = field(default_factory=dict)

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
        return float(self.survived.double().mean())

    @property
    def causes(self) -> dict[str, int]:
        """Number of deaths by the aliveness check that failed, without those that never failed."""
        counts = {name: int(failed.sum()) for name, failed in self.deaths.items()}
        return {name: count for name, count in counts.items() if count}


def evaluate(policy: TensorDictModuleBase, env: SatelliteTasking, *, seed: int) -> Evaluation:
    """Play one episode in each of the environment's N rows; the most probable action is taken. Only sums are kept of the steps.

    Args:
        policy: Writes ``action`` into a tensordict with ``observation`` and ``action_mask``.
        env: The environment; its episodes start anew.
        seed: Seed of the episodes; the same seed gives every policy the same ones.
    """
    env.set_seed(seed)
    with torch.no_grad(), set_exploration_type(ExplorationType.DETERMINISTIC):
        return _summary(_play(policy, env, env.reset()), env)


def _play(policy: TensorDictModuleBase, env: SatelliteTasking, now: TensorDictBase) -> TensorDictBase:
    """Play on from ``now`` until every row has ended; the last outputs, with sums of reward, duration and decisions [N]."""
    over = now["done"].squeeze(-1)
    returns, seconds, decisions = (torch.zeros(len(over), dtype=torch.float64, device=env.device) for _ in range(3))
    for _ in range(LONGEST):
        if bool(over.all()):
            break
        now = env.play(policy(now)["action"], ~over)
        returns += torch.where(over, 0.0, now["reward"].squeeze(-1))
        seconds += torch.where(over, 0.0, now["duration"].squeeze(-1))
        decisions += ~over
        over = over | now["done"].squeeze(-1)
    return now.update({"returns": returns.to(env.dtype), "seconds": seconds.to(env.dtype), "decisions": decisions.long()})


def _summary(played: TensorDictBase, env: SatelliteTasking) -> Evaluation:
    """Results of episodes that have been played to their ends."""
    counts: TensorDictBase | None = played.get("counts", None)
    return Evaluation(
        returns=played["returns"],
        collected=played["returns"] - env.failure_penalty * env.dead,
        survived=~env.dead,
        decisions=played["decisions"],
        seconds=played["seconds"],
        deaths={name: ~alive for name, alive in env.satellite.aliveness().items()},
        counts={} if counts is None else {str(name): count.squeeze(-1).clone() for name, count in counts.items()},
    )
