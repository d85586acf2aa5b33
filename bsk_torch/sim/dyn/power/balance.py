"""Power sinks and battery: Basilisk's simplePowerSink and simpleBattery."""

from __future__ import annotations

import torch

from bsk_torch.rand import Uniform
from bsk_torch.sim.component import Arg, Bus, Component, Field, Values

MOST_POWER = 1e12  # bound of powers, W


def charge_battery(bus: Bus) -> None:
    """Integrate the power P of the end of the tick over the tick: ``E = min(max(E + P h, 0), capacity)``, W s."""
    charge = torch.clamp(bus.charge + bus.power * bus.h, min=0.0)
    bus.charge = torch.minimum(charge, bus.battery_capacity)


def _check_battery(args: Values) -> None:
    if bool((args["storedCharge_Init"] > args["batteryStorageCapacity"]).any()):
        raise ValueError(
            f"storedCharge_Init={args['storedCharge_Init'].max().item():g} W s is above "
            f"batteryStorageCapacity={args['batteryStorageCapacity'].min().item():g} W s; set sat_args['storedCharge_Init'], too"
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
    state=(Field("charge", 1, "W s", "energy in the battery", exact=True),),
    params=(Field("battery_capacity", 1, "W s", exact=True),),
    initial=lambda args: {"charge": args["storedCharge_Init"]},
    prepare=lambda args: {"battery_capacity": args["batteryStorageCapacity"]},
    check=_check_battery,
)
