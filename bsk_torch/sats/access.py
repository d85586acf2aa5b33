"""Satellites that know when places on the ground will see them."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

import torch
from torch import Tensor

from bsk_torch.sats.satellite import Satellite
from bsk_torch.sim.span import PLAN_STEP


class Opportunities(NamedTuple):
    """The next opportunities, sorted by closing time: opening and closing time, s since reset, and place; [N, n] each."""

    open: Tensor
    close: Tensor
    place: Tensor
    r_LP_P: Tensor
    """Earth-fixed positions, [N, n, 3] m."""

    @property
    def mid(self) -> Tensor:
        """Middle of the window, [N, n] s since reset."""
        return 0.5 * (self.open + self.close)


class AccessSatellite(Satellite):
    """Adds access windows; see :mod:`bsk_torch.sim.access`."""

    def __init__(
        self,
        name: str,
        sat_args: Mapping[str, Any] | None = None,
        *,
        generation_duration: float = 600.0,
        initial_generation_duration: float | None = None,
        **options: Any,
    ) -> None:
        """See :class:`~bsk_torch.sats.satellite.Satellite` for the other arguments.

        Args:
            name: A Python identifier.
            sat_args: Arguments of the models.
            generation_duration: Seconds by which windows are extended when a query runs out of them, a multiple of 30.
            initial_generation_duration: Seconds for which windows are generated at reset; None for the time limit (nothing
                where that is infinite).
            **options: Passed on.
        """
        super().__init__(name, sat_args, **options)
        whole = generation_duration / PLAN_STEP
        if generation_duration <= 0.0 or whole != round(whole):
            raise ValueError(f"generation_duration={generation_duration:g} s must be a positive multiple of {PLAN_STEP:g} s")
        self.generation_duration = generation_duration
        self.initial_generation_duration = initial_generation_duration

    @property
    def segment(self) -> float:
        """See :attr:`Satellite.segment`."""
        return self.generation_duration

    @property
    def opportunity_types(self) -> tuple[str, ...]:  # type: ignore[override]
        """Kinds of opportunities that this satellite has."""
        return ("ground_station",) if self.simulator.access is not None else ()

    def generation(self, limit: Tensor) -> Tensor:
        """See :meth:`Satellite.generation`."""
        wanted = limit if self.initial_generation_duration is None else torch.full_like(limit, self.initial_generation_duration)
        wanted = torch.where(torch.isfinite(wanted), wanted, torch.zeros_like(wanted))
        least = max(2.0 * PLAN_STEP, self.generation_duration)
        whole = torch.ceil(torch.clamp(wanted, min=least) / self.generation_duration) * self.generation_duration
        return torch.where(wanted > 0.0, whole, torch.zeros_like(wanted))

    def find_next_opportunities(self, n: int, type: str = "ground_station") -> Opportunities:
        """The ``n`` opportunities of ``type`` that close next, those in progress included; the last repeated if fewer.

        RuntimeError where none is found within a hundred segments.
        """
        if type not in self.opportunity_types:
            raise ValueError(f"type={type!r} must be one of {list(self.opportunity_types)}")
        windows = self.simulator.next_windows(n)
        return Opportunities(*windows, self.simulator.access.places.r_P[windows.place])  # type: ignore[union-attr]
