"""The instrument that takes images, a store of partitions, and the transmitter that empties them packet by packet.

Basilisk's simpleInstrument, spaceToGroundTransmitter and partitionedStorageUnit connected for point imaging, bit by
bit: these modules subtract times rounded to doubles of seconds, and whether a packet is complete after a tick may
hang on the last digit. How many partitions there are depends on the arguments, so transmitter and store are made to fit.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from numbers import Real
from typing import Any

import torch
from torch import Tensor

from bsk_torch.constants import NANO
from bsk_torch.sim.component import Arg, Bus, Component, Field, UserArguments, Values
from bsk_torch.sim.dyn.storage import store as storage
from bsk_torch.vec3 import only

STORED_DATA = "STORED DATA"  # the partition, after all others, that holds what the store starts with
NUM_BUFFERS = 100  # partitions where the user names none
Levels = tuple[Tensor, ...]  # data in every partition, bit


def partition_names(arguments: UserArguments) -> tuple[str, ...]:
    """Return the names of the partitions that the arguments ask for, in order; ValueError if they do not fit together."""
    names, count = arguments["bufferNames"], arguments["transmitterNumBuffers"]
    if not isinstance(count, Real) or not 1.0 <= float(count) <= storage.MOST_BUFFERS or not float(count).is_integer():
        raise ValueError(
            f"sat_args: transmitterNumBuffers={count!r} must be a whole number from 1 to {storage.MOST_BUFFERS}, the same for "
            "all environments"
        )
    count = int(float(count))
    if names is None:
        named = tuple(str(k) for k in range(count))
    else:
        named = _checked(names)
        if count not in (NUM_BUFFERS, len(named)):
            raise ValueError(f"sat_args: transmitterNumBuffers={count} differs from the number of bufferNames={list(named)}")
    return (*named, STORED_DATA) if _starts_with_data(arguments) else named


def _checked(names: Any) -> tuple[str, ...]:
    wrong = isinstance(names, str) or not isinstance(names, Sequence) or not all(isinstance(n, str) and n for n in names)
    if wrong or not names or len(set(names)) < len(names) or STORED_DATA in names:
        raise ValueError(
            f"sat_args: bufferNames={names!r} must be a list of different names, at least one and none of them {STORED_DATA!r}, "
            "the same for all environments; or None for transmitterNumBuffers partitions"
        )
    return tuple(names)


def _starts_with_data(arguments: UserArguments) -> bool:
    level = arguments["storageInit"]
    return not (isinstance(level, Real) and level == 0)


def take_images(bus: Bus) -> None:
    """Write the data rate of the instrument, bit/s, at which an image takes one tick: ``image / h`` where the command is 1.

    The flight software wrote the command one tick ago. A command that is not withdrawn persists, with an image in every tick. The
    same holds for flight software that commands no instrument, as with Basilisk's devices that get no command.
    """
    rate = bus.instrument_baud / bus.h
    bus.instrument_rate = rate * bus.instrument_command if bus.has("instrument_command") else rate


def _time(bus: Bus, ago: int = 0) -> Tensor:
    """Return the time, s, at the end of this tick or of an earlier one, rounded as in Basilisk: ``fl(nanoseconds) * 1e-9``."""
    # abs keeps compilers from fusing the product into a difference, which would round once instead of twice
    return torch.abs((bus.ticks - float(ago)) * bus.h_ns * NANO)


def _level(levels: Levels, index: Tensor) -> Tensor:
    level = levels[0]
    for k, other in enumerate(levels[1:], 1):
        level = torch.where(index == k, other, level)
    return level


def _fullest(levels: Levels, floor: Tensor) -> tuple[Tensor, Tensor]:
    """Return number and level of the first partition that holds most and more than ``floor``; -1 and ``floor`` if none does."""
    index, most = torch.full_like(floor, -1.0), floor
    for k, level in enumerate(levels):
        more = level > most
        index, most = torch.where(more, float(k), index), torch.where(more, level, most)
    return index, most


def transmit(bus: Bus) -> None:
    """Write the data rate of the transmitter, bit/s (negative), and the partition that it empties, by the levels of one tick ago.

    ``packet`` is the progress of the packet under way, in negative bits; it and its partition stay while the transmitter is off,
    whose first tick accounts for all the time since; see :func:`_send`.
    """
    one = len(bus.partitions) == 1
    source = torch.zeros_like(bus.packet) if one else bus.packet_partition
    on, now, off = bus.transmitter_on > 0.0, _time(bus), (torch.zeros_like(bus.packet), bus.packet, source)
    bus.transmitter_rate, bus.packet, bus.packet_partition = only(on, lambda: _send(bus, source, now), off)
    bus.transmitter_time = torch.where(on, now, bus.transmitter_time)


def _send(bus: Bus, source: Tensor, now: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Return data rate, packet and its partition after a tick in which the transmitter is on.

    With the progress p and the size P of a packet, the baud rate B, all three negative, the level L of the packet's partition and
    ``dt``, the time since the transmitter last ran::

        packet              its level   station     rate    packet after            partition after
        under way           L > 0       yes         B       continues from p        the same
        under way           L > 0       no          0       0                       the same
        under way           L <= 0      yes         0       starts in M, or 0       M, if it holds anything
        under way           L <= 0      no          0       0                       M, if it holds anything
        none or complete                yes         B       starts in M             M
        none or complete                no          0       0                       M

    M is the first of the partitions that hold most. A packet starts, from p = 0, if M holds a whole one, ``L_M >= -P``; if not,
    rate and packet are 0. It then continues to ``p + B dt``, or to -L where the partition holds less than ``-B dt``. So where a
    partition has run dry on the way, the next packet may start in the same tick, but nothing is sent in it.
    """
    levels, size, zero = bus.partitions, bus.packet_size, torch.zeros_like(bus.packet)
    sent = -torch.abs(bus.transmitter_baud * (now - bus.transmitter_time))
    packet = torch.where(bus.packet <= size, zero, bus.packet)
    level = _level(levels, source)
    dry, continues = (packet != 0.0) & (level <= 0.0), (packet != 0.0) & (level > 0.0)
    fullest, most = _fullest(levels, torch.where(dry, 0.0, zero - 1.0))
    source, level = torch.where(continues, source, fullest), torch.where(continues, level, most)
    access = bus.station_access if bus.has("station_access") else torch.zeros_like(bus.packet)
    works = (access > 0.0) & (continues | ((fullest >= 0.0) & (level >= -size)))
    progress = torch.where(level + sent < 0.0, -level, torch.where(continues, packet, zero) + sent)
    return torch.where(works & ~dry, bus.transmitter_baud, zero), torch.where(works, progress, zero), source


def _whole(bits: Tensor) -> Tensor:
    """Return bits, which are not negative, rounded half up."""
    down = torch.floor(bits)
    return torch.where(bits - down >= 0.5, down + 1.0, down)


def _changed(levels: Levels, index: Any, change: Tensor) -> Levels:
    if len(levels) == 1:
        return (levels[0] + change,)
    return tuple(torch.where(index == k, level + change, level) for k, level in enumerate(levels))


def store(bus: Bus) -> None:
    """Add the instrument's bits to the partition of the current task, then take the transmitter's from that of its packet.

    ``q = round(rate dt)`` with the length dt of the tick as a difference of two rounded times. Bits of a tick that would overfill
    the store are dropped whole; a partition that holds less than what is sent ends up empty.
    """
    span = _time(bus) - _time(bus, 1)
    data = _whole(torch.abs(bus.instrument_rate * span))
    fits = (data > 0.0) & (bus.storage + data <= bus.storage_capacity)
    into = None if len(bus.partitions) == 1 else bus.data_partition
    levels = only(fits, lambda: _changed(bus.partitions, into, data), bus.partitions)
    total = torch.where(fits, bus.storage + data, bus.storage)

    def drained() -> tuple[Levels, Tensor]:
        level, bits = _level(levels, bus.packet_partition), torch.abs(bus.transmitter_rate * span)
        removed = -torch.where(level - bits >= 0.0, _whole(bits), level)
        return _changed(levels, bus.packet_partition, removed), total + removed

    bus.partitions, bus.storage = only(bus.transmitter_rate < 0.0, drained, (levels, total))


def transmitter(partitions: int) -> Component:
    """Return the transmitter of a store with this many partitions."""
    state = [
        Field("packet", 1, "bit", "sent of the packet under way, negative", exact=True),
        Field("transmitter_time", 1, "s", "when the transmitter last ran", exact=True),
    ]
    if partitions > 1:
        state.append(Field("packet_partition", 1, "-", "partition that the packet comes from", exact=True))
    rate, *others = storage.TRANSMITTER.args
    return dataclasses.replace(
        storage.TRANSMITTER,
        update=transmit,
        args=(dataclasses.replace(rate, flown=None), *others),  # what a positive rate does to partitions is not that of Basilisk
        state=tuple(state),
        fit=lambda arguments: transmitter(len(partition_names(arguments))),
    )


def partitioned_store(partitions: int, starts_with_data: bool = False) -> Component:
    """Return a store of this many partitions; if it ``starts_with_data``, they are in the last one."""

    def initial(args: Values) -> dict[str, Tensor]:
        total = storage.initial_store(args)["storage"]
        levels = torch.zeros(len(total), partitions, dtype=torch.float64)
        if starts_with_data:
            levels[:, -1] = total
        return {"storage": total, "partitions": levels}

    task = (Field("data_partition", 1, "-", "partition that the instrument writes to"),) if partitions > 1 else ()
    return dataclasses.replace(
        storage.STORAGE,
        update=store,
        args=(*storage.STORAGE.args, BUFFER_NAMES),
        state=(*storage.STORAGE.state, Field("partitions", partitions, "bit", many=True, exact=True), *task),
        initial=initial,
        fit=lambda arguments: partitioned_store(len(partition_names(arguments)), _starts_with_data(arguments)),
    )


BUFFER_NAMES = Arg(
    "bufferNames", None, "-", "names of the partitions; None: transmitterNumBuffers of them, named by number", "constant"
)

IMAGER = dataclasses.replace(
    storage.INSTRUMENT,
    update=take_images,
    args=(Arg("instrumentBaudRate", 8e6, "bit", "data of one image", low=0.0, high=storage.MOST_BITS),),
)

TRANSMITTER = transmitter(NUM_BUFFERS)

PARTITIONED_STORE = partitioned_store(NUM_BUFFERS)
