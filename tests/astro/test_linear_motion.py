"""Linear relative motion to many moments, about chiefs on circular and eccentric orbits."""

import math

import pytest
import torch

from bsk_torch.astro.clohessy_wiltshire import propagate
from bsk_torch.astro.integrate import nystroem_step
from bsk_torch.astro.linear_motion import about_circle, about_orbit
from bsk_torch.astro.orbit import Elements, elements_to_rv
from bsk_torch.astro.relative import cd2hill, hill2cd
from bsk_torch.constants import MU_EARTH as MU
from bsk_torch.vec3 import Vec3

N = 40
DURATIONS = torch.tensor([600.0, 1200.0, 2000.0], dtype=torch.float64)


def chiefs(e, n=N):
    """Positions and velocities of chiefs with perigees at 6,900 km, all around their orbits."""
    torch.manual_seed(3)
    angles = torch.rand(4, n, dtype=torch.float64) * 2 * math.pi
    a = torch.full((n,), 6.9e6 / (1.0 - e), dtype=torch.float64)
    return [x.stack() for x in elements_to_rv(Elements(a, torch.full_like(a, e), 0.5 * angles[0], *angles[1:]))]


def deputies(size=60.0, n=N):
    direction = torch.nn.functional.normalize(torch.randn(2, n, 3, dtype=torch.float64), dim=-1)
    return direction[0] * size, direction[1] * 1e-3 * size


def fallen(r, v, seconds, h=2.0):
    """Two-body motion, integrated by itself."""

    def fall(x):
        return x * (-MU / torch.linalg.vector_norm(x, dim=-1, keepdim=True) ** 3)

    for _ in range(round(seconds / h)):
        r, v = nystroem_step(fall, r, v, h)
    return r, v


def at(motion, moment, rho, velocity):
    """Positions [N, K, 3]."""
    return motion.at(moment, Vec3.of(rho), Vec3.of(velocity)).stack().transpose(0, 1)


@pytest.mark.parametrize("e", [0.0, 0.04, 0.2])
def test_linear_motion_is_the_difference_of_two_orbits(e):
    """What is left is of second order: (distance)^2 / radius is 5 cm where 60 m have grown to 600 m."""
    chief, (rho, velocity) = chiefs(e), deputies()
    flown = fallen(*chief, 2000.0), fallen(*hill2cd(*chief, rho, velocity), 2000.0)
    exact, _ = cd2hill(*flown[0], *flown[1])
    found = at(about_orbit(*chief, DURATIONS, 20), -1, rho, velocity)[:, 2]
    away = torch.linalg.vector_norm(exact, dim=-1)
    assert bool((torch.linalg.vector_norm(found - exact, dim=-1) <= 0.01 + 2.0 * away.square() / 6.9e6).all())


@pytest.mark.parametrize("e", [0.0, 0.04, 0.2])
def test_errors_of_linear_motion_are_of_the_second_order(e):
    """Deputies a thousand times closer leave a millionth: what remains is the error of the integration, 1e-5 of the distance."""
    chief, (rho, velocity) = chiefs(e), deputies(0.06)
    flown = fallen(*chief, 2000.0), fallen(*hill2cd(*chief, rho, velocity), 2000.0)
    exact, _ = cd2hill(*flown[0], *flown[1])
    found = at(about_orbit(*chief, DURATIONS, 20), -1, rho, velocity)[:, 2]
    assert torch.allclose(found, exact, rtol=0, atol=1e-5)


def test_all_moments_lie_on_the_way():
    chief, (rho, velocity) = chiefs(0.04), deputies()
    motion = about_orbit(*chief, DURATIONS, 20)
    for moment, k in ((0, 0), (9, 1), (9, 2), (19, 0)):
        time = float(motion.time[moment, k])
        exact, _ = cd2hill(*fallen(*chief, time), *fallen(*hill2cd(*chief, rho, velocity), time))
        assert torch.allclose(at(motion, moment, rho, velocity)[:, k], exact, rtol=0, atol=0.1)


def test_on_circular_orbits_it_is_that_of_clohessy_and_wiltshire():
    chief, (rho, velocity) = chiefs(0.0), deputies()
    n = torch.sqrt(MU / torch.linalg.vector_norm(chief[0], dim=-1) ** 3)
    orbit, circle = about_orbit(*chief, DURATIONS, 20), about_circle(n, DURATIONS, 20)
    for moment in (0, 7, 19):
        found = at(orbit, moment, rho, velocity)
        assert torch.allclose(found, at(circle, moment, rho, velocity), rtol=0, atol=0.01)
        for k, time in enumerate(circle.time[moment]):
            exact, _ = propagate(rho, velocity, n, time)
            assert torch.allclose(at(circle, moment, rho, velocity)[:, k], exact, rtol=0, atol=1e-9)


def test_on_eccentric_orbits_it_is_not():
    """What the equations of Clohessy and Wiltshire leave out at an eccentricity of 0.04: tens of metres."""
    chief, (rho, velocity) = chiefs(0.04), deputies()
    n = torch.full((N,), math.sqrt(MU * (0.96 / 6.9e6) ** 3), dtype=torch.float64)
    orbit, circle = about_orbit(*chief, DURATIONS, 20), about_circle(n, DURATIONS, 20)
    away = at(orbit, -1, rho, velocity) - at(circle, -1, rho, velocity)
    assert float(torch.linalg.vector_norm(away, dim=-1)[:, 2].mean()) > 10.0


def test_deputies_share_the_motion_of_a_chief_but_no_other_rows():
    chief, (rho, velocity) = chiefs(0.04), deputies()
    whole = at(about_orbit(*chief, DURATIONS, 20), -1, rho, velocity)
    for rows in (slice(0, 1), slice(3, 20)):
        part = at(about_orbit(*(x[rows] for x in chief), DURATIONS, 20), -1, rho[rows], velocity[rows])
        assert torch.equal(part, whole[rows])
    motion = about_orbit(*chiefs(0.04, 3), DURATIONS, 5).repeated(2)
    assert motion.rr.x.y.shape == (5, 3, 6)
    assert torch.equal(motion.rv.x.y[..., 0], motion.rv.x.y[..., 1])
    assert not torch.equal(motion.rv.x.y[..., 1], motion.rv.x.y[..., 2])
