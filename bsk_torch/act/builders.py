"""Action spaces of satellites' ``action_spec``: discrete actions, or one continuous entry."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import torch
from torch import Tensor

from bsk_torch._checks import no_gradient
from bsk_torch.act.base import ActionBuilder, ActionTable, Decision, check_decision, checked_durations
from bsk_torch.act.continuous import ContinuousAction, HybridAction, is_continuous
from bsk_torch.sats.bound import BoundSatellite, link_entry
from bsk_torch.sim.hooks import check_tensor, overrides
from bsk_torch.sim.state import StateTable

LARGEST = torch.finfo(torch.float64).max


def action_builder(spec: Sequence[Any], satellite: BoundSatellite) -> ActionBuilder | ContinuousBuilder:
    """Return the action space of an ``action_spec``."""
    title = f"{type(satellite).__name__}.action_spec"
    if not spec:
        raise ValueError(f"{title} is empty; list at least one action, such as act.Charge()")
    continuous = [entry for entry in spec if is_continuous(entry)]
    if not continuous:
        return ActionBuilder(spec, satellite)
    if len(spec) > 1:
        names = ", ".join(type(entry).__name__ for entry in spec)
        raise ValueError(
            f"{title} = [{names}] has {continuous[0].name!r}, whose actions are real numbers, with other entries; it must be "
            "the only one. An act.HybridAction has real numbers and a choice"
        )
    return ContinuousBuilder(continuous[0], satellite)


class ContinuousBuilder:
    """The action space of a satellite type with continuous actions.

    Internally, actions are [N, A] float64, or [N, A + 1] with the number of the choice last.

    Attributes:
        low: Lowest values, [A] float64.
        high: Highest values, [A] float64.
        n_actions: Number K of choices; 0 without a choice.
        some_legal: False: masks may be empty.
    """

    n_negative_actions = 0
    some_legal = False

    def __init__(self, entry: ContinuousAction, satellite: BoundSatellite) -> None:
        """Link the entry to the satellite."""
        self.entries, self.entry, self.satellite = (entry,), entry, satellite
        link_entry(entry, satellite)
        ticks = satellite.simulator.ticks
        self.low, self.high = (side.to(ticks.device) for side in _bounds(entry))
        self.names = _names(entry, "names", len(self.low))
        self.choices = _names(entry, "choices") if isinstance(entry, HybridAction) else []
        self.n_actions = len(self.choices)
        self._all_legal = torch.ones_like(ticks, dtype=torch.bool).unsqueeze(1).expand(-1, self.n_actions)
        self._masking = entry if isinstance(entry, HybridAction) and overrides(entry, HybridAction, "mask") else None

    @property
    def is_hybrid(self) -> bool:
        """Whether there is a choice in addition to the real numbers."""
        return bool(self.choices)

    @property
    def width(self) -> int:
        """Numbers of an action, including its choice."""
        return len(self.low) + self.is_hybrid

    @property
    def description(self) -> list[str]:
        """Names of the real numbers, followed by those of the choices."""
        return [*self.names, *self.choices]

    def title(self, action: Tensor) -> str:
        """Return the name of an action [A] or [A + 1]: its numbers and its choice."""
        pairs = zip(self.names, action.tolist(), strict=False)
        values = ", ".join(f"{name} {value:.6g}" for name, value in pairs)
        return f"{self.choices[int(action[-1])]}, {values}" if self.is_hybrid else values

    def entry_of(self, action: object) -> int:
        """Return the number of the only entry."""
        return 0

    def table(self) -> ActionTable:
        """There is none; TypeError."""
        raise TypeError(f"{self.entry.name!r} is continuous and has no table")

    def declare(self, task: StateTable) -> None:
        """Declare the actions in progress in the table of tasks."""
        task.declare("action", 0.0, self.width, low=-LARGEST, high=LARGEST)

    def checked(self, action: Tensor, acts: Tensor | None) -> Tensor:
        """Return actions [N, A] or [N, A + 1] as float64, 0 if they are ignored, and store their dtype in the entry."""
        self.entry.given_dtype, action = action.dtype, action.to(torch.float64, copy=True)
        action = action if acts is None else torch.where(acts.unsqueeze(-1), action, 0.0)
        wrong = ~torch.isfinite(action)
        if bool(wrong.any()):
            row, column = torch.nonzero(wrong)[0].tolist()
            name = [*self.names, "choice"][column]
            raise ValueError(
                f"action of {self.satellite.title(row)} has {name}={float(action[row, column])}; all its numbers must be finite"
            )
        if self.is_hybrid:
            self._check_choice(action[:, -1])
        return action

    def _check_choice(self, choice: Tensor) -> None:
        wrong = (choice < 0) | (choice >= self.n_actions) | (choice != choice.floor())
        if bool(wrong.any()):
            row = int(torch.nonzero(wrong)[0])
            names = ", ".join(f"{k}: {name}" for k, name in enumerate(self.choices))
            raise ValueError(f"choice {float(choice[row]):g} of {self.satellite.title(row)} is out of range; legal are {names}")

    @property
    def hears_ends(self) -> bool:
        """Whether :meth:`end` does anything."""
        return overrides(self.entry, ContinuousAction, "end")

    def decide(self, action: Tensor, previous: Tensor, acts: Tensor) -> Decision:
        """Return the commands of ``action`` [N, A] where ``acts`` [N] bool; those of other rows are undefined."""
        title, decision = type(self.entry).__name__, self.entry.decide(action, acts)
        check_decision(title, decision, len(action))
        return checked_durations(title, decision, acts, self.satellite)

    def begin(self, action: Tensor, acts: Tensor, decision: Decision) -> None:
        """Notify the entry that its actions have been commanded in the rows ``acts`` [N] bool."""
        self.entry.begin(acts, decision)

    def end(self, action: Tensor, ended: Tensor, decision: Decision, event: Tensor) -> None:
        """Notify the entry that its actions have ``ended`` [N] bool, by an ``event`` [N] bool or by their duration."""
        self.entry.end(ended, decision._replace(command=action), event)

    def mask(self) -> Tensor:
        """Return which choices are legal now, [N, K] bool; TypeError for a mask of wrong shape or dtype."""
        if self._masking is None:
            return self._all_legal
        mask = self._masking.mask()
        check_tensor(f"{type(self.entry).__name__}.mask()", mask, self._all_legal.shape, torch.bool)
        return mask


def _bounds(entry: ContinuousAction) -> tuple[Tensor, Tensor]:
    """Return the bounds of an entry, [A] float64 each; ValueError if invalid."""
    title, given = f"{type(entry).__name__}.bounds()", entry.bounds()
    if not isinstance(given, tuple | list) or len(given) != 2:
        raise ValueError(f"{title} returns {given!r}; it must return the lower and upper bounds")
    no_gradient(title, given)
    try:
        low, high = (torch.as_tensor(side, dtype=torch.float64).cpu() for side in given)
    except (TypeError, ValueError) as error:
        raise ValueError(f"{title} returns {given!r}; they must be numbers: {error}") from error
    if low.ndim != 1 or low.shape != high.shape or not len(low):
        raise ValueError(f"{title} returns bounds of shapes {list(low.shape)} and {list(high.shape)}; both must be [A]")
    if not bool((low < high).all()):
        raise ValueError(f"{title} returns {low.tolist()} and {high.tolist()}; each lower bound must be below the upper")
    return low, high


def _names(entry: object, hook: str, count: int | None = None) -> list[str]:
    """Return the names from a hook of an entry; ValueError unless they are ``count`` strings, at least one."""
    names = getattr(entry, hook)()
    wrong = isinstance(names, str) or not all(isinstance(name, str) for name in names) or not names
    if wrong or count not in (None, len(names)):
        many = "at least one name" if count is None else f"{count} names, one for each number of bounds()"
        raise ValueError(f"{type(entry).__name__}.{hook}() returns {names!r}; it must return {many}")
    return list(names)
