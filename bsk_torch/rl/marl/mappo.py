"""MAPPO and IPPO for constellations: networks that satellites of one type share, decisions at different times.

A step ends when any satellite has finished its task. Only satellites that then get a new one have decided something, and only
these decisions are learned from, by TorchRL's ``loss_mask_key``. Every satellite is credited with what it earns itself, from its
decision on, with a discount for elapsed time as in :mod:`~bsk_torch.rl.durations`. The critic of MAPPO (Yu et al.
2022, arXiv:2103.01955) observes all satellites, that of IPPO (de Witt et al. 2020, arXiv:2011.09533) one.

Every group of agents, one for each type of satellites, has its own actor, critic and optimizer. In MAPPO the critics
observe the satellites of all groups.
"""

from __future__ import annotations

import dataclasses
import logging
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch
from tensordict import TensorDict, TensorDictBase
from tensordict.nn import TensorDictModule, TensorDictModuleBase
from tensordict.utils import expand_as_right
from torch import Tensor
from torchrl.modules import ValueOperator
from torchrl.modules.value_norm import ValueNorm
from typing_extensions import override

from bsk_torch.env import ConstellationTasking, SatelliteTasking
from bsk_torch.env.agents import AGENTS
from bsk_torch.rl.evaluation.evaluate import Evaluation, evaluate
from bsk_torch.rl.marl.networks import ConstellationCritic, DecidingOnly
from bsk_torch.rl.networks.normaliser import CLOCK
from bsk_torch.rl.networks.plans import CLOCKS, AttentionPlan, Clocked, MLPPlan, Plan, actor_of
from bsk_torch.rl.networks.precision import float32_weights
from bsk_torch.rl.policies.files import save_policy
from bsk_torch.rl.policies.shared_policy import member_views, of_groups, shared
from bsk_torch.rl.rules.continuous import Bounds
from bsk_torch.rl.rules.targets import image_actions
from bsk_torch.rl.training.advantages import FINAL, final, standardize, write_advantages
from bsk_torch.rl.training.config import EVALUATE_EVERY, PPOConfig
from bsk_torch.rl.training.imitation import TAUGHT, taught
from bsk_torch.rl.training.ppo import REPORTED, Learner, averages, existing_keys
from bsk_torch.rl.training.trainer import VALIDATION, Training
from bsk_torch.sim.arguments.values import nearest

logger = logging.getLogger(__name__)

ALIVE, DECIDES = ("seen", "alive"), "decides"
"""Keys of masks [..., S] of satellites that are alive, and of those that decided."""

CRITIC_WIDTH = 32
"""Width of critics: all satellites are judged after every step, but few decide."""

LEARNED_FROM = ("seen", DECIDES, "action_mask", "action", "action_log_prob")
"""Keys of a batch that gradient steps need."""

CRITICS = ("mappo", "ippo")
"""Algorithms, by what their critics observe: all satellites, or the one that is judged."""


@dataclass(frozen=True)
class MAPPOConfig(PPOConfig):
    """Settings of a training of a constellation; the defaults differ from those for one satellite.

    A frame is a step of the constellation, in which about one satellite decides; ``lmbda`` is the decay per decision of a
    satellite. ``network`` and ``hidden`` are those of satellites that choose among targets; others learn with ``"mlp"``.

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

    @override
    def _default_interval(self) -> int:  # a step of a constellation takes longer
        return min(EVALUATE_EVERY // 5, super()._default_interval())

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.algorithm not in CRITICS:
            raise ValueError(f"algorithm={self.algorithm!r} must be one of {sorted(CRITICS)}; {nearest(self.algorithm, CRITICS)}")
        if self.network != "attention":
            raise ValueError(f"network={self.network!r}: constellations learn with 'attention'")


def deciding(agents: TensorDictBase) -> Tensor:
    """Return which agents of a group have to decide, [..., S]."""
    if "action_mask" in agents.keys():  # noqa: SIM118  - a tensordict
        return ~agents["action_mask"][..., -1]
    return agents["requires_retasking"].squeeze(-1)


def _actions(agents: TensorDictBase, decides: Tensor, bounds: Bounds) -> dict[str, Tensor]:
    """Return the actions of agents, and the mask of numbered ones; those that do not decide get one that they could take."""
    if bounds:
        middle = torch.tensor(bounds, dtype=agents["action"].dtype, device=decides.device).mean(-1)
        return {"action": torch.where(decides.unsqueeze(-1), agents["action"], middle)}
    legal = agents["action_mask"]
    first = torch.arange(legal.shape[-1] - 1, device=legal.device) == 0
    mask = torch.where(decides.unsqueeze(-1), legal[..., :-1], first)
    return {"action_mask": mask, "action": torch.where(decides, agents["action"], 0)}


def team_batch(batch: TensorDictBase, group: str = AGENTS, other_groups: Sequence[str] = (), bounds: Bounds = ()) -> TensorDict:
    """Return observations, actions and rewards [N, T, S, ...] of a group in a batch [N, T] without the level of the group.

    ``decides`` [N, T, S] marks satellites that had to decide; the others could only take the first action, and did. Under
    ``next``, ``done`` [N, T, 1] is the end of the episode, ``removed`` [N, T, S, 1] that of a satellite, by death or with the
    episode, and ``satellite_terminated`` [N, T, S, 1] an end after which nothing is expected: a death, or what
    :func:`~bsk_torch.rl.training.advantages.final` found, which is under ``next`` of ``batch``. What ``other_groups`` see is at
    ``("seen", "others", name)``. Real numbers as actions have ``bounds``, and no mask.
    """
    agents, following = batch[group], batch["next", group]
    decides = deciding(agents)
    parts = {
        "seen": _observations(batch, group, other_groups),
        DECIDES: decides,
        **_actions(agents, decides, bounds),
        "action_log_prob": agents["action_log_prob"],
        "next": {
            "seen": _observations(batch["next"], group, other_groups),
            "reward": following["reward"],
            "duration": following["duration"],
            "done": batch["next", "done"],
            "removed": batch["next", "done"].unsqueeze(-2) | ~following["mask"].unsqueeze(-1),
            "satellite_terminated": batch["next", FINAL].unsqueeze(-2) | ~following["mask"].unsqueeze(-1),
        },
    }
    return TensorDict(parts, batch.batch_size, names=[None, "time"], device=batch.device)


def _observations(situations: TensorDictBase, group: str, other_groups: Sequence[str] = ()) -> TensorDict:
    """Return the normalized observations of each agent [N, T, S], as a tensordict [N, T]."""
    agents = situations[group]
    parts = {**agents["seen"], "alive": agents["mask"]}
    if other_groups:
        parts["others"] = {name: _observations(situations, name) for name in other_groups}
    return TensorDict(parts, situations.batch_size)


def team_advantages(
    team: TensorDictBase, critic: ValueOperator, gamma: float, lmbda: float, value_norm: ValueNorm, reward_time: str = "end"
) -> None:
    """Write ``advantage`` and ``value_target`` [N, T, S, 1] of each satellite in semi-Markov time.

    Nothing is expected after a satellite's death. Both are standardized over decisions; those of satellites that did not decide
    have no meaning.

    Args:
        team: A batch by :func:`team_batch`.
        critic: Computes values of observations, at the root and under ``next``.
        gamma: Discount per second.
        lmbda: Decay of the estimator, per step.
        value_norm: Running mean and deviation of value targets, in which the critic gives values.
        reward_time: See :func:`~bsk_torch.rl.durations.rewards_at_start`.
    """
    write_advantages(
        team,
        critic,
        gamma,
        lmbda,
        reward_time,
        done="removed",
        terminated="satellite_terminated",
        value_norm=value_norm,
    )
    standardize(team, value_norm, team[DECIDES])


def group_plan(config: MAPPOConfig, view: SatelliteTasking) -> Plan:
    """Return how networks of a group are built: with attention where it chooses among targets of a set, else ``"mlp"``."""
    try:
        image_actions(view)
    except ValueError:
        return MLPPlan.of(view, config.hidden)
    if view.satellite.obs_type is not dict:
        logger.info(
            "%s observes targets in one vector: no attention; as_set=True and obs_type=dict make a set", view.satellite.name
        )
        return MLPPlan.of(view, config.hidden)
    return AttentionPlan.of(view, config.hidden)


def observed_sizes(plan: Plan) -> tuple[int, int]:
    """Return how many numbers a satellite observes of itself and of each target of a set; 0 for no set."""
    return (plan.n_own, plan.n_features) if isinstance(plan, AttentionPlan) else (plan.n_observed, 0)


class GroupLearner(Learner):
    """Actor and critic of all satellites of a group, and their optimizer."""

    config: MAPPOConfig

    def __init__(self, config: MAPPOConfig, env: ConstellationTasking, group: str) -> None:
        """Build new networks for a group of an environment; ValueError if it does not fit them."""
        views = member_views(env)
        super().__init__(config, views[group])
        self.group = group
        self.lmbda = config.lmbda ** (1.0 / env.fleet.size)
        sees_all = config.algorithm == "mappo"
        plans = {name: group_plan(config, view) for name, view in views.items() if sees_all and name != group}
        self.other_groups = list(plans)
        sizes = [observed_sizes(plan) for plan in plans.values()]
        n_own, n_features = observed_sizes(self.plan)
        with float32_weights():
            judge = Clocked(ConstellationCritic(n_own + CLOCKS, n_features, CRITIC_WIDTH, sees_all, sizes))
        keys = list(self.networks.normaliser.out_keys)
        parts = [("seen", "others", name, part) for name, plan in plans.items() for part in observed_parts(plan)]
        critic = ValueOperator(judge, in_keys=[*keys, ALIVE, *parts, CLOCK]).to(env.device)
        self.bounds: Bounds = getattr(self.plan, "bounds", ())
        parameters = self.networks.actor[0]  # of the distribution
        inputs, outputs = [*parameters.in_keys, DECIDES], parameters.out_keys
        acting = TensorDictModule(DecidingOnly(parameters.module), in_keys=inputs, out_keys=outputs)
        self._learn_by(actor_of(acting, self.bounds), critic)

    @override
    def make_plan(self, env: SatelliteTasking) -> Plan:
        return group_plan(self.config, env)

    @override
    def make_teacher(self, env: SatelliteTasking) -> TensorDictModuleBase | None:
        """Return the rule to imitate first; None without one, or, with a warning, for a group that it does not fit."""
        try:
            return super().make_teacher(env)
        except ValueError as error:
            logger.warning("%s; these satellites learn by themselves", error)
            return None

    @override
    def counts(self, sample: TensorDictBase) -> Tensor:
        return sample[DECIDES]

    def normalise(self, batch: TensorDictBase) -> None:
        """Write what is ``seen`` into the situations of a batch [N, T]."""
        for situations in (batch, batch["next"]):
            agents = self.networks.normaliser(situations[self.group])
            agents[CLOCK] = self.clock(situations).unsqueeze(-2).expand(*agents.batch_size, -1)

    def update_normaliser(self, batch: TensorDictBase) -> None:
        """Take the situations of a batch [N, T] in which a satellite decided into account."""
        agents = batch[self.group]
        self.networks.normaliser.update(agents.select("observation")[deciding(agents)])

    def learn(self, batch: TensorDictBase) -> dict[str, float]:
        """Several passes over a batch [N, T] of normalized situations; means of what the loss reports.

        ``decisions`` is the number of decisions learned from: 0, and nothing else is reported, where the satellites of
        the group were busy but for one decision at most, which has no standardized advantage.
        """
        team = team_batch(batch, self.group, self.other_groups, self.bounds)
        decisions = int(team[DECIDES].sum())
        if decisions < 2:
            return {"decisions": 0}
        if self.judges:
            team_advantages(team, self.critic, self.config.gamma, self.lmbda, self.value_norm, self.config.reward_time)
        if self.imitates:
            observation = batch[self.group, "observation"]
            legal = team["action_mask"] & team[DECIDES].unsqueeze(-1)  # none, and nothing to learn, for busy satellites
            lesson = taught(self.teacher, TensorDict({"observation": observation, "action_mask": legal}, team[DECIDES].shape))
            team[TAUGHT] = torch.where(expand_as_right(team[DECIDES], lesson), lesson, 0)
        keys = [*existing_keys(LEARNED_FROM, team), *self._further_keys()]
        samples = self._samples(team.select(*keys).reshape(-1))
        reports = [self._descend(sample) for sample in samples if bool(sample[DECIDES].any())]
        return averages(reports) | {"decisions": decisions} if reports else {"decisions": 0}


def observed_parts(plan: Plan) -> list[str]:
    """Return the names of what critics of other groups observe of a group."""
    return ["own", *(["rows", "mask"] if isinstance(plan, AttentionPlan) else []), "alive"]


class MAPPOLearner:
    """The learners of all groups of a constellation.

    Plans, networks and states of the only group are its own, and by the names of the groups where there are several.
    """

    recurrent = False

    def __init__(self, config: MAPPOConfig, env: ConstellationTasking) -> None:
        """Build new networks for an environment; ValueError if it does not fit them."""
        self.config = config
        self.groups = {group: GroupLearner(config, env, group) for group in member_views(env)}
        if config.imitate and all(group.teacher is None for group in self.groups.values()):
            raise ValueError(
                f"imitate={config.imitate!r} fits no satellite of {config.preset} with these options; imitate=null trains without"
            )

    @property
    def policy(self) -> TensorDictModuleBase:
        """The current policy for one satellite, or those of all groups; it continues to learn during training."""
        return of_groups({name: group.policy for name, group in self.groups.items()})

    def policy_state(self) -> dict[str, Any]:
        """Return the weights of the policies."""
        return joined({name: group.policy_state() for name, group in self.groups.items()})

    def load_policy_state(self, state: Mapping[str, object]) -> None:
        """Restore what :meth:`policy_state` returned."""
        for name, part in self._by_group(state).items():
            self.groups[name].load_policy_state(part)

    def save_policy(self, path: Path, training: Mapping[str, int | float]) -> None:
        """Write the file of the present policies, with what their ``training`` has cost."""
        plan, networks = (joined({name: getattr(g, what) for name, g in self.groups.items()}) for what in ("plan", "networks"))
        save_policy(path, plan, networks, self.config.preset, self.config.options, training)

    def anneal(self, fraction: float) -> None:
        """Set what depends on the used ``fraction`` of the budget, in all groups."""
        for group in self.groups.values():
            group.anneal(fraction)

    def state_dict(self) -> dict[str, Any]:
        """Networks, normalizers and optimizers."""
        return joined({name: group.state_dict() for name, group in self.groups.items()})

    def load_state_dict(self, state: Mapping[str, object]) -> None:
        """Restore what :meth:`state_dict` returned."""
        for name, part in self._by_group(state).items():
            self.groups[name].load_state_dict(part)

    def _by_group(self, state: Mapping[str, object]) -> Mapping[str, Any]:
        return {next(iter(self.groups)): state} if len(self.groups) == 1 else state

    def learn(self, batch: TensorDictBase) -> dict[str, float]:
        """Several passes over a batch [N, T] for each group; means over all decisions of what the losses report."""
        batch["next", FINAL] = final(batch, self.config.beyond_limit)
        for group in self.groups.values():  # critics observe all groups
            group.normalise(batch)
        reports = [group.learn(batch) for group in self.groups.values()]
        for group in self.groups.values():  # afterwards: networks learn from what they saw when they decided
            group.update_normaliser(batch)
        return mean_report(reports)


def joined(parts: Mapping[str, object]) -> Any:
    """Return the part of the only group, or the parts of several by name: files of one group name none."""
    return next(iter(parts.values())) if len(parts) == 1 else dict(parts)


def mean_report(reports: Sequence[Mapping[str, float]]) -> dict[str, float]:
    """Means over the decisions of all groups; nan where nothing was learned from."""
    learned = [report for report in reports if report["decisions"]]
    total = sum(report["decisions"] for report in learned)
    if not total:
        return dict.fromkeys(REPORTED, float("nan"))
    return {name: sum(report[name] * (report["decisions"] / total) for report in learned) for name in REPORTED}


class MAPPOTraining(Training):
    """A run in a constellation.

    The policy that it leaves is for one satellite where all are alike, and a ``GroupPolicies`` where there are several groups;
    see :mod:`~bsk_torch.rl.policies.shared_policy`.
    """

    config: MAPPOConfig
    env: Any  # a constellation, where the base class has one satellite
    _lost: Tensor | bool = False
    """Present episodes that have lost a satellite, [N]."""

    @override
    def make_learner(self) -> MAPPOLearner:
        return MAPPOLearner(self.config, self.env)

    @property
    @override
    def actor(self) -> TensorDictModuleBase:
        return shared(self.policy, self.env)

    @override
    def evaluate(self) -> Evaluation:
        return evaluate(self.actor, self.judge, seed=self.config.seed + VALIDATION)

    @override
    def rewards(self, batch: TensorDictBase) -> Tensor:
        return torch.stack([batch["next", group, "reward"].sum((-2, -1)) for group in self.learner.groups]).sum(0)

    @override
    def survived(self, batch: TensorDictBase) -> Tensor:
        """Return where all satellites have survived, [N, T]; a rewarder may end episodes in which none has died."""
        groups = self.learner.groups
        if not self.env.fleet.varies:
            return torch.stack([batch["next", group, "mask"].all(-1) for group in groups]).all(0)
        # masks of the absent are those of the dead, so that deaths show only when they happen
        died = torch.stack([(batch[group, "mask"] & ~batch["next", group, "mask"]).any(-1) for group in groups]).any(0)
        done, complete = batch["next", "done"].squeeze(-1), torch.ones_like(died)
        for step in range(died.shape[1]):
            self._lost = died[:, step] | self._lost
            complete[:, step] = ~self._lost
            self._lost = self._lost & ~done[:, step]
        return complete

    def fill(self, batch: TensorDictBase) -> None:
        """Satellites of a constellation are not followed one by one."""
