"""What studies of the benchmarks define beside the package: worlds, rewards, and how files of results grow."""

import json
import sys
from importlib import import_module
from pathlib import Path
from typing import Any

import pytest
import torch

import bsk_torch
from bsk_torch.env.rollout import play_episodes

SEED = 4_000_011

BENCHMARKS = Path(__file__).parents[2] / "benchmarks"


def imported(name):
    """A fixture that imports a benchmark, and forgets it and those that it imports afterwards."""

    @pytest.fixture(name=name)
    def module(monkeypatch):
        monkeypatch.syspath_prepend(str(BENCHMARKS))
        before = set(sys.modules)
        yield import_module(name)
        for other in set(sys.modules) - before:
            if Path(getattr(sys.modules[other], "__file__", None) or "").parent == BENCHMARKS:
                del sys.modules[other]

    return module


NAMES = ("clouds", "suite", "distillation", "adversary", "sites")
clouds, suite, distillation, adversary, sites = map(imported, NAMES)


def test_clouds_change_every_half_hour_and_forecasts_are_about_right(clouds):
    env = clouds.preset_of("moving", "repeats")(num_envs=2, backend="eager", time_limit=3600.0)
    env.set_seed(SEED)
    env.reset()
    scenario: Any = env.scenario
    since, covers = scenario.drawn("since_change"), scenario.drawn("covers")
    assert covers.shape[-1] == 3
    for time, change in ((0.0, 0), (clouds.STAY, 1)):
        for shift in (0.0, 0.999):  # right after a change and right before the next one
            now = time - since + shift * clouds.STAY
            assert torch.equal(scenario.at(covers, since, now.clamp(min=0.0))[now >= 0.0], covers[..., change][now >= 0.0])
    assert torch.equal(scenario.cloud_cover, covers[..., 0])
    errors = (scenario.drawn("forecasts") - covers)[(covers < 0.7) & (covers > 0.3)]
    assert 0.1 < float(errors.std()) < 0.3  # standard deviations are uniform up to 0.6, cut at 0 and 1


@pytest.mark.compiled
def test_repeated_images_pay_once_and_raise_the_belief(clouds):
    env = clouds.preset_of("moving", "repeats")(num_envs=6)
    rule = clouds.ranked(clouds.by_first_chance, env)
    env.set_seed(SEED)
    start = env.reset()
    scenario: Any = env.scenario
    satellite: Any = env.satellite
    tables = [scenario.drawn(name) for name in ("covers", "forecasts", "since_change", "cloud_forecast_sigma")]
    covers, forecasts, since, sigma = (table.clone() for table in tables)
    priority = scenario.priority.clone()
    level, images = satellite.dynamics.partition_levels[:, 0].clone(), {}
    paid, belief = torch.zeros(6, dtype=torch.float64), torch.zeros_like(priority, dtype=torch.float64)
    for playing, _ in play_episodes(env, rule, start):
        taken = (satellite.dynamics.partition_levels[:, 0] > level) & playing
        level = satellite.dynamics.partition_levels[:, 0].clone()
        for row in torch.nonzero(taken).flatten().tolist():
            target, time = int(satellite.latest_target[row]), float(env.simulator.sim_time[row])
            k = int((time + float(since[row, target])) // clouds.STAY)
            before = images.setdefault((row, target), [])
            assert not before or time - before[-1][0] >= clouds.STAY
            assert float(belief[row, target]) < clouds.ENOUGH
            clear = float(covers[row, target, k]) <= clouds.THRESHOLD
            if clear and not any(seen for _, seen in before):
                paid[row] += float(priority[row, target])
            before.append((time, clear))
            chance = clouds.chance_of_clear(forecasts[row, target, k], sigma[row, target])
            belief[row, target] = 1.0 - (1.0 - belief[row, target]) * (1.0 - chance)
    assert torch.allclose(env.returns.flatten().double(), paid, atol=1e-5)
    assert torch.allclose(scenario.fleet.memory["belief"], belief, atol=1e-12)
    repeated = sum(len(times) - 1 for times in images.values())
    assert repeated == int(env.counts()["repeated"].sum())
    assert repeated > 10


def test_rows_of_other_presets_stay_in_the_suites_file(tmp_path, suite):
    file = tmp_path / "suite.json"
    head = {"format": 1, "suite": "v1"}
    mine = [{"preset": "b", "policy": "new"}]
    assert suite.with_others(file, head, mine) == mine
    old = [{"preset": name, "policy": policy} for name, policy in (("a", "x"), ("b", "x"), ("b", "y"), ("c", "x"))]
    file.write_text(json.dumps(head | {"rows": old}))
    assert suite.with_others(file, head, mine) == [old[0], mine[0], old[3]]
    with pytest.raises(ValueError, match="rows of another suite: 'v1', not 'v3'"):
        suite.with_others(file, head | {"suite": "v3"}, mine)


def test_references_count_the_gain_of_planners_in_the_episodes_that_they_play(suite):
    def row(*returns):
        return {"returns": list(returns), "return": {"mean": sum(returns) / len(returns)}}

    rest = [0.0] * 253
    rows = {"random": row(0.0, 0.0, 0.0, *rest), "hasty": row(3.0, 2.0, 4.0, *rest), "plan:rollout": row(5.0, 4.1, 5.9)}
    head = {"suite": "v3", "bsk_torch": "0.3.0"}
    found = suite.references(head, {"sites": rows, "sites_convex": {"hasty": rows["hasty"]}})
    assert found.keys() == {"sites"}  # random actions have not played the other task
    assert found["sites"]["high"]["return"] == pytest.approx(9.0 / 256 + 2.0)
    assert found["sites"]["high"]["source"] == "plan:rollout, bsk_torch 0.3.0, gain over hasty in 3 episodes"
    unsure = rows | {"plan:rollout": row(3.5, 1.0, 4.5)}
    assert suite.references(head, {"sites": unsure})["sites"]["high"]["source"] == "hasty, bsk_torch 0.3.0"


def test_published_runs_of_a_seed_are_one_policy_and_keep_their_cost(suite):
    row = {"returns": [1.0, 1 / 3], "training": {"decisions": 9}, "survival": 1.0}
    results = {"sites": {"runs/sites/seed_0": row, "commit": row}, "areas": {"runs/areas/seed_0": row}}
    content = suite.public({"suite": "v3"}, results, ["ppo=ppo/seed_*"])
    kept = {"returns": [1.0, 0.3333333], "training": {"decisions": 9}}
    assert content["methods"] == {"ppo": ["ppo/seed_0"]}
    assert content["policies"] == {"ppo/seed_0": {"sites": kept, "areas": kept}, "commit": {"sites": kept}}
    with pytest.raises(ValueError, match="two runs of the same seed in areas"):
        suite.public({}, {"areas": {"runs/areas/seed_0": row, "runs/areas_revisit/seed_0": row}}, [])


def test_planners_of_several_runs_are_joined(sites):
    parts = [
        {"returns": [4.0, 6.0], "gains": [1.0, 2.0], "over_random": [4.0, 6.0], "measures": {}, "cpu": 2.0},
        {"returns": [5.0], "gains": [3.0], "over_random": [5.0], "measures": {}, "cpu": 1.0},
    ]
    found = sites.figures("rollout", sites.joined(parts))
    assert (found["episodes"], found["return"], found["gain"], found["share"], found["cpu"]) == (3, 5.0, 2.0, 0.4, 3.0)


def test_the_interval_of_a_share_shrinks_with_what_the_gains_have_in_common(distillation):
    draws = torch.Generator().manual_seed(SEED)
    whole = 1.0 + torch.rand(400, generator=draws, dtype=torch.float64)
    noise = 0.1 * torch.randn(400, generator=draws, dtype=torch.float64)
    exact, noisy = distillation.share(0.3 * whole, whole), distillation.share(0.3 * whole + noise, whole)
    assert exact.mean == pytest.approx(0.3, abs=1e-12)
    assert exact.half_width < 1e-12
    assert abs(noisy.mean - 0.3) < noisy.half_width == pytest.approx(1.96 * 0.1 / 400**0.5 / 1.5, rel=0.15)


@pytest.mark.compiled
def test_the_nominal_box_is_the_preset(adversary):
    preset = bsk_torch.make("NadirScan-v1", num_envs=512, seed=SEED)
    boxed = adversary.arguments(adversary.uniform(adversary.NOMINAL))
    same = bsk_torch.make("NadirScan-v1", num_envs=512, sat_args=boxed, seed=SEED)
    for env in (preset, same):
        env.reset()
    for name in (*boxed, "oe"):
        expected, found = (env.satellite.sat_args[name].double() for env in (preset, same))
        expected, found = (values.expand(512, *values.shape[1:]) for values in (expected, found))
        if name == "oe":  # (i, Omega) and (-i, Omega + pi) are the same orbit
            expected, found = expected[:, :3].abs(), found[:, :3].abs()
        spread = float(expected.std(0).max())
        assert torch.allclose(expected.mean(0), found.mean(0), atol=4.0 * spread * (2.0 / 512) ** 0.5 + 1e-12)
        assert float(found.std(0).max()) == pytest.approx(spread, rel=0.15)
