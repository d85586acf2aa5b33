"""Base of actions, and how a satellite's list of them becomes one discrete space."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, NamedTuple, cast

import torch
from torch import Tensor

if TYPE_CHECKING:
    from bsk_torch.sats.satellite import Satellite


class Decision(NamedTuple):
    """What the actions of one step mean, [N] each.

    Attributes:
        mode: Mode to enter.
        retask: Whether to enter it.
        duration: For how long, s.
        key: What the action is remembered by: an action with the same key repeats it.
        expected: About how long it will last, s, if an event may end it.
    """

    mode: Tensor
    retask: Tensor
    duration: Tensor
    key: Tensor
    expected: Tensor


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
    satellite: Any

    def __init__(self, name: str) -> None:
        """Name under which the entry appears in ``action_description``."""
        self.name = name

    def link_satellite(self, satellite: Satellite) -> None:
        """Called once when the environment is built; raises where the satellite cannot do this."""
        self.satellite = satellite

    @property
    def explicit(self) -> int:
        """Number of negative actions, -1 downwards, that the entry understands beside its own."""
        return 0

    def names(self) -> list[str]:
        """Names of the entry's actions."""
        return [self.name] if self.n_actions == 1 else [f"{self.name}_{k}" for k in range(self.n_actions)]

    def decide(self, index: Tensor, mine: Tensor, action: Tensor, previous: Tensor) -> Decision:
        """What the entry makes of its actions.

        Args:
            index: Number within the entry, [N].
            mine: Where the action is one of the entry's, [N]; elsewhere the answer is not looked at.
            action: Number in the whole space, [N].
            previous: Key of the previous action, [N]; -1 for none.
        """
        raise NotImplementedError(f"{type(self).__name__} must implement decide(index, mine, action, previous)")

    def begin(self, rows: Tensor, decision: Decision) -> None:
        """Called where the entry has been decided for, ``rows`` [N], once its mode has been entered."""

    def end(self, rows: Tensor, decision: Decision, event: Tensor) -> None:
        """Called where the entry's actions ended within the episode, ``rows`` [N]; ``event`` [N] where an event ended them."""

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

    @property
    def explicit(self) -> int:
        """Number of negative actions that are legal beside the discrete space."""
        return max(entry.explicit for entry in self.entries)

    def shares(self, action: Tensor) -> list[tuple[Action, Tensor, Tensor]]:
        """Entries, which actions are theirs, and their numbers within the entry; negative ones go to the first that has them."""
        shares, first = [], 0
        negative = action < 0
        for entry in self.entries:
            mine = (action >= first) & (action < first + entry.n_actions)
            if entry.explicit:
                mine, negative = mine | negative, torch.zeros_like(negative)
            shares.append((entry, mine, (action - first).clamp(0, entry.n_actions - 1)))
            first += entry.n_actions
        return shares

    def decide(self, action: Tensor, previous: Tensor, moves: Tensor) -> Decision:
        """What ``action`` [N] means, where it ``moves`` [N] anything, after the action with key ``previous`` [N] (-1: none)."""
        table = self.table()
        if table is not None:
            retask = (action != previous) | table.reset[action]
            duration = table.duration[action]
            return Decision(table.mode.gather(1, action.unsqueeze(1)).squeeze(1), retask, duration, action, duration)
        seconds = action.double()
        decision = Decision(torch.zeros_like(action), torch.zeros_like(action, dtype=torch.bool), seconds, action, seconds)
        for entry, mine, index in self.shares(action):
            part = entry.decide(index, mine & moves, action, previous)
            decision = Decision(*(torch.where(mine, new, old) for new, old in zip(part, decision, strict=True)))
        return decision

    def begin(self, action: Tensor, moves: Tensor, decision: Decision) -> None:
        """Tell the entries what has been decided, where ``moves`` [N] is true."""
        if self.table() is None:
            for entry, mine, _ in self.shares(action):
                entry.begin(mine & moves, decision)

    def end(self, action: Tensor, ended: Tensor, decision: Decision, event: Tensor) -> None:
        """Tell the entries where their actions ``ended`` [N], and where that was by an ``event`` [N]."""
        if self.table() is None:
            for entry, mine, _ in self.shares(action):
                entry.end(mine & ended, decision, event)

    def mask(self) -> Tensor:
        """Which actions are legal now, [N, n_actions]."""
        return torch.cat([entry.mask() for entry in self.entries], -1)
