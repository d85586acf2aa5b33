"""Base of actions, and how a satellite's list of them becomes one discrete space."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, NamedTuple, cast

import torch
from torch import Tensor

if TYPE_CHECKING:
    from bsk_torch.sats.satellite import Satellite


class Decision(NamedTuple):
    """What the actions of one step mean, [N] each: mode to enter, whether to enter it, and for how long, s."""

    mode: Tensor
    retask: Tensor
    duration: Tensor


class Table(NamedTuple):
    """What actions mean until the next reset: modes [N, A], and by action [A] the rest.

    That is whether a repeated action enters its mode anew, and for how long an action lasts, s.
    """

    mode: Tensor
    reset: Tensor
    duration: Tensor


class Action:
    """One entry of an ``action_spec``, standing for ``n_actions`` consecutive numbers of the discrete space."""

    n_actions: int = 1

    def __init__(self, name: str) -> None:
        """Name under which the entry appears in ``action_description``."""
        self.name = name

    def link_satellite(self, satellite: Satellite) -> None:
        """Called once when the environment is built; raises where the satellite cannot do this."""
        self.satellite = satellite

    def names(self) -> list[str]:
        """Names of the entry's actions."""
        return [self.name] if self.n_actions == 1 else [f"{self.name}_{k}" for k in range(self.n_actions)]

    def decide(self, index: Tensor, repeats: Tensor) -> Decision:
        """What action ``index`` [N] of this entry means; ``repeats`` [N] where it is also the previous action."""
        raise NotImplementedError(f"{type(self).__name__} must implement decide(index, repeats)")

    def table(self) -> Table | None:
        """What the entry's actions mean until the next reset, where nothing else decides that; else None."""
        return None

    def mask(self) -> Tensor:
        """Which of the entry's actions are legal now, [N, n_actions] booleans; all of them unless overridden."""
        ticks = self.satellite.simulator.ticks
        return torch.ones(len(ticks), self.n_actions, dtype=torch.bool, device=ticks.device)


class ActionBuilder:
    """The actions of a satellite, numbered in the order of its ``action_spec``."""

    def __init__(self, spec: Sequence[Action], satellite: Satellite) -> None:
        """Link every entry; ValueError for an empty or misused spec."""
        if not spec:
            raise ValueError(f"{type(satellite).__name__}.action_spec is empty; list at least one action, such as act.Charge()")
        for entry in spec:
            if not isinstance(entry, Action):
                raise ValueError(f"action_spec holds {entry!r}, which is no action; write act.Charge(), with parentheses")
            entry.link_satellite(satellite)
        self.entries, self.satellite = tuple(spec), satellite
        self._made, self._table = -1, cast("Table | None", None)

    def table(self) -> Table | None:
        """The tables of all entries side by side; None where one has none."""
        if self._made != self.satellite.simulator.draws:
            tables = [table for table in (entry.table() for entry in self.entries) if table is not None]
            whole = len(tables) == len(self.entries)
            self._table = Table(*(torch.cat(parts, -1) for parts in zip(*tables, strict=True))) if whole else None
            self._made = self.satellite.simulator.draws
        return self._table

    @property
    def n_actions(self) -> int:
        """Size of the discrete space."""
        return sum(entry.n_actions for entry in self.entries)

    @property
    def description(self) -> list[str]:
        """Names of all actions in order."""
        return [name for entry in self.entries for name in entry.names()]

    def decide(self, action: Tensor, previous: Tensor) -> Decision:
        """What ``action`` [N] means after ``previous`` [N] (-1: none)."""
        table = self.table()
        if table is not None:
            retask = (action != previous) | table.reset[action]
            return Decision(table.mode.gather(1, action.unsqueeze(1)).squeeze(1), retask, table.duration[action])
        decision = Decision(torch.zeros_like(action), torch.zeros_like(action, dtype=torch.bool), action.double())
        first = 0
        for entry in self.entries:
            mine = (action >= first) & (action < first + entry.n_actions)
            index = (action - first).clamp(0, entry.n_actions - 1)
            part = entry.decide(index, action == previous)
            decision = Decision(*(torch.where(mine, new, old) for new, old in zip(part, decision, strict=True)))
            first += entry.n_actions
        return decision

    def mask(self) -> Tensor:
        """Which actions are legal now, [N, n_actions]."""
        return torch.cat([entry.mask() for entry in self.entries], -1)
