"""Policies for constellations: one policy for all satellites of a group, each acting on its own observations."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import cast

import torch
from tensordict import NestedKey, TensorDictBase
from tensordict.nn import TensorDictModuleBase, TensorDictSequential
from torchrl.data import Binary, Composite

from bsk_torch._rooms import Entries
from bsk_torch.env import NO_ACTION, ConstellationTasking, SatelliteTasking, Tasking
from bsk_torch.env.agents import AGENTS, Group
from bsk_torch.env.satellite_group import SatelliteGroup
from bsk_torch.rl.rules.baselines import BASELINES, TeamPolicy, random_policy
from bsk_torch.sim.arguments.values import nearest
from bsk_torch.wrappers.policies import Actor, WholePolicy, policy_of_one

TRAINED_WITH = "make it with the options that the policy was trained with, which read_card(file)['options'] lists"
"""Advice for a policy that reads observations missing in the environment."""


TOGETHER: Entries[Callable[[Tasking], TeamPolicy]] = Entries(
    {
        "local": "bsk_torch.tasks.objects.team_rules:local",
        "centralized": "bsk_torch.tasks.objects.team_rules:centralized",
        "nearest_task": "bsk_torch.tasks.aeos_bench.rules:nearest_task",
    }
)
"""Rules that decide for all satellites of an environment."""

RULES = (*BASELINES, *TOGETHER)
"""Names of all rules, for single satellites and for teams."""


@dataclass(frozen=True)
class MemberView:
    """Attributes of a single-satellite environment, for one satellite of a constellation."""

    satellite: SatelliteGroup
    observation_spec: Composite
    device: torch.device


def member_views(env: Tasking) -> dict[str, SatelliteTasking]:
    """Return views of a constellation for one satellite of each group, by the names of the groups.

    Networks and rules are built for these views. A single-satellite environment is itself the view of its only group.

    ValueError unless every satellite of a constellation is a separate agent.
    """
    if not isinstance(env, ConstellationTasking):
        return {AGENTS: cast(SatelliteTasking, env)}
    if env.joint or any(group.is_meta for group in env.groups):
        raise ValueError(f"each satellite must be a separate agent; the groups are {dict(env.group_map)}")
    return {group.name: _view(env, group) for group in env.groups}


def _view(env: ConstellationTasking, group: Group) -> SatelliteTasking:
    member, satellite = env.observation_spec[group.name][:, 0], env.satellites[group.types[0]]
    n = satellite.actions.n_actions
    parts = {"observation": member["observation"]}
    if n:
        parts["action_mask"] = Binary(
            n, shape=(*member.shape, n), dtype=torch.bool, device=env.device
        )  # without that to continue
    spec = Composite(parts, shape=member.shape, device=env.device)
    return cast(SatelliteTasking, MemberView(satellite, spec, env.device))


def member_view(env: Tasking) -> SatelliteTasking:
    """Return the view for one satellite of an environment with a single group; see :func:`member_views`.

    ValueError unless the satellites of a constellation form one group, and each is a separate agent.
    """
    views = member_views(env)
    if len(views) > 1:
        raise ValueError(f"satellites must be alike; the groups are {', '.join(views)}")
    return next(iter(views.values()))


def check_reads(policy: object, spec: Composite, hint: str = TRAINED_WITH) -> None:
    """Raise ValueError, ending with ``hint``, if a policy reads observations by name that are missing in ``spec``."""
    paths = {_path(key) for key in spec.keys(include_nested=True)}
    for path in (_path(key) for key in getattr(policy, "in_keys", ())):
        if "observation" in path and path not in paths:
            raise ValueError(f"the policy reads {'.'.join(path)}, which this environment does not have; {hint}")


def _path(key: NestedKey) -> tuple[str, ...]:
    return key if isinstance(key, tuple) else (key,)


class SharedPolicy(TensorDictModuleBase):
    """Applies a policy for one satellite to all satellites of a group that need a task; busy and dead ones continue."""

    def __init__(self, policy: TensorDictModuleBase, group: str = AGENTS) -> None:
        """Wrap ``policy``, which writes ``action`` into tensordicts [B] with ``observation`` and ``action_mask``.

        For continuous actions, [B, A], there is no mask; satellites that need no task get ``NO_ACTION``.

        ``out_keys`` are the actions of the ``group``, [N, S], and their log-probabilities if the policy returns these.

        ValueError for a recurrent policy, whose memory would be lost between the decisions of each satellite.
        """
        super().__init__()
        if any(isinstance(key, tuple) and key[0] == "next" for key in policy.out_keys):
            raise ValueError("the policy keeps a memory, which a constellation does not pass on; train with 'attention'")
        self.policy, self.group = policy, group
        decides = "action_mask" if "action_mask" in policy.in_keys else "requires_retasking"
        self.in_keys = [(group, "observation"), (group, decides)]
        self.log_prob_key = (group, "action_log_prob") if "action_log_prob" in policy.out_keys else None
        self.out_keys = [(group, "action"), *([] if self.log_prob_key is None else [self.log_prob_key])]

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Write ``out_keys``; the log-probability is 0 for satellites that continue."""
        if (self.group, "action_mask") not in tensordict.keys(include_nested=True):
            return self._write_real(tensordict)
        situations = tensordict[self.group].select("observation", "action_mask", *self.policy.in_keys, strict=False)
        legal = situations["action_mask"]
        decides = ~legal[..., -1]
        action = torch.full(decides.shape, legal.shape[-1] - 1, device=legal.device)
        log_prob = torch.zeros(decides.shape, dtype=torch.float32, device=legal.device)
        if bool(decides.any()):  # after the longest step, all may still be busy
            deciding = situations[decides]
            deciding["action_mask"] = deciding["action_mask"][..., :-1]
            decided = self.policy(deciding)
            action[decides] = decided["action"]
            if self.log_prob_key is not None:
                log_prob[decides] = decided["action_log_prob"]
        tensordict.set((self.group, "action"), action)
        return tensordict if self.log_prob_key is None else tensordict.set(self.log_prob_key, log_prob)

    def _write_real(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Write continuous actions, [N, S, A]; the policy acts for all satellites, and its actions are used for deciding ones."""
        agents = tensordict[self.group]
        decides = agents["requires_retasking"].squeeze(-1)
        decided = self.policy(agents.select("observation").flatten())
        action = decided["action"].unflatten(0, decides.shape)
        tensordict.set((self.group, "action"), torch.where(decides.unsqueeze(-1), action, float(NO_ACTION)))
        if self.log_prob_key is None:
            return tensordict
        log_prob = decided["action_log_prob"].unflatten(0, decides.shape)
        return tensordict.set(self.log_prob_key, torch.where(decides, log_prob, 0.0))


class GroupPolicies(TensorDictSequential):
    """The policies of all groups of a constellation, each applied to the satellites of its group."""

    def __init__(self, policies: Mapping[str, TensorDictModuleBase]) -> None:
        """Apply the ``policies`` for one satellite, by the names of the groups, as :class:`SharedPolicy` does."""
        super().__init__(*(SharedPolicy(policy, group) for group, policy in policies.items()))

    @property
    def policies(self) -> dict[str, TensorDictModuleBase]:
        """The policies for one satellite by the names of the groups."""
        return {part.group: part.policy for part in self.module}


def of_groups(policies: Mapping[str, TensorDictModuleBase]) -> TensorDictModuleBase:
    """Return the single-satellite policy of the only group, or :class:`GroupPolicies` for several groups."""
    return next(iter(policies.values())) if len(policies) == 1 else GroupPolicies(policies)


def as_policy(actor: Actor | str | Path, env: Tasking) -> TensorDictModuleBase:
    """Return what chooses actions as a policy for all satellites of ``env``.

    A module of tensordicts is returned unchanged. In a constellation with one group, others act for each satellite; see
    :func:`~bsk_torch.wrappers.policies.policy_of_one` for what they may be, and :func:`shared` for errors. Text names a
    policy, see :func:`~bsk_torch.load_policy`.
    """
    if isinstance(actor, str | Path):
        from bsk_torch.rl.policies.loading import load_policy

        return load_policy(actor, env)
    return actor if isinstance(actor, TensorDictModuleBase) else shared(actor, env)


def shared(policy: Actor, env: Tasking) -> TensorDictModuleBase:
    """Return a policy of one satellite, see :func:`~bsk_torch.wrappers.policies.policy_of_one`, for all satellites of ``env``.

    The result is the policy itself for one satellite, for a :class:`GroupPolicies` or a
    :class:`~bsk_torch.rl.rules.baselines.TeamPolicy`, and a :class:`SharedPolicy` in a
    constellation with one group. ValueError for policies of other groups, a single-satellite policy in a constellation of several
    groups, or a policy that reads observations missing in the environment.
    """
    if isinstance(policy, TeamPolicy):
        return policy
    views = member_views(env)
    if not isinstance(policy, TensorDictModuleBase):
        policy = policy_of_one(policy, member_view(env).satellite)
    if isinstance(policy, WholePolicy):
        return policy
    if isinstance(policy, GroupPolicies):
        if policy.policies.keys() != views.keys():
            raise ValueError(f"the policies are for groups {', '.join(policy.policies)}; the environment has {', '.join(views)}")
        for group, part in policy.policies.items():
            check_reads(part, views[group].observation_spec)
        return policy
    check_reads(policy, member_view(env).observation_spec)
    return policy if isinstance(env, SatelliteTasking) else SharedPolicy(policy, next(iter(views)))


def for_each_group(
    change: Callable[[TensorDictModuleBase, SatelliteTasking], TensorDictModuleBase], policy: TensorDictModuleBase, env: Tasking
) -> TensorDictModuleBase:
    """Return ``change(policy, view)`` for the view of ``env``, or for each policy of :class:`GroupPolicies`.

    ValueError for a policy that decides for all satellites at once.
    """
    if isinstance(policy, TeamPolicy):
        raise ValueError("the rule decides for all satellites at once; choose a policy of one satellite")
    if not isinstance(policy, GroupPolicies):
        return change(policy, member_view(env))
    views = member_views(env)
    return GroupPolicies({group: change(part, views[group]) for group, part in policy.policies.items()})


def baseline(name: str, env: Tasking, seed: int = 0) -> TensorDictModuleBase:
    """Return one of the ``BASELINES`` for one satellite of ``env``, or for one of each group, or one of :data:`TOGETHER` for all.

    Groups to which it does not apply act at random; see :func:`baseline_of_groups`.

    KeyError or ValueError if the rule applies to no group, or for an unknown name.
    """
    if name in TOGETHER:
        return TOGETHER[name](env)
    return baseline_of_groups(BASELINES[name], env, seed)


def baseline_of_groups(
    rule: Callable[[SatelliteTasking, int], TensorDictModuleBase], env: Tasking, seed: int = 0
) -> TensorDictModuleBase:
    """Return ``rule(view, seed)`` for one satellite of ``env``, or for one of each group, with another seed for each.

    If the rule applies to some groups only, the others act at random, such as relays with a rule for imaging.

    KeyError or ValueError if the rule applies to no group.
    """
    views = member_views(env)
    policies: dict[str, TensorDictModuleBase] = {}
    errors: list[Exception] = []
    for k, (group, view) in enumerate(views.items()):
        try:
            policies[group] = rule(view, seed + k)
        except (KeyError, ValueError) as error:
            errors.append(error)
            policies[group] = random_policy(view, seed + k)
    if len(errors) == len(views):
        raise errors[0]
    return of_groups(policies)


def fitting_baseline(name: str, env: Tasking, seed: int = 0, where: str = "this environment") -> TensorDictModuleBase:
    """Return a :func:`baseline`; if it does not apply to ``env``, called ``where``, ValueError with the rules that do."""
    try:
        return baseline(name, env, seed)
    except (KeyError, ValueError) as error:
        fitting = ", ".join(shared_baselines(env))
        raise ValueError(f"the policy {name!r} does not fit {where}: {error.args[0]}. Baselines that fit: {fitting}") from error


def rule(name: str, env: Tasking, seed: int = 0) -> TensorDictModuleBase:
    """Return a rule or the random policy for all satellites of ``env``, a single one or a constellation.

    ========================  ==================================================================================================
    name                      requirements
    ========================  ==================================================================================================
    ``random``                legal actions with equal probability; real numbers need finite bounds
    ``rule``                  the observations and actions of ``NadirScan-v1``
    ``cautious``              the same
    ``science``               the observations and actions of ``NadirScience-v1``
    ``areas``                 the observations and actions of ``Areas-v1`` and ``AreasTeam-v1``
    ``commit``                the observations and actions of ``Sites-v1``, ``SitesTeam-v1`` and ``TipAndCue-v1``
    ``greedy``                ``act.Image``, and ``priority`` of the targets in ``obs.OpportunityProperties``
    ``nearest``               ``act.Image``, and targets in ``obs.OpportunityProperties``
    ``hasty``                 likewise, with ``priority``, ``target_angle``, ``opportunity_open`` and ``opportunity_close``
    ``farsighted``            likewise, and ``r_LB_H``
    ``cooperative``           the observations and actions of ``HeteroCluster-v1``
    ``drift``                 the observations and actions of ``RSOInspection-v1`` and ``MultiInspection-v1``
    ``circumnavigate``        the same
    ``survey``                the same
    ``hurried_survey``        the same: prefers short transfers, for episodes of one to two orbits
    ``glide``                 the observations and actions of ``CWDocking-v1``
    ``seek``                  the observations and actions of ``CWInspection-v1``
    ``angle``                 those of ``Services-v1``: image the object of the catalog that needs the smallest turn
    ``priority_angle``        the same: the object with the smallest ratio of turn and priority
    ``distance``              the same: the nearest object
    ``candidate_priority``    the same: the observed candidate of the highest priority
    ``rate``                  the same: the lit object of the catalog that brings the most priority per second
    ``candidate_rate``        the same among the observed candidates
    ``rate_ahead``            like ``rate``, with the duration, light and sight expected for the end of the image
    ``candidate_rate_ahead``  likewise among the observed candidates, with ``outlook=True`` of ``Services-v1``
    ``prompt``                like ``candidate_rate`` in sight only, for teams with ``as_set=True``; waits by desaturating
    ``prompt_ahead``          the same with what is expected for the end of the image, with ``outlook=True``
    ``local``                 those of ``ThreeSensors-v1`` and ``Walker4-v1``: each imager decides by what it knows
    ``centralized``           the same: the best joint choice, which needs ``information="ideal"`` to be one of the team
    ``nearest_task``          those of ``AEOSBench-v1``: the benchmark's greedy rule, which needs ``sensor="on"`` to be that
    ``soonest_task``          the same with ``candidates=True``: satellites share the tasks, each taking what it completes first
    ========================  ==================================================================================================

    If the rule applies to some groups of a constellation only, the others act at random.

    Args:
        name: One of :data:`RULES`.
        env: The environment in which the policy will act.
        seed: Seed of random actions.

    Raises:
        ValueError: For an unknown name, or a rule that reads observations or chooses actions missing in all groups; the message
            lists the rules that fit.
    """
    if name not in RULES:
        hint = nearest(name, RULES)
        fitting = f"those of this environment: {', '.join(shared_baselines(env))}"
        raise ValueError(f"name={name!r} is not a rule; {hint if hint.startswith('did you mean') else fitting}")
    return shared(fitting_baseline(name, env, seed), env)


def shared_baselines(env: Tasking, seed: int = 0) -> dict[str, TensorDictModuleBase]:
    """Return the applicable :data:`RULES` for all satellites of an environment, by name; see :func:`baseline`."""
    fitting = {}
    for name in RULES:
        with suppress(KeyError, ValueError):  # a rule for other observations or actions
            fitting[name] = shared(baseline(name, env, seed), env)
    return fitting
