"""Policies of constellations: one for all satellites of a group, each of which decides by what it observes itself."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from typing import cast

import torch
from tensordict import NestedKey, TensorDictBase
from tensordict.nn import TensorDictModuleBase, TensorDictSequential
from torchrl.data import Binary, Composite

from bsk_torch.env import NO_ACTION, ConstellationTasking, SatelliteTasking, Tasking
from bsk_torch.env.agents import AGENTS, Group
from bsk_torch.env.satellite_group import SatelliteGroup
from bsk_torch.rl.rules.baselines import BASELINES, random_policy
from bsk_torch.sim.arguments.values import nearest

TRAINED_WITH = "make it with the options that the policy was trained with, which read_card(file)['options'] lists"
"""What to do about a policy that reads what an environment does not have."""


@dataclass(frozen=True)
class MemberView:
    """The attributes of an environment of one satellite, for one satellite of a constellation."""

    satellite: SatelliteGroup
    observation_spec: Composite
    device: torch.device


def member_views(env: Tasking) -> dict[str, SatelliteTasking]:
    """Return a constellation as the satellites of each group meet it, by the names of the groups.

    Networks and rules are built for these. An environment of one satellite is returned itself, as the only group.

    Raises:
        ValueError: Unless every satellite of a constellation is a separate agent.
    """
    if not isinstance(env, ConstellationTasking):
        return {AGENTS: cast(SatelliteTasking, env)}
    if env.joint or any(group.is_meta for group in env.groups):
        raise ValueError(f"each satellite must be a separate agent; the groups are {dict(env.group_map)}")
    return {group.name: _view(env, group) for group in env.groups}


def _view(env: ConstellationTasking, group: Group) -> SatelliteTasking:
    seen, satellite = env.observation_spec[group.name][:, 0], env.satellites[group.types[0]]
    n = satellite.actions.n_actions
    parts = {"observation": seen["observation"]}
    if n:
        parts["action_mask"] = Binary(n, shape=(*seen.shape, n), dtype=torch.bool, device=env.device)  # without that to continue
    spec = Composite(parts, shape=seen.shape, device=env.device)
    return cast(SatelliteTasking, MemberView(satellite, spec, env.device))


def member_view(env: Tasking) -> SatelliteTasking:
    """Return an environment as one of its satellites meets it, where all of them are alike; see :func:`member_views`.

    Raises:
        ValueError: Unless the satellites of a constellation are alike, and each is a separate agent.
    """
    views = member_views(env)
    if len(views) > 1:
        raise ValueError(f"satellites must be alike; the groups are {', '.join(views)}")
    return next(iter(views.values()))


def check_reads(policy: object, spec: Composite, hint: str = TRAINED_WITH) -> None:
    """ValueError, which ends with ``hint``, for observations that a policy reads by their names and ``spec`` does not have."""
    known = {_path(key) for key in spec.keys(include_nested=True)}
    for path in (_path(key) for key in getattr(policy, "in_keys", ())):
        if "observation" in path and path not in known:
            raise ValueError(f"the policy reads {'.'.join(path)}, which this environment does not have; {hint}")


def _path(key: NestedKey) -> tuple[str, ...]:
    return key if isinstance(key, tuple) else (key,)


class SharedPolicy(TensorDictModuleBase):
    """Applies a policy for one satellite to all satellites of a group that need a task; busy and dead ones continue."""

    def __init__(self, policy: TensorDictModuleBase, group: str = AGENTS) -> None:
        """Wrap ``policy``, which writes ``action`` into tensordicts [B] with ``observation`` and ``action_mask``.

        Policies whose actions are real numbers, [B, A], find no mask; satellites that need no task get ``NO_ACTION``.

        The actions of the ``group``, [N, S], and their log-probabilities if the policy returns these, are ``out_keys``.
        """
        super().__init__()
        self.policy, self.group = policy, group
        decides = "action_mask" if "action_mask" in policy.in_keys else "requires_retasking"
        self.in_keys = [(group, "observation"), (group, decides)]
        self.log_prob_key = (group, "action_log_prob") if "action_log_prob" in policy.out_keys else None
        self.out_keys = [(group, "action"), *([] if self.log_prob_key is None else [self.log_prob_key])]

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Write ``out_keys``; the log-probability is 0 for satellites that continue."""
        if (self.group, "action_mask") not in tensordict.keys(include_nested=True):
            return self._write_real(tensordict)
        seen = tensordict[self.group].select("observation", "action_mask")
        legal = seen["action_mask"]
        decides = ~legal[..., -1]
        action = torch.full(decides.shape, legal.shape[-1] - 1, device=legal.device)
        log_prob = torch.zeros(decides.shape, dtype=torch.float32, device=legal.device)
        if bool(decides.any()):  # after the longest step, all may still be busy
            deciding = seen[decides]
            deciding["action_mask"] = deciding["action_mask"][..., :-1]
            decided = self.policy(deciding)
            action[decides] = decided["action"]
            if self.log_prob_key is not None:
                log_prob[decides] = decided["action_log_prob"]
        tensordict.set((self.group, "action"), action)
        return tensordict if self.log_prob_key is None else tensordict.set(self.log_prob_key, log_prob)

    def _write_real(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Write actions of real numbers, [N, S, A]; all satellites are asked, for those that decide."""
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
    """Return the policy of the only group, which is one for one satellite, or :class:`GroupPolicies` of several."""
    return next(iter(policies.values())) if len(policies) == 1 else GroupPolicies(policies)


def shared(policy: TensorDictModuleBase, env: Tasking) -> TensorDictModuleBase:
    """Return a policy as it acts in ``env``.

    That is itself for one satellite, :class:`SharedPolicy` in a constellation of satellites that are alike, and itself where it
    is a :class:`GroupPolicies`. ValueError for policies of other groups, of one satellite in a constellation of unlike ones, or
    that read observations which the environment does not have.
    """
    views = member_views(env)
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
    """Return ``change`` of a policy and of what it is for in ``env``, or of each of :class:`GroupPolicies`."""
    if not isinstance(policy, GroupPolicies):
        return change(policy, member_view(env))
    views = member_views(env)
    return GroupPolicies({group: change(part, views[group]) for group, part in policy.policies.items()})


def baseline(name: str, env: Tasking, seed: int = 0) -> TensorDictModuleBase:
    """Return one of the ``BASELINES`` for one satellite of ``env``, or for one of each group.

    Groups that the rule does not fit, such as relays where it is about targets, act at random, alongside one that it does fit.

    Raises:
        KeyError, ValueError: If the rule fits no group, or there is none of that name.
    """
    rule, views = BASELINES[name], member_views(env)
    found: dict[str, TensorDictModuleBase] = {}
    errors: list[Exception] = []
    for k, (group, view) in enumerate(views.items()):
        try:
            found[group] = rule(view, seed + k)
        except (KeyError, ValueError) as error:
            errors.append(error)
            found[group] = random_policy(view, seed + k)
    if len(errors) == len(views):
        raise errors[0]
    return of_groups(found)


def rule(name: str, env: Tasking, seed: int = 0) -> TensorDictModuleBase:
    """Return a rule, or random actions, as a policy for every satellite of ``env``: a single one or a constellation.

    ==================  ==================================================================================================
    name                what the satellite must have
    ==================  ==================================================================================================
    ``random``          legal actions with equal probability; real numbers need finite bounds
    ``rule``            the observations and actions of ``NadirScan-v1``
    ``greedy``          ``act.Image``, and ``priority`` of the targets in ``obs.OpportunityProperties``
    ``nearest``         ``act.Image``, and targets in ``obs.OpportunityProperties``
    ``hasty``           likewise, with ``priority``, ``target_angle``, ``opportunity_open`` and ``opportunity_close``
    ``drift``           the observations and actions of ``RSOInspection-v1`` and ``MultiInspection-v1``
    ``circumnavigate``  the same
    ``survey``          the same
    ==================  ==================================================================================================

    Groups of a constellation that the rule does not fit act at random, alongside one that it does fit.

    Args:
        name: One of ``bsk_torch.rl.rules.baselines.BASELINES``.
        env: The environment in which the policy will act.
        seed: Seed of random actions.

    Raises:
        KeyError: If the rule reads an observation that no group has; the message names it.
        ValueError: For an unknown name, or actions that the rule cannot choose.
    """
    if name not in BASELINES:
        raise ValueError(f"name={name!r} is not a rule; {nearest(name, BASELINES)}")
    return shared(baseline(name, env, seed), env)


def shared_baselines(env: Tasking, seed: int = 0) -> dict[str, TensorDictModuleBase]:
    """Return the ``BASELINES`` that fit an environment, for every satellite, by name; see :func:`baseline`."""
    fitting = {}
    for name in BASELINES:
        with suppress(KeyError, ValueError):  # a rule for other observations or actions
            fitting[name] = rule(name, env, seed)
    return fitting
