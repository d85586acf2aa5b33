"""Learning with actions of real numbers: PPO and MAPPO, files of policies, evaluation, and what is refused."""

import math

import pytest
import torch
from torchrl.envs.utils import ExplorationType, set_exploration_type

from bsk_torch import ConstellationTasking, SatelliteTasking, act, data, obs, presets, sats
from bsk_torch.rl.evaluation import evaluate
from bsk_torch.rl.marl import MAPPOConfig, MAPPOTraining
from bsk_torch.rl.networks.plans import AttentionPlan, GRUPlan, MLPPlan
from bsk_torch.rl.policies.files import check_fits, policy_of_file, read_card
from bsk_torch.rl.policies.shared_policy import shared, shared_baselines
from bsk_torch.rl.rules.continuous import bounds_of, spread
from bsk_torch.rl.rules.shield import SafeRule, shield
from bsk_torch.rl.training import resume, train
from bsk_torch.rl.training.config import PPOConfig
from bsk_torch.sim import dyn, fsw
from bsk_torch.viz.episodes import draw, record
from tests.act.test_continuous import START, Choose, kind
from tests.support.refusals import check_refusals, refusal

TARGET = torch.tensor([0.3, -0.2, 0.1], dtype=torch.float64)


class Aim(data.GlobalReward):
    """Reward for the attitude at the end of a step: the negative distance of its MRP from a target."""

    def read_log(self):
        return {"sigma_BN": self.fleet.each(lambda satellite: satellite.dynamics.sigma_BN)}

    def calculate_reward(self, before, after):
        return -(after["sigma_BN"] - TARGET).norm(dim=-1)


class Turner(sats.Satellite):
    """Has the attitude of its set-point at once."""

    dyn_type, fsw_type = dyn.DynamicsModel, fsw.FSWModel
    observation_spec = (obs.SatProperties(dict(prop="sigma_BN")), obs.Time(norm=100.0))
    action_spec = (act.AttitudeSetpoint(control_period=4.0),)


class Other(Turner):
    """Turns, or drifts: a type of numbered actions beside the one of real numbers."""

    action_spec = (act.Drift(duration=3.0), act.NadirPoint(duration=3.0))


def turner(num_envs=1, **options):
    return SatelliteTasking(
        Turner("A"), rewarder=Aim(), num_envs=num_envs, **({"time_limit": 40.0, "backend": "eager"} | options)
    )


def crew(num_envs=1, **options):
    satellites = [Turner("A"), Turner("B"), Other("C")]
    return ConstellationTasking(
        satellites, rewarder=Aim(), num_envs=num_envs, **({"time_limit": 30.0, "backend": "eager"} | options)
    )


@pytest.fixture(autouse=True)
def presets_of_this_page(monkeypatch):
    monkeypatch.setitem(presets.PRESETS, "Turner-v0", turner)
    monkeypatch.setitem(presets.PRESETS, "Crew-v0", crew)


class TestNetworks:
    @pytest.mark.parametrize(("plan", "hidden"), [(MLPPlan, (8,)), (GRUPlan, (8, 8))])
    def test_actions_lie_within_their_bounds(self, plan, hidden):
        env = turner(50)
        networks = plan.of(env, hidden).build()
        td = networks.policy(env.reset())
        assert (td["action"].shape, td["action"].dtype) == ((50, 3), torch.float32)
        assert bool((td["action"].abs() < 1.0).all())
        assert td["action_log_prob"].shape == (50,)
        with set_exploration_type(ExplorationType.DETERMINISTIC):
            first, second = (networks.policy(env.reset())["action"] for _ in range(2))
        assert bool((first.abs() < 0.1).all())  # an untrained actor's means are small
        assert first.shape == second.shape

    def test_bounds(self):
        assert bounds_of(turner()) == ((-1.0, 1.0),) * 3
        mover = kind(act.ImpulsiveThrust(max_dv=1.0), models=(dyn.DynamicsModel, fsw.MagicOrbitalManeuverFSWModel))
        env = SatelliteTasking(mover("A", START), backend="eager", orbit="integrated")
        infinite = "'thrust_act'", "A", "duration in [2.0, inf]"
        check_refusals(refusal(lambda of=of: of(env, (8, 8)), ValueError, *infinite) for of in (MLPPlan.of, GRUPlan.of))
        with pytest.raises(ValueError, match="has real numbers and a choice"):
            MLPPlan.of(SatelliteTasking(kind(Choose("choose"))("A", START), backend="eager"), (8,))
        with pytest.raises(ValueError, match="are real numbers: use 'mlp'"):
            AttentionPlan.of(turner(), (32,))
        with pytest.raises(ValueError, match="a shield masks numbered actions"):
            shield(lambda see, actions: torch.ones(1, 1, dtype=torch.bool), turner())

    def test_random_numbers_are_uniform_and_independent(self):
        lot = torch.rand(20000, dtype=torch.float64, generator=torch.Generator().manual_seed(1))
        values = spread(lot, ((-1.0, 1.0), (2.0, 10.0), (0.0, 1.0), (0.0, 1.0)))
        assert values.mean(0).tolist() == pytest.approx([0.0, 6.0, 0.5, 0.5], abs=0.04)
        assert values.std(0).tolist() == pytest.approx([2 / 12**0.5, 8 / 12**0.5, 12**-0.5, 12**-0.5], rel=0.02)
        correlations = torch.corrcoef(values.mT) - torch.eye(4)
        assert float(correlations.abs().max()) < 0.03


def settings(**changes):
    common = dict(seconds=None, frames=8192, num_envs=64, rollout=8, minibatch=128, hidden=(16,), gamma=0.9, entropy=0.0, seed=3)
    return PPOConfig("Turner-v0", **(common | dict(learning_rate=1e-2, checkpoint_every=0, epochs=6) | changes))


class TestPPO:
    def test_it_learns_and_its_file_is_read(self, tmp_path):
        policy = train(settings(), tmp_path / "run", episodes=0)
        env = turner(16)
        baselines = shared_baselines(env)
        assert list(baselines) == ["random"]
        random, learned = (evaluate(player, env, seed=11).mean_return.mean for player in (baselines["random"], policy))
        assert random < -6.0  # ten steps, each about one away
        assert learned > -2.0
        loaded = policy_of_file(tmp_path / "run")
        assert evaluate(loaded, env, seed=11).mean_return.mean == learned
        card = read_card(tmp_path / "run")
        assert card["plan"]["bounds"] == ((-1.0, 1.0),) * 3 or card["plan"]["bounds"] == [[-1.0, 1.0]] * 3
        check_fits(card, env)
        with pytest.raises(ValueError, match="bounds="):
            check_fits(card, SatelliteTasking(Other("A"), rewarder=Aim(), backend="eager"))

    def test_a_policy_with_a_memory_learns(self, tmp_path):
        train(settings(network="gru", hidden=(8, 8), frames=1024), tmp_path / "run", episodes=0)
        assert (tmp_path / "run" / "policy.pt").exists()

    def test_a_run_goes_on(self, tmp_path):
        train(settings(frames=1024), tmp_path / "run", episodes=0)
        before = policy_of_file(tmp_path / "run")
        config = (tmp_path / "run" / "config.yaml").read_text()
        (tmp_path / "run" / "config.yaml").write_text(config.replace("frames: 1024", "frames: 2048"))
        after = resume(tmp_path / "run", episodes=0)
        states = [list(policy.parameters()) for policy in (before, after)]
        assert any(not torch.equal(a, b) for a, b in zip(*states, strict=True))


def test_episodes_are_drawn(tmp_path):
    env = turner()
    draw(record(shared_baselines(env)["random"], env, seed=0), tmp_path / "one.png", "one")
    team = crew()
    draw(record(shared_baselines(team)["random"], team, seed=0), tmp_path / "crew.png", "crew")
    assert all((tmp_path / name).stat().st_size > 10_000 for name in ("one.png", "crew.png"))


class TestMAPPO:
    def settings(self, **changes):
        common = dict(seconds=None, frames=2048, num_envs=32, rollout=16, minibatch=128, hidden=(32,), gamma=0.9, entropy=0.0)
        extra = dict(learning_rate=1e-2, checkpoint_every=0, epochs=4, options={}, seed=1)
        return MAPPOConfig("Crew-v0", **(common | extra | changes))

    @pytest.mark.parametrize("algorithm", ["mappo", "ippo"])
    @pytest.mark.nightly("ippo")
    def test_types_of_real_and_numbered_actions_learn_side_by_side(self, algorithm, tmp_path):
        training = MAPPOTraining(self.settings(algorithm=algorithm), tmp_path / "run")
        policy = training.run()
        env = crew(8)
        random, learned = (
            evaluate(player, env, seed=5).mean_return.mean for player in (shared_baselines(env)["random"], shared(policy, env))
        )
        assert math.isfinite(learned)
        assert learned > random + 2.0
        loaded = shared(policy_of_file(tmp_path / "run"), env)
        assert evaluate(loaded, env, seed=5).mean_return.mean == learned

    def test_busy_satellites_go_on(self):
        env = crew(4)
        policy = shared_baselines(env)["random"]
        td = env.step(policy(env.reset()))["next"]
        assert td["duration"].flatten().tolist() == [3.0] * 4
        decided = policy(td)
        assert not bool(td["turner", "requires_retasking"].any())
        assert bool((decided["turner", "action"] == 2.0**31).all())  # NO_ACTION in single precision
        assert env.step(decided)["next", "duration"].flatten().tolist() == [1.0] * 4


def test_rejects_the_safe_rule():
    check_refusals(refusal(lambda: shield(SafeRule(), turner()), ValueError, "shield", "actions", "A", "real numbers"))
