"""Any set of thrusters: forces, torques, and desaturation."""

from __future__ import annotations

import functools

import pytest
import torch

from bsk_torch import dyn, rand
from bsk_torch.sim.component import Bus
from bsk_torch.sim.dyn.effectors.thrusters import (
    ARGS,
    DIRECTIONS,
    POSITIONS,
    THRUST,
    THRUSTERS,
    arms_about_center,
    fitted_thrusters,
    thruster_set,
)
from bsk_torch.sim.fsw.desaturation import impulses, set_desaturation
from bsk_torch.vec3 import Vec3
from tests.sim.buses import N, vectors, write
from tests.sim.dyn import flights
from tests.sim.dyn.flights import DESAT, SCAN

fly = functools.partial(flights.fly, actions=(SCAN, DESAT))
"""A flight that ends with desaturation."""

GIVEN = {arg.name: arg.default for arg in ARGS} | {"r_CB_B": (0.0, 0.0, 0.0)}
OCTET = [
    dyn.Thruster([sign * x for x in position], [sign * x for x in direction], THRUST)
    for position, direction in zip(POSITIONS, DIRECTIONS, strict=True)
    for sign in (1.0, -1.0)
]


def random_args(count: int) -> dict[str, torch.Tensor]:
    return {
        "thrusterPositions_B": torch.randn(N, count, 3, dtype=torch.float64),
        "thrusterDirections_B": torch.randn(N, count, 3, dtype=torch.float64),
        "thrusterMaxThrust": 0.1 + torch.rand(1, count, dtype=torch.float64),
        "r_CB_B": torch.randn(N, 3, dtype=torch.float64),
        **{name: torch.zeros(1, dtype=torch.float64) for name in ("hs_min", "maxCounterValue", "thrMinFireTime")},
    }


def test_forces_and_torques_of_the_thrusters_that_fire():
    args = random_args(5)
    part = thruster_set(True, tuple(OCTET[:5]))
    bus, on = Bus(1_000_000_000), (torch.rand(N, 5) > 0.5).double()
    values = part.prepare(args)
    for field in part.params:
        write(bus, **{field.name: tuple(Vec3.of(row) for row in values[field.name].unflatten(-1, (5, 3)).unbind(1))})
    bus.pulse = on.unbind(-1)
    force, torque = part.effector.thrust(bus, 0)
    unit = args["thrusterDirections_B"] / args["thrusterDirections_B"].norm(dim=-1, keepdim=True)
    each = on[..., None] * args["thrusterMaxThrust"][..., None] * unit
    torch.testing.assert_close(force.stack(), each.sum(1), rtol=0, atol=1e-14)
    expected = torch.linalg.cross(args["thrusterPositions_B"], each).sum(1)
    torch.testing.assert_close(torque.stack(), expected, rtol=0, atol=1e-13)
    assert all(part.effector.thrust(bus, stage) is None for stage in (1, 2, 3))


def test_impulses_of_symmetric_thrusters_have_the_momentum_wanted():
    """Two at each place, in opposite directions: what all of them exert together is no torque."""
    args = random_args(4)
    args["thrusterPositions_B"] = args["thrusterPositions_B"].repeat(1, 2, 1)
    args["thrusterDirections_B"] = torch.cat([args["thrusterDirections_B"], -args["thrusterDirections_B"]], 1)
    args["thrusterMaxThrust"] = args["thrusterMaxThrust"].repeat(1, 2)
    rows = set_desaturation(8).prepare(args)["impulse_map"].unflatten(-1, (8, 3))
    dH = vectors(10.0)
    F = torch.stack(impulses(dH, [Vec3.of(row) for row in rows.unbind(1)]), -1)
    assert F.amin() >= 0.0
    torch.testing.assert_close((F[..., None] * arms_about_center(args)).sum(1), dH.stack(), rtol=1e-9, atol=1e-9)


def test_the_form_follows_from_the_arguments():
    assert fitted_thrusters(GIVEN) is THRUSTERS
    listed = GIVEN | {"thrusters": OCTET}
    assert fitted_thrusters(listed).effector.thrust is None  # opposite ones never push
    for change in (
        {"thrusters": OCTET[:-1]},
        {"thrusters": [*OCTET[:-1], dyn.Thruster(OCTET[-1].position, OCTET[-1].direction, 1.0)]},
        {"r_CB_B": [0.1, 0.0, 0.0]},
        {"thrusterMaxThrust": rand.Uniform(0.5, 1.0, 8)},
    ):
        assert fitted_thrusters(listed | change).effector.torque is None


def test_the_eight_thrusters_of_bsk_rl_dump_alike_however_they_are_described():
    plain, listed = fly({}), fly({"thrusters": OCTET})
    for name in ("wheel_speeds", "sigma_BN"):
        a, b = (getattr(env.satellite.dynamics, name) for env in (plain, listed))
        torch.testing.assert_close(a, b, rtol=0, atol=1e-9)
    assert (plain.simulator.state.read("dump_calls") > 10.0).all()
    assert (plain.simulator.state.read("dump_momentum_B").norm(dim=-1) > 1.0).all()


def test_thrusters_that_push_need_an_integrated_orbit():
    single = {"thrusters": OCTET[:-1], "wheelSpeeds": [1500.0, -900.0, 700.0]}
    with pytest.raises(TypeError, match=r"push the orbit, but it was solved in advance.* pass orbit='integrated'"):
        fly(single)
    pushed, plain = (fly(args, orbit="integrated", max_step_duration=60.0) for args in (single, single | {"thrusters": OCTET}))
    away = (pushed.satellite.dynamics.r_BN_N - plain.satellite.dynamics.r_BN_N).norm(dim=-1)
    assert (away > 1e-3).any()  # where one fires whose partner is missing


@pytest.mark.compiled
def test_drawn_thrusters_fly_alike_compiled():
    args = dict(thrusters=OCTET, thrusterMaxThrust=rand.Uniform(0.5, 2.0, 8), r_CB_B=rand.Uniform(-0.05, 0.05, 3))
    eager, compiled = (fly(args, orbit="integrated", backend=backend) for backend in ("eager", "compiled"))
    for name, bound in (("wheel_speeds", 1e-8), ("sigma_BN", 1e-9), ("r_BN_N", 1e-6)):
        a, b = (getattr(env.satellite.dynamics, name) for env in (eager, compiled))
        torch.testing.assert_close(a, b, rtol=0, atol=bound)


def test_types_have_the_thrust_of_basilisks_factory():
    thrusts = [dyn.Thruster([0, 0, 1], [1, 0, 0], f"MOOG_Monarc_{kind}").thrust for kind in ("1", "5", "22_6", "22_12", "90LT")]
    assert thrusts == [0.9, 4.5, 22.0, 22.0, 90.0]
    assert THRUST == 0.9


def test_thrusters_that_turn_otherwise_than_desired_or_never_fire_are_logged(caplog):
    fly({"thrusters": OCTET[:-1]}, actions=(), orbit="integrated")
    assert "firing all thrusters at once exerts a torque" in caplog.text
    caplog.clear()
    fly({"thrusters": OCTET, "thrusterMaxThrust": 500.0}, actions=(), orbit="integrated")
    assert "so it never fires" in caplog.text
