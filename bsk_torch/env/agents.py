"""Agents of a constellation: the satellites commanded by each agent, and groups of agents that share tensors."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import torch
from torch import Tensor

from bsk_torch.sim.names import name_fault, nearest, snake

AGENTS = "agents"
"""Name of the only group."""

ROOT = (
    *("observation", "action", "action_mask", "reward", "done", "terminated", "truncated", "duration"),
    *("counts", "state", "next"),
)
"""Names not allowed for groups."""


@dataclass(frozen=True)
class Group:
    """A agents with equal spaces: each commands M satellites, the m-th of which is of type ``types[m]``."""

    name: str  # key of the group
    agents: tuple[str, ...]  # names of the agents
    members: Tensor  # indices of their satellites among all, [A, M]
    types: tuple[int, ...]  # type of each of the M members
    within: tuple[Tensor, ...]  # indices of the members within their types, M tensors [A]
    whole: tuple[bool, ...]  # for each of the M members, whether they are all satellites of their type, in order
    alone: bool  # whether the agents are all satellites of an episode, in order, one each

    def to(self, device: torch.device) -> Group:
        """Return the group with its tensors on a device."""
        return replace(self, members=self.members.to(device), within=tuple(index.to(device) for index in self.within))

    @property
    def is_meta(self) -> bool:
        """Whether each agent commands several satellites."""
        return len(self.types) > 1

    def of_members(self, table: Tensor) -> Tensor:
        """Return values [N, S] of the satellites for the members of each agent, [N, A, M]."""
        return table.unsqueeze(-1) if self.alone else table[:, self.members]


def agents_of(names: Sequence[str], groupings: Mapping[str, Sequence[str]] | None) -> dict[str, list[str]]:
    """Return the satellites of every agent: first those of ``groupings``, then one agent for each other satellite."""
    agents: dict[str, list[str]] = {}
    taken: dict[str, str] = {}
    if groupings is not None and not isinstance(groupings, Mapping):
        raise ValueError(f"meta_agent_groupings={groupings!r} must be a dictionary, such as {{'pair': ['EO0', 'EO1']}}")
    for agent, members in (groupings or {}).items():
        if not isinstance(agent, str) or (fault := name_fault(agent)):
            raise ValueError(f"meta_agent_groupings: agent {agent!r} {fault if isinstance(agent, str) else 'must be a string'}")
        if isinstance(members, str) or not members:
            raise ValueError(f"meta_agent_groupings[{agent!r}]={members!r} must be a list of at least one satellite's name")
        for member in members:
            if member not in names:
                raise ValueError(
                    f"meta_agent_groupings[{agent!r}] has {member!r}, which is not a satellite; {nearest(member, names)}"
                )
            if member in taken:
                raise ValueError(f"meta_agent_groupings: satellite {member!r} belongs to {taken[member]!r} and to {agent!r}")
            taken[member] = agent
        agents[agent] = list(members)
    others = [name for name in names if name not in taken]
    if twice := sorted(set(others) & set(agents)):
        raise ValueError(
            f"meta_agent_groupings: {twice} are names of satellites that belong to no agent; give agents other names"
        )
    return agents | {name: [name] for name in others}


def make_groups(
    agents: Mapping[str, Sequence[str]],
    names: Sequence[str],
    types: Sequence[Sequence[int]],
    titles: Sequence[str],
    group_map: Mapping[str, Sequence[str]] | None = None,
) -> list[Group]:
    """Return the groups of agents with equal spaces: agents by type unless ``group_map`` names them.

    ``agents`` are the satellites of each agent, ``types`` the indices of the satellites of each type, ``titles`` their names.
    """
    place = {names[column]: (t, k) for t, columns in enumerate(types) for k, column in enumerate(columns)}
    signature = {agent: tuple(place[member][0] for member in members) for agent, members in agents.items()}
    if group_map is None:
        kinds: dict[tuple[int, ...], list[str]] = {}
        for agent, kind in signature.items():
            kinds.setdefault(kind, []).append(agent)
        group_map = named(kinds, titles)
    check_map(group_map, signature)
    groups = []
    for name, chosen in group_map.items():
        table = [[place[member] for member in agents[agent]] for agent in chosen]
        members = torch.tensor([[names.index(member) for member in agents[agent]] for agent in chosen])
        within = tuple(torch.tensor([row[m][1] for row in table]) for m in range(members.shape[1]))
        kind = signature[chosen[0]]
        whole = tuple(index.tolist() == list(range(len(types[t]))) for t, index in zip(kind, within, strict=True))
        alone = members.tolist() == [[k] for k in range(len(names))]
        groups.append(Group(name, tuple(chosen), members, kind, within, whole, alone))
    return groups


def named(kinds: Mapping[tuple[int, ...], list[str]], titles: Sequence[str]) -> dict[str, list[str]]:
    """Return groups by name: the type's, or the names of the types of its members."""
    if len(kinds) == 1:
        return {AGENTS: next(iter(kinds.values()))}
    groups: dict[str, list[str]] = {}
    for kind, agents in kinds.items():
        base = name = "_and_".join(snake(titles[t]) for t in kind)
        number = 1
        while name in groups or name in ROOT:
            number += 1
            name = f"{base}_{number}"
        groups[name] = agents
    return groups


def check_map(group_map: Mapping[str, Sequence[str]], signature: Mapping[str, tuple[int, ...]]) -> None:
    """Raise ValueError unless the map assigns each agent to one group of agents with equal spaces."""
    if not isinstance(group_map, Mapping) or not all(isinstance(name, str) for name in group_map):
        raise ValueError(f"group_map={group_map!r} must be a dictionary, such as {{'imagers': ['EO0', 'EO1']}}")
    listed = [agent for agents in group_map.values() for agent in agents]
    for agent in listed:
        if agent not in signature:
            raise ValueError(f"group_map has {agent!r}, which is not an agent; {nearest(agent, signature)}")
    if twice := sorted({agent for agent in listed if listed.count(agent) > 1}):
        raise ValueError(f"group_map has {twice} more than once")
    if missing := [agent for agent in signature if agent not in listed]:
        raise ValueError(f"group_map lacks {missing}; every agent needs a group")
    for name, agents in group_map.items():
        if not agents or name in ROOT or name.startswith("_"):
            raise ValueError(
                f"group_map[{name!r}]={list(agents)} is empty, or its name is one of {list(ROOT)}, or begins with an underscore"
            )
        other = next((agent for agent in agents if signature[agent] != signature[agents[0]]), None)
        if other is not None:
            raise ValueError(
                f"group_map[{name!r}] puts {agents[0]!r} and {other!r} together, whose satellites are of different types"
            )
