"""The view for Stable-Baselines3: its contract, the episodes of GymVectorEnv, and a short training under masks."""

import sys
import warnings
from importlib.util import module_from_spec, spec_from_file_location

import numpy as np
import pytest
import torch
from gymnasium import spaces
from gymnasium.error import ResetNeeded

pytest.importorskip("sb3_contrib", reason="needs pip install 'bsk_torch[sb3]'")

from sb3_contrib import MaskablePPO
from sb3_contrib.common.maskable.evaluation import evaluate_policy
from sb3_contrib.common.maskable.utils import get_action_masks, is_masking_supported
from stable_baselines3 import PPO
from stable_baselines3.common.env_checker import check_env
from stable_baselines3.common.vec_env import VecCheckNan, VecMonitor, VecNormalize

from bsk_torch import SatelliteTasking, data, rand, scene
from bsk_torch.presets.nadir_scan import BATTERY, ScanningSatellite, scanning_args
from bsk_torch.wrappers import GymEnv, GymVectorEnv
from bsk_torch.wrappers.spaces import flat
from bsk_torch.wrappers.stable_baselines3 import SB3VecEnv, by_row
from tests.support.refusals import check_refusals, refusal

pytestmark = pytest.mark.compiled

COUNT = 3

CHARGE = rand.Uniform(0.01 * BATTERY, 0.2 * BATTERY)
"""Some are empty within minutes."""


class Careful(ScanningSatellite):
    """May scan only while the battery is at least half full."""

    def legal_actions(self):
        rich = self.dynamics.battery_charge_fraction >= 0.5
        return rich.unsqueeze(-1) | torch.tensor([False, True, True, True])


def scanning(*, kind=ScanningSatellite, obs_type=torch.Tensor, charge=CHARGE, **options):
    """Like NadirScan-v1, whose kernel it shares, for half an hour; the time limit only truncates."""
    satellite = kind("Scanner1", scanning_args() | {"storedCharge_Init": charge}, obs_type=obs_type)
    nadir = scene.UniformNadirScanning(value_per_second=1 / 1800.0)
    return SatelliteTasking(satellite, nadir, data.ScanningTimeReward(), **(dict(time_limit=1800.0) | options))


def careful(**options):
    return scanning(kind=Careful, charge=rand.Uniform(0.3 * BATTERY, 0.9 * BATTERY), **options)


def test_stable_baselines3_accepts_one_episode():
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        check_env(GymEnv(scanning))


def test_results_have_the_forms_that_are_expected():
    env = VecCheckNan(SB3VecEnv(scanning, COUNT, charge=BATTERY), raise_exception=True)
    assert env.seed(4) == [4] * COUNT
    assert env.reset() in spaces.Box(-np.inf, np.inf, (COUNT, 12), np.float32)
    observation, reward, done, infos = env.step(np.array([0, 1, 2]))
    assert (observation.shape, observation.dtype) == ((COUNT, 12), np.float32)
    assert (reward.shape, reward.dtype, done.shape, done.dtype) == ((COUNT,), np.float32, (COUNT,), bool)
    assert [info["duration"] for info in infos] == [180.0, 120.0, 60.0]
    assert all(info["TimeLimit.truncated"] is False for info in infos)
    assert env.unwrapped.reset_infos[0]["action_mask"].tolist() == [1, 1, 1, 1]
    env.close()


@pytest.mark.parametrize("obs_type", [torch.Tensor, dict])
def test_episodes_are_those_of_the_vector_environment(obs_type):
    """One that its caller resets: ends bring last observations and infos, ``reset_infos`` what the next episodes begin with."""
    env = SB3VecEnv(scanning, COUNT, obs_type=obs_type)
    other = GymVectorEnv(scanning, COUNT, obs_type=obs_type, autoreset_mode="Disabled")
    env.seed(1)
    seen, (expected, info) = env.reset(), other.reset(seed=1)
    ends = {"died": 0, "truncated": 0}
    for action in np.random.default_rng(0).integers(0, 4, (40, COUNT)):
        assert_same(seen, expected)
        seen, reward, done, infos = env.step(action)
        expected, pay, terminated, truncated, info = other.step(action)
        cut = truncated & ~terminated
        last = [one.pop("terminal_observation", None) for one in infos]
        assert_same(reward, pay.astype(np.float32))
        assert [one is not None for one in last] == done.tolist() == (terminated | truncated).tolist()
        assert_same(infos, by_row(info | {"TimeLimit.truncated": cut}))
        for row in np.flatnonzero(done):
            assert_same(last[row], row_of(expected, row))
        if done.any():
            expected, info = other.reset(options={"reset_mask": done})
            assert_same([env.reset_infos[row] for row in np.flatnonzero(done)], by_row(info, np.flatnonzero(done)))
        ends = {"died": ends["died"] + terminated.sum(), "truncated": ends["truncated"] + cut.sum()}
    assert min(ends.values()) > 0


def row_of(observation, row):
    """What one environment sees; the parts of nested observations, leaf by leaf."""
    return observation[row] if isinstance(observation, np.ndarray) else {k: row_of(v, row) for k, v in observation.items()}


def assert_same(left, right):
    """Equal, where nested observations on the right are flat on the left."""
    if isinstance(right, dict) and "sat_props" in right:
        right = {name: np.reshape(part, np.shape(left[name])) for name, part in flat(right).items()}
    np.testing.assert_equal(left, right)


def test_a_seed_holds_for_one_reset():
    env, core = SB3VecEnv(scanning, COUNT), scanning(num_envs=COUNT)
    core.set_seed(5)
    first, second = (core.reset()["observation"].numpy() for _ in range(2))
    for _ in range(2):
        env.seed(5)
        np.testing.assert_array_equal(env.reset(), first)
        np.testing.assert_array_equal(env.reset(), second)
    assert env.seed()[0] != env.seed()[0]


def test_an_episode_can_start_from_a_state():
    env = SB3VecEnv(scanning, COUNT, charge=BATTERY)
    env.seed(0)
    env.reset()
    moved = env.step(np.full(COUNT, 1))[0]
    env.set_options({"state": env.core.get_state()})
    env.step(np.full(COUNT, 2))
    np.testing.assert_array_equal(env.reset(), moved)
    assert not np.array_equal(env.reset(), moved)


def test_observations_and_infos_are_split():
    env = SB3VecEnv(scanning, COUNT, obs_type=dict)
    parts = {name: part.shape for name, part in env.reset().items()}
    assert parts == {name: (COUNT, *box.shape) for name, box in env.observation_space.items()}
    assert parts["sat_props/wheel_speeds_fraction"] == (COUNT, 3)
    assert parts["time"] == parts["ground_station/ground_station_0/opportunity_open_normd"] == (COUNT, 1)
    PPO("MultiInputPolicy", env, n_steps=4, batch_size=12, n_epochs=1, device="cpu").learn(12)
    columns = {"duration": np.array([1.0, 2.0]), "mask": np.eye(2), "_duration": np.ones(2), "final_obs": None}
    rows = by_row(columns)
    assert [row["duration"] for row in rows] == [1.0, 2.0]
    assert (rows[1]["mask"].tolist(), set(rows[0])) == ([0.0, 1.0], {"duration", "mask"})
    assert [row["duration"] for row in by_row(columns, [1])] == [2.0]


@pytest.mark.parametrize(("kind", "make", "warnings_"), [(PPO, careful, 1), (PPO, scanning, 0), (MaskablePPO, careful, 0)])
def test_algorithms_that_ignore_masks_are_told_once(kind, make, warnings_, caplog):
    env = SB3VecEnv(make, 8, seed=0)
    model = kind("MlpPolicy", env, n_steps=8, batch_size=32, n_epochs=1, seed=0, device="cpu")
    model.learn(128)
    told = [record.getMessage() for record in caplog.records if "MaskablePPO" in record.getMessage()]
    assert len(told) == warnings_
    assert all("the mask forbids" in text for text in told)


def test_masks_are_found_by_sb3_contrib():
    env = VecMonitor(SB3VecEnv(careful, 16))
    env.seed(0)
    rich = env.reset()[:, 1] >= 0.5
    assert 0 < rich.sum() < 16
    assert is_masking_supported(env)
    expected = np.stack([rich, *np.ones((3, 16), bool)], 1)
    np.testing.assert_array_equal(get_action_masks(env), expected)
    np.testing.assert_array_equal(env.env_method("action_masks", indices=[5, 2]), expected[[5, 2]])
    np.testing.assert_array_equal(env.get_attr("action_masks", 3)[0](), expected)
    np.testing.assert_array_equal([info["action_mask"] for info in env.unwrapped.reset_infos], expected)


def test_attributes_are_those_of_the_simulation():
    env = SB3VecEnv(scanning, COUNT)
    assert env.get_attr("batch_size", [0, 2]) == [env.core.batch_size] * 2
    assert (env.get_attr("render_mode"), env.env_is_wrapped(VecMonitor)) == ([None] * COUNT, [False] * COUNT)
    assert not env.has_attr("no_such_thing")
    check_refusals(
        refusal(lambda: env.get_attr("no_such_thing"), AttributeError, "'no_such_thing'", "GymVectorEnv"),
        refusal(lambda: env.env_method("action_mask"), AttributeError, "'action_masks'"),
        refusal(lambda: env.set_attr("gravity", 0.0), NotImplementedError, "'gravity'"),
    )


def test_pictures_are_tiled():
    pytest.importorskip("matplotlib", reason="needs pip install 'bsk_torch[viz]'")
    env = SB3VecEnv(scanning, 2, render_mode="rgb_array")
    env.reset()
    image = env.render()
    assert (image.shape, image.dtype) == ((2 * 480, 640, 3), np.uint8)
    np.testing.assert_array_equal(env.env_method("render", indices=1)[0], image[480:])
    assert env.metadata["render_fps"] == 10
    check_refusals(refusal(lambda: SB3VecEnv(scanning, 2, render_mode="human"), ValueError, "render_mode='human'"))


def test_rejects_wrong_calls():
    env = SB3VecEnv(scanning, COUNT)
    check_refusals(
        refusal(lambda: env.step_wait(), RuntimeError, "step_async"),
        refusal(lambda: env.step(np.zeros(COUNT)), ResetNeeded, "reset"),
    )
    env.reset()
    check_refusals(
        refusal(lambda: env.step(np.array([0, 9, 0])), ValueError, "action 9 of environment 1"),
        refusal(lambda: env.step(np.array([0, 1])), ValueError, "[2]", "[3]"),
    )
    assert env.core.simulator.ticks.tolist() == [0] * COUNT
    check_refusals(
        refusal(lambda: env.set_options([{}] * COUNT), ValueError, "options", "list"),
        refusal(lambda: env.set_options({"mask": 1}), ValueError, "['mask']", "['state']"),
        refusal(lambda: SB3VecEnv("Constellation-v1", 2, n_satellites=3, backend="eager"), TypeError, "SatelliteTasking"),
    )


def test_without_stable_baselines3_the_extra_is_named(monkeypatch):
    monkeypatch.setitem(sys.modules, "stable_baselines3.common.vec_env.base_vec_env", None)
    spec = spec_from_file_location("once_more", sys.modules[SB3VecEnv.__module__].__file__)
    once_more = lambda: spec.loader.exec_module(module_from_spec(spec))
    check_refusals(refusal(once_more, ImportError, "SB3VecEnv", "pip install 'bsk_torch[sb3]'"))


def test_a_masked_policy_learns_and_obeys():
    """Only scanning pays, and only in the right attitude; it is illegal for a part of the episodes."""
    played = []

    class Watched(SB3VecEnv):
        def step_async(self, actions):
            played.append(self.action_masks()[np.arange(self.num_envs), actions])
            super().step_async(actions)

    env = VecNormalize(VecMonitor(Watched(careful, 64)), norm_reward=False)
    model = MaskablePPO("MlpPolicy", env, n_steps=16, batch_size=256, learning_rate=3e-3, ent_coef=0.0, seed=0, device="cpu")
    before = evaluate_policy(model, env, 64, deterministic=False)[0]
    model.learn(16 * 1024)
    after = evaluate_policy(model, env, 64)[0]
    assert np.concatenate(played).all()
    assert after > before + 0.2, (before, after)
