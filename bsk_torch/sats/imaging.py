"""Satellites that image targets on the ground."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import ClassVar

import torch
from torch import Tensor
from typing_extensions import Unpack, override

from bsk_torch.sats.access import AccessOptions, AccessSatellite
from bsk_torch.sats.bound import SatelliteFleet
from bsk_torch.sats.bound_access import BoundAccessSatellite
from bsk_torch.sim.dyn import DynamicsModel, ImagingDynModel
from bsk_torch.sim.fsw import FSWModel, ImagingFSWModel
from bsk_torch.sim.places import TARGETS

BUFFER = "image_buffer"
"""Partition that images go to."""

NONE = -1
"""Target before the first one has been chosen."""


class ImagingSatellite(AccessSatellite):
    """A satellite that images targets; an imaging task ends when the image is taken or the window closes.

    In an environment, it is a :class:`BoundImagingSatellite`.

    Attributes:
        target_types: Type of the opportunities that it images.
        sees_through_clouds: Whether its images show targets under clouds, as those of a radar do; read by
            :class:`bsk_torch.data.CloudFreeImageReward`. Subclasses set it.
    """

    dyn_type: ClassVar[type[DynamicsModel]] = ImagingDynModel
    fsw_type: ClassVar[type[FSWModel]] = ImagingFSWModel
    target_types: str = "target"
    sees_through_clouds: bool = False

    def __init__(
        self,
        name: str,
        sat_args: Mapping[str, object] | Callable[[], Mapping[str, object]] | None = None,
        **options: Unpack[AccessOptions],
    ) -> None:
        """See :class:`~bsk_torch.sats.access.AccessSatellite`; the store has one partition, for images."""
        super().__init__(name, sat_args, **options)
        self.sat_args_generator["bufferNames"] = [BUFFER]
        self.sat_args_generator["transmitterNumBuffers"] = 1


class BoundImagingSatellite(BoundAccessSatellite, ImagingSatellite):
    """The imaging satellites of one type in an environment.

    Counters of the current episodes: ``imaged``, ``missed`` (windows that closed without the image), [N] each.
    """

    def _join(self, fleet: SatelliteFleet, type_index: int) -> None:
        super()._join(fleet, type_index)
        scenario = self.simulator.scenario_state
        targets = scenario[TARGETS].shape[1] if TARGETS in scenario else 0
        for name, initial, high in (("latest_target", NONE, targets - 1), ("imaged", 0, None), ("missed", 0, None)):
            self.memory.declare(name, initial, low=initial, high=high)

    @property
    def latest_target(self) -> Tensor:
        """Target chosen last, [N]; -1 before the first."""
        return self.memory["latest_target"]

    @property
    def known_images(self) -> Tensor:
        """Targets that each satellite knows to be imaged, [N, T] bool; needs :class:`bsk_torch.data.UniqueImageReward`."""
        return self.rows_of(self.rewarder.known)

    @property
    def imaged(self) -> Tensor:
        """Number of images taken, [N]."""
        return self.memory["imaged"]

    @property
    def missed(self) -> Tensor:
        """Number of chosen targets whose windows closed without an image, [N]."""
        return self.memory["missed"]

    @override
    def note_events(self, event: Tensor) -> None:
        self.memory["imaged"] = self.imaged + event

    @override
    def counts(self) -> dict[str, Tensor]:
        return {"imaged": self.imaged, "missed": self.missed}

    def window_of(self, target: Tensor, type: str | None = None) -> tuple[Tensor, Tensor]:
        """Return opening and closing time of the next known window of a target [N], [N] s each; infinity if none is known."""
        windows = self.upcoming_opportunities(type or self.target_types)
        same = (windows.place == target.unsqueeze(-1)) & torch.isfinite(windows.close)
        opens, closes = (torch.where(same, time, torch.inf).amin(1) for time in (windows.open, windows.close))
        return opens, closes


ImagingSatellite.bound_type = BoundImagingSatellite
