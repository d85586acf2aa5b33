"""Initial attitudes and wheel speeds: bsk_rl's numbers where they are fixed, distributions where they are random."""

import numpy as np
import pytest
import torch

from bsk_torch import SatelliteTasking, act, obs, sats
from bsk_torch.initial import hill_frame_attitude, random_tumble
from bsk_torch.rand import Uniform, first_key, random_circular_orbit, random_orbit, random_unit_vector

R, V = np.array([-2438.5e3, 5811.1e3, 3011.7e3]), np.array([-5543.2, -4210.9, 3605.4])
SIGMA = [0.21770807471852982, 0.06587343534223743, 0.5540728899196935]
SPINS = [
    (None, [0.0, 0.0, 0.0011223852547642165]),
    (dict(rate=0.5, axis="velocity"), [-1.5058269526632857e-05, 0.008726633268059109, 0.0011223852547642167]),
    (dict(type="fixed", rate=-1.0, axis=[1.0, 2.0, 2.0]), [-0.005817764173314432, -0.011635528346628864, -0.010513143091864647]),
]


@pytest.mark.parametrize(("spin", "omega"), SPINS, ids=str)
def test_a_spin_in_the_hill_frame_is_bsk_rls(spin, omega):
    got = hill_frame_attitude(R, V, spin)
    np.testing.assert_allclose(got[0], SIGMA, rtol=1e-12)
    np.testing.assert_allclose(got[1], omega, rtol=1e-12, atol=1e-18)
    batch = hill_frame_attitude(torch.tensor(R).expand(2, 3), torch.tensor(V).expand(2, 3), spin)
    np.testing.assert_allclose(batch[1], [got[1]] * 2, rtol=1e-12, atol=1e-18)


def test_a_random_spin_is_drawn_about_its_axis():
    sigma, spin = hill_frame_attitude(R, V, dict(type="uniform", low=1.0, high=2.0, axis="normal"))
    drawn = spin.draw(first_key(50).named("omega_init")) - torch.tensor(hill_frame_attitude(R, V)[1])
    np.testing.assert_allclose(sigma, SIGMA, rtol=1e-12)
    rates = torch.rad2deg(drawn[:, 2])
    assert 1.0 < rates.min() < 1.2
    assert 1.8 < rates.max() < 2.0
    assert not drawn[:, :2].any()
    anywhere = hill_frame_attitude(R, V, dict(rate=1.0, axis="random"))[1].draw(first_key(9)) - torch.tensor(SPINS[0][1])
    torch.testing.assert_close(torch.rad2deg(anywhere.norm(dim=1)), torch.ones(9, dtype=torch.float64))


def test_tumbles_and_directions_are_distributions():
    sigma, omega = random_tumble(0.01)
    assert (sigma, omega) == (Uniform(0.0, 1.0, 3), Uniform(-0.01, 0.01, 3))
    assert random_circular_orbit(i=45.0, alt=600.0) == random_orbit(i=45.0, a=6971.0, omega=0.0)
    torch.testing.assert_close(random_unit_vector().draw(first_key(5)).norm(dim=1), torch.ones(5, dtype=torch.float64))


class Plain(sats.Satellite):
    observation_spec = (obs.Time(),)
    action_spec = (act.Drift(duration=10.0),)


def test_functions_of_sat_args_may_return_distributions():
    """bsk_rl's programs write random_orbit both as a function and inside of one; rows do not depend on the batch."""
    args = dict(oe=random_orbit, sigma_init=lambda: random_tumble()[0], wheelSpeeds=lambda: Uniform(-400.0, 400.0, 3))
    few, many = (
        SatelliteTasking(Plain("S", args), num_envs=n, seed=1, backend="eager", time_limit=lambda: Uniform(20.0, 60.0))
        for n in (2, 3)
    )
    few.reset(), many.reset()
    assert len(many.satellite.dynamics.r_BN_N.unique(dim=0)) == 3
    for read in (lambda e: e.satellite.dynamics.r_BN_N, lambda e: e.satellite.dynamics.wheel_speeds, lambda e: e.time_limit):
        torch.testing.assert_close(read(few), read(many)[:2])
    wide = SatelliteTasking(Plain("S", dict(oe=random_orbit())), num_envs=2, seed=1, backend="eager", time_limit=20.0)
    wide.reset()
    torch.testing.assert_close(wide.satellite.dynamics.r_BN_N, few.satellite.dynamics.r_BN_N)
