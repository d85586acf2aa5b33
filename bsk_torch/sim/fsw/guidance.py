"""Guidance laws: each writes the error relative to its reference, where the flight mode has switched it on.

All of them use the attitude, rate, position and velocity of this tick that the navigation knows: the true ones, unless there are
errors (:mod:`bsk_torch.sim.dyn.navigation`). R is the reference frame; sigma_BR is the attitude of B relative to
R, omega_BR the rate, and ``omega_BR_B = omega_BN_B - omega_RN_B``. Sources: Basilisk's modules hillPoint, locationPointing and
attTrackingError; frames as in Schaub and Junkins, section 8.4.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import NamedTuple

import torch
from torch import Tensor

from bsk_torch.astro.attitude import dcm_to_mrp, mrp_rate_to_omega, mrp_subtract, mrp_to_dcm
from bsk_torch.astro.orbit import hill_frame
from bsk_torch.sim.component import Arg, Bus, Component, Field, vec
from bsk_torch.sim.dyn.axes import AXIS_BOUNDS, check_axis, unit_rows
from bsk_torch.sim.dyn.navigation import navigated
from bsk_torch.sim.faults.declared import may_change
from bsk_torch.sim.readout.observables import Now
from bsk_torch.vec3 import Mat3, Vec3, only, select


class Error(NamedTuple):
    """Attitude error sigma_BR, rate error, rad/s, and the reference's rate, rad/s, and acceleration, rad/s^2, all in B."""

    sigma_BR: Vec3
    omega_BR_B: Vec3
    omega_RN_B: Vec3
    domega_RN_B: Vec3


def rest(bus: Bus) -> Error:
    """Return the error without a guidance law: the reference is N itself, at rest."""
    zero, known = Vec3.zeros_like(bus.sigma_BN.x), navigated(bus)
    return Error(known.sigma_BN, known.omega_BN_B, zero, zero)


def navigate(bus: Bus) -> None:
    """Write the attitude [BN] of this tick, for all guidance laws, and the error as it is without one."""
    bus.BN, bus.error = mrp_to_dcm(navigated(bus).sigma_BN), rest(bus)


def point_at(bus: Bus, axis_B: Vec3, r_TN_N: Vec3, task: str, damped: bool = True) -> None:
    """Write the error of pointing an axis p of B at a target T, both directions in B (Basilisk's locationPointing).

    With the direction ``x = [BN] (r_TN - r_BN) / |r_TN - r_BN|`` of the target, at r_TN_N, m, and the angle phi between p, of
    length one, and x::

        sigma_BR = -tan(phi / 4) (p x x) / |p x x|
        omega_BR_B = 4 B^-1(sigma_BR) (sigma_BR - sigma_BR(t - h)) / h + (x . omega_BN_B) x
        omega_RN_B = omega_BN_B - omega_BR_B,  domega_RN_B = 0

    The rotation about the shortest way turns p to x; the rate error is a difference of attitude errors, see
    :func:`bsk_torch.astro.attitude.mrp_rate_to_omega`, and its last term damps the rate about the line of sight where
    ``damped``. In the first tick after a reset, where ``<task>_fresh`` is 1, there is no difference to take and its term is
    zero. The flag ``<task>_on`` of the ``task``, ``"sun"`` or ``"location"``, switches the law on.
    """
    known = navigated(bus)
    on, memory, fresh = getattr(bus, f"{task}_on") > 0.0, getattr(bus, f"{task}_sigma_BR"), getattr(bus, f"{task}_fresh")

    def law() -> tuple[Vec3, Error]:
        x_B = bus.BN @ (r_TN_N - known.r_BN_N).unit().to(bus.dtype)
        cosine, turn = axis_B.dot(x_B), axis_B.cross(x_B)
        # tan(phi / 4) / sin(phi) = 1 / (c + sqrt(c^2 + sin(phi)^2)) with c = 1 + cos(phi): acos would lose digits near alignment
        half = 1.0 + cosine
        sigma_BR = -turn / torch.clamp(half + torch.sqrt(half * half + turn.dot(turn)), min=1e-30)
        omega_BR_B = Vec3.zeros_like(cosine)
        if bus.h_ns:
            difference = mrp_rate_to_omega(sigma_BR, (sigma_BR - memory) / bus.h)
            omega_BR_B = select(fresh > 0.0, omega_BR_B, difference)
        omega_BR_B = omega_BR_B + x_B * known.omega_BN_B.dot(x_B) if damped else omega_BR_B
        return sigma_BR, Error(sigma_BR, omega_BR_B, known.omega_BN_B - omega_BR_B, Vec3.zeros_like(cosine))

    memory, bus.error = only(on, law, (memory, bus.error))
    setattr(bus, f"{task}_sigma_BR", memory)
    setattr(bus, f"{task}_fresh", torch.where(on, torch.zeros_like(fresh), fresh))


def point_at_sun(bus: Bus) -> None:
    """Point the panel's normal at the Sun."""
    point_at(bus, bus.panel_normal_B, bus.r_SN_N, "sun")


def point_axis_at_sun(bus: Bus) -> None:
    """Point the axis that the flight software knows at the Sun."""
    point_at(bus, bus.sun_axis_B, bus.r_SN_N, "sun")


def point_at_location(bus: Bus) -> None:
    """Point the instrument's axis at the target's position of one tick ago."""
    point_at(bus, bus.instrument_axis_B, bus.r_LN_N, "location")


def guided_angle(now: Now) -> Tensor:
    """Return the angle between axis and target in the last tick of :func:`point_at_location`, [N] rad: ``4 atan |sigma_BR|``."""
    return 4.0 * torch.atan(now.location_sigma_BR.norm())


def hill_motion(bus: Bus) -> tuple[Mat3, Tensor, Tensor]:
    """Return the Hill frame [HN], and its rate, rad/s, and acceleration, rad/s^2, about the orbit normal.

    ``f' = |r x v| / r^2`` and ``f'' = -2 (v . r) f' / r^2``.
    """
    r, v, _, _ = navigated(bus)
    HN = hill_frame(r, v)
    radius2, momentum = r.dot(r), r.cross(v).norm()
    rate = momentum / radius2
    acceleration = -2.0 * v.dot(r) / radius2 * rate
    return HN.to(bus.dtype), rate.to(bus.dtype), acceleration.to(bus.dtype)


def point_along_hill(bus: Bus) -> None:
    """Write the error of pointing B along the Hill frame H: x radially out, z along the orbit normal (Basilisk's hillPoint).

    With ``R = H`` (see :func:`bsk_torch.astro.orbit.hill_frame`), the orbit normal o_h and the true anomaly f::

        sigma_BR = sigma_BN relative to the MRP of [HN]
        omega_RN_B = [BN] f' o_h
        domega_RN_B = [BN] f'' o_h
    """

    def law() -> Error:
        HN, rate, acceleration = hill_motion(bus)
        known = navigated(bus)
        omega_RN_B, domega_RN_B = bus.BN @ (HN.z * rate), bus.BN @ (HN.z * acceleration)
        sigma_BR = mrp_subtract(known.sigma_BN, dcm_to_mrp(HN))
        return Error(sigma_BR, known.omega_BN_B - omega_RN_B, omega_RN_B, domega_RN_B)

    bus.error = only(bus.nadir_on > 0.0, law, bus.error)


def _memory(task: str) -> tuple[Field, ...]:
    return vec(f"{task}_sigma_BR", "-", "attitude error of the last tick"), Field(f"{task}_fresh", 1, "-", "1 after a reset")


# modes that can be added to any flight software, such as hold_inertial, ask for attitude control, where there is a law and where
# there is none
NAVIGATION = Component(slot="navigation", update=navigate, flags=("control_on",))

SUN_RESET = {"sun_fresh": 1.0, "sun_sigma_BR": 0.0}  # what a mode resets in which pointing at the Sun begins


def fitted_sun_pointing(given: Mapping[str, object]) -> Component:
    """Return the component that points nHat_B at the Sun, where it is not simply the normal of the panel."""
    return AXIS_TO_SUN if given.get("panels") is not None or may_change(given, "nHat_B") else SUN_POINTING


SUN_POINTING = Component(
    slot="sun_pointing",
    update=point_at_sun,
    state=_memory("sun"),
    initial=lambda args: {"sun_fresh": torch.ones(1, dtype=torch.float64)},
    flags=("sun_on",),
    fit=fitted_sun_pointing,
)

AXIS_TO_SUN = dataclasses.replace(
    SUN_POINTING,
    update=point_axis_at_sun,
    params=(vec("sun_axis_B"),),
    reads=("nHat_B",),
    prepare=lambda args: {"sun_axis_B": unit_rows(args["nHat_B"])},
)
"""Points the axis that the flight software knows: of several panels, or of one that a fault may turn."""

INSTRUMENT_AXIS = Arg(
    "inst_pHat_B", (0.0, 0.0, 1.0), "-", "instrument axis in B; nadir is -x of B when B = H", "vector", *AXIS_BOUNDS
)

NADIR_POINTING = Component(
    slot="nadir_pointing",
    update=point_along_hill,
    args=(INSTRUMENT_AXIS,),
    check=check_axis("inst_pHat_B"),
    flags=("nadir_on",),
)
"""Points B along H, whatever the axis of the instrument is, as Basilisk does; the axis tells how far that is from nadir."""

LOCATION_POINTING = Component(
    slot="location_pointing",
    update=point_at_location,
    args=(INSTRUMENT_AXIS,),
    state=_memory("location"),
    params=(vec("instrument_axis_B"),),
    initial=lambda args: {"location_fresh": torch.ones(1, dtype=torch.float64)},
    prepare=lambda args: {"instrument_axis_B": unit_rows(args["inst_pHat_B"])},
    check=check_axis("inst_pHat_B"),
    flags=("location_on",),
    resets=(("location_fresh", 1.0), ("location_sigma_BR", 0.0)),
)
