"""Formations, presets, initial attitudes and draws: wrong arguments and hooks."""

import math

import bsk_torch
from bsk_torch import formations as fm
from bsk_torch import rand
from bsk_torch.initial import hill_frame_attitude
from bsk_torch.rand import Uniform, first_key
from tests.support.refusals import check_refusals, refusal
from tests.test_formations import CHIEF, TWELVE
from tests.test_initial import R, V


def test_rejects_wrong_formations():
    def delta(*given, **options):
        fm.walker_delta_args(*given, **options).check(TWELVE)

    def star(*given, **options):
        fm.walker_star_args(*given, **options).check(TWELVE)

    def train(spacing):
        fm.train_args(spacing).check(TWELVE)

    def about(chief, orbit, **deputies):
        fm.relative_to_chief(chief, orbit, deputies).check(TWELVE)

    still, fast, states = [0.0] * 6, [0.0, 0.0, 0.0, 0.0, 9e3, 0.0], "deputy_relative_state"
    check_refusals(
        refusal(lambda: delta(5), ValueError, "n_planes=5", "12 satellites", [1, 2, 3, 4, 6, 12]),
        refusal(lambda: delta(3, clustersize=3), ValueError, "clustersize=3", "4 satellites", [1, 2, 4]),
        refusal(lambda: star(0), ValueError, "n_planes=0"),
        refusal(lambda: star(3, clustersize=1.5), ValueError, "clustersize", 1.5),
        refusal(lambda: delta(3, phasing=3), ValueError, "phasing=3", "n_planes", "2"),
        refusal(lambda: delta(3, 0.5, phasing=1), ValueError, "phasing=1", "rel_phasing", 0.5),
        refusal(lambda: delta(3, altitude=-1.0), ValueError, "walker_delta_args", "altitude", "-1 km", "[0, 1e+06]"),
        refusal(lambda: star(3, inc=200.0), ValueError, "walker_star_args", "inc", "200 deg", "[-180, 180]"),
        refusal(lambda: delta(3, altitude=Uniform(0.0, 1.0, 2)), ValueError, "walker_delta_args", "altitude", "km", [2]),
        refusal(lambda: train([1.0, 2.0]), ValueError, "train_args", "spacing", [1.0, 2.0], "11", "12 satellites"),
        refusal(lambda: train(Uniform(size=3)), ValueError, "train_args", "spacing", "Uniform(", "11", "12 satellites"),
        refusal(lambda: train("near"), ValueError, "train_args", "spacing", "'near'"),
        refusal(lambda: train(math.nan), ValueError, "train_args", "spacing", "nan"),
        refusal(lambda: about("Sat_3", CHIEF), ValueError, "chief_name", "'Sat_3'", "'Sat-3'"),
        refusal(lambda: about("Sat-3", CHIEF, **{"Sat-4": still, "Sat4": still}), ValueError, states, "'Sat4'", "'Sat-4'"),
        refusal(lambda: about("A", CHIEF, A=still), ValueError, states, "'A'", "chief"),
        refusal(lambda: about("Sat-3", None), ValueError, "relative_to_chief", "chief_orbit", None, "six numbers"),
        refusal(lambda: about("Sat-3", CHIEF, **{"Sat-4": [0.0] * 3}), ValueError, states, "'Sat-4'", "6 numbers", [3]),
        refusal(lambda: about("Sat-3", CHIEF, **{"Sat-4": fast}), ValueError, states, "'Sat-4'", "a=-", "e=3.8"),
        # functions for given numbers of satellites
        refusal(lambda: fm.walker_delta(0, 1, 0.0, 500e3, 45.0), ValueError, "n_spacecraft=0"),
        refusal(lambda: fm.walker_star(7, 3, 0.0, 500e3, 45.0), ValueError, "7 satellites", "n_planes=3"),
    )


def test_rejects_wrong_hooks_options_of_presets_spins_and_draws():
    class Empty(rand.Distribution):
        pass

    def define(**members):
        return type("Mine", (fm.Formation,), members)

    check_refusals(
        refusal(lambda: define(reset=lambda self: None), TypeError, "Mine.reset", "draw(key, names)"),
        refusal(lambda: define(draws=lambda self, key, names: {}), TypeError, "Mine.draws", "'draw'"),
        refusal(lambda: define(draw=lambda self, key: {}), TypeError, "Mine.draw(self, key)", "draw(key, names)"),
        refusal(lambda: Empty().draw(first_key(4)), TypeError, "Empty", "draw(key)"),
    )

    def make(name, **options):
        return bsk_torch.make(name, num_envs=1, backend="eager", **options)

    scan, tumble = "FaultyScan-v1", "[0, 0.05] rad/s"
    check_refusals(
        refusal(lambda: make(scan, kinds=["wheels"]), ValueError, "kinds", "'wheels'", "'wheel'"),
        refusal(lambda: make(scan, kinds="wheel"), ValueError, "kinds", "'wheel'", ["wheel"]),
        refusal(lambda: make(scan, chance=1.5), ValueError, "chance", 1.5),
        refusal(lambda: make(scan, observed=1), ValueError, "observed=1", True, False),
        *(
            refusal(lambda rate=rate: make("RSOInspection-v1", tumble=rate), ValueError, "tumble", repr(rate), tumble)
            for rate in (-0.01, 0.06, math.nan, "fast", [0.01, 0.02])
        ),
    )

    def spin(**config):
        return hill_frame_attitude(R, V, config)

    check_refusals(
        refusal(lambda: spin(rat=1.0), ValueError, "spin_config['rat']", "'rate'"),
        refusal(lambda: spin(type="normal"), ValueError, "spin_config['type']", "'normal'", "'fixed'", "'uniform'"),
        refusal(lambda: spin(type="uniform", low=1.0), ValueError, "spin_config", "'low'", "'high'"),
        refusal(lambda: spin(axis="radal"), ValueError, "spin_config['axis']", "'radal'", "'radial'"),
        refusal(lambda: spin(axis=[0.0, 0.0, 0.0]), ValueError, "spin_config['axis']", [0.0, 0.0, 0.0]),
        refusal(lambda: hill_frame_attitude(R, R), ValueError, "r_N", "v_N", "orbit plane"),
        refusal(lambda: first_key(4).distinct(0, 5), ValueError, "count=0", "options=5", "1 to 5"),
        refusal(lambda: first_key(4).distinct(6, 5), ValueError, "count=6", "options=5", "1 to 5"),
    )
