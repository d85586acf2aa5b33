import math
from itertools import product
from typing import Any

import pytest
import torch

from bsk_torch.astro.attitude import mrp_to_dcm
from bsk_torch.constants import AU, RPM
from bsk_torch.sim.component import Bus
from bsk_torch.sim.dyn import hub
from bsk_torch.sim.dyn.effectors import thrusters, wheels
from bsk_torch.sim.dyn.forces import drag
from bsk_torch.sim.dyn.power import balance as power
from bsk_torch.sim.dyn.power import panels
from bsk_torch.sim.dyn.storage import store as storage
from bsk_torch.vec3 import Mat3, Vec3
from tests.sim.buses import write


def number(*values: float) -> torch.Tensor:
    return torch.tensor(values, dtype=torch.float64)


def a_bus(h: float = 1.0, **values: Any) -> Bus:
    """A tick on which some values have been written: numbers become planes of one environment, triples vectors."""
    bus = Bus(round(h * 1e9))
    for name, value in values.items():
        if isinstance(value, int | float):
            value = number(value)
        elif isinstance(value, list) and len(value) == 3 and not isinstance(value[0], torch.Tensor):
            value = Vec3.of(torch.tensor([value], dtype=torch.float64))
        setattr(bus, name, value)
    return bus


@pytest.mark.parametrize(
    ("charge", "watts", "h", "expected"),
    [
        (100.0, -30.0, 1.0, 70.0),
        (20.0, -30.0, 1.0, 0.0),
        (995.0, 10.0, 1.0, 1000.0),
        (100.0, 30.0, 0.5, 115.0),
        (0.0, 5.0, 2.0, 10.0),
    ],
)
def test_battery(charge, watts, h, expected):
    bus = a_bus(h, charge=charge, power=watts, battery_capacity=1000.0)
    power.charge_battery(bus)
    assert bus.charge.item() == expected


@pytest.mark.parametrize(
    ("normal", "illumination", "share"),
    [([1, 0, 0], 1.0, 1.0), ([-1, 0, 0], 1.0, 0.0), ([0.6, 0.8, 0], 0.5, 0.3), ([0, 1, 0], 1.0, 0.0)],
)
def test_panel(normal, illumination, share):
    """1361 W/m^2 at one astronomical unit, a quarter as much at two, none from behind."""
    for distance in (AU, 2.0 * AU):
        r = [7e6, 0.0, 0.0]
        bus = a_bus(r_BN_N=r, r_SN_N=[distance + 7e6, 0.0, 0.0], sigma_BN=[0.0] * 3, panel_normal_B=normal)
        bus.panel_gain, bus.illumination = number(0.25 * 0.2), number(illumination)
        panels.collect_sunlight(bus)
        assert bus.power.item() == pytest.approx(share * 1361.0 * 0.05 * (AU / distance) ** 2, rel=1e-12)


def test_panels_follow_the_attitude_and_sinks_draw_power():
    """A quarter turn about z brings body +y to the inertial -x side."""
    bus = a_bus(
        r_BN_N=[0.0] * 3, r_SN_N=[AU, 0.0, 0.0], sigma_BN=[0.0, 0.0, math.tan(math.pi / 8)], panel_normal_B=[0.0, -1.0, 0.0]
    )
    bus.panel_gain, bus.illumination = number(1.0), number(1.0)
    panels.collect_sunlight(bus)
    assert bus.power.item() == pytest.approx(1361.0, rel=1e-12)
    bus = a_bus(power=10.0, base_power=-4.0, thruster_draw=-80.0, thruster_power=0.0)
    power.BASE_POWER.update(bus)
    power.THRUSTER_POWER.update(bus)
    assert bus.power.item() == 6.0
    bus.thruster_power = number(1.0)
    power.THRUSTER_POWER.update(bus)
    assert bus.power.item() == -74.0


@pytest.mark.parametrize(
    ("speed", "torque", "mech_to_elec", "need"),
    [
        (100.0, 0.1, 0.0, 20.0),  # accelerating costs |w u| / 0.5
        (-100.0, -0.1, 0.0, 20.0),
        (100.0, -0.1, 0.0, 0.0),  # braking is free
        (100.0, -0.1, 0.25, -2.5),  # or returns a share
        (100.0, -0.1, -1.0, 20.0),  # or costs as much as accelerating
        (100.0, 0.0, -1.0, 0.0),
        (0.0, 0.1, 0.0, 0.0),
    ],
)
def test_wheel_power(speed, torque, mech_to_elec, need):
    bus = a_bus(power=0.0, Omega_WB_B=[speed, 0.0, 0.0], motor_torque_B=[torque, 0.0, 0.0])
    bus.wheel_base_power, bus.wheel_to_battery, bus.battery_to_wheel = number(0.4), number(mech_to_elec), number(0.5)
    wheels.draw_wheel_power(bus)
    assert bus.power.item() == pytest.approx(-need - 3 * 0.4, abs=1e-12)


def test_wheel_powers_add_up():
    bus = a_bus(power=5.0, Omega_WB_B=[100.0, -50.0, 10.0], motor_torque_B=[0.1, -0.2, -0.1])
    bus.wheel_base_power, bus.wheel_to_battery, bus.battery_to_wheel = number(0.4), number(0.5), number(0.5)
    wheels.draw_wheel_power(bus)
    assert bus.power.item() == pytest.approx(5.0 - 20.0 - 20.0 + 0.5 - 1.2, abs=1e-12)


LIMIT = wheels.MAX_SPEED


@pytest.mark.parametrize(
    ("command", "u_max", "speed", "expected"),
    [
        (0.1, 0.2, 0.0, 0.1),
        (0.5, 0.2, 0.0, 0.2),
        (-0.5, 0.2, 0.0, -0.2),
        (0.5, 0.0, 0.0, 0.5),  # no limit where not positive
        (-0.5, -1.0, 0.0, -0.5),
        (0.1, 0.2, LIMIT, 0.0),  # at the limit no more of it
        (-0.1, 0.2, -LIMIT, 0.0),
        (-0.1, 0.2, LIMIT, -0.1),  # but braking
        (0.1, 0.2, -1.1 * LIMIT, 0.1),
        (0.1, 0.2, LIMIT * (1 - 1e-15), 0.1),
    ],
)
def test_motor_torque(command, u_max, speed, expected):
    bus = a_bus(motor_torque_command_B=[0.0, command, 0.0], Omega_WB_B=[0.0, speed, 0.0], max_motor_torque=u_max)
    wheels.latch_motor_torque(bus)
    assert [x.item() for x in bus.motor_torque_B] == [0.0, expected, 0.0]


def test_constants_of_wheels_and_boxes():
    assert wheels.MAX_SPEED == 6000.0 * RPM
    assert pytest.approx(0.07957747154594767, rel=1e-15) == wheels.SPIN_INERTIA
    state = wheels.WHEELS.initial({"wheelSpeeds": number(60.0, -30.0, 0.0)[None]})
    assert state["Omega_WB_B"].tolist() == [pytest.approx([2 * math.pi, -math.pi, 0.0])]
    assert INERTIA.tolist() == [pytest.approx([82.115, 98.395, 121.022], abs=1e-3)]
    args = {"oe": None, "rN": number(7e6, 0, 0)[None], "vN": number(0, 7e3, 0)[None], "omega_init": number(0, 0, 0)[None]}
    state = hub.HUB.initial(args | {"sigma_init": number(2.0, 0.0, 0.0)[None]})
    assert state["sigma_BN"].tolist() == [[-0.5, 0.0, 0.0]]
    bus = a_bus(density=1.0, density_message=2.0)
    drag.DRAG.update(bus)
    assert bus.density.item() == 2.0


@pytest.mark.parametrize(
    ("level", "instrument", "transmitter", "h", "expected"),
    [
        (0.0, 10.0, 0.0, 1.0, 10.0),
        (89.0, 10.0, 0.0, 1.0, 99.0),
        (90.0, 10.0, 0.0, 1.0, 100.0),  # up to the capacity exactly
        (91.0, 10.0, 0.0, 1.0, 91.0),  # more than fits: the whole tick is dropped
        (95.0, 10.0, 0.0, 1.0, 95.0),
        (95.0, 10.0, -5.0, 1.0, 90.0),  # the drop does not depend on what the transmitter frees
        (89.0, 10.0, -5.0, 1.0, 94.0),
        (3.0, 0.0, -5.0, 1.0, 0.0),  # down to nothing, not below
        (5.0, 0.0, -5.0, 1.0, 0.0),
        (0.0, 0.0, -5.0, 1.0, 0.0),
        (50.0, 0.0, 0.0, 1.0, 50.0),
        (100.0, 0.0, 0.0, 1.0, 100.0),  # full from the start
        (100.0, 0.0, -30.0, 1.0, 70.0),
        (0.0, 2.5, 0.0, 1.0, 3.0),  # halves are rounded away from zero
        (0.0, 2.4999, 0.0, 1.0, 2.0),
        (50.0, 0.0, -2.5, 1.0, 47.0),
        (2.0, 0.0, -2.5, 1.0, 0.0),
        (0.0, 5.0, 0.0, 0.5, 3.0),
        (0.0, 3.0, 0.0, 0.5, 2.0),
        (0.0, 3.0, -1.0, 1.0, 2.0),  # the transmitter removes what the instrument has just written
    ],
)
def test_store(level, instrument, transmitter, h, expected):
    bus = a_bus(h, storage=level, storage_capacity=100.0, instrument_rate=instrument, transmitter_rate=transmitter)
    storage.store(bus)
    assert bus.storage.item() == expected


@pytest.mark.parametrize(("command", "linked", "rate"), [(1.0, 1.0, 4e6), (0.0, 1.0, 0.0), (1.0, 0.0, 0.0)])
def test_instrument(command, linked, rate):
    bus = a_bus(instrument_baud=4e6, instrument_command=command, instrument_linked=linked)
    storage.run_instrument(bus)
    assert bus.instrument_rate.item() == rate


def test_a_store_of_basilisk_fills_up_exactly(recording):
    """1.2e9 bits of room are 300 seconds at 4 Mbit/s: Basilisk takes the last of them, and no more."""
    full = recording("full")
    capacity = full["fixed"]["dataStorageCapacity"]
    room = [capacity - initial["storageInit"] for initial in full["ic"]]
    assert {x % full["fixed"]["instrumentBaudRate"] for x in room} == {0.0}
    assert full["state"][:, full["columns"].index("storage")].max() == capacity


def test_sizes_of_stores_and_packets():
    args = {"storageInit": number(99.9, 100.4, 101.0), "dataStorageCapacity": number(100.7)}
    assert storage.STORAGE.initial(args)["storage"].tolist() == [99.0, 100.0, 0.0]
    assert storage.STORAGE.prepare(args)["storage_capacity"].tolist() == [100.0]
    args = {"transmitterPacketSize": None, "transmitterBaudRate": number(-1.0), "instrumentBaudRate": number(5.0)}
    assert storage.TRANSMITTER.prepare(args)["packet_size"].item() == -5.0
    assert storage.TRANSMITTER.prepare(args | {"transmitterPacketSize": number(-7.0)})["packet_size"].item() == -7.0


@pytest.mark.parametrize(
    ("packet", "idle", "level", "access", "rate", "after"),
    [
        (0.0, 0.0, 9.0, 1.0, 0.0, 0.0),  # less than a packet: nothing starts
        (0.0, 0.0, 10.0, 1.0, -4.0, -4.0),  # a whole one: it does
        (0.0, 0.0, 10.0, 0.0, 0.0, 0.0),  # but not without a station
        (-4.0, 0.0, 6.0, 1.0, -4.0, -8.0),  # a packet under way needs no whole one left
        (-4.0, 0.0, 6.0, 0.0, 0.0, 0.0),  # and is lost with the station
        (-8.0, 0.0, 50.0, 1.0, -4.0, -12.0),
        (-12.0, 0.0, 50.0, 1.0, -4.0, -4.0),  # sent: the next one starts from zero
        (-12.0, 0.0, 9.0, 1.0, 0.0, 0.0),  # or does not
        (-10.0, 0.0, 9.0, 1.0, 0.0, 0.0),  # exactly one packet is one
        (-4.0, 0.0, 3.0, 1.0, -4.0, -3.0),  # the store runs out: progress is what was left
        (-4.0, 0.0, 4.0, 1.0, -4.0, -8.0),  # not where it lasts exactly
        (-4.0, 0.0, 0.0, 1.0, 0.0, 0.0),  # empty under way: given up
        (0.0, 0.0, 0.0, 1.0, 0.0, 0.0),
        (0.0, 9.0, 100.0, 1.0, -4.0, -40.0),  # the first tick accounts for all the time since the last
        (0.0, 9.0, 20.0, 1.0, -4.0, -20.0),  # up to what the store holds
    ],
)
def test_transmitter(packet, idle, level, access, rate, after):
    bus = a_bus(packet=packet, idle=idle, storage=level, station_access=access, transmitter_on=1.0)
    bus.transmitter_baud, bus.packet_size = number(-4.0), number(-10.0)
    storage.transmit(bus)
    assert (bus.transmitter_rate.item(), bus.packet.item(), bus.idle.item()) == (rate, after, 0.0)


def test_transmitter_at_rest():
    """Neither packet nor clock are lost."""
    bus = a_bus(packet=-4.0, idle=3.0, storage=50.0, station_access=1.0, transmitter_on=0.0)
    bus.transmitter_baud, bus.packet_size = number(-4.0), number(-10.0)
    storage.transmit(bus)
    assert [x.item() for x in (bus.transmitter_rate, bus.packet, bus.idle)] == [0.0, -4.0, 4.0]


def test_a_downlink_from_start_to_end():
    """25 bits go in packets of three ticks, 12 bits: two of them, then 1 bit is too little to start another."""
    bus = a_bus(packet=0.0, idle=0.0, storage=25.0, station_access=1.0, transmitter_on=1.0, instrument_rate=0.0)
    bus.transmitter_baud, bus.packet_size, bus.storage_capacity = number(-4.0), number(-10.0), number(100.0)
    levels = []
    for _ in range(9):
        storage.transmit(bus)
        storage.store(bus)
        levels.append(bus.storage.item())
    assert levels == [21.0, 17.0, 13.0, 9.0, 5.0, 1.0, 1.0, 1.0, 1.0]


SIDES = {"width": 1.38, "depth": 1.04, "height": 1.58, "panelArea": 1.3}


def facets() -> list[tuple[float, tuple, tuple]]:
    """Area, normal and location of every facet, as bsk_rl lists them; the second location's sign is its own."""
    w, d, h, panel = SIDES.values()
    return [
        (w * d, (1, 0, 0), (h / 2, 0, 0)),
        (w * d, (-1, 0, 0), (h / 2, 0, 0)),
        (h * w, (0, 1, 0), (0, d / 2, 0)),
        (h * w, (0, -1, 0), (0, -d / 2, 0)),
        (h * d, (0, 0, 1), (0, 0, w / 2)),
        (h * d, (0, 0, -1), (0, 0, -w / 2)),
        (panel / 2, (0, 1, 0), (0, h, 0)),
        (panel / 2, (0, -1, 0), (0, h, 0)),
    ]


@pytest.mark.parametrize("signs", list(product((1, -1), repeat=3)))
def test_drag_is_the_sum_over_facets(signs):
    velocity = torch.tensor([5000.0, 3000.0, 4500.0], dtype=torch.float64) * torch.tensor(signs)
    args = {name: number(value) for name, value in SIDES.items()} | {"dragCoeff": number(2.2)}
    params = drag.DRAG.prepare(args)
    bus = a_bus(density=1e-11, drag_coefficient=2.2)
    bus.facet_areas, bus.facet_offsets = (tuple(params[name].unbind(-1)) for name in ("facet_areas", "facet_offsets"))
    force, torque = drag.drag(bus, Vec3.of(velocity[None]))
    flow = velocity / velocity.norm()
    expected_force, expected_torque = torch.zeros(3).double(), torch.zeros(3).double()
    for area, normal, location in facets():
        projected = area * (torch.tensor(normal, dtype=torch.float64) @ flow)
        if projected > 0:
            part = -0.5 * velocity.norm() ** 2 * 2.2 * projected * 1e-11 * flow
            expected_force += part
            expected_torque += torch.linalg.cross(torch.tensor(location, dtype=torch.float64), part)
    torch.testing.assert_close(force.stack()[0], expected_force, rtol=1e-13, atol=0)
    torch.testing.assert_close(torque.stack()[0], expected_torque, rtol=1e-12, atol=1e-18)
    assert force.stack()[0] @ flow < 0


INERTIA = hub.box_inertia(number(330.0), number(1.38), number(1.04), number(1.58))


def spacecraft(h: float = 1.0, n: int = 20) -> Bus:
    """Tumbling spacecraft with wheels at some 500 rpm, which make them nutate with 0.05 rad/s."""
    bus = Bus(round(h * 1e9))
    bus.inertia_B = Vec3(*(x.expand(n) for x in INERTIA.unbind(-1)))
    bus.sigma_BN, bus.omega_BN_B, bus.Omega_WB_B = (
        Vec3.of(scale * torch.randn(n, 3, dtype=torch.float64)) for scale in (0.3, 0.01, 50.0)
    )
    bus.motor_torque_B = Vec3.of(0.1 * torch.randn(n, 3, dtype=torch.float64))
    bus.effectors = (wheels.WHEELS.effector,)
    return bus


def momentum(bus: Bus) -> torch.Tensor:
    """Angular momentum of hub and wheels in N; the hub's inertia includes the wheels'."""
    return (mrp_to_dcm(bus.sigma_BN).mT @ (bus.inertia_B.scale(bus.omega_BN_B) + bus.Omega_WB_B * wheels.SPIN_INERTIA)).stack()


def drift(h: float, seconds: int = 64) -> float:
    """Largest relative change of the momentum with motor torques that change every eight seconds."""
    torch.manual_seed(3)
    bus = spacecraft(h)
    before = momentum(bus)
    for _ in range(seconds // 8):
        bus.motor_torque_B = Vec3.of(0.1 * torch.randn(20, 3, dtype=torch.float64))
        for _ in range(round(8 / h)):
            hub.rotate(bus)
    assert (bus.sigma_BN.norm() <= 1.0).all()
    return ((momentum(bus) - before).norm(dim=-1) / before.norm(dim=-1)).amax().item()


def test_conservation_of_momentum_and_energy():
    """Up to the truncation of Runge-Kutta, which falls at least with the fourth power of the tick."""
    assert drift(1.0) < 1e-5
    assert drift(0.125) < 1e-5 / 8**4
    assert drift(0.125) > 0.0
    # Without wheels: Euler's equations.
    bus = spacecraft()
    del bus.Omega_WB_B, bus.motor_torque_B, bus.effectors
    energy = bus.omega_BN_B.dot(bus.inertia_B.scale(bus.omega_BN_B))
    before = (mrp_to_dcm(bus.sigma_BN).mT @ bus.inertia_B.scale(bus.omega_BN_B)).stack()
    for _ in range(300):
        hub.rotate(bus)
    after = (mrp_to_dcm(bus.sigma_BN).mT @ bus.inertia_B.scale(bus.omega_BN_B)).stack()
    torch.testing.assert_close(bus.omega_BN_B.dot(bus.inertia_B.scale(bus.omega_BN_B)), energy, rtol=1e-8, atol=0)
    assert ((after - before).norm(dim=-1) / before.norm(dim=-1)).amax() < 1e-6


def test_rotation_is_of_fourth_order():
    """Halving the tick divides the error of half a minute by sixteen."""
    results = []
    for h in (2.0, 1.0, 0.5, 0.0625):
        torch.manual_seed(3)
        bus = spacecraft(h)
        for _ in range(round(32 / h)):
            hub.rotate(bus)
        results.append(torch.cat([mrp_to_dcm(bus.sigma_BN).stack().flatten(1), bus.omega_BN_B.stack()], -1))
    errors = [(result - results[-1]).norm().item() for result in results[:-1]]
    assert math.log2(errors[0] / errors[1]) == pytest.approx(4.0, abs=0.4)
    assert math.log2(errors[1] / errors[2]) == pytest.approx(4.0, abs=0.2)


def test_torques_of_motors_and_disturbances_act_on_wheels_and_hub():
    """From rest about one axis: u / Js - omega' on the wheel, -u / (I - Js) on the hub."""
    bus = a_bus(h=1.0, sigma_BN=[0.0] * 3, omega_BN_B=[0.0] * 3, Omega_WB_B=[0.0] * 3, motor_torque_B=[0.0, 0.1, 0.0])
    bus.inertia_B, bus.effectors = Vec3(*INERTIA.unbind(-1)), (wheels.WHEELS.effector,)
    hub.rotate(bus)
    rate = -0.1 / (INERTIA[0, 1].item() - wheels.SPIN_INERTIA)
    assert bus.omega_BN_B.y.item() == pytest.approx(rate, rel=1e-12)
    assert bus.Omega_WB_B.y.item() == pytest.approx(0.1 / wheels.SPIN_INERTIA - rate, rel=1e-12)
    assert bus.sigma_BN.y.item() == pytest.approx(math.tan(rate / 2 / 4), rel=1e-9)
    torques = {}
    for name in ("disturbance_torque_B", "pulse"):
        bus = a_bus(h=1.0, sigma_BN=[0.0] * 3, omega_BN_B=[0.0] * 3, Omega_WB_B=[0.0] * 3, motor_torque_B=[0.0] * 3)
        bus.inertia_B = Vec3(*INERTIA.unbind(-1))
        pulse = tuple(number(x) for x in (1.0, 0.0, 0.0, 0.0))
        setattr(bus, name, pulse if name == "pulse" else thrusters.pair_torque(pulse))
        bus.effectors = (wheels.WHEELS.effector, *((thrusters.THRUSTERS.effector,) if name == "pulse" else ()))
        hub.rotate(bus)
        torques[name] = bus.omega_BN_B.stack() * (INERTIA - wheels.SPIN_INERTIA)
    # beyond the sixth only products of the rates, 1e-2 rad/s, that the pulse brings about
    torch.testing.assert_close(6.0 * torques["pulse"], torques["disturbance_torque_B"], rtol=0.01, atol=1e-3)


def test_drag_keeps_the_attitude_in_its_type():
    """Integrated with an orbit in float64, an attitude in float32 stays float32: kernels refuse to mix them unawares."""
    single = lambda *values: Vec3.of(torch.tensor([values], dtype=torch.float32))
    bus = a_bus(
        r_BN_N=[6.6e6, 0.0, 0.0], v_BN_N=[0.0, 7.7e3, 0.0], r_SN_N=[AU, 0.0, 0.0], v_SN_N=[0.0] * 3, cos_earth=1.0, sin_earth=0.0
    )
    write(bus, dtype=torch.float32, EN=Mat3(*(Vec3.of(row[None]) for row in torch.eye(3).double())), mass=number(330.0))
    write(bus, sigma_BN=single(0.1, 0.2, 0.3), omega_BN_B=single(1e-3, 0.0, 0.0), Omega_WB_B=single(10.0, 0.0, 0.0))
    write(bus, motor_torque_B=single(0.1, 0.0, 0.0), density=number(1e-9), drag_coefficient=number(2.2))
    params = drag.DRAG.prepare({name: number(value) for name, value in SIDES.items()} | {"dragCoeff": number(2.2)})
    bus.facet_areas, bus.facet_offsets = (tuple(params[name].float().unbind(-1)) for name in ("facet_areas", "facet_offsets"))
    bus.inertia_B, bus.effectors = Vec3(*INERTIA.float().unbind(-1)), (wheels.WHEELS.effector, drag.DRAG.effector)
    hub.translate_and_rotate(bus, 10)
    assert {x.dtype for x in (*bus.r_BN_N, *bus.v_BN_N)} == {torch.float64}
    assert {x.dtype for x in (*bus.sigma_BN, *bus.omega_BN_B, *bus.Omega_WB_B)} == {torch.float32}
