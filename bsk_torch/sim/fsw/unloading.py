"""Momentum unloading by magnetic torque bars: the cross-product law."""

from __future__ import annotations

import functools

import torch

from bsk_torch.astro.attitude import mrp_to_dcm
from bsk_torch.sim.component import Arg, Bus, Component, Field, Values
from bsk_torch.sim.dyn.axes import unit_rows
from bsk_torch.sim.dyn.effectors.torque_bars import described_bars
from bsk_torch.sim.fsw.desaturation import stored_momentum

NO_FIELD = 1e-20  # square of a magnetic field, T^2, below which bars are not used


def unload(bus: Bus) -> None:
    """Command the dipoles, A m^2, that take momentum from the wheels while attitude is controlled, else none.

    With the momentum h of the wheels relative to the body, N m s, and the magnetic field B, T, both in B, the law is::

        m = k (h x B) / |B|^2,    so that the torque is  m x B = -k (h - (h . B^) B^)

    It takes the momentum across the field away at the rate k, 1/s, while attitude control passes the torque on to the wheels.
    What lies along the field stays until the field has turned relative to it, along the orbit. Bars share m with least norm, and
    are scaled together where one of them would exceed its largest dipole, which keeps the direction of the torque (Camillo and
    Markley, "Orbit-averaged behavior of magnetic control laws for momentum unloading", Journal of Guidance and Control 3(6),
    1980).
    """
    B = mrp_to_dcm(bus.sigma_BN) @ bus.magnetic_field_N
    size2 = B.dot(B)
    acts = (size2 > NO_FIELD) & (bus.control_on > 0.0)
    wanted = stored_momentum(bus).cross(B) * (bus.bar_gain / torch.where(acts, size2, torch.ones_like(size2)))
    dipoles = [row.dot(wanted) for row in bus.bar_map]
    scale = torch.ones_like(size2)
    for dipole, most in zip(dipoles, bus.bar_max_dipole, strict=True):
        scale = torch.minimum(scale, most / torch.maximum(torch.abs(dipole), most))
    none = torch.zeros_like(size2)
    bus.bar_command = tuple(torch.where(acts, dipole * scale, none) for dipole in dipoles)


def _check_gain(args: Values, h: float) -> str | None:
    """Return words about a gain that takes more than all momentum away within a tick."""
    gain = args["barGain"].max().item()
    if gain * h <= 1.0:
        return None
    return (
        f"barGain={gain:g} 1/s takes more than the momentum of the wheels away in a tick of sim_rate={h:g} s; give at most "
        f"{1 / h:g}"
    )


ARGS = (Arg("barGain", 0.01, "1/s", "rate at which torque bars take the momentum of the wheels away", low=0.0, high=1e3),)


@functools.cache
def unloading(count: int) -> Component:
    """Return the component of the cross-product law for ``count`` bars."""
    return Component(
        slot="unloading",
        after="control",
        update=unload,
        args=ARGS,
        params=(Field("bar_gain", 1, "1/s"), Field("bar_map", 3 * count, vectors=True)),
        reads=("barAxes_B",),
        prepare=lambda args: {
            "bar_gain": args["barGain"],
            "bar_map": torch.linalg.pinv(unit_rows(args["barAxes_B"]).mT).flatten(-2),
        },
        check_tick=_check_gain,
    )


UNLOADING = Component(
    slot="unloading", after="control", update=unload, args=ARGS, fit=lambda arguments: unloading(len(described_bars(arguments)))
)
"""The cross-product law, for the bars of the dynamics model."""
