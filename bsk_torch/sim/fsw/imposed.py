"""Attitude of a spacecraft without actuators: the reference of the guidance is imposed.

Basilisk's spacecraft with ``attRefInMsg``.
"""

from __future__ import annotations

import torch

from bsk_torch.astro.attitude import dcm_to_mrp, mrp_to_dcm
from bsk_torch.sim.component import Bus, Component, vec
from bsk_torch.sim.fsw.guidance import hill_motion, point_along_hill
from bsk_torch.vec3 import Vec3, only


def impose(bus: Bus) -> None:
    """Set the attitude to the reference that the flight software wrote one tick ago.

    ``sigma_BN = sigma_RN`` and ``omega_BN_B = [RN] omega_RN_N``, unchanged: a reference of length above one is not switched.
    """
    bus.sigma_BN, bus.omega_BN_B = bus.sigma_RN, mrp_to_dcm(bus.sigma_RN) @ bus.omega_RN_N


def refer_to_hill(bus: Bus) -> None:
    """Write the Hill frame H as the reference, ``sigma_RN`` of [HN] and ``omega_RN_N = f' o_h``, and the error relative to it."""
    point_along_hill(bus)

    def reference() -> tuple[Vec3, Vec3]:
        HN, rate, _ = hill_motion(bus)
        return dcm_to_mrp(HN), HN.z * rate

    bus.sigma_RN, bus.omega_RN_N = only(bus.nadir_on > 0.0, reference, (bus.sigma_RN, bus.omega_RN_N))


HILL_REFERENCE = Component(slot="nadir_pointing", update=refer_to_hill, flags=("nadir_on",))

_ADVICE = "the attitude is that of the reference; write sigma_RN and omega_RN_N"

IMPOSED_ATTITUDE = Component(
    slot="imposed_attitude",
    update=impose,
    state=(
        vec("sigma_RN", "-", "attitude of the reference, MRP; zero from every command until a guidance law writes it"),
        vec("omega_RN_N", "rad/s", "rate of the reference, in N"),
    ),
    # the last two replace what the hub starts with: without a reference Basilisk imposes zero from the beginning
    initial=lambda args: {
        name: torch.zeros(1, 3, dtype=torch.float64) for name in ("sigma_RN", "omega_RN_N", "sigma_BN", "omega_BN_B")
    },
    overwrites=(("sigma_BN", _ADVICE), ("omega_BN_B", _ADVICE)),
    resets=(("sigma_RN", 0.0), ("omega_RN_N", 0.0)),
)

ACTUATORS = Component(slot="imposed_attitude")
"""Nothing in the slot: for flight software that turns the spacecraft by wheels."""
