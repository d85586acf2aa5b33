"""Forces of custom components on the spacecraft, such as low thrust."""

from __future__ import annotations

from bsk_torch.sim.component import Bus
from bsk_torch.vec3 import Vec3


def add_force(bus: Bus, force_N: Vec3) -> None:
    """Add a force on the spacecraft, in newtons with components in N, constant over this tick.

    The hub integrates ``v' = a(r, t) + F_N / m`` with the sum ``external_force_N`` of all added forces. Components that add
    forces must run before it: ``before="hub"``, or in an earlier slot. The orbit must be integrated; if it is solved in advance,
    a component that adds a force raises a TypeError. Look-ahead (predicted windows and eclipses) does not include the force.
    """
    bus.external_force_N = bus.external_force_N + force_N if bus.has("external_force_N") else force_N


def check_force(bus: Bus, on_arc: bool) -> None:
    """Raise TypeError after a tick for a force that the hub has not felt."""
    if not bus.has("external_force_N"):
        return
    if on_arc:
        raise TypeError(
            "a component writes external_force_N, a force on the spacecraft, but the orbit was solved in advance, without it; "
            "pass orbit='integrated' to the environment, or write orbit = 'integrated' in the dynamics model"
        )
    if not (bus.has("force_is_felt") and bus.force_is_felt):
        raise TypeError(
            "a component writes external_force_N, a force on the spacecraft, after the hub, which would never feel it; give the "
            "component before='hub'"
        )
