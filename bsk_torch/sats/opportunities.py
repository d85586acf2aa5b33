"""Opportunities of all satellites of a type, windows of places in the order in which they close, and their objects."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple, Protocol

import numpy as np
import torch
from torch import Tensor

from bsk_torch.sim.access.windows.search import AccessWindows
from bsk_torch.sim.names import nearest
from bsk_torch.sim.simulator import Simulator


class Viewer(Protocol):
    """Satellites of one type that see places: what filters, opportunities and their objects read of them."""

    simulator: Simulator
    scenario: Any
    access_windows: AccessWindows

    def places(self, type: str) -> int:
        """Return the number of places of a type."""

    def positions(self, type: str, place: Tensor) -> Tensor:
        """Return the current Earth-fixed positions, [N, n, 3] m, of places [N, n] of a type."""

    def objects(self, type: str, place: Tensor) -> object:
        """Return the objects of places [N, n]: :class:`TargetObjects`, else names [N, n]."""


class _Opportunities(NamedTuple):
    open: Tensor
    close: Tensor
    place: Tensor
    r_LP_P: Tensor
    found: Tensor


class Opportunities(_Opportunities):
    """The next opportunities, sorted by closing time.

    If there are fewer than n, the last one is repeated. Items are also read by name:
    ``opportunities["object"]``, the targets with ``r_LP_P``, ``priority``, ``id``, ``name`` and values drawn by the scenario
    (:class:`TargetObjects`), or an array [N, n] of the names of stations; ``["window"]``, opening and closing time, s since
    reset, [N, n] each; ``["r_LP_P"]``, [N, n, 3] m; ``["type"]``.

    Attributes:
        open: Opening time, [N, n] s since reset.
        close: Closing time, [N, n] s since reset.
        place: Index of the place among those of its type, [N, n].
        r_LP_P: Earth-fixed positions, [N, n, 3] m.
        found: Number of opportunities without repetitions, [N].
        satellite: The satellites.
        type: Type of the opportunities.
    """

    satellite: Viewer
    type: str

    def of(self, satellite: Viewer, type: str) -> Opportunities:
        """Say whose opportunities of which type these are."""
        self.satellite, self.type = satellite, type
        return self

    def __getitem__(self, key: Any) -> Any:
        if not isinstance(key, str):
            return super().__getitem__(key)
        if key == "window":
            return self.open, self.close
        if key == "r_LP_P":
            return self.r_LP_P
        if key == "type":
            return self.type
        if key == "object":
            return self.satellite.objects(self.type, self.place)
        raise KeyError(f"opportunities have no {key!r}; {nearest(key, ('object', 'window', 'type', 'r_LP_P'))}")

    @property
    def mid(self) -> Tensor:
        """Middle of the window, [N, n] s since reset."""
        return 0.5 * (self.open + self.close)

    @property
    def mask(self) -> Tensor:
        """False for repetitions of the last opportunity, [N, n]."""
        return torch.arange(self.place.shape[1], device=self.place.device) < self.found.unsqueeze(-1)


def target_names(satellite: Viewer, env: int) -> Sequence[str]:
    """Return the name of every target of an environment."""
    return satellite.scenario.names(env)


class TargetObjects:
    """Targets of opportunities [N, n]. Attributes are tensors [N, n] or [N, n, ...].

    They have ``r_LP_P``, ``priority``, ``id``, ``name``, and what else :meth:`bsk_torch.scene.TargetScenario.target_attribute`
    finds.
    """

    def __init__(self, satellite: Viewer, place: Tensor) -> None:
        """Describe the targets ``place`` [N, n] of the satellites of a type."""
        self._satellite, self.id = satellite, place

    id: Tensor
    """Index of each target in its environment, [N, n]."""

    @property
    def name(self) -> np.ndarray:
        """Name of each target, [N, n] strings."""
        count = self._satellite.simulator.count
        rows = enumerate(self.id.tolist())
        return np.array([[target_names(self._satellite, row // count)[k] for k in places] for row, places in rows], dtype=object)

    __hash__ = None  # type: ignore[assignment]

    def __eq__(self, other: object) -> bool:
        raise TypeError("these are targets of all satellites; compare their index: opportunity['object'].id == ...")

    def __getattr__(self, name: str) -> Tensor:
        if name.startswith("_"):
            raise AttributeError(name)
        return self._satellite.simulator.look_up(self._satellite.scenario.target_attribute(name), self.id)


def names_of(satellite: Viewer, kind: str) -> Sequence[str]:
    """Return the names of all places of a kind but targets; the objects of stations are their names."""
    places = satellite.access_windows.kinds[kind]
    return places.names or [f"{kind}-{k}" for k in range(places.count)]


def place_names(satellite: Viewer, kind: str, place: Tensor) -> np.ndarray:
    """Return the names of places [N, n] of a kind, an array of strings."""
    return np.array(names_of(satellite, kind), dtype=object)[place.cpu().numpy()]
