from __future__ import annotations

import math

import numpy as np
import pytest
import torch

from bsk_torch.astro.interpolate import Node, quintic_position, quintic_velocity
from bsk_torch.astro.orbit import Elements, elements_to_rv
from bsk_torch.constants import MU_EARTH
from bsk_torch.vec3 import Vec3


def polynomial(degree: int):
    """Three polynomials with random coefficients, their derivative and second derivative."""
    parts = [np.polynomial.Polynomial(c) for c in torch.randn(3, degree + 1, dtype=torch.float64).numpy()]
    return [lambda t, k=k: Vec3(*(torch.as_tensor(p.deriv(k)(t) if k else p(t)) for p in parts)) for k in range(3)]


@pytest.mark.parametrize("degree", [0, 1, 2, 3, 4, 5])
def test_exact_on_quintics(degree):
    r, v, a = polynomial(degree)
    begin, step = 0.3, 1.7
    nodes = [Node(*(f(torch.tensor(t, dtype=torch.float64)) for f in (r, v, a))) for t in (begin, begin + step)]
    s = torch.linspace(0.0, 1.0, 11, dtype=torch.float64)
    t = begin + s * step
    # rounding: terms up to 2^5 times the coefficients
    torch.testing.assert_close(quintic_position(s, step, *nodes).stack(), r(t).stack(), rtol=0, atol=1e-12)
    torch.testing.assert_close(quintic_velocity(s, step, *nodes).stack(), v(t).stack(), rtol=0, atol=1e-11)


def test_not_exact_on_a_sixth_power():
    r, v, a = polynomial(6)
    nodes = [Node(*(f(torch.tensor(t, dtype=torch.float64)) for f in (r, v, a))) for t in (0.0, 1.0)]
    s = torch.tensor([0.5], dtype=torch.float64)
    assert (quintic_position(s, 1.0, *nodes).stack() - r(s).stack()).abs().amax() > 1e-4


def circular(t: torch.Tensor) -> Node:
    """A circular orbit at 6871 km."""
    n = math.sqrt(MU_EARTH / 6871e3**3)
    zero = torch.zeros(1, dtype=torch.float64)
    r, v = elements_to_rv(Elements(zero + 6871e3, zero, zero + 1.0, zero, zero, n * t))
    return Node(r, v, r * (-(n**2)))


def error(step: float) -> tuple[float, float]:
    s = torch.linspace(0.0, 1.0, 21, dtype=torch.float64)
    nodes = [circular(torch.tensor([t], dtype=torch.float64)) for t in (100.0, 100.0 + step)]
    truth = circular(100.0 + s * step)
    position = (quintic_position(s, step, *nodes) - truth.r).norm().amax()
    return position.item(), (quintic_velocity(s, step, *nodes) - truth.v).norm().amax().item()


def test_order_of_convergence():
    """Position of sixth order, velocity of fifth."""
    (r_coarse, v_coarse), (r_fine, v_fine) = error(480.0), error(240.0)
    assert math.log2(r_coarse / r_fine) == pytest.approx(6.0, abs=0.1)
    assert math.log2(v_coarse / v_fine) == pytest.approx(5.0, abs=0.1)


def test_error_over_a_minute():
    """What the module promises for the nodes of an arc: below 0.02 mm."""
    assert error(60.0)[0] < 2e-5
    assert error(60.0)[1] < 2e-6


def test_nodes_are_met():
    nodes = [circular(torch.tensor([t], dtype=torch.float64)) for t in (0.0, 60.0)]
    for s, node in zip((0.0, 1.0), nodes, strict=True):
        at = torch.tensor([s], dtype=torch.float64)
        torch.testing.assert_close(quintic_position(at, 60.0, *nodes).stack(), node.r.stack(), rtol=1e-15, atol=1e-9)
        torch.testing.assert_close(quintic_velocity(at, 60.0, *nodes).stack(), node.v.stack(), rtol=1e-13, atol=1e-9)
