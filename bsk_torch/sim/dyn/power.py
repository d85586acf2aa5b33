"""Solar panel, power sinks and battery: Basilisk's simpleSolarPanel, simplePowerSink and simpleBattery."""

from __future__ import annotations

from collections.abc import Callable

import torch
from torch import Tensor

from bsk_torch.astro.attitude import mrp_to_dcm
from bsk_torch.constants import AU, SOLAR_FLUX
from bsk_torch.rand import Uniform
from bsk_torch.sim.component import Arg, Bus, Component, Field, Values, vec

AXIS_BOUNDS = -1e9, 1e9
"""Bounds of the components of vectors of which only the direction counts."""

MOST_POWER = 1e12
"""Bound of powers, W."""


def unit_rows(vectors: Tensor) -> Tensor:
    """Return rows [n, 3] scaled to length one."""
    return vectors / vectors.norm(dim=-1, keepdim=True)


def check_axis(name: str) -> Callable[[Values], None]:
    """A check that the argument ``name`` has a direction."""

    def check(args: Values) -> None:
        if bool((args[name].norm(dim=-1) <= 0.0).any()):
            raise ValueError(f"{name}=[0, 0, 0] has no direction; give a vector in B, such as [0, 0, 1]")

    return check


def collect_sunlight(bus: Bus) -> None:
    """Start the power balance, W, with the solar panel.

    ``P = 1361 W/m^2 (AU / d)^2 A eta nu max(n . s^, 0)`` with the area A, m^2, the efficiency eta, the illumination nu of
    :mod:`bsk_torch.astro.eclipse`, the panel's normal n in B and the direction ``s^ = [BN] (r_SN - r_BN) / d`` of the Sun, both
    positions at the end of the tick.
    """
    to_sun = bus.r_SN_N - bus.r_BN_N
    distance2 = to_sun.dot(to_sun)
    s_hat_B = mrp_to_dcm(bus.sigma_BN) @ (to_sun / torch.sqrt(distance2)).to(bus.dtype)
    cosine = torch.clamp(s_hat_B.dot(bus.panel_normal_B), min=0.0)
    flux = (SOLAR_FLUX * AU * AU / distance2).to(bus.dtype)
    bus.power = flux * bus.panel_gain * bus.illumination * cosine


def charge_battery(bus: Bus) -> None:
    """Integrate the power P of the end of the tick over the tick: ``E = min(max(E + P h, 0), capacity)``, W s."""
    charge = torch.clamp(bus.charge + bus.power * bus.h, min=0.0)
    bus.charge = torch.minimum(charge, bus.battery_capacity)


def _check_battery(args: Values) -> None:
    if bool((args["storedCharge_Init"] > args["batteryStorageCapacity"]).any()):
        raise ValueError(
            f"storedCharge_Init={args['storedCharge_Init'].max().item():g} W s is above "
            f"batteryStorageCapacity={args['batteryStorageCapacity'].min().item():g} W s"
        )


PANEL = Component(
    slot="panel",
    update=collect_sunlight,
    args=(
        Arg("panelArea", 1.0, "m^2", "area of the solar panel", low=0.0, high=1e6),
        Arg("panelEfficiency", 0.2, "-", "share of sunlight turned into power", low=0.0, high=1.0),
        Arg("nHat_B", (0.0, 0.0, -1.0), "-", "panel normal in B", "vector", *AXIS_BOUNDS),
    ),
    params=(Field("panel_gain", 1, "m^2"), vec("panel_normal_B")),
    prepare=lambda args: {
        "panel_gain": args["panelArea"] * args["panelEfficiency"],
        "panel_normal_B": unit_rows(args["nHat_B"]),
    },
    check=check_axis("nHat_B"),
)


def power_arg(name: str, default: float, doc: str) -> Arg:
    """Return an argument that is a power, W."""
    return Arg(name, default, "W", doc, low=-MOST_POWER, high=MOST_POWER)


def sink(slot: str, arg: Arg, flag: str | None) -> Component:
    """Return a device that adds the power of ``arg``, W, to the balance while the mode's ``flag`` is set; negative draws."""

    def draw(bus: Bus) -> None:
        power = getattr(bus, slot)
        bus.power = bus.power + (power * getattr(bus, flag) if flag else power)

    flags = (flag,) if flag else ()
    prepare = lambda args: {slot: args[arg.name]}  # noqa: E731
    return Component(slot, draw, (arg,), params=(Field(slot, 1, "W"),), prepare=prepare, flags=flags, idle_flags=flags)


BASE_POWER = sink("base_power", power_arg("basePowerDraw", 0.0, "power always drawn, negative"), None)
THRUSTER_POWER = sink(
    "thruster_draw", power_arg("thrusterPowerDraw", 0.0, "power while desaturating, negative"), "thruster_power"
)

BATTERY = Component(
    slot="battery",
    update=charge_battery,
    args=(
        Arg("batteryStorageCapacity", 288000.0, "W s", "battery capacity", low=1e-6, high=1e18),
        Arg("storedCharge_Init", Uniform(108000.0, 252000.0), "W s", "initial charge", low=0.0),
    ),
    state=(Field("charge", 1, "W s", exact=True),),
    params=(Field("battery_capacity", 1, "W s", exact=True),),
    initial=lambda args: {"charge": args["storedCharge_Init"]},
    prepare=lambda args: {"battery_capacity": args["batteryStorageCapacity"]},
    check=_check_battery,
)
