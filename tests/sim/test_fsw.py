from __future__ import annotations

import math
from typing import Any

import pytest
import torch

from bsk_torch.astro.attitude import dcm_to_mrp, mrp_add, mrp_rate, mrp_subtract, mrp_to_dcm
from bsk_torch.astro.orbit import Elements, elements_to_rv, hill_frame
from bsk_torch.sim.component import Bus
from bsk_torch.sim.dyn.hub import box_inertia
from bsk_torch.sim.dyn.thrusters import ARMS, THRUST
from bsk_torch.sim.dyn.wheels import SPIN_INERTIA
from bsk_torch.sim.fsw import BasicFSWModel, ContinuousImagingFSWModel, Mode, control, desaturation, guidance, instrument
from bsk_torch.sim.fsw.modes import FLAGS
from bsk_torch.vec3 import Vec3

N = 40
ROUNDING = 1e-13


def vectors(scale: float = 1.0) -> Vec3:
    return Vec3.of(scale * torch.randn(N, 3, dtype=torch.float64))


def plane(value: float, n: int = N) -> torch.Tensor:
    return torch.full((n,), value, dtype=torch.float64)


def write(bus: Bus, **values: Any) -> Bus:
    for name, value in values.items():
        setattr(bus, name, value)
    return bus


def pointing(h: float = 1.0) -> Bus:
    """Satellites somewhere in orbit, pointing at random, about to point at something far away; all laws are on."""
    bus = write(
        Bus(round(h * 1e9)), r=vectors(7e6), v=vectors(7e3), sigma=mrp_add(vectors(0.3), vectors(0.3)), omega=vectors(0.01)
    )
    guidance.navigate(bus)
    for task in ("location", "sun"):
        memory = {f"{task}_fresh": plane(1.0), f"{task}_sigma": Vec3.zeros_like(plane(0.0))}
        write(bus, **memory)
    write(bus, location_on=plane(1.0), sun_on=plane(1.0), nadir_on=plane(1.0))
    write(bus, panel_normal=vectors().unit(), r_sun=vectors(1.5e11))
    return write(bus, instrument_axis=vectors().unit(), target_N=vectors(1e8))


LAWS = {"sun": guidance.point_at_sun, "nadir": guidance.point_along_hill, "location": guidance.point_at_location}
"""In the order of a tick."""


# -- location pointing ------------------------------------------------------------------------------------------------------


def direct_error(bus: Bus) -> torch.Tensor:
    """Principal rotation from target direction to axis: ``-tan(phi / 4) e`` with ``phi = acos(p . x)``, ``e = p x x``."""
    x = (mrp_to_dcm(bus.sigma) @ (bus.target_N - bus.r)).unit()
    phi = torch.acos(bus.instrument_axis.dot(x).clamp(-1.0, 1.0))
    return (bus.instrument_axis.cross(x).unit() * (-torch.tan(phi / 4.0))).stack()


def test_location_pointing_error():
    bus = pointing()
    guidance.point_at_location(bus)
    torch.testing.assert_close(bus.error.sigma_BR.stack(), direct_error(bus), rtol=1e-10, atol=1e-12)
    assert torch.equal(bus.location_sigma.stack(), bus.error.sigma_BR.stack())
    assert (bus.location_fresh == 0.0).all()


def test_the_reference_points_at_the_target():
    """[RN] of sigma_RN = sigma_BN (+) -sigma_BR maps the line of sight to the axis."""
    bus = pointing()
    guidance.point_at_location(bus)
    RN = mrp_to_dcm(mrp_add(bus.sigma, -bus.error.sigma_BR))
    torch.testing.assert_close((RN @ (bus.target_N - bus.r).unit()).stack(), bus.instrument_axis.stack(), rtol=0, atol=ROUNDING)


@pytest.mark.parametrize("angle", [0.0, 1e-9, 1e-4, 1.0, math.pi - 1e-6])
def test_location_pointing_keeps_its_digits(angle):
    bus = pointing()
    zero = plane(0.0)
    write(bus, r=Vec3(zero, zero, zero), sigma=Vec3(zero, zero, zero), instrument_axis=Vec3(zero, zero, zero + 1.0))
    guidance.navigate(bus)
    bus.target_N = Vec3(zero + math.sin(angle), zero, zero + math.cos(angle)) * 1e8
    guidance.point_at_location(bus)
    expected = [0.0, -math.tan(angle / 4.0), 0.0]
    found = bus.error.sigma_BR.stack()[0].tolist()
    assert found == pytest.approx(expected, rel=1e-9, abs=1e-24)


def test_rate_error_of_the_first_tick_is_that_about_the_line_of_sight():
    bus = pointing()
    guidance.point_at_location(bus)
    x = (bus.BN @ (bus.target_N - bus.r)).unit()
    error = bus.error
    torch.testing.assert_close(error.omega_BR.stack(), (x * bus.omega.dot(x)).stack(), rtol=0, atol=ROUNDING)
    torch.testing.assert_close(error.omega_RN.stack(), (bus.omega - error.omega_BR).stack(), rtol=0, atol=ROUNDING)
    assert (error.domega_RN.stack() == 0.0).all()


@pytest.mark.parametrize("h", [0.5, 1.0])
def test_rate_error_of_later_ticks_is_a_finite_difference(h):
    bus = pointing(h)
    guidance.point_at_location(bus)
    first = bus.location_sigma
    bus.sigma = mrp_add(bus.sigma, vectors(1e-3))
    guidance.navigate(bus)
    guidance.point_at_location(bus)
    error = bus.error
    x = (bus.BN @ (bus.target_N - bus.r)).unit()
    without_damping = error.omega_BR - x * bus.omega.dot(x)
    rate = mrp_rate(error.sigma_BR, without_damping)  # the difference is what this rate would have changed
    torch.testing.assert_close(rate.stack(), ((error.sigma_BR - first) / h).stack(), rtol=0, atol=1e-12)


def test_a_pointing_law_that_is_off_remembers_what_it_had():
    bus = pointing()
    bus.location_on = torch.where(torch.arange(N) % 2 == 0, plane(1.0), plane(0.0))
    bus.location_sigma = vectors()
    before = bus.location_sigma.stack()
    guidance.point_at_location(bus)
    assert torch.equal(bus.location_sigma.stack()[1::2], before[1::2])
    assert (bus.location_sigma.stack()[::2] != before[::2]).all()
    assert bus.location_fresh.tolist() == [0.0, 1.0] * (N // 2)


def test_sun_pointing_uses_the_panel():
    bus = pointing()
    write(bus, panel_normal=bus.instrument_axis, r_sun=bus.target_N)
    guidance.point_at_location(bus)
    location = bus.error
    guidance.navigate(bus)
    guidance.point_at_sun(bus)
    for found, expected in zip(bus.error, location, strict=True):
        assert torch.equal(found.stack(), expected.stack())


# -- hill pointing ----------------------------------------------------------------------------------------------------------


def test_hill_pointing():
    oe = (plane(7e6), plane(0.1), *torch.rand(4, N, dtype=torch.float64))
    bus = pointing()
    bus.r, bus.v = elements_to_rv(Elements(*oe))
    guidance.point_along_hill(bus)
    error, HN, BN = bus.error, hill_frame(bus.r, bus.v), mrp_to_dcm(bus.sigma)
    torch.testing.assert_close(mrp_to_dcm(error.sigma_BR).stack(), BN.stack() @ HN.stack().mT, rtol=0, atol=1e-12)
    # rate and acceleration of the frame from the orbit at close times
    dt, mu = 1e-2, 398600.436e9
    acceleration = bus.r * (-mu / bus.r.norm() ** 3)

    def frame_at(t: float) -> torch.Tensor:
        jerk = (bus.v - bus.r * (3.0 * bus.r.dot(bus.v) / bus.r.dot(bus.r))) * (-mu / bus.r.norm() ** 3)
        r = bus.r + bus.v * t + acceleration * (t * t / 2) + jerk * (t**3 / 6)
        v = bus.v + acceleration * t + jerk * (t * t / 2)
        rate = r.cross(v).norm() / r.dot(r)
        return hill_frame(r, v).z.stack() * rate.unsqueeze(-1)

    omega, domega = frame_at(0.0), (frame_at(dt) - frame_at(-dt)) / (2 * dt)
    torch.testing.assert_close(error.omega_RN.stack(), (BN @ Vec3.of(omega)).stack(), rtol=0, atol=1e-15)
    torch.testing.assert_close(error.domega_RN.stack(), (BN @ Vec3.of(domega)).stack(), rtol=0, atol=1e-12)
    torch.testing.assert_close(error.omega_BR.stack(), (bus.omega - error.omega_RN).stack(), rtol=0, atol=1e-15)


def test_nadir_means_x_outward():
    """At the reference attitude the error vanishes and body x is radial."""
    bus = pointing()
    bus.sigma = dcm_to_mrp(hill_frame(bus.r, bus.v))
    guidance.navigate(bus)
    guidance.point_along_hill(bus)
    assert bus.error.sigma_BR.norm().amax() < ROUNDING
    torch.testing.assert_close((bus.BN @ bus.r.unit()).stack(), torch.eye(3).double()[:1].expand(N, 3), rtol=0, atol=ROUNDING)


# -- tracking error ---------------------------------------------------------------------------------------------------------


def stacked(error: guidance.Error) -> torch.Tensor:
    """All errors of a law, [N, 12]."""
    return torch.cat([part.stack() for part in error], -1)


def test_without_a_law_the_reference_is_at_rest_in_n():
    bus = pointing()
    zero = torch.zeros(N, 3, dtype=torch.float64)
    for found, expected in zip(bus.error, (bus.sigma.stack(), bus.omega.stack(), zero, zero), strict=True):
        assert torch.equal(found.stack(), expected)


def test_the_law_that_is_on_is_tracked():
    """Bit for bit what that law says alone; rows without one keep the error of rest."""
    bus = pointing()
    expected = {"rest": stacked(bus.error)}
    for task, law in LAWS.items():
        law(bus)
        expected[task] = stacked(bus.error)
    assert len({e[0, 0].item() for e in expected.values()}) == 4
    guidance.navigate(bus)
    for k, task in enumerate(LAWS):
        write(bus, **{f"{task}_on": (torch.arange(N) % 4 == k).double()})
        if task != "nadir":
            write(bus, **{f"{task}_fresh": plane(1.0), f"{task}_sigma": Vec3.zeros_like(plane(0.0))})
    for law in LAWS.values():
        law(bus)
    for k, task in enumerate((*LAWS, "rest")):
        assert torch.equal(stacked(bus.error)[k::4], expected[task][k::4])


@pytest.mark.parametrize("task", LAWS)
def test_laws_in_single_precision(task):
    """Positions stay float64 until they are directions, so only the rounding of attitudes remains."""
    torch.manual_seed(8)
    exact = pointing()
    LAWS[task](exact)
    torch.manual_seed(8)
    bus = pointing()
    bus.dtype = torch.float32
    for name in ("sigma", "omega", "instrument_axis", "panel_normal", f"{task}_sigma"):
        if bus.has(name):
            setattr(bus, name, getattr(bus, name).to(torch.float32))
    guidance.navigate(bus)
    LAWS[task](bus)
    assert all(x.dtype == torch.float32 for part in bus.error for x in part)
    # measured up to 4e-6, where an axis points almost away from its target; elsewhere a few roundings of 6e-8
    torch.testing.assert_close(stacked(bus.error).double(), stacked(exact.error), rtol=0, atol=1e-5)


# -- control ----------------------------------------------------------------------------------------------------------------

INERTIA = box_inertia(*(torch.tensor([x], dtype=torch.float64) for x in (330.0, 1.38, 1.04, 1.58)))


def controlled(Ki: float = -1.0, h: float = 1.0) -> Bus:
    bus = write(Bus(round(h * 1e9)), K=plane(7.0), P=plane(35.0), Ki=plane(Ki), control_on=plane(1.0), control_idle=plane(-1.0))
    zero = Vec3.zeros_like(plane(0.0))
    write(bus, inertia=Vec3(*(x.expand(N) for x in INERTIA.unbind(-1))), control_integral=zero, motor_torque_command=zero)
    return write(bus, error=guidance.Error(vectors(0.3), vectors(0.01), vectors(1e-3), vectors(1e-6)))


def feedback(bus: Bus, integral: torch.Tensor | None = None) -> torch.Tensor:
    """Wheel torque by matrix algebra: opposite of the body torque that Basilisk's mrpFeedback requests."""
    s, w, w_R, dw_R = (v.stack() for v in bus.error)
    K, P, Ki = (x.unsqueeze(-1) for x in (bus.K, bus.P, bus.Ki))
    inertia, cross = INERTIA, torch.linalg.cross
    body = w + w_R
    z = torch.zeros_like(s) if integral is None else integral + inertia * w
    weight = torch.zeros_like(Ki) if integral is None else Ki
    return K * s + P * w + P * weight * z - cross(w_R + weight * z, inertia * body) + inertia * (cross(body, w_R) - dw_R)


def test_mrp_feedback():
    bus = controlled()
    control.feed_back(bus)
    torch.testing.assert_close(bus.motor_torque_command.stack(), feedback(bus), rtol=0, atol=ROUNDING)
    assert (bus.control_integral.stack() == 0.0).all()


def test_feedback_turns_toward_the_reference():
    """The wheels get the torque that the error calls for; the hub gets the opposite, which reduces it."""
    bus = controlled()
    zero = Vec3.zeros_like(plane(0.0))
    bus.error = guidance.Error(vectors(0.1), zero, zero, zero)
    control.feed_back(bus)
    assert (bus.motor_torque_command.dot(bus.error.sigma_BR) > 0).all()


def test_feedback_with_integral():
    """The first call ever has dt = 0; then K h s is added each tick, within +-0.2 / Ki."""
    Ki, h = 0.01, 0.5
    bus, expected = controlled(Ki, h), torch.zeros(N, 3, dtype=torch.float64)
    bus.error = guidance.Error(vectors(2.0), *bus.error[1:])
    s = bus.error.sigma_BR.stack()
    for k in range(4):
        control.feed_back(bus)
        expected = (expected + (7.0 * h * s if k else 0.0)).clamp(-0.2 / Ki, 0.2 / Ki)
        torch.testing.assert_close(bus.control_integral.stack(), expected, rtol=0, atol=ROUNDING)
        torch.testing.assert_close(bus.motor_torque_command.stack(), feedback(bus, expected), rtol=0, atol=100 * ROUNDING)
    assert (expected.abs() == 20.0).any()
    assert (expected.abs() < 20.0).any()


def test_drifting_holds_the_command_and_lets_the_clock_run():
    bus = controlled(0.01)
    control.feed_back(bus)
    held, integral = bus.motor_torque_command.stack(), bus.control_integral.stack()
    bus.control_on = plane(0.0)
    bus.error = guidance.Error(vectors(0.2), *bus.error[1:])
    for _ in range(3):
        control.feed_back(bus)
    assert torch.equal(bus.motor_torque_command.stack(), held)
    assert torch.equal(bus.control_integral.stack(), integral)
    assert (bus.control_idle == 3.0).all()
    bus.control_on = plane(1.0)
    control.feed_back(bus)
    torch.testing.assert_close(
        bus.control_integral.stack(), integral + 7.0 * 4.0 * bus.error.sigma_BR.stack(), rtol=0, atol=ROUNDING
    )
    assert (bus.control_idle == 0.0).all()


def test_a_clock_that_never_started_does_not_run():
    bus = controlled(0.01)
    bus.control_on = plane(0.0)
    control.feed_back(bus)
    assert (bus.control_idle == -1.0).all()


# -- desaturation -----------------------------------------------------------------------------------------------------------


def dumping(speed: float, h: float = 1.0, **params: float) -> Bus:
    """One satellite whose x wheel spins, at the start of a desaturation."""
    bus = write(Bus(round(h * 1e9)), Omega=Vec3(plane(speed, 1), plane(0.0, 1), plane(0.0, 1)), desat_on=plane(1.0, 1))
    write(bus, pulse_command=tuple(plane(0.0, 1) for _ in range(4)))
    values = {"momentum_to_keep": 0.0, "dump_wait": 4.0, "shortest_pulse": 0.02, "dump_calls": 0.0, "dump_counter": 0.0}
    write(bus, **{name: plane(value, 1) for name, value in (values | params).items()})
    return write(bus, dump_momentum=Vec3.zeros_like(plane(0.0, 1)), dump_remaining=tuple(plane(0.0, 1) for _ in range(4)))


def fired(bus: Bus, ticks: int) -> list[list[float]]:
    commands = []
    for _ in range(ticks):
        desaturation.dump_momentum(bus)
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
    F = torch.stack(desaturation.impulses(dH), -1)
    arms = torch.tensor(ARMS, dtype=torch.float64)
    # the shift adds the same to all eight thrusters, whose torques cancel
    torch.testing.assert_close(2.0 * F @ arms, dH.stack(), rtol=0, atol=1e-12)
    torch.testing.assert_close(F.amin(-1), torch.zeros(N).double(), rtol=0, atol=1e-12)


@pytest.mark.parametrize("speed", [300.0, 320.0, 340.0, 360.0])
def test_pulse_pattern(speed):
    """Nothing in the first tick, a pulse in the second, then one every five ticks until less than a tick is left."""
    bus = dumping(speed)
    times = on_times(bus.Omega)
    commands = fired(bus, 200)
    assert commands[0] == [0.0] * 4
    for pair, time in enumerate(times):
        ticks = [k for k, command in enumerate(commands) if command[pair] == 1.0]
        assert ticks == [1 + 5 * k for k in range(int(time))]
    assert max(times) > 3.0
    assert min(times) == pytest.approx(0.0, abs=1e-12)


def test_pulse_patterns_above_leave_short_and_long_remainders():
    """So that they tell whole ticks from rounded ones."""
    rest = [max(on_times(dumping(speed).Omega)) % 1.0 for speed in (300.0, 320.0, 340.0, 360.0)]
    assert min(rest) < 0.4
    assert max(rest) > 0.6


@pytest.mark.parametrize("wait", [0.0, 1.0, 7.0])
def test_ticks_between_pulses(wait):
    bus = dumping(300.0, dump_wait=wait)
    commands = [max(command) for command in fired(bus, 30)]
    first = [k for k, command in enumerate(commands) if command][:3]
    assert first == [1, 2 + wait, 3 + 2 * wait]


def test_pulses_shorter_than_a_tick_or_than_the_limit_are_not_commanded():
    assert max(map(max, fired(dumping(5.0), 20))) == 0.0  # 0.17 s in all
    assert max(map(max, fired(dumping(300.0, h=0.01), 20))) == 1.0
    # left over one pulse of 0.01 s after the other: what remains decides, until it falls below the limit
    assert max(map(max, fired(dumping(300.0, h=0.01, shortest_pulse=1e6), 20))) == 0.0


def test_momentum_is_measured_once_in_the_first_tick():
    bus = dumping(300.0)
    desaturation.dump_momentum(bus)
    first = bus.dump_momentum.stack()
    assert first[0].tolist() == pytest.approx([-300.0 * SPIN_INERTIA, 0.0, 0.0])
    bus.Omega = bus.Omega * 2.0
    desaturation.dump_momentum(bus)
    assert torch.equal(bus.dump_momentum.stack(), first)


@pytest.mark.parametrize(("keep", "expected"), [(0.0, -10.0), (4.0, -6.0), (10.0, 0.0), (12.0, 0.0)])
def test_momentum_to_keep(keep, expected):
    Omega = Vec3(plane(0.0, 1), plane(6.0 / SPIN_INERTIA, 1), plane(8.0 / SPIN_INERTIA, 1))
    dH = desaturation.momentum_to_dump(Omega, plane(keep, 1))
    assert dH.stack()[0].tolist() == pytest.approx([0.0, 0.6 * expected, 0.8 * expected], abs=1e-12)
    assert torch.equal(desaturation.momentum_to_dump(Omega * 0.0, plane(keep, 1)).stack(), torch.zeros(1, 3).double())


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
    names = ("Omega", "desat_on", "momentum_to_keep", "dump_wait", "shortest_pulse", *DUMP)
    together = Bus(1_000_000_000)
    for name in names:
        parts = [getattr(bus, name) for bus in buses]
        write(together, **{name: joined(parts)})
    for _ in range(8):
        for bus in (together, *buses):
            desaturation.dump_momentum(bus)
        for name in DUMP:
            assert leaves(getattr(together, name)) == leaves(joined([getattr(bus, name) for bus in buses]))
    assert together.dump_calls.tolist() == [8.0, 0.0, 8.0, 0.0]


DUMP = ("pulse_command", "dump_momentum", "dump_remaining", "dump_counter", "dump_calls")


def joined(parts: list[Any]) -> Any:
    """Planes of one row each as planes of many."""
    if isinstance(parts[0], torch.Tensor):
        return torch.cat(parts)
    planes = [torch.cat(columns) for columns in zip(*parts, strict=True)]
    return Vec3(*planes) if isinstance(parts[0], Vec3) else tuple(planes)


def leaves(value: Any) -> list[list[float]]:
    return [value.tolist()] if isinstance(value, torch.Tensor) else [part.tolist() for part in value]


# -- instrument -------------------------------------------------------------------------------------------------------------


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
    zero = plane(0.0, 1)
    bus = write(
        Bus(1_000_000_000), attitude_tolerance=plane(0.1, 1), rate_tolerance=plane(0.01, 1), location_on=plane(location, 1)
    )
    write(bus, controller_on=plane(controller, 1), instrument_command=plane(before, 1), target_access=plane(1.0, 1))
    along = lambda size: Vec3(plane(size, 1), zero, zero)
    bus.error = guidance.Error(along(error), along(rate), along(9.0), along(9.0))
    instrument.command_scan(bus)
    assert bus.instrument_command.item() == after


# -- modes ------------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("mode", "on"),
    [
        ("idle", set()),
        ("drift", set()),
        ("charge", {"control_on", "sun_on"}),
        ("nadir_point", {"control_on", "nadir_on"}),
        ("downlink", {"control_on", "nadir_on", "transmitter_on"}),
        ("nadir_scan", {"control_on", "location_on", "controller_on", "instrument_linked", "instrument_power"}),
        ("desat_sun", {"control_on", "sun_on", "desat_on", "thruster_power"}),
        ("desat_nadir", {"control_on", "nadir_on", "desat_on", "thruster_power"}),
        ("desat_none", {"control_on", "desat_on", "thruster_power"}),
    ],
)
def test_mode_table(mode, on):
    entry = ContinuousImagingFSWModel.all_modes()[mode]
    assert set(entry.on) == on
    assert ("sun_fresh" in entry.resets) == ("sun_on" in on)
    assert ("dump_calls" in entry.resets) == ("desat_on" in on)


def test_modes_and_commands_of_models():
    assert "nadir_scan" not in BasicFSWModel.all_modes()
    assert ContinuousImagingFSWModel.all_commands()["desat"].modes == ("desat_sun", "desat_nadir", "desat_none")
    assert ContinuousImagingFSWModel.all_commands()["charge"].modes == ("charge",)
    with pytest.raises(ValueError, match=r"\['warp_on'\] are no flags"):
        Mode(("warp_on",))
    assert all(set(mode.on) <= set(FLAGS) for mode in ContinuousImagingFSWModel.all_modes().values())


def test_target_of_a_scan_is_the_earths_centre_but_for_ten_centimetres():
    from bsk_torch.sim.span import pole_matrix

    position = Vec3.of(torch.tensor([[7e6, 0.0, 0.0]], dtype=torch.float64))
    bus = write(Bus(1_000_000_000), pole=pole_matrix(torch.zeros(1, dtype=torch.float64)), r=position)
    for limit, reaches in ((-1.0, 1.0), (6.9e6, 0.0), (7.1e6, 1.0)):
        guidance.aim_at_earth_centre(write(bus, target_range=plane(limit, 1)))
        assert bus.target_access.item() == reaches
    assert bus.target_N.stack()[0].tolist() == pytest.approx([0.0, 0.0, 0.1], abs=1e-12)


def test_errors_are_relative_attitudes():
    """sigma_BR of hill pointing composes with the reference to the attitude itself."""
    bus = pointing()
    guidance.point_along_hill(bus)
    reference = dcm_to_mrp(hill_frame(bus.r, bus.v))
    torch.testing.assert_close(mrp_to_dcm(mrp_add(reference, bus.error.sigma_BR)).stack(), bus.BN.stack(), rtol=0, atol=1e-12)
    torch.testing.assert_close(mrp_subtract(bus.sigma, reference).stack(), bus.error.sigma_BR.stack(), rtol=0, atol=0)
