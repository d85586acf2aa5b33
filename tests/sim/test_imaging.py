import math
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import torch

from bsk_torch.astro.earth_rotation import pole_matrix
from bsk_torch.astro.ephemeris import earth_angles, earth_orientation, parse_utc
from bsk_torch.astro.orbit import Elements, elements_to_rv
from bsk_torch.constants import MU_EARTH, R_EARTH
from bsk_torch.rand import first_key
from bsk_torch.sim import dyn, fsw
from bsk_torch.sim.component import Bus
from bsk_torch.sim.dyn import events
from bsk_torch.sim.dyn.events import DISARMED
from bsk_torch.sim.fsw import guidance, instrument, target
from bsk_torch.sim.simulator import Simulator
from bsk_torch.vec3 import Vec3
from tests.sim.buses import plane, write
from tests.sim.simulators import make_simulator

CONTROLLER = np.load(Path(__file__).with_name("data") / "controller.npz")
"""Recorded by scripts/recorders/record_modules.py: simpleInstrumentController under random errors, access and tasks."""


def controlled(sigma: float, omega: float, **values: float) -> Bus:
    """A controller of one satellite that sees these errors."""
    bus, zero = Bus(1_000_000_000), plane(0.0, 1)
    along = lambda size: Vec3(plane(0.6 * size, 1), zero, plane(-0.8 * size, 1))
    bus.error = guidance.Error(along(sigma), along(omega), along(9.0), along(9.0))
    defaults = {"attitude_tolerance": 0.1, "rate_tolerance": 0.01, "location_on": 1.0, "controller_on": 1.0}
    defaults |= {"target_access": 1.0, "instrument_command": 0.0, "image_taken": 0.0}
    return write(bus, **{name: plane(value, 1) for name, value in (defaults | values).items()})


@pytest.mark.parametrize(
    ("error", "rate", "controller", "location", "before", "after"),
    [
        (0.05, 0.001, 1.0, 1.0, 0.0, 1.0),
        (0.1, 0.01, 1.0, 1.0, 0.0, 1.0),  # limits are inclusive
        (0.11, 0.001, 1.0, 1.0, 1.0, 0.0),
        (0.05, 0.011, 1.0, 1.0, 1.0, 0.0),
        (0.05, 0.001, 0.0, 1.0, 1.0, 0.0),  # controller off
        (0.5, 0.5, 0.0, 0.0, 1.0, 1.0),  # outside of the task the last command stays
        (0.05, 0.001, 1.0, 0.0, 0.0, 0.0),
    ],
)
def test_scanning_controller(error, rate, controller, location, before, after):
    bus = controlled(error, rate, controller_on=controller, location_on=location, instrument_command=before)
    instrument.command_scan(bus)
    assert bus.instrument_command.item() == after
    bus.target_access = plane(0.0, 1)
    instrument.command_scan(bus)
    assert bus.instrument_command.item() == (after if location == 0.0 else 0.0)


def test_basilisks_image_controller_tick_by_tick():
    """Once for each task, in the first tick in which everything is right; between tasks the last command stays."""
    command = taken = plane(0.0, 1)
    attitude, rate = CONTROLLER["tolerances"].tolist()
    commands = []
    for sigma, omega, access, status, new, on in CONTROLLER["inputs"].tolist():
        bus = controlled(sigma, omega, attitude_tolerance=attitude, rate_tolerance=rate, target_access=access)
        write(bus, controller_on=plane(status, 1), location_on=plane(on, 1), instrument_command=command)
        bus.image_taken = plane(0.0, 1) if new else taken
        instrument.command_image(bus)
        command, taken = bus.instrument_command, bus.image_taken
        commands.append(int(command))
    assert commands == CONTROLLER["command"].tolist()
    repeated = np.diff(CONTROLLER["command"]) == 0
    assert (repeated & (CONTROLLER["command"][1:] == 1)).any()  # a command that was not taken back
    assert sum(commands) >= 20


H = 2.0
EPOCH = parse_utc("2021-05-04T00:00:00")


def aimed(target_P: torch.Tensor, r: torch.Tensor, elevation: float, reach: float, location: float = 1.0) -> Bus:
    """What the target says of positions [N, 3] in N, all of them a tick before the epoch."""
    bus, n = Bus(round(H * 1e9)), len(r)
    epoch = torch.full((n,), EPOCH, dtype=torch.float64)
    bus.ephemeris, bus.ephemeris_tau = [SimpleNamespace(earth_angle=earth_angles(epoch)[2])], torch.zeros_like(epoch)
    write(bus, EN=pole_matrix(epoch), r_BN_N=Vec3.of(r), r_LP_P=Vec3.of(target_P), location_on=plane(location, n))
    args = {"imageTargetMinimumElevation": plane(elevation, 1), "imageTargetMaximumRange": plane(reach, 1)}
    write(bus, **target.IMAGE_TARGET.prepare(args))
    target.aim_at_place(False, False)(bus)
    return bus


@pytest.mark.parametrize("reach", [-1.0, 1.2e6])
@pytest.mark.parametrize("elevation", [1.0, 45.0, 80.0])
def test_a_target_sees_what_is_above_its_limit_and_within_its_range(elevation, reach):
    """By angles, though the comparison is one of squares. The Earth as it was one tick ago, but for the pole's 8e-12 rad/s."""
    n = 4000
    places = R_EARTH * torch.nn.functional.normalize(torch.randn(n, 3, dtype=torch.float64), dim=-1)
    PN = earth_orientation(torch.tensor(EPOCH - H, dtype=torch.float64))
    up = torch.nn.functional.normalize(places + 1e6 * torch.randn(n, 3, dtype=torch.float64), dim=-1)
    r = 7.1e6 * up @ PN  # from P to N
    bus = aimed(places, r, math.radians(elevation), reach)
    torch.testing.assert_close(bus.r_LN_N.stack(), places @ PN, rtol=0, atol=8e-12 * H * R_EARTH * 1.1)
    line = r @ PN.mT - places
    distance = line.norm(dim=-1)
    margin = torch.asin((line * places).sum(-1) / (distance * R_EARTH)) - math.radians(elevation)
    assert margin.abs().min() > 1e-8  # so that rounding decides nothing
    expected = (margin > 0.0) & ((distance < reach) | (reach < 0.0))
    assert torch.equal(bus.target_access == 1.0, expected)
    assert expected.any()
    assert not expected.all()


def test_places_without_access():
    """Its squared elevation would be as good."""
    places = torch.tensor([[R_EARTH, 0.0, 0.0], [-R_EARTH, 0.0, 0.0]], dtype=torch.float64)
    PN = earth_orientation(torch.tensor(EPOCH - H, dtype=torch.float64))
    r = torch.tensor([[7e6, 0.0, 0.0]], dtype=torch.float64).expand(2, 3) @ PN
    assert aimed(places, r, math.radians(45.0), -1.0).target_access.tolist() == [1.0, 0.0]
    places = torch.tensor([[R_EARTH, 0.0, 0.0]], dtype=torch.float64)
    bus = aimed(places, places * 1.1, 0.5, -1.0, location=0.0)
    assert bus.target_access.item() == 0.0
    assert (bus.r_LN_N.stack() == 0.0).all()


def test_targets_before_and_beside_images():
    state = target.IMAGE_TARGET.initial({"groundLocationPlanetRadius": torch.tensor([R_EARTH], dtype=torch.float64)})
    assert state["r_LP_P"].tolist() == [[R_EARTH + 1000.0, 0.0, 0.0]]
    position = Vec3.of(torch.tensor([[7e6, 0.0, 0.0]], dtype=torch.float64))
    bus = write(Bus(1_000_000_000), EN=pole_matrix(torch.zeros(1, dtype=torch.float64)), r_BN_N=position)
    for limit, reaches in ((-1.0, 1.0), (6.9e6, 0.0), (7.1e6, 1.0)):
        target.aim_at_earth_centre(write(bus, target_range=plane(limit, 1)))
        assert bus.target_access.item() == reaches
    assert bus.r_LN_N.stack()[0].tolist() == pytest.approx([0.0, 0.0, 0.1], abs=1e-12)


def test_the_event_fires_once():
    """When the first partition holds more than at the time of the task; the rest of the store does not matter."""
    bus = write(Bus(1_000_000_000), image_level=torch.tensor([5.0, 5.0, math.inf, 5.0]).double(), images=plane(2.0, 4))
    bus.partitions = torch.tensor([5.0, 5.5, 9.0, 6.0]).double(), plane(1e9, 4)
    events.notice_image(bus)
    assert (bus.stop.tolist(), bus.images.tolist()) == ([False, True, False, True], [2.0, 3.0, 2.0, 3.0])
    assert bus.image_level.tolist() == [5.0, DISARMED, math.inf, DISARMED]
    bus.stop = torch.tensor([True, False, False, False])  # of another event
    events.notice_image(bus)
    assert (bus.stop.tolist(), bus.images.tolist()) == ([True, False, False, False], [2.0, 3.0, 2.0, 3.0])


MODES = ("image", "image", "image", "charge", "downlink", "desat", "drift", "image")
"""Mode of each row. Rows 0 to 2 are near places that they image, the last is not."""

ARGS: dict[str, Any] = {
    "oe": [6.871e6, 0.0, 0.9, 0.3, 0.0, 0.2],
    "sigma_init": [0.1, 0.2, -0.1],
    "omega_init": [1e-3, -1e-3, 0.0],
    "wheelSpeeds": [100.0, -200.0, 300.0],
    "u_max": 0.4,
    "instrumentBaudRate": 8e6,
    "transmitterBaudRate": -3e6,
    "bufferNames": ["sea", "land"],
    "storageInit": 16e6,
    "storedCharge_Init": 2e5,
    "imageRateErrorRequirement": 0.01,
    "K1": 0.5,
    "omega_max": math.radians(5.0),
    "servo_P": 30.0,
}
"""The servo is one that does not oscillate: with bsk_rl's default gains rounding grows to degrees within minutes."""

WORLD = {"utc_init": "2015 JUN 02 10:20:30.000 (UTC)", "gsMinimumElevation": math.radians(-60.0)}
TICKS = 160


def imager(backend: str) -> Simulator:
    """Satellites on one orbit in different modes, each image row with a place ahead of it and a partition; images end runs."""
    n = len(MODES)
    models = dyn.GroundStationDynModel, fsw.SteeringImagerFSWModel
    options = dict(num_envs=n, dtype=torch.float64, sim_rate=1.0, horizon=600.0, stops=True)
    simulator = make_simulator(*models, ARGS, WORLD, orbit="arc", backend=backend, **options)
    simulator.reset(
        simulator.state.all_rows, simulator.type.arguments.draw(first_key(n)), torch.full((n,), 600.0, dtype=torch.float64)
    )
    modes = torch.cat([simulator.mode_index(mode)[:1] for mode in MODES])
    simulator.command(torch.ones(n, dtype=torch.bool), modes)
    view = simulator.tick.state.view
    view(simulator.state.planes, "r_LP_P")[:] = places().mT
    view(simulator.state.planes, "data_partition")[:] = torch.tensor([0, 1, 0, 0, 0, 0, 0, 1])
    view(simulator.state.planes, "image_level")[:3] = view(simulator.state.planes, "partitions")[0, :3]
    return simulator


def places() -> torch.Tensor:
    """Places under the orbit, [N, 3] m in P: those of rows 0 to 2 are passed within the run, that of the last one later."""
    anomaly = torch.tensor([0.2, 0.25, 0.3, 0.2, 0.2, 0.2, 0.2, 1.5], dtype=torch.float64)
    a, e, i, Omega, omega, _ = (torch.full_like(anomaly, x) for x in ARGS["oe"])
    r, _ = elements_to_rv(Elements(a, e, i, Omega, omega, anomaly), torch.tensor(MU_EARTH))
    up = (r.unit() * R_EARTH).stack()
    return up @ earth_orientation(torch.tensor(parse_utc(WORLD["utc_init"]), dtype=torch.float64)).mT


@pytest.fixture(scope="module")
def imagers(backend) -> Simulator:
    """After some minutes under each back end."""
    simulator = imager(backend)
    simulator.run(torch.full((len(MODES),), TICKS))
    return simulator


def test_each_task_takes_one_image_into_its_partition(imagers):
    """What the store starts with is its own partition, which only a downlink empties."""
    levels = imagers.read("partitions")
    image = ARGS["instrumentBaudRate"]
    assert levels[:3].tolist() == [[image, 0.0, 2.0 * image], [0.0, image, 2.0 * image], [image, 0.0, 2.0 * image]]
    assert (levels[4, 2] < 2.0 * image) & (levels[4, :2] == 0.0).all()
    assert levels[[3, 5, 6, 7]].tolist() == [[0.0, 0.0, 2.0 * image]] * 4
    assert torch.equal(imagers.read("storage"), levels.sum(-1))
    assert imagers.read("image_taken").tolist() == [1.0] * 3 + [0.0] * 5
    assert imagers.read("instrument_command").tolist() == [0.0] * 8
    assert imagers.read("images").tolist() == [1.0, 0.0, 1.0] + [0.0] * 5  # events watch the first partition


def test_models_tell_levels(imagers):
    model = dyn.GroundStationDynModel(imagers)
    assert torch.equal(model.partition_levels, imagers.read("partitions"))
    assert torch.equal(model.storage_level, imagers.read("storage"))
    assert torch.equal(model.storage_level_fraction, model.storage_level / 1.6e8)
    assert model.data_storage_valid().all()


@pytest.mark.compiled
def test_kernels_and_loops_agree():
    """Counts exactly; the attitude to what rounding becomes in some minutes of slews (measured 1e-12)."""
    eager, compiled = imager("eager"), imager("compiled")
    for simulator in (eager, compiled):
        simulator.run(torch.full((len(MODES),), TICKS))
    assert torch.equal(eager.ticks, compiled.ticks)
    store = ("partitions", "storage", "packet", "packet_partition", "transmitter_time")
    for name in (*store, "images", "image_taken", "image_level"):
        assert torch.equal(eager.read(name), compiled.read(name)), name
    for name, bound in {"sigma_BN": 1e-9, "omega_BN_B": 1e-10, "Omega_WB_B": 1e-7, "control_integral_B": 1e-9}.items():
        torch.testing.assert_close(eager.read(name), compiled.read(name), rtol=0, atol=bound)


def test_a_command_left_over_records_in_every_tick(backend):
    """Satellites that are tasked again in the very tick in which the image was ordered; a new image task ends it."""
    simulator, rows = imager(backend), torch.arange(len(MODES)) == 0
    simulator.tick.state.view(simulator.state.planes, "image_level")[:] = math.inf
    one = torch.ones(len(MODES), dtype=torch.int64)
    while simulator.read("instrument_command")[0] == 0.0:
        simulator.run(one)
    simulator.command(rows, simulator.mode_index("charge"))
    simulator.run(5 * one)
    assert simulator.read("partitions")[0, 0] == 5 * 8e6
    simulator.command(rows, simulator.mode_index("image"))
    simulator.run(5 * one)  # one more image in the first tick; the turn back has not ended
    assert simulator.read("partitions")[0, 0] == 6 * 8e6


@pytest.mark.nightly("eager")
def test_the_image_ends_the_run(backend):
    """With the tick that stores the image, one after the one that orders it."""
    simulator = imager(backend)
    simulator.run(torch.full((len(MODES),), TICKS))
    ticks = simulator.ticks
    assert (ticks[[0, 2]] < TICKS).all()
    assert (ticks[[1, 3, 4, 5, 6, 7]] == TICKS).all()
    assert simulator.read("images")[[0, 2]].tolist() == [1.0, 1.0]
    free = imager(backend)
    free.run(ticks - 1)
    assert (free.read("images") == 0.0).all()
    assert free.read("instrument_command")[[0, 2]].tolist() == [1.0, 1.0]


def test_float32_has_the_same_data():
    """Counters are exact in the mixed mode, too, here without ground stations and with feedback control."""
    models = dyn.ImagingDynModel, fsw.ImagingFSWModel
    args = {name: value for name, value in ARGS.items() if name not in ("K1", "omega_max", "servo_P")}
    options = dict(num_envs=2, dtype=torch.float32, sim_rate=1.0, horizon=600.0, backend="eager")
    simulator = make_simulator(*models, args, {"utc_init": WORLD["utc_init"]}, **options)
    simulator.reset(
        simulator.state.all_rows, simulator.type.arguments.draw(first_key(2)), torch.full((2,), 600.0, dtype=torch.float64)
    )
    simulator.tick.state.view(simulator.state.planes, "r_LP_P")[:] = places()[2:3].mT
    simulator.command(torch.ones(2, dtype=torch.bool), simulator.mode_index("image"))
    simulator.run(torch.tensor([TICKS, 1]))
    assert simulator.read("partitions").tolist() == [[8e6, 0.0, 16e6], [0.0, 0.0, 16e6]]
