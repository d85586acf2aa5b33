"""Instrument, transmitter and a storage unit with a single partition that counts whole bits.

Basilisk's simpleInstrument, spaceToGroundTransmitter and simpleStorageUnit.
"""

from __future__ import annotations

import functools

import torch
from torch import Tensor

from bsk_torch.sim.component import Arg, Bus, Component, Field, Values
from bsk_torch.sim.dyn.power.balance import power_arg, sink
from bsk_torch.sim.instruments import each_value

MOST_BITS = 2.0**53  # bound of data and of data rates, bit and bit/s: above it whole bits are not exact
MOST_BUFFERS = 1000  # bound of the number of partitions, each of which is part of the state


def run_instrument(bus: Bus) -> None:
    """Write the data rate of the instrument, bit/s: its baud rate if the command of one tick ago is 1 and the mode links it.

    Under flight software that commands no instrument it always records, as Basilisk's devices do that get no command.
    """
    commanded = bus.has("instrument_command")
    rate = bus.instrument_baud
    bus.instrument_rate = rate * bus.instrument_command * bus.instrument_linked if commanded else rate


def transmit(bus: Bus) -> None:
    """Write the data rate of the transmitter, bit/s (negative), by the level of the store of one tick ago.

    ``packet`` p is the progress of the packet under way, in negative bits down to ``packet_size`` P, B the baud rate, both
    negative, and L the level. With the time ``dt = idle + h`` since the transmitter last ran, all of which its first tick
    accounts for, a tick in which it is on does::

        packet              level       station     rate    packet after
        under way           L > 0       yes         B       p + B dt where L + B dt >= 0, else -L
        under way           L <= 0      any         0       0
        none or complete    L >= -P     yes         B       B dt where L + B dt >= 0, else -L
        none or complete    L < -P      any         0       0
        any                 any         no          0       0

    Where it is off, p stays and ``idle`` grows. Without ground stations there is never one: nothing is sent.
    """
    level, rate, size = bus.storage, bus.transmitter_baud, bus.packet_size
    zero = torch.zeros_like(level)
    packet = torch.where(bus.packet <= size, zero, bus.packet)
    empty = (packet != 0.0) & (level <= 0.0)
    sent = rate * (bus.idle + bus.h)
    starved = (packet == 0.0) & (level < -size)
    access = bus.station_access if bus.has("station_access") else zero
    sends = (access > 0.0) & ~empty & ~starved
    progress = torch.where(level + sent < 0.0, -level, packet + sent)
    on = bus.transmitter_on > 0.0
    bus.packet = torch.where(on, torch.where(sends, progress, zero), bus.packet)
    bus.transmitter_rate = torch.where(on & sends, rate + zero, zero)
    bus.idle = torch.where(on, zero, bus.idle + bus.h)


def level_after(level: Tensor, rate: Tensor, bus: Bus) -> Tensor:
    """Return the level, bit, after one node with a ``rate``, bit/s.

    ``L + q`` with ``q = round(rate h)``, half away from zero, where that is within the capacity or the rate is not positive, but
    0 where ``L + rate h < 0``. Data of a tick that would overfill the store are dropped whole.
    """
    bits = rate * bus.h
    whole = torch.sign(bits) * torch.floor(torch.abs(bits) + 0.5)
    accepted = (level + whole <= bus.storage_capacity) | (rate <= 0.0)
    after = torch.where(level + bits >= 0.0, level + whole, torch.zeros_like(level))
    return torch.where(accepted, after, level)


def store(bus: Bus) -> None:
    """Add the instrument's bits, then remove the transmitter's."""
    bus.storage = level_after(level_after(bus.storage, bus.instrument_rate, bus), bus.transmitter_rate, bus)


def _packet_size(args: Values) -> dict[str, Tensor]:
    size = args["transmitterPacketSize"]
    return {
        "transmitter_baud": args["transmitterBaudRate"],
        "packet_size": -functools.reduce(torch.minimum, each_value(args, "instrumentBaudRate")) if size is None else size,
    }


def initial_store(args: Values) -> dict[str, Tensor]:
    """Return the level that the store starts with: whole bits, 0 if they are more than the capacity."""
    level, capacity = torch.trunc(args["storageInit"]), torch.trunc(args["dataStorageCapacity"])
    return {"storage": torch.where(level <= capacity, level, torch.zeros_like(level))}


INSTRUMENT_POWER = sink(
    "instrument_draw", power_arg("instrumentPowerDraw", -30.0, "power while imaging, negative"), "instrument_power"
)
TRANSMITTER_POWER = sink(
    "transmitter_draw", power_arg("transmitterPowerDraw", -15.0, "power while downlinking, negative"), "transmitter_on"
)

INSTRUMENT = Component(
    slot="instrument",
    update=run_instrument,
    args=(Arg("instrumentBaudRate", 8e6, "bit/s", "data rate while imaging", low=0.0, high=MOST_BITS),),
    params=(Field("instrument_baud", 1, "bit/s", exact=True),),
    prepare=lambda args: {"instrument_baud": args["instrumentBaudRate"]},
    flags=("instrument_linked",),
)

TRANSMITTER = Component(
    slot="transmitter",
    update=transmit,
    args=(
        Arg(
            "transmitterBaudRate",
            -8e6,
            "bit/s",
            "data rate of the downlink, negative",
            low=-MOST_BITS,
            high=0.0,
            flown=(-MOST_BITS, MOST_BITS),
        ),
        Arg(
            "transmitterPacketSize", None, "bit", "packet, negative; None: one second of the instrument", low=-MOST_BITS, high=0.0
        ),
        Arg("transmitterNumBuffers", 100.0, "-", "partitions of a partitioned store", low=1.0, high=MOST_BUFFERS, whole=True),
    ),
    state=(Field("packet", 1, "bit", "sent of the packet under way, negative", exact=True), Field("idle", 1, "s", exact=True)),
    params=(Field("transmitter_baud", 1, "bit/s", exact=True), Field("packet_size", 1, "bit", exact=True)),
    reads=("instrumentBaudRate", "instruments"),
    prepare=_packet_size,
    flags=("transmitter_on",),
    idle_flags=("transmitter_on",),
)

STORAGE = Component(
    slot="storage",
    update=store,
    args=(
        Arg("dataStorageCapacity", 1.6e8, "bit", "storage capacity; no limit where infinite", low=0.0, endless=True),
        Arg("storageInit", 0.0, "bit", "initial storage level", low=0.0),
        Arg("storageUnitValidCheck", False, "-", "whether a full store kills the spacecraft", "constant", choices=(True, False)),
    ),
    state=(Field("storage", 1, "bit", "data in the buffer", exact=True),),
    params=(Field("storage_capacity", 1, "bit", exact=True),),
    initial=initial_store,
    prepare=lambda args: {"storage_capacity": torch.trunc(args["dataStorageCapacity"])},
)
