"""Table of the agents of an environment, a common interface for planners to single satellites and constellations."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import torch
from tensordict import TensorDict, TensorDictBase
from torch import Tensor

from bsk_torch.env import ConstellationTasking, Tasking
from bsk_torch.env.action_forms import form
from bsk_torch.rl.policies.shared_policy import member_views
from bsk_torch.rl.rules.continuous import Bounds, bounds_of

NO_AGENT = -1
"""Index used when no agent decides."""


class AgentTable:
    """The S agents of each episode, in the order of their groups; a single-satellite environment has one.

    Attributes:
        groups: Names of the groups; None for the root, in a single-satellite environment.
        sizes: Number of agents of each group.
        n_actions: Number of discrete actions of each group, 0 for continuous actions.
        bounds: Bounds of the continuous actions of each group.
        most_actions: Largest number of actions A.
        most_numbers: Largest length of a continuous action W.
    """

    def __init__(self, env: Tasking) -> None:
        """Read the agents of an environment; ValueError unless satellites are separate agents and bounds are finite."""
        views = member_views(env)
        self.groups: list[str | None] = list(views) if isinstance(env, ConstellationTasking) else [None]
        self.sizes = [len(env.group_map[name]) for name in views] if isinstance(env, ConstellationTasking) else [1]
        self.size = sum(self.sizes)
        self.first = [sum(self.sizes[:k]) for k in range(len(self.sizes))]
        self.n_actions = [view.satellite.actions.n_actions for view in views.values()]
        self.real = [form(view.satellite) is not None for view in views.values()]
        self.bounds: list[Bounds] = [
            bounds_of(view) if real else () for view, real in zip(views.values(), self.real, strict=True)
        ]
        self.titles = [view.satellite.name for view in views.values()]
        self.most_actions, self.most_numbers = max(self.n_actions), max(map(len, self.bounds))

    @property
    def acting(self) -> list[str]:
        """Names of the groups whose agents have a choice; of all groups if there are none."""
        kinds = zip(self.titles, self.real, self.n_actions, strict=True)
        return [title for title, real, n in kinds if real or n > 1] or self.titles

    def of(self, chosen: Sequence[bool], device: Any) -> Tensor:
        """Return which agents belong to the ``chosen`` groups, [S] booleans."""
        flags = [flag for flag, size in zip(chosen, self.sizes, strict=True) for _ in range(size)]
        return torch.tensor(flags, device=device)

    # -- reading ------------------------------------------------------------------------------------------------------

    def deciding(self, td: TensorDictBase) -> Tensor:
        """Return the agents that need a task in episodes that have not ended, [N, S]."""
        alive = ~td["done"]
        if self.groups == [None]:
            return alive.clone()
        parts = [td[group, "requires_retasking"].squeeze(-1) & td[group, "mask"] for group in self.groups]
        return torch.cat(parts, 1) & alive

    def legal(self, td: TensorDictBase) -> Tensor:
        """Return the legal actions of every agent, [N, S, A]; all False for continuous actions."""
        parts = []
        for group, size, n in zip(self.groups, self.sizes, self.n_actions, strict=True):
            if n and group is None:
                mask = td["action_mask"].unsqueeze(1)
            elif n:
                mask = td[group, "action_mask"][..., :n]
            else:
                mask = torch.zeros(*td.batch_size, size, 0, dtype=torch.bool, device=td.device)
            parts.append(torch.nn.functional.pad(mask, (0, self.most_actions - mask.shape[-1])))
        return torch.cat(parts, 1)

    def chosen(self, td: TensorDictBase) -> Tensor:
        """Return the discrete actions in ``td``, [N, S]; 0 for continuous actions."""
        parts = []
        for group, size, real in zip(self.groups, self.sizes, self.real, strict=True):
            action = self._action(td, group)
            parts.append(torch.zeros(*td.batch_size, size, dtype=torch.int64, device=td.device) if real else action)
        return torch.cat(parts, 1)

    def numbers(self, td: TensorDictBase) -> Tensor:
        """Return the continuous actions in ``td``, [N, S, W], padded with 0; 0 for discrete actions."""
        parts = []
        for group, size, real in zip(self.groups, self.sizes, self.real, strict=True):
            if real:
                action = self._action(td, group)
                parts.append(torch.nn.functional.pad(action, (0, self.most_numbers - action.shape[-1])))
            else:
                parts.append(torch.zeros(*td.batch_size, size, self.most_numbers, dtype=torch.float32, device=td.device))
        return torch.cat(parts, 1)

    @staticmethod
    def at(table: Tensor, slot: Tensor) -> Tensor:
        """Return the entries of a table [n, S, ...] for one agent per row, ``slot`` [n]; NO_AGENT selects the first agent."""
        return table[torch.arange(len(slot), device=slot.device), slot.clamp(min=0)]

    def _action(self, td: TensorDictBase, group: str | None) -> Tensor:
        return td["action"].unsqueeze(1) if group is None else td[group, "action"]

    # -- writing ------------------------------------------------------------------------------------------------------

    def actions(self, td: TensorDictBase) -> TensorDict:
        """Return copies of the actions in ``td``."""
        parts: dict[Any, Any] = {}
        for group in self.groups:
            parts |= {"action": td["action"].clone()} if group is None else {(group, "action"): td[group, "action"].clone()}
        return TensorDict(parts, td.batch_size, device=td.device)

    def put(self, td: TensorDictBase, slot: Tensor, value: Tensor, where: Tensor | None = None) -> None:
        """Write the action ``value`` of the agent ``slot`` [N] of each row, discrete [N] or continuous [N, W].

        Rows where ``where`` [N] is false, or the slot is NO_AGENT, remain unchanged.
        """
        for group, first, size, bounds in zip(self.groups, self.first, self.sizes, self.bounds, strict=True):
            old = self._action(td, group)
            here = slot.unsqueeze(1) == first + torch.arange(size, device=slot.device)
            here = here if where is None else here & where.unsqueeze(1)
            if value.ndim == 1 and not bounds:
                new = torch.where(here, value.unsqueeze(1).to(old.dtype), old)
            elif value.ndim == 2 and bounds:
                new = torch.where(here.unsqueeze(-1), value[:, : len(bounds)].unsqueeze(1).to(old.dtype), old)
            else:
                continue
            td.set("action" if group is None else (group, "action"), new.squeeze(1) if group is None else new)

    def play(self, env: Tasking, td: TensorDictBase, moves: Tensor) -> TensorDictBase:
        """Execute the actions in ``td`` where ``moves`` [N] is true; return the entries of ``next``."""
        if self.groups == [None]:
            return env.play(td["action"], moves)
        return env.play([td[group, "action"] for group in self.groups], moves)

    def neutral(self, td: TensorDictBase) -> None:
        """Write the first legal action of every agent, or the continuous action nearest to zero."""
        for group, bounds in zip(self.groups, self.bounds, strict=True):
            at = td if group is None else td[group]
            if bounds:
                low, high = torch.tensor(bounds, dtype=torch.float32, device=td.device).unbind(1)
                at["action"] = torch.zeros_like(low).clamp(low, high).expand(*at.batch_size, -1).clone()
            else:
                at["action"] = at["action_mask"].long().argmax(-1)
