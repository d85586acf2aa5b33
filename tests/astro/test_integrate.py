import math
from collections.abc import Sequence

import numpy as np
import pytest
import torch

from bsk_torch.astro.integrate import Quadrature, nystroem_step, quadrature, rk4_step
from bsk_torch.astro.orbit import Elements, elements_to_rv
from bsk_torch.constants import MU_EARTH
from bsk_torch.vec3 import Vec3


def kepler(t: torch.Tensor, a: float = 7.5e6, e: float = 0.08, angles: Sequence[float] = (0.9, 2.0, 0.5)) -> tuple[Vec3, Vec3]:
    """Analytic two-body motion from periapsis; Kepler's equation by Newton's method."""
    mean = math.sqrt(MU_EARTH / a**3) * t
    anomaly = mean.clone()
    for _ in range(20):
        anomaly = anomaly - (anomaly - e * torch.sin(anomaly) - mean) / (1.0 - e * torch.cos(anomaly))
    f = 2.0 * torch.atan2(math.sqrt(1.0 + e) * torch.sin(anomaly / 2), math.sqrt(1.0 - e) * torch.cos(anomaly / 2))
    zero = torch.zeros_like(f)
    return elements_to_rv(Elements(zero + a, zero + e, *(zero + angle for angle in angles), f))


def attraction(r: Vec3) -> Vec3:
    return r * (-MU_EARTH / r.norm() ** 3)


def start() -> tuple[Vec3, Vec3]:
    return kepler(torch.zeros(1, dtype=torch.float64))


def rk4_error(steps: int, span: float = 1800.0) -> float:
    y = start()
    for _ in range(steps):
        y = rk4_step(lambda stage, offset, y: (y[1], attraction(y[0])), y, span / steps)
    return (y[0] - kepler(torch.tensor([span], dtype=torch.float64))[0]).norm().item()


def nystroem_error(steps: int, span: float = 1800.0) -> float:
    y, rate = (torch.stack(tuple(x)) for x in start())
    for _ in range(steps):
        y, rate = nystroem_step(lambda x: torch.stack(tuple(attraction(Vec3(*x)))), y, rate, span / steps)
    exact = kepler(torch.tensor([span], dtype=torch.float64))
    return max(float((Vec3(*y) - exact[0]).norm()), 1e3 * float((Vec3(*rate) - exact[1]).norm()))


def test_nystroem_steps_are_of_fourth_order() -> None:
    """Half the step leaves a sixteenth of the error."""
    assert 14.0 < nystroem_error(45) / nystroem_error(90) < 18.0
    assert nystroem_error(450) < 1e-2


def test_rk4_is_of_fourth_order():
    """Slope of the error over the step, by regression."""
    steps = [15, 20, 30, 40, 60]
    slope = np.polyfit(np.log(steps), np.log([rk4_error(n) for n in steps]), 1)[0]
    assert slope == pytest.approx(-4.0, abs=0.15)


def test_rk4_reports_stage_and_time():
    """The rates see the stages 0 to 3 at the offsets 0, h/2, h/2, h, which makes t^3 exact."""
    seen = []

    def rates(stage, offset, y):
        seen.append((stage, offset))
        return (Vec3(*(torch.tensor([4.0 * offset**3], dtype=torch.float64),) * 3),)

    (result,) = rk4_step(rates, (Vec3.of(torch.zeros(1, 3, dtype=torch.float64)),), 2.0)
    assert seen == [(0, 0.0), (1, 1.0), (2, 1.0), (3, 2.0)]
    assert result.x.item() == pytest.approx(16.0, rel=1e-15)


@pytest.mark.parametrize("outputs", [None, (0.25, 0.5, 1.0)])
@pytest.mark.parametrize("degree", [0, 1, 5, 12])
def test_quadrature_is_exact_on_polynomials(degree, outputs):
    q = quadrature(12, outputs)
    polynomial = np.polynomial.Polynomial(torch.randn(degree + 1, dtype=torch.float64).numpy())
    once, twice = polynomial.integ(1), polynomial.integ(2)
    values = torch.as_tensor(polynomial(q.nodes.numpy()))
    for matrix, exact in ((q.value, polynomial), (q.velocity, once), (q.position, twice)):
        expected = torch.as_tensor(exact(q.times.numpy()))
        torch.testing.assert_close(matrix @ values, expected, rtol=0, atol=1e-13)
    if outputs is None:
        assert torch.equal(q.times, q.nodes)
    else:
        assert q.times.tolist() == pytest.approx(outputs, abs=1e-15)


def test_nodes_cover_the_interval():
    nodes = quadrature(8).nodes
    assert (nodes[0], nodes[-1]) == (0.0, 1.0)
    assert (nodes.diff() > 0).all()


def picard_path(q: Quadrature, r0: Vec3, v0: Vec3, a: Vec3, length: float) -> Vec3:
    """Positions at the output times of q from accelerations at its nodes."""
    time = (q.times * length).unsqueeze(-1)
    return Vec3(*(r + time * v + length**2 * (q.position @ acc) for r, v, acc in zip(r0, v0, a, strict=True)))


def picard_velocity(q: Quadrature, v0: Vec3, a: Vec3, length: float) -> Vec3:
    return Vec3(*(v + length * (q.velocity @ acc) for v, acc in zip(v0, a, strict=True)))


def test_path_of_a_constant_acceleration():
    """r0 + v0 t + a t^2 / 2 over seven seconds."""
    q = quadrature(6, (0.5, 1.0))
    r0, v0, a = (Vec3.of(torch.randn(4, 3, dtype=torch.float64)) for _ in range(3))
    everywhere = Vec3(*(x.expand(7, 4) for x in a))
    path, velocity = picard_path(q, r0, v0, everywhere, 7.0), picard_velocity(q, v0, everywhere, 7.0)
    for k, t in enumerate((3.5, 7.0)):
        torch.testing.assert_close(path.stack()[k], (r0 + v0 * t + a * (0.5 * t * t)).stack(), rtol=0, atol=1e-12)
        torch.testing.assert_close(velocity.stack()[k], (v0 + a * t).stack(), rtol=0, atol=1e-12)


def test_picard_solves_kepler():
    span, q = 3600.0, quadrature(56)
    r0, v0 = start()
    r = Vec3(*(x.expand(57, 1) for x in r0))
    for _ in range(60):
        r = picard_path(q, r0, v0, attraction(r), span)
    velocity = picard_velocity(q, v0, attraction(r), span)
    truth_r, truth_v = kepler(q.times * span)
    # rounding: 57-term sums of a (3600 s)^2 = 1e8 m and a 3600 s = 3e4 m/s
    assert (r.stack()[:, 0] - truth_r.stack()).norm(dim=-1).amax() < 1e-6
    assert (velocity.stack()[:, 0] - truth_v.stack()).norm(dim=-1).amax() < 1e-9
