"""Impulsive maneuvers: the tank, and the change of velocity that the spacecraft takes at the beginning of a tick.

A maneuver is commanded at the end of a tick, at time T. The state message of that tick keeps the velocity before it, as in
Basilisk, so the change waits in ``delta_v_N`` until the next tick begins, from whose start on the orbit is the new one.
"""

from __future__ import annotations

import torch
from torch import Tensor

from bsk_torch.sim.component import Arg, Bus, Component, Field, vec
from bsk_torch.vec3 import Vec3

EMPTY = 1e-8  # change of velocity, m/s, up to which a tank counts as empty
MOST_FUEL = 1e6  # largest tank, m/s


def change_velocity(bus: Bus) -> None:
    """Start the tick from ``v_BN_N + delta_v_N``; where the orbit was solved in advance, that has been done."""
    bus.v_BN_N = bus.v_BN_N + bus.delta_v_N
    bus.delta_v_N = Vec3.zeros_like(bus.v_BN_N.x)


TANK = Component(
    slot="manoeuvre",
    update=change_velocity,
    args=(Arg("dv_available_init", 100.0, "m/s", "sum of the changes of velocity of a full tank", low=0.0, high=MOST_FUEL),),
    state=(
        Field("dv_available", 1, "m/s", "remaining velocity change", exact=True, limit=MOST_FUEL),
        Field("thrust_count", 1, "-", "maneuvers since reset", exact=True),
        vec("delta_v_N", "m/s", "change of velocity with which the next tick begins", exact=True),
    ),
    initial=lambda args: {"dv_available": args["dv_available_init"]},
)
"""The tank of :class:`~bsk_torch.sim.fsw.models.MagicOrbitalManeuverFSWModel`."""


def burn(dv_N: Tensor, available: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Return the maneuvers ``dv_N`` [N, 3] m/s with tanks that are good for ``available`` [N] m/s.

    ``dv <- dv min(1, available / |dv|)``. Returned with what remains, ``available - |dv|`` [N] m/s, and whether a request exceeds
    its tank, [N].
    """
    asked = dv_N.norm(dim=-1)
    clipped = asked > available
    scaled = dv_N / torch.where(clipped, asked, 1.0).unsqueeze(-1) * available.unsqueeze(-1)
    dv_N = torch.where(clipped.unsqueeze(-1), scaled, dv_N)
    return dv_N, (available - dv_N.norm(dim=-1)).clamp(min=0.0), clipped
