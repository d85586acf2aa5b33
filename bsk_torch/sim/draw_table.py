"""Draws of a scenario, of which copies of the same episode share one."""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor
from typing_extensions import override

from bsk_torch.sim.state import StateTable, owned

SHARED_FROM = 2  # copies of each episode, on average, from which draws are stored once per episode


class DrawTable(StateTable):
    """Draws of a scenario, [N, ...] each; filled with copies of few episodes, it stores the draws of each episode once.

    The branches of a planner are hundreds of copies of a few episodes. Draws, such as the positions of thousands of targets,
    are most of the state. Reading a draw by its name stores it with a row for each episode again, which may be written into;
    :meth:`shared` does not.
    """

    @override
    def __init__(self, num_envs: int, count: int = 1, device: torch.device | str = "cpu") -> None:
        super().__init__(num_envs, count, device)
        attributes: dict[str, object] = self.__dict__
        attributes["_once"], attributes["_owner"] = {}, None

    def shared(self, name: str) -> tuple[Tensor, Tensor | None]:
        """Return a draw [K, ...], and the row of it that belongs to each episode, [N]; None if row k belongs to episode k."""
        return (self._once[name], self._owner) if name not in self.__dict__ and name in self.fields else (self[name], None)

    def of_envs(self, name: str, envs: Tensor) -> Tensor:
        """Return a draw of the episodes ``envs`` [...], [..., ...]."""
        value, owner = self.shared(name)
        return value[envs if owner is None else owner[envs]]

    def look_up(self, name: str, place: Tensor) -> Tensor:
        """Return the entries [N, n] of a draw [N, P] for places [N, n]."""
        value, owner = self.shared(name)
        return value.gather(1, place) if owner is None else value[owner.unsqueeze(-1), place]

    def __getattr__(self, name: str) -> Any:
        """Return a draw stored once per episode, from now on with a row for each episode; see :class:`StateTable`."""
        once = self.__dict__.get("_once", {})
        if name not in once:
            return super().__getattr__(name)
        value = self.__dict__[name] = owned(once[name][self._owner])
        self.__dict__["_once"] = {other: once[other] for other in once if other != name}
        return value

    @override
    def copy_rows(self, envs: Tensor, other: StateTable, source: Tensor) -> None:
        few, owner = source.unique(return_inverse=True)
        if not isinstance(other, DrawTable) or len(envs) < self.num_envs or SHARED_FROM * len(few) > self.num_envs:
            super().copy_rows(envs, other, source)
            return
        attributes: dict[str, object] = self.__dict__
        attributes["_once"] = {name: owned(other.of_envs(name, few)) for name in self.fields}
        attributes["_owner"] = owned(torch.empty_like(owner).index_copy(0, envs, owner))
        for name in self.fields:
            attributes.pop(name, None)
        self.touch()
