"""Wrong arguments, and environments that cannot be copied: errors before anything is planned."""

import itertools

import numpy as np
import pytest
import torch

import bsk_torch
from bsk_torch import act, data, obs, sats
from bsk_torch.plan import BeamSearch, CrossEntropy, Rollout, TreeSearch, planner, redraw_clouds
from bsk_torch.sim import dyn, fsw
from tests.plan.conftest import scanning


@pytest.fixture(scope="module")
def env():
    return scanning(2, backend="eager")


@pytest.mark.parametrize(
    ("kind", "options", "message"),
    [
        (Rollout, {"horizon": 0.0}, r"horizon=0.0 must be a number in \(0, inf\] s"),
        (Rollout, {"horizon": -5.0}, r"horizon=-5.0 must be"),
        (Rollout, {"budget": 0}, "budget=0 must be a whole number from 1 on"),
        (BeamSearch, {"budget": 0}, "budget=0 must be"),
        (TreeSearch, {"budget": 0}, "budget=0 must be"),
        (CrossEntropy, {"budget": 0}, "budget=0 must be"),
        (CrossEntropy, {"budget": 4}, "budget=4 must be at least 8: two samples for each of iterations=4"),
        (BeamSearch, {"budget": 2, "depth": 3}, "budget=2 must be at least depth=3"),
        (BeamSearch, {"width": 0}, "width=0 must be"),
        (TreeSearch, {"leaves": 1.5}, "leaves=1.5 must be a whole number"),
        (TreeSearch, {"exploration": -1.0}, "exploration=-1.0 must be"),
        (Rollout, {"gamma": 0.0}, r"gamma=0.0 must be a number in \(0, 1\]"),
        (Rollout, {"gamma": 1.1}, "gamma=1.1 must be"),
        (Rollout, {"reward_time": "ende"}, "reward_time='ende' must be one of .*'end'"),
        (Rollout, {"futures": 0}, "futures=0 must be"),
        (Rollout, {"rows": 0}, "rows=0 must be"),
        (Rollout, {"value": 3}, "value=3 must be a module"),
        (Rollout, {"redraw": redraw_clouds}, "there are none: give futures=1"),
        (Rollout, {"base": "hastey"}, "base='hastey' is not a rule.* did you mean 'hasty'"),
        (Rollout, {"base": "hasty"}, "base='hasty' does not fit the environment"),
        (CrossEntropy, {}, "planner 'cem' plans real numbers; Scanner1 chooses numbered actions: use 'rollout'"),
    ],
)
def test_wrong_arguments(kind, options, message, env):
    with pytest.raises(ValueError, match=message):
        kind(env, **options)


def test_types(env):
    with pytest.raises(TypeError, match="env='NadirScan-v1' must be an environment"):
        Rollout("NadirScan-v1")
    with pytest.raises(TypeError, match="base=3 must be a policy"):
        Rollout(env, 3)


def test_names(env):
    with pytest.raises(ValueError, match=r"planner='rolout' must be one of .* did you mean 'rollout'"):
        planner("rolout", env)
    with pytest.raises(TypeError, match="planner 'rollout' has no such option; did you mean 'horizon'"):
        planner("rollout", env, horizn=3.0)


def test_real_numbers_are_not_numbered():
    env = bsk_torch.make("RSOInspection-v1", actions="thrust", num_envs=1, backend="eager", time_limit=600.0)
    for kind in (Rollout, BeamSearch, TreeSearch):
        with pytest.raises(ValueError, match=f"planner {kind.name!r} tries numbered actions; .* are real numbers: use 'cem'"):
            kind(env)


def test_bounds_must_be_finite():
    class Thruster(sats.Satellite):
        observation_spec = (obs.Time(),)
        action_spec = (act.ImpulsiveThrust(),)
        dyn_type = dyn.BasicDynamicsModel
        fsw_type = fsw.MagicOrbitalManeuverFSWModel

    env = bsk_torch.SatelliteTasking(Thruster("T", {"dv_available_init": 10.0}), time_limit=600.0, backend="eager")
    with pytest.raises(ValueError, match="infinite bounds"):
        CrossEntropy(env, "drift")


@pytest.mark.compiled
def test_only_the_planned_environment_is_planned(env):
    made = Rollout(env, "rule")
    other = scanning(1)
    with pytest.raises(ValueError, match=r"an environment of 2 episodes; the tensordict has \[1\]"):
        made(other.reset())


# -- environments that cannot be copied -------------------------------------------------------------------------------

STREAM = np.random.default_rng(0)
COUNT = itertools.count()


class Noisy(data.GlobalReward):
    """Pays by chance."""

    def read_log(self):
        return {"time": self.fleet.sim_time.unsqueeze(1)}

    def calculate_reward(self, before, after):
        return torch.as_tensor(STREAM.normal(size=tuple(after["time"].shape)))


class SameForAll(Noisy):
    """Pays all episodes the same, by chance."""

    def calculate_reward(self, before, after):
        return torch.full_like(after["time"], float(STREAM.normal()))


class Counting(Noisy):
    """Remembers something that is no part of the state."""

    def calculate_reward(self, before, after):
        return torch.full_like(after["time"], float(next(COUNT)))


def satellite(rewarder=None, **arguments):
    class Simple(sats.Satellite):
        observation_spec = (obs.Time(),)
        action_spec = (act.Drift(duration=10.0), act.Charge(duration=10.0))
        dyn_type = dyn.BasicDynamicsModel
        fsw_type = fsw.BasicFSWModel

    return bsk_torch.SatelliteTasking(
        Simple("S", arguments), rewarder=rewarder or data.NoReward(), time_limit=300.0, backend="eager", num_envs=2, seed=0
    )


@pytest.mark.parametrize("kind", [Noisy, SameForAll, Counting])
def test_functions_that_draw_without_a_seed(kind):
    with pytest.raises(ValueError, match=r"the environment cannot be copied: .* different 'reward'.*key of bsk_torch.rand"):
        Rollout(satellite(kind()), "random", horizon=100.0)


def test_arguments_that_are_drawn_without_a_seed():
    with pytest.raises(ValueError, match="two episodes of the same seed begin with different"):
        Rollout(satellite(storedCharge_Init=lambda: float(STREAM.uniform(1e5, 2e5))), "random", horizon=100.0)


def test_arguments_of_seeded_functions_can_be_copied():
    env = satellite(storedCharge_Init=lambda: float(np.random.uniform(1e5, 2e5)))
    made = Rollout(env, "random", horizon=20.0)
    assert made(env.reset())["simulated_seconds"].tolist() == [40.0, 40.0]
