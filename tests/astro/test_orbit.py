import math

import pytest
import torch

from bsk_torch.astro.orbit import (
    Elements,
    elements_to_rv,
    hill_frame,
    hill_rate,
    hill_to_inertial,
    periapsis_radius,
    rv_to_elements,
)
from bsk_torch.constants import MU_EARTH
from bsk_torch.vec3 import Vec3

TIGHT = 1e-12  # relative; angles of an orbit with e = 1e-3 are known to 1e-16 / e


def elements(a=7e6, e=0.1, i=0.8, Omega=1.0, omega=2.0, f=3.0) -> Elements:
    return Elements(*(torch.tensor([x], dtype=torch.float64) for x in (a, e, i, Omega, omega, f)))


def random_elements(n: int = 300) -> Elements:
    u = torch.rand(6, n, dtype=torch.float64)
    turn = 2.0 * math.pi
    return Elements(6.6e6 + 3e7 * u[0], 1e-3 + 0.7 * u[1], 0.01 + 3.1 * u[2], turn * u[3], turn * u[4], turn * u[5])


def turned_by(a: torch.Tensor, b: torch.Tensor) -> torch.Tensor:
    """Distance of two angles on the circle."""
    return torch.remainder(a - b + math.pi, 2.0 * math.pi) - math.pi


def assert_same(found: Elements, expected: Elements, tolerance: float = TIGHT) -> None:
    torch.testing.assert_close(found.a, expected.a, rtol=tolerance, atol=0)
    torch.testing.assert_close(found.e, expected.e, rtol=0, atol=tolerance)
    for one, other in zip(found[2:], expected[2:], strict=True):
        assert turned_by(one, other).abs().amax() < tolerance


def test_round_trip():
    oe = random_elements()
    found = rv_to_elements(*elements_to_rv(oe))
    assert_same(found, oe, 1e-11)  # angles from the apse: 1e-15 / e, and e goes down to 1e-3
    for angle in found[3:]:
        assert ((angle >= 0) & (angle < 2.0 * math.pi)).all()
    mu = torch.tensor([4.9e12], dtype=torch.float64)
    oe = elements(a=2e6)
    assert_same(rv_to_elements(*elements_to_rv(oe, mu), mu), oe)
    r, v = elements_to_rv(elements(i=-0.8, Omega=1.0, omega=2.0))
    assert_same(rv_to_elements(r, v), elements(i=0.8, Omega=1.0 + math.pi, omega=2.0 + math.pi))


def test_elements_do_not_depend_on_the_batch():
    """To the last bit, which torch's atan2 and hypot differ in between the bulk and the rest of a tensor."""
    r, v = elements_to_rv(random_elements(301))
    whole = torch.stack(rv_to_elements(r, v))
    alone = [rv_to_elements(*(Vec3(*(x[k : k + 1] for x in vector)) for vector in (r, v))) for k in range(301)]
    assert torch.equal(torch.cat([torch.stack(oe) for oe in alone], 1), whole)


@pytest.mark.parametrize("i", [0.5, 2.5])
def test_circular(i):
    """omega is zero and f the argument of latitude."""
    found = rv_to_elements(*elements_to_rv(elements(e=0.0, i=i, omega=2.0, f=3.0)))
    assert_same(found, elements(e=0.0, i=i, omega=0.0, f=5.0))


@pytest.mark.parametrize(("i", "sign"), [(0.0, 1.0), (math.pi, -1.0)])
def test_equatorial(i, sign):
    """Omega is zero and omega the longitude of periapsis, counted along the motion."""
    found = rv_to_elements(*elements_to_rv(elements(i=i, Omega=1.0, omega=2.0)))
    assert_same(found, elements(i=i, Omega=0.0, omega=2.0 + sign * 1.0))


def test_circular_equatorial():
    found = rv_to_elements(*elements_to_rv(elements(e=0.0, i=0.0, Omega=1.0, omega=2.0, f=0.5)))
    assert_same(found, elements(e=0.0, i=0.0, Omega=0.0, omega=0.0, f=3.5))


def test_small_eccentricities_and_inclinations_can_be_kept():
    """Elements with e = 1e-12 and i = 1e-12 lead back to the orbit; rounded, it moves by up to 2 a e = 14 micrometres."""
    u = torch.rand(3, 300, dtype=torch.float64) * 2.0 * math.pi
    tiny = torch.full_like(u[0], 1e-12)
    r, v = elements_to_rv(Elements(torch.full_like(u[0], 7e6), tiny, tiny, *u))
    kept = elements_to_rv(rv_to_elements(r, v, small=1e-14))
    for found, expected, tolerance in zip(kept, (r, v), (1e-7, 1e-10), strict=True):  # a few roundings of 7e6 m, 7.5e3 m/s
        torch.testing.assert_close(found.stack(), expected.stack(), rtol=0, atol=tolerance)
    rounded, _ = elements_to_rv(rv_to_elements(r, v))
    assert 7e-6 < (rounded - r).norm().amax() < 3e-5


def test_textbook_case():
    """Vallado, example 2-6: p = 11067.790 km, e = 0.83285 and so on to r and v in km and km/s."""
    degrees = [math.radians(x) for x in (87.87, 227.89, 53.38, 92.335)]
    a = 11067.790e3 / (1.0 - 0.83285**2)
    oe = elements(a, 0.83285, *degrees)
    r, v = elements_to_rv(oe, 398600.4418e9)
    assert r.stack()[0].tolist() == pytest.approx([6525.344e3, 6861.535e3, 6449.125e3], abs=1e3)  # data have six digits
    assert v.stack()[0].tolist() == pytest.approx([4902.276, 5533.124, -1975.709], abs=1.0)


def test_conserved_quantities():
    oe = random_elements()
    r, v = elements_to_rv(oe)
    torch.testing.assert_close(v.dot(v), MU_EARTH * (2.0 / r.norm() - 1.0 / oe.a), rtol=TIGHT, atol=0)
    torch.testing.assert_close(r.cross(v).norm(), torch.sqrt(MU_EARTH * oe.a * (1.0 - oe.e**2)), rtol=TIGHT, atol=0)
    torch.testing.assert_close(r.cross(v).z / r.cross(v).norm(), torch.cos(oe.i), rtol=0, atol=TIGHT)
    torch.testing.assert_close(periapsis_radius(*elements_to_rv(oe)), oe.a * (1.0 - oe.e), rtol=TIGHT, atol=0)


def test_hill_frame():
    r, v = elements_to_rv(random_elements())
    HN = hill_frame(r, v)
    matrix = HN.stack()
    torch.testing.assert_close(matrix @ matrix.mT, torch.eye(3).double().expand_as(matrix), rtol=0, atol=TIGHT)
    assert (torch.linalg.det(matrix) > 0).all()
    r_H, v_H = HN @ r, HN @ v
    torch.testing.assert_close(r_H.x, r.norm(), rtol=TIGHT, atol=0)
    assert r_H.y.abs().amax() < TIGHT * 1e8
    assert v_H.z.abs().amax() < TIGHT * 1e4
    assert (v_H.y > 0).all()


def test_hill_rate_against_finite_differences():
    """Turning rate of the radial direction along a short straight piece of the path."""
    r, v = elements_to_rv(random_elements())
    dt = 0.01
    ahead, behind = (r + v * dt).unit(), (r - v * dt).unit()
    turned = (ahead - behind).norm() / (2.0 * dt)
    # (v dt / r)^2 and rounding, 1e-16 / (v dt / r), both stay below 1e-8
    torch.testing.assert_close(hill_rate(r, v), turned, rtol=1e-8, atol=0)


def test_motion_relative_to_a_chief():
    """The rate of change of the relative position in the turning Hill frame is what was asked for, by finite differences."""
    rho, rho_dot = (Vec3.of(scale * torch.randn(300, 3, dtype=torch.float64)) for scale in (1e4, 10.0))
    r_C, v_C = elements_to_rv(random_elements())
    r_D, v_D = hill_to_inertial(r_C, v_C, rho, rho_dot)
    torch.testing.assert_close((hill_frame(r_C, v_C) @ (r_D - r_C)).stack(), rho.stack(), rtol=0, atol=1e-7)  # of 4e7 m
    dt = 0.1

    def seen(t: float) -> torch.Tensor:
        return (hill_frame(r_C + v_C * t, v_C) @ (r_D - r_C + (v_D - v_C) * t)).stack()

    # truncation rho omega^3 dt^2, where the fastest chief turns by 7e-3 rad/s, is largest
    torch.testing.assert_close((seen(dt) - seen(-dt)) / (2.0 * dt), rho_dot.stack(), rtol=0, atol=1e-4)


def test_motion_by_hand():
    r, v = elements_to_rv(elements(a=7e6, e=0.0, i=math.pi / 2, Omega=0.0, omega=0.0, f=math.pi / 2))
    speed = math.sqrt(MU_EARTH / 7e6)
    torch.testing.assert_close(r.stack(), torch.tensor([[0.0, 0.0, 7e6]], dtype=torch.float64), rtol=0, atol=1e-8)
    torch.testing.assert_close(v.stack(), torch.tensor([[-speed, 0.0, 0.0]], dtype=torch.float64), rtol=0, atol=1e-11)
    assert torch.equal(hill_frame(r, v).z.y.round(), -torch.ones(1).double())
    assert isinstance(r, Vec3)
    # Radially 7 km above a chief on a circle of 7000 km it moves with the chief's angular rate.
    r_C, v_C = elements_to_rv(elements(a=7e6, e=0.0, i=0.0, Omega=0.0, omega=0.0, f=0.0))
    zero = torch.zeros(1, dtype=torch.float64)
    r, v = hill_to_inertial(r_C, v_C, Vec3(zero + 7e3, zero, zero), Vec3(zero, zero, zero))
    assert r.stack()[0].tolist() == pytest.approx([7.007e6, 0.0, 0.0], abs=1e-8)
    assert v.stack()[0].tolist() == pytest.approx([0.0, 1.001 * math.sqrt(MU_EARTH / 7e6), 0.0], abs=1e-11)
