from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest
import torch

from bsk_torch.codegen.kernel import Samples
from bsk_torch.sim import dyn
from bsk_torch.sim.arguments.values import merge
from bsk_torch.sim.component import Bus, Component, Field
from bsk_torch.sim.dyn import events
from bsk_torch.sim.dyn.storage import partitions
from bsk_torch.sim.dyn.storage import store as storage
from bsk_torch.sim.environment import world
from bsk_torch.sim.environment.ephemeris import EPHEMERIS_TRACK
from bsk_torch.sim.tick.loop import Tick
from bsk_torch.sim.tick.runners import Runners, make_runners
from tests.sim.buses import plane, write
from tests.sim.run.runs import Start

TABLE = np.load(Path(__file__).parents[1] / "data" / "store.npz")
"""Recorded by record_modules.py: instrument, transmitter and store under random commands, tasks and access."""

GIVEN = {"bufferNames": None, "transmitterNumBuffers": 100.0, "storageInit": 0.0}

INPUTS = Component("inputs", state=(Field("instrument_command"), Field("station_access")))
"""What others write: here the test does, between ticks."""


class Recorded(NamedTuple):
    """A group of cases of the table."""

    h_ns: int
    parameters: torch.Tensor
    inputs: torch.Tensor
    levels: torch.Tensor
    rate: torch.Tensor

    @property
    def given(self) -> dict[str, Any]:
        """Arguments that ask for the recorded partitions; the last one of several holds what the store starts with."""
        count = self.levels.shape[2]
        names = [f"buffer {k}" for k in range(max(1, count - 1))]
        return GIVEN | {"bufferNames": names, "storageInit": 0.0 if count == 1 else torch.ones(1)}

    @property
    def args(self) -> dict[str, Any]:
        """Drawn arguments of the cases."""
        names = ("instrumentBaudRate", "transmitterBaudRate", "transmitterPacketSize", "dataStorageCapacity", "storageInit")
        return dict(zip(names, self.parameters.unbind(-1), strict=True))


def recorded(group: str) -> Recorded:
    h_ns, *rest = (TABLE[f"{group}_{name}"] for name in Recorded._fields)
    return Recorded(int(h_ns), *(torch.tensor(part, dtype=torch.float64) for part in rest))


def parts(table: Recorded) -> list[Component]:
    made = [part.fit(table.given) for part in (partitions.TRANSMITTER, partitions.PARTITIONED_STORE)]
    return [INPUTS, partitions.IMAGER, *made]


class Store:
    """The components of a group as a separate tick; the transmitter is off in mode 0 and on in mode 1."""

    def __init__(self, table: Recorded, backend: str) -> None:
        self.table, self.parts = table, parts(table)
        self.tick = Tick(self.parts, set(), table.h_ns, on_arc=False, dtype=torch.float64, opaque_field=False)
        self.runners: Runners = make_runners(self.tick, backend, torch.device("cpu"))
        n = len(table.parameters)
        self.state = self.tick.state.rows(self.merged("initial"), n).double().contiguous()
        self.own = self.tick.own.rows(self.merged("prepare"), n).contiguous()
        self.flags = torch.zeros(self.tick.flags.size, 2, dtype=torch.float64)
        self.flags[list(self.tick.flags.fields).index("transmitter_on"), 1] = 1.0
        self.ephemeris = Samples(
            torch.zeros(n, 2, EPHEMERIS_TRACK.width, dtype=torch.float64), torch.zeros(n, dtype=torch.float64)
        )

    def merged(self, what: str) -> dict[str, torch.Tensor]:
        return merge(self.table.args, self.parts, what)

    def after(self, k: int) -> torch.Tensor:
        """Levels [cases, partitions] after tick number k + 1."""
        command, into, on, access = self.table.inputs[k].unbind(-1)
        view = self.tick.state.view
        view(self.state, "instrument_command")[:], view(self.state, "station_access")[:] = command, access
        if "data_partition" in self.tick.state.fields:
            view(self.state, "data_partition")[:] = into
        packs = self.state, torch.zeros(0, 1).double(), self.own, on.long(), self.flags, torch.full_like(into, k).long()
        Start(*packs, (self.ephemeris,), self.table.h_ns).run(self.runners.run, torch.ones(len(into), dtype=torch.int64))
        levels = view(self.state, "partitions")
        return levels.reshape(-1, len(into)).mT


@pytest.mark.parametrize("group", ["second", "hundredth", "single"])
def test_basilisks_store_tick_by_tick(group, backend):
    """Bit for bit, whatever the last digits of the clock do to packets and to halves of bits."""
    table = recorded(group)
    store = Store(table, backend)
    assert len(table.levels) >= 100
    for k, levels in enumerate(table.levels):
        assert torch.equal(store.after(k), levels), k
        assert torch.equal(store.tick.state.view(store.state, "storage"), levels.sum(-1))


@pytest.mark.parametrize("group", ["second", "hundredth", "single"])
def test_basilisks_transmitter_tick_by_tick(group):
    """The rate that it reports, of which the store only feels what there is to send."""
    table = recorded(group)
    store = Store(table, "eager")
    assert len(table.rate) >= 100
    for k, rate in enumerate(table.rate):
        inputs = table.inputs[k].unbind(-1)
        bus = Bus(table.h_ns)
        for layout, pack in ((store.tick.state, store.state), (store.tick.own, store.own)):
            layout.put(bus, pack.unbind(0))
        write(bus, ticks=plane(k + 1.0, len(rate)), transmitter_on=inputs[2], station_access=inputs[3])
        partitions.transmit(bus)
        assert torch.equal(bus.transmitter_rate, rate), k
        store.after(k)


def test_the_recording_holds_what_it_is_meant_to():
    """Full stores, images that are dropped, partitions that run dry, and ticks in which a packet begins but nothing is sent."""
    second = recorded("second")
    capacity, level = second.parameters[:, 3].trunc(), second.levels.sum(-1)
    assert (level == capacity).any()
    image = (second.inputs[..., 0] > 0.0) & (second.parameters[:, 0] > 0.0)
    dropped = image[1:] & (level[:-1] + second.parameters[:, 0] > capacity)
    assert dropped.sum() > 20
    assert ((second.levels[1:] == 0.0) & (second.levels[:-1] > 0.0)).sum() > 20
    assert second.levels[..., 3].amax(0).tolist()[-1] == 0.0  # more than fits was left out
    assert min(ticks_of_silence(recorded(group)) for group in ("second", "hundredth")) >= 5


def ticks_of_silence(table: Recorded) -> int:
    """Ticks in which a packet makes progress without being sent."""
    store, count = Store(table, "eager"), 0
    for k, rate in enumerate(table.rate):
        store.after(k)
        progress = store.tick.state.view(store.state, "packet") < 0.0
        count += int(((table.inputs[k, :, 2] > 0.0) & (rate == 0.0) & progress).sum())
    return count


def bus_of(levels: list[float], **values: float) -> Bus:
    """A store of one satellite, at -4 bit/s and packets of -10 bit, in its fifth tick."""
    defaults = {"packet": 0.0, "packet_partition": 0.0, "data_partition": 0.0, "transmitter_time": 4.0, "transmitter_on": 1.0}
    defaults |= {"transmitter_baud": -4.0, "packet_size": -10.0, "storage_capacity": 100.0, "station_access": 1.0, "ticks": 5.0}
    bus = write(Bus(1_000_000_000), **{name: plane(value, 1) for name, value in (defaults | values).items()})
    return write(bus, partitions=tuple(plane(level, 1) for level in levels), storage=plane(sum(levels), 1))


@pytest.mark.parametrize(
    ("levels", "packet", "partition", "rate", "after"),
    [
        ([5.0, 20.0, 20.0], 0.0, 0, -4.0, (-4.0, 1)),  # the first of the fullest
        ([9.0, 5.0, 9.0], 0.0, 1, 0.0, (0.0, 0)),  # none holds a packet
        ([50.0, 6.0, 0.0], -4.0, 1, -4.0, (-8.0, 1)),  # a packet under way goes on, though another holds more
        ([50.0, 6.0, 0.0], -10.0, 1, -4.0, (-4.0, 0)),  # a complete one does not
        ([50.0, 3.0, 0.0], -4.0, 1, -4.0, (-3.0, 1)),  # what is left
        ([50.0, 0.0, 0.0], -4.0, 1, 0.0, (-4.0, 0)),  # run dry: the next one begins in silence
        ([9.0, 0.0, 0.0], -4.0, 1, 0.0, (0.0, 0)),  # unless there is none
        ([0.0, 0.0, 0.0], -4.0, 1, 0.0, (0.0, -1)),
    ],
)
def test_transmitter(levels, packet, partition, rate, after):
    bus = bus_of(levels, packet=packet, packet_partition=float(partition))
    partitions.transmit(bus)
    assert (bus.transmitter_rate.item(), (bus.packet.item(), bus.packet_partition.item())) == (rate, after)
    assert bus.transmitter_time.item() == 5.0


def test_transmitters_at_rest_and_after_a_pause():
    """At rest neither packet nor clock are lost; without a station the packet is."""
    bus = bus_of([50.0, 60.0], packet=-4.0, packet_partition=1.0, transmitter_on=0.0)
    partitions.transmit(bus)
    kept = (bus.transmitter_rate, bus.packet, bus.packet_partition, bus.transmitter_time)
    assert [x.item() for x in kept] == [0.0, -4.0, 1.0, 4.0]
    for access in (0.0, None):
        bus = bus_of([50.0, 60.0], packet=-4.0, packet_partition=1.0, station_access=0.0)
        if access is None:
            del bus.station_access  # a model without ground stations
        partitions.transmit(bus)
        assert [bus.transmitter_rate.item(), bus.packet.item()] == [0.0, 0.0]
    bus = bus_of([50.0, 60.0], transmitter_time=2.0)
    partitions.transmit(bus)
    assert (bus.packet.item(), bus.transmitter_rate.item()) == (-12.0, -4.0)


@pytest.mark.parametrize(
    ("instrument", "transmitter", "into", "of", "expected"),
    [
        (10.0, 0.0, 1, 0, [20.0, 40.0, 0.0]),
        (50.0, 0.0, 2, 0, [20.0, 30.0, 50.0]),  # up to the capacity exactly
        (50.5, 0.0, 2, 0, [20.0, 30.0, 0.0]),  # rounded to a bit more than fits: dropped whole
        (51.0, -9.0, 2, 0, [11.0, 30.0, 0.0]),  # what the transmitter frees comes too late
        (2.5, -2.5, 0, 1, [23.0, 27.0, 0.0]),  # halves away from zero
        (0.0, -31.0, 0, 1, [20.0, 0.0, 0.0]),  # down to nothing, not below
        (5.0, -25.0, 0, 0, [0.0, 30.0, 0.0]),
    ],
)
def test_store(instrument, transmitter, into, of, expected):
    bus = bus_of([20.0, 30.0, 0.0], data_partition=float(into), packet_partition=float(of))
    write(bus, instrument_rate=plane(instrument, 1), transmitter_rate=plane(transmitter, 1))
    partitions.store(bus)
    assert [level.item() for level in bus.partitions] == expected
    assert bus.storage.item() == sum(expected)


@pytest.mark.parametrize("h", [0.5, 1.0])
def test_an_image_takes_a_tick(h):
    bus = write(Bus(round(h * 1e9)), instrument_baud=plane(8e6, 1), instrument_command=plane(1.0, 1))
    partitions.take_images(bus)
    assert bus.instrument_rate.item() * h == 8e6
    bus.instrument_command = plane(0.0, 1)
    partitions.take_images(bus)
    assert bus.instrument_rate.item() == 0.0


@pytest.mark.parametrize(
    ("given", "names"),
    [
        ({"transmitterNumBuffers": 3}, ("0", "1", "2")),
        ({"bufferNames": ["b", "a"]}, ("b", "a")),
        ({"bufferNames": ("b",), "transmitterNumBuffers": 1.0}, ("b",)),
        ({"transmitterNumBuffers": 1, "storageInit": 5.0}, ("0", "STORED DATA")),
        ({"bufferNames": ["a"], "storageInit": lambda: 0.0}, ("a", "STORED DATA")),
    ],
)
def test_partition_names(given, names):
    assert partitions.partition_names(GIVEN | given) == names
    fitted = partitions.PARTITIONED_STORE.fit(GIVEN | given)
    fields = {field.name: field for field in fitted.state}
    assert fields["partitions"].width == len(names)
    assert ("data_partition" in fields) == (len(names) > 1)
    sender = {field.name for field in partitions.TRANSMITTER.fit(GIVEN | given).state}
    assert ("packet_partition" in sender) == (len(names) > 1)


def test_stores_and_transmitters_start_by_their_arguments():
    """Whole bits in the last partition; more than the capacity is left out."""
    args = {"storageInit": torch.tensor([99.9, 101.0, 0.0]).double(), "dataStorageCapacity": torch.tensor([100.7]).double()}
    state = partitions.partitioned_store(3, starts_with_data=True).initial(args)
    assert state["partitions"].tolist() == [[0.0, 0.0, 99.0], [0.0, 0.0, 0.0], [0.0, 0.0, 0.0]]
    assert state["storage"].tolist() == [99.0, 0.0, 0.0]
    empty = partitions.partitioned_store(2).initial({**args, "storageInit": torch.zeros(1).double()})
    assert empty["partitions"].tolist() == [[0.0, 0.0]]
    for part in (partitions.TRANSMITTER, partitions.PARTITIONED_STORE, world.GROUND_STATIONS):
        given = {arg.name: arg.default for arg in (*partitions.PARTITIONED_STORE.args, *partitions.TRANSMITTER.args, *part.args)}
        fitted = part.fit(given)
        assert (fitted.state, fitted.params, fitted.args) == (part.state, part.params, part.args)


def slots(model: type) -> dict[str, Component]:
    return {part.slot: part for part in model.all_components()}


class ContinuousFirst(dyn.ContinuousImagingDynModel, dyn.GroundStationDynModel):
    """In the order of bsk_rl's examples."""


class StationsFirst(dyn.GroundStationDynModel, dyn.ContinuousImagingDynModel):
    """In the other order."""


@pytest.mark.parametrize("model", [dyn.ContinuousImagingDynModel, ContinuousFirst, StationsFirst])
def test_continuous_imaging_stays_what_it_is(model):
    """One counter of bits, nothing else; nothing runs in the slot of the image event."""
    made = slots(model)
    assert (made["instrument"], made["transmitter"], made["storage"]) == (
        storage.INSTRUMENT,
        storage.TRANSMITTER,
        storage.STORAGE,
    )
    assert (made["image_event"].update, made["image_event"].state) == (None, ())
    assert "bufferNames" not in {arg.name for part in made.values() for arg in part.args}


@pytest.mark.parametrize("model", [dyn.ImagingDynModel, dyn.GroundStationDynModel])
def test_imaging_has_partitions_and_an_event(model):
    made = slots(model)
    assert made["instrument"] is partitions.IMAGER
    assert made["transmitter"] is partitions.TRANSMITTER
    assert made["storage"] is partitions.PARTITIONED_STORE
    assert made["image_event"] is events.IMAGE_EVENT


def test_as_many_stations_as_are_given_on_the_worlds_sphere():
    """Satellites have a radius of the same name, which is not that of the stations."""
    given = {arg.name: arg.default for arg in world.STATION_ARGS} | {"groundLocationPlanetRadius": 6e6}
    for stations in ([{"lat": 0.0, "long": 0.0}], [{"lat": 0.0, "long": 0.0}] * 9):
        part = world.GROUND_STATIONS.fit(given | {"groundStationsData": stations})
        assert {field.name: field.width for field in part.params}["station_positions_P"] == 3 * len(stations)
        args = {"groundStationsData": stations, "groundLocationPlanetRadius": torch.tensor([7e6])}
        args |= {"gsMinimumElevation": torch.tensor([0.1]), "gsMaximumRange": torch.tensor([-1.0])}
        assert part.prepare(args)["station_positions_P"][0, : len(stations)].tolist() == [6e6] * len(stations)


@pytest.mark.parametrize("wrong", [None, [], lambda: []])
def test_stations_that_cannot_be_are_left_to_their_check(wrong):
    given = {arg.name: arg.default for arg in world.STATION_ARGS} | {"groundStationsData": wrong}
    assert world.GROUND_STATIONS.fit(given).params[:3] == world.GROUND_STATIONS.params
