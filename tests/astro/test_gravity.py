import csv
import importlib.resources
import math
from decimal import Decimal, getcontext

import pytest
import torch

from bsk_torch.astro.ephemeris import EARTH_ROTATION_RATE, earth_orientation, parse_utc, sun_position
from bsk_torch.astro.gravity import DEGREE, J2, Weights, field, field_weights, third_body
from bsk_torch.astro.integrate import rk4_step
from bsk_torch.astro.orbit import Elements, elements_to_rv, rv_to_elements
from bsk_torch.constants import DAY, MU_EARTH, MU_SUN, R_EARTH
from bsk_torch.sim.orbit.equations import zonal_field
from bsk_torch.vec3 import Vec3

ROUNDING = 1e-14  # relative
PUBLISHED_J2 = 1.08264e-3  # GGM03S, six digits


def positions(n: int = 40) -> torch.Tensor:
    """Points between 6500 and 9000 km in all directions."""
    direction = torch.nn.functional.normalize(torch.randn(n, 3, dtype=torch.float64), dim=-1)
    return direction * torch.linspace(6.5e6, 9e6, n, dtype=torch.float64).unsqueeze(-1)


def acceleration(r: torch.Tensor, degree: int = DEGREE) -> torch.Tensor:
    return field(Vec3.of(r), field_weights(degree)).stack()


def point_mass(r: torch.Tensor) -> torch.Tensor:
    return -MU_EARTH * r / r.norm(dim=-1, keepdim=True) ** 3


def j2_term(r: torch.Tensor, j2: float) -> torch.Tensor:
    """Vallado, "Fundamentals of Astrodynamics and Applications", section 8.7.1."""
    radius = r.norm(dim=-1, keepdim=True)
    z2 = 5.0 * (r[..., 2:] / radius) ** 2
    factor = torch.cat([1.0 - z2, 1.0 - z2, 3.0 - z2], -1)
    return -1.5 * j2 * MU_EARTH * R_EARTH**2 / radius**5 * r * factor


def zonal_weights() -> dict[tuple[int, int], Weights]:
    """Weights of the point mass and J2 alone."""
    two = field_weights(2)
    oblate = {(3, 1): Weights((J2, 0.0), (0.0, J2), (0.0, 0.0)), (3, 0): Weights((0.0, 0.0), (0.0, 0.0), (3.0 * J2, 0.0))}
    return {(1, 1): two[1, 1], (1, 0): two[1, 0], **oblate}


def measured_j2(weights) -> float:
    """Over the pole the J2 acceleration is 3 J2 mu R^2 / r^4."""
    r = torch.tensor([[0.0, 0.0, 7e6]], dtype=torch.float64)
    extra = field(Vec3.of(r), weights).stack() - point_mass(r)
    return (extra[0, 2] * 7e6**4 / (3.0 * MU_EARTH * R_EARTH**2)).item()


def test_the_table_has_a_point_mass_and_a_j2():
    r = positions()
    torch.testing.assert_close(acceleration(r, 0), point_mass(r), rtol=ROUNDING, atol=ROUNDING)
    assert pytest.approx(PUBLISHED_J2, rel=5e-6) == J2
    assert measured_j2(field_weights(2)) == pytest.approx(J2, rel=1e-11)  # a difference of 1e-3 of rounded accelerations


def test_zonal_field_in_closed_form():
    r = positions()
    expected = point_mass(r) + j2_term(r, J2)
    torch.testing.assert_close(field(Vec3.of(r), zonal_weights()).stack(), expected, rtol=0, atol=9.8 * 5 * ROUNDING)
    # The closed form that they use is the field with its weights of m = 0, to a few roundings (measured 5e-16).
    r = positions(2000)
    expected, found = field(Vec3.of(r), zonal_weights()).stack(), zonal_field(Vec3.of(r)).stack()
    assert ((found - expected).norm(dim=-1) / expected.norm(dim=-1)).amax() < 1e-15


def test_zonal_field_stretches_and_does_not_depend_on_longitude():
    stretch, r = 1e-3, positions()
    stretched = torch.tensor([1.0 + stretch, 1.0 + stretch, 1.0], dtype=torch.float64)
    expected = stretched * field(Vec3.of(stretched * r), zonal_weights()).stack()
    found = zonal_field(Vec3.of(r), stretch).stack()
    assert ((found - expected).norm(dim=-1) / expected.norm(dim=-1)).amax() < 1e-15
    r = positions()
    turned = torch.stack([-r[:, 1], r[:, 0], r[:, 2]], -1)
    a, b = (zonal_field(Vec3.of(x)).stack() for x in (r, turned))
    torch.testing.assert_close(b, torch.stack([-a[:, 1], a[:, 0], a[:, 2]], -1), rtol=0, atol=9.8 * 1e-15)


def test_field_becomes_a_point_mass_far_away():
    r = positions() * 100.0
    extra = (acceleration(r) - point_mass(r)).norm(dim=-1) / point_mass(r).norm(dim=-1)
    assert (extra < 3.0 * J2 * 1e-4 * 1.01).all()  # J2's share falls with the square of the distance
    assert (extra > 1e-8).any()


def test_field_has_neither_sources_nor_curl():
    """Central differences over +-50 m; the gradient itself is 2.5e-6 1/s^2."""
    r, step = positions(), 50.0
    columns = [(acceleration(r + step * e) - acceleration(r - step * e)) / (2.0 * step) for e in torch.eye(3).double()]
    gradient = torch.stack(columns, -1)
    assert gradient.diagonal(dim1=-2, dim2=-1).abs().amax() > 1e-6
    # truncation is about (step / r)^2 = 5e-11 of the gradient, rounding 9.8 m/s^2 * 1e-15 / 100 m
    assert gradient.diagonal(dim1=-2, dim2=-1).sum(-1).abs().amax() < 2e-15
    assert (gradient - gradient.mT).abs().amax() < 2e-15


def legendre(n_max: int, x: torch.Tensor) -> dict[tuple[int, int], torch.Tensor]:
    """Fully normalised associated Legendre functions (Holmes and Featherstone 2002, equations 11 to 13)."""
    root = torch.sqrt(1.0 - x * x)
    p = {(0, 0): torch.ones_like(x)}
    for m in range(n_max + 1):
        if m:
            p[m, m] = root * p[m - 1, m - 1] * math.sqrt((2 * m + 1) / (2 * m) * (2 if m == 1 else 1))
        for n in range(m + 1, n_max + 1):
            a = math.sqrt((2 * n - 1) * (2 * n + 1) / ((n - m) * (n + m)))
            p[n, m] = a * x * p[n - 1, m]
            if n > m + 1:
                b = math.sqrt((2 * n + 1) * (n + m - 1) * (n - m - 1) / ((n - m) * (n + m) * (2 * n - 3)))
                p[n, m] = p[n, m] - b * p[n - 2, m]
    return p


def disturbing_potential(r: torch.Tensor) -> torch.Tensor:
    """Potential without the point mass, from the table's normalised coefficients."""
    path = importlib.resources.files("bsk_torch.astro") / "tables" / "ggm03s_degree10.csv"
    radius, longitude = r.norm(dim=-1), torch.atan2(r[..., 1], r[..., 0])
    p = legendre(DEGREE, r[..., 2] / radius)
    total = torch.zeros_like(radius)
    with path.open() as file:
        for row in csv.reader(line for line in file if line[0].isdigit()):
            n, m, c, s = int(row[0]), int(row[1]), float(row[2]), float(row[3])
            if 2 <= n <= DEGREE:
                wave = c * torch.cos(m * longitude) + s * torch.sin(m * longitude)
                total = total + (R_EARTH / radius) ** n * p[n, m] * wave
    return total * MU_EARTH / radius


def test_field_is_the_gradient_of_the_potential():
    """An independent evaluation of the potential, differentiated over +-30 m."""
    r, step = positions(), 30.0
    axes = torch.eye(3, dtype=torch.float64)
    gradient = [(disturbing_potential(r + step * e) - disturbing_potential(r - step * e)) / (2.0 * step) for e in axes]
    disturbance = acceleration(r) - point_mass(r)
    # truncation (10 step / r)^2 of 0.03 m/s^2 is 6e-11; degree 10 alone contributes 1e-7
    torch.testing.assert_close(torch.stack(gradient, -1), disturbance, rtol=0, atol=1e-10)
    assert (acceleration(r) - acceleration(r, DEGREE - 1)).norm(dim=-1).amax() > 1e-8


@pytest.mark.parametrize(
    ("a", "inclination", "degrees_per_day"),
    [
        (7178.137e3, 98.603, 0.9856),  # Sun-synchronous at 800 km: the mean Sun's 360 degrees in 365.2422 days
        (6871e3, 51.6, None),
        (8000e3, 120.0, None),
    ],
)
def test_nodal_precession(a, inclination, degrees_per_day):
    """Vallado, equation 9-37: dOmega/dt = -3/2 n J2 (R/p)^2 cos i."""
    i = math.radians(inclination)
    zero = torch.zeros(1, dtype=torch.float64)
    r, v = elements_to_rv(Elements(zero + a, zero, zero + i, zero + 1.0, zero, zero))
    motion = math.sqrt(MU_EARTH / a**3)
    expected = -1.5 * motion * J2 * (R_EARTH / a) ** 2 * math.cos(i)
    if degrees_per_day:
        assert math.degrees(expected) * DAY == pytest.approx(degrees_per_day, rel=1e-3)
    per_orbit, orbits = 90, 4
    h, y, node = 2.0 * math.pi / motion / per_orbit, (r, v), []
    for _ in range(orbits * per_orbit):
        y = rk4_step(lambda stage, offset, y: (y[1], zonal_field(y[0])), y, h)
        node.append(rv_to_elements(*y).Omega)
    nodes = torch.cat(node).view(orbits, per_orbit).mean(-1)  # means over whole orbits have no short-period part
    rate = (nodes[-1] - nodes[0]) / ((orbits - 1) * per_orbit * h)
    assert rate.item() == pytest.approx(expected, rel=0.01)  # second-order terms are about J2


@pytest.mark.parametrize("distance", [4e8, 1.5e11])
def test_third_body_against_forty_digits(distance):
    getcontext().prec = 40
    mu = MU_SUN * (distance / 1.5e11) ** 3
    direction = torch.tensor([0.3, -0.9, 0.4], dtype=torch.float64)
    body = direction / direction.norm() * distance
    places = positions(4)
    assert len(places) == 4
    for r in places:
        x, s = ([Decimal(c) for c in v.tolist()] for v in (r, body))
        d = [a - b for a, b in zip(x, s, strict=True)]
        d3, s3 = (sum(c * c for c in v).sqrt() ** 3 for v in (d, s))
        exact = torch.tensor([float(-Decimal(mu) * (a / d3 + b / s3)) for a, b in zip(d, s, strict=True)], dtype=torch.float64)
        found = third_body(Vec3.of(r), Vec3.of(body), mu).stack()
        torch.testing.assert_close(found, exact, rtol=0, atol=4 * ROUNDING * exact.norm().item())


def test_third_body_vanishes_at_the_centre():
    centre, sun = torch.zeros(3, dtype=torch.float64), torch.tensor([1e11, 2e10, 0.0], dtype=torch.float64)
    assert torch.equal(third_body(Vec3.of(centre), Vec3.of(sun)).stack().abs(), centre)


def test_acceleration_of_basilisk(recording):
    """Sixth-order differences of the velocities recorded every second, against field and Sun at the same instants.

    Basilisk extrapolates the Earth's orientation linearly over the second, which stretches equatorial components by
    (omega dt)^2 / 2; a third of the value at 1 s is the mean over the Runge-Kutta stages.
    """
    ticks = recording("ticks_seed11")
    r, v = (torch.tensor(ticks[name]) for name in ("r", "v"))
    weights = ((1, 3 / 4), (2, -3 / 20), (3, 1 / 60))
    centre = torch.arange(3, len(r) - 3)
    measured = sum(w * (v[centre + k] - v[centre - k]) for k, w in weights)
    et = parse_utc(ticks["init"]["utc_init"]) + torch.tensor(ticks["t"])[centre]
    PN, r_N = earth_orientation(et), r[centre]
    r_P = (PN @ r_N.unsqueeze(-1)).squeeze(-1)
    stretch = 1.0 + torch.tensor([1.0, 1.0, 0.0], dtype=torch.float64) * EARTH_ROTATION_RATE**2 / 6.0
    earth = (PN.mT @ (stretch * acceleration(stretch * r_P)).unsqueeze(-1)).squeeze(-1)
    sun = third_body(Vec3.of(r_N), Vec3.of(sun_position(et))).stack()
    # measured 6e-12 (rounding of 7600 m/s); without the stretch 9e-9, without the Sun 5e-7, without degree 10 about 1e-7
    torch.testing.assert_close(earth + sun, measured, rtol=0, atol=2e-11)
