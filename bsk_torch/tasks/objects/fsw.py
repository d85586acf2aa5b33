"""Flight software of imagers of resident space objects (RSO): the instrument points at an object of a catalog."""

from __future__ import annotations

import dataclasses
from typing import ClassVar

import torch
from torch import Tensor

from bsk_torch.sim.component import Bus, Component
from bsk_torch.sim.dyn.models import DynamicsModel
from bsk_torch.sim.fsw.guidance import guided_angle
from bsk_torch.sim.fsw.instrument import SCANNING_CONTROLLER
from bsk_torch.sim.fsw.models import ImagingFSWModel
from bsk_torch.sim.fsw.modes import Mode
from bsk_torch.sim.readout.observables import Now, observable
from bsk_torch.tasks.objects.dyn import SpaceToSpaceImagingDynModel, check_hold
from bsk_torch.tasks.objects.radio import CatalogRadioDynModel


def aim_at_rso(bus: Bus) -> None:
    """Write the position of the target in this tick, m."""
    bus.r_LN_N = bus.r_TN_N


def judge_pointing(bus: Bus) -> None:
    """Write whether ``|sigma_BR| <= attitude tolerance`` and ``|omega_BR| <= rate tolerance``, for the gate and the hold."""
    error = bus.error
    points = (error.sigma_BR.norm() <= bus.attitude_tolerance) & (error.omega_BR_B.norm() <= bus.rate_tolerance)
    zero = torch.zeros_like(bus.rso_pointed)
    bus.rso_pointed = torch.where(points & (bus.location_on > 0.0), torch.ones_like(zero), zero)
    check_hold(bus)


RSO_AIM = Component(slot="location_target", after="navigation", update=aim_at_rso)

POINTING_JUDGE = dataclasses.replace(SCANNING_CONTROLLER, update=judge_pointing, state=(), flags=("controller_on",), stops=True)


class SpaceToSpaceImagingFSWModel(ImagingFSWModel):
    """Points the instrument at an object of a catalog; the gate of the dynamics model, or a controller, takes the image.

    The mode ``"image_rso"`` is entered by :class:`bsk_torch.tasks.objects.ImageRSO`. Places on the ground are not imaged.
    """

    requires_dyn: ClassVar[tuple[type[DynamicsModel], ...]] = (SpaceToSpaceImagingDynModel,)
    components: ClassVar[tuple[Component, ...]] = (RSO_AIM, POINTING_JUDGE)
    modes: ClassVar[dict[str, Mode | None]] = {
        "image": None,
        "image_rso": Mode(("control_on", "location_on", "instrument_power"), {"rso_armed": 1.0}),
    }

    @observable
    def target_pointing_error(now: Now) -> Tensor:
        """Angle between the instrument axis and the direction of the target, [N] rad, when last pointed there."""
        return guided_angle(now)


class CatalogRadioFSWModel(SpaceToSpaceImagingFSWModel):
    """Points the instrument also at another imager, to which it transmits.

    The mode ``"transmit_rso"`` is entered by :class:`bsk_torch.tasks.objects.TransmitCatalog`.
    """

    requires_dyn: ClassVar[tuple[type[DynamicsModel], ...]] = (CatalogRadioDynModel,)
    modes: ClassVar[dict[str, Mode | None]] = {"transmit_rso": Mode(("control_on", "location_on"), {"radio_armed": 1.0})}
