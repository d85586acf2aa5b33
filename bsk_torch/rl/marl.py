"""MAPPO and IPPO for constellations whose satellites are alike: shared networks, decisions at different times.

A step ends when any satellite has finished its task. Only satellites that then get a new one have decided something, and only
these decisions are learned from, by TorchRL's ``loss_mask_key``. Every satellite is credited with what it earns itself, from its
decision on, with a discount for elapsed time as in :mod:`bsk_torch.rl.ppo`. In MAPPO (Yu et al. 2022, arXiv:2103.01955) the
critic sees all satellites, in IPPO (de Witt et al. 2020, arXiv:2011.09533) the one it judges.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import Any

import torch
from tensordict import TensorDict, TensorDictBase
from tensordict.nn import TensorDictModule
from torch import Tensor, nn
from torch.nn.functional import relu
from torchrl.modules import MaskedCategorical, ProbabilisticActor, ValueOperator
from torchrl.objectives import IPPOLoss, MAPPOLoss
from torchrl.objectives.value import MultiAgentGAE

from bsk_torch.env import ConstellationTasking
from bsk_torch.env.groups import AGENTS
from bsk_torch.rl.config import PPOConfig
from bsk_torch.rl.crew import Crew, evaluate_crew, member
from bsk_torch.rl.evaluate import Evaluation
from bsk_torch.rl.networks import AttentionPlan
from bsk_torch.rl.ppo import REPORTED, Learner, timed, values
from bsk_torch.rl.sight import MASK, OWN, ROWS
from bsk_torch.rl.training import VALIDATION, Training
from bsk_torch.sim.params import nearest

ALIVE, DECIDES = ("seen", "alive"), "decides"
"""Keys of which satellites live, and of which have decided something, [..., S] booleans."""

JUDGES = 32
"""Width of critics: all satellites are judged after every step, but few decide."""

LEARNED_FROM = ("seen", DECIDES, "action_mask", "action", "action_log_prob", "advantage", "value_target")
"""Keys of a batch that gradient steps need."""

LOSSES: dict[str, type[MAPPOLoss]] = {"mappo": MAPPOLoss, "ippo": IPPOLoss}
"""Algorithms by name."""


@dataclass(frozen=True)
class CrewConfig(PPOConfig):
    """What differs from training one satellite.

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


class WhereDeciding(nn.Module):
    """A network that is only asked about satellites that decide; zeros for the others."""

    def __init__(self, network: nn.Module) -> None:
        """``network`` gives [B, A] for what is seen, [B, ...] each."""
        super().__init__()
        self.network = network

    def forward(self, own: Tensor, rows: Tensor, mask: Tensor, decides: Tensor) -> Tensor:
        """Outputs [..., S, A] for what satellites see, [..., S, ...] each, of which ``decides`` [..., S]."""
        some = self.network(own[decides], rows[decides], mask[decides])
        return some.new_zeros(*decides.shape, some.shape[-1]).index_put((decides,), some)


class CrewCritic(nn.Module):
    """Value of each satellite's situation, by what it sees and, in MAPPO, by the mean of what all that live see."""

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


def by_team(batch: TensorDictBase) -> TensorDict:
    """A batch [N, T] of what the agents saw, did and got, [N, T, S, ...] each, without the level of the group.

    ``decides`` [N, T, S] says who had to decide; the others could only take the first action, and did. Under ``next``, ``done``
    [N, T, 1] is the end of the episode, ``gone`` [N, T, S, 1] that of a satellite, by death or with the episode, and ``lost``
    an end after which nothing is to be expected.
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
            "gone": batch["next", "done"].unsqueeze(-2) | ~following["mask"].unsqueeze(-1),
            "lost": batch["next", "terminated"].unsqueeze(-2) | ~following["mask"].unsqueeze(-1),
        },
    }
    return TensorDict(parts, batch.batch_size, names=[None, "time"], device=batch.device)


def _seen(agents: TensorDictBase) -> TensorDict:
    """What networks see of each agent [N, T, S], as a tensordict [N, T]."""
    seen = agents["seen"]
    return TensorDict({"own": seen["own"], "rows": seen["rows"], "mask": seen["mask"], "alive": agents["mask"]}, seen.shape[:-1])


def estimate_advantages(
    team: TensorDictBase, critic: ValueOperator, gamma: float, lmbda: float, reward_time: str = "end"
) -> None:
    """Write ``advantage`` and ``value_target`` [N, T, S, 1], in semi-Markov time as in :mod:`bsk_torch.rl.ppo`.

    Nothing is expected after a satellite's death. Advantages are standardised over decisions; those of others mean nothing.

    Args:
        team: A batch by :func:`by_team`.
        critic: Judges what is seen, here and under ``next``.
        gamma: Discount per second.
        lmbda: Decay of the estimator, per step.
        reward_time: See :func:`~bsk_torch.rl.ppo.timed`.
    """
    reward, seconds = team["next", "reward"], team["next", "duration"]
    estimator = MultiAgentGAE(
        gamma=torch.tensor(gamma, dtype=torch.float64, device=reward.device),
        lmbda=lmbda,
        value_network=None,
        device=reward.device,
    )
    estimator.set_keys(steps_to_next_obs=("next", "duration"), done="gone", terminated="lost")
    judged = team.select("next").clone(recurse=False)
    judged["state_value"], judged["next", "state_value"] = values(team, critic)
    judged["next", "reward"] = timed(reward, seconds, gamma, reward_time)
    estimator(judged)
    for key in ("advantage", "value_target"):
        team[key] = judged[key].to(reward.dtype)
    deviation, mean = torch.std_mean(team["advantage"][team[DECIDES]])
    team["advantage"] = (team["advantage"] - mean) / deviation.clamp(min=1e-4)


class CrewLearner(Learner):
    """One actor and one critic for all satellites, and their optimiser."""

    config: CrewConfig

    def __init__(self, config: CrewConfig, env: ConstellationTasking) -> None:
        """Fresh networks for an environment; ValueError if it does not fit them."""
        super().__init__(config, member(env))
        assert isinstance(self.plan, AttentionPlan)
        self.lmbda = config.lmbda ** (1.0 / env.fleet.size)
        keys = [OWN, ROWS, MASK]
        judge = CrewCritic(self.plan.n_own, self.plan.n_features, JUDGES, config.algorithm == "mappo")
        self.critic = ValueOperator(judge, in_keys=[*keys, ALIVE]).to(env.device)
        logits = WhereDeciding(self.networks.actor[0].module)
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
            self.networks.sight(situations)
        team = by_team(batch)
        estimate_advantages(team, self.critic, self.config.gamma, self.lmbda, self.config.reward_time)
        self.buffer.empty()
        self.buffer.extend(team.select(*LEARNED_FROM).reshape(-1))
        steps = self.config.epochs * (self.config.batch // self._minibatch)
        reports = [self._descend(self.buffer.sample()) for _ in range(steps)]
        self.networks.sight.update(agents.select("observation")[~agents["action_mask"][..., -1]])
        report = dict(zip(REPORTED, torch.stack(reports).mean(0).tolist(), strict=True))
        share = float(team[DECIDES].float().mean())
        return report | {name: report[name] / share for name in ("entropy", "kl_approx", "clip_fraction")}


class CrewTraining(Training):
    """A run in a constellation; the policy that it leaves is for one satellite, see :class:`~bsk_torch.rl.crew.Crew`."""

    config: CrewConfig

    def make_learner(self) -> CrewLearner:
        """See :meth:`Training.make_learner`."""
        return CrewLearner(self.config, self.env)

    @property
    def actor(self) -> Crew:
        """See :attr:`Training.actor`."""
        return Crew(self.policy)

    def evaluate(self) -> Evaluation:
        """See :meth:`Training.evaluate`."""
        return evaluate_crew(self.actor, self.judge, seed=self.config.seed + VALIDATION)

    def rewards(self, batch: TensorDictBase) -> Tensor:
        """See :meth:`Training.rewards`."""
        return batch["next", AGENTS, "reward"].sum((-2, -1))

    def fill(self, batch: TensorDictBase) -> None:
        """Satellites of a constellation are not followed one by one."""
