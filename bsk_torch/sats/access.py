"""Satellites with access windows of places on the ground."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping

import torch
from torch import Tensor
from typing_extensions import Unpack, override

from bsk_torch._checks import number, switch
from bsk_torch.sats.access_filter import AccessFilter, Filter, make_filter
from bsk_torch.sats.satellite import Satellite, SatelliteOptions
from bsk_torch.sim.orbit.grid import PLAN_STEP

LONGEST_GENERATION = 1e6
"""Bound of the seconds that one extension of windows searches, eleven days: all of them are kept."""

LONGEST_AT_RESET = 1e7
"""Bound of the seconds for which windows are generated at reset, 116 days: they take seconds and megabytes for each episode."""


class AccessOptions(SatelliteOptions, total=False):
    """The same of satellites with access windows; see :class:`AccessSatellite`."""

    generation_duration: float
    initial_generation_duration: float | None
    max_generation_duration_beyond_initial: float
    may_see_nothing: bool


class AccessSatellite(Satellite):
    """Adds access windows; see :mod:`bsk_torch.sim.access.windows.search`.

    In an environment, it has the queries of :class:`bsk_torch.sats.bound_access.BoundAccessSatellite`.
    """

    def __init__(
        self,
        name: str,
        sat_args: Mapping[str, object] | Callable[[], Mapping[str, object]] | None = None,
        *,
        generation_duration: float = 600.0,
        initial_generation_duration: float | None = None,
        max_generation_duration_beyond_initial: float = float("inf"),
        may_see_nothing: bool = False,
        **options: Unpack[SatelliteOptions],
    ) -> None:
        """See :class:`~bsk_torch.sats.satellite.Satellite` for the other arguments.

        Args:
            name: A Python identifier.
            sat_args: Arguments of the models.
            generation_duration: Seconds by which windows are extended when a query runs out of them, a multiple of 30.
            initial_generation_duration: Seconds for which windows are generated at reset; None for the time limit (nothing
                where that is infinite). Of more than :data:`LONGEST_AT_RESET`, the rest is generated as queries need it.
            max_generation_duration_beyond_initial: Seconds beyond that after which queries end; they then repeat the last window.
            may_see_nothing: Whether queries without a window within a hundred segments yield observations of zeros, and images
                that only wait for a segment; otherwise they raise RuntimeError.
            **options: Passed on.
        """
        super().__init__(name, sat_args, **options)
        self.generation_duration = number(
            "generation_duration", generation_duration, 0.0, LONGEST_GENERATION, unit="s", above=True
        )
        whole = self.generation_duration / PLAN_STEP
        if whole != round(whole):
            raise ValueError(f"generation_duration={generation_duration:g} s must be a positive multiple of {PLAN_STEP:g} s")
        self.initial_generation_duration = initial_generation_duration
        if initial_generation_duration is not None:
            self.initial_generation_duration = number(
                "initial_generation_duration", initial_generation_duration, 0.0, unit="s", finite=False, none=True
            )
        self.max_generation_duration_beyond_initial = number(
            "max_generation_duration_beyond_initial", max_generation_duration_beyond_initial, 0.0, unit="s", finite=False
        )
        self.may_see_nothing = switch("may_see_nothing", may_see_nothing)
        self.access_filters: list[AccessFilter] = []

    @property
    @override
    def segment(self) -> float:
        return self.generation_duration

    @override
    def generation(self, limit: Tensor) -> Tensor:
        wanted = limit if self.initial_generation_duration is None else torch.full_like(limit, self.initial_generation_duration)
        wanted = torch.where(torch.isfinite(wanted), wanted.clamp(max=LONGEST_AT_RESET), torch.zeros_like(wanted))
        least = max(2.0 * PLAN_STEP, self.generation_duration)
        whole = torch.ceil(torch.clamp(wanted, min=least) / self.generation_duration) * self.generation_duration
        return torch.where(wanted > 0.0, whole, torch.zeros_like(wanted))

    def add_access_filter(
        self, access_filter_fn: Filter, types: str | Collection[str] | None = None, prepend: bool = False, type: str | None = None
    ) -> None:
        """Exclude places from all queries, of the satellite before an environment is built or of the one in an environment.

        Args:
            access_filter_fn: Function that returns the places of a type that remain, [N, P] booleans: without arguments, or of
                all places of a type, an :class:`~bsk_torch.sats.access_filter.AllPlaces`.
            types: Type or types of opportunities that are filtered; ``"target"`` unless given for functions without arguments,
                and all of them for functions of places.
            prepend: Whether the filter precedes the others; the result does not depend on it.
            type: The same as ``types``.
        """
        made = make_filter(access_filter_fn, types if type is None else type)
        self.access_filters.insert(0 if prepend else len(self.access_filters), made)
