"""Random catalogs of objects in low, medium and geosynchronous orbits."""

import pytest
import torch

from bsk_torch import rand
from bsk_torch.rand import Key
from bsk_torch.tasks.objects import RandomRSOCatalog, RSOMixture
from bsk_torch.tasks.objects.catalog import scaled_to
from bsk_torch.tasks.objects.mixture import BODY, REGIMES, largest_remainders


def key(n, first=0):
    zeros = torch.zeros(n, dtype=torch.int64)
    return Key(zeros + 3, torch.arange(first, first + n), zeros).named("rso_oe")


def kinds(a):
    """Number of the regime of each semi-major axis, m, by its altitude."""
    altitude = a - BODY
    return torch.where(altitude < 2000e3, 0, torch.where(altitude < 35000e3, 1, 2))


def test_elements_are_uniform_in_the_ranges_of_their_regime():
    elements = RSOMixture().draw(key(200), 200).flatten(0, 1)
    a, e, i, *angles = elements.unbind(-1)
    kind = kinds(a)
    for number, regime in enumerate(REGIMES.values()):
        mine = kind == number
        low, high = regime.altitude
        assert low <= float((a[mine] - BODY).min()) < low + 0.01 * (high - low)
        assert high - 0.01 * (high - low) < float((a[mine] - BODY).max()) <= high
        assert float(e[mine].max()) <= regime.e
        assert 0.99 * regime.i < float(i[mine].rad2deg().max()) <= regime.i
        share = mine.double().mean().item()
        assert share == pytest.approx((0.5, 0.3, 0.2)[number], abs=4 * 0.5 / 200)  # four standard deviations
    assert float((a * (1.0 - e)).min()) >= 6771e3 - 1e-6
    wide = (kind == 0) & (a - BODY > 1000e3)
    assert float(e[wide].mean()) == pytest.approx(0.01, abs=3e-4)
    assert all(float(angle.min()) >= 0.0 and float(angle.max()) < 2 * torch.pi for angle in angles)


@pytest.mark.parametrize("count", [200, 7])
def test_exact_shares_are_rounded_by_largest_remainders(count):
    elements = RSOMixture(exact=True).draw(key(5), count)
    number = torch.stack([torch.bincount(row, minlength=3) for row in kinds(elements[..., 0])])
    assert number.tolist() == [{200: [100, 60, 40], 7: [4, 2, 1]}[count]] * 5
    order = kinds(elements[..., 0])
    assert not torch.equal(order[0], order[1])


def test_largest_remainders_agree_with_the_usual_procedure():
    shares = torch.rand(300, 3, generator=torch.Generator().manual_seed(0), dtype=torch.float64)
    shares = shares / shares.sum(1, keepdim=True)
    numbers = largest_remainders(shares, 17)
    assert (numbers.sum(1) == 17).all()
    for row, found in zip(shares.tolist(), numbers.tolist(), strict=True):
        wanted = [int(17 * share) for share in row]
        order = sorted(range(3), key=lambda k: wanted[k] - 17 * row[k])
        for k in order[: 17 - sum(wanted)]:
            wanted[k] += 1
        assert found == wanted


def test_shares_of_training():
    assert (kinds(RSOMixture("LEO").draw(key(3), 50)[..., 0]) == 0).all()
    shares = RSOMixture("random").shares_of(key(4000))
    torch.testing.assert_close(shares.sum(1), torch.ones(4000, dtype=torch.float64))
    assert shares.mean(0).tolist() == pytest.approx([0.5, 0.25, 0.25], abs=0.02)
    assert (shares >= 0.0).all()


def test_draws_do_not_depend_on_the_batch():
    for mixture in (RSOMixture(), RSOMixture("random", exact=True)):
        assert torch.equal(mixture.draw(key(6), 9)[4:], mixture.draw(key(2, 4), 9))


def test_priorities_are_scaled_to_their_sum():
    catalog = RandomRSOCatalog(11, RSOMixture(), rand.Uniform(0.0, 2.0), priority_sum=33.0)
    priority = catalog.draw(key(50))[2]
    assert (priority.sum(1) - 33.0).abs().max() < 1e-12
    plain = RandomRSOCatalog(11, RSOMixture(), rand.Uniform(0.0, 2.0)).draw(key(50))[2]
    torch.testing.assert_close(priority, plain * 33.0 / plain.sum(1, keepdim=True))
    with pytest.raises(ValueError, match="priority_sum=5: all priorities of an episode are zero"):
        scaled_to(torch.zeros(2, 3, dtype=torch.float64), 5.0)
