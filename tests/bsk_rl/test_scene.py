"""Scenarios of the drop-in."""

import copy
import pickle

import numpy as np
import pytest

from bsk_torch.bsk_rl.scene import CityTargets, Scenario, SphericalRSO, UniformTargets, targets
from bsk_torch.bsk_rl.scene.rso_points import RSOPoint
from bsk_torch.bsk_rl.scene.targets import Target
from bsk_torch.bsk_rl.utils.orbital import lla2ecef
from tests.bsk_rl.fakes import fleet


def reset(scenario, satellites):
    scenario.link_satellites(satellites)
    scenario.reset_overwrite_previous()
    scenario.reset_pre_sim_init()
    scenario.reset_during_sim_init()


def test_targets_are_places_for_satellites_that_look_out_for_them():
    satellites = [*fleet(2), object()]
    scenario = UniformTargets(3, radius=7e6)
    reset(scenario, satellites)
    assert [place["object"] for place in satellites[1].places] == scenario.targets
    assert {place["min_elev"] for place in satellites[0].places} == {0.5}
    assert {place["type"] for place in satellites[0].places} == {"target"}
    assert [np.linalg.norm(target.r_LP_P) for target in scenario.targets] == pytest.approx([7e6] * 3)
    first = scenario.targets
    reset(scenario, satellites[:1])
    assert not set(first) & set(scenario.targets)


def test_targets_are_told_apart_and_keep_their_id_in_copies():
    one, other = (Target("Oslo", [1.0, 2.0, 3.0], 0.5) for _ in range(2))
    assert one != other
    assert one.id != other.id
    assert one.id.startswith("Oslo_")
    assert copy.deepcopy(one).id == one.id
    assert repr(one) == "Target(Oslo)"


def test_copies_draw_from_the_same_generator():
    """Environments copy their scenario; its draws must still follow the seed of NumPy's global generator."""
    drawn = []
    for scenario in (UniformTargets(2), copy.deepcopy(UniformTargets(2)), pickle.loads(pickle.dumps(UniformTargets(2)))):
        np.random.seed(4)
        reset(scenario, [])
        drawn.append([target.priority for target in scenario.targets] + [np.random.rand()])
    assert drawn[0] == drawn[1] == drawn[2]


def test_an_own_scenario_regenerates_targets():
    class Grid(UniformTargets):
        def regenerate_targets(self):
            self.targets = [Target(f"t{k}", [6.4e6, 0.0, k], k) for k in range(self.n_targets)]

    scenario = Grid(4)
    reset(scenario, [])
    assert [target.priority for target in scenario.targets] == [0, 1, 2, 3]


def test_cities_are_those_of_the_table():
    from bsk_torch.scene.cities import city_table

    np.random.seed(3)
    scenario = CityTargets(20, n_select_from=50, location_offset=1e4)
    reset(scenario, [])
    names = {name.replace("'", "") for name in city_table()[0][:50]}
    assert len({target.name for target in scenario.targets}) == 20
    assert {target.name for target in scenario.targets} <= names
    assert [np.linalg.norm(target.r_LP_P) for target in scenario.targets] == pytest.approx([6378136.6] * 20)
    exact = CityTargets((2, 3), n_select_from=50)
    np.random.seed(3)
    reset(exact, [])
    [index] = [k for k, name in enumerate(city_table()[0]) if name.replace("'", "") == exact.targets[0].name][:1]
    latitude = np.arcsin(exact.targets[0].r_LP_P[2] / 6378136.6)
    assert latitude == pytest.approx(float(city_table()[1][index, 0]))


def test_all_cities_may_be_drawn():
    scenario = CityTargets(2, n_select_from="all")
    reset(scenario, [])
    assert scenario.n_select_from > 10_000


def test_hooks_of_an_own_scenario_have_defaults():
    class Mine(Scenario):
        pass

    scenario = Mine()
    scenario.validate_satellite_names([])
    scenario.after_step(3.0)
    reset(scenario, [])
    assert scenario.satellites == []


def test_points_of_a_sphere_are_on_it_and_equal_by_their_numbers():
    scenario = SphericalRSO(n_points=12, radius=2.0, theta_max=0.3)
    points, again = scenario.generate_points(), scenario.generate_points()
    assert points == again
    assert len(set(points) | set(again)) == 12
    for point in points:
        np.testing.assert_allclose(point.r_PB_B, 2.0 * point.n_B)
        assert point.theta_max == 0.3
        assert np.linalg.norm(point.n_B) == pytest.approx(1.0)
    other = RSOPoint(points[0].r_PB_B, points[0].n_B, 0.4, -1, points[0].theta_solar_max, 0.1)
    assert other != points[0]
    assert str(points[0]).startswith("RSOPoint_[")


def test_a_scenario_without_rso_warns(caplog):
    scenario = SphericalRSO()
    scenario.link_satellites(fleet(1))
    scenario.reset_overwrite_previous()
    scenario.reset_pre_sim_init()
    assert "nothing to inspect" in caplog.text


def test_cities_are_those_of_bsk_rl_where_it_is_installed(tmp_path, monkeypatch):
    folder = tmp_path / "bsk_rl" / "_dat" / "simplemaps_worldcities"
    folder.mkdir(parents=True)
    (tmp_path / "bsk_rl" / "__init__.py").write_text("raise AssertionError('it is not imported')")
    rows = "city,lat,lng,iso2", "L'Aquila,42.35,13.39,IT", "Windhoek,-22.57,17.08,NA"
    (folder / "worldcities.csv").write_text("\n".join(rows))
    monkeypatch.syspath_prepend(tmp_path)
    targets.city_places.cache_clear()
    scenario = CityTargets(2)
    reset(scenario, [])
    targets.city_places.cache_clear()
    places = {target.name: target.r_LP_P for target in scenario.targets}
    assert places.keys() == {"LAquila, IT", "Windhoek, nan"}
    assert places["LAquila, IT"] == pytest.approx(lla2ecef(42.35, 13.39, scenario.radius))
