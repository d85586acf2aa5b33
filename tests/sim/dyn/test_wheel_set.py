"""Any number of reaction wheels about any axes: equations, limits, friction, and types."""

import functools
import math
import re
from pathlib import Path

import pytest
import torch
from hypothesis import example, given, settings
from hypothesis import strategies as st
from tensordict import TensorDict

from bsk_torch import dyn, rand
from bsk_torch.astro.attitude import mrp_to_dcm
from bsk_torch.constants import RPM
from bsk_torch.presets.nadir_scan import ScanningSatellite
from bsk_torch.sim.component import Bus
from bsk_torch.sim.dyn import hub
from bsk_torch.sim.dyn.effectors import wheels
from bsk_torch.sim.dyn.effectors.wheel_set import LINEAR_BELOW, WheelForm, friction_torques, latch, wheel_effector
from bsk_torch.sim.fsw.allocation import distribute, wheel_map
from bsk_torch.vec3 import Mat3, Vec3
from tests.sim.buses import N, plane, vectors, write
from tests.sim.dyn.flights import SCAN, fly
from tests.sim.dyn.test_body import random_tensors

PAGE = Path(__file__).parents[3] / "docs" / "how_to" / "spacecraft.md"

# before any test runs: a block of the page adds a type
TYPES = dict(dyn.WHEEL_TYPES)

PYRAMID = [dyn.Wheel("Honeywell_HR16", axis, 50.0) for axis in dyn.pyramid(0.8)]


PROPERTY = settings(max_examples=15, deadline=None, derandomize=True, database=None)
SEEDS = st.integers(0, 2**31)
COUNTS = st.integers(1, 8)
AXES = st.lists(st.sampled_from([None, None, 0, 1, 2]), max_size=8).map(tuple)
"""Axes of up to eight wheels, some of which are axes of B."""


def planes(count: int, scale: float = 1.0) -> tuple[torch.Tensor, ...]:
    return tuple(scale * torch.randn(N, dtype=torch.float64) for _ in range(count))


def axes_of(form: WheelForm) -> torch.Tensor:
    """Unit vectors, [N, W, 3], that agree with the axes of B in a form."""
    axes = torch.randn(N, len(form.axes), 3, dtype=torch.float64)
    axes = axes / axes.norm(dim=-1, keepdim=True)
    for k, axis in enumerate(form.axes):
        if axis is not None:
            axes[:, k] = torch.eye(3, dtype=torch.float64)[axis]
    return axes


def random_spacecraft(form: WheelForm, torque: float) -> tuple[Bus, torch.Tensor]:
    """Tumbling bodies with wheels, and the wheels' axes."""
    count, axes = len(form.axes), axes_of(form)
    inertia = tuple(0.01 + 0.1 * torch.rand(N, dtype=torch.float64) for _ in range(count))
    spin = sum(J[:, None, None] * g[:, :, None] * g[:, None, :] for J, g in zip(inertia, axes.unbind(1), strict=True))
    bus = write(Bus(50_000_000), sigma_BN=vectors(0.3), omega_BN_B=vectors(0.03), inertia_B=Mat3.of(random_tensors() + spin))
    write(bus, wheel_axes_B=tuple(Vec3.of(g) for g in axes.unbind(1)), wheel_inertia=inertia, Omega_WB_B=planes(count, 100.0))
    write(bus, motor_torque_B=planes(count, torque), wheel_coulomb=planes(count, 0.0), wheel_viscous=planes(count, 1e-3))
    return write(bus, effectors=(wheel_effector(form),) if count else ()), axes


def momentum_and_energy(bus: Bus, axes: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
    """``H = [NB] (I w + sum J O g)``, [N, 3] N m s, and ``E = w . I w / 2 + sum (J O^2 / 2 + J O g . w)``, [N] J."""
    omega = bus.omega_BN_B.stack()
    H = (bus.inertia_B @ bus.omega_BN_B).stack()
    E = 0.5 * (H * omega).sum(-1)
    for J, speed, g in zip(bus.wheel_inertia, bus.Omega_WB_B, axes.unbind(1), strict=True):
        H = H + (J * speed)[:, None] * g
        E = E + 0.5 * J * speed * speed + J * speed * (g * omega).sum(-1)
    return (mrp_to_dcm(bus.sigma_BN).mT @ Vec3.of(H)).stack(), E


@pytest.mark.parametrize("moved", ["free", "motors", "friction"])
@settings(PROPERTY, max_examples=6)
@given(axes=AXES, seed=SEEDS)
@example((None,) * 2, 0)
@example((None,) * 6, 0)
@example((None,) * 7, 0)
@example((None,) * 8, 0)
@example((2, None, 2, 0, None), 0)
def test_momentum_and_energy_of_any_wheels_on_any_body(moved, axes, seed):
    """Momentum is kept whatever happens between hub and wheels, energy without torques; both to the error of the method.

    Halving the step, nearly 2^4 is won: the error of the method is the only one.
    """
    form = WheelForm(axes, False, False, moved == "friction", False)
    errors = []
    for halvings in (0, 1):
        torch.manual_seed(seed)
        bus, unit = random_spacecraft(form, 0.0 if moved == "free" else 0.1)
        bus.h_ns, bus.h = bus.h_ns >> halvings, bus.h / 2**halvings
        H, E = momentum_and_energy(bus, unit)
        for _ in range(20 << halvings):
            hub.rotate(bus)
        after_H, after_E = momentum_and_energy(bus, unit)
        errors.append((((after_H - H).norm(dim=-1) / H.norm(dim=-1)).amax(), ((after_E - E).abs() / E).amax()))
    (coarse_H, coarse_E), (fine_H, fine_E) = errors
    assert coarse_H < 1e-5
    assert fine_H < max(coarse_H / 10.0, 1e-13)
    if moved == "free" or not axes:
        assert coarse_E < 1e-5
        assert fine_E < max(coarse_E / 10.0, 1e-13)
    else:
        assert coarse_E > 1e-5


def test_accelerations_are_those_of_the_equations():
    """The linear system of hub and wheels, solved as one by torch.linalg."""
    form = WheelForm((None, 1, None, None), False, False, True, False)
    bus, axes = random_spacecraft(form, 0.1)
    L, count = vectors(0.05), 4
    _, omega_dot, *wheel_dots = hub._attitude_rates(bus, L, bus.sigma_BN, bus.omega_BN_B, [(bus.Omega_WB_B,)])
    J, speeds, omega = torch.stack(bus.wheel_inertia, -1), torch.stack(bus.Omega_WB_B, -1), bus.omega_BN_B.stack()
    G, inertia = axes.mT, bus.inertia_B.stack()
    system = torch.zeros(N, 3 + count, 3 + count, dtype=torch.float64)
    system[:, :3, :3], system[:, :3, 3:] = inertia, G * J[:, None]
    system[:, 3:, :3], system[:, 3:, 3:] = (G * J[:, None]).mT, torch.diag_embed(J)
    total = (inertia @ omega[..., None] + G @ (J * speeds)[..., None])[..., 0]
    u = torch.stack(bus.motor_torque_B, -1) - 1e-3 * 0.0
    friction = torch.stack(friction_torques(bus, bus.Omega_WB_B, False), -1)
    right = torch.cat([L.stack() - torch.linalg.cross(omega, total), u + friction], 1)
    found = torch.cat([omega_dot.stack(), torch.stack(wheel_dots, -1)], 1)
    torch.testing.assert_close(found, torch.linalg.solve(system, right), rtol=1e-10, atol=1e-12)


LIMITS = WheelForm((None,), True, True, False, False)


@pytest.mark.parametrize(
    ("command", "speed", "most", "least", "power", "fastest", "expected"),
    [
        (0.5, 10.0, 0.2, 0.0, -1.0, 600.0, 0.2),
        (-0.5, 10.0, 0.2, 0.0, -1.0, 600.0, -0.2),
        (0.5, 10.0, 0.0, 0.0, -1.0, 600.0, 0.5),  # 0 is no limit, as in Basilisk
        (0.5, 10.0, -1.0, 0.0, -1.0, 600.0, 0.5),
        (1e-3, 10.0, 0.2, 2e-3, -1.0, 600.0, 0.0),
        (2e-3, 10.0, 0.2, 2e-3, -1.0, 600.0, 2e-3),  # only smaller ones vanish
        (0.2, 100.0, 0.2, 0.0, 5.0, 600.0, 0.05),
        (-0.2, 100.0, 0.2, 0.0, 5.0, 600.0, -0.05),  # a brake is limited, too
        (0.2, -100.0, 0.2, 0.1, 5.0, 600.0, 0.05),  # below the smallest torque, which was checked before
        (0.05, 100.0, 0.2, 0.0, 5.0, 600.0, 0.05),
        (0.2, 0.0, 0.2, 0.0, 5.0, 600.0, 0.2),
        (0.2, 600.0, 0.2, 0.0, -1.0, 600.0, 0.0),
        (-0.2, 600.0, 0.2, 0.0, -1.0, 600.0, -0.2),
        (0.2, 700.0, 0.2, 0.0, -1.0, -1.0, 0.2),
    ],
)
def test_limits_in_the_order_of_basilisk(command, speed, most, least, power, fastest, expected):
    bus = Bus(1_000_000_000)
    values = dict(motor_torque_command_B=command, Omega_WB_B=speed, max_motor_torque=most, min_motor_torque=least)
    values |= dict(max_wheel_power=power, wheel_top_speed=fastest)
    write(bus, **{name: (plane(value, 1),) for name, value in values.items()})
    latch(LIMITS)(bus)
    assert bus.motor_torque_B[0].item() == pytest.approx(expected, rel=1e-15)


@PROPERTY
@given(count=COUNTS, seed=SEEDS)
def test_limits_hold_for_any_wheels(count, seed):
    """Motors exert no more than asked, nor in the other direction, within the limits of torque and power, and brake at most."""
    torch.manual_seed(seed)
    bus = write(Bus(1), motor_torque_command_B=planes(count, 0.3), Omega_WB_B=planes(count, 400.0))
    write(bus, max_motor_torque=planes(count, 0.3), min_motor_torque=tuple(x.abs() for x in planes(count, 0.02)))
    write(bus, max_wheel_power=planes(count, 30.0), wheel_top_speed=planes(count, 600.0))
    latch(WheelForm((None,) * count, True, True, False, False))(bus)
    every = (bus.motor_torque_B, bus.motor_torque_command_B, bus.Omega_WB_B)
    limits = (bus.max_motor_torque, bus.max_wheel_power, bus.wheel_top_speed)
    for u, command, speed, most, power, fastest in zip(*every, *limits, strict=True):
        assert (u * command >= 0.0).all()
        assert (u.abs() <= command.abs()).all()
        assert (u.abs() <= most)[most > 0.0].all()
        assert ((u * speed).abs() <= power * (1.0 + 1e-15))[power > 0.0].all()
        assert (u * speed <= 0.0)[(fastest > 0.0) & (speed.abs() >= fastest)].all()


def one_wheel(**values: float) -> Bus:
    """A wheel with friction; all values are its own."""
    known = dict(
        wheel_coulomb=0.0, wheel_viscous=0.0, wheel_static=0.0, wheel_stribeck=-1.0, wheel_speed_before=0.0, wheel_started=0.0
    )
    return write(Bus(1_000_000_000), **{name: (plane(value, 1),) for name, value in (known | values).items()})


def friction(bus: Bus, speed: float) -> float:
    return friction_torques(bus, (plane(speed, 1),), True)[0].item()


def test_friction_opposes_motion():
    bus = one_wheel(wheel_coulomb=0.01, wheel_viscous=1e-4)
    assert friction(bus, 50.0) == pytest.approx(-0.015, rel=1e-14)
    assert (friction(bus, -50.0), friction(bus, 0.0)) == (pytest.approx(0.015, rel=1e-14), 0.0)
    assert friction(bus, LINEAR_BELOW / 4.0) == pytest.approx(-(0.01 + 1e-8) / 4.0, rel=1e-14)
    assert bus.wheel_started[0].item() == 0.0
    bus = one_wheel(wheel_coulomb=0.01, wheel_static=0.02)
    friction(bus, 0.0)
    assert friction(bus, 1.0) == -0.01


def test_stribeck_friction_from_rest():
    """It begins at rest, lasts while the wheel speeds up, and ends when it slows down."""
    b, static, coulomb = 0.5, 0.02, 0.01
    bus = one_wheel(wheel_coulomb=coulomb, wheel_static=static, wheel_stribeck=b)

    def stribeck(x: float) -> float:
        bump = math.sqrt(2.0 * math.e) * (static - coulomb) * math.exp(-0.5 * (x / b) ** 2) * x / (b * math.sqrt(2.0))
        return bump + coulomb * math.tanh(10.0 * x / b)

    assert friction(bus, 1.0) == -coulomb  # it has not been at rest
    assert (friction(bus, 0.0), bus.wheel_started[0].item()) == (0.0, 1.0)
    for speed in (0.1, 0.5, 2.0):
        assert friction(bus, speed) == pytest.approx(-stribeck(speed), rel=1e-14)
        bus.wheel_speed_before = (plane(speed, 1),)
    assert friction(bus, LINEAR_BELOW / 2.0) == pytest.approx(-coulomb / 2.0, rel=1e-14)  # slower: the flag is gone
    assert (bus.wheel_started[0].item(), friction(bus, 1.0)) == (0.0, -coulomb)


@PROPERTY
@given(count=COUNTS, span=st.integers(1, 3), seed=SEEDS)
@example(2, 2, 0)
@example(6, 3, 0)
@example(7, 2, 0)
def test_torques_of_least_norm(count, span, seed):
    """They exert the torque, or its part in the line or plane of the axes; no others with that torque are smaller."""
    torch.manual_seed(seed)
    axes = torch.randn(N, count, span, dtype=torch.float64) @ torch.randn(N, span, 3, dtype=torch.float64)
    unit = axes / axes.norm(dim=-1, keepdim=True)
    W = wheel_map({"rwAxes_B": axes})
    bus, torque = write(Bus(1), wheel_map=tuple(Vec3.of(row) for row in W.unbind(1))), vectors()
    (commands,) = distribute(bus, torque, False)
    u = torch.stack(commands, -1)
    vectors_, values, _ = torch.linalg.svd(unit.mT, full_matrices=False)
    known = min(count, span)
    within = vectors_[..., :known]
    exerted = -(u[..., None] * unit).sum(1)
    condition = (values[:, :1] / values[:, known - 1 : known]) ** 2
    wanted = (within @ (within.mT @ torque.stack()[..., None]))[..., 0]
    assert ((exerted - wanted).abs() < 1e-13 * condition).all()
    least = torch.linalg.lstsq(unit.mT, -torque.stack()[..., None], rcond=1e-9, driver="gelsd").solution[..., 0]
    assert ((u - least).abs() < 1e-13 * condition * (1.0 + u.norm(dim=-1, keepdim=True))).all()


def test_null_motion_exerts_no_torque_and_slows_wheels():
    axes = torch.randn(N, 6, 3, dtype=torch.float64)
    unit = axes / axes.norm(dim=-1, keepdim=True)
    rows, speeds = tuple(Vec3.of(row) for row in wheel_map({"rwAxes_B": axes}).unbind(1)), planes(6, 100.0)
    bus = write(Bus(1), wheel_map=rows, null_axes_B=tuple(Vec3.of(g) for g in unit.unbind(1)), Omega_WB_B=speeds)
    write(bus, null_speeds=planes(6, 10.0), null_gain=plane(0.02))
    torque = vectors()
    plain, moved = (torch.stack(distribute(bus, torque, null)[0], -1) for null in (False, True))
    extra, excess = moved - plain, torch.stack(speeds, -1) - torch.stack(bus.null_speeds, -1)
    torch.testing.assert_close((extra[..., None] * unit).sum(1), torch.zeros(N, 3).double(), rtol=0, atol=1e-12)
    Z = torch.eye(6).double() - unit @ torch.linalg.inv(unit.mT @ unit) @ unit.mT
    torch.testing.assert_close(extra, -0.02 * (Z @ excess[..., None])[..., 0], rtol=0, atol=1e-10)
    assert ((extra * excess).sum(-1) < 0.0).all()


def test_the_three_wheels_of_bsk_rl_fly_alike_however_they_are_described():
    plain = fly({})
    described = fly({"wheels": [dyn.Wheel("Honeywell_HR16", axis, 50.0) for axis in torch.eye(3).tolist()]})
    for name in ("wheel_speeds", "sigma_BN", "battery_charge", "wheel_speeds_fraction"):
        a, b = (getattr(env.satellite.dynamics, name) for env in (plain, described))
        torch.testing.assert_close(a, b, rtol=0, atol=1e-6 if name == "battery_charge" else 1e-9)
    assert torch.equal(plain.satellite.dynamics.rw_speeds_valid(), described.satellite.dynamics.rw_speeds_valid())


DRAWN = dict(
    wheels=PYRAMID,
    rwAxes_B=lambda: torch.tensor(dyn.pyramid(0.8)) + 0.1 * torch.randn(4, 3),
    rwFCoulomb=rand.Uniform(0.0, 1e-3, 4),
    rwBetaStatic=0.5,
    rwFStatic=0.01,
    rwPMax=rand.Choice([5.0, -1.0]),
    rwUMin=1e-4,
    rwBasePower=rand.Uniform(0.0, 2.0, 4),
    wheelSpeeds=[0.0, 500.0, -300.0, 900.0],
    nullSpaceGain=0.01,
)


@pytest.mark.compiled
def test_drawn_wheels_fly_alike_compiled_and_in_any_batch():
    eager, compiled, one = fly(DRAWN), fly(DRAWN, backend="compiled"), fly(DRAWN, num_envs=1)
    for name in ("wheel_speeds", "sigma_BN", "battery_charge"):
        a, b, c = (getattr(env.satellite.dynamics, name) for env in (eager, compiled, one))
        torch.testing.assert_close(a, b, rtol=1e-9, atol=1e-9)
        torch.testing.assert_close(a[:1], c, rtol=1e-9, atol=1e-9)
    axes = eager.satellite.sat_args["rwAxes_B"]
    assert axes.shape == (3, 4, 3)
    assert not torch.equal(axes[0], axes[1])


def test_arguments_of_wheels_default_to_their_types():
    env = fly({"wheels": [*PYRAMID, dyn.Wheel("NanoAvionics_RW0", [0, 0, 1], useRWfriction=True)]}, actions=())
    args = env.satellite.sat_args
    assert args["u_max"].tolist() == [[0.2] * 4 + [0.0032]] * 3
    assert args["rwFCoulomb"][0].tolist() == [0.0] * 4 + [5e-5]
    assert args["rwJs"][0, 4].item() == pytest.approx(2.938245e-5, rel=1e-6)
    assert args["wheelSpeeds"].shape == (3, 5)
    # ``default_sat_args`` has the torque and the speeds of three HR16, which are no wish of the user.
    args = dict(ScanningSatellite.default_sat_args()) | {"wheels": PYRAMID, "u_max": 0.1}
    own = fly(args, actions=()).satellite.sat_args
    assert (own["u_max"].tolist(), own["wheelSpeeds"].shape) == ([[0.1] * 4] * 3, (3, 4))


@pytest.mark.parametrize(
    ("type_", "momentum", "Js", "speed", "most", "least", "coulomb"),
    [
        ("Honeywell_HR16", 100.0, 0.15915494, 6000.0, 0.2, 1e-5, 5e-4),
        ("Honeywell_HR14", 25.0, 0.039788736, 6000.0, 0.2, 1e-5, 5e-4),
        ("Honeywell_HR12", 12.0, 0.019098593, 6000.0, 0.2, 1e-5, 5e-4),
        ("BCT_RWP015", None, 2.3873241e-5, 6000.0, 0.004, 1e-5, 5e-5),
        ("NanoAvionics_RW0", None, 2.938245e-5, 6500.0, 0.0032, 4.923e-5, 5e-5),
    ],
)
def test_types_of_basilisks_factory(type_, momentum, Js, speed, most, least, coulomb):
    """With all switches on; printed by Basilisk's ``rwFactory().create``."""
    found = dyn.Wheel(type_, [0, 0, 2], momentum, useRWfriction=True, useMinTorque=True).arguments
    assert found["rwJs"] == pytest.approx(Js, rel=1e-7)
    assert (found["rwOmegaMax"], found["u_max"], found["rwUMin"], found["rwFCoulomb"]) == (speed, most, least, coulomb)
    assert found["rwAxes_B"] == (0.0, 0.0, 1.0)
    off = dyn.Wheel(type_, [0, 0, 2], momentum, useMaxTorque=False).arguments
    assert (off["u_max"], off["rwUMin"], off["rwFCoulomb"]) == (-1.0, 0.0, 0.0)


def test_types_are_listed_on_the_page_and_can_be_added(monkeypatch):
    rows = re.findall(r"^\| `(\w+_\w+)` \| ([^|]+) \|((?: [\d.e-]+ \|){4})$", PAGE.read_text(), re.MULTILINE)
    listed = {
        name: ([float(x) for x in re.findall(r"[\d.]+", momenta)], [float(x) for x in numbers.split("|")[:-1]])
        for name, momenta, numbers in rows
    }
    assert listed == {
        name: (list(kind.maxMomentum), [kind.Omega_max, kind.u_max, kind.u_min, kind.fCoulomb]) for name, kind in TYPES.items()
    }
    monkeypatch.setitem(dyn.WHEEL_TYPES, "Mine", dyn.WheelType((1.0,), 3000.0, 0.05, 0.0, 1e-4))
    assert dyn.Wheel("Mine", [1, 0, 0]).arguments["rwJs"] == pytest.approx(1.0 / (3000.0 * RPM))


PAIR = [dyn.Wheel("Honeywell_HR16", axis, 50.0) for axis in ([1, 0, 0.2], [0, 1, 0])]


BODIES = [[110.0, 4.0, -6.0, 4.0, 95.0, 3.0, -6.0, 3.0, 120.0], [80.0, 0.0, 9.0, 0.0, 100.0, -7.0, 9.0, -7.0, 90.0]]

RING = [dyn.Wheel("Honeywell_HR16", [math.cos(k), math.sin(k), 0.7 * (-1.0) ** k], 50.0) for k in range(7)]


@pytest.mark.parametrize("wheels", [PAIR, RING[:6], RING], ids=["two", "six", "seven"])
def test_steered_satellites_keep_their_momentum(wheels):
    """Whatever the flight software commands and the wheels can do; half the tick wins nearly the 2^4 of the method."""
    flight = dict(wheels=wheels, inertia=rand.Choice(BODIES), disturbance_vector=[0.0] * 3, dragCoeff=0.0)
    flight |= {"underactuated": len(wheels) < 4}

    def change(sim_rate: float) -> float:
        env = fly(flight, actions=(), sim_rate=sim_rate, max_step_duration=10.0)
        model, args, momenta, speeds = env.satellite.dynamics, env.satellite.sat_args, [], []
        axes, inertia = args["rwAxes_B"] / args["rwAxes_B"].norm(dim=-1, keepdim=True), args["inertia"].view(3, 3, 3)
        for _ in range(2):
            of_wheels = ((args["rwJs"] * model.wheel_speeds)[..., None] * axes).sum(1)
            inner = (inertia @ model.omega_BN_B[..., None])[..., 0] + of_wheels
            momenta.append((model.BN.mT @ inner[..., None])[..., 0])
            speeds.append(model.wheel_speeds)
            env.step(TensorDict({"action": torch.full(env.batch_size, SCAN)}, env.batch_size))
        assert ((speeds[1] - speeds[0]).abs() > 0.1).all()
        return float(((momenta[1] - momenta[0]).norm(dim=-1) / momenta[0].norm(dim=-1)).max())

    coarse, fine = change(1.0), change(0.5)
    assert coarse < 1e-5
    assert fine < coarse / 10.0


def test_unstable_null_motion_is_logged(caplog):
    fly({"wheels": PYRAMID, "nullSpaceGain": 0.02}, actions=())
    assert "nullSpaceGain" not in caplog.text
    fly({"wheels": PYRAMID, "nullSpaceGain": 0.04}, actions=())
    assert "nullSpaceGain=0.04 N m s oscillates at sim_rate=1 s" in caplog.text
    fly({"wheels": PYRAMID, "nullSpaceGain": 0.3}, actions=())
    assert "nullSpaceGain=0.3 N m s is not stable at sim_rate=1 s" in caplog.text


def test_wheels_draw_base_power_and_more():
    bus = write(Bus(1_000_000_000), power=plane(100.0, 1), Omega_WB_B=tuple(plane(x, 1) for x in (100.0, 100.0, -100.0)))
    write(
        bus,
        motor_torque_B=tuple(plane(x, 1) for x in (0.1, -0.1, 0.1)),
        wheel_base_power=tuple(plane(x, 1) for x in (1.0, 2.0, 3.0)),
    )
    write(
        bus,
        wheel_to_battery=tuple(plane(x, 1) for x in (0.0, 0.5, -1.0)),
        battery_to_wheel=tuple(plane(0.8, 1) for _ in range(3)),
    )
    wheels.draw_power_of_wheels(bus)
    needs = 10.0 / 0.8 + 1.0, -0.5 * 10.0 + 2.0, 10.0 / 0.8 + 3.0  # drives, returns half, and pays for the brake
    assert bus.power.item() == pytest.approx(100.0 - functools.reduce(float.__add__, needs), rel=1e-14)
    # One number for each of bsk_rl's three, or a number of each wheel.
    speeds, each = torch.zeros(1, 4), torch.tensor([[1.0, 2.0, 3.0, 4.0], [0.0, 0.0, 0.0, 1.0]])
    assert wheels.base_power_of_wheels({"rwBasePower": each, "wheelSpeeds": speeds}, 2).tolist() == [10.0, 1.0]
    three = {"rwBasePower": torch.tensor([0.5]), "wheelSpeeds": torch.zeros(1, 3)}
    assert wheels.base_power_of_wheels(three, 2).tolist() == [1.5, 1.5]
