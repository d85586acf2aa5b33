"""Suites: frozen episodes, the same for every policy, and scores."""

import pytest
import torch
from tensordict.nn import TensorDictModule

from bsk_torch.env.seeds import SUITE_SEEDS, suite_episodes
from bsk_torch.lab.offline.behaviors import Behavior
from bsk_torch.lab.offline.recipe import Recipe
from bsk_torch.lab.suites.suite import EPISODES, SUITES, Timed, bench_folder, normalised, play, ranking, references, tasks_of
from bsk_torch.presets import PRESETS, make
from bsk_torch.recording import record
from bsk_torch.rl.evaluation.evaluate import FRESH, evaluate
from bsk_torch.rl.rules.baselines import random_policy
from bsk_torch.rl.training.config import PPOConfig
from bsk_torch.wrappers.gymnasium import GymEnv, GymVectorEnv
from bsk_torch.wrappers.pettingzoo import parallel_env
from tests.support.refusals import check_refusals, refusal
from tests.tasks.aeos_bench.aeos_cases import constellation, tasks, write

NADIR = tasks_of("v1", "NadirScan-v1")[0]


def idle(preset, make):
    """Enters a policy that always scans."""
    env = make()
    return env, TensorDictModule(lambda x: torch.zeros(x.shape[0], dtype=torch.int64), ["observation"], ["action"])


NEWER = {"FaultyScan-v1", "NadirScience-v1", "HeteroCluster-v1", "Services-v1", "ThreeSensors-v1", "Walker4-v1"}
NEWER |= {"CWDocking-v1", "CWInspection-v1", "AEOSBench-v1", "Areas-v1", "AreasTeam-v1", "Sites-v1", "SitesTeam-v1"}
NEWER |= {"TipAndCue-v1"}
"""Presets that were added after the suite was frozen."""


def test_frozen_seeds_stay_and_are_in_the_suite_once():
    tasks = SUITES["v1"]
    assert sorted(task.preset for task in tasks) == sorted(set(PRESETS) - NEWER)
    seeds = [seed for task in tasks for seed in task.seeds()]
    assert len(set(seeds)) == len(seeds) == EPISODES * len(tasks)
    assert all(seed in SUITE_SEEDS for seed in seeds)
    # a suite is its seeds: published scores are of these
    assert {task.preset: task.first_seed - 2**60 for task in SUITES["v1"]} == {
        "NadirScan-v1": 0,
        "AEOS-v1": 1024,
        "AEOSPower-v1": 2048,
        "AEOSCity-v1": 3072,
        "CloudyAEOS-v1": 4096,
        "Constellation-v1": 5120,
        "AEOSConstellation-v1": 6144,
        "RelayConstellation-v1": 7168,
        "RSOInspection-v1": 8192,
        "MultiInspection-v1": 9216,
    }


def test_the_third_suite_is_frozen():
    # its published scores are of these episodes, whose seeds no other suite has, nor had the suite v2, which is withdrawn
    tasks = SUITES["v3"]
    assert {task.title: (task.family, task.preset, task.first_seed - 2**60, task.episodes) for task in tasks} == {
        "sites": ("sites", "Sites-v1", 23 * 1024, 256),
        "sites_convex": ("sites", "Sites-v1", 24 * 1024, 256),
        "sites_clear": ("sites", "Sites-v1", 25 * 1024, 256),
        "areas": ("areas", "Areas-v1", 26 * 1024, 256),
        "areas_revisit": ("areas", "Areas-v1", 27 * 1024, 256),
        "areas_scarce": ("areas", "Areas-v1", 28 * 1024, 256),
    }
    assert [dict(task.options) for task in tasks] == [
        {},
        {"gain": "convex"},
        {"gain": "convex", "risk": 0.0},
        {},
        {"revisit": 5700.0},
        {"revisit": 5700.0, "sat_args": {"panelArea": 0.15, "storageInit": 8e9, "transmitterBaudRate": -1.6e8}},
    ]
    mine = {seed for task in tasks for seed in task.seeds()}
    others = {seed for name in set(SUITES) - {"v3"} for task in SUITES[name] for seed in task.seeds()}
    assert not mine & (others | set(SUITE_SEEDS[18 * 1024 : 23 * 1024]))
    known = references("v3")
    assert known.keys() == {task.title for task in tasks}
    assert all(one["low"]["return"] < one["high"]["return"] for one in known.values())


def test_tasks_of_a_family_refuse_options_that_are_no_views():
    task = tasks_of("v3", "sites_clear")[0]
    check_refusals(refusal(lambda: task.environment(1, n_sites=5), ValueError, "n_sites=5", "sites_clear"))


def test_policies_are_ranked_by_what_they_gain_in_the_same_episodes():
    best, gains = ranking({"low": [1.0, 1.0, 4.0], "high": [2.0, 1.0, 5.0], "lucky": [3.0], "short": [1.5, 1.0]})
    assert (best, list(gains)) == ("high", ["lucky", "high", "short", "low"])
    assert [gain.mean for gain in gains.values()] == pytest.approx([-1.0, 0.0, 0.25, 2 / 3])


FIRST, LAST = SUITE_SEEDS[0], SUITE_SEEDS[-1]


def refused(*calls):
    """Rows of a table of calls that start episodes of suites."""
    return [refusal(call, ValueError, LAST, FIRST, "bsk-torch bench") for call in calls]


def test_environments_accept_seeds_of_suites_in_bench_alone():
    core = make("NadirScan-v1", num_envs=2, backend="eager", env_ids=[0, 0])
    before = core.state.seed.tolist()
    check_refusals(
        refused(
            lambda: make("NadirScan-v1", seed=LAST, backend="eager"),
            lambda: core.set_seed(LAST),
            lambda: core.reseed(LAST),
            lambda: core.reseed([5, LAST]),
            lambda: record(core, "random", seed=LAST),
            lambda: evaluate(idle("", lambda: core)[1], core, seeds=[5, LAST]),
            lambda: PPOConfig(seed=LAST),
            lambda: PPOConfig(seed=LAST - FRESH),
            lambda: Recipe("NadirScan-v1", [Behavior("random", None, 1.0)], [5, LAST]),
        )
    )
    assert core.state.seed.tolist() == before
    for seed in (FIRST - 1, LAST + 1):
        core.reseed(seed)
    with suite_episodes():
        core.reseed(LAST)
    assert core.state.seed.tolist() == [LAST, LAST]


def test_views_accept_no_seeds_of_suites():
    single, vector = GymEnv("CWDocking-v1", backend="eager"), GymVectorEnv("CWDocking-v1", num_envs=2, backend="eager")
    team = parallel_env("CWDocking-v1", backend="eager", deputies=2)
    check_refusals(
        refused(
            lambda: single.reset(seed=LAST),
            lambda: vector.reset(seed=LAST),
            lambda: vector.reset(seed=[None, LAST]),
            lambda: team.reset(seed=LAST),
        )
    )


@pytest.mark.compiled
def test_a_score_is_that_of_the_frozen_episodes():
    score = play(NADIR, idle, 3)
    env = NADIR.environment(3)
    with suite_episodes():
        again = evaluate(idle("", lambda: env)[1], env, seeds=range(2**60, 2**60 + 3))
    assert score.evaluation.returns.tolist() == again.returns.tolist()
    assert 0.0 < score.seconds < 1.0


@pytest.mark.compiled
def test_random_policies_are_timed_and_keep_their_lots():
    def chance(preset, make):
        env = make()
        return env, random_policy(env, 0)

    returns = [play(NADIR, chance, n).evaluation.returns[:2].tolist() for n in (2, 3)]
    assert returns[0] == returns[1]


def test_functions_may_be_policies_and_others_get_no_score():
    timed = Timed(lambda tensordict: tensordict)
    assert timed({}) == {}
    assert timed.seconds > 0.0
    assert play(NADIR, lambda preset, make: None, 2) is None


def test_unknown_suites_and_presets_name_the_nearest():
    check_refusals(
        refusal(lambda: tasks_of("v9"), ValueError, "suite='v9'"),
        refusal(lambda: tasks_of("v2"), ValueError, "suite='v2' is withdrawn", "use 'v3'"),
        refusal(lambda: tasks_of("v1", "NadirScan-v1,AEOS-v2"), ValueError, "'AEOS-v2'", "'AEOS-v1'"),
    )
    assert [task.preset for task in tasks_of("v1", "AEOS-v1,NadirScan-v1,AEOS-v1")] == ["AEOS-v1", "NadirScan-v1"]


@pytest.mark.compiled
def test_scores_are_linear_in_returns():
    evaluation = play(NADIR, idle, 3).evaluation
    low, high = 0.25, 2.25
    score = normalised(evaluation, {"low": {"return": low}, "high": {"return": high}})
    assert score.mean == pytest.approx((evaluation.mean_return.mean - low) / 2.0, abs=1e-12)
    assert score.half_width == pytest.approx(evaluation.mean_return.half_width / 2.0, rel=1e-9)


def test_scenarios_of_aeos_bench_stay():
    """Seeds of their own, and the sizes and the tasks that these draw."""
    tasks = SUITES["aeosbench"]
    assert [(task.title, task.first_seed - 2**60, task.episodes) for task in tasks] == [
        ("random_orbits", 16384, 64),
        ("real_orbits", 17408, 64),
    ]
    found = []
    for task in tasks:
        env = task.environment(2, backend="eager")
        with suite_episodes():
            env.reseed(list(task.seeds(2)))
        env.reset()
        exists = env.scenario.task_exists
        found.append([env.present.sum(1).tolist(), exists.sum(1).tolist(), int(env.scenario.drawn("task_due")[exists].sum())])
    assert found == DRAWN


DRAWN = [[[12, 2], [101, 293], 1069150], [[17, 21], [182, 294], 1269448]]
"""Numbers of satellites and of tasks in the first two scenarios of each task, and the sum of due times, s."""


def test_cases_of_a_folder_are_a_task_with_a_checksum(tmp_path):
    write(tmp_path / "00001", constellation(2), tasks(5))
    write(tmp_path / "00002", constellation(1), tasks(7))
    task = bench_folder(tmp_path)
    assert ((task.episodes, list(task.seeds())), task.about) == ((2, [0, 1]), bench_folder(tmp_path).about)
    write(tmp_path / "00002", constellation(1), tasks(6))
    assert bench_folder(tmp_path).about != task.about
    env = task.environment(backend="eager")
    env.reseed([0, 1])
    env.reset()
    assert env.present.sum(1).tolist() == [2, 1]
    check_refusals(refusal(lambda: task.environment(satellites=3), ValueError, "satellites=3"))


def test_references_are_sound():
    assert references("aeosbench") == {}
    known = references("v1")
    assert known.keys() <= PRESETS.keys()
    for reference in known.values():
        assert reference["high"]["return"] > reference["low"]["return"]
        assert reference["high"]["source"]
        assert reference["low"]["source"]
