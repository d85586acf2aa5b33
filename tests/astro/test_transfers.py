"""Transfers about a chief: manoeuvres, costs, and distances on the way."""

import torch

from bsk_torch.astro.linear_motion import about_circle, about_orbit
from bsk_torch.astro.relative import cd2hill, fibonacci_sphere, hill2cd
from bsk_torch.astro.transfers import closest, transfers
from bsk_torch.vec3 import Mat3, Vec3
from tests.astro.test_linear_motion import DURATIONS, chiefs, deputies, fallen

TARGETS = torch.as_tensor(fibonacci_sphere(8)) * 60.0


def some(n=6, most=None, samples=20):
    chief, (rho, velocity) = chiefs(0.04, n), deputies(150.0, n)
    return chief, rho, velocity, transfers(about_orbit(*chief, DURATIONS, samples), rho, velocity, TARGETS, most)


def test_transfers_arrive_in_two_body_motion():
    """All of 8 targets in 3 durations from 6 places; the second order leaves centimetres."""
    chief, rho, velocity, ahead = some()
    assert len(DURATIONS) == 3
    for d in range(8):
        for k, time in enumerate(DURATIONS.tolist()):
            dv = ahead.manoeuvre(torch.full((6,), 3 * d + k))
            assert torch.allclose(torch.linalg.vector_norm(dv, dim=-1), ahead.cost[:, d, k], rtol=1e-12)
            arrived, _ = cd2hill(*fallen(*chief, time, 10.0), *fallen(*hill2cd(*chief, rho, velocity + dv), time, 10.0))
            assert torch.allclose(arrived, TARGETS[d].expand(6, 3), rtol=0, atol=0.05)


def test_paths_begin_at_the_deputy_and_end_at_the_target():
    _, rho, _, ahead = some(samples=2000)
    expected = TARGETS[None, :, None].expand(6, 8, 3, 3)
    assert torch.allclose(ahead.position(-1), expected, rtol=0, atol=1e-9)
    first = ahead.position(0) - rho[:, None, None]
    assert bool((torch.linalg.vector_norm(first, dim=-1) < 2.0).all())


def test_larger_manoeuvres_are_scaled_down_and_cost_what_they_would():
    most = torch.linspace(0.05, 0.3, 6, dtype=torch.float64)
    free, limited = some()[3], some(most=most)[3]
    assert torch.equal(free.cost, limited.cost)
    size = limited.dv.norm().permute(2, 1, 0)
    assert torch.allclose(size, torch.minimum(free.cost, most[:, None, None]), rtol=1e-12)
    aligned = free.dv.unit().dot(limited.dv.unit())
    assert torch.allclose(aligned, torch.ones_like(aligned))
    over = free.cost > most[:, None, None]
    assert bool(over.any())
    missed = torch.linalg.vector_norm(limited.position(-1) - TARGETS[None, :, None], dim=-1)
    assert bool((missed[over] > 1e-3).all())
    assert bool((missed[~over] < 1e-6).all())


def test_distances_are_those_of_a_fine_path():
    """Between moments paths count as straight: 100 s at accelerations of 1e-3 m/s^2 bend them by up to a metre and a half."""
    nearest, farthest = some()[3].distances()
    fine = some(samples=1000)
    path = torch.stack([fine[1][:, None, None].expand(6, 8, 3, 3), *(fine[3].position(k) for k in range(1000))])
    distance = torch.linalg.vector_norm(path, dim=-1)
    assert torch.allclose(nearest, distance.amin(0), rtol=0, atol=1.5)
    assert torch.allclose(farthest, distance.amax(0), rtol=0, atol=1.5)


def test_distances_from_others_are_those_of_a_fine_path():
    rho, velocity = (torch.stack([x, 2.0 * x.flip(1)], 1) for x in deputies(90.0, 6))
    apart = some()[3].apart(rho, velocity)
    assert apart.shape == (6, 2, 8, 3)
    fine = some(samples=1000)[3]
    others = [Vec3.of(each.transpose(0, 1).unsqueeze(1)) for each in (rho, velocity)]
    drift = [fine.motion.at(k, *others).stack().permute(2, 0, 1, 3).unsqueeze(2) for k in range(1000)]
    exact = torch.stack([(fine.position(k)[:, None] - drift[k]).norm(dim=-1) for k in range(1000)]).amin(0)
    exact = torch.minimum(exact, (some()[1][:, None] - rho).norm(dim=-1)[..., None, None])
    assert torch.allclose(apart, exact, rtol=0, atol=1.5)


def test_rows_are_those_of_the_whole():
    whole = some()[3]
    part, other = whole.rows(1, 3), torch.randn(6, 2, 3, dtype=torch.float64)
    rows = slice(1, None, 3)
    assert torch.equal(part.cost, whole.cost[rows])
    assert torch.equal(part.position(4), whole.position(4)[rows])
    assert torch.equal(part.apart(other[rows], other[rows]), whole.apart(other, other)[rows])


def test_a_transfer_that_does_not_exist_costs_an_infinity_and_has_no_manoeuvre():
    """Where no velocity changes the place of arrival."""
    n, z = torch.ones(1, dtype=torch.float64), torch.tensor([[0.0, 0.0, 5.0]], dtype=torch.float64)
    motion = about_circle(n, torch.tensor([1.0], dtype=torch.float64), 1)
    singular = motion._replace(rv=Mat3(*(row * 0.0 for row in motion.rv)))
    ahead = transfers(singular, z, z * 0.0, TARGETS, torch.ones(1, dtype=torch.float64))
    assert bool(ahead.cost.isinf().all())
    assert bool((ahead.manoeuvre(torch.zeros(1, dtype=torch.int64)) == 0.0).all())
    assert bool(ahead.distances()[0].isfinite().all())


def test_linear_equations_and_closest_points_of_lines():
    matrix, vector = torch.randn(7, 3, 3, dtype=torch.float64), torch.randn(7, 3, dtype=torch.float64)
    found = Mat3.of(matrix).solve(Vec3.of(vector)).stack()
    assert torch.allclose((matrix @ found.unsqueeze(-1)).squeeze(-1), vector, rtol=1e-9, atol=1e-9)
    a = Vec3.of(torch.tensor([[-1.0, 2, 0], [1, 2, 0], [3, 4, 0]], dtype=torch.float64))
    b = Vec3.of(torch.tensor([[1.0, 2, 0], [4, 2, 0], [3, 4, 0]], dtype=torch.float64))
    assert closest(a, b).tolist() == [4.0, 5.0, 25.0]
