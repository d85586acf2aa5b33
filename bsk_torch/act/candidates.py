"""Base of actions that choose among candidates: targets, tasks, or peers."""

from __future__ import annotations

from collections.abc import Callable
from typing import ClassVar

import torch
from torch import Tensor
from typing_extensions import override

from bsk_torch.act.base import Action

SLEW = 40.0
"""Typical duration of a slew to a target, s; used only for the expected durations that sort rows."""

NO_TARGET = -1
"""Key of an action without a target, and of the state before the first action."""


class CandidateAction(Action):
    """Choose the k-th of ``n_actions`` candidates, of which there may be fewer. Subclasses define :meth:`candidates`.

    A place is the number of a candidate among all that there can be, such as the index of a target in the scenario.

    Attributes:
        aim: Name of the memory with the place chosen last, -1 before the first; empty for candidates other than targets.
        drawn: Name of a drawn value of all places, which actions -1, -2, ... choose by their index; empty for none of these.
    """

    aim: ClassVar[str] = ""
    drawn: ClassVar[str] = ""

    def candidates(self) -> tuple[Tensor, Tensor]:
        """Return the places of the candidates, and which candidates exist, [N, K] each."""
        raise NotImplementedError(f"{type(self).__name__} must implement candidates()")

    @property
    @override
    def n_negative_actions(self) -> int:
        return self.satellite.simulator.scenario_state[self.drawn].shape[1] if self.drawn else 0

    @property
    @override
    def target_actions(self) -> range:
        return range(self.n_actions if self.aim else 0)

    @override
    def aimed_at(self) -> Tensor | None:
        return self.satellite.simulator.memory[self.aim] if self.aim else None

    @override
    def offers(self) -> tuple[Tensor, Tensor] | None:
        if not self.aim:
            return None
        place, exists = self.candidates()
        return torch.where(exists, place, -1), torch.full_like(place, torch.nan, dtype=torch.float64)

    @override
    def mask(self) -> Tensor:
        return self.candidates()[1]

    def chosen(self, index: Tensor) -> tuple[Tensor, Tensor]:
        """Return the place of the candidate with the number ``index`` [N], and whether it exists, [N] each."""
        place, exists = (part.gather(1, index.unsqueeze(-1)).squeeze(-1) for part in self.candidates())
        return place, exists

    @staticmethod
    def keys(place: Tensor, first: int = 0) -> Tensor:
        """Return the keys of actions on places, or the places of keys: other actions have keys from 0 on, -1 is no target.

        Keys count the first place as number ``first``.
        """
        return (-2 - first) - place

    def remember(self, mask: Tensor, place: Tensor) -> None:
        """Store the ``place`` [N] where ``mask`` [N] holds as the one chosen last."""
        memory = self.satellite.simulator.memory
        memory[self.aim] = torch.where(mask, place, memory[self.aim])

    def refuse(self, rows: Tensor, place: Tensor, why: Callable[[int], str]) -> None:
        """Raise ValueError for the first of the ``rows`` [N] bool, whose actions chose a ``place`` [N] by its index."""
        if bool(rows.any()):
            row = int(torch.nonzero(rows)[0])
            number = int(place[row])
            raise ValueError(f"action {-1 - number} of {self.satellite.title(row)} selects target {number}, {why(number)}")
