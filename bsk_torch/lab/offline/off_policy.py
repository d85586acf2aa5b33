"""Off-policy evaluation: the value of a policy from episodes of another one, and its score against counterfactual returns."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import torch
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModuleBase
from torch import Tensor
from torchrl.modules import MLP

from bsk_torch._checks import number, whole
from bsk_torch.env.rollout import decide
from bsk_torch.lab.offline.layout import EPISODE, LOG_PROB
from bsk_torch.rl.evaluation.statistics import Estimate, confidence

__all__ = ["FittedQ", "ImportanceEstimate", "Score", "actions_of", "features", "fitted_q", "importance_sampling", "score"]

ROWS = 8192
"""Rows that a policy or network judges at once."""


@dataclass(frozen=True)
class FittedQ:
    """Estimated action values of a policy.

    Attributes:
        network: From standardized observations [n, F] to values [n, A], in units of ``scale``.
        mean: Mean of the observations, [F].
        deviation: Their standard deviation, [F].
        scale: Unit of the network's values.
    """

    network: torch.nn.Module
    mean: Tensor
    deviation: Tensor
    scale: float

    @torch.no_grad()
    def values(self, rows: TensorDictBase) -> Tensor:
        """Return the estimated returns of all actions, [n, A] float64, for rows [n] with observations."""
        inputs = (features(rows) - self.mean) / self.deviation
        return torch.cat([self.network(part).double() for part in inputs.split(ROWS)]) * self.scale


class ImportanceEstimate(NamedTuple):
    """The value of a policy by importance sampling.

    Attributes:
        ordinary: Mean over episodes of per-decision importance sampling, with its 95 % confidence interval. Without bias, but the
            interval is too narrow where few episodes have all the weight.
        weighted: The same with normalized weights at each decision.
        effective: Effective number of episodes, (sum of weights)^2 / sum of squared weights, at their ends.
    """

    ordinary: Estimate
    weighted: float
    effective: float


class Score(NamedTuple):
    """How good estimates of action values are.

    Attributes:
        rmse: Root of the mean squared error, over all legal actions.
        concordance: Share of the pairs of legal actions with different returns that the estimates put in the right order.
        regret: Mean loss of return by taking the action with the largest estimate once.
    """

    rmse: float
    concordance: float
    regret: float


def features(rows: TensorDictBase) -> Tensor:
    """Return the observations of rows [n] as one tensor, [n, F] float32; parts of a set are joined in order of their names."""
    observation = rows["observation"]
    if isinstance(observation, Tensor):
        return observation.float()
    leaves = sorted(observation.keys(True, True), key=str)
    return torch.cat([observation[key].float().flatten(1) for key in leaves], 1)


def actions_of(policy: TensorDictModuleBase, rows: TensorDictBase) -> Tensor:
    """Return the most probable actions of a policy, [n], for rows [n] with observations and masks."""
    keys = [key for key in rows.keys(True, True) if key in policy.in_keys]
    parts = rows.select(*keys).split(ROWS)
    return torch.cat([decide(policy, part.clone())["action"] for part in parts])


def fitted_q(
    transitions: TensorDictBase,
    policy: TensorDictModuleBase,
    *,
    gamma: float = 1.0,
    trace: float = 0.0,
    iterations: int = 200,
    hidden: Sequence[int] = (64, 64),
    batch_size: int = 512,
    learning_rate: float = 1e-3,
    seed: int = 0,
) -> FittedQ:
    """Estimate the action values of a policy by fitted Q evaluation.

    Each iteration fits a network, which starts from that of the iteration before, to ``gamma^t (r + Q(s', policy(s')))``, in one
    pass through the data (Le, Voloshin, Yue, "Batch policy learning under constraints", ICML 2019). At the end of an episode, Q
    is 0: values are returns up to the time limit. With a ``trace``, the sum continues along the episode as long as its actions
    are those of the policy (tree backup: D. Precup, R. Sutton, S. Singh, ICML 2000).

    Args:
        transitions: Whole episodes one after the other, [T]; see :meth:`~bsk_torch.lab.offline.OfflineDataset.transitions`.
        policy: The policy to judge, whose most probable action is taken.
        gamma: Discount per second.
        trace: Share of the sum along the episode, 0 to 1.
        iterations: Number of iterations.
        hidden: Widths of the hidden layers.
        batch_size: Decisions of a gradient step.
        learning_rate: Learning rate of Adam.
        seed: Seed of the network and of the order of decisions.
    """
    number("gamma", gamma, 0.0, 1.0, above=True)
    number("trace", trace, 0.0, 1.0)
    whole("iterations", iterations, 1)
    whole("batch_size", batch_size, 1)
    data = _Episodes.of(transitions, policy, gamma)
    x, after = features(transitions), features(transitions["next"])
    mean, deviation = x.mean(0), x.std(0)
    deviation = torch.where(deviation > 0.0, deviation, 1.0)
    x, after = (x - mean) / deviation, (after - mean) / deviation
    scale = float(data.returns().std()) or 1.0
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(seed)
        network = MLP(x.shape[1], transitions["action_mask"].shape[-1], num_cells=list(hidden), activation_class=torch.nn.ReLU)
    optimizer = torch.optim.Adam(network.parameters(), lr=learning_rate)
    generator = torch.Generator().manual_seed(seed)
    estimate = FittedQ(network, mean, deviation, scale)
    actions = transitions["action"].unsqueeze(1)
    for _ in range(iterations):
        with torch.no_grad():
            q = torch.cat([network(part) for part in after.split(ROWS)]).gather(1, data.next_action.unsqueeze(1)).squeeze(1)
            targets = data.backed_up(q.double() * scale, trace) / scale
        for index in torch.randperm(len(x), generator=generator).split(batch_size):
            error = network(x[index]).gather(1, actions[index]).squeeze(1) - targets[index].float()
            optimizer.zero_grad()
            error.square().mean().backward()
            optimizer.step()
    return estimate


def importance_sampling(transitions: TensorDictBase, policy: TensorDictModuleBase, *, gamma: float = 1.0) -> ImportanceEstimate:
    """Estimate the value of a policy at the starts of episodes by importance sampling of its most probable actions.

    Args:
        transitions: Whole episodes one after the other, [T], with ``action_log_prob`` of the behavior.
        policy: The policy to judge.
        gamma: Discount per second.
    """
    number("gamma", gamma, 0.0, 1.0, above=True)
    data = _Episodes.of(transitions, policy, gamma)
    ratio = data.agrees.double() / transitions[LOG_PROB].double().exp()
    weight = data.table(ratio, 1.0).cumprod(1)
    gain = data.table(data.factor, 1.0).cumprod(1) * data.table(data.reward, 0.0)
    shares = weight / weight.sum(0).clamp(min=torch.finfo(torch.float64).tiny)
    last = weight[:, -1]
    return ImportanceEstimate(
        confidence((weight * gain).sum(1)),
        float((shares * gain).sum()),
        float(last.sum() ** 2 / last.square().sum()) if bool(last.any()) else 0.0,
    )


def score(estimates: Tensor, truth: Tensor) -> Score:
    """Return the score of estimated action values [D, A] against returns [D, A], which are NaN for illegal actions."""
    legal = ~truth.isnan()
    error = (estimates - truth)[legal]
    returns = truth.nan_to_num(nan=0.0)
    comparable = legal.unsqueeze(2) & legal.unsqueeze(1)
    difference, guessed = returns.unsqueeze(2) - returns.unsqueeze(1), estimates.unsqueeze(2) - estimates.unsqueeze(1)
    pairs = comparable & (difference > 0.0)
    best = truth.nan_to_num(nan=-torch.inf).amax(1)
    action = estimates.masked_fill(~legal, -torch.inf).argmax(1, keepdim=True)
    return Score(
        float(error.square().mean().sqrt()),
        float((guessed[pairs] > 0.0).double().mean()),
        float((best - truth.gather(1, action).squeeze(1)).mean()),
    )


class _Episodes(NamedTuple):
    """Decisions [T] of E episodes, one after the other, as off-policy evaluation needs them.

    Attributes:
        reward: Rewards, [T] float64.
        factor: Discounts over the decisions, [T].
        done: Whether the episode ended, [T].
        agrees: Whether the action is that of the policy, [T].
        next_action: The action of the policy after the decision, [T].
        place: Episode and decision in it, [T] each.
    """

    reward: Tensor
    factor: Tensor
    done: Tensor
    agrees: Tensor
    next_action: Tensor
    place: tuple[Tensor, Tensor]

    @classmethod
    def of(cls, transitions: TensorDictBase, policy: TensorDictModuleBase, gamma: float) -> _Episodes:
        episode, following = transitions[EPISODE], transitions["next"]
        _, number_of, count = torch.unique_consecutive(episode, return_inverse=True, return_counts=True)
        begins = (count.cumsum(0) - count)[number_of]
        return cls(
            following["reward"].squeeze(-1).double(),
            gamma ** following["duration"].squeeze(-1).double(),
            following["done"].squeeze(-1).clone(),
            actions_of(policy, transitions) == transitions["action"],
            actions_of(policy, following),
            (number_of, torch.arange(len(episode)) - begins),
        )

    def table(self, column: Tensor, fill: float) -> Tensor:
        """Return a column [T] as a table of episodes and decisions, [E, L], filled up at the ends of short episodes."""
        episodes, longest = (int(part.max()) + 1 for part in self.place)
        return torch.full((episodes, longest), fill, dtype=column.dtype).index_put(self.place, column)

    def returns(self) -> Tensor:
        return self.table(self.reward, 0.0).sum(1)

    def backed_up(self, following: Tensor, trace: float) -> Tensor:
        """Return the targets of a regression [T], with values ``following`` [T] of the states after the decisions."""
        following = torch.where(self.done, 0.0, following)
        if trace == 0.0:
            return self.factor * (self.reward + following)
        value, reward, factor = self.table(following, 0.0), self.table(self.reward, 0.0), self.table(self.factor, 1.0)
        follows = trace * self.table(self.agrees.double(), 0.0)
        total, totals = torch.zeros_like(value[:, 0]), torch.zeros_like(value)
        share = torch.zeros_like(total)
        for k in reversed(range(value.shape[1])):
            total = factor[:, k] * (reward[:, k] + share * total + (1.0 - share) * value[:, k])
            totals[:, k], share = total, follows[:, k]
        return totals[self.place]
