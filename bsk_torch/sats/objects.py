"""Objects of opportunities, targets and ground stations, with the attributes that bsk_rl's have.

``TargetObjects`` are the targets of opportunities of all satellites, with attributes [N, n]; a :class:`OneTarget` is one target
of one environment. Both have ``r_LP_P``, ``priority``, ``id``, ``name``, and what else
:meth:`bsk_torch.scene.TargetScenario.target_attribute` finds.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from torch import Tensor

from bsk_torch.sats.one import of_row

if TYPE_CHECKING:
    from bsk_torch.sats.bound_access import BoundAccessSatellite


def target_names(satellite: BoundAccessSatellite, env: int) -> Sequence[str]:
    """Return the name of every target of an environment."""
    return satellite.scenario.names(env)


class TargetObjects:
    """Targets of opportunities [N, n]. Attributes are tensors [N, n] or [N, n, ...]; see the module."""

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
        """Raise TypeError: several targets are neither equal to one nor a member of a list."""
        raise TypeError("these are targets of all satellites; compare their index: opportunity['object'].id == ...")

    def __getattr__(self, name: str) -> Tensor:
        """Return a value of the targets, [N, n, ...]; AttributeError for an unknown name."""
        if name.startswith("_"):
            raise AttributeError(name)
        return self._satellite.simulator.look_up(self._satellite.scenario.target_attribute(name), self.id)


def names_of(satellite: BoundAccessSatellite, kind: str) -> Sequence[str]:
    """Return the names of all places of a kind but targets; bsk_rl's objects of stations are their names, too."""
    places = satellite.access_windows.kinds[kind]
    return places.names or [f"{kind}-{k}" for k in range(places.count)]


def place_names(satellite: BoundAccessSatellite, kind: str, place: Tensor) -> np.ndarray[Any, Any]:
    """Return the names of places [N, n] of a kind, an array of strings."""
    return np.array(names_of(satellite, kind), dtype=object)[place.cpu().numpy()]


class OneTarget:
    """A target of one environment; equal to others of the same environment and index.

    Attributes:
        id: Index among the targets of the environment; ``act.image_target(id)`` is the action that images it.
    """

    def __init__(self, satellite: BoundAccessSatellite, env: int, index: int) -> None:
        """Describe target number ``index`` of an environment."""
        self._satellite, self._env, self.id = satellite, env, index

    @property
    def name(self) -> str:
        """Name of the target."""
        return target_names(self._satellite, self._env)[self.id]

    def __getattr__(self, name: str) -> Any:
        """Return a value of the target, a number or a NumPy array, or an attribute of the object that the scenario made for it.

        AttributeError for an unknown name.
        """
        if name.startswith("_"):
            raise AttributeError(name)
        try:
            return of_row(self._satellite.scenario.target_attribute(name)[self._env], self.id)
        except AttributeError:
            made = getattr(self._satellite.scenario, "target_object", None)
            if made is None or not hasattr(target := made(self._env, self.id), name):
                raise
            return getattr(target, name)

    @property
    def _place(self) -> tuple[int, int]:
        """Environment and index, by which targets are compared."""
        return self._env, self.id

    def __eq__(self, other: object) -> bool:
        """Whether it is the same target of the same environment."""
        return getattr(other, "_place", None) == self._place

    def __hash__(self) -> int:
        """Agree with equality."""
        return hash(self._place)

    def __repr__(self) -> str:
        """Return the name as bsk_rl shows it."""
        return f"Target({self.name})"
