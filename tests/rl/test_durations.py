"""Discounts per second as functions, in TorchRL's estimators and losses, and in Stable-Baselines3."""

from importlib.util import find_spec

import numpy as np
import pytest
import torch
from tensordict import TensorDict
from tensordict.nn import TensorDictModule
from torchrl.data import Categorical
from torchrl.modules import MaskedCategorical, ProbabilisticActor, QValueActor, ValueOperator
from torchrl.objectives import ClipPPOLoss, DiscreteSACLoss, DQNLoss
from torchrl.objectives.value import GAE

from bsk_torch.rl.durations import DurationGAE, DurationTD0, estimate_advantages, td_targets
from bsk_torch.rl.networks import FeatureNormaliser

GAMMA, LMBDA = 0.999, 0.9

ROUNDING = dict(rtol=1e-5, atol=1e-5)
"""Sums of a dozen float32 numbers of order one."""


def batch(n=3, steps=12, seconds=None):
    """Random decisions [n, steps] with values, of which some end an episode and half of these by a time limit."""
    torch.manual_seed(0)
    done = torch.rand(n, steps, 1) < 0.25
    following = {
        "state_value": torch.randn(n, steps, 1),
        "reward": torch.randn(n, steps, 1),
        "duration": torch.randint(60, 181, (n, steps, 1)).float() if seconds is None else torch.full((n, steps, 1), seconds),
        "done": done,
        "terminated": done & (torch.rand(n, steps, 1) < 0.5),
    }
    return TensorDict({"state_value": torch.randn(n, steps, 1), "next": following}, [n, steps], names=[None, "time"])


def columns(data):
    """The arguments of ``estimate_advantages``."""
    value, following = data["state_value"], data["next"]
    return (
        *(following[key] for key in ("reward", "duration")),
        value,
        *(following[k] for k in ("state_value", "done", "terminated")),
    )


def sums(data, reward_time):
    """Advantages as the sum over later decisions k of the same episode: errors of values, times g lambda of those before k."""
    n, steps = data.shape
    result = torch.zeros(n, steps, 1, dtype=torch.float64)
    reward, seconds, value, following, done, terminated = (column.double() for column in columns(data))
    for i in range(n):
        for t in range(steps):
            weight = 1.0
            for k in range(t, steps):
                g = GAMMA ** seconds[i, k]
                later = following[i, k] * (1.0 - terminated[i, k])
                error = (g * (reward[i, k] + later) if reward_time == "end" else reward[i, k] + g * later) - value[i, k]
                result[i, t] += weight * error
                weight = weight * g * LMBDA
                if done[i, k]:
                    break
    return result


@pytest.mark.parametrize("reward_time", ["end", "start"])
def test_advantages_are_the_sums_of_their_definition(reward_time):
    data = batch()
    expected, settings = sums(data, reward_time), dict(gamma=GAMMA, lmbda=LMBDA, reward_time=reward_time)
    advantage, target = estimate_advantages(*columns(data), **settings)
    torch.testing.assert_close(advantage.double(), expected, **ROUNDING)
    torch.testing.assert_close(target, advantage + data["state_value"])
    turned = [column.transpose(0, 1) for column in columns(data)]
    torch.testing.assert_close(estimate_advantages(*turned, **settings, time_dim=0)[0].transpose(0, 1), advantage)
    before = data.clone()
    estimated = DurationGAE(**settings)(data)
    assert estimated is data
    torch.testing.assert_close(data["advantage"].double(), expected, **ROUNDING)
    torch.testing.assert_close(data["value_target"], target, **ROUNDING)
    assert bool((data["next"] == before["next"]).all())


def test_two_steps_by_hand():
    """0.5 per 100 s, lambda 0.5; steps of 100 s and 200 s with rewards 8 and 16, all values 4; the second step terminates."""
    data = batch(1, 2)
    data["state_value"], data["next", "state_value"] = torch.full((2, 1, 2, 1), 4.0)
    data["next", "reward"], data["next", "duration"] = torch.tensor([[[8.0], [16.0]], [[100.0], [200.0]]]).unsqueeze(1)
    data["next", "done"] = data["next", "terminated"] = torch.tensor([[[False], [True]]])
    for reward_time, first, second in (("end", 0.5 * (8 + 4) - 4, 0.25 * 16 - 4), ("start", 8 + 0.5 * 4 - 4, 16 - 4)):
        settings = dict(gamma=0.5**0.01, lmbda=0.5, reward_time=reward_time)
        expected = torch.tensor([first + 0.5 * 0.5 * second, second])
        torch.testing.assert_close(estimate_advantages(*columns(data), **settings)[0].flatten(), expected, **ROUNDING)
        torch.testing.assert_close(DurationGAE(**settings)(data)["advantage"].flatten(), expected, **ROUNDING)


def test_steps_of_equal_length_are_torchrls():
    data = batch(seconds=60.0)
    plain = GAE(gamma=GAMMA**60.0, lmbda=LMBDA, value_network=None)(data.clone())["advantage"]
    torch.testing.assert_close(DurationGAE(gamma=GAMMA, lmbda=LMBDA, reward_time="start")(data)["advantage"], plain, **ROUNDING)


def test_horizons_of_months_are_those_of_double_precision():
    """In float32, 1 - 1e-8 is 1."""
    data = batch(1, 1, seconds=1e7)
    data["next", "done"] = data["next", "terminated"] = torch.ones(1, 1, 1, dtype=torch.bool)
    advantage = DurationGAE(gamma=1.0 - 1e-8, lmbda=1.0)(data)["advantage"]
    torch.testing.assert_close(advantage, data["next", "reward"] * 0.9048374 - data["state_value"], **ROUNDING)


def test_agents_share_ends():
    data = batch()
    agents = [column.unsqueeze(2).expand(-1, -1, 2, -1) for column in columns(data)[:4]]
    ends = [column.unsqueeze(2) for column in columns(data)[4:]]
    one, _ = estimate_advantages(*columns(data), gamma=GAMMA, lmbda=LMBDA)
    advantage, _ = estimate_advantages(*agents, *ends, gamma=GAMMA, lmbda=LMBDA)
    assert torch.equal(advantage, one.unsqueeze(2).expand(-1, -1, 2, -1))


# -- losses of TorchRL ------------------------------------------------------------------------------------------------


def decisions():
    """Eight decisions between three actions, of which the last one is always illegal; every other one terminates."""
    torch.manual_seed(0)
    data = batch(8, 1).reshape(-1).exclude("state_value", ("next", "state_value"))
    legal = torch.tensor([True, True, False]).expand(8, 3)
    for part in (data, data["next"]):
        part["observation"], part["action_mask"] = torch.randn(8, 2), legal
    data["next", "done"] = data["next", "terminated"] = (torch.arange(8) % 2 == 0).unsqueeze(1)
    return data.set("action", torch.randint(0, 2, (8,)))


def favors_the_last():
    """A network [n, 2] -> [n, 3] whose last output is the largest by far."""
    torch.manual_seed(0)
    layer = torch.nn.Linear(2, 3)
    layer.bias.data[2] = 100.0
    return layer


@pytest.mark.parametrize("reward_time", ["end", "start"])
def test_deep_q_learning_takes_legal_actions_and_durations(reward_time):
    data, layer = decisions(), favors_the_last()
    actor = QValueActor(layer, in_keys=["observation"], spec=Categorical(3), action_mask_key="action_mask")
    loss = DQNLoss(actor, action_space="categorical", double_dqn=True, delay_value=True, loss_function="l2")
    loss.make_value_estimator(DurationTD0, gamma=GAMMA, reward_time=reward_time)
    following = layer(data["next", "observation"])[:, :2].max(1, keepdim=True).values
    steps = (data["next", key] for key in ("reward", "duration"))
    target = td_targets(*steps, following, data["next", "terminated"], GAMMA, reward_time)
    chosen = layer(data["observation"]).gather(1, data["action"].unsqueeze(1))
    torch.testing.assert_close(loss(data)["loss"], (chosen - target).square().mean(), **ROUNDING)


def test_discrete_sac_takes_legal_actions_and_durations():
    data, layer = decisions(), favors_the_last()
    keys = {"logits": "logits", "mask": "action_mask"}
    net = TensorDictModule(layer, ["observation"], ["logits"])
    never = {"neg_inf": -1e9}  # the loss multiplies it by a probability of 0
    actor = ProbabilisticActor(net, in_keys=keys, distribution_class=MaskedCategorical, distribution_kwargs=never)
    critic = TensorDictModule(favors_the_last(), ["observation"], ["action_value"])
    loss = DiscreteSACLoss(actor, critic, action_space="categorical", num_actions=3, loss_function="l2", num_qvalue_nets=1)
    loss.make_value_estimator(DurationTD0, gamma=GAMMA)
    weights = loss.target_qvalue_network_params
    with torch.no_grad():
        following, now = data["next"], data["observation"]
        probs = layer(following["observation"])[:, :2].softmax(-1)
        values = torch.nn.functional.linear(
            following["observation"], weights["module", "weight"][0], weights["module", "bias"][0]
        )
        following["state_value"] = (probs * (values[:, :2] - probs.log())).sum(-1, keepdim=True)
        steps = (following[key] for key in ("reward", "duration", "state_value", "terminated"))
        target = td_targets(*steps, GAMMA)
        chosen = torch.nn.functional.linear(now, weights["module", "weight"][0], weights["module", "bias"][0])
    error = chosen.gather(1, data["action"].unsqueeze(1)) - target
    losses = loss(data)
    torch.testing.assert_close(losses["loss_qvalue"], error.square().mean(), **ROUNDING)
    assert bool(losses["loss_actor"].isfinite())


def test_a_batch_without_durations_is_refused():
    with pytest.raises(KeyError, match="duration"):
        DurationGAE(gamma=GAMMA, lmbda=LMBDA)(batch().exclude(("next", "duration")))


class Rebinding(FeatureNormaliser):
    """Assigns new tensors to its buffers instead of changing them."""

    def update(self, x, mask=None):
        other = FeatureNormaliser(x.shape[-1])
        other.update(x, mask)
        for name, value in other.named_buffers():
            setattr(self, name, value)


@pytest.mark.parametrize(("kind", "follows"), [(FeatureNormaliser, True), (Rebinding, False)])
def test_a_loss_sees_updates_in_place(kind, follows):
    """ClipPPOLoss keeps references to the buffers of the networks; a rebound buffer is another one."""
    seen, net = kind(2), torch.nn.Linear(2, 3)
    module = TensorDictModule(torch.nn.Sequential(seen, net), ["observation"], ["logits"])
    keys = {"logits": "logits", "mask": "action_mask"}
    actor = ProbabilisticActor(module, in_keys=keys, distribution_class=MaskedCategorical, return_log_prob=True)
    loss = ClipPPOLoss(actor, ValueOperator(torch.nn.Linear(2, 1), in_keys=["observation"]), entropy_bonus=False)
    data = decisions()
    seen.update(5.0 + 3.0 * torch.randn(100, 2))
    with torch.no_grad():
        data = actor(data)  # as a collector, which has the module itself
    data["advantage"], data["value_target"] = torch.ones(2, 8, 1)
    assert (float(loss(data)["kl_approx"].abs()) < 1e-6) == follows


def test_target_networks_are_copies_that_updates_do_not_reach():
    seen = FeatureNormaliser(2)
    network = torch.nn.Sequential(seen, torch.nn.Linear(2, 3))
    loss = DQNLoss(
        QValueActor(network, in_keys=["observation"], spec=Categorical(3)), action_space="categorical", delay_value=True
    )
    seen.update(5.0 + 3.0 * torch.randn(100, 2))
    kept, copied = (
        params["module", "0", "module", "0", "count"] for params in (loss.value_network_params, loss.target_value_network_params)
    )
    assert (float(kept), float(copied)) == (100.0, 0.0)


# -- Stable-Baselines3 ------------------------------------------------------------------------------------------------


needs_sb3 = pytest.mark.skipif(find_spec("sb3_contrib") is None, reason="needs pip install 'bsk_torch[sb3]'")


def vec_env(**options):
    from bsk_torch.wrappers.stable_baselines3 import SB3VecEnv

    return SB3VecEnv("NadirScan-v1", 2, time_limit=400.0, **options)


@needs_sb3
@pytest.mark.compiled
@pytest.mark.parametrize("algorithm", ["PPO", "MaskablePPO"])
@pytest.mark.parametrize("limit_terminates", [True, False])
def test_ppo_discounts_per_second(algorithm, limit_terminates):
    """After a time limit that truncates, the value of the last state counts, discounted over the step."""
    import sb3_contrib
    import stable_baselines3
    from stable_baselines3.common.callbacks import BaseCallback

    from bsk_torch.rl.stable_baselines3 import DiscountPerSecond

    class Notes(BaseCallback):
        """What the environment gave, and what the rollout's buffer had at its end."""

        def _on_training_start(self):
            self.steps, self.kept = [], None

        def _on_step(self):
            values = self.model.policy.predict_values(torch.as_tensor(self.locals["new_obs"])).detach()
            for row, info in enumerate(self.locals["infos"]):
                if self.locals["dones"][row]:
                    last = self.model.policy.predict_values(torch.as_tensor(info["terminal_observation"])[None]).detach()
                    values[row] = last * info["TimeLimit.truncated"]
            seconds = [info["duration"] for info in self.locals["infos"]]
            self.steps.append((self.locals["rewards"].copy(), seconds, values.flatten().numpy(), self.locals["dones"]))
            return True

        def _on_rollout_end(self):
            buffer = self.locals["rollout_buffer"]
            self.kept = buffer.values.copy(), buffer.advantages.copy(), buffer.returns.copy()

    notes = Notes()
    kind = getattr(stable_baselines3, algorithm, None) or getattr(sb3_contrib, algorithm)
    env = vec_env(terminate_on_time_limit=limit_terminates)
    kind("MlpPolicy", env, n_steps=6, batch_size=12, n_epochs=1, gamma=1.0, gae_lambda=LMBDA, seed=0, device="cpu").learn(
        12, callback=[DiscountPerSecond(GAMMA), notes]
    )
    value, advantage, target = notes.kept
    later, ended = np.zeros(2), 0
    for t in reversed(range(6)):
        reward, seconds, following, done = notes.steps[t]
        g = GAMMA ** np.array(seconds)
        later = g * (reward + following) - value[t] + g * LMBDA * later * ~done
        np.testing.assert_allclose(advantage[t], later, rtol=1e-5, atol=1e-6)
        np.testing.assert_allclose(target[t], later + value[t], rtol=1e-5, atol=1e-6)
        ended += done.sum()
    assert ended


@needs_sb3
def test_samples_of_a_replay_buffer_have_the_discount_of_their_step():
    """Rewards 1 and 2 belong to steps of 180 s and of 60 s."""
    from gymnasium import spaces

    from bsk_torch.rl.stable_baselines3 import DurationReplayBuffer

    np.random.seed(0)
    buffer = DurationReplayBuffer(64, spaces.Box(-1.0, 1.0, (3,)), spaces.Discrete(2), "cpu", n_envs=2, gamma=GAMMA)
    infos = [{"duration": 180.0}, {"duration": 60.0, "TimeLimit.truncated": True}]
    for _ in range(8):
        buffer.add(*np.zeros((2, 2, 3)), np.zeros(2), np.array([1.0, 2.0]), np.array([True, True]), infos)
    samples = buffer.sample(20)
    long = samples.dones.bool()
    assert 0 < int(long.sum()) < 20
    torch.testing.assert_close(samples.discounts, torch.where(long, GAMMA**180.0, GAMMA**60.0))
    torch.testing.assert_close(samples.rewards, samples.discounts * torch.where(long, 1.0, 2.0))


@needs_sb3
@pytest.mark.compiled
@pytest.mark.parametrize(("algorithm", "gamma"), [("PPO", 0.99), ("DQN", 1.0)])
def test_other_models_are_refused(algorithm, gamma):
    import stable_baselines3

    from bsk_torch.rl.stable_baselines3 import DiscountPerSecond

    model = getattr(stable_baselines3, algorithm)("MlpPolicy", vec_env(), gamma=gamma, device="cpu")
    with pytest.raises(ValueError, match=rf"PPO, MaskablePPO or A2C with gamma=1\.0, not {algorithm} with gamma={gamma}"):
        model.learn(2, callback=DiscountPerSecond(GAMMA))
