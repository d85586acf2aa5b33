"""What chooses actions in other libraries, as policies of one satellite and of a constellation."""

import numpy as np
import pytest
import torch
from stable_baselines3 import PPO
from tensordict import TensorDict
from tensordict.nn import TensorDictModule

import bsk_torch
from bsk_torch.lab.planners import Rollout
from bsk_torch.rl.evaluation import compare, evaluate
from bsk_torch.rl.policies import as_policy
from bsk_torch.wrappers.policies import ModelPolicy, policy_of_one
from bsk_torch.wrappers.stable_baselines3 import SB3VecEnv
from tests.support.refusals import check_refusals, refusal

pytestmark = pytest.mark.compiled

SHORT = dict(time_limit=900.0, backend="compiled")


@pytest.fixture(scope="module")
def env():
    return bsk_torch.make("NadirScan-v1", num_envs=3, **SHORT)


def first_legal(observation, action_mask):
    return action_mask.long().argmax(-1)


def scores(observation):
    """The last action has the highest score."""
    return torch.arange(4.0, dtype=observation.dtype).expand(len(observation), 4)


class Net(torch.nn.Module):
    """Always prefers the second action; float32 whatever the observation is."""

    def __init__(self):
        super().__init__()
        self.layer = torch.nn.Linear(12, 4)
        torch.nn.init.zeros_(self.layer.weight)
        self.layer.bias.data = torch.tensor([0.0, 1.0, 0.0, 0.0])

    def forward(self, observation):
        return self.layer(observation)


def whole(td):
    return td.set("action", torch.full(td.batch_size, 2))


@pytest.mark.parametrize(
    ("actor", "wanted"),
    [
        (lambda observation: np.full(len(observation), 1), 1),
        (lambda observation: torch.full((len(observation), 1), 3), 3),
        (lambda x: torch.eye(4)[[2]].expand(len(x), 4), 2),
        (first_legal, 0),
        (scores, 3),
        (Net(), 1),
        (whole, 2),
        (TensorDictModule(first_legal, ["observation", "action_mask"], ["action"]), 0),
    ],
)
def test_each_kind_chooses_its_action(env, actor, wanted):
    assert as_policy(actor, env)(env.reset())["action"].tolist() == [wanted] * 3


def test_only_legal_actions_are_chosen_and_modules_not_wrapped(env):
    td = TensorDict({"observation": torch.zeros(2, 12), "action_mask": torch.tensor([[True, True, False, False]] * 2)}, [2])
    assert policy_of_one(scores, env.satellite)(td)["action"].tolist() == [1, 1]
    policy = TensorDictModule(first_legal, ["observation", "action_mask"], ["action"])
    assert as_policy(policy, env) is policy


def test_a_model_of_stable_baselines3_acts_as_in_its_own_environment(env):
    venv = SB3VecEnv("NadirScan-v1", num_envs=3, **SHORT)
    model = PPO("MlpPolicy", venv, n_steps=4, batch_size=12, n_epochs=1, seed=0).learn(12)
    venv.seed(5)
    ours = evaluate(model, env, seed=5)
    seen, returns, ended = venv.reset(), np.zeros(3), np.zeros(3, dtype=bool)
    while not ended.all():
        seen, reward, done, _ = venv.step(model.predict(seen, deterministic=True)[0])
        returns += np.where(ended, 0.0, reward)
        ended |= done
    assert ours.returns.tolist() == pytest.approx(returns.tolist(), abs=1e-6)
    assert isinstance(as_policy(model, env), ModelPolicy)


def test_a_function_decides_for_each_satellite_of_a_constellation():
    options = dict(n_satellites=3, n_planes=1, phasing=0, n_targets=100, num_envs=2)
    team = bsk_torch.make("Constellation-v1", time_limit=300.0, **options)
    numbers = as_policy(first_legal, team)(team.reset())["agents", "action"]
    assert numbers.tolist() == team.reset()["agents", "action_mask"][..., :-1].long().argmax(-1).tolist()
    assert evaluate(first_legal, team, seed=1).decisions.shape == (2,)


def test_planners_and_comparisons_have_the_same_door(env):
    assert next(iter(compare({"mine": Net()}, env, 0))) == "mine"
    short = bsk_torch.make("NadirScan-v1", num_envs=1, **SHORT)
    planned = Rollout(short, base=first_legal, horizon=120.0)(short.reset())
    assert planned["action"].shape == (1,)


def test_real_actions_come_from_functions(tmp_path):
    docking = bsk_torch.make("CWDocking-v1", num_envs=2, time_limit=20.0)
    policy = as_policy(lambda observation: observation[:, :3] * 0.0 + 0.25, docking)
    assert policy(docking.reset())["action"].tolist() == [[0.25] * 3] * 2


def test_rejects_objects_that_are_no_policies(env):
    wrong_shape = lambda observation: torch.ones(2, 2)
    text = lambda observation: "charge"
    docking = bsk_torch.make("CWDocking-v1", num_envs=2, time_limit=20.0)
    check_refusals(
        refusal(lambda: evaluate("ruel", env, seed=0), ValueError, "'ruel'", "'rule'"),
        refusal(lambda: evaluate(3, env, seed=0), TypeError, "a int", "TensorDictModule(network", "Stable-Baselines3"),
        refusal(lambda: evaluate(lambda: 1, env, seed=0), TypeError, "the function", "TensorDictModule(network"),
        refusal(lambda: evaluate(torch.nn.Linear, env, seed=0), TypeError, "the class Linear", "TensorDictModule(network"),
        refusal(lambda: evaluate(wrong_shape, env, seed=0), ValueError, "[2, 2]", "[3]", "[3, 4]"),
        refusal(lambda: evaluate(text, env, seed=0), TypeError, "a str", "tensor of actions"),
        refusal(lambda: as_policy(first_legal, docking), TypeError, "first_legal", "no action mask"),
    )
