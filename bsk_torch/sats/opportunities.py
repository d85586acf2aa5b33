"""Opportunities of all satellites of a type: windows of places, in the order in which they close."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

import torch
from torch import Tensor

from bsk_torch.sim.names import nearest

if TYPE_CHECKING:
    from bsk_torch.sats.bound_access import BoundAccessSatellite


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
    (:class:`~bsk_torch.sats.objects.TargetObjects`), or an array [N, n] of the names of stations; ``["window"]``, opening and
    closing time, s since reset, [N, n] each; ``["r_LP_P"]``, [N, n, 3] m; ``["type"]``.

    Attributes:
        open: Opening time, [N, n] s since reset.
        close: Closing time, [N, n] s since reset.
        place: Index of the place among those of its type, [N, n].
        r_LP_P: Earth-fixed positions, [N, n, 3] m.
        found: Number of opportunities without repetitions, [N].
        satellite: The satellites.
        type: Type of the opportunities.
    """

    satellite: BoundAccessSatellite
    type: str

    def of(self, satellite: BoundAccessSatellite, type: str) -> Opportunities:
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
