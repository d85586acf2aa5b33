"""The other satellites of an episode, by name, row by row alongside the satellite that asks for them.

With N environments and ``count`` satellites of the asking type in each, the row ``e * count + k`` of what is read here belongs to
environment e: it is the value of the named satellite in that environment.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np
import torch
from torch import Tensor

if TYPE_CHECKING:
    from bsk_torch.sats.bound import BoundSatellite

SatelliteLike: TypeAlias = "BoundSatellite | OtherSatellite"
"""What functions of satellites get: all of a type, or another one of each episode."""

PLAIN = (int, float, str, bytes, type(None), type, np.ndarray, np.generic, torch.dtype, torch.device)
"""Values that are the same for all rows."""

Take = Callable[[Any], Any]


def aligned(value: object, rows: int, take: Take) -> Any:
    """Return a value whose tensors of ``rows`` rows are replaced by what ``take`` makes of them, also within containers.

    Functions give aligned results, and objects show aligned attributes.
    """
    if isinstance(value, Tensor):
        return take(value) if value.ndim and len(value) == rows else value
    if isinstance(value, PLAIN):
        return value
    if isinstance(value, tuple | list):
        parts = [aligned(part, rows, take) for part in value]
        return type(value)(*parts) if hasattr(value, "_fields") else type(value)(parts)
    if isinstance(value, dict):
        return {name: aligned(part, rows, take) for name, part in value.items()}
    if callable(value):
        return lambda *args, **options: aligned(value(*args, **options), rows, take)
    return Aligned(value, rows, take)


class Aligned:
    """Read-only view of an object whose tensors have other rows than those of the satellite that looks at it."""

    def __init__(self, whole: object, rows: int, take: Take) -> None:
        """View ``whole``, whose tensors have ``rows`` rows; ``take`` makes a tensor with the rows of the view of one."""
        own = self.__dict__
        own["_whole"], own["_rows"], own["_take"] = whole, rows, take

    _whole: Any
    _rows: int
    _take: Take

    def __getattr__(self, name: str) -> Any:
        if name.startswith("__"):
            raise AttributeError(name)
        return aligned(getattr(self._whole, name), self._rows, self._take)

    def __getitem__(self, name: object) -> Any:
        return aligned(self._whole[name], self._rows, self._take)

    def __setattr__(self, name: str, value: object) -> None:
        raise AttributeError(f"{name!r} cannot be set: another satellite is shown to be read")

    def __repr__(self) -> str:
        return f"<{type(self._whole).__name__} of another satellite>"


class OtherSatellite(Aligned):
    """A satellite of the same episodes: ``dynamics``, ``fsw``, ``sat_args`` and the rest, as of a :class:`BoundSatellite`.

    Tensors have the rows of the satellite that asks: ``satellite.others["RSO"].dynamics.r_BN_N`` is [N, 3], alongside
    ``satellite.dynamics.r_BN_N``.
    """

    def __init__(self, whole: BoundSatellite, number: int, times: int) -> None:
        """View satellite ``number`` of those of the type ``whole``, for ``times`` rows of each episode."""
        state = whole.simulator.state
        count = state.count

        def take(value: Tensor) -> Tensor:
            mine = value if count == 1 else value.view(-1, count, *value.shape[1:])[:, number]
            return mine if times == 1 else mine.repeat_interleave(times, 0)

        super().__init__(whole, state.rows, take)
        self.__dict__["name"] = self.__dict__["id"] = whole.names[number]


class Others(Mapping[str, OtherSatellite]):
    """The satellites of an episode by name, as one of its types sees them, itself included."""

    def __init__(self, satellite: BoundSatellite) -> None:
        """Show the satellites of the fleet to a ``satellite``."""
        self._satellite, self._fleet = satellite, satellite.fleet

    def __getitem__(self, name: str) -> OtherSatellite:
        whole, number = self._fleet.found(name)
        return OtherSatellite(whole, number, self._satellite.simulator.count)

    def __iter__(self) -> Iterator[str]:
        return iter(self._fleet.places)

    def __len__(self) -> int:
        return len(self._fleet.places)
