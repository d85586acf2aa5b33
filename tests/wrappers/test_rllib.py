"""RLlib's configurations of bsk_rl's programs, with Ray itself; runs under scripts/test.sh --rllib."""

import pytest

from .test_metrics import charge, total
from .test_registration import Imager, problem

pytestmark = pytest.mark.rllib


def test_registered_names_make_environments_and_callbacks_log():
    from ray.rllib.env.wrappers.pettingzoo_env import ParallelPettingZooEnv
    from ray.tune.registry import ENV_CREATOR, _global_registry

    from bsk_torch.wrappers.rllib import WrappedEpisodeDataCallbacks

    logged = {}

    class Log:
        def log_value(self, name, value, **_):
            logged[name] = value

    make = _global_registry.get(ENV_CREATOR, "ConstellationTasking-RLlib")
    config = problem(satellites=[Imager("A"), Imager("B")], episode_data_callback=total, satellite_data_callback=charge)
    env = make(config)
    assert isinstance(env, ParallelPettingZooEnv)
    WrappedEpisodeDataCallbacks().on_environment_created(env=env, metrics_logger=Log())
    env.reset()
    for _ in range(3):
        env.step({"A": 0, "B": 0})
    assert set(logged) == {"reward", "A/charge", "B/charge", "mean/charge"}


def test_ppo_trains_with_env_config_and_reports_metrics():
    from ray.rllib.algorithms.ppo import PPOConfig

    from bsk_torch.wrappers.rllib import WrappedEpisodeDataCallbacks

    config = PPOConfig().environment(
        "SatelliteTasking-RLlib", env_config=problem(satellite=Imager("A"), episode_data_callback=total)
    )
    config = config.env_runners(num_env_runners=0).training(train_batch_size=12, minibatch_size=6, num_epochs=1)
    algorithm = config.callbacks(WrappedEpisodeDataCallbacks).build_algo()
    result = algorithm.train()
    assert "reward" in result["env_runners"]
    algorithm.stop()
