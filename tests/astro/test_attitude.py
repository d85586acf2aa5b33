import math

import pytest
import torch

from bsk_torch.astro.attitude import (
    SINGULAR,
    dcm_to_mrp,
    mrp_add,
    mrp_rate,
    mrp_rate_to_omega,
    mrp_shadow,
    mrp_subtract,
    mrp_switch,
    mrp_to_dcm,
)
from bsk_torch.vec3 import Mat3, Vec3

ROUNDING = 1e-14
NEAR_SINGULAR = 1e-12  # denominators down to SINGULAR lose one digit, their squares two


def rotations(n: int = 500) -> torch.Tensor:
    """MRPs with norms on both sides of one."""
    axis = torch.nn.functional.normalize(torch.randn(n, 3, dtype=torch.float64), dim=-1)
    return axis * torch.linspace(0.0, 3.0, n, dtype=torch.float64).unsqueeze(-1)


def axis_angle(axis: list[float], angle: float) -> Vec3:
    unit = torch.nn.functional.normalize(torch.tensor([axis], dtype=torch.float64), dim=-1)
    return Vec3.of(unit * math.tan(angle / 4.0))


def dcm(sigma: torch.Tensor | Vec3) -> torch.Tensor:
    return mrp_to_dcm(sigma if isinstance(sigma, Vec3) else Vec3.of(sigma)).stack()


def cross_matrix(v: torch.Tensor) -> torch.Tensor:
    x, y, z = v.unbind(-1)
    zero = torch.zeros_like(x)
    return torch.stack([zero, -z, y, z, zero, -x, -y, x, zero], -1).reshape(*x.shape, 3, 3)


def test_dcm_is_a_rotation_by_the_textbook_formula():
    BN = dcm(rotations())
    identity = torch.eye(3, dtype=torch.float64).expand(len(BN), 3, 3)
    torch.testing.assert_close(BN @ BN.mT, identity, rtol=0, atol=ROUNDING)
    torch.testing.assert_close(torch.linalg.det(BN), torch.ones(len(BN)).double(), rtol=0, atol=ROUNDING)
    sigma = rotations()
    s2, S = (sigma**2).sum(-1)[:, None, None], cross_matrix(sigma)
    expected = torch.eye(3) + (8 * S @ S - 4 * (1 - s2) * S) / (1 + s2) ** 2
    torch.testing.assert_close(dcm(sigma), expected, rtol=0, atol=ROUNDING)
    angle = 0.7
    c, s = math.cos(angle), math.sin(angle)
    expected = torch.tensor([[[c, s, 0], [-s, c, 0], [0, 0, 1]]], dtype=torch.float64)
    torch.testing.assert_close(dcm(axis_angle([0, 0, 1], angle)), expected, rtol=0, atol=ROUNDING)


def test_shadow_is_the_same_attitude():
    sigma = rotations()[1:]
    shadow = mrp_shadow(Vec3.of(sigma)).stack()
    torch.testing.assert_close(dcm(shadow), dcm(sigma), rtol=0, atol=ROUNDING)
    torch.testing.assert_close(shadow.norm(dim=-1), 1.0 / sigma.norm(dim=-1), rtol=ROUNDING, atol=0)
    assert torch.equal(mrp_shadow(Vec3.of(torch.zeros(2, 3))).stack(), torch.zeros(2, 3))


def test_switch_is_strict_and_leaves_short_ones_alone():
    sigma = rotations()
    switched = mrp_switch(Vec3.of(sigma)).stack()
    assert (switched.norm(dim=-1) <= 1.0 + ROUNDING).all()
    short = sigma.norm(dim=-1) <= 1.0
    assert torch.equal(switched[short], sigma[short])
    torch.testing.assert_close(dcm(switched), dcm(sigma), rtol=0, atol=ROUNDING)
    edge = torch.tensor([[0.6, 0.8, 0.0], [1.0, 0.0, 0.0]], dtype=torch.float64)
    assert torch.equal(mrp_switch(Vec3.of(edge)).stack(), edge)


def test_sums_and_differences_multiply_matrices():
    a, b = rotations(), rotations().flip(0)
    total = mrp_add(Vec3.of(a), Vec3.of(b)).stack()
    torch.testing.assert_close(dcm(total), dcm(b) @ dcm(a), rtol=0, atol=NEAR_SINGULAR)
    assert (total.norm(dim=-1) <= 1.0 + ROUNDING).all()
    relative = mrp_subtract(Vec3.of(a), Vec3.of(b)).stack()
    torch.testing.assert_close(dcm(relative), dcm(a) @ dcm(b).mT, rtol=0, atol=NEAR_SINGULAR)
    assert (relative.norm(dim=-1) <= 1.0 + ROUNDING).all()


@pytest.mark.parametrize("turn", [math.pi - 1e-3, math.pi, math.pi + 1e-3, 3.0])
def test_composition_near_a_whole_turn(turn):
    """Two turns whose sum is close to 2 pi make the plain formula's denominator vanish."""
    a, b = axis_angle([1, 2, -1], turn), axis_angle([1, 2.01, -1], math.pi)
    denominator = 1.0 + a.dot(a) * b.dot(b) - 2.0 * a.dot(b)
    assert denominator.abs() < SINGULAR
    total = mrp_add(a, b)
    torch.testing.assert_close(dcm(total), dcm(b) @ dcm(a), rtol=0, atol=NEAR_SINGULAR)
    back = mrp_subtract(a, -b)
    torch.testing.assert_close(dcm(back), dcm(a) @ dcm(-b).mT, rtol=0, atol=NEAR_SINGULAR)


def test_zero_is_neutral():
    sigma = mrp_switch(Vec3.of(rotations()))
    zero = Vec3.zeros_like(sigma.x)
    for result in (mrp_add(sigma, zero), mrp_add(zero, sigma), mrp_subtract(sigma, zero)):
        torch.testing.assert_close(result.stack(), sigma.stack(), rtol=ROUNDING, atol=0)
    torch.testing.assert_close(mrp_subtract(sigma, sigma).stack(), zero.stack(), rtol=0, atol=ROUNDING)


@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize(
    ("axis", "angle"),
    [([1, 2, 3], 0.3), ([5, 1, 1], 2.9), ([1, 5, -1], 2.9), ([1, -1, 5], 2.9), ([1, 1, 1], 0.0)],
    ids=["scalar", "x", "y", "z", "identity"],
)
def test_sheppard_in_every_branch(axis, angle, sign):
    """Each rotation has another largest Euler parameter."""
    sigma = axis_angle(axis, sign * angle)
    torch.testing.assert_close(dcm_to_mrp(mrp_to_dcm(sigma)).stack(), sigma.stack(), rtol=0, atol=ROUNDING)


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_sheppard_half_turn(axis):
    """The scalar part is zero and the norm exactly one."""
    diagonal = -torch.ones(3, dtype=torch.float64)
    diagonal[axis] = 1.0
    sigma = dcm_to_mrp(Mat3.of(torch.diag(diagonal))).stack()
    torch.testing.assert_close(sigma.abs(), torch.eye(3, dtype=torch.float64)[axis], rtol=0, atol=ROUNDING)


def test_sheppard_inverts_everywhere():
    sigma = Vec3.of(rotations())
    found = dcm_to_mrp(mrp_to_dcm(sigma))
    assert (found.norm() <= 1.0 + ROUNDING).all()
    torch.testing.assert_close(dcm(found), dcm(sigma), rtol=0, atol=10 * ROUNDING)


def test_kinematics_against_finite_differences():
    sigma, omega, dt = 0.9 * rotations() / 3.0, torch.randn(500, 3, dtype=torch.float64), 1e-4
    rate = omega.norm(dim=-1, keepdim=True)

    def turned(t: float) -> torch.Tensor:
        step = omega / rate * torch.tan(rate * t / 4.0)
        return mrp_add(Vec3.of(sigma), Vec3.of(step)).stack()

    difference = (turned(dt) - turned(-dt)) / (2.0 * dt)
    rates = mrp_rate(Vec3.of(sigma), Vec3.of(omega)).stack()
    # truncation omega^3 dt^2 / 6 with omega up to 4
    torch.testing.assert_close(rates, difference, rtol=0, atol=4**3 * dt**2)


def test_kinematics_of_the_matrix_and_their_inverse():
    """[BN]' = -[omega x][BN]: the rate is that of B relative to N, in B."""
    sigma, omega, dt = 0.3 * rotations(), torch.randn(500, 3, dtype=torch.float64), 1e-5
    rates = mrp_rate(Vec3.of(sigma), Vec3.of(omega)).stack()
    difference = (dcm(sigma + rates * dt) - dcm(sigma - rates * dt)) / (2.0 * dt)
    torch.testing.assert_close(difference, -cross_matrix(omega) @ dcm(sigma), rtol=0, atol=1e-7)
    sigma, omega = Vec3.of(rotations()), Vec3.of(torch.randn(500, 3, dtype=torch.float64))
    found = mrp_rate_to_omega(sigma, mrp_rate(sigma, omega))
    torch.testing.assert_close(found.stack(), omega.stack(), rtol=0, atol=10 * ROUNDING)
