"""Wrong arguments, tasks that are not covered, and environments that cannot be copied: errors before anything is planned."""

import itertools
from dataclasses import replace
from functools import partial

import numpy as np
import pytest
import torch

import bsk_torch
from bsk_torch import act, data, dyn, make, obs, rand, sats
from bsk_torch.env.base import ResetNeededError
from bsk_torch.lab.audit.audit import audit
from bsk_torch.lab.bounds import (
    Envelope,
    Schedule,
    ScheduledPolicy,
    imaging_bound,
    milp_schedule,
    record_transitions,
    relaxed_schedule,
    scanning_bound,
)
from bsk_torch.lab.planners import BeamSearch, CrossEntropy, Rollout, TreeSearch, planner
from bsk_torch.lab.risk.estimate import risk
from bsk_torch.sim import fsw
from tests.lab.bounds.test_bounds import envelope
from tests.lab.bounds.test_sustained import fitted, flights, sustained_envelope
from tests.lab.planners.conftest import scanning
from tests.support.refusals import check_refusals, refusal


@pytest.fixture(scope="module")
def eager():
    return scanning(2, backend="eager")


def test_rejects_wrong_options_of_planners_and_audits(eager):
    check_refusals(
        refusal(lambda: Rollout(eager, horizon=0.0), ValueError, "horizon", "0.0", "(0, inf] s"),
        refusal(lambda: Rollout(eager, horizon=-5.0), ValueError, "horizon", "-5.0"),
        *(
            refusal(lambda kind=kind: kind(eager, budget=0), ValueError, "budget", "0", "from 1")
            for kind in (Rollout, BeamSearch, TreeSearch, CrossEntropy)
        ),
        refusal(lambda: CrossEntropy(eager, budget=4), ValueError, "budget", "4", "8", "iterations"),
        refusal(lambda: BeamSearch(eager, budget=2, depth=3), ValueError, "budget", "2", "depth", "3"),
        refusal(lambda: BeamSearch(eager, width=0), ValueError, "width", "0"),
        refusal(lambda: TreeSearch(eager, leaves=1.5), ValueError, "leaves", "1.5", "whole number"),
        refusal(lambda: TreeSearch(eager, exploration=-1.0), ValueError, "exploration", "-1.0"),
        refusal(lambda: Rollout(eager, gamma=0.0), ValueError, "gamma", "0.0", "(0, 1]"),
        refusal(lambda: Rollout(eager, gamma=1.1), ValueError, "gamma", "1.1"),
        refusal(lambda: Rollout(eager, reward_time="ende"), ValueError, "reward_time", "'ende'", "'end'"),
        refusal(lambda: Rollout(eager, futures=0), ValueError, "futures", "0"),
        refusal(lambda: Rollout(eager, rows=0), ValueError, "rows", "0"),
        refusal(lambda: Rollout(eager, value=3), ValueError, "value", "3", "module"),
        refusal(lambda: Rollout(eager, price={"battery": 1.0}), ValueError, "price", "'battery'"),
        refusal(lambda: Rollout(eager, price={"wheel_speeds_fraction": 1.0}), ValueError, "price", "'wheel_speeds_fraction'"),
        refusal(lambda: Rollout(eager, price=3.0), ValueError, "price", "3.0", "function"),
        refusal(lambda: Rollout(eager, price=torch.ones, horizon=float("inf")), ValueError, "price", "horizon"),
        refusal(lambda: Rollout(eager, price=torch.ones, value=torch.ones), ValueError, "price", "value"),
        refusal(lambda: Rollout(eager, base="hastey"), ValueError, "base", "'hastey'", "'hasty'"),
        refusal(lambda: Rollout(eager, base="hasty"), ValueError, "base", "'hasty'", "environment"),
        refusal(lambda: Rollout("NadirScan-v1"), TypeError, "env", "'NadirScan-v1'", "environment"),
        refusal(lambda: Rollout(eager, 3), TypeError, "policy", "int", "TensorDictModule"),
        refusal(lambda: planner("rolout", eager), ValueError, "planner", "'rolout'", "'rollout'"),
        refusal(lambda: planner("rollout", eager, horizn=3.0), TypeError, "'rollout'", "'horizn'", "'horizon'"),
    )
    check_refusals(
        refusal(lambda: audit(eager, "rule", seeds=[]), ValueError, "seeds", "()"),
        refusal(lambda: audit(eager, "rule", seeds=[0], futures=1), ValueError, "futures", "1", "half"),
        refusal(lambda: audit(eager, "ruel", seeds=[0]), ValueError, "'ruel'", "'rule'"),
    )


@pytest.mark.compiled
def test_rejects_environments_that_do_not_suit_the_planner(env):
    class Thruster(sats.Satellite):
        observation_spec = (obs.Time(),)
        action_spec = (act.ImpulsiveThrust(),)
        dyn_type = dyn.BasicDynamicsModel
        fsw_type = fsw.MagicOrbitalManeuverFSWModel

    steered = bsk_torch.make("RSOInspection-v1", actions="thrust", num_envs=1, time_limit=600.0)
    endless = bsk_torch.SatelliteTasking(Thruster("T", {"dv_available_init": 10.0}), time_limit=600.0, backend="eager")
    other = scanning(1)
    made = Rollout(env, "rule")
    check_refusals(
        refusal(lambda: CrossEntropy(env), ValueError, "'cem'", "Scanner1", "'rollout'"),
        *(
            refusal(lambda kind=kind: kind(steered), ValueError, repr(kind.name), "real numbers", "'cem'")
            for kind in (Rollout, BeamSearch, TreeSearch)
        ),
        refusal(lambda: CrossEntropy(endless, "drift"), ValueError, "infinite bounds", "thrust_act"),
        refusal(lambda: made(other.reset()), ValueError, "3 episodes", "[1]"),
    )


@pytest.mark.compiled
def test_rejects_wrong_arguments_of_risks(env):
    def of(policy="rule", episodes=20, **given):
        return risk(env, policy, episodes=episodes, **given)

    example = "battery_charge_fraction<0.05"
    none = torch.zeros(3, dtype=torch.bool)
    check_refusals(
        refusal(lambda: of(event="deaht"), ValueError, "event", "'deaht'", example, "'death'"),
        refusal(lambda: of(event="x"), ValueError, "event", "'x'", example, "'death'"),
        refusal(
            lambda: of(event="batery_charge_fraction<0.1"), ValueError, "batery_charge_fraction", "'battery_charge_fraction'"
        ),
        refusal(lambda: of(level="batery"), ValueError, "level", "'batery'", "'battery'"),
        refusal(lambda: of(level="buffer"), ValueError, "level", "'buffer'", "satellites"),
        refusal(lambda: of(event=lambda env: none), ValueError, "event", "level="),
        refusal(lambda: of(level=lambda env: 1.0), ValueError, "level", "1.0", "[3]"),
        refusal(lambda: of(level=lambda env: torch.full((3,), torch.nan)), ValueError, "level", "NaN"),
        refusal(lambda: of(episodes=25), ValueError, "episodes", "25", "10"),
        refusal(lambda: of(repetitions=1), ValueError, "repetitions", "1"),
        refusal(lambda: of(smallest=0.0), ValueError, "smallest", "0.0"),
        refusal(lambda: of(method="sreen"), ValueError, "method", "'sreen'", "'screen'"),
        refusal(lambda: of(method="screen", pool=30), ValueError, "pool", "30"),
        refusal(lambda: of(policy="ruel"), ValueError, "'ruel'", "'rule'"),
        refusal(lambda: risk(env, Rollout(env, "rule", horizon=60.0)), ValueError, "policy", "'rollout'", "environment"),
    )


def test_rejects_wrong_blends_and_envelopes():
    def blend(seeds, parts, steps):
        steps = torch.tensor(steps, dtype=torch.float64)
        rand.Blend(torch.tensor(seeds, dtype=torch.int64), torch.tensor(parts, dtype=torch.int64), steps, torch.ones_like(steps))

    check_refusals(
        refusal(lambda: blend([1, 1], [[1], [2]], [[1.0], [1.0]]), ValueError, "seeds", "repeated"),
        refusal(lambda: blend([1, 2], [[1], [2]], [[1.0], [0.5]]), ValueError, "steps", "0 to 1", "first part"),
        refusal(lambda: blend([1], [[1, 2]], [[1.0, 1.5]]), ValueError, "steps", "0 to 1"),
        refusal(lambda: blend([1], [[1, 2]], [[1.0]]), ValueError, "[1, 2]", "[1, 1]", "[M, J]"),
        refusal(lambda: blend([], [], []), ValueError, "0 seeds", "shapes"),
    )
    none, images, given = torch.zeros(0), flights(6), dict(step=0.5, arguments={})
    times = envelope([2], [2])
    check_refusals(
        refusal(lambda: Envelope.below(none, none.long(), none.bool(), **given), ValueError, "0 transitions", "bin"),
        refusal(lambda: sustained_envelope(images, reserve=10, **given), ValueError, "214 transitions", "bin", "500"),
        refusal(lambda: fitted(images, 118), ValueError, "reserve", "118", "margin", "6", "120"),
        refusal(lambda: fitted(images, 10, share=1.0), ValueError, "share", "1", "0"),
        refusal(lambda: replace(times, lag=0.04), ValueError, "lag", "0.04", "sectors", "0"),
        refusal(lambda: replace(times, sectors=8), ValueError, "lag", "0", "sectors", "8"),
        refusal(lambda: replace(times, lag=-0.1, sectors=8), ValueError, "lag", "-0.1", "sectors", "8"),
    )


def begun(preset="AEOS-v1", **options):
    env = make(preset, num_envs=1, time_limit=300.0, **options)
    env.reset()
    return env


@pytest.mark.compiled
def test_rejects_tasks_without_a_bound():
    squares, panels = data.ScanningTimeReward(lambda seconds: seconds**2), [dyn.Panel([0, 0, -1], 1.0, 0.2)]
    placed = {"oe": None, "rN": [7e6, 0.0, 0.0], "vN": [0.0, 7.5e3, 0.0]}
    images, scans = (lambda **options: imaging_bound(begun(**options))), (lambda **options: scanning_bound(begun(**options)))
    check_refusals(
        refusal(lambda: images(preset="NadirScan-v1"), ValueError, "ScanningTimeReward", "UniqueImageReward"),
        refusal(lambda: scans(n_targets=100), ValueError, "UniqueImageReward", "ScanningTimeReward"),
        refusal(lambda: images(sat_args={"u_max": 0.2}), ValueError, "u_max", "0.2", "0.4", "envelope"),
        refusal(lambda: images(sim_rate=1.0), ValueError, "sim_rate", "1", "envelope"),
        refusal(lambda: images(sat_args={"oe": rand.random_orbit(a=8000.0)}), ValueError, "a=", "7.171e+06", "8000000.0"),
        refusal(lambda: images(failure_penalty=1.0), ValueError, "failure_penalty", "1", "dying"),
        refusal(lambda: scans(preset="NadirScan-v1", rewarder=squares), ValueError, "ScanningTimeReward", "reward_fn"),
        refusal(lambda: scans(preset="NadirScan-v1", sat_args={"panels": panels}), ValueError, "one solar panel", "panels"),
        refusal(lambda: images(n_targets=100, sat_args=placed), ValueError, "elements", "oe"),
    )


@pytest.mark.compiled
def test_rejects_episodes_that_do_not_begin_and_numbers_out_of_range():
    env, running, scanner = begun(n_targets=100), begun(n_targets=100), begun("NadirScan-v1")
    running.step(running.rand_action(running.reset()))
    none = torch.full((2, 1), -1)
    fresh = lambda preset: preset(num_envs=1, time_limit=300.0)
    check_refusals(
        refusal(lambda: imaging_bound(fresh(partial(make, "AEOS-v1"))), ResetNeededError, "imaging_bound", "reset()"),
        refusal(lambda: scanning_bound(fresh(partial(make, "NadirScan-v1"))), ResetNeededError, "scanning_bound", "reset()"),
        refusal(lambda: imaging_bound(running), ValueError, "whole episodes", "env.reset()", "first step"),
        refusal(lambda: imaging_bound(env, cell=3), ValueError, "cell", "3"),
        refusal(lambda: imaging_bound(env, cell=0), ValueError, "cell", "0"),
        refusal(lambda: imaging_bound(env, bits=9), ValueError, "bits", "9", "8"),
        refusal(lambda: imaging_bound(env, iterations=0), ValueError, "iterations", "0"),
        refusal(lambda: milp_schedule(env, seconds=0.0), ValueError, "seconds", "0.0"),
        refusal(lambda: ScheduledPolicy(env, Schedule(none, none), None), ValueError, "2 episodes", "environment 1"),
        refusal(lambda: relaxed_schedule(env, envelope=replace(Envelope.load(), typical=())), ValueError, "typical times"),
        refusal(lambda: record_transitions(scanner, lambda td: td, 0), ValueError, "ScanningSatellite", "sats.ImagingSatellite"),
    )


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


@pytest.mark.compiled
def test_rejects_environments_that_draw_without_a_seed():
    drawn = {"storedCharge_Init": lambda: float(STREAM.uniform(1e5, 2e5))}
    charged, scanner = satellite(**drawn), scanning(2, sat_args=drawn)
    unlike = [satellite(kind()) for kind in (Noisy, SameForAll, Counting)]
    check_refusals(
        *(
            refusal(
                lambda env=env: Rollout(env, "random", horizon=100.0), ValueError, "environment", "'reward'", "bsk_torch.rand"
            )
            for env in unlike
        ),
        refusal(lambda: Rollout(charged, "random", horizon=100.0), ValueError, "environment", "two episodes", "same seed"),
        refusal(lambda: risk(scanner, "rule"), ValueError, "environment", "two episodes", "same seed"),
    )


def test_arguments_of_seeded_functions_can_be_copied():
    env = satellite(storedCharge_Init=lambda: float(np.random.uniform(1e5, 2e5)))
    made = Rollout(env, "random", horizon=20.0)
    assert made(env.reset())["simulated_seconds"].tolist() == [40.0, 40.0]
