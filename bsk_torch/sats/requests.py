"""Satellites that look at requests on the ground."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from typing import ClassVar

import torch
from torch import Tensor
from typing_extensions import Unpack, override

from bsk_torch._checks import text
from bsk_torch.sats.access import AccessOptions
from bsk_torch.sats.bound import SatelliteFleet
from bsk_torch.sats.imaging import BoundImagingSatellite, ImagingSatellite
from bsk_torch.sim.fsw import FSWModel
from bsk_torch.sim.fsw.look import LookFSWModel
from bsk_torch.sim.places.requested import DUE

MOST_SENSORS = 32
"""Largest number of sensor types of an environment: the bits of a number that float64 holds exactly."""


class RequestSatellite(ImagingSatellite):
    """An imaging satellite that serves the requests of :class:`bsk_torch.scene.Requests`.

    It sees the requests that allow one of the sensors that it carries, or any sensor. Satellites that differ in their sensors
    only are simulated together. There may be no requests left: it then observes zeros, and waits.

    Attributes:
        sensor_types: Names of the sensors that it carries; subclasses may set it. In an environment, those of all satellites are
            in ``scenario.fitting``.
    """

    fsw_type: ClassVar[type[FSWModel]] = LookFSWModel
    sensor_types: Collection[str] = ()

    def __init__(
        self,
        name: str,
        sat_args: Mapping[str, object] | Callable[[], Mapping[str, object]] | None = None,
        *,
        sensor_types: Collection[str] | None = None,
        **options: Unpack[AccessOptions],
    ) -> None:
        """Describe a satellite; ValueError for wrong sensor types.

        Args:
            name: See :class:`~bsk_torch.sats.ImagingSatellite`.
            sat_args: Likewise.
            sensor_types: Names of the sensors that it carries, such as ``["visible"]`` (default: those of the class).
            **options: Likewise; ``may_see_nothing`` is True unless given.
        """
        options.setdefault("may_see_nothing", True)
        super().__init__(name, sat_args, **options)
        given = self.sensor_types if sensor_types is None else sensor_types
        if isinstance(given, str) or not isinstance(given, Collection) or len(given) > MOST_SENSORS:
            raise ValueError(f"sensor_types={given!r} must be a list of at most {MOST_SENSORS} names, such as ['visible']")
        self.sensor_types = tuple(text("sensor_types", name) for name in given)


class BoundRequestSatellite(BoundImagingSatellite, RequestSatellite):
    """The satellites of one type in an environment that look at requests."""

    _last_due: tuple[int, Tensor] | None = None

    @override
    def _join(self, fleet: SatelliteFleet, type_index: int) -> None:
        super()._join(fleet, type_index)
        if DUE not in self.simulator.scenario_state:
            raise ValueError(
                f"{self.names[0]} is a {type(self).__name__}, which serves requests, such as "
                "scene.Requests(scene.UniformTargets(300)); the scenario has none"
            )

    def request_values(self, name: str, place: Tensor) -> Tensor:
        """Return drawn values ``name`` of requests ``place`` [N, n], [N, n]."""
        return self.simulator.scenario_state.look_up(name, place.reshape(self.fleet.num_envs, -1)).view(place.shape)

    @override
    def _last_generation(self, max_lookahead: int) -> Tensor | None:
        last = super()._last_generation(max_lookahead)
        end = torch.minimum(self._due_last(), self.time_limit)  # nothing to find behind
        return end if last is None else torch.minimum(end, last)

    def _due_last(self) -> Tensor:
        """Return the time at which the last request of each episode is due, [N] s."""
        table = self.simulator.scenario_state
        if self._last_due is None or self._last_due[0] != table.version:
            due, owner = table.shared(DUE)
            exists = table.shared("target_exists")[0] > 0.5
            last = torch.where(exists, due, 0.0).amax(1)
            self._last_due = table.version, self.of_env(last if owner is None else last[owner])
        return self._last_due[1]


RequestSatellite.bound_type = BoundRequestSatellite
