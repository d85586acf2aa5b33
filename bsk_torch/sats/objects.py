"""Objects of opportunities: the targets of all satellites, with attributes [N, n], and names of other places."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from torch import Tensor

if TYPE_CHECKING:
    from bsk_torch.sats.bound_access import BoundAccessSatellite


def target_names(satellite: BoundAccessSatellite, env: int) -> Sequence[str]:
    """Return the name of every target of an environment."""
    return satellite.scenario.names(env)


class TargetObjects:
    """Targets of opportunities [N, n]. Attributes are tensors [N, n] or [N, n, ...].

    They have ``r_LP_P``, ``priority``, ``id``, ``name``, and what else :meth:`bsk_torch.scene.TargetScenario.target_attribute`
    finds.
    """

    def __init__(self, satellite: BoundAccessSatellite, place: Tensor) -> None:
        """Describe the targets ``place`` [N, n] of the satellites of a type."""
        self._satellite, self.id = satellite, place

    id: Tensor
    """Index of each target in its environment, [N, n]."""

    @property
    def name(self) -> np.ndarray[Any, Any]:
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


def names_of(satellite: BoundAccessSatellite, kind: str) -> Sequence[str]:
    """Return the names of all places of a kind but targets; the objects of stations are their names."""
    places = satellite.access_windows.kinds[kind]
    return places.names or [f"{kind}-{k}" for k in range(places.count)]


def place_names(satellite: BoundAccessSatellite, kind: str, place: Tensor) -> np.ndarray[Any, Any]:
    """Return the names of places [N, n] of a kind, an array of strings."""
    return np.array(names_of(satellite, kind), dtype=object)[place.cpu().numpy()]
