"""Effectors of a user: a fourth wheel on a skewed axis, with friction, in a model, a law and a hub that know nothing of it."""

import math

import pytest
import torch

from bsk_torch import SatelliteTasking, dyn, fsw, rand
from bsk_torch.astro.attitude import mrp_to_dcm
from bsk_torch.presets.nadir_scan import ScanningSatellite
from bsk_torch.sim.component import Allocation, Arg, Bus, Component, Effector, Field, vec
from bsk_torch.sim.dyn import hub
from bsk_torch.sim.dyn.effectors import wheels
from bsk_torch.vec3 import Mat3, Vec3, times
from tests.sim.buses import N, vectors, write

JS = 0.05
"""Inertia of the fourth wheel, kg m^2."""

AXIS = [1.0 / math.sqrt(3.0)] * 3


SKEWED = Effector(
    state=("skewed_speed",),
    loads=lambda bus, omega, y: (
        bus.skewed_axis_B * (bus.skewed_torque - bus.skewed_friction * y[0]),
        omega.cross(bus.skewed_axis_B * (JS * y[0])),
    ),
    inertia=lambda bus: Mat3.outer(bus.skewed_axis_B, bus.skewed_axis_B * JS),
    rates=lambda bus, omega, omega_dot, y: (
        (bus.skewed_torque - bus.skewed_friction * y[0]) * (1.0 / JS) - bus.skewed_axis_B.dot(omega_dot),
    ),
    momentum=lambda bus, omega: (
        bus.skewed_axis_B * (JS * (bus.skewed_speed + (0.0 if omega is None else bus.skewed_axis_B.dot(omega))))
    ),
)


def latch(bus: Bus) -> None:
    """Latch the torque of the fourth wheel."""
    bus.skewed_torque = bus.skewed_command


SKEWED_WHEEL = Component(
    slot="skewed_wheel",
    after="wheels",
    update=latch,
    args=(
        Arg("skewedAxis_B", AXIS, "-", "axis of the fourth wheel", "vector"),
        Arg("skewedSpeed", 0.0, "rpm", "its initial speed"),
        Arg("skewedFriction", 1e-5, "N m s", "its viscous friction", low=0.0),
    ),
    state=(Field("skewed_speed", 1, "rad/s"), Field("skewed_torque", 1, "N m"), Field("skewed_command", 1, "N m")),
    params=(vec("skewed_axis_B"), Field("skewed_friction")),
    initial=lambda args: {
        "skewed_speed": args["skewedSpeed"] * (math.pi / 30.0),
        **{name: torch.zeros(1, dtype=torch.float64) for name in ("skewed_torque", "skewed_command")},
    },
    prepare=lambda args: {"skewed_axis_B": args["skewedAxis_B"], "skewed_friction": args["skewedFriction"]},
    effector=SKEWED,
)


def distribute(bus: Bus, torque_B: Vec3) -> tuple[Vec3, torch.Tensor]:
    """Return the motor torques of least norm, ``u = -[G]^T ([G] [G]^T)^-1 L`` with ``[G] = [1, g]``, ``g . g = 1``.

    ``([1] + g g^T)^-1 = [1] - g g^T / 2``.
    """
    g = bus.skewed_axis_B
    share = -(torque_B - g * (0.5 * g.dot(torque_B)))
    return share, g.dot(share)


class FourWheelsDynModel(dyn.BasicDynamicsModel):
    components = (SKEWED_WHEEL,)

    @dyn.observable
    def skewed_speed(now):  # noqa: N805
        return now.skewed_speed


class FourWheelsFSWModel(fsw.BasicFSWModel):
    components = (
        Component("allocation", after="control", allocation=Allocation(("motor_torque_command_B", "skewed_command"), distribute)),
    )


def spacecraft(friction: float = 0.0) -> Bus:
    """Tumbling spacecraft with three wheels on the axes and a fourth one."""
    bus = write(Bus(50_000_000), sigma_BN=vectors(0.3), omega_BN_B=vectors(0.02), Omega_WB_B=vectors(50.0))
    axis = Vec3(*(torch.full((N,), part, dtype=torch.float64) for part in AXIS))
    inertia = Vec3(*(torch.full((N,), part, dtype=torch.float64) for part in (82.1, 98.4, 121.0)))
    speed = 100.0 * torch.randn(N, dtype=torch.float64)
    write(bus, inertia_B=inertia, motor_torque_B=vectors(0.1), skewed_axis_B=axis, skewed_speed=speed)
    write(bus, skewed_torque=0.1 * torch.randn(N, dtype=torch.float64), skewed_friction=friction)
    return write(bus, effectors=(wheels.WHEELS.effector, SKEWED))


def momentum(bus: Bus) -> torch.Tensor:
    """Angular momentum in N, N m s."""
    own = times(bus.inertia_B, bus.omega_BN_B)
    for effector in bus.effectors:
        own = own + effector.momentum(bus, None)
    return (mrp_to_dcm(bus.sigma_BN).mT @ own).stack()


@pytest.mark.parametrize("friction", [0.0, 1e-2])
def test_the_momentum_of_a_spacecraft_with_four_wheels_is_kept(friction):
    """Motors and friction act between hub and wheels: the sum of their momenta is constant, to the error of the method."""
    bus = spacecraft(friction)
    before, speed = momentum(bus), bus.skewed_speed
    for _ in range(200):
        hub.rotate(bus)
    assert ((momentum(bus) - before).norm(dim=-1) / before.norm(dim=-1)).amax() < 1e-9
    assert (bus.skewed_speed - speed).abs().amax() > 1.0


def test_accelerations_are_those_of_the_equations():
    """The linear system of hub and wheels, solved as one with NumPy's routines: ten unknowns less the kinematics."""
    bus = spacecraft(1e-3)
    states = [(bus.Omega_WB_B,), (bus.skewed_speed,)]
    _, omega_dot, wheel_dot, skewed_dot = hub._attitude_rates(bus, vectors(0.05), bus.sigma_BN, bus.omega_BN_B, states)
    torch.manual_seed(20260)
    bus = spacecraft(1e-3)
    L = vectors(0.05).stack()
    G = torch.cat([torch.eye(3).double(), torch.tensor(AXIS, dtype=torch.float64)[:, None]], 1)
    J = torch.tensor([wheels.SPIN_INERTIA] * 3 + [JS], dtype=torch.float64)
    speeds = torch.cat([bus.Omega_WB_B.stack(), bus.skewed_speed[:, None]], 1)
    u = torch.cat([bus.motor_torque_B.stack(), (bus.skewed_torque - 1e-3 * bus.skewed_speed)[:, None]], 1)
    omega, I = bus.omega_BN_B.stack(), torch.diag_embed(bus.inertia_B.stack())  # noqa: E741
    system = torch.zeros(N, 7, 7, dtype=torch.float64)
    system[:, :3, :3], system[:, :3, 3:] = I, G * J
    system[:, 3:, :3], system[:, 3:, 3:] = G.mT * J[:, None], torch.diag(J)
    total = (I @ omega[..., None])[..., 0] + (J * speeds) @ G.mT
    right = torch.cat([L - torch.linalg.cross(omega, total), u], 1)
    expected = torch.linalg.solve(system, right)
    found = torch.cat([omega_dot.stack(), wheel_dot.stack(), skewed_dot[:, None]], 1)
    torch.testing.assert_close(found, expected, rtol=1e-12, atol=1e-15)


def test_allocations_of_least_norm_have_the_torque():
    bus, torque = spacecraft(), vectors(0.1)
    commands, fourth = distribute(bus, torque)
    exerted = -(commands + bus.skewed_axis_B * fourth)
    torch.testing.assert_close(exerted.stack(), torque.stack(), rtol=0, atol=1e-15)
    G = torch.cat([torch.eye(3).double(), torch.tensor(AXIS, dtype=torch.float64)[:, None]], 1)
    least = -torque.stack() @ torch.linalg.pinv(G).mT
    torch.testing.assert_close(torch.cat([commands.stack(), fourth[:, None]], 1), least, rtol=0, atol=1e-15)


@pytest.mark.compiled
def test_four_wheels_fly_alike_in_eager_and_compiled():
    """A user's model, composed with the package's: it points, dumps momentum, and both back ends agree."""
    satellite = type(
        "Mine",
        (ScanningSatellite,),
        {
            "dyn_type": (FourWheelsDynModel, ScanningSatellite.get_dyn_type()),
            "fsw_type": (FourWheelsFSWModel, ScanningSatellite.get_fsw_type()),
        },
    )
    speeds = []
    for backend in ("eager", "compiled"):
        args = {"skewedSpeed": rand.Uniform(-1000.0, 1000.0), "skewedFriction": rand.Uniform(0.0, 1e-4)}
        env = SatelliteTasking(satellite("A", args), num_envs=3, seed=0, time_limit=900.0, backend=backend)
        td = env.reset()
        before = env.simulator.state.read("skewed_speed")
        for action in (0, 2):
            td = env.step(td.set("action", torch.full((3,), action)))["next"]
        speeds.append(env.simulator.state.read("skewed_speed"))
        assert (speeds[-1] - before).abs().amax() > 0.1
    torch.testing.assert_close(*speeds, rtol=1e-7, atol=1e-9)


def note_rate(bus: Bus) -> None:
    """Count the ticks in which the hub has moved."""
    bus.moves = bus.moves + 1.0


COUNTED_HUB = hub.HUB.extended(
    update=note_rate, state=(Field("moves"),), initial=lambda args: {"moves": torch.zeros(1, dtype=torch.float64)}
)


class CountedDynModel(dyn.BasicDynamicsModel):
    components = (COUNTED_HUB,)


@pytest.mark.parametrize("orbit", ["arc", "integrated"])
def test_additions_to_the_hub_run_after_it_has_moved(orbit):
    """Whether the orbit is solved in advance or integrated, the hub moves as it does without the addition."""
    rates = []
    for dyn_type in (CountedDynModel, dyn.BasicDynamicsModel):
        satellite = type("Mine", (ScanningSatellite,), {"dyn_type": (dyn_type, ScanningSatellite.get_dyn_type())})
        env = SatelliteTasking(satellite("A"), num_envs=2, seed=0, time_limit=60.0, backend="eager", orbit=orbit)
        env.step(env.reset().set("action", torch.zeros(2, dtype=torch.int64)))
        rates.append(env.satellite.dynamics.omega_BN_B)
        if dyn_type is CountedDynModel:
            assert torch.equal(env.simulator.state.read("moves"), env.simulator.state.ticks.double())
    assert torch.equal(*rates)
