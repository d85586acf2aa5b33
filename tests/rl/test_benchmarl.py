"""Constellations as BenchMARL's tasks: what it is told of them, and a short training.

BenchMARL 1.5 wants an older TorchRL than this package, so scripts/test.sh installs it without its dependencies: see
:mod:`bsk_torch.rl.marl.benchmarl`.
"""

from importlib.util import find_spec

import pytest
import torch

if find_spec("benchmarl") is None:
    pytest.skip("needs pip install --no-deps benchmarl==1.5.2", allow_module_level=True)

from bsk_torch.rl.marl.benchmarl import ConstellationTask, TaskConfig

# isort: split
from benchmarl.algorithms import IppoConfig, MappoConfig
from benchmarl.experiment import Experiment, ExperimentConfig
from benchmarl.models.mlp import MlpConfig

pytestmark = pytest.mark.compiled

SMALL = {
    "CONSTELLATION": dict(n_satellites=3, n_targets=100, time_limit=600.0),
    "AEOS_CONSTELLATION": dict(n_satellites=2, n_targets=100, time_limit=600.0),
    "RELAY_CONSTELLATION": dict(n_imagers=2, n_targets=100, time_limit=600.0),
}
GROUPS = {
    "CONSTELLATION": {"agents": (3, 17)},
    "AEOS_CONSTELLATION": {"agents": (2, 33)},
    "RELAY_CONSTELLATION": {"broadcasting_imager": (2, 18), "relay": (2, 4)},
}


def task(name="CONSTELLATION", **config):
    return ConstellationTask[name].get_task({"options": SMALL[name]} | config)


@pytest.mark.parametrize("name", SMALL)
def test_groups_are_described_one_episode_at_a_time(name):
    made = task(name)
    env = made.get_env_fun(num_envs=2, continuous_actions=False, seed=0, device="cpu")()
    assert (env.batch_size, set(made.group_map(env))) == ((2,), set(GROUPS[name]))
    for group, (agents, actions) in GROUPS[name].items():
        assert list(made.observation_spec(env)[group].keys()) == ["observation"]
        assert made.observation_spec(env)[group, "observation"].shape[0] == agents
        assert made.action_mask_spec(env)[group, "action_mask"].shape == (agents, actions)
        assert made.action_spec(env)[group, "action"].space.n == actions


def test_tasks_can_be_set_and_compared():
    assert ConstellationTask.CONSTELLATION.get_task().config == {"max_steps": TaskConfig.max_steps, "options": {}}
    made = task(max_steps=7)
    assert made == task(max_steps=7) != task()
    assert (made.env_name(), made.max_steps(None), made.supports_continuous_actions()) == ("bsk_torch", 7, False)
    with pytest.raises(TypeError, match="max_step"):
        task(max_step=7)
    with pytest.raises(ValueError, match="actions of Constellation-v1 are discrete"):
        made.get_env_fun(num_envs=2, continuous_actions=True, seed=0, device="cpu")


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize(("name", "algorithm"), [("CONSTELLATION", MappoConfig), ("RELAY_CONSTELLATION", IppoConfig)])
def test_benchmarl_can_train(name, algorithm, tmp_path):
    """Two batches, and an evaluation of whole episodes; what is learned is not looked at."""
    config = ExperimentConfig.get_from_yaml()
    changes = dict(
        max_n_iters=2,
        max_n_frames=None,
        on_policy_n_envs_per_worker=4,
        on_policy_collected_frames_per_batch=32,
        on_policy_minibatch_size=16,
        on_policy_n_minibatch_iters=1,
        evaluation_interval=32,
        evaluation_episodes=2,
        loggers=["csv"],
        create_json=False,
        save_folder=str(tmp_path),
    )
    for key, value in changes.items():
        setattr(config, key, value)
    made = task(name, max_steps=20)
    experiment = Experiment(
        task=made, algorithm_config=algorithm.get_from_yaml(), model_config=MlpConfig.get_from_yaml(), seed=0, config=config
    )
    before = [parameter.clone() for parameter in experiment.policy.parameters()]
    experiment.run()
    assert experiment.total_frames == 64
    assert any(not torch.equal(old, new) for old, new in zip(before, experiment.policy.parameters(), strict=True))
    assert list(tmp_path.rglob("eval_reward_episode_reward_mean.csv"))
