import itertools
import math
from functools import partial

import numpy as np
import pytest
import torch

from bsk_torch.astro.interpolate import BEFORE, COUNT, coefficients, position, positions, velocity
from bsk_torch.vec3 import Vec3
from tests.astro import test_integrate

STEPS = torch.arange(COUNT, dtype=torch.float64) - BEFORE
"""Where the nodes lie."""

MIDDLE, START, END = (0.0, 1.0), (-float(BEFORE), 1.0 - BEFORE), (COUNT - BEFORE - 2.0, COUNT - BEFORE - 1.0)
"""Steps that a lookup is used for: between the middle nodes, and between the outermost ones at either end of an arc."""


def polynomial(degree: int):
    """Three polynomials of s with random coefficients, and their derivative."""
    parts = [np.polynomial.Polynomial(c) for c in torch.randn(3, degree + 1, dtype=torch.float64).numpy()]
    return [lambda s, k=k: Vec3(*(torch.as_tensor(p.deriv(k)(s) if k else p(s)) for p in parts)) for k in range(2)]


def split(r: Vec3) -> list[Vec3]:
    """Nodes from vectors whose components hold all of them."""
    return [Vec3(*(x[k : k + 1] for x in r)) for k in range(COUNT)]


def test_exact_up_to_the_ninth_power():
    failures = []
    for degree, step in itertools.product(range(COUNT), [1.0, 60.0]):
        r, v = polynomial(degree)
        c, s = coefficients(split(r(STEPS))), torch.linspace(STEPS[0], STEPS[-1], 37, dtype=torch.float64)
        # nodes are as large as 5^degree; at the edges their rounding is summed with powers of s that are as large as 5^9
        size = 5.0**degree
        off = float((position(c, s).stack() - r(s).stack()).abs().amax())
        off_v = float((velocity(c, s, step).stack() - v(s).stack() / step).abs().amax())
        if not (off <= 1e-12 * size and off_v <= 5e-12 * size / step):
            failures.append(f"degree={degree}, step={step}: off by {off} and {off_v}")
    assert not failures, "\n".join(failures)


def test_coefficients_are_those_of_the_polynomial():
    powers = torch.randn(3, COUNT, dtype=torch.float64)
    nodes = Vec3(*(torch.as_tensor(np.polynomial.polynomial.polyval(STEPS.numpy(), c.numpy())) for c in powers))
    found = torch.stack([c.stack()[0] for c in coefficients(split(nodes))], -1)
    # nodes are as large as 5^9; each power has a share of 1 / 5^k of that
    assert ((found - powers).abs() * 5.0 ** torch.arange(COUNT)).amax() < 1e-14 * 5.0**COUNT
    r, _ = polynomial(COUNT)
    c, s = coefficients(split(r(STEPS))), torch.tensor([0.5], dtype=torch.float64)
    assert (position(c, s).stack() - r(s).stack()).abs().amax() > 1.0


kepler = partial(test_integrate.kepler, angles=(1.0, 0.0, 0.0))


def errors(step: float, where: tuple[float, float], a: float = 6871e3, e: float = 0.0) -> tuple[float, float]:
    """Largest errors of position and velocity near periapsis."""
    r, _ = kepler(step * STEPS, a, e)
    c, s = coefficients(split(r)), torch.linspace(*where, 101, dtype=torch.float64)
    truth = kepler(step * s, a, e)
    return (position(c, s) - truth[0]).norm().amax().item(), (velocity(c, s, step) - truth[1]).norm().amax().item()


@pytest.mark.parametrize("where", [START, MIDDLE, END])
def test_order_of_convergence(where):
    """Position of tenth order, velocity of ninth."""
    (r_coarse, v_coarse), (r_fine, v_fine) = errors(240.0, where), errors(120.0, where)
    assert math.log2(r_coarse / r_fine) == pytest.approx(COUNT, abs=0.1)
    assert math.log2(v_coarse / v_fine) == pytest.approx(COUNT - 1, abs=0.1)


@pytest.mark.parametrize(
    ("a", "e", "where", "metres", "metres_per_second"),
    [
        # measured 3e-9 and 1.5e-10 in the middle, which is rounding, and 3e-7 and 2e-8 at the edges
        (6871e3, 0.0, MIDDLE, 1e-8, 5e-10),
        (6871e3, 0.0, START, 5e-7, 4e-8),
        (6871e3, 0.0, END, 1e-6, 4e-8),
        # perigee at 350 km of e = 0.2: measured 5.5e-6 and 3.1e-7, and 2.7e-4 and 3.8e-5
        (8410e3, 0.2, MIDDLE, 1e-5, 5e-7),
        (8410e3, 0.2, START, 4e-4, 5e-5),
        (8410e3, 0.2, END, 4e-4, 5e-5),
        # geostationary: rounding only
        (42164e3, 0.0, MIDDLE, 3e-8, 1e-10),
        (42164e3, 0.0, END, 3e-7, 1e-8),
    ],
)
def test_error_with_nodes_a_minute_apart(a, e, where, metres, metres_per_second):
    r, v = errors(60.0, where, a, e)
    assert r < metres
    assert v < metres_per_second


def test_nodes_are_met():
    r, v = kepler(60.0 * STEPS, 6871e3, 0.0)
    c = coefficients(split(r))
    # the middle node is a coefficient; at the edges nine powers of 5 of rounded differences add up
    assert torch.equal(position(c, STEPS).stack()[BEFORE], r.stack()[BEFORE])
    torch.testing.assert_close(position(c, STEPS).stack(), r.stack(), rtol=0, atol=2e-6)
    torch.testing.assert_close(velocity(c, STEPS, 60.0).stack(), v.stack(), rtol=0, atol=1e-7)


def test_neighbouring_polynomials_agree_where_they_meet():
    """What a tick sees does not jump when the next record begins."""
    r, _ = kepler(60.0 * torch.arange(COUNT + 1, dtype=torch.float64), 6871e3, 0.0)
    rows = r.stack()
    first, second = (coefficients([Vec3.of(row) for row in rows[k : k + COUNT].unsqueeze(1)]) for k in (0, 1))
    one, zero = torch.ones(1, dtype=torch.float64), torch.zeros(1, dtype=torch.float64)
    torch.testing.assert_close(position(first, one).stack(), position(second, zero).stack(), rtol=0, atol=1e-8)
    # the ends of an interval are where velocities are worst
    torch.testing.assert_close(velocity(first, one, 60.0).stack(), velocity(second, zero, 60.0).stack(), rtol=0, atol=1e-9)


def test_positions_of_many_rows():
    """The same as one row at a time, bit for bit."""
    nodes, s = torch.randn(7, COUNT, 3, dtype=torch.float64), torch.rand(7, dtype=torch.float64)
    together = positions(nodes, s)
    assert together.shape == (7, 3)
    for k in range(7):
        c = coefficients([Vec3.of(node) for node in nodes[k]])
        assert torch.equal(together[k], position(c, s[k]).stack())
