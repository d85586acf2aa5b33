from __future__ import annotations

import pytest
import torch

from bsk_torch.codegen.inductor import just_in_time
from bsk_torch.sim.component import Bus
from bsk_torch.sim.dyn.effectors import thrusters
from tests.codegen.columns import mapped

SECOND = 1_000_000_000


def number(*values: float) -> torch.Tensor:
    return torch.tensor(values, dtype=torch.float64)


# -- geometry ---------------------------------------------------------------------------------------------------------------


def test_thruster_geometry():
    """Pairs of opposite thrusters: no net force, and the arms that Basilisk's configuration has."""
    arms = torch.tensor(thrusters.ARMS, dtype=torch.float64)
    for position, direction, arm in zip(thrusters.POSITIONS, thrusters.DIRECTIONS, arms, strict=True):
        p, d = (torch.tensor(x, dtype=torch.float64) for x in (position, direction))
        torch.testing.assert_close(torch.linalg.cross(p, d), arm, rtol=0, atol=1e-15)
        torch.testing.assert_close(torch.linalg.cross(-p, -d), arm, rtol=0, atol=1e-15)
        assert d.norm().item() == pytest.approx(1.0, abs=1e-15)
    assert arms[:, :2].abs().flatten().tolist() == pytest.approx([0.602773] * 8, abs=1e-6)
    assert arms[:, 2].abs().tolist() == pytest.approx([0.825500] * 4, abs=1e-6)
    assert torch.linalg.matrix_rank(arms) == 3


def test_pulse_torque():
    torque = thrusters.pair_torque(tuple(number(x) for x in (1.0, 0.0, 0.0, 1.0)))
    arms = torch.tensor(thrusters.ARMS, dtype=torch.float64)
    torch.testing.assert_close(torque.stack()[0], 2 * 0.9 * (arms[0] + arms[3]), rtol=0, atol=1e-15)


# -- pulses -----------------------------------------------------------------------------------------------------------------

MISSED = (14, 28, 57, 114, 228, 456, 912, 1825, 3650, 7301, 14602, 29205)
"""Ticks of 1 s at whose pulses Basilisk's rounding puts the end before the stage (measured on Basilisk)."""


def latched(ticks: torch.Tensor, h_ns: int) -> torch.Tensor:
    """Whether pulses of all pairs, commanded in the tick before, are latched in ticks [n]: 1 or 0."""
    bus = Bus(h_ns)
    bus.ticks, bus.pulse_command = ticks, tuple(torch.ones_like(ticks) for _ in range(4))
    thrusters.latch_pulses(bus)
    assert all(torch.equal(pulse, bus.pulse[0]) for pulse in bus.pulse)
    return bus.pulse[0]


def clock(count: int) -> torch.Tensor:
    """Numbers of the first ticks after a reset."""
    return torch.arange(1, count + 1, dtype=torch.float64)


def test_pulses_are_consumed_once():
    bus = Bus(SECOND)
    bus.pulse_command = tuple(number(x) for x in (1.0, 0.0, 1.0, 0.0))
    for tick, expected in ((2.0, [1.0, 0.0, 1.0, 0.0]), (3.0, [0.0] * 4)):
        bus.ticks = number(tick)
        thrusters.latch_pulses(bus)
        assert [x.item() for x in bus.pulse] == expected
        assert [x.item() for x in bus.pulse_command] == [0.0] * 4


def test_a_missed_pulse_is_consumed_too():
    bus = Bus(SECOND)
    bus.pulse_command = tuple(number(1.0) for _ in range(4))
    for tick in (MISSED[0] + 1.0, MISSED[0] + 2.0):
        bus.ticks = number(tick)
        thrusters.latch_pulses(bus)
        assert [x.item() for x in bus.pulse + bus.pulse_command] == [0.0] * 8


def test_missed_pulses_of_one_second():
    """A pulse written at tick t is latched at t + 1 and compared with the stage at t + 1."""
    missed = torch.nonzero(latched(clock(30_000), SECOND) == 0.0).squeeze(-1) + 1
    assert (missed - 1).tolist() == list(MISSED)


def test_missed_pulses_of_a_tenth_of_a_second():
    """22 % of the first 2000 s; the share goes up and down with the exponent of the clock."""
    assert 1.0 - latched(clock(20_000), SECOND // 10).mean().item() == pytest.approx(0.22, abs=0.005)


def expected_pulses(count: int, h_ns: int) -> list[bool]:
    """The comparison in plain doubles."""
    return [h_ns * 1e-9 + (k * h_ns) * 1e-9 >= ((k + 1) * h_ns) * 1e-9 for k in range(count)]


@pytest.mark.parametrize("h_ns", [SECOND // 10, SECOND // 2, SECOND, 2 * SECOND, 1_234_567_891])
def test_missed_pulses_by_python_floats(h_ns):
    expected = expected_pulses(5000, h_ns)
    assert latched(clock(5000), h_ns).tolist() == expected
    assert 0 < 5000 - sum(expected) < 1300


def as_function(ticks: torch.Tensor, h_ns: int) -> torch.Tensor:
    bus = Bus(h_ns)
    bus.ticks, bus.pulse_command = ticks, (torch.ones_like(ticks),)
    thrusters.latch_pulses(bus)
    return bus.pulse[0]


@pytest.mark.compiled
def test_compilers_round_as_basilisk_does():
    """A fused multiply-add would round once where Basilisk rounds twice: measured, none of 545 pulses would be missed."""
    h_ns, ticks = SECOND // 10, clock(5000)
    expected = expected_pulses(5000, h_ns)
    kernel = mapped(lambda x, _: [as_function(x[0], h_ns)], 1, 0, "test of pulses")
    assert kernel(ticks.unsqueeze(0))[0].tolist() == expected
    assert just_in_time(lambda x: as_function(x, h_ns), "test of pulses")(ticks).tolist() == expected
