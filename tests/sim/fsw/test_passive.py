"""Passive satellites tumble as torque-free rigid bodies: conservation laws, Euler's solution, and Dzhanibekov's flips."""

import math

import pytest
import torch

from bsk_torch import ConstellationTasking, SatelliteTasking, act, dyn, fsw, obs, rand, sats
from bsk_torch.sim.dyn.hub import box_inertia

BODY = dict(mass=120.0, width=1.0, depth=0.6, height=2.2)
"""Three different moments of inertia: 13.6, 52 and 58.4 kg m^2 about the body axes."""


class Debris(sats.Satellite):
    observation_spec = (obs.SatProperties(dict(prop="sigma_BN"), dict(prop="omega_BN_B")),)
    action_spec = (act.Drift(duration=50.0),)
    dyn_type, fsw_type = dyn.DynamicsModel, fsw.TumblingFSWModel


def inertia():
    return box_inertia(*(torch.tensor([value], dtype=torch.float64) for value in BODY.values()))[0]


def tumble(omega, steps=8, kind=Debris, num_envs=1, **args):
    """Attitudes [K, N, 3, 3], rates [K, N, 3] and times [K] at the ends of steps of 50 s."""
    given = BODY | dict(sigma_init=[0.2, -0.3, 0.1], omega_init=omega) | args
    env = SatelliteTasking(kind("Debris", given), num_envs=num_envs, seed=1, backend="eager", dtype=torch.float64)
    td, found = env.reset(), []
    for _ in range(steps + 1):
        dynamics = env.satellite.dynamics
        found.append((dynamics.BN, dynamics.omega_BN_B, env.simulator.sim_time[0]))
        td["action"] = torch.zeros(num_envs, dtype=torch.int64)
        td = env.step(td)["next"]
    return [torch.stack(part) for part in zip(*found, strict=True)]


OMEGA = (0.03, 0.02, -0.015)


@pytest.fixture(scope="module")
def motion():
    return tumble(OMEGA)


def test_motion_starts_as_told_and_conserves_momentum_and_energy(motion):
    assert motion[1][0, 0].tolist() == list(OMEGA)
    assert motion[2].tolist() == pytest.approx([50.0 * k for k in range(9)])
    # The error of a Runge-Kutta step of h = 1 s is some (omega h)^5 / 120 = 1e-9 of the rate: 4e-7 in 400 s.
    BN, omega, _ = motion
    H_N = (BN.mT @ (inertia() * omega).unsqueeze(-1)).squeeze(-1)
    energy = 0.5 * (omega * inertia() * omega).sum(-1)
    assert float((H_N - H_N[0]).norm(dim=-1).max() / H_N[0].norm()) < 4e-7
    assert float((energy - energy[0]).abs().max() / energy[0]) < 4e-7
    assert float((omega - omega[0]).abs().max()) > 0.02  # it does tumble


def elliptic(u, m):
    """Jacobi's sn, cn and dn of the parameter m, by the arithmetic-geometric mean (Abramowitz and Stegun, 16.4)."""
    a, b, means = 1.0, math.sqrt(1.0 - m), []
    while a - b > 1e-16 and len(means) < 20:
        a, b, c = 0.5 * (a + b), math.sqrt(a * b), 0.5 * (a - b)
        means.append((a, c))
    phi = 2.0 ** len(means) * a * u
    for a, c in reversed(means):
        phi = 0.5 * (phi + math.asin(c / a * math.sin(phi)))
    return math.sin(phi), math.cos(phi), math.sqrt(1.0 - m * math.sin(phi) ** 2)


def test_rates_are_eulers_solution():
    """Circular functions at m = 0, hyperbolic ones at m = 1."""
    assert elliptic(0.7, 0.0) == pytest.approx((math.sin(0.7), math.cos(0.7), 1.0), abs=1e-15)
    assert elliptic(0.7, 1.0 - 1e-12) == pytest.approx((math.tanh(0.7), 1.0 / math.cosh(0.7), 1.0 / math.cosh(0.7)), abs=1e-10)
    # Absolute, of rates of 0.03 rad/s; the sign of the middle rate follows from its initial slope.
    moments = inertia().tolist()
    middle = sorted(moments)[1]
    omega = [0.0 if moment == middle else 0.02 if moment == min(moments) else 0.03 for moment in moments]
    _, found, times = tumble(tuple(omega))
    assert len(times) == 9
    k = moments.index(middle)
    slope = (moments[(k + 1) % 3] - moments[(k + 2) % 3]) * omega[(k + 1) % 3] * omega[(k + 2) % 3]
    for row, t in enumerate(times.tolist()):
        expected = euler(omega, t)
        expected[middle] *= math.copysign(1.0, slope)
        assert found[row, 0].tolist() == pytest.approx([expected[moment] for moment in moments], abs=1e-8)


def euler(omega, t):
    """Rates by axis at time t of a body that starts without a rate about its middle axis (Landau and Lifshitz, section 37).

    With ``I1 < I2 < I3`` and ``H^2 > 2 T I2`` the rates are ``A1 cn, A2 sn, A3 dn`` of ``tau = lambda t``.
    """
    (I1, w1), (I2, _), (I3, w3) = sorted(zip(inertia().tolist(), omega, strict=True))
    H2, T2 = (I1 * w1) ** 2 + (I3 * w3) ** 2, I1 * w1**2 + I3 * w3**2
    assert H2 > T2 * I2
    rate = math.sqrt((I3 - I2) * (H2 - T2 * I1) / (I1 * I2 * I3))
    m = (I2 - I1) * (T2 * I3 - H2) / ((I3 - I2) * (H2 - T2 * I1))
    sn, cn, dn = elliptic(rate * t, m)
    w2 = math.sqrt((T2 * I3 - H2) / (I2 * (I3 - I2)))
    return {I1: w1 * cn, I2: w2 * sn, I3: w3 * dn}


def test_a_spin_about_the_middle_axis_turns_over():
    """The intermediate axis: a small disturbance grows until the spin has reversed; about the others it stays small."""
    moments = inertia().tolist()
    assert len(set(moments)) == 3
    omega = [[1e-3 if other != moment else 0.05 for other in moments] for moment in moments]
    rates = tumble(rand.per_env(omega), steps=12, num_envs=3)[1].diagonal(dim1=1, dim2=2)
    assert (rates < -0.045).any(0).tolist() == [moment == sorted(moments)[1] for moment in moments]


def test_rows_do_not_depend_on_the_batch_and_torques_act():
    class Pushed(Debris):
        dyn_type = dyn.DisturbanceTorqueDynModel

    free, three = tumble(OMEGA, steps=2)[1], tumble(OMEGA, steps=2, num_envs=3)[1]
    assert torch.equal(three[:, 1:2], free)
    pushed = tumble((0.0, 0.0, 0.0), steps=2, kind=Pushed, disturbance_vector=[1e-4, 0.0, 0.0])[1]
    assert pushed[-1, 0, 0].item() == pytest.approx(1e-4 * 100.0 / inertia()[0].item(), rel=1e-9)


def test_wheels_of_a_passive_satellite_keep_turning_and_stiffen_it():
    class Wheeled(Debris):
        dyn_type = dyn.BasicDynamicsModel

    BN, omega, _ = tumble((0.0, 0.0, 0.0), steps=4, kind=Wheeled, wheelSpeeds=[1000.0, 0.0, 0.0], disturbance_vector=None)
    assert float(omega.abs().max()) < 1e-15
    assert torch.allclose(BN, BN[0].expand_as(BN), atol=1e-14)


def test_a_passive_satellite_flies_beside_others():
    """A tumbling chief observed by a satellite that is imposed the Hill frame."""
    looking = type(
        "Looking",
        (Debris,),
        {
            "observation_spec": (obs.RelativeProperties(dict(prop="rso_omega_BH"), dict(prop="sigma_DC"), chief_name="Debris"),),
            "fsw_type": fsw.FSWModel,
        },
    )
    satellites = [Debris("Debris", BODY | dict(omega_init=OMEGA)), looking("Camera")]
    env = ConstellationTasking(satellites, num_envs=2, seed=1, backend="eager", dtype=torch.float64)
    seen = env.reset()["looking", "observation"]
    debris = env.fleet.satellite("Debris").dynamics
    assert torch.allclose(seen[:, 0, :3], debris.omega_BH_H, atol=1e-16)
    assert debris.omega_BN_B.tolist() == [list(OMEGA)] * 2
