"""Guidance laws. Each writes what it asks for; the tracking error picks the law that the flight mode has switched on.

All of them see the navigation of this tick, which is the truth. Sources: Basilisk's modules hillPoint, locationPointing and
attTrackingError; frames as in Schaub and Junkins.
"""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from bsk_torch.astro.attitude import dcm_to_mrp, mrp_rate_to_omega, mrp_subtract, mrp_to_dcm
from bsk_torch.astro.orbit import hill_frame
from bsk_torch.sim.component import Arg, Bus, Component, Field, Values, vec
from bsk_torch.sim.dyn.power import check_axis, unit_rows
from bsk_torch.vec3 import Vec3, only, select


class Error(NamedTuple):
    """Attitude error sigma_BR, rate error omega_BR_B, and the reference's rate and acceleration, all in B."""

    sigma_BR: Vec3
    omega_BR: Vec3
    omega_RN: Vec3
    domega_RN: Vec3


def rest(bus: Bus) -> Error:
    """Error without a guidance law: the reference is N itself, at rest."""
    zero = Vec3.zeros_like(bus.sigma.x)
    return Error(bus.sigma, bus.omega, zero, zero)


def navigate(bus: Bus) -> None:
    """Attitude of this tick as a matrix, for all guidance laws, and the error as it is without one."""
    bus.BN, bus.error = mrp_to_dcm(bus.sigma), rest(bus)


def line_of_sight(bus: Bus, target: Vec3) -> Vec3:
    """Direction to a target position in N, in B."""
    return bus.BN @ (target - bus.r).unit().to(bus.dtype)


def point_at(bus: Bus, axis: Vec3, target: Vec3, task: str) -> None:
    """Point a body axis at a target position in N, with the rate error from differences of the attitude error.

    The first tick after a reset (``<task>_fresh`` is 1) has no difference to take. The rate about the line of sight is damped.
    """
    on, memory, fresh = getattr(bus, f"{task}_on") > 0.0, getattr(bus, f"{task}_sigma"), getattr(bus, f"{task}_fresh")

    def law() -> tuple[Vec3, Error]:
        los = line_of_sight(bus, target)
        cosine, turn = axis.dot(los), axis.cross(los)
        # tan(phi / 4) / sin(phi), free of the cancellation of acos near alignment
        half = 1.0 + cosine
        sigma = -turn / torch.clamp(half + torch.sqrt(half * half + turn.dot(turn)), min=1e-30)
        difference = mrp_rate_to_omega(sigma, (sigma - memory) / bus.h)
        omega = select(fresh > 0.0, Vec3.zeros_like(cosine), difference) + los * bus.omega.dot(los)
        return sigma, Error(sigma, omega, bus.omega - omega, Vec3.zeros_like(cosine))

    memory, bus.error = only(on, law, (memory, bus.error))
    setattr(bus, f"{task}_sigma", memory)
    setattr(bus, f"{task}_fresh", torch.where(on, torch.zeros_like(fresh), fresh))


def point_at_sun(bus: Bus) -> None:
    """Panel normal toward the Sun."""
    point_at(bus, bus.panel_normal, bus.r_sun, "sun")


def point_at_location(bus: Bus) -> None:
    """Instrument axis toward the target of one tick ago."""
    point_at(bus, bus.instrument_axis, bus.target_N, "location")


def point_along_hill(bus: Bus) -> None:
    """Body axes along the Hill frame: x radially out, z along the orbit normal."""

    def law() -> Error:
        HN = hill_frame(bus.r, bus.v)
        radius2, momentum = bus.r.dot(bus.r), bus.r.cross(bus.v).norm()
        rate = momentum / radius2
        acceleration = -2.0 * bus.v.dot(bus.r) / radius2 * rate
        HN, rate, acceleration = HN.to(bus.dtype), rate.to(bus.dtype), acceleration.to(bus.dtype)
        omega_RN, domega_RN = bus.BN @ (HN.z * rate), bus.BN @ (HN.z * acceleration)
        sigma_BR = mrp_subtract(bus.sigma, dcm_to_mrp(HN))
        return Error(sigma_BR, bus.omega - omega_RN, omega_RN, domega_RN)

    bus.error = only(bus.nadir_on > 0.0, law, bus.error)


def _memory(task: str) -> tuple[Field, ...]:
    return vec(f"{task}_sigma", "-", "attitude error of the last tick"), Field(f"{task}_fresh", 1, "-", "1 after a reset")


def _forget(task: str) -> dict[str, Tensor]:
    return {f"{task}_sigma": torch.zeros(1, 3).double(), f"{task}_fresh": torch.ones(1).double()}


def _instrument_axis(args: Values) -> dict[str, Tensor]:
    return {"instrument_axis": unit_rows(args["inst_pHat_B"])}


NAVIGATION = Component(slot="navigation", order=300, update=navigate)

SUN_POINTING = Component(
    slot="sun_pointing", order=301, update=point_at_sun, state=_memory("sun"), initial=lambda args: _forget("sun")
)

NADIR_POINTING = Component(slot="nadir_pointing", order=302, update=point_along_hill)

LOCATION_POINTING = Component(
    slot="location_pointing",
    order=304,
    update=point_at_location,
    args=(Arg("inst_pHat_B", (0.0, 0.0, 1.0), "-", "instrument axis in B", kind="vector"),),
    state=_memory("location"),
    params=(vec("instrument_axis"),),
    initial=lambda args: _forget("location"),
    prepare=_instrument_axis,
    check=check_axis("inst_pHat_B"),
)
