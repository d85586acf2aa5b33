"""Filters of opportunities: functions that determine which places satellites may choose."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Collection
from typing import Any

import torch
from torch import Tensor

from bsk_torch.sats.opportunities import Viewer
from bsk_torch.sats.user_function import UserFunction
from bsk_torch.sim.names import nearest
from bsk_torch.sim.places import TARGET_KIND, is_target

Filter = Callable[[], Tensor] | Callable[[Any], Any]
"""Function that returns the places that remain, [N, P] booleans: without arguments, or of :class:`AllPlaces`."""

ADVICE = (
    "write a function without arguments that returns booleans [N, P], such as lambda: env.scenario.priority > 0.5, or keep to "
    "comparisons of opportunity['object'].priority, .id and the like, joined by & and |"
)

WINDOWS = "filters select places, regardless of the window; legal_actions() of the satellite forbids actions"


class AllPlaces:
    """All places of a type, the argument of a filter: ``["object"]``, ``["type"]`` and ``["r_LP_P"]`` [N, P, 3] m."""

    def __init__(self, satellite: Viewer, kind: str) -> None:
        """Describe all places of type ``kind``."""
        rows = len(satellite.simulator.ticks)
        self._satellite, self._kind = satellite, kind
        self._place = torch.arange(satellite.places(kind), device=satellite.simulator.device).expand(rows, -1)
        self.differs = False  # whether something has been read that differs between places

    def __getitem__(self, key: str) -> Any:
        if key == "type":
            return self._kind
        self.differs = True
        if key == "object":
            return self._satellite.objects(self._kind, self._place)
        if key == "r_LP_P":
            return self._satellite.positions(self._kind, self._place)
        if key == "window":
            raise KeyError(f"opportunity['window'] is not known to a filter: {WINDOWS}")
        raise KeyError(f"opportunities have no {key!r}; {nearest(key, ('object', 'type', 'r_LP_P'))}")


class AccessFilter:
    """A filter that is added to a satellite.

    Attributes:
        functions: The user's function of an opportunity, for each type to which it has been applied.
    """

    def __init__(self, function: Filter, types: tuple[str, ...] | None, takes_opportunity: bool) -> None:
        """Filter ``types``, or all if None."""
        self.function: Any = function
        self.types, self.takes_opportunity = types, takes_opportunity
        self.functions: dict[str, UserFunction] = {}

    def bound(self, kinds: Collection[str]) -> AccessFilter:
        """Return a filter for the satellites of an environment, which have opportunities of several ``kinds``."""
        copied = AccessFilter(self.function, self.types, self.takes_opportunity)
        if copied.takes_opportunity:
            copied.functions = {kind: copied.user_function() for kind in kinds if copied.concerns(kind)}
        return copied

    def user_function(self) -> UserFunction:
        """Return the function for a type of opportunities."""
        return UserFunction(f"the access filter {self.function!r}", ADVICE)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, AccessFilter) and (self.function, self.types) == (other.function, other.types)

    def __hash__(self) -> int:
        return hash((self.function, self.types))

    def concerns(self, kind: str) -> bool:
        """Return whether opportunities of a type are filtered; all instruments have the same targets."""
        return self.types is None or kind in self.types or (is_target(kind) and TARGET_KIND in self.types)

    def __call__(self, satellite: Viewer, kind: str) -> Tensor:
        """Return the places of a type that remain, [N, P] booleans."""
        if not self.takes_opportunity:
            return self.function()
        if kind not in self.functions:
            self.functions[kind] = self.user_function()
        rows, places, device = len(satellite.simulator.ticks), satellite.places(kind), satellite.simulator.device

        def call() -> object:
            everywhere = AllPlaces(satellite, kind)
            remain = self.function(everywhere)
            same = isinstance(remain, bool) and not everywhere.differs
            return torch.full((rows, places), remain, device=device) if same else remain

        remain = self.functions[kind]((rows, places), device, call)
        if remain.shape != (rows, places):
            raise TypeError(f"{self.functions[kind].title} gives shape {list(remain.shape)}; it must be [{rows}, {places}]")
        return remain.bool()


def make_filter(function: object, types: str | Collection[str] | None) -> AccessFilter:
    """Return a filter from a function; TypeError for anything else."""
    kinds = (types,) if isinstance(types, str) else None if types is None else tuple(types)
    if not callable(function):
        raise TypeError(f"access filter {function!r} must be a function without arguments, or of all places")
    if _takes_one(function):
        return AccessFilter(function, kinds, True)
    return AccessFilter(function, kinds or (TARGET_KIND,), False)


def _takes_one(function: Callable[..., object]) -> bool:
    """Return whether a function wants an argument; TypeError if it wants several."""
    try:
        signature = inspect.signature(function)
    except (TypeError, ValueError):
        return True
    for count in (0, 1):
        try:
            signature.bind(*[None] * count)
        except TypeError:
            continue
        return count == 1
    name = getattr(function, "__qualname__", type(function).__name__)
    raise TypeError(f"access filter {name}{signature} must take all places of a type, or nothing")
