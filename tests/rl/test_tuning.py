"""Search over thresholds of rules."""

import math

import pytest
import torch

import bsk_torch
from bsk_torch.rl.rules.baselines import ScanRule
from tests.support.refusals import check_refusals, refusal

pytestmark = pytest.mark.compiled


@pytest.fixture(scope="module")
def env():
    return bsk_torch.make("NadirScan-v1", num_envs=2, time_limit=600.0)


def scan_unless(observation, *, low=0.5):
    """Charges below a threshold; the best one never charges in these short episodes."""
    return (observation[:, 1] < low).long()


def test_finds_the_best_setting_in_one_batch_and_counts_its_budget(env):
    tuned = bsk_torch.tune(scan_unless, env, {"low": [0.9, 0.0, 0.6]}, episodes=4, rounds=2, fresh=5)
    assert tuned.thresholds == {"low": 0.0}
    assert tuned.flown.tolist() == [4, 20, 4]  # one of three goes on, in four times as many episodes
    assert tuned.episodes == 28 + 5
    assert tuned.evaluation.returns.shape == (5,)
    assert tuned.core_seconds > 0.0
    fresh = env.like(5, env_ids=[0] * 5)
    first = 2**40 + 4 + 16
    assert torch.equal(bsk_torch.evaluate(tuned.rule, fresh, seeds=range(first, first + 5)).returns, tuned.evaluation.returns)
    assert "low=0" in str(tuned)


def test_returns_of_settings_do_not_depend_on_the_others(env):
    many = bsk_torch.tune(scan_unless, env, {"low": [0.9, 0.3, 0.6]}, episodes=3, rounds=1, fresh=2)
    for k, low in enumerate([0.9, 0.3, 0.6]):
        alone = bsk_torch.tune(scan_unless, env, {"low": [low]}, episodes=3, rounds=1, fresh=2)
        assert alone.returns[0] == many.returns[k]


def test_draws_settings_within_ranges_after_the_defaults(env):
    ranges = {"low": (0.05, 0.5), "fast": [0.3, 0.75]}
    tuned = bsk_torch.tune("rule", env, ranges, settings=8, episodes=1, rounds=1, zooms=0, fresh=2)
    low, fast = tuned.settings["low"], tuned.settings["fast"]
    assert (float(low[0]), float(fast[0])) == (pytest.approx(ScanRule().low), 0.75)
    assert bool(((low >= 0.05) & (low <= 0.5)).all())
    assert {round(x, 2) for x in fast.tolist()} == {0.3, 0.75}
    assert len(low.unique()) == 8
    other = bsk_torch.tune("rule", env, {"low": (0.05, 0.5)}, settings=4, episodes=1, rounds=1, zooms=0, fresh=2, seed=1)
    assert other.settings["low"][1] != low[1]


def test_searches_again_in_narrower_ranges_around_the_best_setting(env):
    ranges = {"low": (0.1, 0.9), "fast": [0.3, 0.75]}
    tuned = bsk_torch.tune("rule", env, ranges, settings=8, episodes=1, rounds=1, zooms=2, fresh=2)
    low, fast = tuned.settings["low"].view(3, 8), tuned.settings["fast"].view(3, 8)
    returns = tuned.returns.view(3, 8)
    for k, width in ((1, 0.4), (2, 0.2)):
        best = returns[k - 1].argmax()
        assert (low[k, 0], fast[k, 0]) == (low[k - 1, best], fast[k - 1, best])  # flies again
        assert bool(((low[k] - low[k - 1, best]).abs() <= width / 2 + 1e-6).all())
        assert len(low[k].unique()) == 8
    best = returns[2].argmax()
    assert tuned.thresholds == {"low": low[2, best], "fast": fast[2, best]}
    assert tuned.episodes == 3 * 8 + 2
    judge = env.like(2, env_ids=[0] * 2)
    assert torch.equal(bsk_torch.evaluate(tuned.rule, judge, seeds=range(2**40 + 3, 2**40 + 5)).returns, tuned.evaluation.returns)


def test_the_defaults_of_a_rule_return_what_the_rule_does(env):
    tuned = bsk_torch.tune("cautious", env, {"fast": [0.16]}, episodes=3, rounds=1, fresh=4)
    judge = env.like(4, env_ids=[0] * 4)
    seeds = range(2**40 + 3, 2**40 + 7)
    assert torch.equal(bsk_torch.evaluate("cautious", judge, seeds=seeds).returns, tuned.evaluation.returns)


def test_satellites_of_a_constellation_share_the_thresholds_of_their_episode():
    team = bsk_torch.make("Constellation-v1", n_satellites=2, n_planes=1, phasing=0, n_targets=100, time_limit=300.0, num_envs=2)
    taken = []

    def first_or_last(observation, action_mask, *, last=0.0):
        taken.append(last)
        return torch.where(torch.as_tensor(last) > 0.5, 15, 0).expand(len(action_mask))

    tuned = bsk_torch.tune(first_or_last, team, {"last": [0.0, 1.0]}, episodes=1, rounds=1, fresh=2)
    assert taken[0].tolist() == [0.0, 0.0, 1.0, 1.0]  # two satellites in each of two rows
    assert tuned.flown.tolist() == [1, 1]


def test_rejects_wrong_thresholds_and_rules(env):
    tune = lambda rule=scan_unless, ranges=None, **more: bsk_torch.tune(rule, env, ranges or {"low": (0.1, 0.5)}, **more)
    check_refusals(
        refusal(lambda: tune(ranges={"lo": (0.1, 0.5)}), ValueError, "'lo'", "'low'"),
        refusal(lambda: tune("rule", {"enuogh": (0.1, 0.5)}), ValueError, "'enuogh'", "'enough'"),
        refusal(lambda: tune(ranges={"observation": (0.1, 0.5)}), ValueError, "'observation'", "threshold"),
        refusal(lambda: tune(ranges={"low": (0.5, 0.1)}), ValueError, "'low'", "(0.5, 0.1)", "minimum"),
        refusal(lambda: tune(ranges={"low": (0.5, 0.6, 0.7)}), ValueError, "'low'", "(0.5, 0.6, 0.7)"),
        refusal(lambda: tune(ranges={"low": [math.nan]}), ValueError, "'low'", "nan"),
        refusal(lambda: tune(ranges={"low": []}), ValueError, "'low'", "[]"),
        refusal(lambda: tune(ranges=[1]), TypeError, "ranges", "[1]"),
        refusal(lambda: tune("hasty"), ValueError, "'hasty'", "thresholds"),
        refusal(lambda: tune("ruel"), ValueError, "'ruel'", "'rule'"),
        refusal(lambda: tune(3), TypeError, "3", "rule"),
        refusal(lambda: tune(rounds=0), ValueError, "rounds", 0),
        refusal(lambda: tune(settings=0), ValueError, "settings", 0),
        refusal(lambda: bsk_torch.tune(scan_unless, "NadirScan-v1", {"low": (0.1, 0.5)}), TypeError, "env", "'NadirScan-v1'"),
    )
