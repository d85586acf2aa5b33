from typing import Any

import pytest
import torch

from bsk_torch.sim.component import Bus
from bsk_torch.sim.dyn.effectors.thrusters import ARMS, THRUST
from bsk_torch.sim.dyn.effectors.wheels import SPIN_INERTIA
from bsk_torch.sim.fsw import desaturation
from bsk_torch.vec3 import Vec3
from tests.sim.buses import N, plane, vectors, with_wheels, write


def dumping(speed: float, h: float = 1.0, **params: float) -> Bus:
    """One satellite whose x wheel spins, at the start of a desaturation."""
    bus = write(
        with_wheels(Bus(round(h * 1e9))), Omega_WB_B=Vec3(plane(speed, 1), plane(0.0, 1), plane(0.0, 1)), desat_on=plane(1.0, 1)
    )
    write(bus, pulse_command=tuple(plane(0.0, 1) for _ in range(4)))
    values = {"momentum_to_keep": 0.0, "dump_wait": 4.0, "shortest_pulse": 0.02, "dump_calls": 0.0, "dump_counter": 0.0}
    write(bus, **{name: plane(value, 1) for name, value in (values | params).items()})
    return write(bus, dump_momentum_B=Vec3.zeros_like(plane(0.0, 1)), dump_remaining=tuple(plane(0.0, 1) for _ in range(4)))


def fired(bus: Bus, ticks: int) -> list[list[float]]:
    commands = []
    for _ in range(ticks):
        desaturation.DESATURATION.update(bus)
        commands.append([pulse.item() for pulse in bus.pulse_command])
    return commands


def on_times(Omega: Vec3) -> list[float]:
    """On-time of the eight thrusters by the least-norm formula on their torques, shifted to be positive."""
    D = torch.tensor([*ARMS, *ARMS], dtype=torch.float64).mT
    h = SPIN_INERTIA * Omega.stack()[0]
    F = D.mT @ torch.linalg.inv(D @ D.mT) @ -h
    return ((F - F.min().clamp(max=0.0)) / THRUST)[:4].tolist()


def test_impulses_have_the_momentum_wanted_and_are_positive():
    dH = vectors(10.0)
    F = torch.stack(desaturation.impulses(dH, desaturation.pair_map()), -1)
    arms = torch.tensor(ARMS, dtype=torch.float64)
    # the shift adds the same to all eight thrusters, whose torques cancel
    torch.testing.assert_close(2.0 * F @ arms, dH.stack(), rtol=0, atol=1e-12)
    torch.testing.assert_close(F.amin(-1), torch.zeros(N).double(), rtol=0, atol=1e-12)


@pytest.mark.parametrize("speed", [300.0, 320.0, 340.0, 360.0])
def test_pulse_pattern(speed):
    """Nothing in the first tick, a pulse in the second, then one every five ticks until less than a tick is left."""
    bus = dumping(speed)
    times = on_times(bus.Omega_WB_B)
    commands = fired(bus, 200)
    assert commands[0] == [0.0] * 4
    for pair, time in enumerate(times):
        ticks = [k for k, command in enumerate(commands) if command[pair] == 1.0]
        assert ticks == [1 + 5 * k for k in range(int(time))]
    assert max(times) > 3.0
    assert min(times) == pytest.approx(0.0, abs=1e-12)


def test_pulses_have_remainders_and_a_shortest_length():
    """So that they tell whole ticks from rounded ones."""
    rest = [max(on_times(dumping(speed).Omega_WB_B)) % 1.0 for speed in (300.0, 320.0, 340.0, 360.0)]
    assert min(rest) < 0.4
    assert max(rest) > 0.6
    assert max(map(max, fired(dumping(5.0), 20))) == 0.0  # 0.17 s in all
    assert max(map(max, fired(dumping(300.0, h=0.01), 20))) == 1.0
    # left over one pulse of 0.01 s after the other: what remains decides, until it falls below the limit
    assert max(map(max, fired(dumping(300.0, h=0.01, shortest_pulse=1e6), 20))) == 0.0


@pytest.mark.parametrize("wait", [0.0, 1.0, 7.0])
def test_ticks_between_pulses(wait):
    bus = dumping(300.0, dump_wait=wait)
    commands = [max(command) for command in fired(bus, 30)]
    first = [k for k, command in enumerate(commands) if command][:3]
    assert first == [1, 2 + wait, 3 + 2 * wait]


def test_momentum_is_measured_once_in_the_first_tick():
    bus = dumping(300.0)
    desaturation.DESATURATION.update(bus)
    first = bus.dump_momentum_B.stack()
    assert first[0].tolist() == pytest.approx([-300.0 * SPIN_INERTIA, 0.0, 0.0])
    bus.Omega_WB_B = bus.Omega_WB_B * 2.0
    desaturation.DESATURATION.update(bus)
    assert torch.equal(bus.dump_momentum_B.stack(), first)


@pytest.mark.parametrize(("keep", "expected"), [(0.0, -10.0), (4.0, -6.0), (10.0, 0.0), (12.0, 0.0)])
def test_momentum_to_keep(keep, expected):
    Omega = Vec3(plane(0.0, 1), plane(6.0 / SPIN_INERTIA, 1), plane(8.0 / SPIN_INERTIA, 1))
    h = Omega * SPIN_INERTIA
    dH = desaturation.momentum_to_dump(h, plane(keep, 1))
    assert dH.stack()[0].tolist() == pytest.approx([0.0, 0.6 * expected, 0.8 * expected], abs=1e-12)
    assert torch.equal(desaturation.momentum_to_dump(h * 0.0, plane(keep, 1)).stack(), torch.zeros(1, 3).double())


def test_desaturation_that_is_off_commands_nothing_and_remembers():
    bus = dumping(300.0)
    fired(bus, 3)
    calls, left, counter = bus.dump_calls.item(), [x.item() for x in bus.dump_remaining], bus.dump_counter.item()
    bus.desat_on = plane(0.0, 1)
    assert max(map(max, fired(bus, 10))) == 0.0
    assert (bus.dump_calls.item(), [x.item() for x in bus.dump_remaining], bus.dump_counter.item()) == (calls, left, counter)


def test_rows_dump_alone_and_together():
    """Half of the rows desaturate: they do what they would do alone, the others nothing at all."""
    buses = [dumping(speed) for speed in (300.0, 310.0, 320.0, 330.0)]
    buses[1].desat_on = buses[3].desat_on = plane(0.0, 1)
    names = ("Omega_WB_B", "desat_on", "momentum_to_keep", "dump_wait", "shortest_pulse", *DUMP)
    together = with_wheels(Bus(1_000_000_000))
    for name in names:
        parts = [getattr(bus, name) for bus in buses]
        write(together, **{name: joined(parts)})
    for _ in range(8):
        for bus in (together, *buses):
            desaturation.DESATURATION.update(bus)
        for name in DUMP:
            assert leaves(getattr(together, name)) == leaves(joined([getattr(bus, name) for bus in buses]))
    assert together.dump_calls.tolist() == [8.0, 0.0, 8.0, 0.0]


DUMP = ("pulse_command", "dump_momentum_B", "dump_remaining", "dump_counter", "dump_calls")


def joined(parts: list[Any]) -> Any:
    """Planes of one row each as planes of many."""
    if isinstance(parts[0], torch.Tensor):
        return torch.cat(parts)
    planes = [torch.cat(columns) for columns in zip(*parts, strict=True)]
    return Vec3(*planes) if isinstance(parts[0], Vec3) else tuple(planes)


def leaves(value: Any) -> list[list[float]]:
    return [value.tolist()] if isinstance(value, torch.Tensor) else [part.tolist() for part in value]
