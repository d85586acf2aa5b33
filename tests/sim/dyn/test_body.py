"""Bodies of any inertia whose center of mass lies anywhere."""

import pytest
import torch

from bsk_torch import ConstellationTasking, SatelliteTasking, act, dyn, fsw, obs, rand, sats
from bsk_torch.astro.attitude import mrp_to_dcm
from bsk_torch.constants import MU_EARTH
from bsk_torch.sim.component import Bus
from bsk_torch.sim.dyn import hub
from bsk_torch.sim.dyn.effectors import wheels
from bsk_torch.sim.dyn.hub import HUB, fitted_hub
from bsk_torch.vec3 import Mat3, Vec3
from tests.sim.buses import N, vectors, write
from tests.support.refusals import check_refusals, refusal

GIVEN = {arg.name: arg.default for arg in HUB.args}

TENSOR = [70.0, 5.0, -3.0, 5.0, 80.0, 8.0, -3.0, 8.0, 60.0]


def random_tensors(n: int = N) -> torch.Tensor:
    """Inertia of four random points of mass, [n, 3, 3] kg m^2, which obeys every law of bodies."""
    r = torch.randn(n, 4, 3, dtype=torch.float64)
    square = (r * r).sum(-1)[..., None, None] * torch.eye(3).double() - r[..., :, None] * r[..., None, :]
    return (torch.rand(n, 4, 1, 1, dtype=torch.float64) * 20.0 * square).sum(1) + 5.0 * torch.eye(3).double()


def test_any_body_keeps_momentum_and_energy():
    """Free of torques, to the error of the method in small steps."""
    tensors = random_tensors()
    bus = write(Bus(50_000_000), sigma_BN=vectors(0.3), omega_BN_B=vectors(0.05), inertia_B=Mat3.of(tensors), effectors=())

    def momentum_and_energy() -> tuple[torch.Tensor, torch.Tensor]:
        spin = bus.inertia_B @ bus.omega_BN_B
        return (mrp_to_dcm(bus.sigma_BN).mT @ spin).stack(), bus.omega_BN_B.dot(spin)

    (H, E), omega = momentum_and_energy(), bus.omega_BN_B.stack()
    for _ in range(400):
        hub.rotate(bus)
    after_H, after_E = momentum_and_energy()
    assert ((after_H - H).norm(dim=-1) / H.norm(dim=-1)).amax() < 1e-9
    assert ((after_E - E).abs() / E).amax() < 1e-9
    assert (bus.omega_BN_B.stack() - omega).abs().amax() > 1e-3


class Plain(sats.Satellite):
    observation_spec = (obs.Time(),)
    action_spec = (act.Drift(duration=20.0), act.Drift(name="minute", duration=60.0))
    dyn_type = dyn.BasicDynamicsModel
    fsw_type = fsw.BasicFSWModel


FLIGHT = dict(
    oe=None,
    rN=[6.9e6, 1e5, 2e5],
    vN=[-200.0, 5200.0, 5500.0],
    sigma_init=[0.1, 0.2, -0.3],
    omega_init=[0.02, -0.01, 0.015],
    inertia=TENSOR,
    disturbance_vector=[0.0] * 3,
    dragCoeff=0.0,
)


def fly(orbit: str, backend: str = "eager", **args: object) -> dyn.DynamicsModel:
    env = SatelliteTasking(Plain("A", FLIGHT | args), num_envs=3, seed=0, orbit=orbit, backend=backend, time_limit=600.0)
    td = env.reset()
    for _ in range(5):
        td = env.step(td.set("action", torch.zeros(3, dtype=torch.int64)))["next"]
    return env.satellite.dynamics


def center(dynamics: dyn.DynamicsModel, c: list[float]) -> tuple[torch.Tensor, torch.Tensor]:
    lever = torch.tensor(c, dtype=torch.float64)
    NB = dynamics.BN.mT
    swing = torch.linalg.cross(dynamics.omega_BN_B, lever.expand(3, 3))
    return dynamics.r_BN_N + NB @ lever, dynamics.v_BN_N + (NB @ swing[..., None])[..., 0]


@pytest.mark.parametrize("orbit", ["arc", "integrated"])
def test_the_center_of_mass_moves_as_a_point(orbit):
    """Whatever its place in the body: the given orbit is its own, and gravity does not turn the body."""
    c = [0.3, -0.2, 0.1]
    plain, offset = fly(orbit), fly(orbit, r_CB_B=c)
    assert torch.equal(plain.sigma_BN, offset.sigma_BN)
    assert (plain.r_BN_N - offset.r_BN_N).norm(dim=-1).amin() > 0.1
    r, v = center(offset, c)
    # the integrator's error of the turning lever, a fraction of a millimeter in minutes
    torch.testing.assert_close(r, plain.r_BN_N, rtol=0, atol=2e-4 if orbit == "integrated" else 1e-8)
    torch.testing.assert_close(v, plain.v_BN_N, rtol=0, atol=2e-6 if orbit == "integrated" else 1e-8)


@pytest.mark.compiled
@pytest.mark.parametrize("orbit", ["arc", "integrated"])
def test_kernels_agree_with_tensors_for_drawn_bodies(orbit):
    drawn = dict(r_CB_B=rand.Uniform(-0.3, 0.3, 3), inertia=rand.Choice([TENSOR, [40.0, 0, 0, 0, 50.0, 0, 0, 0, 60.0]]))
    eager, compiled = (fly(orbit, backend, **drawn) for backend in ("eager", "compiled"))
    for name, bound in (("r_BN_N", 1e-7), ("sigma_BN", 1e-12), ("omega_BN_B", 1e-13)):
        torch.testing.assert_close(getattr(eager, name), getattr(compiled, name), rtol=0, atol=bound)
    assert eager.sigma_BN.unique(dim=0).shape[0] > 1


@pytest.mark.parametrize("orbit", ["arc", "integrated"])
@pytest.mark.nightly("integrated")
def test_gravity_turns_a_body_toward_the_vertical(orbit):
    """The torque is ``3 mu / r^3 x^ x (I x^)``: over a minute the momentum changes by as much."""

    class Stable(Plain):
        dyn_type = (dyn.GravityGradientDynModel, dyn.BasicDynamicsModel)

    found = {}
    for kind in (Plain, Stable):
        args = FLIGHT | {"omega_init": [0.0] * 3, "wheelSpeeds": [0.0] * 3}
        env = SatelliteTasking(kind("A", args), num_envs=1, seed=0, orbit=orbit, backend="eager", time_limit=60.0)
        env.step(env.reset().set("action", torch.ones(1, dtype=torch.int64)))
        found[kind] = env.satellite.dynamics.omega_BN_B[0]
    r, v = (torch.tensor(FLIGHT[name], dtype=torch.float64) for name in ("rN", "vN"))
    x = r + 30.0 * v  # in the middle of the minute
    sigma = torch.tensor(FLIGHT["sigma_init"], dtype=torch.float64)
    x_B = (mrp_to_dcm(Vec3.of(sigma)) @ Vec3.of(x / x.norm())).stack()
    inertia = torch.tensor(TENSOR, dtype=torch.float64).view(3, 3)
    torque = 3.0 * MU_EARTH / x.norm() ** 3 * torch.linalg.cross(x_B, inertia @ x_B)
    rate = torch.linalg.solve(inertia - wheels.SPIN_INERTIA * torch.eye(3).double(), torque) * 60.0
    torch.testing.assert_close(found[Stable] - found[Plain], rate, rtol=0, atol=0.02 * float(rate.norm()))
    assert rate.norm() > 1e-6


def test_the_form_of_the_hub_follows_from_the_arguments():
    assert fitted_hub(GIVEN) is HUB
    diagonal = fitted_hub(GIVEN | {"inertia": torch.diag(torch.tensor([70.0, 80.0, 60.0]))})
    assert [field.width for field in diagonal.params] == [3, 1]
    tensor = fitted_hub(GIVEN | {"inertia": TENSOR, "r_CB_B": rand.Uniform(-0.1, 0.1, 3)})
    assert [(field.name, field.width) for field in tensor.params] == [("inertia_B", 9), ("mass", 1), ("r_CB_B", 3)]


def test_rejects_impossible_bodies():
    def two(**args):
        """The first one decides what is built."""
        flat = FLIGHT | {"inertia": [70.0, 0, 0, 0, 80.0, 0, 0, 0, 60.0]}
        return ConstellationTasking([Plain("A", flat), Plain("B", flat | args)], num_envs=1)

    skew = [[70.0, 5.0, 0], [4.0, 80.0, 0], [0, 0, 60.0]]
    long, negative = [10.0, 0, 0, 0, 20.0, 0, 0, 0, 31.0], [10.0, 0, 0, 0, -20.0, 0, 0, 0, 31.0]
    check_refusals(
        refusal(lambda: fly("arc", inertia=skew), ValueError, "inertia=[70.0, 5.0, 0.0, 4.0, ", "kg m^2", "[i][k]", "[k][i]"),
        refusal(lambda: fly("arc", inertia=long), ValueError, "inertia", "[10.0, 20.0, 31.0]"),
        refusal(lambda: fly("arc", inertia=negative), ValueError, "inertia", "[-20.0, 10.0, 31.0]"),
        refusal(lambda: fly("arc", inertia=[10.0, 20.0, 25.0]), ValueError, "inertia", "9 numbers", "[3]"),
        refusal(lambda: fly("arc", mass=0.0), ValueError, "mass=0 kg"),
        refusal(lambda: two(inertia=TENSOR), ValueError, "inertia=[70.0, ", "products of inertia", "type"),
        refusal(lambda: two(r_CB_B=[0.1, 0, 0]), ValueError, "r_CB_B=[0.1, 0.0, 0.0] m", "origin of B", "type"),
    )


def test_the_triangle_inequality_can_be_waived():
    dynamics = fly("arc", inertia=[10.0, 0, 0, 0, 20.0, 0, 0, 0, 31.0], checkInertia=False)
    assert torch.isfinite(dynamics.omega_BN_B).all()
