"""The PettingZoo view against PettingZoo's own checks, against the environment behind it, and under TorchRL's wrapper."""

import warnings
from functools import cache

import numpy as np
import pytest
import torch
from gymnasium import spaces
from pettingzoo.test import api_test, parallel_api_test, parallel_seed_test
from pettingzoo.utils import parallel_to_aec
from torchrl.envs import PettingZooWrapper, check_env_specs

from bsk_torch import NO_ACTION, data
from bsk_torch.wrappers.pettingzoo import PettingZooEnv, parallel_env
from tests.support.refusals import check_refusals, refusal

from .constellations import EMPTY, FULL, crew, mixed, same, trio

pytestmark = pytest.mark.compiled

DYING = (FULL, EMPTY, FULL)
CASES = {
    "alike": (trio, {}),
    "one dies": (trio, {"charges": DYING}),
    "all die": (trio, {"charges": (EMPTY,) * 3}),
    "named observations": (trio, {"obs_type": dict}),
    "two types": (mixed, {}),
    "meta-agent": (crew, {}),
    "meta-agent dies": (crew, {"charges": DYING}),
    "going on is an action": (mixed, {"continue_action": True}),
    "the end is terminal": (trio, {"terminate_on_time_limit": True}),
}
cases = pytest.mark.parametrize(("make", "options"), CASES.values(), ids=CASES)


@cache
def built(make, **options):
    return PettingZooEnv(make, **options)


def view(make=trio, seed=0, **options):
    env = built(make, **options)
    return env, *env.reset(seed=seed)


def sample(env, infos):
    return {agent: env.action_space(agent).sample(infos[agent]["action_mask"]) for agent in env.agents}


@cases
def test_pettingzoo_accepts_the_environment(make, options):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        parallel_api_test(built(make, **options), 20)


def test_episodes_can_be_repeated():
    parallel_seed_test(lambda: PettingZooEnv(mixed, time_limit=12.0), 20)


@pytest.mark.filterwarnings("ignore::UserWarning:pettingzoo.test")
def test_agents_can_take_turns():
    api_test(parallel_to_aec(built(mixed)), 20)


def test_agents_have_the_order_and_spaces_of_the_satellites():
    env, observations, _ = view(trio, names=("Zeta", "Alpha", "Mu"))
    assert env.possible_agents == env.agents == ["Zeta", "Alpha", "Mu"] == list(observations)
    env, observations, infos = view(mixed)
    assert env.possible_agents == env.agents == ["S0", "S1", "S2"] == list(observations) == list(infos)
    assert (env.num_agents, env.max_num_agents, env.render_mode) == (3, 3, None)
    assert [env.action_space(agent) for agent in env.agents] == [spaces.Discrete(3), spaces.Discrete(2), spaces.Discrete(3)]
    assert [env.observation_space(agent).shape for agent in env.agents] == [(5,), (2,), (5,)]
    assert all(observations[agent] in env.observation_space(agent) for agent in env.agents)
    assert env.observation_space("S0").dtype == np.float64


def test_observations_may_be_named_and_the_state_is_what_all_see():
    env, observations, _ = view(obs_type=dict)
    _, vectors, _ = view()
    assert observations["S1"] in env.observation_space("S1")
    assert same(observations["S1"]["sat_props"]["wheel_speeds_fraction"], vectors["S1"][1:4])
    env, observations, _ = view(mixed)
    assert same(env.state(), np.concatenate(list(observations.values())))
    assert env.state() in env.state_space
    assert view(obs_type=dict)[0].state().shape == (15,)
    env, _, infos = view(common_info=True)
    assert infos["__common__"] == {"d_ts": 0.0}
    assert env.step({"S0": 2})[4]["__common__"] == {"d_ts": 3.0}


@pytest.mark.parametrize("charges", [(FULL,) * 3, DYING])
def test_steps_are_those_of_the_environment(charges):
    """Same draws and same actions give the same numbers to the last bit, until the episode is over."""
    env, observations, infos = view(mixed, seed=3, charges=charges)
    core = mixed(charges=charges, seed=3)
    places = {"S0": ("quick", 0), "S1": ("slow", 0), "S2": ("quick", 1)}
    now = core.reset()
    generator = np.random.default_rng(0)
    while env.agents:
        for agent in env.agents:
            group, k = places[agent]
            assert same(observations[agent], now[group, "observation"][0, k].numpy())
            assert infos[agent]["requires_retasking"] == bool(now[group, "requires_retasking"][0, k])
            assert infos[agent]["d_ts"] == float(now["duration"])
        actions = {agent: int(generator.integers(env.action_space(agent).n)) for agent in env.agents if generator.random() < 0.7}
        given = {agent: actions.get(agent, env.action_space(agent).n) for agent in places}
        now["quick", "action"] = torch.tensor([[given["S0"], given["S2"]]])
        now["slow", "action"] = torch.tensor([[given["S1"]]])
        now = core.step(now)["next"]
        live = env.agents
        observations, rewards, terminations, truncations, infos = env.step(actions)
        for agent in live:
            group, k = places[agent]
            assert rewards[agent] == float(now[group, "reward"][0, k])
            assert terminations[agent] != bool(now[group, "mask"][0, k])
            assert truncations[agent] == bool(now["truncated"])
        assert (not env.agents) == bool(now["done"])
    assert list(observations) == [agent for agent in places if charges is not DYING or agent != "S1"]


def test_agents_without_an_action_go_on():
    ways = [{}, {"S1": None}, {"S1": NO_ACTION, "S0": None}, {"S1": np.int64(NO_ACTION), "S2": np.array(1)}]
    results = []
    for more in ways:
        env, *_ = view()
        env.step({"S0": 0, "S1": 1, "S2": 2})
        results.append(env.step({"S2": 1} | more))
    assert all(same(result, results[0]) for result in results)
    assert results[0][4]["S1"] == {"requires_retasking": True, "d_ts": 3.0} | {"action_mask": pytest.approx(np.ones(3))}
    env, *_ = view()
    env.step({"S0": 0, "S1": 1, "S2": 2})
    infos = env.step({"S2": 2, "S1": 1})[4]  # a new task begins at once
    assert [infos[agent]["requires_retasking"] for agent in env.agents] == [False, False, True]


def test_going_on_can_be_an_action():
    env, *_ = view(continue_action=True)
    plain, *_ = view()
    assert env.action_space("S0") == spaces.Discrete(4)
    _, _, _, _, infos = env.step({"S0": 0, "S1": 1, "S2": 2})
    plain.step({"S0": 0, "S1": 1, "S2": 2})
    assert [infos[agent]["action_mask"].tolist() for agent in env.agents] == [[0, 0, 0, 1], [0, 0, 0, 1], [1, 1, 1, 0]]
    assert same(env.step({"S0": 3, "S1": 3, "S2": 0})[0], plain.step({"S2": 0})[0])


def test_the_dead_say_goodbye():
    env, *_ = view(charges=DYING)
    observations, rewards, terminations, truncations, infos = env.step(dict.fromkeys(env.agents, 0))
    assert (terminations, rewards["S1"]) == ({"S0": False, "S1": True, "S2": False}, -1.0)
    assert not any(truncations.values())
    assert observations["S1"].any()
    assert env.agents == ["S0", "S2"]
    assert infos["S1"]["requires_retasking"]  # its task has ended by then, as in bsk_rl
    results = env.step({"S0": 0, "S2": 0, "S1": 0})  # which no other hears
    assert all(list(result) == ["S0", "S2"] for result in results)
    assert same(env.state()[5:10], np.zeros(5))


def test_agents_that_die_as_their_task_ends_are_observed():
    env, *_ = view(charges=DYING, generate_obs_retasking_only=True)
    observations, *_ = env.step(dict.fromkeys(env.agents, 0))
    assert "S1" not in env.agents
    assert observations["S1"].any()


def test_actions_of_the_dead_are_not_looked_at(caplog):
    env = PettingZooEnv(trio(charges=DYING))
    env.reset(seed=0)
    everybody = dict.fromkeys(env.possible_agents, 2)
    while len(env.agents) == 3:
        env.step(everybody)
    assert not caplog.records
    for _ in range(2):
        env.step(everybody)
    said = [record.message for record in caplog.records]
    assert said == [
        f"actions of {[a for a in env.possible_agents if a not in env.agents]} are ignored: they have left the episode"
    ]


def test_no_agent_is_left_at_the_time_limit():
    for terminal in (False, True):
        env, *_ = view(time_limit=5.0, terminate_on_time_limit=terminal)
        _, _, terminations, truncations, _ = env.step(dict.fromkeys(env.agents, 0))
        assert (set(terminations.values()), set(truncations.values())) == ({terminal}, {True})
        assert env.agents == []
        assert env.step({}) == ({}, {}, {}, {}, {})
        assert env.reset()[0].keys() == {"S0", "S1", "S2"}


class Enough(data.ScanningTimeReward):
    """Ends the episode of the second satellite, which is alive."""

    def is_terminated(self):
        return torch.tensor([[False, True, False]])


def test_the_rewarder_can_end_it_for_one():
    env, *_ = view(rewarder=Enough())
    _, rewards, terminations, _, _ = env.step(dict.fromkeys(env.agents, 0))
    assert (terminations, rewards["S1"]) == ({"S0": False, "S1": True, "S2": False}, 0.0)
    assert env.agents == ["S0", "S2"]


def test_an_agent_may_command_several():
    env, observations, infos = view(crew)
    apart, alone, _ = view(mixed)
    assert (env.agents, env.action_space("Pair")) == (["Pair", "S0"], spaces.MultiDiscrete([3, 2]))
    assert same(observations["Pair"], np.concatenate([alone["S2"], alone["S1"]]))
    assert [mask.tolist() for mask in infos["Pair"]["action_mask"]] == [[1, 1, 1], [1, 1]]
    step = env.step({"Pair": np.array([2, 0]), "S0": 0})
    each = apart.step({"S0": 0, "S1": 0, "S2": 2})
    assert same(step[0]["Pair"], np.concatenate([each[0]["S2"], each[0]["S1"]]))
    assert step[1]["Pair"] == each[1]["S2"] + each[1]["S1"]
    pair = step[4]["Pair"]
    assert (pair["requires_retasking"], pair["d_ts"]) == (True, 3.0)
    assert (pair["S2"], pair["S1"]) == ({"requires_retasking": True}, {"requires_retasking": False})
    assert same(env.step({"Pair": (1, None)})[0]["S0"], apart.step({"S2": 1})[0]["S0"])
    assert same(env.step({"Pair": 1})[0]["S0"], apart.step({"S2": 1, "S1": 1})[0]["S0"])  # one for all


def test_an_agent_leaves_with_its_first_satellite():
    env, *_ = view(crew, charges=DYING)
    _, rewards, terminations, _, _ = env.step({"Pair": [0, 0], "S0": 0})
    assert ((rewards["Pair"], terminations), env.agents) == ((-1.0, {"Pair": True, "S0": False}), ["S0"])


def test_rejects_wrong_actions_which_change_nothing():
    env, *_ = view()
    wrong = [
        ({"S3": 0}, ValueError, "'S3'", "'S"),
        ({"S0": 3}, ValueError, "['S0'] is 3", "0: action_nadir_scan", "2: action_desat", "None"),
        ({"S0": -1}, ValueError, "['S0'] is -1"),
        ({"S0": 0.5}, TypeError, "['S0'] is 0.5", "integer"),
        ({"S0": "action_scan"}, TypeError, "['S0'] is 'action_scan'"),
        ({"S0": [0, 1]}, ValueError, "['S0'] has 2 entries", "1"),
        ({"S0": True}, TypeError, "['S0'] is True"),
    ]
    check_refusals(
        (refusal(lambda actions=actions: env.step({"S1": 0} | actions), *names) for actions, *names in wrong),
        refusal(lambda: env.step([1, 1]), TypeError, "actions=[1, 1]", "dictionary"),
        refusal(lambda: env.step(None), TypeError, "actions=None", "dictionary"),
        refusal(lambda: env.action_space("S9"), ValueError, "'S9'"),
    )
    assert int(env.core.simulator.ticks[0]) == 0


def test_a_seed_names_a_sequence_of_episodes():
    env, first, _ = view(seed=5)
    second = env.reset()[0]
    assert not same(first, second)
    assert same(env.reset(seed=5)[0], first)
    assert same(env.reset()[0], second)
    check_refusals(refusal(lambda: env.reset(seed=-1), ValueError, "seed=-1"))


def test_an_episode_can_start_from_a_state():
    env, *_ = view(charges=DYING)
    env.step(dict.fromkeys(env.agents, 0))
    state = env.core.get_state()
    after = env.step({"S0": 1})
    env.reset(seed=1)
    observations, _ = env.reset(options={"state": state})
    assert list(observations) == env.agents == ["S0", "S2"]
    assert same(env.step({"S0": 1}), after)


@pytest.mark.filterwarnings("ignore:PettingZoo in TorchRL:UserWarning")
def test_torchrl_can_wrap_the_view():
    groups = {"quick": ["S0", "S2"], "slow": ["S1"]}
    inner = built(mixed, charges=DYING, continue_action=True, time_limit=12.0)
    env = PettingZooWrapper(
        inner, group_map=groups, use_mask=True, done_on_any=False, return_state=True, categorical_actions=True
    )
    check_env_specs(env)
    env.set_seed(0)
    steps = env.rollout(8, break_when_any_done=False)
    assert steps["next", "done"].any()
    assert steps["quick", "mask"].all()
    assert not steps["next", "slow", "mask"][0]
    assert steps["next", "slow", "terminated"][0]
    assert (steps["quick", "info", "d_ts"].shape, steps["state"].shape) == ((8, 2), (8, 12))


@pytest.mark.parametrize("preset", ["Constellation-v1", "RelayConstellation-v1"])
def test_presets_can_be_made_by_name(preset):
    env = parallel_env(preset, time_limit=1500.0, n_targets=100)
    assert str(env) == preset
    for k, agent in enumerate(env.possible_agents):  # at random, a few earn with an image that a new task had overtaken
        env.action_space(agent).seed(k)
    _, infos = env.reset(seed=0)
    total = 0.0
    while env.agents:
        _, rewards, _, _, infos = env.step(sample(env, infos))
        total += sum(rewards.values())
    imaged = sum(info["imaged"] - info["duplicates"] for info in infos.values())
    assert total <= imaged
