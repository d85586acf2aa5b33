"""Dynamics and flight software of inspection: a resident space object (RSO), and the satellites that inspect it."""

from __future__ import annotations

from typing import ClassVar

import torch
from torch import Tensor

from bsk_torch.astro.attitude import dcm_to_mrp
from bsk_torch.astro.orbit import hill_frame, hill_rate
from bsk_torch.sim.component import Bus, Component, vec
from bsk_torch.sim.dyn.models import ContinuousImagingDynModel, DynamicsModel, EclipseDynModel
from bsk_torch.sim.fsw.guidance import guided_angle
from bsk_torch.sim.fsw.models import ContinuousImagingFSWModel
from bsk_torch.sim.fsw.modes import Mode
from bsk_torch.sim.instruments import NO_INSTRUMENTS
from bsk_torch.sim.readout.observables import Now, observable
from bsk_torch.vec3 import Vec3, only


def see_surroundings(bus: Bus) -> None:
    """Keep the Sun's position r_SN_N, m, and the direction of the Earth's axis in N, which the records of a run hold."""
    bus.sun_N, bus.pole_N = bus.r_SN_N, bus.EN.z


def refer_to_past_hill(bus: Bus) -> None:
    """Write the Hill frame of the last tick as the reference where a command to point along it has just cleared the reference.

    In Basilisk the flight software writes the reference for the first time a tick after the command, and the spacecraft has the
    attitude zero until then. A written reference has a rate: that of the orbit.
    """
    if not bus.has("omega_RN_N"):  # wheels turn the spacecraft, not the reference
        return
    cleared = (bus.nadir_on > 0.0) & bus.omega_RN_N.dot(bus.omega_RN_N).eq(0.0)

    def reference() -> tuple[Vec3, Vec3]:
        HN = hill_frame(bus.r_BN_N, bus.v_BN_N)
        rate_N = HN.z * hill_rate(bus.r_BN_N, bus.v_BN_N)
        return dcm_to_mrp(HN.to(bus.dtype)), rate_N.to(bus.dtype)

    bus.sigma_RN, bus.omega_RN_N = only(cleared, reference, (bus.sigma_RN, bus.omega_RN_N))


RSO = Component(
    slot="rso",
    after="eclipse",
    update=see_surroundings,
    at_start=True,
    state=(
        vec("sun_N", "m", "Sun relative to the Earth", exact=True),
        vec("pole_N", "-", "unit vector along the Earth's axis", exact=True),
    ),
    overwrites=(("sun_N", "it follows from the time"), ("pole_N", "it follows from the time")),
    records=("r_BN_N", "sigma_BN", "illumination", "sun_N", "pole_N"),
)
"""What inspectors follow."""

PAST_REFERENCE = Component(slot="rso_reference", before="manoeuvre", update=refer_to_past_hill, mends=True)

INSPECTOR = Component(slot="rso_inspector", after="storage", records=("r_BN_N", "storage"))


class RSODynModel(EclipseDynModel):
    """A spacecraft with points on its surface that others inspect; see :class:`bsk_torch.tasks.inspection.SphericalRSO`.

    An environment has exactly one satellite with this model. It may fly without actuators (:class:`bsk_torch.sim.fsw.FSWModel`),
    with an imposed attitude, or with any other flight software.
    """

    components: ClassVar[tuple[Component, ...]] = (RSO, PAST_REFERENCE)
    orbit: ClassVar[str] = "integrated"  # as Basilisk does, whose ticks of 5 s are millimeters an hour off the true orbit


class RSOInspectorDynModel(ContinuousImagingDynModel):
    """A satellite that inspects an RSO: its instrument records while it points at the RSO, into the data buffer."""

    components: ClassVar[tuple[Component, ...]] = (NO_INSTRUMENTS, INSPECTOR)
    orbit: ClassVar[str] = "integrated"


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
