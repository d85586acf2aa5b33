"""Attitude set-points: a reference attitude at rest that an action sets."""

from __future__ import annotations

from typing import ClassVar

from bsk_torch.astro.attitude import mrp_subtract
from bsk_torch.sim.component import Bus, Component, vec
from bsk_torch.sim.dyn.navigation import navigated
from bsk_torch.sim.fsw.guidance import Error
from bsk_torch.sim.fsw.models import FSWModel
from bsk_torch.sim.fsw.modes import Mode
from bsk_torch.vec3 import Vec3

ATTITUDE_MRP = "attitude_mrp"  # command that follows a set-point


def hold(bus: Bus) -> None:
    """Write the error relative to the set-point, which is at rest: ``[BR] = [BN] [RN]^T``, ``omega_BR = omega_BN``.

    Every command sets ``sigma_RN`` to zero, so that the reference is N itself unless a set-point follows; guidance laws, which
    run after this, replace the error. The set-point may have any length: the error is the short way round.
    """
    zero, estimate = Vec3.zeros_like(bus.sigma_BN.x), navigated(bus)
    bus.error = Error(mrp_subtract(estimate.sigma_BN, bus.sigma_RN), estimate.omega_BN_B, zero, zero)


ATTITUDE_SETPOINT = Component(
    slot="attitude_setpoint",
    after="navigation",
    update=hold,
    state=(vec("sigma_RN", "-", "set-point, MRP; zero from every command until an action sets it"),),
    resets=(("sigma_RN", 0.0),),
)


class AttitudeSetpointFSWModel(FSWModel):
    """Adds the command ``attitude_mrp`` to any flight software: control to the setpoint in the state ``sigma_RN``.

    :class:`bsk_torch.act.AttitudeSetpoint` adds it automatically.
    """

    components: ClassVar[tuple[Component, ...]] = (ATTITUDE_SETPOINT,)
    modes: ClassVar[dict[str, Mode | None]] = {ATTITUDE_MRP: Mode(("control_on",))}


HOLD_INERTIAL = "hold_inertial"  # command to turn to the attitude of N


class InertialHoldFSWModel(FSWModel):
    """Adds the command ``hold_inertial`` to any flight software: control to the attitude of N, at rest.

    As in Basilisk, this is the mode after a maneuver. Actions for maneuvers add it automatically.
    """

    modes: ClassVar[dict[str, Mode | None]] = {HOLD_INERTIAL: Mode(("control_on",))}
