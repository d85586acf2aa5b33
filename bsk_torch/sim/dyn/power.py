"""Solar panel, power sinks and battery."""

from __future__ import annotations

from collections.abc import Callable

import torch
from torch import Tensor

from bsk_torch.astro.attitude import mrp_to_dcm
from bsk_torch.constants import AU, SOLAR_FLUX
from bsk_torch.rand import Uniform
from bsk_torch.sim.component import Arg, Bus, Component, Field, Values, vec


def unit_rows(vectors: Tensor) -> Tensor:
    """Rows [n, 3] scaled to length one."""
    return vectors / vectors.norm(dim=-1, keepdim=True)


def check_axis(name: str) -> Callable[[Values], None]:
    """A check that the argument ``name`` has a direction."""

    def check(args: Values) -> None:
        if bool((args[name].norm(dim=-1) <= 0.0).any()):
            raise ValueError(f"{name}=[0, 0, 0] has no direction; give a vector in B, such as [0, 0, 1]")

    return check


def collect_sunlight(bus: Bus) -> None:
    """Start the power balance with the panel: ``1361 W/m^2 (AU/d)^2 * illumination * max(A n.s, 0) * efficiency``."""
    to_sun = bus.r_sun - bus.r
    distance2 = to_sun.dot(to_sun)
    s_hat_B = mrp_to_dcm(bus.sigma) @ (to_sun / torch.sqrt(distance2)).to(bus.dtype)
    cosine = torch.clamp(s_hat_B.dot(bus.panel_normal), min=0.0)
    flux = (SOLAR_FLUX * AU * AU / distance2).to(bus.dtype)
    bus.power = flux * bus.panel_gain * bus.illumination * cosine


def charge_battery(bus: Bus) -> None:
    """Integrate the power of the end of the tick over the tick, within the capacity."""
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
    order=213,
    update=collect_sunlight,
    args=(
        Arg("panelArea", 1.0, "m^2", "area of the solar panel", low=0.0),
        Arg("panelEfficiency", 0.2, "-", "share of sunlight turned into power", low=0.0, high=1.0),
        Arg("nHat_B", (0.0, 0.0, -1.0), "-", "panel normal in B", kind="vector"),
    ),
    params=(Field("panel_gain", 1, "m^2"), vec("panel_normal")),
    prepare=lambda args: {
        "panel_gain": args["panelArea"] * args["panelEfficiency"],
        "panel_normal": unit_rows(args["nHat_B"]),
    },
    check=check_axis("nHat_B"),
)


def sink(slot: str, arg: Arg, flag: str | None) -> Component:
    """A device that draws the power of ``arg`` (negative numbers draw) while the mode's ``flag`` is set."""

    def draw(bus: Bus) -> None:
        power = getattr(bus, slot)
        bus.power = bus.power + (power * getattr(bus, flag) if flag else power)

    return Component(slot, 215, draw, (arg,), params=(Field(slot, 1, "W"),), prepare=lambda args: {slot: args[arg.name]})


BASE_POWER = sink("base_power", Arg("basePowerDraw", 0.0, "W", "power always drawn, negative"), None)
THRUSTER_POWER = sink("thruster_draw", Arg("thrusterPowerDraw", 0.0, "W", "power while desaturating, negative"), "thruster_power")

BATTERY = Component(
    slot="battery",
    order=217,
    update=charge_battery,
    args=(
        Arg("batteryStorageCapacity", 288000.0, "W s", "battery capacity", low=0.0),
        Arg("storedCharge_Init", Uniform(108000.0, 252000.0), "W s", "initial charge", low=0.0),
    ),
    state=(Field("charge", 1, "W s", exact=True),),
    params=(Field("battery_capacity", 1, "W s", exact=True),),
    initial=lambda args: {"charge": args["storedCharge_Init"]},
    prepare=lambda args: {"battery_capacity": args["batteryStorageCapacity"]},
    check=_check_battery,
)
