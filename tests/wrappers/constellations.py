"""Small constellations: actions of a few seconds, episodes of 15 s, and charges that say who dies when; and checks of views."""

import warnings

import torch
from gymnasium.utils.env_checker import check_env, data_equivalence

from bsk_torch import ConstellationTasking, act, data, obs, sats, scene
from bsk_torch.presets.nadir_scan import ScanningSatellite, scanning_args

FULL, EMPTY = 1e5, 150.0


class Quick(sats.Satellite):
    observation_spec = (obs.SatProperties(dict(prop="battery_charge_fraction"), dict(prop="wheel_speeds_fraction")), obs.Time())
    action_spec = (act.Scan(duration=9.0), act.Charge(duration=6.0), act.Desat(duration=3.0))
    dyn_type, fsw_type = ScanningSatellite.dyn_type, ScanningSatellite.fsw_type


class Slow(Quick):
    observation_spec = (obs.SatProperties(dict(prop="battery_charge_fraction")), obs.Time())
    action_spec = (act.Charge(duration=12.0), act.Scan(duration=15.0))


def make(kinds, charges, obs_type, rewarder, names=("S0", "S1", "S2"), **options):
    satellites = [
        kind(name, scanning_args() | {"storedCharge_Init": charge}, obs_type=obs_type)
        for kind, name, charge in zip(kinds, names, charges, strict=True)
    ]
    nadir = scene.UniformNadirScanning(value_per_second=0.1)
    defaults = dict(time_limit=15.0, dtype=torch.float64)
    return ConstellationTasking(satellites, nadir, rewarder or data.ScanningTimeReward(), **(defaults | options))


def trio(*, charges=(FULL,) * 3, obs_type=torch.Tensor, rewarder=None, **options):
    return make((Quick,) * 3, charges, obs_type, rewarder, **options)


def mixed(*, charges=(FULL,) * 3, obs_type=torch.Tensor, rewarder=None, **options):
    return make((Quick, Slow, Quick), charges, obs_type, rewarder, **options)


def crew(*, charges=(FULL,) * 3, **options):
    """One agent commands the first and the last satellite."""
    return mixed(charges=charges, **({"meta_agent_groupings": {"Pair": ["S2", "S1"]}} | options))


def same(left, right):
    return data_equivalence(left, right, exact=True)


def check_accepted(env):
    """Gymnasium's checker warns of nothing but spaces without bounds."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        check_env(env)
    assert all("infinity" in str(warning.message) for warning in caught), [str(w.message) for w in caught]
