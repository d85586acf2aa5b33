"""Observations: wrong entries, hooks and noise, and values that are no observations."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch

from bsk_torch import SatelliteTasking, act, obs, rand, sats, scene
from tests.support.refusals import check_refusals, refusal

pytestmark = pytest.mark.compiled


def make(*spec, obs_type=np.ndarray, **more):
    satellite = type("Imager", (sats.ImagingSatellite,), dict(observation_spec=spec, action_spec=(act.Image(2),)))(
        "A", obs_type=obs_type
    )
    options = dict(num_envs=2, time_limit=600.0, seed=1, dtype=torch.float64) | more
    return SatelliteTasking(satellite, scene.UniformTargets(100), **options)


def test_rejects_wrong_entries():
    def entry(*given, **keys):
        return obs.SatProperties(*(given or (keys,)))

    def relative(*given, chief_name="RSO", **keys):
        return obs.RelativeProperties(*(given or (keys,)), chief_name=chief_name)

    two, twice = (dict(prop="r_BN_N", norm=2.0), dict(prop="r_BN_N", norm=3.0)), (dict(prop="r_DC_N"), dict(prop="r_DC_N"))
    entry(dict(prop="r_BN_N"), dict(prop="r_BN_N", norm=3.0))
    check_refusals(
        [
            refusal(lambda: entry(norm=2.0), ValueError, "obs.SatProperties", "'prop'", "'fn'", 2.0),
            refusal(lambda: entry(prop="r_BN_N", norms=2.0), ValueError, "obs.SatProperties", ["norms"], "'norm'"),
            refusal(lambda: entry(prop="r_BN_N", norm=0.0), ValueError, "norm", "'r_BN_N'", 0.0, "zero"),
            refusal(lambda: entry(prop="r_BN_N", norm="far"), ValueError, "norm", "'r_BN_N'", "'far'", "number"),
            refusal(lambda: entry(fn="r_BN_N"), TypeError, "fn", "'r_BN_N'", "function"),
            refusal(lambda: entry("r_BN_N"), TypeError, "obs.SatProperties", "'r_BN_N'", "dict(prop='r_BN_N')"),
            refusal(lambda: entry(*two), ValueError, "obs.SatProperties", ["r_BN_N_normd"], "'name'"),
            refusal(lambda: relative(prop="r_DC_H"), ValueError, "prop", "'r_DC_H'", "'r_DC_Hc'"),
            refusal(lambda: relative(prop="r_DC_N", module="dynamics"), ValueError, "obs.RelativeProperties", ["module"]),
            refusal(lambda: relative(norm=2.0), ValueError, "obs.RelativeProperties", "'prop'", "'fn'", 2.0),
            refusal(lambda: relative(prop="r_DC_N", norm=0.0), ValueError, "norm", "'r_DC_N'", 0.0),
            refusal(lambda: relative(prop="r_DC_N", fn=3), TypeError, "fn=3", "function"),
            refusal(lambda: relative("r_DC_N"), TypeError, "obs.RelativeProperties", "'r_DC_N'", "dictionary"),
            refusal(lambda: relative(*twice), ValueError, "obs.RelativeProperties", ["r_DC_N"], "'name'"),
            refusal(lambda: relative(prop="r_DC_N", chief_name=None), ValueError, "chief_name", None),
        ]
    )


def test_rejects_wrong_hooks():
    def define(base=obs.Observation, **members):
        return type("Mine", (base,), members)

    def nothing(self):
        pass

    def satellite(self, satellite):
        pass

    loose = define(obs.SatProperties, link_satellite=satellite)
    link = ("Mine.link_satellite(satellite)", "super().link_satellite(satellite)")
    check_refusals(
        [
            refusal(lambda: define(get_vector=nothing), TypeError, "get_vector()", "get_obs()"),
            refusal(lambda: define(get_observation=nothing), TypeError, "Mine.get_observation", "bsk_torch.bsk_rl", "get_obs"),
            refusal(lambda: define(getobs=nothing), TypeError, "Mine.getobs", "'get_obs'"),
            refusal(lambda: define(link_satelite=satellite), TypeError, "Mine.link_satelite", "'link_satellite'"),
            refusal(lambda: define(get_obs=satellite), TypeError, "Mine.get_obs(self, satellite)", "get_obs()"),
            refusal(lambda: define(get_obs=3.0), TypeError, "Mine.get_obs", "value", "method"),
            refusal(lambda: make(loose(dict(prop="r_BN_N"))), TypeError, *link),
        ]
    )


def test_rejects_values_that_are_no_observations():
    def constant(value):
        return make(type("Mine", (obs.Observation,), {"get_obs": lambda self: value})("mine"))

    def named(function):
        return make(obs.SatProperties(dict(fn=function, name="x")))

    def first(satellite, targets):
        return targets.open[:, 0]

    mixed, name = (lambda sat: sat.dynamics.r_BN_N - sat.dynamics.r_BN_N.mean(dim=0)), "'x' of 'sat_props'"
    targets = obs.OpportunityProperties(dict(fn=first, name="first"), n_ahead_observe=3)
    check_refusals(
        [
            refusal(lambda: constant(None), TypeError, "Mine.get_obs()", None, "shape"),
            refusal(lambda: constant("far"), TypeError, "Mine.get_obs()", "'far'"),
            refusal(lambda: constant({"a": {"b": object()}}), TypeError, "Mine.get_obs()['a']['b']", "<object"),
            refusal(lambda: named(lambda sat: torch.rand(len(sat.simulator.ticks))), TypeError, name, "values", "obs.Noisy"),
            refusal(lambda: named(mixed), TypeError, name, "environments"),
            refusal(lambda: named(lambda sat: "far"), TypeError, name, "'far'"),
            refusal(lambda: named(lambda sat: sat.dynamics.speedy), AttributeError, "'speedy'"),
            refusal(lambda: make(targets), TypeError, "'first' of 'target'", [1], [1, 3]),
        ]
    )


def test_rejects_wrong_noise():
    time = obs.Time()
    misspelled = obs.Noisy(obs.SatProperties(dict(prop="r_BN_N")), {"r_BN": 1.0})
    three = obs.Noisy(obs.Eclipse(), rand.Normal(0.0, 1.0, 3))
    check_refusals(
        [
            refusal(lambda: obs.Noisy(obs.Time, 0.1), ValueError, "obs.Noisy", "obs.Time()"),
            refusal(lambda: obs.Noisy(obs.Noisy(time, 0.1), 0.1), ValueError, "obs.Noisy", "'time'", "noise already"),
            refusal(lambda: obs.Noisy(time, -0.1), ValueError, "noise", -0.1, "standard deviation"),
            refusal(lambda: obs.Noisy(time, bias={"time": math.inf}), ValueError, "bias", "inf", "'time'"),
            refusal(lambda: make(misspelled), ValueError, "obs.Noisy", "'r_BN'", "'r_BN_N'"),
            refusal(lambda: make(three), ValueError, "obs.Noisy", "Normal(", [3], "2 numbers"),
        ]
    )


@pytest.mark.parametrize("named", [False, True])
def test_rejects_observations_that_are_not_finite(named):
    def after(value):
        """Make a step after which a function gives a value for the second environment."""
        wrong = torch.zeros(1, dtype=torch.bool)

        def own(satellite):
            charge = satellite.dynamics.battery_charge_fraction
            return torch.where(wrong & (torch.arange(len(charge)) == 1), value, charge)

        env = make(obs.SatProperties(dict(prop="own", fn=own)), obs_type=dict if named else np.ndarray, max_step_duration=5.0)
        td = env.reset().set("action", torch.zeros(2, dtype=torch.int64))
        wrong.fill_(True)
        return env.step(td)

    names = ["'sat_props.own'", "environment 1"]
    table = [refusal(lambda value=value: after(value), FloatingPointError, *names, word) for value, word in BAD.items()]
    check_refusals(table)


BAD = {math.nan: "NaN", math.inf: "is inf", -math.inf: "is -inf"}


def changed(tensor, how):
    """Change a tensor in place, by torch or by NumPy."""
    if how == "torch":
        tensor.mul_(0.0)
    else:
        np.asarray(tensor)[:] = 0.0
    return tensor


@pytest.mark.parametrize("how", ["torch", "numpy"])
@pytest.mark.parametrize("kept", [True, False])
def test_functions_change_nothing_in_place(how, kept):
    """A property is read by rewards and other observations in the same step."""

    def played(function):
        own = obs.SatProperties(dict(prop="own", fn=function))
        env = make(
            own,
            obs.SatProperties(dict(prop="battery_charge_fraction"), dict(prop="r_BN_N")),
            obs_type=dict,
            max_step_duration=5.0,
        )
        td, found = env.reset(), []
        for _ in range(3):
            td = env.step(td.set("action", torch.ones(2, dtype=torch.int64)))["next"]
            found.append(
                {name: value.clone() for name, value in td["observation", "sat_props_2"].items()} | {"reward": td["reward"]}
            )
            if kept:  # what the step has returned belongs to the user
                for value in td["observation", "sat_props_2"].values():
                    changed(value, how)
            td = td.exclude("reward")
        return found

    first = played(lambda sat: sat.dynamics.battery_charge_fraction)
    second = played(
        lambda sat: changed(sat.dynamics.battery_charge_fraction, how) + 0.0 * changed(sat.dynamics.r_BN_N, how)[:, 0]
    )
    assert len(first) == 3
    for a, b in zip(first, second, strict=True):
        assert all(torch.equal(a[name], b[name]) for name in a)
