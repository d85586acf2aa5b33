"""The Gymnasium views against Gymnasium's own checks and against each other.

Most tests fly a small satellite with actions of a few seconds, a battery that is nearly empty and episodes of 15 s.
"""

import warnings

import gymnasium
import numpy as np
import pytest
import torch
from gymnasium.error import ResetNeeded
from gymnasium.vector import AutoresetMode, SyncVectorEnv
from tensordict import TensorDict

from bsk_torch import SatelliteTasking, data, rand, scene
from bsk_torch.presets import PRESETS
from bsk_torch.presets.nadir_scan import scanning_args
from bsk_torch.wrappers import GymEnv, GymVectorEnv
from bsk_torch.wrappers.registration import register
from tests.support.refusals import check_refusals, refusal
from tests.wrappers.constellations import Quick, check_accepted, same

NEXT, SAME, DISABLED = AutoresetMode.NEXT_STEP, AutoresetMode.SAME_STEP, AutoresetMode.DISABLED
pytestmark = pytest.mark.compiled

NADIR = {"id": "bsk_torch/NadirScan-v1", "time_limit": 600.0}


SHORT_LIVED = rand.Uniform(100.0, 1500.0)


def quick(*, obs_type=torch.Tensor, charge=SHORT_LIVED, **options):
    satellite = Quick("Quick", scanning_args() | {"storedCharge_Init": charge}, obs_type=obs_type)
    defaults = dict(time_limit=15.0, dtype=torch.float64)
    nadir = scene.UniformNadirScanning(value_per_second=0.1)
    return SatelliteTasking(satellite, nadir, data.ScanningTimeReward(), **(defaults | options))


def single(**options):
    return GymEnv(quick, **options)


def sync(count, mode, **options):
    return SyncVectorEnv([lambda k=k: single(env_ids=[k], **options) for k in range(count)], autoreset_mode=mode)


def assert_same(left, right):
    assert same(left, right), f"{left}\n{right}"


@pytest.mark.parametrize("obs_type", [torch.Tensor, dict])
def test_gymnasium_accepts_the_environment(obs_type):
    spec = gymnasium.envs.registration.EnvSpec("Quick-v0", entry_point=single, kwargs={"obs_type": obs_type})
    check_accepted(gymnasium.make(spec).unwrapped)


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_spaces_follow_the_specs(dtype):
    env = single(dtype=dtype)
    assert env.observation_space.shape == (5,)
    assert env.observation_space.dtype == (np.float32 if dtype is torch.float32 else np.float64)
    assert env.action_space == gymnasium.spaces.Discrete(3)


def test_named_observations_are_a_dict_space():
    env = single(obs_type=dict)
    observation, _ = env.reset(seed=0)
    vector, _ = single().reset(seed=0)
    assert observation in env.observation_space
    assert set(observation) == {"sat_props", "time"}
    assert_same(observation["sat_props"]["wheel_speeds_fraction"], vector[1:4])


def test_results_are_plain_values():
    env = single(charge=1e4)
    env.reset(seed=0)
    observation, reward, terminated, truncated, info = env.step(np.int64(1))
    assert observation in env.observation_space
    assert (type(reward), terminated, truncated) == (float, False, False)
    assert info.pop("action_mask").dtype == np.int8
    assert info == {"duration": 6.0, "d_ts": 6.0, "requires_retasking": True}
    assert env.action_masks().tolist() == [True, True, True]


def test_a_seed_names_a_sequence_of_episodes():
    env, core = single(), quick()
    core.set_seed(5)
    first, second = (core.reset()["observation"][0].numpy() for _ in range(2))
    for _ in range(2):
        assert_same(env.reset(seed=5)[0], first)
        assert_same(env.reset()[0], second)
    assert not np.array_equal(first, second)


def test_an_episode_can_start_from_a_state():
    env = single(charge=1e4)
    env.reset(seed=1)
    env.step(0)
    state = env.core.get_state()
    after = env.step(2)
    env.reset(seed=2)
    _, info = env.reset(options={"state": state})
    assert info["duration"] == 0.0
    assert_same(env.step(2), after)


def test_an_episode_has_to_run():
    env = single(time_limit=5.0)
    check_refusals(refusal(lambda: env.step(0), ResetNeeded, "reset"))
    env.reset(seed=0)
    assert env.step(0)[3]
    check_refusals(refusal(lambda: env.step(0), ResetNeeded, "reset"))


def test_rejects_wrong_actions_which_change_nothing():
    env = single()
    env.reset(seed=0)
    check_refusals(
        refusal(lambda: env.step(7), ValueError, "action 7 of environment 0"),
        refusal(lambda: env.step(0.5), TypeError, "float32"),
        refusal(lambda: env.step([0, 1]), ValueError, [2]),
        refusal(lambda: env.step(None), TypeError, "action=None"),
        refusal(lambda: env.step("x"), TypeError, "action='x'"),
    )
    assert int(env.core.simulator.ticks) == 0


@pytest.mark.parametrize(("mode", "obs_type"), [(NEXT, torch.Tensor), (SAME, torch.Tensor), (SAME, dict)])
@pytest.mark.nightly("AutoresetMode.SAME_STEP-Tensor")
def test_a_batch_plays_what_single_environments_play(mode, obs_type):
    count, seed = 3, 1
    batch = GymVectorEnv(quick, count, autoreset_mode=mode, obs_type=obs_type)
    singles = sync(count, mode, obs_type=obs_type)
    assert (batch.observation_space, batch.action_space) == (singles.observation_space, singles.action_space)
    assert_same(batch.reset(seed=seed), singles.reset(seed=[seed] * count))
    actions = np.random.default_rng(0).integers(0, 3, (6, count))
    ends = np.zeros((2, count), dtype=int)
    for action in actions:
        ours, theirs = batch.step(action), singles.step(action)
        assert_same(ours, theirs)
        ends += np.stack(ours[2:4])
    assert ends[0].sum() >= 1  # some died
    assert ends[1].sum() >= 1  # some came to the time limit


def test_environments_that_wait_do_not_move_and_take_no_action():
    env = GymVectorEnv(quick, 2, time_limit=12.0, charge=1e5)
    env.reset(seed=0)
    env.step([0, 2])
    assert env.step([1, 2])[3].tolist() == [True, False]
    observation, reward, _, truncated, info = env.step([99, 2])  # 99 is ignored
    assert (env.core.simulator.ticks.tolist(), info["duration"].tolist()) == ([0, 9], [0.0, 3.0])
    assert (reward[0], truncated.tolist(), observation[0, -1]) == (0.0, [False, False], 0.0)


def test_all_may_wait_at_once():
    env = GymVectorEnv(quick, 2, time_limit=5.0, charge=1e5)
    first, _ = env.reset(seed=0)
    assert env.step([0, 0])[3].all()
    second, reward, terminated, truncated, info = env.step([0, 0])
    assert not np.array_equal(first, second)
    assert not np.stack([reward, terminated, truncated, info["duration"]]).any()
    assert info["action_mask"].all()


def test_without_autoreset_the_caller_resets_what_ended():
    env = GymVectorEnv(quick, 2, autoreset_mode="Disabled", time_limit=8.0, charge=1e5)
    check_refusals(refusal(lambda: env.reset(options={"reset_mask": np.array([True, False])}), ResetNeeded, "reset"))
    env.reset(seed=0)
    observation, _, _, truncated, _ = env.step([0, 2])
    assert truncated.tolist() == [True, False]
    check_refusals(refusal(lambda: env.step([0, 2]), ResetNeeded, "[0]"))
    masks = np.array([1, 0]), np.array([True]), np.array([False, False])
    check_refusals(refusal(lambda x=x: env.reset(options={"reset_mask": x}), ValueError, "reset_mask") for x in masks)
    after, info = env.reset(options={"reset_mask": truncated})
    assert_same(after[1], observation[1])
    assert not np.array_equal(after[0], observation[0])
    assert info["action_mask"].all()
    assert env.step([2, 2])[4]["duration"].tolist() == [3.0, 3.0]


def test_every_environment_may_have_its_own_seed():
    env = GymVectorEnv(quick, 3)
    same, _ = env.reset(seed=7)
    other, _ = env.reset(seed=[7, 8, 7])
    assert_same(other[[0, 2]], same[[0, 2]])
    assert not np.array_equal(other[1], same[1])
    assert_same(other[1], single(env_ids=[1]).reset(seed=8)[0])
    later, _ = env.reset(seed=[7, None, None])  # None goes on to the next episode
    assert_same(later[0], same[0])
    assert not np.array_equal(later[2], same[2])
    check_refusals(refusal(lambda x=x: env.reset(seed=x), ValueError, "seed") for x in ([1, 2], [1, 2, -3], [1, 2, 0.5]))


def test_a_masked_reset_seeds_only_its_environments():
    env = GymVectorEnv(quick, 2)
    first, _ = env.reset(seed=1)
    second, _ = env.reset(seed=1, options={"reset_mask": np.array([True, False])})
    assert_same(first, second)
    assert env.core.episode.tolist() == [0, 0]


def test_tensors_come_out_when_asked_for():
    env = GymVectorEnv(quick, 2, output="torch", autoreset_mode=SAME, time_limit=8.0, charge=1e5)
    plain = GymVectorEnv(quick, 2, autoreset_mode=SAME, time_limit=8.0, charge=1e5)
    observation, info = env.reset(seed=0)
    assert_same(observation.numpy(), plain.reset(seed=0)[0])
    results, expected = env.step(torch.tensor([0, 2])), plain.step([0, 2])
    for ours, theirs in zip(results[:4], expected[:4], strict=True):
        assert_same(ours.numpy(), theirs)
    info = results[4]
    assert torch.equal(info["_final_obs"], torch.tensor([True, False]))
    assert_same(info["final_obs"][0].numpy(), expected[4]["final_obs"][0])
    assert info["action_mask"].dtype == torch.int8
    assert torch.equal(info["duration"], torch.tensor([0.0, 3.0], dtype=torch.float64))


def test_returned_arrays_are_the_callers():
    env = GymVectorEnv(quick, 2, charge=1e5)
    observation, info = env.reset(seed=0)
    kept = observation.copy()
    env.step([0, 1])
    assert_same(observation, kept)
    observation[:], info["action_mask"][:] = 9.0, 0
    assert env.action_masks().all()
    assert not (env.reset(options={"reset_mask": np.array([True, False])})[0] == 9.0).any()


def test_a_partial_restore_leaves_state_and_the_others_alone():
    env = GymVectorEnv(quick, 2, charge=1e5)
    start, _ = env.reset(seed=0)
    state = env.core.get_state()
    kept = state.clone()
    moved = env.step([0, 1])[0]
    back, _ = env.reset(options={"state": state, "reset_mask": np.array([True, False])})
    assert_same(back, np.stack([start[0], moved[1]]))
    assert (state == kept).all()


def test_episode_statistics_are_recorded_and_the_core_stays_usable():
    env = gymnasium.wrappers.RecordEpisodeStatistics(single(time_limit=12.0, charge=1e5))
    env.reset(seed=0)
    first, last = env.step(0), env.step(1)
    assert (last[4]["episode"]["l"], last[4]["episode"]["r"]) == (2, pytest.approx(first[1] + last[1]))
    env = single(charge=1e5)
    env.reset(seed=0)
    step = env.core.step(TensorDict({"action": torch.tensor([2])}, [1]))
    assert float(step["next", "duration"]) == 3.0


@pytest.mark.parametrize("mode", [NEXT, SAME])
def test_episode_statistics_of_a_batch_are_recorded(mode):
    env = GymVectorEnv(quick, 2, autoreset_mode=mode, time_limit=9.0, charge=1e5)
    env = gymnasium.wrappers.vector.RecordEpisodeStatistics(env)
    env.reset(seed=0)
    _, reward, _, _, info = env.step(np.array([0, 1]))
    assert (info["episode"]["l"].tolist(), info["episode"]["r"][0]) == ([1, 0], reward[0])


def test_presets_can_be_made_by_name():
    register()
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        register()
        env = gymnasium.make(**NADIR)
        observation, info = env.reset(seed=0)
        assert env.step(env.action_space.sample(info["action_mask"]))[0] in env.observation_space
        batch = gymnasium.make_vec(**NADIR, num_envs=2, autoreset_mode="SameStep")
        assert_same(batch.reset(seed=0)[0][0], observation)
        assert isinstance(batch, GymVectorEnv)
        assert (batch.num_envs, batch.metadata["autoreset_mode"]) == (2, SAME)
    assert {f"bsk_torch/{name}" for name in PRESETS} <= set(gymnasium.registry)


def test_a_preset_can_be_vectorised_by_gymnasium():
    register()
    env = gymnasium.make_vec(**NADIR, num_envs=1, vectorization_mode="sync")
    assert isinstance(env, SyncVectorEnv)
    observation, _ = env.reset(seed=0)
    assert observation in env.observation_space


def test_images_are_counted_in_infos():
    """Of one episode and of a batch, kept over the resets of others and shown for the last time in ``final_info``."""
    options = dict(n_targets=2000, time_limit=600.0)
    env = gymnasium.make("bsk_torch/AEOS-v1", **options)
    _, info = env.reset(seed=1)
    assert (info["imaged"], info["missed"], info["duplicates"]) == (0, 0, 0)
    total = 0
    for _ in range(4):
        _, reward, _, _, info = env.step(2)
        total += reward > 0
        assert info["imaged"] == total
    vector = gymnasium.make_vec("bsk_torch/AEOS-v1", num_envs=3, **options, autoreset_mode="SameStep")
    vector.reset(seed=1)
    before = np.zeros(3, dtype=int)
    for _ in range(8):
        _, rewards, _, truncated, infos = vector.step(np.full(3, 2))
        seen = np.where(truncated, infos.get("final_info", infos)["imaged"], infos["imaged"])
        assert np.array_equal(seen - before, rewards > 0)
        before = np.where(truncated, 0, seen)
