"""Flight software of inspectors: the instrument points at a resident space object (RSO)."""

from __future__ import annotations

from typing import ClassVar

import torch
from torch import Tensor

from bsk_torch.sim.component import Bus, Component
from bsk_torch.sim.dyn.models import DynamicsModel
from bsk_torch.sim.fsw.guidance import guided_angle
from bsk_torch.sim.fsw.models import ContinuousImagingFSWModel
from bsk_torch.sim.fsw.modes import Mode
from bsk_torch.sim.readout.observables import Now, observable
from bsk_torch.tasks.inspection.dyn import RSOInspectorDynModel


def aim_at_rso(bus: Bus) -> None:
    """Write the position of the RSO in this tick as the target's, m; it always has access."""
    bus.r_LN_N, bus.target_access = bus.rso[0].r_BN_N, torch.ones_like(bus.r_BN_N.x).to(bus.dtype)


RSO_TARGET = Component(slot="location_target", after="navigation", update=aim_at_rso, follows="rso")


class RSOInspectorFSWModel(ContinuousImagingFSWModel):
    """Points the instrument at the satellite with an :class:`~bsk_torch.tasks.inspection.RSODynModel`, and records while it does.

    The command is ``action_inspect_rso``, as in ``act.DiscreteFSWAction("action_inspect_rso", duration=300.0)``. The instrument
    records while the attitude and rate errors are within ``imageAttErrorRequirement`` and ``imageRateErrorRequirement``. The
    attitude error never exceeds 1 (MRP norm), so a requirement of 1 is always met.
    """

    requires_dyn: ClassVar[tuple[type[DynamicsModel], ...]] = (RSOInspectorDynModel,)
    components: ClassVar[tuple[Component, ...]] = (RSO_TARGET,)
    modes: ClassVar[dict[str, Mode | None]] = {
        "inspect_rso": Mode(("control_on", "location_on", "controller_on", "instrument_linked", "instrument_power")),
    }

    @observable
    def target_pointing_error(now: Now) -> Tensor:
        """Angle between the instrument axis and the direction of the RSO, [N] rad, when last pointed there."""
        return guided_angle(now)
