"""Relative motion near a circular orbit."""

import math

import torch

from bsk_torch.astro.clohessy_wiltshire import circumnavigation, propagate, transfer, transition
from bsk_torch.astro.integrate import rk4_step
from bsk_torch.astro.relative import cd2hill, hill2cd
from bsk_torch.vec3 import Vec3

MU = 3.986004418e14
RADIUS = 7.0e6
N = math.sqrt(MU / RADIUS**3)


def generator():
    """Equations of motion as a matrix, x' = A x."""
    A = torch.zeros(6, 6, dtype=torch.float64)
    A[:3, 3:] = torch.eye(3, dtype=torch.float64)
    A[3, 0], A[3, 4], A[4, 3], A[5, 2] = 3 * N**2, 2 * N, -2 * N, -(N**2)
    return A


def draw(*shape):
    return torch.randn(*shape, dtype=torch.float64)


def test_transitions_are_exponentials_of_the_equations_of_motion():
    times = torch.tensor([0.0, 1.0, 300.0, 2000.0, 9000.0], dtype=torch.float64)
    step = transition(torch.tensor(N, dtype=torch.float64), times)
    assert len(times) == len(step.rr)
    for k, time in enumerate(times.tolist()):
        exact = torch.linalg.matrix_exp(generator() * time)
        found = torch.cat([torch.cat([step.rr[k], step.rv[k]], 1), torch.cat([step.vr[k], step.vv[k]], 1)])
        assert torch.allclose(found, exact, rtol=1e-9, atol=1e-12)


def test_motion_is_the_relative_one_of_two_bodies():
    """The error is of second order in the distance: 100 m over 7,000 km, for a third of an orbit, leave centimetres."""
    r_C = torch.tensor([RADIUS, 0.0, 0.0], dtype=torch.float64)
    v_C = torch.tensor([0.0, math.sqrt(MU / RADIUS), 0.0], dtype=torch.float64)
    rho, velocity = draw(3) * 50.0, draw(3) * 0.05
    r_D, v_D = hill2cd(r_C, v_C, rho, velocity)

    def fall(_, __, y):
        r, v = y
        return v, r * (-MU / r.dot(r) ** 1.5)

    chief, deputy = (Vec3.of(r_C), Vec3.of(v_C)), (Vec3.of(r_D), Vec3.of(v_D))
    for _ in range(200):
        chief, deputy = rk4_step(fall, chief, 10.0), rk4_step(fall, deputy, 10.0)
    exact = cd2hill(*(x.stack() for x in (*chief, *deputy)))
    found = propagate(rho, velocity, torch.tensor(N, dtype=torch.float64), torch.tensor(2000.0, dtype=torch.float64))
    assert torch.allclose(found[0], exact[0], rtol=0, atol=0.05)
    assert torch.allclose(found[1], exact[1], rtol=0, atol=1e-4)


def test_a_transfer_arrives():
    rho, target, n = draw(50, 3) * 200, draw(50, 3) * 200, torch.full((50,), N, dtype=torch.float64)
    time = torch.linspace(100.0, 2500.0, 50, dtype=torch.float64)
    arrived, _ = propagate(rho, transfer(rho, target, n, time), n, time)
    assert torch.allclose(arrived, target, rtol=0, atol=1e-9)


def test_a_circumnavigation_comes_back_on_an_ellipse_of_axes_one_to_two():
    n = torch.tensor(N, dtype=torch.float64)
    start = torch.tensor([50.0, 0.0, 20.0], dtype=torch.float64)
    quarter = math.pi / (2 * N)
    times = torch.arange(5, dtype=torch.float64) * quarter
    path, _ = propagate(start.expand(5, 3), circumnavigation(start, n).expand(5, 3), n, times)
    expected = torch.tensor([[50.0, 0, 20], [0, -100, 0], [-50, 0, -20], [0, 100, 0], [50, 0, 20]], dtype=torch.float64)
    assert torch.allclose(path, expected, rtol=0, atol=1e-9)
