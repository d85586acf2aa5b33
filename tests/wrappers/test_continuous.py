"""Views of environments whose actions are real numbers: spaces, steps, NO_ACTION, masks, and learners of others."""

import numpy as np
import pytest
import torch
from gymnasium import spaces
from gymnasium.utils.env_checker import check_env
from pettingzoo.test import parallel_api_test
from tensordict import TensorDict

from bsk_torch import NO_ACTION, ConstellationTasking, SatelliteTasking, act
from bsk_torch.sim import dyn, fsw
from bsk_torch.wrappers import GymEnv, GymVectorEnv, PettingZooEnv
from bsk_torch.wrappers.general import GymJointEnv
from tests.act.test_continuous import START, Choose, kind
from tests.support.refusals import check_refusals, refusal

OPTIONS = dict(time_limit=60.0, seed=1, backend="eager")
SETPOINT = act.AttitudeSetpoint(control_period=6.0)
LIMIT = {act.AttitudeSetpoint: 30.0, Choose: 160.0}


def core(entry=SETPOINT, num_envs=1, **options):
    return SatelliteTasking(kind(entry)("A", START), num_envs=num_envs, **(OPTIONS | options))


def constellation(**options):
    turner, plain = kind(SETPOINT, name="Turner"), kind(act.Drift(duration=7.0), act.NadirPoint(duration=3.0), name="Plain")
    satellites = [turner("T1"), plain("D1"), kind(Choose("choose"), name="Hybrid")("H1"), turner("T2")]
    return ConstellationTasking(satellites, **(OPTIONS | options))


class TestGymnasium:
    def test_space(self):
        space = GymEnv(core()).action_space
        assert space == spaces.Box(-1.0, 1.0, (3,), np.float32)
        mover = kind(act.ImpulsiveThrust(max_dv=2.0), models=(dyn.DynamicsModel, fsw.MagicOrbitalManeuverFSWModel))
        space = GymEnv(SatelliteTasking(mover("A", START), **OPTIONS)).action_space
        assert (space.low.tolist(), space.high.tolist()) == ([-2.0, -2.0, -2.0, 2.0], [2.0, 2.0, 2.0, np.inf])
        hybrid = GymEnv(core(Choose("choose"))).action_space
        assert hybrid == spaces.Dict(values=spaces.Box(1.0, 50.0, (1,), np.float32), choice=spaces.Discrete(2))

    @pytest.mark.parametrize("entry", [SETPOINT, Choose("choose")], ids=["box", "hybrid"])
    @pytest.mark.filterwarnings("ignore::UserWarning")
    def test_gymnasiums_checker(self, entry):
        check_env(GymEnv(core(entry)), skip_render_check=True)

    def test_a_step_is_that_of_the_core(self):
        env, other = GymEnv(core(dtype=torch.float64)), core(dtype=torch.float64)
        env.reset(seed=3), other.reseed(3), other.reset()
        for action in (np.array([0.1, -0.2, 0.3]), [0.3, 0, -1], np.float32([0.1, 0.2, 0.3]), torch.tensor([0.5, 0.5, 0.5])):
            observation, *_, info = env.step(action)
            given = torch.as_tensor(np.asarray(action, dtype=float)).unsqueeze(0)
            assert np.array_equal(observation, other.play(given)["observation"][0].numpy())
            assert "action_mask" not in info
        assert env.step(np.float32([2.0, 0.0, 0.0]))[0][:3].tolist() == [2.0, 0.0, 0.0]  # outside the Box as in bsk_rl

    @pytest.mark.parametrize(
        "nothing", [None, NO_ACTION, [NO_ACTION] * 3, np.full(3, NO_ACTION, np.float32), np.full(3, NO_ACTION)]
    )
    def test_no_action(self, nothing):
        env = GymEnv(core(max_step_duration=4.0))
        env.reset()
        env.step([0.1, 0.2, 0.3])
        observation, *_, info = env.step(nothing)
        assert (observation[:3], info["d_ts"]) == (pytest.approx([0.1, 0.2, 0.3]), 2.0)

    def test_hybrid_actions(self):
        env = GymEnv(core(Choose("choose")))
        _, info = env.reset(seed=1)
        assert info["action_mask"].tolist() == [1, 1]
        info = env.step({"values": [21.0], "choice": 1})[-1]
        assert (info["d_ts"], info["action_mask"].tolist()) == (21.0, [1, 0])
        action = env.action_space.sample({"values": None, "choice": info["action_mask"]})
        assert action["choice"] == 0
        assert env.step(np.array([3.0, 0.0]))[-1]["d_ts"] == 3.0
        check_refusals(refusal(lambda: env.step({"values": [21.0]}), TypeError, "'values'", "'choice'"))

    @pytest.mark.parametrize("entry", [SETPOINT, Choose("choose")], ids=["box", "hybrid"])
    @pytest.mark.parametrize("mode", ["NextStep", "SameStep"])
    @pytest.mark.nightly("SameStep-hybrid")
    def test_a_vector_is_its_single_episodes(self, entry, mode):
        one = [GymEnv(core(entry, env_ids=[k], time_limit=LIMIT[type(entry)])) for k in range(2)]
        env = GymVectorEnv(core(entry, 2, time_limit=LIMIT[type(entry)]), autoreset_mode=mode)
        first = env.reset(seed=5)[0]
        assert np.array_equal(first, np.stack([view.reset(seed=5)[0] for view in one]))
        env.action_space.seed(7)
        for _ in range(3):
            action = env.action_space.sample()
            rows = [{k: v[row] for k, v in action.items()} if isinstance(action, dict) else action[row] for row in range(2)]
            seen = env.step(action)[0]
            assert np.allclose(seen, np.stack([view.step(row)[0] for view, row in zip(one, rows, strict=True)]), atol=1e-6)
        for _ in range(12):  # beyond the ends of episodes
            assert np.isfinite(env.step(env.action_space.sample())[0]).all()


class TestConstellations:
    def test_pettingzoo(self):
        env = PettingZooEnv(constellation())
        assert env.action_space("T1") == spaces.Box(-1.0, 1.0, (3,), np.float32)
        assert env.action_space("D1") == spaces.Discrete(2)
        _, infos = env.reset(seed=0)
        assert "action_mask" not in infos["T1"]
        assert infos["H1"]["action_mask"].tolist() == [1, 1]
        actions = {"T1": np.float32([0.1, 0.2, 0.3]), "T2": None, "D1": 0, "H1": {"values": [5.0], "choice": 1}}
        *_, infos = env.step(actions)
        assert infos["T1"]["d_ts"] == 5.0
        assert [infos[name]["requires_retasking"] for name in ("T1", "D1", "H1", "T2")] == [False, False, True, True]
        check_refusals(
            refusal(lambda: env.step({"T2": [0.0, 0.0]}), ValueError, "actions['T2']", "[2]"),
            refusal(lambda: env.step({"T2": [float("nan"), 0.0, 0.0]}), ValueError, "0", "mrp_1=nan"),
        )

    def test_the_action_that_continues(self):
        env = PettingZooEnv(constellation(), continue_action=True)
        assert env.action_space("H1")["choice"] == spaces.Discrete(3)
        _, infos = env.reset(seed=0)
        assert infos["H1"]["action_mask"].tolist() == [1, 1, 0]
        *_, infos = env.step({"H1": {"values": [5.0], "choice": 0}, "D1": 1})
        assert infos["H1"]["action_mask"].tolist() == [0, 0, 1]
        *_, infos = env.step({"H1": {"values": [9.0], "choice": 2}, "D1": 2})
        assert infos["H1"]["d_ts"] == 2.0

    def test_pettingzoos_checker(self):
        parallel_api_test(PettingZooEnv(constellation()), num_cycles=20)

    def test_one_agent(self):
        env = GymJointEnv(constellation(joint=True))
        kinds = [type(part) for part in env.action_space.spaces]
        assert kinds == [spaces.Box, spaces.Discrete, spaces.Dict, spaces.Box]
        _, info = env.reset(seed=0)
        assert [None if mask is None else mask.tolist() for mask in info["action_mask"]] == [None, [1, 1], [1, 1], None]
        *_, info = env.step(([0.1, 0.2, 0.3], 0, {"values": [5.0], "choice": 1}, None))
        assert info["d_ts"] == 5.0
        assert np.isfinite(env.step(env.action_space.sample())[1])


class TestStableBaselines3:
    def test_ppo_and_sac(self):
        sb3 = pytest.importorskip("stable_baselines3")
        from bsk_torch.wrappers.stable_baselines3 import SB3VecEnv

        env = SB3VecEnv(core(num_envs=2))
        assert env.action_space == spaces.Box(-1.0, 1.0, (3,), np.float32)
        sb3.PPO("MlpPolicy", env, n_steps=4, batch_size=4, n_epochs=1, seed=0).learn(16)
        sac = sb3.SAC("MlpPolicy", env, learning_starts=4, batch_size=4, seed=0)
        sac.learn(16)
        action, _ = sac.predict(env.reset(), deterministic=True)
        assert action.shape == (2, 3)


def test_rllibs_view():
    from bsk_torch.wrappers.rllib import satellite_tasking

    env = satellite_tasking(dict(satellite=kind(SETPOINT)("A", START), **OPTIONS))
    env.reset(seed=0)
    assert env.action_space == spaces.Box(-1.0, 1.0, (3,), np.float32)
    assert np.isfinite(env.step(env.action_space.sample())[1])


def test_torchrls_step_takes_the_action_of_a_vector():
    env = core(Choose("choose"), 2)
    td = env.reset()
    td["action"] = TensorDict(values=torch.tensor([[3.0], [4.0]]), choice=torch.tensor([0, 1]), batch_size=[2])
    assert env.step(td)["next", "duration"].flatten().tolist() == [3.0, 4.0]


def test_rejects_wrong_actions():
    env = GymEnv(core())
    env.reset()
    check_refusals(
        refusal(lambda: env.step([0.0, 0.0]), ValueError, "action", [2], [3]),
        refusal(lambda: env.step(["a", 0.0, 0.0]), TypeError, "action", "'a'", "numeric"),
        refusal(lambda: env.step(np.array([0, 0, 0])), TypeError, "action", "torch.int64", "torch.float32"),
        refusal(lambda: env.step([0.0, float("nan"), 0.0]), ValueError, "action", "mrp_2=nan"),
        refusal(lambda: env.step(3), ValueError, "action", [], [3]),
    )


def test_rejects_hybrid_actions_for_stable_baselines3():
    view = pytest.importorskip("bsk_torch.wrappers.stable_baselines3").SB3VecEnv
    check_refusals(refusal(lambda: view(core(Choose("choose"))), ValueError, "'choose'", "act.ContinuousAction"))
