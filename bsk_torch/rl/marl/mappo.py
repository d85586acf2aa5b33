"""MAPPO and IPPO for constellations whose satellites are alike: shared networks, decisions at different times.

A step ends when any satellite has finished its task. Only satellites that then get a new one have decided something, and only
these decisions are learned from, by TorchRL's ``loss_mask_key``. Every satellite is credited with what it earns itself, from its
decision on, with a discount for elapsed time as in :mod:`~bsk_torch.rl.training.advantages`. The critic of MAPPO (Yu et al.
2022, arXiv:2103.01955) observes all satellites, that of IPPO (de Witt et al. 2020, arXiv:2011.09533) one.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import torch
from tensordict import TensorDict, TensorDictBase
from tensordict.nn import TensorDictModule
from torch import Tensor, nn
from torch.nn.functional import relu
from torchrl.modules import MaskedCategorical, ProbabilisticActor, ValueOperator
from torchrl.objectives import IPPOLoss, MAPPOLoss
from torchrl.objectives.value import MultiAgentGAE

from bsk_torch._deprecated import deprecated_names
from bsk_torch.env import ConstellationTasking
from bsk_torch.env.agents import AGENTS
from bsk_torch.rl.evaluation.evaluate import Evaluation, evaluate
from bsk_torch.rl.networks.normaliser import MASK, OWN, ROWS
from bsk_torch.rl.networks.plans import AttentionPlan
from bsk_torch.rl.policies.shared_policy import SharedPolicy, member_view
from bsk_torch.rl.training.advantages import estimate_advantages
from bsk_torch.rl.training.config import PPOConfig
from bsk_torch.rl.training.ppo import REPORTED, Learner
from bsk_torch.rl.training.trainer import VALIDATION, Training
from bsk_torch.sim.params import nearest

ALIVE, DECIDES = ("seen", "alive"), "decides"
"""Keys of masks [..., S] of satellites that are alive, and of those that decided."""

CRITIC_WIDTH = 32
"""Width of critics: all satellites are judged after every step, but few decide."""

LEARNED_FROM = ("seen", DECIDES, "action_mask", "action", "action_log_prob", "advantage", "value_target")
"""Keys of a batch that gradient steps need."""

LOSSES: dict[str, type[MAPPOLoss]] = {"mappo": MAPPOLoss, "ippo": IPPOLoss}
"""Algorithms by name."""


@dataclass(frozen=True)
class MAPPOConfig(PPOConfig):
    """Settings of a training of a constellation; the defaults differ from those for one satellite.

    A frame is a step of the constellation, in which about one satellite decides; ``lmbda`` is the decay per decision of a
    satellite.

    Args:
        algorithm: ``"mappo"`` or ``"ippo"``.
    """

    preset: str = "Constellation-v1"
    network: str = "attention"
    num_envs: int = 64
    rollout: int = 128
    hidden: tuple[int, ...] = (64,)
    learning_rate: float = 1e-3
    gamma: float = 0.997
    epochs: int = 2
    minibatch: int = 512
    checkpoint_every: int = 50_000
    options: dict[str, Any] = dataclasses.field(default_factory=lambda: {"as_set": True})
    algorithm: str = "mappo"

    def __post_init__(self) -> None:
        """Refuse what :class:`PPOConfig` refuses, and unknown algorithms and networks."""
        super().__post_init__()
        if self.algorithm not in LOSSES:
            raise ValueError(f"algorithm={self.algorithm!r} must be one of {sorted(LOSSES)}; {nearest(self.algorithm, LOSSES)}")
        if self.network != "attention":
            raise ValueError(f"network={self.network!r}: constellations learn with 'attention'")


class DecidingOnly(nn.Module):
    """A network that is evaluated for satellites that decide only; zeros for the others."""

    def __init__(self, network: nn.Module) -> None:
        """``network`` gives [B, A] for what is seen, [B, ...] each."""
        super().__init__()
        self.network = network

    def forward(self, own: Tensor, rows: Tensor, mask: Tensor, decides: Tensor) -> Tensor:
        """Outputs [..., S, A] for what satellites see, [..., S, ...] each, of which ``decides`` [..., S]."""
        some = self.network(own[decides], rows[decides], mask[decides])
        return some.new_zeros(*decides.shape, some.shape[-1]).index_put((decides,), some)


class ConstellationCritic(nn.Module):
    """Value of each satellite's state, from its own observation and, in MAPPO, the mean over all that are alive."""

    def __init__(self, n_own: int, n_features: int, width: int, sees_all: bool) -> None:
        """Expect ``n_own`` numbers of a satellite and ``n_features`` of each of its targets."""
        super().__init__()
        self.sees_all = sees_all
        self.own, self.context, self.row = nn.Linear(n_own, width), nn.Linear(n_own, width), nn.Linear(n_features, width)
        self.gist = nn.Linear(2 * width, width)
        self.value = nn.Sequential(nn.Linear((1 + sees_all) * width, width), nn.ReLU(), nn.Linear(width, 1))

    def forward(self, own: Tensor, rows: Tensor, mask: Tensor, alive: Tensor) -> Tensor:
        """Values [..., S, 1] by ``own`` [..., S, D], ``rows`` [..., S, K, F], ``mask`` [..., S, K] and ``alive`` [..., S]."""
        targets = mean_where(relu(self.row(rows) + self.context(own).unsqueeze(-2)), mask)
        each = relu(self.gist(torch.cat([relu(self.own(own)), targets], -1)))
        if not self.sees_all:
            return self.value(each)
        team = mean_where(each, alive).unsqueeze(-2)
        return self.value(torch.cat([each, team.expand_as(each)], -1))


def mean_where(x: Tensor, mask: Tensor) -> Tensor:
    """Mean [..., W] of those x [..., K, W] where ``mask`` [..., K] is true; zero where there are none."""
    weight = mask.unsqueeze(-1).to(x.dtype)
    return (x * weight).sum(-2) / weight.sum(-2).clamp(min=1.0)


def team_batch(batch: TensorDictBase) -> TensorDict:
    """Return observations, actions and rewards [N, T, S, ...] of a batch [N, T] without the level of the group.

    ``decides`` [N, T, S] marks satellites that had to decide; the others could only take the first action, and did. Under
    ``next``, ``done`` [N, T, 1] is the end of the episode, ``removed`` [N, T, S, 1] that of a satellite, by death or with the
    episode, and ``satellite_terminated`` [N, T, S, 1] an end after which nothing is expected.
    """
    agents, following = batch[AGENTS], batch["next", AGENTS]
    legal = agents["action_mask"]
    decides = ~legal[..., -1]
    first = torch.arange(legal.shape[-1] - 1, device=legal.device) == 0
    parts = {
        "seen": _seen(agents),
        DECIDES: decides,
        "action_mask": torch.where(decides.unsqueeze(-1), legal[..., :-1], first),
        "action": torch.where(decides, agents["action"], 0),
        "action_log_prob": agents["action_log_prob"],
        "next": {
            "seen": _seen(following),
            "reward": following["reward"],
            "duration": following["duration"],
            "done": batch["next", "done"],
            "removed": batch["next", "done"].unsqueeze(-2) | ~following["mask"].unsqueeze(-1),
            "satellite_terminated": batch["next", "terminated"].unsqueeze(-2) | ~following["mask"].unsqueeze(-1),
        },
    }
    return TensorDict(parts, batch.batch_size, names=[None, "time"], device=batch.device)


def _seen(agents: TensorDictBase) -> TensorDict:
    """Return the normalised observations of each agent [N, T, S], as a tensordict [N, T]."""
    seen = agents["seen"]
    return TensorDict({"own": seen["own"], "rows": seen["rows"], "mask": seen["mask"], "alive": agents["mask"]}, seen.shape[:-1])


def team_advantages(team: TensorDictBase, critic: ValueOperator, gamma: float, lmbda: float, reward_time: str = "end") -> None:
    """Write ``advantage`` and ``value_target`` [N, T, S, 1] of each satellite in semi-Markov time.

    Nothing is expected after a satellite's death. Advantages are standardised over decisions; those of satellites that did not
    decide have no meaning.

    Args:
        team: A batch by :func:`team_batch`.
        critic: Computes values of observations, at the root and under ``next``.
        gamma: Discount per second.
        lmbda: Decay of the estimator, per step.
        reward_time: See :func:`~bsk_torch.rl.training.advantages.timed`.
    """
    estimate_advantages(
        team, critic, gamma, lmbda, reward_time, estimator=MultiAgentGAE, done="removed", terminated="satellite_terminated"
    )
    deviation, mean = torch.std_mean(team["advantage"][team[DECIDES]])
    team["advantage"] = (team["advantage"] - mean) / deviation.clamp(min=1e-4)


class MAPPOLearner(Learner):
    """One actor and one critic for all satellites, and their optimiser."""

    config: MAPPOConfig

    def __init__(self, config: MAPPOConfig, env: ConstellationTasking) -> None:
        """Fresh networks for an environment; ValueError if it does not fit them."""
        super().__init__(config, member_view(env))
        assert isinstance(self.plan, AttentionPlan)
        self.lmbda = config.lmbda ** (1.0 / env.fleet.size)
        keys = [OWN, ROWS, MASK]
        judge = ConstellationCritic(self.plan.n_own, self.plan.n_features, CRITIC_WIDTH, config.algorithm == "mappo")
        self.critic = ValueOperator(judge, in_keys=[*keys, ALIVE]).to(env.device)
        logits = DecidingOnly(self.networks.actor[0].module)
        actor = ProbabilisticActor(
            TensorDictModule(logits, in_keys=[*keys, DECIDES], out_keys=["logits"]),
            in_keys={"logits": "logits", "mask": "action_mask"},
            distribution_class=MaskedCategorical,
            return_log_prob=True,
        )
        self.loss = LOSSES[config.algorithm](
            actor,
            self.critic,
            clip_epsilon=config.clip,
            entropy_coeff=config.entropy,
            normalize_advantage=False,
            loss_critic_type="l2",
        )
        self.loss.loss_mask_key = DECIDES
        self.optimiser = torch.optim.Adam(self.loss.parameters(), config.learning_rate, eps=1e-5)

    def learn(self, batch: TensorDictBase) -> dict[str, float]:
        """Several passes over a batch [N, T]; means of what the loss reports."""
        agents = batch[AGENTS]
        for situations in (agents, batch["next", AGENTS]):
            self.networks.normaliser(situations)
        team = team_batch(batch)
        team_advantages(team, self.critic, self.config.gamma, self.lmbda, self.config.reward_time)
        self.buffer.empty()
        self.buffer.extend(team.select(*LEARNED_FROM).reshape(-1))
        steps = self.config.epochs * (self.config.batch // self._minibatch)
        reports = [self._descend(self.buffer.sample()) for _ in range(steps)]
        self.networks.normaliser.update(agents.select("observation")[~agents["action_mask"][..., -1]])
        report = dict(zip(REPORTED, torch.stack(reports).mean(0).tolist(), strict=True))
        share = float(team[DECIDES].float().mean())
        return report | {name: report[name] / share for name in ("entropy", "kl_approx", "clip_fraction")}


class MAPPOTraining(Training):
    """A run in a constellation; the policy that it leaves is for one satellite; see ``SharedPolicy``."""

    config: MAPPOConfig
    env: Any  # a constellation, where the base class has one satellite

    def make_learner(self) -> MAPPOLearner:
        """See :meth:`Training.make_learner`."""
        return MAPPOLearner(self.config, self.env)

    @property
    def actor(self) -> SharedPolicy:
        """See :attr:`Training.actor`."""
        return SharedPolicy(self.policy)

    def evaluate(self) -> Evaluation:
        """See :meth:`Training.evaluate`."""
        return evaluate(self.actor, self.judge, seed=self.config.seed + VALIDATION)

    def rewards(self, batch: TensorDictBase) -> Tensor:
        """See :meth:`Training.rewards`."""
        return batch["next", AGENTS, "reward"].sum((-2, -1))

    def fill(self, batch: TensorDictBase) -> None:
        """Satellites of a constellation are not followed one by one."""


if not TYPE_CHECKING:
    __getattr__ = deprecated_names(__name__)
