"""What scenarios have computed for the current state."""

from __future__ import annotations

from collections.abc import Callable, Hashable
from typing import TYPE_CHECKING, TypeVar, cast

if TYPE_CHECKING:
    from bsk_torch.sats.fleet import SatelliteFleet

Value = TypeVar("Value")


class Found:
    """Results for the current state of the satellites and the memory of the episodes, each computed once."""

    def __init__(self) -> None:
        """Start without results."""
        self._results: dict[Hashable, tuple[tuple[int, ...], object]] = {}

    def once(self, name: Hashable, fleet: SatelliteFleet, find: Callable[[], Value], further: tuple[int, ...] = ()) -> Value:
        """Return what ``find`` returns, which is called only where the state is another than at the last call with ``name``.

        Args:
            name: Name of the result.
            fleet: The satellites.
            find: Computes the result.
            further: Versions of other tables that it depends on.
        """
        tables = [table for part in fleet.simulators for table in (part.state, part.memory)]
        key = (*(table.version for table in (*tables, fleet.memory)), *further)
        known = self._results.get(name)
        if known is None or known[0] != key:
            known = self._results[name] = (key, find())
        return cast(Value, known[1])
